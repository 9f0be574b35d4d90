"""Results as CSV, NetCDF and LaTeX: nothing is lost on the way, nothing foreign gets in."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
import xarray
from convert_results import dataset, escaped, latex_text, read_results, write_table
from places import SCENES, cases_of
from refusals import refusal

import mcrim_mitsuba as mcrim

cases = cases_of(__file__)

DOCUMENTS = Path(__file__).with_suffix(".json").read_text()


def document(kind):
    """As ``mcrim ... --json`` writes it, in short."""
    return json.loads(DOCUMENTS)[kind]


HOSTILE = document("calibration")["rows"][0]["label"]


def estimate(value, sigma, **further):
    return {
        "value": value,
        "sigma": sigma,
        "lower": value - sigma,
        "upper": None,
        "at_bound": None,
        "contributions": {},
    } | further


def calibration(**changes):
    return document("calibration") | changes


def eta_rows(n_gap=(1.0, 1.46), alpha_abs=(0.014, 0.039), alpha_scat=(0.1, 0.5, 1 / 3)):
    rng = np.random.default_rng(4)
    return [
        {
            "n_gap": n,
            "alpha_abs_per_cm": a,
            "alpha_scat_per_cm": s,
            "eta": rng.uniform(0.2, 0.5),
            "eta_sigma": rng.uniform(1e-4, 1e-3),
        }
        for n in n_gap
        for a in alpha_abs
        for s in alpha_scat
    ]


def table(**changes):
    """As ``mcrim table --json`` writes it."""
    return {
        "rows": eta_rows(),
        "photons": 4_000_000,
        "cached_photons": 0,
        "seed": 3,
        "seconds": 1.0,
        "parameters": {"gap_mm": 0.05, "polarization": False},
        "scene_hash": "cd" * 32,
        "notes": [],
    } | changes


def simulation(**changes):
    return document("simulation") | changes


def diagnosis():
    return document("diagnosis") | {"baseline": calibration(chi2=110.0)}


@pytest.fixture
def write(tmp_path):
    def write(name, content):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


def rows_of(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_an_eta_table_becomes_a_grid_and_comes_back(write, tmp_path):
    path = write("wide.json", table())
    write_table(read_results([path]), tmp_path / "wide.nc")
    with xarray.open_dataset(tmp_path / "wide.nc") as found:
        assert found.eta.dims == ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm")
        assert found.eta.shape == (2, 2, 3)
        for row in eta_rows():
            at = {n: row[n] for n in ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm")}
            assert float(found.eta.sel(at)) == row["eta"]
            assert float(found.eta_sigma.sel(at)) == row["eta_sigma"]
        assert found.alpha_scat_per_cm.attrs["units"] == "1/cm"
        assert found.n_gap.attrs["units"] == found.eta.attrs["units"] == "1"
        assert found.attrs["scene_hash"] == "cd" * 32
        assert json.loads(found.attrs["parameters"]) == {"gap_mm": 0.05, "polarization": False}
    # as CSV it is a table again, with all digits
    write_table(read_results([path]), tmp_path / "wide.csv")
    again = read_results([tmp_path / "wide.csv"])
    assert [{k: v for k, v in row.items() if k != "result"} for row in again.rows] == eta_rows()


def test_the_csv_of_mcrim_table_with_provenance(write):
    text = (
        "# scene_hash: 123\n# a remark\n# seed: 7\n"
        "n_gap,alpha_abs_per_cm,alpha_scat_per_cm,eta,eta_sigma\n"
        "1.46,0.039,0.5,0.43,0.0003\n1,0.039,0.5,0.25,0.0002\n1,0.039,0.5,0.25,0.0002\n"
    )
    found = dataset(read_results([write("t.csv", text)]))
    assert found.n_gap.values.tolist() == [1.0, 1.46]
    assert found.eta.values.ravel().tolist() == [0.25, 0.43]
    assert (found.attrs["scene_hash"], found.attrs["seed"]) == ("123", "7")


def test_several_tables_get_a_dimension_and_holes(write):
    first = write("a.json", table(rows=eta_rows(n_gap=(1.0,))))
    second = write("b.json", table(rows=eta_rows(n_gap=(1.46,))))
    found = dataset(read_results([first, second]))
    assert found.eta.dims[0] == "result" and found["result"].values.tolist() == ["a", "b"]
    assert found.eta.sel(result="a", n_gap=1.0).notnull().all()
    assert found.eta.sel(result="a", n_gap=1.46).isnull().all()


def test_a_calibration_in_all_three(write, tmp_path):
    bounded = calibration()
    bounded["parameters"]["alpha_scat_per_cm"] |= {"at_bound": "max", "lower": None}
    table = read_results([write("one.json", calibration()), write("two.json", bounded)])
    assert table.kind == "calibration"
    for suffix in (".csv", ".nc", ".tex"):
        write_table(table, tmp_path / f"out{suffix}")
    first, second = rows_of(tmp_path / "out.csv")
    assert (first["result"], first["chi2"], first["p_value"]) == ("one", "1.25", "")
    assert float(first["light_yield_ph_per_keV_sigma"]) == 0.79
    # at a bound there is no error
    assert second["alpha_scat_per_cm_sigma"] == ""
    assert second["alpha_scat_per_cm_at_bound"] == "max"
    with xarray.open_dataset(tmp_path / "out.nc") as found:
        assert found.light_yield_ph_per_keV.dims == ("result",)
        assert found.light_yield_ph_per_keV.attrs["units"] == "1/keV"
        assert found["result"].values.tolist() == ["one", "two"]
        assert math.isnan(found.alpha_scat_per_cm_sigma[1])
        assert found.alpha_scat_per_cm_at_bound.values.tolist() == ["", "max"]
        assert "p_value" not in found  # nobody knows one
        assert found.reading_label.values.tolist() == [HOSTILE, "gel"] * 2
        assert found.reading_use.values.tolist() == [1, 0] * 2
        known = json.loads(found.attrs["provenance"])["one"]
        assert known["seed"] == 2**62 + 1 and known["notes"] == ["a note with ± and \u03b1"]
    text = (tmp_path / "out.tex").read_text()
    assert r"one & $1.25$ & $0$ & $0.57 \pm 0.13$ & $7.5 \pm 0.8$ & $2.01$ \\" in text
    assert "$0.566$ (at its bound)" in text
    assert r"light yield (ph\,keV$^{-1}$)" in text


def test_results_of_an_effects_old_name_say_the_new_one(write):
    def with_old_name(content):
        names = (
            ("gap_bubble", "saturation"),
            ("bubble_fraction", "saturation"),
            ("gel", "saturation"),
        )
        text = json.dumps(content)
        for name, old in names:
            text = text.replace(f'"{name}"', f'"{old}"')
        return text

    candidate = read_results([write("old.json", with_old_name(diagnosis()))]).rows[1]
    assert (candidate["effect"], candidate["leading"]) == ("nonlinearity", True)
    assert candidate["size"] == "nonlinearity = 0.27 ± 0.07"
    fitted = calibration(parameters={"bubble_fraction": estimate(0.002, 0.001)})
    fit = read_results([write("fit.json", with_old_name(fitted))])
    assert fit.rows[0]["nonlinearity"] == 0.002
    # a reading is called what it is called
    assert fit.readings[1]["label"] == "saturation"


def test_a_report_counts_as_its_calibration(write):
    whole = diagnosis() | {"calibration": calibration(chi2=7.0), "seed": 5}
    table = read_results([write("report.json", whole)])
    assert (table.kind, table.rows[0]["chi2"]) == ("calibration", 7.0)


def test_simulations_and_diagnoses(write, tmp_path):
    one = write("air.json", simulation())
    other = simulation(parameters={"n_gap": 1.46, "polarization": False}, eta=0.43)
    found = read_results([one, write("gel.json", other)])
    text = latex_text(found)
    # what differs, and what was simulated
    assert r"result & $\eta$ & detected & absorbed my-crystal & $n_{\mathrm{gap}}$ \\" in text
    assert r"air & $0.2528 \pm 0.0007$ &" in text
    assert float(dataset(found)["absorbed_my-crystal"][0]) == 0.7472
    ranked = read_results([write("d.json", diagnosis())])
    write_table(ranked, tmp_path / "d.csv")
    none, bubble, polarization = rows_of(tmp_path / "d.csv")
    assert (none["effect"], none["chi2"], bubble["leading"]) == ("none", "110.0", "1")
    assert bubble["size"] == "bubble_fraction = 0.27 ± 0.07" and polarization["size"] == "on"
    assert dataset(ranked).sizes["row"] == 3
    assert r"gap\_bubble & yes & $9.07$" in latex_text(ranked)


def test_labels_are_shown_as_they_are():
    text = escaped(HOSTILE)
    assert text == (
        r"50 \% \& \$x\$\_1 \#2 \{a\}\textasciitilde{}\textasciicircum{}\textbackslash{} "
        r"\textless{}b\textgreater{} $\pm$ \textbar{} next\textless{}U+202E\textgreater{} line"
    )


def test_a_hostile_name_cannot_leave_its_comment_or_cell(write):
    path = write("a%b_&\nc.json", calibration())
    lines = latex_text(read_results([path])).splitlines()
    assert lines[0].startswith("%") and lines[1].startswith(r"\begin{tabular}")
    (row,) = [line for line in lines if "0.57" in line]
    assert row.startswith(r"a\%b\_\& c & $1.25$")
    # as many cells as columns: an escaped & is none
    columns = lines[1].partition("}{")[2].rstrip("}")
    assert row.replace(r"\&", "").count("&") == len(columns) - 1
    assert all(line.count("{") == line.count("}") for line in lines)


def test_large_and_small_numbers(write):
    known = calibration(chi2=1.2e-12)
    known["parameters"] = {"scale": estimate(1.234e9, 5.6e6)}
    text = latex_text(read_results([write("big.json", known)]))
    assert r"$1.2 \times 10^{-12}$" in text and r"$(1.234 \pm 0.006) \times 10^{9}$" in text


@cases(
    "name",
    "content",
    "says",
    more=[
        ("a.json", "[" * 100_000, "nested too deeply"),
        ("a.json", calibration(chi2="small"), "chi2: not a number"),
        ("a.json", json.dumps(calibration(chi2=math.inf)), "chi2: not finite"),
        ("a.json", calibration(rows=[1]), "rows: not a list of objects"),
        ("a.json", calibration(parameters={"a/b\n": {}}), "cannot be a column"),
        ("a.json", calibration(parameters={"a": {"value": None}}), "it has no value"),
        ("a.json", calibration(parameters={"a": 1.0}), "parameters.a: not an object"),
        ("a.json", table(rows=[{"n_gap": 1.0}]), "no table of eta over n_gap, alpha_abs and"),
        ("a.csv", "gap_mm,eta,eta_sigma\n1,0.5,0.1\n", "of all axes it writes .nc itself"),
        ("a.json", calibration(version=2), "a document of version 2, but version 1 is read here"),
        ("a.json", table(rows=[]), "a table without rows"),
    ],
)
def test_one_line_for_what_is_no_result(write, name, content, says):
    assert says in refusal(read_results, [write(name, content)])


def test_kinds_are_not_mixed(write):
    one, other = write("c.json", calibration()), write("t.json", table())
    refused = refusal(read_results, [one, other])
    assert "kind eta table, but " in refused and "c.json of the kind calibration" in refused
    assert "named twice" in refusal(read_results, [one, one])


def test_files_of_one_name_are_told_apart(write, tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write(f"{folder}/campaign.json", calibration())
    table = read_results([tmp_path / f / "campaign.json" for f in ("a", "b")])
    assert list(table.provenance) == ["a/campaign.json", "b/campaign.json"]


def test_what_a_document_is_is_its_kind(write):
    said = {"kind": "fit", "version": 1}
    table = read_results(
        [write("new.json", said | calibration()), write("old.json", calibration())]
    )
    assert table.kind == "calibration" and len(table.rows) == 2
    # whatever keys it has
    for kind in ("plan", "check", "of the future"):
        refused = refusal(read_results, [write("x.json", calibration(kind=kind))])
        assert "no result of mcrim that can be converted" in refused


def test_a_result_is_read_again(tmp_path):
    light = mcrim.simulate(SCENES / "camoo4.xml", photons=20_000, seed=1)
    light.to_json(tmp_path / "light.json")
    assert {"kind": "simulation", "version": 1}.items() <= light.document.items()
    (row,) = read_results([tmp_path / "light.json"]).rows
    assert (row["eta"], row["photons"]) == (light.eta, light.photons)
