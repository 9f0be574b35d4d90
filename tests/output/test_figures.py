"""Profiles, the error budget, histograms and their figures: what is drawn is what was computed."""

import csv
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import findings_by_hand as by
import numpy as np
import pytest
from formula_surfaces import couplings
from matplotlib.figure import Figure
from places import CAMPAIGN_FILES
from trials.surface_model import CampaignModel

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.inference import simulations as campaigns
from mcrim_mitsuba.inference.compare import Comparison, Suspect
from mcrim_mitsuba.inference.diagnose import RepairStep
from mcrim_mitsuba.inference.estimates import FittedRow
from mcrim_mitsuba.inference.fit import fit_model
from mcrim_mitsuba.inference.profiles import Profile
from mcrim_mitsuba.laboratory.histogram import Histogram
from mcrim_mitsuba.laboratory.peak import fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum
from mcrim_mitsuba.output import budget_figures as budget
from mcrim_mitsuba.output import describe_campaign as describe
from mcrim_mitsuba.output import diagnosis_figures as staircase
from mcrim_mitsuba.output import figure_style
from mcrim_mitsuba.output import fit_figures as comparison
from mcrim_mitsuba.output import fit_figures as profiles
from mcrim_mitsuba.output import laboratory_figures as histograms
from mcrim_mitsuba.output.sentences import shares_text

HOSTILE = (
    "a label that goes on and on, with n_gap = 1.46 and an aperture of 7 mm " * 3,
    "$x$ and $\\frac{1}{",
    "<b>bold</b> & [red]",
    "مرحبا بالعالم",
    "x" * 10_000,
    "two\nlines",
    "",
)


def test_no_two_readings_have_the_same_short_name():
    """What all share is left out before anything is elided, and numbers come where that fails."""
    bench = "CaMoO4 cube of April, polished"
    names = [f"{bench}, {gap} gap, mounting {m} of 4" for gap in ("air", "gel") for m in (1, 12)]
    short = figure_style.shortened_apart(names, 24)
    assert short == ["air gap, mounting 1", "air gap, mounting 12", *short[2:]]
    assert figure_style.shortened_apart(["air", "wrapped 10 (1275)"], 22)[1] == "wrapped 10 (1275)"
    alike = [f"wrapped {place} (1275)" for place in (10, 12, 15)]
    for names in (alike, ["x" * 60 + middle + "y" * 60 for middle in "ab"], HOSTILE, [bench, ""]):
        for most in (11, 22, 34):
            short = figure_style.shortened_apart(names, most)
            assert len(set(short)) == len(names) and max(map(len, short)) <= most, short


def fitted(scenes, tmp_path, change=lambda text: text, sigma=0.003):
    """The article's campaign with its text changed: its model and its fit."""
    for name in CAMPAIGN_FILES:
        text = (scenes / name).read_text()
        (tmp_path / name).write_text(change(text) if name.endswith(".toml") else text)
    model = CampaignModel(read_campaign(tmp_path / CAMPAIGN_FILES[0]), couplings(sigma))
    return model, fit_model(model)


def test_a_quadratic_statistic_has_a_parabola(scenes, tmp_path):
    # with both coefficients held, predictions are linear in the scale
    def hold(text):
        return text.split("[parameters")[0] + "[light_yield]" + text.split("[light_yield]")[1]

    _, found = fitted(scenes, tmp_path, hold)
    scale, light = found.profiles
    assert (scale.name, light.name) == ("scale", "light_yield_ph_per_keV")
    parabola = ((scale.values - scale.value) / scale.sigma) ** 2
    assert scale.delta_chi2 == pytest.approx(parabola, abs=1e-4)
    assert scale.delta_chi2[[0, -1]] == pytest.approx(9, rel=0.01)
    for rise, away in ((1, 1), (4, 2)):
        low, high = scale.crossings(rise)
        assert (scale.value - low, high - scale.value) == pytest.approx(
            (away * scale.sigma, away * scale.sigma), rel=1e-4
        )
    # the efficiency's error, 10 %, adds to the scale's
    assert light.sigma == pytest.approx(found.parameters[light.name].sigma, rel=1e-6)
    low, high = light.crossings(1)
    assert (high - low) / 2 == pytest.approx(light.sigma, rel=0.01)


def test_profiles_cross_where_the_intervals_end(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    for profile in found.profiles:
        known = found.parameters[profile.name]
        # a lopsided one, followed by MINOS: 1e-3 of an error
        off = 0.05 if profile.name == "light_yield_ph_per_keV" else 1e-3
        for end, expected in zip(profile.crossings(1), (known.lower, known.upper), strict=True):
            assert end == pytest.approx(expected, abs=off * known.sigma), profile.name
        rising = np.sign(profile.values - profile.value) * np.gradient(profile.delta_chi2)
        assert np.all(rising >= -1e-6)


def test_a_profile_ends_at_its_bound(scenes, tmp_path):
    _, found = fitted(
        scenes,
        tmp_path,
        lambda text: text.replace("max = 10.0", "max = 0.3").replace("start = 0.5", "start = 0.2"),
    )
    profile = found.profiles[0]
    known = found.parameters[ALPHA_SCAT]
    assert known.at_bound == "max" and profile.ends == (None, "max")
    assert profile.values[-1] == 0.3 and profile.crossings(1)[1] is None
    # no parabola: the statistic has a slope at the bound
    assert profile.crossings(1)[0] == pytest.approx(known.lower, abs=1e-3 * (0.3 - known.lower))
    profiles.draw_profiles([profile]).figure.draw_without_rendering()
    budget.draw_budget(found).figure.draw_without_rendering()
    assert {row[0] for row in budget.draw_budget(found).rows}.isdisjoint({ALPHA_SCAT})


def test_the_budget_adds_up_to_the_error(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    for name, known in found.parameters.items():
        parts = budget.contributions(known)
        origins = [origin for origin, _, _ in parts]
        single = [s for origin, _, s in parts if origin not in ("systematic, together", "total")]
        assert math.hypot(*single) == pytest.approx(known.sigma, rel=1e-6), name
        assert origins[-1] == "total" and parts[-1][2] == known.sigma
        if "systematic, together" in origins:
            systematic = [s for _, kind, s in parts[:-2] if kind == "systematic"]
            assert parts[-2][2] == pytest.approx(math.hypot(*systematic))
    light = next(r for r in budget.draw_budget(found).rows if r[2] == "detector efficiency")
    assert light[0] == "light_yield_ph_per_keV" and light[5] == pytest.approx(10)


def test_numbers_are_what_is_drawn(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    made = found.profiles
    for drawing in (profiles.draw_profiles(made), budget.draw_budget(found)):
        figure, table = drawing.save(tmp_path / "figure.pdf")
        assert figure.read_bytes().startswith(b"%PDF") and b"/Type3" not in figure.read_bytes()
        columns, *rows = list(csv.reader(table.open()))
        assert columns == list(drawing.columns) and len(rows) > 8
    curve = profiles.draw_profiles(made).figure.axes[1].lines[0]
    assert curve.get_xdata()[[0, -1]] == pytest.approx(made[0].values[[0, -1]])
    assert np.interp(made[0].values, *curve.get_data()) == pytest.approx(
        made[0].delta_chi2, abs=0.01
    )
    bars = budget.draw_budget(found).figure.axes[0].patches
    drawn = [bar.get_width() for bar in bars]
    rows = [r for r in budget.draw_budget(found).rows if r[0] == "light_yield_ph_per_keV"]
    assert drawn == pytest.approx([row[5] for row in rows])


def test_calibrate_refuses_places_of_its_three_figures(scenes, here, monkeypatch, mcrim):
    _, found = fitted(scenes, here)
    monkeypatch.setattr(campaigns, "calibrate", lambda _: found)
    before = {path: path.read_bytes() for path in here.iterdir()}
    drawn = ["calibrate", "camoo4_campaign.toml", "--figure"]
    for place, says in (
        ("x.jpg", "end in .png or .pdf"),
        ("no/x.png", "does not exist"),
        ("camoo4_measured.png", "would replace what this command reads"),
    ):
        assert says in mcrim.refused(*drawn, place)
    Path("taken_profiles.png").mkdir()
    assert "the second picture of --figure names a folder" in mcrim.refused(*drawn, "taken.png")
    Path("taken_profiles.png").rmdir()
    assert {path: path.read_bytes() for path in here.iterdir()} == before


def rows(labels):
    return tuple(
        FittedRow(label, 10.0 + i, 0.2, 10.1, 0.01, 0.5, 0.3, 0.001, i != 1)
        for i, label in enumerate(labels)
    )


def suspicious(found, label):
    """A comparison that thinks a reading bad."""
    suspect = Suspect("bad_reading", (label,), 9.0, 0.01, 1.0, 3, 0.5, 4.0, True)
    return Comparison(
        **vars(replace(found, chi2=1.0, ndf=3, p_value=0.5)),
        expected_chi2=(1, 5),
        rms_pull=1.0,
        left_out_error=1.0,
        left_out_pulls={},
        suspects=(suspect,),
        trends=(),
        absorbed=(),
    )


def test_hostile_labels_break_no_figure(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    hostile = replace(
        found,
        rows=rows(HOSTILE),
        parameters={**found.parameters, **dict.fromkeys(HOSTILE, found.parameters["scale"])},
    )
    compared = suspicious(hostile, HOSTILE[0])
    steps = [
        RepairStep(i, name, HOSTILE[:i], 9.0, 3, 0.1, 1.0, 1.0, 0.0, found.parameters, None)
        for i, name in enumerate((None, *HOSTILE))
    ]
    one = found.profiles[0]
    curves = [replace(one, name=name) for name in HOSTILE]
    spectrum = PhotonSpectrum(14.3)
    histogram = Histogram(Path("air"), (), spectrum.photons(), spectrum.sample(1))
    peak = fit_peak(histogram.photons, histogram.counts)
    named = [histograms.FittedHistogram(name, histogram, peak, name[:1]) for name in HOSTILE]
    for i, figure in enumerate(
        [
            comparison.draw_comparison(compared).figure,
            comparison.draw_comparison(compared, hostile, added=HOSTILE[1]).figure,
            comparison.draw_comparison(hostile, unit=HOSTILE[1]).entitled(HOSTILE[0]).figure,
            staircase.draw_staircase(steps, hostile).figure,
            profiles.draw_profiles(curves).figure,
            budget.draw_budget(hostile).figure,
            histograms.draw_histograms(named, title=HOSTILE[1]).figure,
        ]
    ):
        assert isinstance(figure, Figure)
        width, height = figure.get_size_inches()
        assert width < 30 and height < 40
        if i in (1, 3):
            assert figure_style.save(figure, tmp_path / f"{i}.pdf").stat().st_size > 5000
        else:
            figure.draw_without_rendering()
    # the CSV has the labels whole
    table = comparison.draw_comparison(compared).save(tmp_path / "whole.png")[1]
    assert [row["label"] for row in csv.DictReader(table.open(newline=""))] == list(HOSTILE)


def test_currents_have_their_power_of_ten_at_every_number(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    small = [replace(row, measured=1e-9, sigma=1e-11, model=2e-9) for row in rows(["air", "gel"])]
    axes = comparison.draw_comparison(replace(found, rows=tuple(small)), unit="A").figure.axes[0]
    axes.figure.draw_without_rendering()
    assert not axes.yaxis.get_offset_text().get_text()
    ticks = [label.get_text().replace("−", "-") for label in axes.get_yticklabels()]
    assert len(ticks) > 2 and [float(tick) for tick in ticks] == pytest.approx(axes.get_yticks())


def test_texts_over_the_stairs_stay_below_the_title(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    for chi2 in ((226.0, 186.0), (430.0, 186.0), (100.0, 90.0)):
        steps = [
            RepairStep(i, "x" * i, (), of, 197, 0.1, 1.0, 1.0, 0.0, found.parameters, None)
            for i, of in enumerate(chi2)
        ]
        figure = staircase.draw_staircase(steps).figure
        figure.draw_without_rendering()
        for axes in figure.axes:
            tops = [text.get_window_extent().y1 for text in axes.texts]
            assert max(tops) < axes.get_window_extent().y1, chi2


def test_a_suspicion_is_history_after_the_repair(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    found = replace(found, rows=rows(["air", "gel"]))
    compared = suspicious(found, "gel")

    def legend(*arguments):
        axes = comparison.draw_comparison(*arguments).figure.axes[0]
        return [text.get_text() for text in axes.get_legend().get_texts()]

    assert "suspected bad reading" in legend(compared)
    assert not [words for words in legend(compared, found) if "suspected" in words]


def test_figures_carry_title_and_unit(scenes, tmp_path):
    _, found = fitted(scenes, tmp_path)
    readings = comparison.draw_comparison(found, unit="electrons").entitled("air and gel").figure
    assert readings.get_suptitle() == "air and gel"
    assert readings.axes[0].get_ylabel() == "signal\n(electrons)"
    # over what a figure says there itself
    ranking = staircase.draw_ranking(by.diagnosis("missing_effect"))
    own = ranking.figure.get_suptitle()
    assert own.startswith("Absorbing crystal surface ")
    entitled = ranking.entitled("air and gel").figure.get_suptitle()
    assert entitled == f"air and gel\n{own}"


def test_nothing_to_draw_is_said(scenes, tmp_path):
    def hold_all(text):
        return (
            text.replace("prior = 0.039\nprior_sigma = 0.012", "fixed = true").replace(
                "min = 0.001\nmax = 10.0", "fixed = true"
            )
            + "\n[parameters.scale]\nstart = 57.0\nfixed = true\n"
        )

    _, found = fitted(scenes, tmp_path, hold_all)
    assert found.profiles == ()
    for figure in (profiles.draw_profiles(()).figure, budget.draw_budget(found).figure):
        figure.draw_without_rendering()
        assert "nothing was fitted" in figure.texts[0].get_text()
    flat = Histogram(Path("flat"), (), np.arange(20.0), np.full(20, 5.0))
    figure = histograms.draw_histograms([histograms.FittedHistogram("flat", flat, None)]).figure
    assert "no peak stands out" in figure.axes[0].get_legend().get_texts()[0].get_text()


def test_few_rows_and_few_steps_are_drawn_clearly():
    """Some fifty rows, six panels for two steps and dots in empty frames could not be read.

    Nor could a ranking of 3,300 pixels on a page.
    """
    many = [replace(by.CANDIDATES[2], effect=f"e{i}", delta_chi2=-900.0) for i in range(30)]
    probabilities = {by.FIRST: 0.7, "e4": 0.1, "understated errors": 0.01, "none": 0.01}
    changed = {"candidates": (by.CANDIDATES[0], *many), "probabilities": probabilities}
    figure = staircase.draw_ranking(by.diagnosis("missing_effect", **changed)).figure
    chances, bars, _ = figure.axes
    assert figure.get_figwidth() < 12.0
    names = [tick.get_text() for tick in chances.get_yticklabels()]
    assert len(names) == 9 and names[-1] == "and 25 others, none likelier"
    # what falls far behind has no bar that is cut off
    assert min(bar.get_x() + bar.get_width() for bar in bars.patches) >= 0.0
    assert sum("rises by 900" in text.get_text() for text in bars.texts) == 5
    fit = by.calibration(by.MENDED, 0.1, chi2=11.7)
    drawing = staircase.draw_staircase(by.STEPS, fit)
    assert [axes.get_title(loc="left")[:11] for axes in drawing.figure.axes] == [
        "χ² per degr",
        "light yield",
    ]
    assert len(drawing.rows) == 2
    alone = staircase.draw_staircase(by.STEPS[:1]).figure
    assert not alone.axes and "nothing was added" in alone.texts[0].get_text()


def test_rows_and_bars_are_in_the_order_of_their_probabilities():
    """Bars of 39, 3, 3, 3, 8 and 6 % stood in the order of another number."""
    likely = {by.SECOND: 0.6, "unknown": 0.2, "gap_absorption": 0.15, by.FIRST: 0.05}
    found = by.diagnosis("ambiguous", probabilities=likely)
    axes = staircase.draw_ranking(found).figure.axes[0]
    assert [text.get_text() for text in axes.texts] == ["60 %", "20 %", "15 %", "5 %"]
    alone, _ = describe.explanation_tables(found)
    ids = [by.SECOND, "gap_absorption", by.FIRST, by.OFF]
    assert [row.cells[-1].value for row in alone.rows] == ids


def test_error_bars_now_and_after_the_next_reading():
    drawing = staircase.draw_next(by.diagnosis("ambiguous"))
    (now, after) = drawing.rows
    assert now[1:3] == (7.7, 0.86) and after[2:] == pytest.approx((7.7 * 0.083, 7.7 * 0.105))
    assert {"± 11.2 %", "± 8.3 %"} == {t.get_text().strip() for t in drawing.figure.axes[0].texts}
    assert not staircase.draw_next(by.diagnosis("adequate")).rows


def test_an_effect_with_something_unknown_has_its_probability():
    """Where nothing else was likely the ranking's bars were all empty."""
    likely = {f"{by.FIRST} + unknown": 0.99, f"{by.FIRST} + {by.SECOND}": 0.01, "none": 0.0}
    found = by.diagnosis("missing_effect", probabilities=likely)
    assert f"{by.TITLES[by.FIRST]} with something that is in no catalogue 99 %" in shares_text(
        found
    )
    singles, rest = staircase._rows(found)
    assert not any(row.probability for row in singles)
    ((name, p),) = [(row.name, row.probability) for row in rest]
    assert p == 0.99 and "no catalogue" in name.replace("\n", " ")


def test_profile_crossings_are_none_where_the_curve_ends():
    values = np.array([1.0, 2.0, 3.0])
    profile = Profile(
        name="x",
        values=values,
        delta_chi2=(values - 2) ** 2 * 4,
        slopes=8 * (values - 2),
        value=2.0,
        sigma=0.5,
        ends=("min", None),
    )
    assert profile.crossings(1) == pytest.approx((1.5, 2.5))
    assert profile.crossings(5) == (None, None)


def test_a_useless_set_of_couplings_squeezes_no_other():
    """Errors of 6 to 15 % lay on each other below a pair that leaves 112 %; a label lay on them."""
    plans = [
        SimpleNamespace(
            configurations=couplings,
            mountings=8,
            events=events,
            hours=1.0,
            light_yield=SimpleNamespace(
                statistical=error / 2, systematic=error / 2, total=error, of_plan=error
            ),
            alpha_scat=None,
        )
        for couplings, error in (((0, 1), 0.065), ((0, 2), 0.14), ((1, 2), 1.12))
        for events in (1e3, 1e4)
    ]
    named = {"cheapest": plans[0], "cheapest_statistical": None, "wanted": 0.07, "name": str}
    drawing = budget.draw_plan(SimpleNamespace(plans=plans, number=str, is_numbered=False, **named))
    _, total = drawing.figure.axes
    assert total.get_ylim()[1] < 20 and not total.texts
    assert "not drawn: 1 set with errors above 21 %" in drawing.figure.get_suptitle()
    (legend,) = drawing.figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["(0, 1)", "(0, 2)", "wanted: 7.0 %"]
    assert len(drawing.rows) == len(plans)  # the numbers have all
    # what sets are told by, where their names would be long
    parts = [SimpleNamespace(name=name) for name in ("air, wrapped", "grease, wrapped", "bare")]
    numbered = SimpleNamespace(plans=plans, number=str, is_numbered=True, candidates=parts, **named)
    (legend,) = budget.draw_plan(numbered).figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[-3:] == ["1: air, wrapped", "2: grease, wrapped", "3: bare"]
