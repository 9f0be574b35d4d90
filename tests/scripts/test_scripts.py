"""Scripts for everyday work: they go on where they were, and say in one line what is wrong."""

import csv
import importlib
import json
import os
import subprocess
import sys

import convert_results
import eta_tables
import make_raw_example
import measured_blind
import measured_elsewhere
import measured_plausible
import night_batch
import pytest
import write_pages
from convert_results import read_results
from places import SCENES, SCRIPTS, cases_of

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli.terminal import run
from mcrim_mitsuba.transport import loop as transport

cases = cases_of(__file__)

PHOTONS = ["--photons", "50000"]
ONE_POINT = "--alpha-scat 0.5 --alpha-abs 0.039 --n-gap 1.0".split()


@pytest.fixture
def do(capfd):
    """Runs a script: exit status, what it says, its complaints."""

    def do(script, *arguments):
        status = run(script.main, script.__name__, [str(a) for a in arguments])
        said = capfd.readouterr()
        return status, said.out, said.err

    return do


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def campaigns(scenes, tmp_path):
    """The article's campaign, sound and with a slip, in folders of their own."""
    for folder, slip in (("good", "14.3,0.2"), ("bad", "14.3,zero")):
        (tmp_path / folder).mkdir()
        for name in ("camoo4.xml", "camoo4_campaign.toml", "camoo4_measured.csv"):
            text = (scenes / name).read_text().replace("14.3,0.2", slip)
            (tmp_path / folder / name).write_text(text)
    return [tmp_path / folder / "camoo4_campaign.toml" for folder in ("good", "bad")]


def test_tables_of_all_combinations_and_only_once(scenes, tmp_path, do, cache):
    (tmp_path / "camoo4.xml").write_text((scenes / "camoo4.xml").read_text())
    folder = tmp_path / "tables"
    line = [
        tmp_path / "camoo4.xml",
        *"--alpha-scat 0.1,0.5 --alpha-abs 0.039 --n-gap 1.0".split(),
        *PHOTONS,
        "-o",
        folder,
        "-D",
    ]
    # as if the first run had been interrupted within the second table
    status, out, err = do(eta_tables, *line, "gap_mm=0.05")
    assert (status, err) == (0, "") and out.endswith(f"1 tables: 1 made; {folder}\n")
    files = [folder / f"camoo4_gap_mm={gap}.csv" for gap in ("0.05", "0.5")]
    before = files[0].read_text()
    status, out, _ = do(eta_tables, *line, "gap_mm=0.05,0.5")
    assert status == 0 and "0.05.csv: kept: 2 points" in out
    assert out.endswith(f"2 tables: 1 made, 1 kept; {folder}\n")
    assert files[0].read_text() == before and sorted(folder.iterdir()) == files
    table = read_results(files)
    assert len(table.rows) == 4
    known = table.provenance["camoo4_gap_mm=0.5"]
    assert json.loads(known["parameters"])["gap_mm"] == 0.5 and known["seed"] == "0"
    assert json.loads(known["versions"])["mitsuba"]
    # another seed, or a scene that changed, makes them anew
    line.append("gap_mm=0.05,0.5")
    assert ": 2 made;" in do(eta_tables, *line, "--seed", "1")[1]
    scene = tmp_path / "camoo4.xml"
    scene.write_text(
        scene.read_text().replace('name="n_window" value="1.52"', 'name="n_window" value="1.5"')
    )
    assert ": 2 made;" in do(eta_tables, *line, "--seed", "1")[1]


def test_a_table_that_is_refused_stops_no_other(scenes, tmp_path, do):
    status, out, err = do(
        eta_tables,
        scenes / "camoo4.xml",
        *ONE_POINT,
        "-D",
        "gap_mm=50,0.05",
        *PHOTONS,
        "-o",
        tmp_path,
    )
    assert (status, err) == (2, "")
    refused, made, _ = out.splitlines()
    assert "gap_mm=50.0.csv: refused: " in refused and "gap_mm=0.05.csv: made: " in made
    assert [file.name for file in tmp_path.iterdir()] == ["camoo4_gap_mm=0.05.csv"]


def test_an_interrupted_table_is_no_table(scenes, tmp_path, do, monkeypatch):
    """Without scattering a point is simulated on its own, and an interrupt cuts it short."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(transport, "launch", interrupted)
    status, out, err = do(
        eta_tables,
        scenes / "camoo4.xml",
        *"--alpha-scat 0 --alpha-abs 0.039 --n-gap 1.0".split(),
        *PHOTONS,
        "-o",
        tmp_path,
    )
    assert (status, err) == (130, "")
    assert out == "interrupted after 0 of 1; the same line goes on from here\n"
    assert not list(tmp_path.iterdir())


@cases("further", "says")
def test_slips_are_found_before_anything_is_simulated(
    scenes, tmp_path, do, monkeypatch, further, says
):
    monkeypatch.setattr(transport, "launch", None)
    (tmp_path / "camoo4.xml").write_text((scenes / "camoo4.xml").read_text())
    monkeypatch.chdir(tmp_path)
    # each is given once
    pairs = zip(ONE_POINT[::2], ONE_POINT[1::2], strict=True)
    lists = [word for pair in pairs if pair[0] not in further for word in pair]
    status, out, err = do(
        eta_tables, scenes / "camoo4.xml", *lists, "-o", tmp_path / "tables", *PHOTONS, *further
    )
    assert status == 2
    # what a table refuses is said in its line
    assert says in (err or out) and (err or out).count("\n") == (1 if err else 2)


def test_a_variation_may_name_materials(scenes, tmp_path):
    axes = {"alpha_scat_per_cm": [0.5], "alpha_abs_per_cm": [0.039], "n_gap": [1.0]}
    variations = {"n_crystal": "CaMoO4@540nm,2.0"}
    tables = eta_tables.wanted([scenes / "camoo4.xml"], axes, variations, tmp_path)
    assert [scene.parameters["n_crystal"] for scene in tables.values()] == [2.00562, 2.0]


def test_what_is_no_table_is_not_replaced(scenes, tmp_path, do):
    measured = tmp_path / "camoo4.csv"
    measured.write_text("# photons, events\n1,2\n")
    status, out, err = do(eta_tables, scenes / "camoo4.xml", *ONE_POINT, "-o", tmp_path, *PHOTONS)
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert f"{measured}: there is a file of this name, and it is no result of this script" in err
    assert measured.read_text() == "# photons, events\n1,2\n"


def test_a_night_goes_on_past_a_bad_campaign(campaigns, tmp_path, do, cache):
    night = tmp_path / "night"
    line = [*campaigns, tmp_path / "nowhere.toml", *PHOTONS, "-o", night]
    status, out, err = do(night_batch, *line)
    assert (status, err) == (2, "")
    assert f"3 campaigns: 1 made, 2 refused; {night / 'summary.csv'}\n" in out
    with (night / "summary.csv").open() as stream:
        good, bad, none = csv.DictReader(stream)
    assert good["status"] == "made" and float(good["light_yield_ph_per_keV"]) == pytest.approx(
        7.5, abs=0.3
    )
    assert float(good["alpha_scat_per_cm_sigma"]) > 0 and good["p_value"] == ""
    assert bad["status"] == "refused" and "line 4, column sigma: sigma = 'zero'" in bad["reason"]
    assert "no such file" in none["reason"]
    # what was simulated is kept, unless the seed or the scene changes
    assert "1 kept, 2 refused" in do(night_batch, *line)[1]
    assert "1 made, 2 refused" in do(night_batch, *line, "--seed", "1")[1]
    scene = campaigns[0].with_name("camoo4.xml")
    scene.write_text(
        scene.read_text().replace('name="n_window" value="1.52"', 'name="n_window" value="1.5"')
    )
    assert "1 made, 2 refused" in do(night_batch, *line)[1]
    # and converted as it is
    status, out, err = do(
        convert_results, night / "good_camoo4_campaign.json", "-o", tmp_path / "night.tex"
    )
    assert (status, err) == (0, "") and "calibration, 1 rows" in out
    assert r"$7.5 \pm 0.8$" in (tmp_path / "night.tex").read_text()


@pytest.mark.parametrize("name", ["summary.csv", "good_camoo4_campaign.json"])
def test_a_night_replaces_nobody_else_s_files(campaigns, tmp_path, do, name):
    foreign = tmp_path / name
    foreign.write_text('{"my": "thesis"}')
    status, out, err = do(night_batch, *campaigns, *PHOTONS, "-o", tmp_path)
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert f"{foreign}: there is a file of this name, and it is no result of this script" in err
    assert foreign.read_text() == '{"my": "thesis"}'
    # what a power cut has left of a file is nobody's
    foreign.write_text("")
    assert "1 made, 1 refused" in do(night_batch, *campaigns, *PHOTONS, "-o", tmp_path)[1]


def test_results_of_a_night_that_would_have_one_name(tmp_path, do):
    (tmp_path / "a").mkdir()
    same = [tmp_path / place / "x.toml" for place in ("a", "b/a")]
    status, out, err = do(night_batch, *same, "-o", tmp_path)
    assert (status, out) == (2, "") and f"both write {tmp_path / 'a_x.json'}" in err


def test_a_night_goes_on_past_our_own_faults(campaigns, tmp_path, do, monkeypatch):
    def fails(*_, **__):
        raise ZeroDivisionError("1 / 0")

    monkeypatch.setattr(mcrim, "calibrate", fails)
    status, out, _ = do(night_batch, *campaigns, "-o", tmp_path)
    assert status == 1 and out.count(": failed: ZeroDivisionError: 1 / 0\n") == 2
    assert out.endswith(f"2 campaigns: 2 failed; {tmp_path / 'summary.csv'}\n")


def test_a_diagnosis_of_a_night():
    """Its row has the fit without further effects; of the report, that of the mended campaign."""
    known = {"value": 0.5, "sigma": 0.1, "at_bound": None}
    fit = {"chi2": 1.0, "ndf": 2, "p_value": 0.6, "parameters": {"alpha_scat_per_cm": known}}
    found = night_batch.findings({"baseline": fit, "verdict": "ambiguous", "leading": ["a", "b"]})
    assert (found["alpha_scat_per_cm"], found["alpha_scat_per_cm_sigma"]) == (0.5, 0.1)
    assert (found["leading"], found["verdict"], found["ndf"]) == ("a or b", "ambiguous", 2)
    mended = fit | {"parameters": {"alpha_scat_per_cm": known | {"at_bound": "lower"}}}
    found = night_batch.findings({"baseline": fit, "calibration": mended})
    assert found["alpha_scat_per_cm_sigma"] is None


def test_results_are_refused_in_one_line(tmp_path, do):
    foreign = tmp_path / "package.json"
    foreign.write_text('{"name": "left-pad"}')
    for arguments, says in (
        ([foreign, "-o", tmp_path / "out.csv"], "JSON, but no result of mcrim"),
        ([foreign, "-o", tmp_path / "out.xlsx"], "cannot write .xlsx"),
        ([foreign], "Missing option '-o'"),
        (["-o", tmp_path / "out.csv"], "Missing argument 'RESULT...'"),
        ([tmp_path / "none.json", "-o", tmp_path / "out.nc"], "none.json: no such file"),
    ):
        status, out, err = do(convert_results, *arguments)
        assert (status, out) == (2, "")
        assert err.startswith("convert_results: ") or err.startswith(str(tmp_path))
        assert says in err and err.count("\n") == 1
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("ending", ["csv", "tex"])
def test_a_conversion_replaces_its_own_result_and_nothing_else(tmp_path, do, ending):
    result, place = tmp_path / "light.json", tmp_path / f"readings.{ending}"
    mcrim.simulate(mcrim.read_scene(SCENES / "camoo4.xml"), photons=1000).to_json(result)
    place.write_text("label,signal,sigma\nair,14.3,0.2\n")
    status, out, err = do(convert_results, result, "-o", place)
    assert (status, out) == (2, "") and "it is no result of this script; name another" in err
    assert place.read_text().startswith("label,signal")
    place.unlink()
    for _ in range(2):
        assert do(convert_results, result, "-o", place)[0] == 0


@pytest.mark.parametrize(
    ("script", "arguments", "says"),
    [
        (measured_blind, "pixel --photons 0", "'0' is no number of photons; give 1 to 1e13"),
        (measured_blind, "pixel --error 5%", "have errors of their own; leave --error out"),
        (measured_blind, "gagg --campaigns 0", "'0' is not a whole number from 1 to 10000"),
        (measured_elsewhere, "fractions --photons -5", "'-5' is no number of photons"),
        (measured_plausible, "lengths --photons many", "'many' is no number of photons"),
        (write_pages, "--check", "No such option '--check'"),
        (make_raw_example, __file__, "something is there already; name a new folder"),
        (make_raw_example, str(SCENES), "something is there already; name a new folder"),
        (make_raw_example, f"{__file__}/new", "the folder cannot be made"),
    ],
    ids=lambda one: getattr(one, "__name__", None),
)
def test_slips_in_what_makes_pages_are_told_in_one_line(do, monkeypatch, script, arguments, says):
    monkeypatch.setattr(write_pages, "WRITERS", {})
    status, out, err = do(script, *arguments.split())
    assert (status, out, err.count("\n")) == (2, "", 1) and says in err


def test_without_geant4_what_needs_it_says_so_before_it_works(do, monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS / "validate")
    unified = importlib.import_module("unified")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    status, out, err = do(unified, "--photons", "1e3")
    assert (status, out) == (2, "") and err.startswith("unified: Geant4 is not installed; ")


def test_what_a_blind_check_kept_is_that_of_its_bench_errors_and_photons(do, tmp_path, monkeypatch):
    """Readings with errors of 5 % were once taken for those with 3 %, a bar for a pixel."""
    said = {"verdict": "adequate", "chi2": 1.0, "ndf": 2, "leading": [], "suspects": []}
    judged = []

    def judge(path, photons):
        judged.append((path.with_suffix(".csv").read_text(), photons))
        return {**said, "credible": [], "zero": None}

    monkeypatch.setattr(measured_blind, "judged", judge)
    for bench in ("bar", "pixel"):
        monkeypatch.setattr(
            measured_blind,
            f"{bench}_readings",
            lambda cause, size, seed, errors, bench=bench: f"{bench} {seed} {errors}",
        )
    for words in ("gagg", "gagg --error 3%", "gagg --photons 1e4", "pixel", "gagg", "pixel"):
        line = *words.split(), "--results", tmp_path, "--campaigns", "1"
        assert do(measured_blind, *line)[0] == 0
    bar, pixel = "bar 1000 0.05", f"pixel 1000 {tmp_path}"
    assert judged == [(bar, None), ("bar 1000 0.03", None), (bar, 10_000), (pixel, None)]


def test_no_script_imports_mitsuba_before_an_llvm_is_chosen(tmp_path):
    """The benchmark's had the system's, too old, and ended."""
    folders = [SCRIPTS, *(SCRIPTS / name for name in ("benchmark", "trials", "validate"))]
    files = [file for folder in folders for file in sorted(folder.glob("*.py"))]
    modules = [".".join(file.relative_to(SCRIPTS).with_suffix("").parts) for file in files]
    of_geant4 = "geant4_process"  # which only a process of its own imports
    imports = "; ".join(f"import {module}" for module in modules if module != of_geant4)
    path = os.pathsep.join(map(str, [SCRIPTS, SCRIPTS / "validate", SCRIPTS.parent]))
    code = f"import sys; {imports}; print(*sys.modules.keys() & {{'drjit', 'mitsuba'}})"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": path},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == [] and "benchmark.__main__" in imports
