"""Commands as users type them: numbers, JSON, exit status and one line for wrong input."""

import _ctypes
import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import BashComplete
from places import SCENES, cases_of, mitsuba_alone, tables_of

from mcrim_mitsuba import simulate
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.cli.main import mcrim as command_line
from mcrim_mitsuba.core.numbers import said
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference import simulations as campaigns
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.transport.launch_plan import LANES

cases = cases_of(__file__)

BENCH = str(SCENES / "camoo4.xml")


def test_table_agrees_with_the_solution_without_photons(mcrim, tmp_path):
    path = tmp_path / "T.csv"
    line = "--alpha-scat 0,0.02,0.54,6 --alpha-abs 0.014:0.072:2 --n-gap 1,1.46 --photons 4e5"
    mcrim.shown("table", BENCH, *line.split(), "-o", path)
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm", "eta", "eta_sigma"]
    assert len(rows) == 16
    for row in rows:
        changed = [f"{k}={row[k]}" for k in ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm")]
        options = [part for pair in changed for part in ("-D", pair)]
        own = mcrim.json("simulate", BENCH, *options, "--method", "modes")
        assert abs(float(row["eta"]) - own["eta"]) < 4 * float(row["eta_sigma"]), row


def test_a_table_keeps_the_scenes_values_where_no_list_is_given(mcrim, tmp_path):
    path = tmp_path / "T.csv"
    mcrim.shown("table", BENCH, "--alpha-scat", "0,2;0,5", "--method", "modes", "-o", path)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    assert rows[0] == ["alpha_scat_per_cm", "eta", "eta_sigma"]
    assert [row[0] for row in rows[1:]] == ["0.2", "0.5"]
    own = mcrim.json("simulate", BENCH, "-D", "alpha_scat_per_cm=0.2", "--method", "modes")
    assert float(rows[1][1]) == pytest.approx(own["eta"], rel=1e-6)
    assert "give --n-gap, --alpha-abs, --alpha-scat" in mcrim.refused("table", BENCH)


def test_a_table_is_drawn_where_that_tells_something(mcrim, here):
    line = ["table", BENCH, "--method", "modes", "--alpha-scat", "0.1:1:20", "--figure", "t.png"]
    assert "drawn to t.png and t.csv" in mcrim.shown(*line)
    assert Path("t.csv").read_text().startswith("alpha_scat_per_cm,eta,eta_sigma\n")
    # the table has the figure's numbers, to more digits
    Path("t.png").unlink()
    short = [*line[:4], "--alpha-scat", "0.1,1", *line[-2:], "-o", "t.csv"]
    assert "2 points written to t.csv" in mcrim.shown(*short) and Path("t.png").exists()
    assert len(Path("t.csv").read_text().splitlines()[1].split(",")[1]) == len("0.25213000")
    assert "lines would tell nothing" in mcrim.refused(*line, "--alpha-abs", "0:1:20")


def test_a_comma_that_may_be_a_decimal_one_is_told_or_refused(mcrim):
    line = ["table", BENCH, "--method", "modes", "--alpha-scat"]
    said = mcrim.shown(*line, "0,5")
    assert "--alpha-scat = 0,5 is two values, 0 and 5; for one write 0.5" in said
    assert "two values" not in mcrim.shown(*line, "0.1,0.5")
    assert "write 1.0 for one, 1;0 for two" in mcrim.refused(*line[:2], "--n-gap", "1,0")


def test_fates_and_changed_parameters_are_told_in_words(mcrim, here):
    shown = mcrim.shown("simulate", BENCH, "--method", "modes")
    assert "absorbed in the crystal" in shown and "absorbed_" not in shown
    found = simulate(BENCH, method="modes")
    frame = found.to_dataframe()
    assert "absorbed_crystal" in set(frame["fate"]) and list(frame)[1:] == [
        "fraction",
        "fraction_sigma",
    ]
    assert (
        said("gap_mm", 0.02) == "gap 0.02 mm" and said("polarization", False) == "polarization off"
    )


def test_a_spectrum_says_what_one_wavelength_is(mcrim, here):
    Path("light.csv").write_text("wavelength_nm,emission (photons/nm)\n500,1\n540,2\n580,1\n")
    line = ["simulate", BENCH, "--photons", "2e4"]
    label = "at the scene's own values, of one wavelength:"
    assert label in mcrim.shown(*line, "--spectrum", "light.csv")
    assert label not in mcrim.shown(*line)


def test_a_file_of_another_kind_and_a_slip_in_a_verb_are_told(mcrim, campaign_here):
    table = mcrim.refused("calibrate", "camoo4_measured.csv")
    assert 'this is a table, not a campaign; name a campaign (.toml) with measurements = "' in table
    assert "this is a campaign, not a scene" in mcrim.refused("simulate", campaign_here)
    assert "this is a table, not a scene" in mcrim.refused("check", "camoo4_measured.csv")
    assert mcrim.refused("simulat", BENCH) == (
        "mcrim: No such command 'simulat'. Did you mean 'simulate'? See `mcrim --help`\n"
    )
    below = mcrim.refused("lab", "absorption", "-0.1")
    assert "No such option '-0': write -- before a number below 0" in below


def test_check_says_what_is_installed(mcrim):
    out = mcrim.shown("check")
    for words in ("mitsuba", "llvm library", "variants", "threads"):
        assert words in out


def test_no_more_threads_are_used_than_there_are_processors(mcrim, monkeypatch):
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    processors = len(os.sched_getaffinity(0))
    status, out, err = mcrim("check", "--threads", processors + 1, "--json", "-")
    assert status == 0 and json.loads(out)["installation"]["threads"] == str(processors)
    assert err.startswith(f"note: --threads {processors + 1}: of {processors} processor")
    assert not mcrim("check", "--threads", processors, "--json", "-").err


@pytest.mark.parametrize(
    ("library", "words"),
    [
        ("/nowhere/libLLVM.so", ("no such file", "DRJIT_LIBLLVM_PATH")),
        (__file__, ("not a shared library", "DRJIT_LIBLLVM_PATH")),
        # LLVM 16 learned to tell its version; a library that cannot is older, and would abort:
        # any library without LLVMGetVersion stands for it
        (_ctypes.__file__, ("too old",)),
    ],
    ids=["gone", "text", "old"],
)
def test_an_unusable_llvm_is_refused_before_dr_jit_sees_it(library, words):
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": library}
    done = subprocess.run(
        [sys.executable, "-m", "mcrim_mitsuba", "check"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in words)


@mitsuba_alone
def test_mitsuba_imported_first_is_said_not_suffered():
    """Dr.Jit has opened an LLVM by then: a good one is used, a bad one refused, nothing aborts."""
    code = (
        "import mitsuba; from mcrim_mitsuba.cli.main import main; raise SystemExit(main(['check']))"
    )
    environment = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode in (0, 2), done.stderr
    assert done.returncode == 0 or "call mcrim_mitsuba.use_variant() before mitsuba" in done.stderr


LISTS = ["--alpha-scat", "0.5", "--alpha-abs", "0.039", "--n-gap", "1"]
TABLES = tables_of(__file__)
#: What a verb reads, beside its own options; reports, pictures and diagnoses need no work to refuse.
READS = TABLES["reads"]
DIAGNOSES = ("compare", "diagnose", "repair")
FOR_ALL = TABLES["for_all"]
LINK = (["--json", "link.json"], "would replace what")
FIGURES = TABLES["figures"]
OWN = TABLES["own"]


@pytest.mark.parametrize("verb", READS)
def test_impossible_outputs_are_refused_before_any_work(mcrim, monkeypatch, campaign_here, verb):
    def worked(*_, **__):
        raise AssertionError("work was done before the outputs were checked")

    for place in (
        "transport.simulation.Simulation efficiency.table.eta_table inference.repair.repair "
        "inference.simulations.calibrate inference.compare.comparison_of "
        "reference.crosscheck.crosscheck inference.diagnose.diagnose "
        "transport.simulation.check_scene article.reproduce.reproduce_article"
    ).split():
        monkeypatch.setattr(f"mcrim_mitsuba.{place}", worked)
    Path("here.xml").write_text("somebody's work")
    of_campaign = "camoo4_campaign.toml" in READS[verb]
    Path("link.json").symlink_to("camoo4_measured.csv" if of_campaign else "camoo4.xml")
    cases = [*FOR_ALL, *OWN.get(verb, [])]
    cases += [LINK] if READS[verb] else []
    cases += FIGURES if verb in DIAGNOSES else []
    before = {path: path.read_bytes() for path in Path().iterdir()}
    for options, words in cases:
        # an option is given once
        usual = READS[verb][: 1 if not options or options[0] in READS[verb] else None]
        typed = [*usual, *options]
        assert words in mcrim.refused(verb, *typed), options
    if verb in DIAGNOSES:
        assert "no such file" in mcrim.refused(verb, "nothing.toml", *READS[verb][1:])
    assert {path: path.read_bytes() for path in before} == before


def test_standard_output_and_nowhere_are_good_places(mcrim, tmp_path):
    table = ["table", BENCH, *LISTS, "--photons", "1e4"]
    out = mcrim.shown(*table, "-o", "-", "--json", "/dev/null")
    assert out.startswith("n_gap,alpha_abs_per_cm") and out.count("\n") == 2
    out = mcrim.shown(*table, "-o", "/dev/null", "--json", "/dev/stdout")
    assert len(json.loads(out)["rows"]) == 1
    assert Path("/dev/stdout").is_symlink() and Path("/dev/null").is_char_device()


def test_notes_and_what_was_spent_are_seen_beside_a_table_on_standard_output(mcrim):
    hard = ["--photons", "1e4", "--precision", "0.01%"]
    status, out, err = mcrim("table", BENCH, *LISTS, *hard, "-o", "-")
    assert status == 0 and out.startswith("n_gap,") and out.count("\n") == 2
    spent, note = err.splitlines()
    assert "16,384 photons (0 of the cache)" in spent
    assert note.startswith("note: the wanted precision of 0.01 % was not reached")


def test_what_a_table_is_asked_twice_is_simulated_once(mcrim):
    def table(absorption, couplings):
        line = f"--alpha-scat 0.5 --alpha-abs {absorption} --n-gap {couplings} --photons 2e4"
        return mcrim.json("table", BENCH, *line.split())

    once, again = table("100,0.039", "1.46,1"), table("100,0.039,100", "1.46,1,1.46")
    gel, air = once["rows"][:2], once["rows"][2:]
    assert again["rows"] == [*gel, gel[0], *air, air[0], *gel, gel[0]]
    assert [again[name] for name in ("photons", "notes")] == [once["photons"], once["notes"]]


def test_a_parameter_at_its_bound_gets_no_error(mcrim, monkeypatch, tmp_path):
    """Its sigma knows nothing of the bound, and is several times the interval."""
    campaign = tmp_path / "c.toml"
    text = (SCENES / "camoo4_campaign.toml").read_text()
    for old, new in (
        ("start = 0.5", "start = 0.2"),
        ("max = 10.0", "max = 0.3"),
        ('= "camoo4', f'= "{SCENES}/camoo4'),
    ):
        assert old in text
        text = text.replace(old, new)
    campaign.write_text(text)
    fit = campaigns.calibrate(CampaignSimulations(read_campaign(campaign), Run(300_000)))
    monkeypatch.setattr(campaigns, "calibrate", lambda _: fit)
    out = mcrim.shown("calibrate", campaign)
    estimate = fit.parameters["alpha_scat_per_cm"]
    assert estimate.at_bound == "max"
    values, budget = (
        [cell.strip() for cell in line.split("│")[1:-1]]
        for line in out.splitlines()
        if "│ scattering (1/cm)" in line
    )
    assert values[1] == "0.3, at its bound"
    assert [float(end) for end in values[2].split(" to ")] == [round(estimate.lower, 4), 0.3]
    assert not any(budget[1:])
    # its notes are seen beside JSON too
    _, out, err = mcrim("calibrate", campaign, "--json", "-")
    notes = json.loads(out)["notes"]
    assert any("ended at its bound" in note for note in notes)
    assert err.splitlines() == [f"note: {note}" for note in notes]


FINE = "label,signal,sigma,n_gap\nair,14.3,0.2,1.0\ngel,24.5,0.4,1.46\n"


@cases("scene", "rows", "further", "says")
def test_campaigns_are_refused_with_their_line(mcrim, campaign_here, scene, rows, further, says):
    text, long = f'scene = "{scene}"\nmeasurements = "m.csv"\n{further}', "x" * 300
    Path("m.csv").write_text(rows.replace("LONG", long) or FINE)
    Path("c.toml").write_text(text.replace("LONG", long))
    refused = mcrim.refused("calibrate", "c.toml")
    assert all(words in refused for words in says), refused


def test_a_table_says_what_it_understood(mcrim):
    line = "--alpha-scat 0.1:1.0:10 --alpha-abs 0.039 --n-gap 1,1.46 --photons 1e4"
    out = mcrim.shown("table", BENCH, *line.split())
    said = "alpha_scat 0.1, 0.2, ..., 1 (10 values) /cm; alpha_abs 0.039 /cm; n_gap 1, 1.46"
    assert out.splitlines()[0] == said


def into_a_closed_pipe(*arguments: str):
    """Run a command whose reader is gone before the first byte."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        return subprocess.run(
            [sys.executable, "-m", "mcrim_mitsuba", *arguments],
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            env=os.environ,  # without the width that readline, if pytest loads it, adds to ours
        )
    finally:
        os.close(writer)


@cases("line", "written")
def test_a_reader_that_leaves_costs_no_results(campaign_here, here, line, written):
    done = into_a_closed_pipe(*line.split())
    # who reads a table of standard output is told beside it what was spent
    told = "1 points written to -: " if "-o -" in line else ""
    assert done.returncode == 0 and done.stderr.startswith(told)
    assert done.stderr.count("\n") == bool(told)
    for name in written:
        text = (here / name).read_bytes()
        assert json.loads(text) if name.endswith(".json") else len(text) > 60


@cases("words", "last", "proposed")
def test_shells_complete_what_is_typed(words, last, proposed):
    shell = BashComplete(command_line, {}, "mcrim", "_MCRIM_COMPLETE")
    found = [[one.type, one.value] for one in shell.get_completions(words, last)]
    assert sorted(found) == proposed


def test_helps_promise_only_what_a_verb_has(mcrim):
    for verb in ("simulate", "table", "calibrate", "crosscheck", "paper"):
        out = mcrim.shown(verb, "--help")
        assert ("with --precision, at" in " ".join(out.split())) == ("--precision FRACTION" in out)
    calibrate = " ".join(mcrim.shown("calibrate", "--help").split())
    assert "Configurations as they are get four times as many." in calibrate
    table = " ".join(mcrim.shown("table", "--help").split())
    assert "1.0,1.46" in table
    assert f"launches of {LANES:,} photons" in table and "may take as many again" in table


def test_what_was_typed_steers_no_terminal(mcrim):
    """Found by the fuzzer: click shows arguments that are too many as they are."""
    assert "<U+001B>[2J" in mcrim.refused("check", "scene.xml", "\x1b[2J")
