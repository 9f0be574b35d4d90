"""compare, diagnose and repair as users see them, from findings made by hand: no simulation."""

import csv
import itertools
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import click
import findings_by_hand as by
import numpy as np
import pytest
from places import SCENES, cases_of

from mcrim_mitsuba.cli.options import FURTHER_PHOTONS, PHOTONS
from mcrim_mitsuba.core.rounding import p_equals
from mcrim_mitsuba.efficiency.response_maker import EFFECT_PHOTONS, PLAIN_FACTOR
from mcrim_mitsuba.inference import compare as comparing
from mcrim_mitsuba.inference import diagnose as diagnosing
from mcrim_mitsuba.inference import fit as fitting
from mcrim_mitsuba.inference import repair as repairing
from mcrim_mitsuba.inference.hypotheses import NAMES, FittedHypothesis, SideBySide
from mcrim_mitsuba.inference.next_measurements import configuration_words
from mcrim_mitsuba.inference.profiles import Profile
from mcrim_mitsuba.inference.repair import Repaired
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.inference.weighing import AveragedYield
from mcrim_mitsuba.output import describe_campaign, description, sentences
from mcrim_mitsuba.output.campaign_results import DiagnosisResult, HypothesesResult
from mcrim_mitsuba.output.description import Description
from mcrim_mitsuba.output.diagnosis_figures import draw_ranking, draw_staircase
from mcrim_mitsuba.output.fit_figures import draw_comparison, draw_hypotheses
from mcrim_mitsuba.scene.scene_file import read_scene

cases = cases_of(__file__)


def title_of(figure):
    """The figure's title, as an artist."""
    [title] = [text for text in figure.texts if text.get_text() == figure.get_suptitle()]
    return title


def overlap(artists, figure) -> list[str]:
    """Texts whose boxes on the page overlap."""
    figure.draw_without_rendering()
    boxes = [(a.get_text(), a.get_window_extent()) for a in artists if a.get_text()]
    return [
        f"{one} / {two}" for (one, a), (two, b) in itertools.combinations(boxes, 2) if a.overlaps(b)
    ]


@pytest.fixture
def campaign(campaign_here) -> str:
    return campaign_here


def repaired(diagnosis) -> Repaired:
    """Where nothing was added."""
    return Repaired(
        diagnosis=diagnosis,
        effects=(),
        fit=by.calibration(),
        campaign_path=None,
        scene_path=None,
        provenance=by.PROVENANCE,
        simulations=None,
    )


@pytest.fixture
def found(monkeypatch):
    """What the commands find: change it before they run."""
    results = {
        "compare": by.comparison(suspects=(by.BAD, by.SWAPPED)),
        "diagnose": by.diagnosis("missing_effect"),
    }
    results["repair"] = replace(
        repaired(results["diagnose"]),
        effects=(by.FIRST,),
        fit=by.calibration(by.MENDED, 0.3, 12.0),
        campaign_path=Path("new.toml"),
        scene_path=Path("new.xml"),
    )

    def repair(*_, on_step, **__):
        for step in results["repair"].diagnosis.repair:
            on_step(step)
        return results["repair"]

    monkeypatch.setattr(CampaignSimulations, "fit", lambda _: by.calibration())
    monkeypatch.setattr(CampaignSimulations, "provenance", lambda _: by.PROVENANCE)
    monkeypatch.setattr(comparing, "comparison_of", lambda _: results["compare"])
    monkeypatch.setattr(diagnosing, "diagnose", lambda *_, **__: results["diagnose"])
    monkeypatch.setattr(repairing, "repair", repair)
    # findings made by hand have no model
    monkeypatch.setattr(fitting, "profiles_of", lambda *_: ())
    return results


#: Nothing is shown of the campaign itself.
NO_CAMPAIGN = SimpleNamespace(title="", unit="")
PAIRED = by.diagnosis("missing_effect", pairs=(by.PAIR,), leading_sets=((by.FIRST, by.SECOND),))


def shown_of(diagnosis) -> Description:
    notes = diagnosis.baseline.notes
    return DiagnosisResult.of(diagnosis, NO_CAMPAIGN, by.PROVENANCE, notes).description


def row_of(out: str, first: str) -> list[str]:
    line = next(line for line in out.splitlines() if line.startswith(f"│ {first} "))
    return [cell.strip() for cell in line.split("│")[1:-1]]


def test_a_light_yield_has_the_digits_of_its_error():
    """It was 7 beside 8.34, and 0 % beside -6.0 %."""
    light = {"value": 7.0, "sigma": 0.5, "change": 0.0002}
    explanations = [replace(by.CANDIDATES[0], light_yield_ph_per_keV=light)]
    table = describe_campaign.candidates_table(by.diagnosis("ambiguous"), explanations, "")
    (cells,) = (row.cells for row in table.rows)
    place = [column.title for column in table.columns].index("light yield")
    assert cells[place].text == "7.0 (0.0 %)"


def test_compare_shows_where_the_misfit_lies(mcrim, campaign, found):
    status, out, err = mcrim("compare", campaign)
    assert (status, err) == (0, "")
    # of the 15 readings in use: 36 of 49 in squares
    worst = ["20.00 ± 0.20", "18.800 ± 0.010", "+6.00", "+6.60", "73 %"]
    assert row_of(out, by.MARKUP)[1:] == worst
    assert row_of(out, f"{by.LABELS[-1]} (not used)")[-2:] == ["", ""]
    quality = "64.2 where 12 ± 4.9 is expected (ndf = 12), p = 2.3e-09: the model does not"
    assert f"chi2 = {quality}" in out
    assert f"73 % of the squared pulls are those of 1 of 15 readings: {by.MARKUP} (73 %)" in out
    wrong, swapped = f"{by.MARKUP} looks wrong", f"{by.QUOTES} and {by.SCRIPT} look swap"
    trend = "along n_gap: 1: -2.1, 1.46: +2.2 (a trend, p = 0.0002)"
    assert out.index(wrong) < out.index(swapped) < out.index(trend)
    assert "alpha_abs = 0.07 is +2.6 sigma off" in out
    assert row_of(out, "scattering (1/cm)")[1] == "0.620 ± 0.030"
    assert out.splitlines()[-1].startswith(f"Next: check {by.MARKUP} in camoo4_measured.csv")
    assert out.splitlines()[-1].endswith(f"or mcrim diagnose {campaign}")
    assert "note: from afar" in out


@cases(
    "p_value",
    "says",
    "following",
    more=[(None, "without degrees of freedom", "Next: mcrim diagnose")],
)
def test_compare_says_what_chi2_means(mcrim, campaign, found, p_value, says, following):
    found["compare"] = by.comparison(p_value)
    out = mcrim.shown("compare", campaign)
    assert says in out and out.splitlines()[-1].startswith(following)
    assert "before physics is blamed" not in out


FIRST = "Absorbing crystal surface"
AVERAGED = (
    "Light yield: 7.7 ± 0.9 ph/keV (within models 0.78, between them 0.34, for what is in no "
    "catalogue 0.12), averaged over all explanations and sizes that the readings allow: the one to "
    "quote; the best fit alone gives 7.52 ± 0.20 with "
    "absorbing crystal surface (70 %)"
)
FIRST_LINES = {
    "missing_effect": "Absorbing crystal surface explains the misfit (surface_absorption: "
    "surface loss = 0.0123 ± 0.0008): chi2 64.2 -> 12.1 (ndf 11, p = 0.44)",
    "ambiguous": f"Ambiguous: as {by.MARKUP} shows",
    "adequate": f"Adequate: as {by.MARKUP} shows",
    "unexplained": f"Unexplained: as {by.MARKUP} shows",
    "too_few_readings": f"Too few readings: as {by.MARKUP} shows",
}
LAST_LINES = {
    "missing_effect": "Next: mcrim repair camoo4_campaign.toml -o camoo4_campaign_mended.toml",
    "ambiguous": "Next: measure water, gap of 0.5 mm; and gel, mask of 7 mm radius, add ",
    "adequate": "Next: mcrim calibrate camoo4_campaign.toml",
    "unexplained": "Next: measure more configurations",
    "too_few_readings": "Next: measure more configurations",
}


@pytest.mark.parametrize("verdict", FIRST_LINES)
def test_diagnose_says_the_verdict_first_and_what_to_do_last(mcrim, campaign, found, verdict):
    found["diagnose"] = by.diagnosis(verdict)
    out = mcrim.shown("diagnose", campaign)
    lines = out.splitlines()
    assert lines[0] == FIRST_LINES[verdict]
    assert lines[1].startswith("Of 100 %: ") and lines[2] == AVERAGED
    assert lines[-1].startswith(LAST_LINES[verdict])
    likely = [FIRST, "70 %", "1e+9", "surface loss = 0.0123 ± 0.0008", "usual size"]
    effect_of = ["7.52 (-9.5 %)", "52.1 ± 0.8", "0.44", "1.3", by.FIRST]
    assert row_of(out, FIRST) == likely + effect_of
    assert row_of(out, "Air bubble in the gap")[4] == "unusual size"
    at_bound = ["gap absorption (1/cm) = 20, at its bound", "end of its range"]
    assert row_of(out, "Absorbing liquid in the gap")[3:5] == at_bound
    switched = row_of(out, "Polarisation of the light")
    assert [switched[i] for i in (1, 4, 6)] == ["", "on or off", "-2.2 ± 0.8"]
    named = verdict in ("missing_effect", "ambiguous")
    assert ("How to look for it, without a fit:" in lines) == named
    assert (f"- {FIRST}: Polish it again." in lines) == named
    assert "By family (they may act together): surface 70 %, gap 29 %, nothing missing 1 %" in lines
    assert "not tried: nonlinear readout (nonlinearity): excluded" in lines
    assert ("what the readings allow" in out) == (verdict == "adequate")
    if verdict == "adequate":
        # the table of effects comes first, that of limits last
        out = out[out.index("what the readings allow") :]
        for name, text in {
            FIRST: "< 0.0021",
            "Source near the top face": "> 3.25",
            "Wrong index of the liquid": "-0.02 to 0.031",
            "Wrong index of the crystal": "no limit within its range",
            "Polarisation of the light": "excluded (chi2 rises by 9.3 with it)",
        }.items():
            assert row_of(out, name)[1] == text
        assert row_of(out, "Source near the top face")[2:] == ["source_depth_mm", "source_depth"]
    if verdict == "ambiguous":
        gain = ["1 h", "± 8.3 % in 7 of 10 outcomes, else ± 10.5 %", "94 %", "12.3"]
        separated = "absorbing crystal surface from air bubble in the gap"
        assert row_of(out, "water, gap of 0.5 mm;")[1:] == [*gain, separated]


def test_what_is_no_new_reading_is_done_first(mcrim, campaign, found):
    words = "look for air bubble in the gap"
    look = replace(
        by.diagnosis("ambiguous").next_measurements[0],
        kind="look",
        parameters={},
        also=None,
        light_yield_kept=0.96,
        words=words,
    )
    unknown = replace(look, light_yield_sigma=None, light_yield_kept=None)
    found["diagnose"] = by.diagnosis("ambiguous", next_measurements=(look, unknown))
    lines = mcrim.shown("diagnose", campaign).splitlines()
    assert lines[-1].startswith(f"Next: {words}, and diagnose again with what it says; or mcrim")
    shown = [line.split("│")[3].strip() for line in lines if "│ look for air bubble" in line]
    assert shown == ["± 8.3 %", "-"]


def test_a_pair_and_suspect_readings_are_named(mcrim, campaign, found):
    found["diagnose"] = PAIRED
    out = mcrim.shown("diagnose", campaign)
    assert out.splitlines()[0].startswith(
        "Absorbing crystal surface and air bubble in the gap explain the misfit "
        "(surface_absorption and gap_bubble: surface loss = 0.0100 ± 0.0010; bubble fraction = "
        "0.100 ± 0.020): chi2 64.2 -> 9.2"
    )
    found["diagnose"] = by.diagnosis("unexplained", suspect_readings=(by.BAD,))
    out = mcrim.shown("diagnose", campaign)
    assert f"- {by.MARKUP} looks wrong, +7.1 sigma from the others' prediction" in out
    assert out.index("looks wrong") < out.index("each added alone")
    assert out.splitlines()[-1].startswith("Next: check the readings named above")


def test_repair_shows_the_error_fall_and_how_to_go_on(mcrim, campaign, found):
    status, out, err = mcrim("repair", campaign, "-o", "new.toml")
    lines = out.splitlines()
    assert (status, err) == (0, "")
    assert lines[:2] == [
        "step 0, as it came: chi2 64.2, ndf 12, chi2 / ndf 5.35, p 2.3e-09, rms pull 2.1, left out "
        "2.6, light yield (ph/keV) 8.31 ± 0.25, scattering (1/cm) 0.620 ± 0.030",
        "step 1, + absorbing crystal surface: chi2 12.1, ndf 11, chi2 / ndf 1.1, p 0.36, rms pull "
        "0.9, left out 1.1, light yield (ph/keV) 7.52 ± 0.22, scattering (1/cm) 0.543 ± 0.021",
    ]
    # of what was added the yield is that of its simulation, as in the table below
    simulated = AVERAGED.replace("7.52 ± 0.20", "7.52 ± 0.22")
    assert lines[2:4] == [simulated, FIRST_LINES["missing_effect"]]
    assert row_of(out, "surface loss")[1] == "0.0123 ± 0.0008"
    assert lines[-1] == "new.toml and new.xml were written. Next: mcrim calibrate new.toml"


def test_an_unusual_size_is_told_and_not_added(mcrim, campaign, found):
    aside = by.diagnosis(
        "ambiguous",
        leading_sets=((by.SECOND,), (by.FIRST,)),
        set_aside=(by.SECOND,),
        next_measurements=(),
        repair=by.STEPS[:1],
    )
    told = (
        "The likeliest explanation, air bubble in the gap (bubble fraction = 0.200 ± 0.010), has a "
        "size that a laboratory does not usually meet, and is not added. If you have seen it, say "
        "--effect gap_bubble."
    )
    found["diagnose"] = aside
    lines = mcrim.shown("diagnose", campaign).splitlines()
    assert told in lines and "--effect gap_bubble -o" in lines[-1]
    found["repair"] = repaired(aside)
    lines = mcrim.shown("repair", campaign, "-o", "new.toml").splitlines()
    assert told in lines and "Nothing was added, and no file written." in lines
    usual, why = by.diagnosis("missing_effect"), "the readings do not determine scale"
    found["repair"] = replace(found["repair"], diagnosis=usual, undetermined=why)
    out = mcrim.shown("repair", campaign, "-o", "new.toml")
    assert f"With absorbing crystal surface, {why}: diagnose says" in out


@cases("count", "alternatives")
def test_what_is_alike_is_named(count, alternatives):
    leading = (by.CANDIDATES[0], by.CANDIDATES[1])
    names = [f"effect_{i}" for i in range(count)]
    alike = [replace(by.CANDIDATES[3], effect=name, effects=(name,)) for name in names]
    # in the order of the ranking
    first, second = (replace(c, mimics=tuple(names[::-1])) for c in leading)
    diagnosis = by.diagnosis("ambiguous", candidates=(first, second, *alike))
    assert sentences.mistakable(diagnosis) == (
        "By these readings absorbing crystal surface and air bubble in the gap could be mistaken "
        f"for each other and for {alternatives}."
    )


@pytest.mark.parametrize(
    ("probabilities", "told"),
    [
        (
            {by.FIRST: 0.736, by.SECOND: 0.2449, "none": 0.0, "unknown": 0.004},
            "absorbing crystal surface 74 %, air bubble in the gap 24 %, nothing missing 0 %, "
            "something that is in no catalogue 0.4 %, all else 1.6 %",
        ),
        (
            {by.PAIR.effect: 0.995, by.SECOND: 0.005, "none": 0.0, "others": 0.0},
            "absorbing crystal surface with air bubble in the gap 99.5 %, nothing missing 0 %, all "
            "else 0.5 %",
        ),
        (
            {by.FIRST: 0.335, by.SECOND: 0.335, "unknown": 0.33, "none": 0.0},
            "absorbing crystal surface 33 %, air bubble in the gap 34 %, something that is in no "
            "catalogue 33 %, nothing missing 0 %",
        ),
    ],
)
def test_the_probabilities_that_are_told_sum_to_all(probabilities, told):
    text = sentences.shares_text(replace(by.diagnosis("ambiguous"), probabilities=probabilities))
    assert text == f"Of 100 %: {told}."
    assert sum(map(float, re.findall(r"([0-9.]+) %(?!:)", text))) == pytest.approx(100.0)
    none = replace(by.diagnosis("too_few_readings"), probabilities={})
    assert sentences.shares_text(none) == ""


def test_what_to_measure_next_is_named_with_its_part_of_the_error():
    contributions = {"statistical": 0.1, "prior": 0.29, "detector_efficiency": 0.75}
    light = replace(by.estimate(7.5, 0.81), contributions=contributions)
    fit = by.calibration({"light_yield_ph_per_keV": light})
    assert sentences.next_for_fit(fit, ()) == (
        "What to measure next: the detector's efficiency: 10.0 of the light yield's 10.8 %, in "
        "quadrature. What helps: the detector's calibration against a standard, an emission "
        "spectrum of one's own."
    )
    known = replace(light, efficiency_contributions={"tube scale": 0.2, "emission spectrum": 0.1})
    fit = by.calibration({"light_yield_ph_per_keV": known})
    said = sentences.next_for_fit(fit, ["alpha_abs_per_cm"])
    assert "next: the absorption of the crystal: 3.9 of the light yield's 5.1 %, in" in said
    bound = by.estimate(7.5, 0.8, "max")
    assert sentences.next_for_fit(by.calibration({"light_yield_ph_per_keV": bound}), ()) == ""
    assert sentences.next_for_fit(by.calibration({}), ()) == ""
    # what no reading determines has the error that is plausible
    known = replace(light, contributions={"plausible": 0.75, "detector_efficiency": 0.3})
    said = sentences.next_for_fit(by.calibration({"light_yield_ph_per_keV": known}), ())
    assert "the size of what is missing: 10.0 of the light yield's 10.8 %" in said
    # which explanation is right may count for more than anything that they have in common
    found = by.diagnosis("ambiguous", light_yield_averaged=AveragedYield(7.5, 1.1, 0.2, 1.05, 0.3))
    said = sentences.next_for_average(found)
    assert "next: which explanation is right: 14.0 of the averaged light yield's 14.8 %, in" in said


CAMOO4 = read_scene(SCENES / "camoo4.xml")
COMMENTS = {name: known.comment for name, known in CAMOO4.defaults.items()}


@cases("parameters", "of_scene", "words")
def test_configurations_are_told_in_words(parameters, of_scene, words):
    assert configuration_words(parameters, COMMENTS if of_scene else {}) == words


def test_transmittances_are_shown_in_per_cent_and_on_a_scale_of_their_own():
    assert sentences.signal_text(True, 0.76, 0.012) == "(76.0 ± 1.2) %"
    assert sentences.signal_text(True, 0.751011743317966, 0.0) == "75.1 %"
    assert sentences.signal_text(False, 24.5, 0.4) == "24.5 ± 0.4"
    assert sentences.estimate_text(by.estimate(0.0, math.inf)) == "0, not determined"
    first, second, *others = by.rows()
    beam = replace(second, measured=0.76, sigma=0.01, model=0.7, kind="transmittance")
    found = replace(by.comparison(), rows=(first, beam, *others))
    assert sentences.beam_conflict(found) == [
        "the couplings and the beam pull apart: " + by.QUOTES + " was measured 3.3 standard errors "
        "below what all other readings predict, which ask for less to be lost in the crystal than "
        "the beam loses"
    ]
    drawing = draw_comparison(found)
    drawing.figure.draw_without_rendering()
    (of_beam,) = drawing.figure.axes[0].child_axes
    assert of_beam.get_ylabel() == "transmittance (%)"
    assert by.comparison().p_value is not None and sentences.beam_conflict(by.comparison()) == []


DRIFT = """from mcrim_mitsuba.effects import Effect, EffectParameter
size = EffectParameter(
    name="drift", meaning="Gain", minimum=0.5, maximum=2, start=1.1, absent=1.0,
    plausible=(0.9, 1.1), nodes=(),
)
act = lambda s, g: (g * s, g + 0 * s, s)
EFFECT = Effect("drift", "D", "...", "...", parameters=(size,), reading=act)
"""


def test_python_of_a_campaign_is_executed_when_its_user_says_so(
    mcrim, campaign, found, monkeypatch
):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(Path("settings").absolute()))
    Path("theirs").mkdir()
    Path("theirs/drift.py").write_text(DRIFT)
    path = Path(campaign)
    path.write_text('effects_folder = "theirs"\n' + path.read_text())
    # no terminal: nobody to ask
    refused = mcrim.refused("compare", campaign)
    assert f"{campaign}, line 1: the Python in theirs would be executed (drift.py)" in refused
    assert "--trust-effects" in refused
    mcrim.shown("compare", campaign, "--trust-effects")
    # the same process would know it now; other files it does not
    Path("theirs/drift.py").write_text(f"{DRIFT}\n# another\n")
    asked = []
    for stream in (sys.stdin, sys.stderr):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    monkeypatch.setattr(click, "confirm", lambda text, **_: bool(asked.append(text)))
    assert mcrim("compare", campaign)[0] == 2 and len(asked) == 1
    monkeypatch.setattr(click, "confirm", lambda text, **_: not asked.append(text))
    mcrim.shown("compare", campaign)
    mcrim.shown("compare", campaign)
    # asked once, and kept
    assert len(asked) == 2 and Path("settings/mcrim_mitsuba/trusted_effects.txt").is_file()


def test_an_effect_of_one_s_own_that_fails_when_it_acts_is_named_with_its_line(mcrim, campaign):
    Path("theirs").mkdir()
    Path("theirs/drift.py").write_text(DRIFT.replace("g + 0 * s", "h + 0 * s"))
    path = Path(campaign)
    names = 'effects = ["drift"]\neffects_folder = "theirs"'
    text = path.read_text().replace("effects = []", names)
    path.write_text(text + "[parameters.scale]\nstart = 1\nfixed = true\n")
    refused = mcrim.refused("calibrate", campaign, "--trust-effects")
    line = 1 + DRIFT.splitlines().index("act = lambda s, g: (g * s, g + 0 * s, s)")
    assert f"theirs/drift.py, line {line}: NameError: name 'h' is not defined; mend" in refused


def test_a_profile_that_is_no_parabola_is_said():
    values = np.linspace(0.0, 0.6, 61)
    rise = ((values - 0.3) / 0.03) ** 2
    slopes = 2 * (values - 0.3) / 0.03**2
    curve = {"values": values, "delta_chi2": rise, "slopes": slopes}
    even = Profile(name="even", value=0.3, sigma=0.03, **curve)
    assert sentences.shapes([even]) == []
    # a shelf below the best value
    shelf = np.where(values < 0.26, 2.0 + 100 * (0.26 - values) ** 2, rise)
    slopes = np.gradient(shelf, values)
    uneven = replace(even, name="bubble", delta_chi2=shelf, slopes=slopes)
    (said,) = sentences.shapes([even, uneven])
    assert said == (
        "bubble: the 95 % interval is 0.124 to 0.359, not 0.241 to 0.359 as 0.300 ± 0.030 would "
        "have it: chi2 does not rise like a parabola"
    )
    # a bound that is near cuts the interval off, and is said by the fit
    near = replace(even, values=values[28:], delta_chi2=rise[28:], slopes=even.slopes[28:])
    assert sentences.shapes([replace(near, ends=("min", None))]) == []


def test_repair_says_where_nothing_was_added(mcrim, campaign, found):
    found["repair"] = repaired(by.diagnosis("adequate", repair=by.STEPS[:1]))
    lines = mcrim.shown("repair", campaign, "-o", "new.toml").splitlines()
    assert "Nothing was added, and no file written." in lines
    # as a diagnosis goes on, which is not asked for once more
    assert lines[-1] == LAST_LINES["adequate"]


def test_figures_come_with_their_numbers(mcrim, campaign, found):
    names = ("compare", "diagnose", "repair", "repair_readings")
    for verb in names[:3]:
        output = ["-o", "new.toml"] if verb == "repair" else []
        status, out, _ = mcrim(verb, campaign, *output, "--figure", f"{verb}.png")
        assert status == 0 and f"drawn to {verb}.png" in out
    assert mcrim("compare", campaign, "--figure", "compare.PDF")[0] == 0
    assert Path("compare.PDF").read_bytes().startswith(b"%PDF")
    for name in names:
        assert Path(f"{name}.png").read_bytes().startswith(b"\x89PNG")
    tables = {n: list(csv.DictReader(open(f"{n}.csv"))) for n in names}
    first = tables["compare"][0]
    assert [row["label"] for row in tables["compare"]] == by.LABELS
    assert (first["pull"], first["suspect"], first["pull_after"]) == ("6", "bad_reading", "")
    assert float(tables["repair_readings"][0]["pull_after"]) == pytest.approx(1.8)
    ranked = tables["diagnose"]
    order = [by.FIRST, by.SECOND, "gap_absorption", by.OFF, "none"]
    assert [row["effect"] for row in ranked] == order
    assert [row["leading"] for row in ranked] == ["1", "0", "0", "0", "0"]
    assert (ranked[0]["value"], ranked[0]["mimics"]) == ("0.0123", by.SECOND)
    assert ranked[3]["value"] == ""
    # the last row is the mended campaign's: its effects simulated together
    steps = tables["repair"]
    assert [row["light_yield_ph_per_keV"] for row in steps] == ["8.31", "7.52"]
    assert [row["final_simulation"] for row in steps] == ["0", "1"]
    assert (steps[1]["chi2"], steps[1]["left_out_error"]) == ("12", "")


def test_labels_of_figures_do_not_overlap():
    figure = draw_comparison(
        by.comparison(suspects=(by.BAD, by.SWAPPED)),
        by.calibration(by.MENDED, 0.3),
        added="anisotropic_scattering, surface_absorption and scattering_gradient",
    ).figure
    lower = figure.axes[1]
    assert lower.get_xticklabels()[0].get_text().startswith("[bold red]gel")
    legends = [text for axes in figure.axes for text in axes.get_legend().get_texts()]
    assert overlap([*lower.get_xticklabels(), lower.xaxis.label, *legends], figure) == []
    name = "an_effect_of_my_own_with_a_very_long_name" * 2
    long = replace(by.CANDIDATES[3], effect=name, effects=(name,))
    many = {"candidates": (*by.CANDIDATES * 4, long), "pairs": (by.PAIR,) * 3}
    figure = draw_ranking(by.diagnosis("ambiguous", **many)).figure
    chances, _, words = figure.axes
    labels = [*chances.get_yticklabels(), *figure.legends[0].get_texts()]
    assert overlap([*labels, *chances.texts, *words.texts], figure) == []
    figure = draw_ranking(PAIRED, brief=True).entitled("A title that is far too long. " * 9).figure
    figure.draw_without_rendering()
    assert figure.bbox.width > title_of(figure).get_window_extent().x1
    steps = [replace(by.STEPS[1], step=i, added="anisotropic_scattering") for i in range(1, 5)]
    figure = draw_staircase([by.STEPS[0], *steps], by.calibration(by.MENDED, 0.3)).figure
    for axes in figure.axes[-2:]:
        assert overlap([*axes.texts, axes.title], figure) == []
    # names in lines, level; and no two of both panels touch
    labels = [label for axes in figure.axes[-2:] for label in axes.get_xticklabels()]
    assert overlap(labels, figure) == [] and not any(label.get_rotation() for label in labels)


def test_a_hopeless_effect_hides_no_other_and_what_has_no_name_has_a_row():
    hopeless = by.candidate((by.OFF,), -480.0, {})
    found = by.diagnosis(
        "ambiguous",
        candidates=(*by.CANDIDATES[:3], hopeless),
        probabilities={by.FIRST: 0.7, "unknown": 0.2, by.SECOND: 0.0995, "none": 0.0005},
    )
    drawing = draw_ranking(found)
    chances, gains, beside = drawing.figure.axes
    left, right = gains.get_xlim()
    assert 55 < right < 70 and -right < left <= 0
    assert [text.get_text() for text in gains.texts] == ["χ² rises by 480"]
    assert overlap([*gains.texts, *chances.texts, *beside.texts], drawing.figure) == []
    # the second likeliest; what is as good as impossible has none
    names = [label.get_text() for label in chances.get_yticklabels()]
    assert names[1] == "Something that is in no\ncatalogue" and len(names) == 5
    assert [one.get_text() for one in chances.texts] == ["70 %", "20 %", "10 %"]
    assert {row[0]: row[2] for row in drawing.rows}["unknown"] == 0.2
    assert {len(row) for row in drawing.rows} == {len(drawing.columns)}


@pytest.mark.parametrize("known", [True, False])
def test_columns_that_are_there_are_explained(known):
    """A campaign without [light_yield] was told what the column of light yields means."""
    made = by.CANDIDATES
    if not known:
        made = tuple(replace(of, light_yield_ph_per_keV=None) for of in made)
    found = by.diagnosis("adequate", candidates=made)
    legend, *_ = describe_campaign.explanation_pieces(found)
    assert ("light yield" in legend) == known


@pytest.mark.parametrize("brief", [True, False])
def test_titles_are_whole_and_within_their_figure(brief):
    title = "WEIGHT " * 30 + "END"
    figure = draw_ranking(by.diagnosis("missing_effect"), brief=brief).entitled(title).figure
    figure.draw_without_rendering()
    assert figure.bbox.width > title_of(figure).get_window_extent().x1
    assert figure.get_suptitle().replace("\n", " ").startswith(f"{title} Absorbing crystal")


def test_frames_hold_numbers():
    """Texts are for people: a data frame has values, errors and names with units."""
    tables = shown_of(by.diagnosis("adequate", pairs=(by.PAIR,))).tables
    numbers = (
        "probability log_evidence size size_sigma light_yield_ph_per_keV "
        "light_yield_ph_per_keV_sigma delta_chi2 delta_chi2_sigma p_value left_out_error"
    ).split()
    effects = tables["effects, each added alone"].frame()
    assert [name for name in effects if effects[name].dtype == float] == numbers
    words = "effect parameter plausibility title"
    assert " ".join(effects.columns.difference(numbers)) == words
    first, _, at_bound, switched = (row for _, row in effects.iterrows())
    assert (first["effect"], first["parameter"]) == (by.FIRST, "surface_loss")
    assert (first["size"], first["size_sigma"]) == (0.0123, 0.0008)
    # no error at a bound, no size without a parameter
    assert at_bound["size"] == 20 and math.isnan(at_bound["size_sigma"])
    assert math.isnan(switched["size"])
    pairs = tables["the best pairs of effects"].frame()
    assert list(pairs["parameter"]) == list(by.SIZES) and list(pairs["size"]) == [0.01, 0.1]
    limits = tables["what the readings allow, 95 % confidence"].frame().set_index("effect")
    assert limits.loc["gap_index", ["lower", "upper"]].tolist() == [-0.02, 0.031]
    assert bool(limits.loc[by.OFF, "excluded"])
    following = shown_of(by.diagnosis("ambiguous")).tables["what to measure next"].frame()
    gains = following.loc[0, ["hours", "light_yield_sigma", "probability"]]
    assert gains.tolist() == [1.0, 0.083, 0.94]
    steps = describe_campaign.steps_table(by.STEPS).frame()
    assert " ".join(steps.columns) == (
        "added chi2 ndf chi2_per_ndf p_value rms_pull left_out_error light_yield_ph_per_keV "
        "light_yield_ph_per_keV_sigma alpha_scat_per_cm alpha_scat_per_cm_sigma"
    )
    assert all(steps.drop(columns="added").dtypes.map(lambda each: each.kind in "if"))
    assert steps.loc[1, "added"] == by.FIRST and steps.loc[1, "alpha_scat_per_cm"] == 0.543


def test_what_matters_is_shown_and_the_rest_is_counted():
    effects = [name for name in by.TITLES if name != by.FIRST][:30]
    # what leads is shown wherever it stands
    many = (*(by.candidate((name,), 1.0, {}) for name in effects), by.CANDIDATES[0])
    limits = dict.fromkeys((*effects, by.FIRST), by.diagnosis("adequate").upper_limits[by.OFF])
    changed = {"candidates": many, "upper_limits": limits, "probabilities": {"none": 1.0}}
    shown = shown_of(by.diagnosis("missing_effect", **changed))
    text = description.text(shown, 100)
    (more,) = {line for line in text.split("\n") if line.startswith("and ")}
    assert more.startswith("and 18 more, less likely than these: the file of --json has all 31")
    assert text.count("and 18 more") == 2
    for name in ("effects, each added alone", "what the readings allow, 95 % confidence"):
        assert len(shown.tables[name].frame()) == 31 and len(shown.tables[name].seen.rows) == 13
    # where a table goes on, its words have the room that is there
    on = text.partition("each added alone, continued")[2].partition("└")[0]
    for name in (effects[3], by.FIRST):
        assert sentences.capital(by.TITLES[name]) in on and name in on


def test_a_tiny_p_value_is_below_and_equals_nothing():
    assert p_equals(0.0) == "p < 1e-99" and p_equals(0.0123) == "p = 0.012"
    assert p_equals(None) == "no p-value"
    never = by.comparison(p_value=0.0)
    of_never = by.diagnosis("unexplained", baseline=never)
    told = [
        sentences.quality(never),
        describe_campaign.step_text(replace(by.STEPS[0], p_value=0.0)),
        draw_ranking(of_never).figure.get_suptitle(),
        sentences.reliability(of_never, replace(by.calibration(), p_value=0.0), ()),
        sentences.suspicion(replace(by.BAD, p_value=0.0)),
    ]
    assert not [text for text in told if "= <" in text]


def test_bounds_may_keep_a_fit_of_all_parameters_from_its_readings():
    """Two swapped readings, chi2 = 872, were a light yield without a word."""
    cases = ((872.0, "does not describe the readings", True), (0.4, "nothing about", False))
    for chi2, says, doubt in cases:
        comparison = replace(by.comparison(p_value=None), chi2=chi2)
        assert says in sentences.quality(comparison) and sentences.fails(comparison) == doubt


def side_by_side() -> SideBySide:
    """Three hypotheses with the longest names and figures that there are."""
    contributions = {"statistical": 0.123, "detector_efficiency": 0.322}
    sizes = {
        "bottom_roughness_alpha": by.estimate(0.0123, 0.0008),
        "alpha_scat_per_cm": by.estimate(0.54321, 0.02012),
        "light_yield_ph_per_keV": replace(by.estimate(7.812, 0.345), contributions=contributions),
    }
    hypotheses = tuple(
        FittedHypothesis(
            name,
            Path("a campaign.toml"),
            ("anisotropic_scattering", "scattering_gradient"),
            *(1234.5, 13, 1.2e-10, 2.61, -123.4 * place, 1.7 * place, 0.3),
            sizes if place else by.FITTED,
            by.rows(1.0 - 0.4 * place),
        )
        for place, name in enumerate(NAMES)
    )
    apart = {row.label: 0.8 * abs(row.pull) for row in by.rows()}
    return SideBySide("preferred", "as A shows", ("A",), hypotheses, apart)


@pytest.mark.parametrize("width", [80, 100, 140])
def test_hypotheses_fit_a_terminal_and_their_figure(width):
    scenes = dict.fromkeys(NAMES, "hash")
    compared = HypothesesResult.of(side_by_side(), NO_CAMPAIGN, by.PROVENANCE, scenes=scenes)
    shown = compared.description
    lines = description.text(shown, width).splitlines()
    tables = [line for line in lines if line[:1] in "┏┃┡│└"]
    assert max(map(len, tables)) <= width
    whole = "\n".join(tables)
    for table in (shown.tables[title] for title in ("hypotheses", "sizes")):
        assert all(cell.text in whole for row in table.rows for cell in row.cells)
    for table in (shown.tables["pulls"], shown.tables["predictions"]):
        assert all(cell.text in whole for row in table.rows for cell in row.cells[1:])
    assert row_of(whole, "bottom roughness alpha")[1] == ""
    most = f"{by.MARKUP}: 18.80, 19.28 and 19.76 where 20.00 ± 0.20 was measured"
    assert f"They differ most at {most}" in " ".join(lines)
    figure = draw_hypotheses(side_by_side()).figure
    legends = [text for axes in figure.axes for text in axes.get_legend().get_texts()]
    assert overlap([*figure.axes[1].get_xticklabels(), *legends], figure) == []


def test_figures_of_little_can_be_drawn():
    draw_ranking(by.diagnosis("too_few_readings", candidates=())).figure.draw_without_rendering()
    hopeless = replace(by.STEPS[0], p_value=None, ndf=0, left_out_error=math.inf, parameters={})
    draw_staircase([hopeless]).figure.draw_without_rendering()
    draw_staircase([replace(by.STEPS[0], p_value=0.0)]).figure.draw_without_rendering()


def test_help_gives_the_photons_that_are_spent():
    assert PHOTONS.startswith(f"up to {EFFECT_PHOTONS / 1e5:.1f}e5 of each")
    assert f"get {['four', 'five', 'six'][PLAIN_FACTOR - 4]} times" in FURTHER_PHOTONS
