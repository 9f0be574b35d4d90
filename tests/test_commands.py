"""Commands as users type them: numbers, JSON, exit status and one line for wrong input."""

from __future__ import annotations

import _ctypes
import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mcrim_mitsuba.cli.main import main

SCENES = Path(__file__).parents[1] / "scenes"
BENCH = str(SCENES / "camoo4.xml")


def run(capsys, *arguments: str):
    status = main(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_simulate_gives_the_promised_json(capsys):
    status, out, _ = run(capsys, "simulate", BENCH, "-D", "n_gap=1.46", "--photons", "2e5",
                         "--seed", "3", "--json", "-")  # fmt: skip
    result = json.loads(out)
    assert status == 0
    assert abs(result["eta"] - 0.4335) < 5 * result["eta_sigma"]
    assert sum(result["budget"].values()) == pytest.approx(1, abs=1e-6)
    assert result["photons"] == 200_000 and result["seed"] == 3
    assert result["parameters"]["n_gap"] == 1.46
    keys = {"detected", "absorbed_crystal", "absorbed_gap", "absorbed_window",
            "absorbed_aperture", "escaped", "truncated"}  # fmt: skip
    assert keys <= set(result["budget"])
    assert {"mitsuba", "drjit", "llvm", "variant"} <= set(result["versions"])
    assert {"seconds", "photons_per_second"} <= set(result)


def test_table_agrees_with_simulations_of_its_own(capsys, tmp_path):
    path = tmp_path / "T.csv"
    status, *_ = run(capsys, "table", BENCH, "--alpha-scat", "0,0.02,0.54,6", "--alpha-abs",
                     "0.014:0.072:2", "--n-gap", "1,1.46", "--photons", "4e5",
                     "-o", str(path))  # fmt: skip
    assert status == 0
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm", "eta", "eta_sigma"]
    assert len(rows) == 16
    for row in rows[::3]:
        changed = [f"{k}={row[k]}" for k in ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm")]
        options = [part for pair in changed for part in ("-D", pair)]
        _, out, _ = run(capsys, "simulate", BENCH, *options, "--photons", "4e5", "--seed", "77",
                        "--json", "-")  # fmt: skip
        own = json.loads(out)
        sigma = (float(row["eta_sigma"]) ** 2 + own["eta_sigma"] ** 2) ** 0.5
        assert abs(float(row["eta"]) - own["eta"]) < 4 * sigma, row


def test_calibrate_finds_the_articles_light_yield(capsys):
    status, out, _ = run(capsys, "calibrate", str(SCENES / "camoo4_campaign.toml"), "--photons",
                         "6e5", "--json", "-")  # fmt: skip
    found = json.loads(out)
    assert status == 0
    parameters = found["parameters"]
    assert parameters["light_yield_ph_per_keV"]["value"] == pytest.approx(7.5, abs=0.1)
    # R = 0.5837, unpolarised: 0.560 + 0.006, with this run's Monte Carlo error
    alpha = parameters["alpha_scat_per_cm"]
    monte_carlo = alpha["contributions"]["monte_carlo"]
    assert abs(alpha["value"] - 0.566) < 4 * monte_carlo + 0.003
    assert alpha["lower"] < alpha["value"] < alpha["upper"]
    assert found["ndf"] == 0 and found["p_value"] is None
    assert [row["label"] for row in found["rows"]] == ["air", "gel"]
    assert {"measured", "sigma", "model", "model_sigma", "pull", "eta", "eta_sigma"} <= set(
        found["rows"][0]
    )


def test_check_says_what_the_bench_means_and_what_is_installed(capsys):
    status, out, _ = run(capsys, "check", BENCH)
    assert status == 0
    for words in ("crystal: 10 x 10 x 10 mm", "scatters 0.54 /cm", "index 2.01", "detected is what",
                  "radius 14 mm", "the scene is sound"):  # fmt: skip
        assert words in out
    status, out, _ = run(capsys, "check")
    assert status == 0
    for words in ("mitsuba", "llvm library", "variants", "threads"):
        assert words in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "nowhere.xml"], ["nowhere.xml", "no such file"]),
        (["simulate", BENCH, "-D", "n_gapp=1.4"], ["n_gapp", "did you mean n_gap"]),
        (["simulate", BENCH, "-D", "n_gap"], ["n_gap"]),
        (["simulate", BENCH, "-D", "n_gap=1,46"], ["decimal comma", "1.46"]),
        (["simulate", BENCH, "-D", "gap_mm=-0.1"], ["gap_mm", "without a sign"]),
        (["simulate", BENCH, "-D", "gap_mm=0.001"], ["too thin", "0.003"]),
        (["simulate", BENCH, "-D", "polarization=maybe"], ["polarization", "true or false"]),
        (["simulate", BENCH, "--photons", "many"], ["many", "photons"]),
        (["simulate", BENCH, "--photons", "0"], ["photons"]),
        (["simulate", BENCH, "--precision", "0"], ["precision"]),
        (["simulate", BENCH, "--seed", "-1"], ["seed"]),
        (["simulate", BENCH, "--variant", "scalar_rgb"], ["scalar_rgb", "llvm_ad_rgb"]),
        (["simulate", BENCH, "--threads", "0"], ["threads"]),
        (["simulate", BENCH, "--photons", "1e3", "--json", "/nowhere/x.json"], ["/nowhere/x.json"]),
        (["table", BENCH, "--alpha-scat", "0.1;0.5", "--alpha-abs", "0", "--n-gap", "1"], ["0.1;0.5"]),
        (["table", BENCH, "--alpha-scat", "log:0:1:5", "--alpha-abs", "0", "--n-gap", "1"], ["touch 0"]),
        (["table", BENCH, "--alpha-scat", "1", "--alpha-abs", "-1", "--n-gap", "1"], ["negative"]),
        (["table", BENCH, "--alpha-abs", "0", "--n-gap", "1"], ["--alpha-scat"]),
        (["calibrate", BENCH], [BENCH]),
        (["frobnicate"], ["frobnicate"]),
    ],
    ids=lambda value: " ".join(value)[-40:] if isinstance(value, list) else "",
)  # fmt: skip
def test_wrong_input_gets_one_line_and_status_2(capsys, arguments, words):
    status, _, err = run(capsys, *arguments)
    assert status == 2, err
    assert err.startswith("mcrim: ") and err.count("\n") == 1, err
    for word in words:
        assert word in err, err


@pytest.mark.parametrize(
    ("library", "words"),
    [("/nowhere/libLLVM.so", "no such file"), (__file__, "not a shared library")],
)
def test_an_unusable_llvm_is_refused_before_dr_jit_sees_it(library, words):
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": library}
    done = subprocess.run(
        [sys.executable, "-m", "mcrim_mitsuba", "check"],
        env=environment, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 2
    assert words in done.stderr and "DRJIT_LIBLLVM_PATH" in done.stderr
    assert done.stderr.count("\n") == 1


def test_an_llvm_that_is_too_old_is_refused():
    """LLVM 16 learned to tell its version; a library that cannot is older, and would abort."""
    # any library without LLVMGetVersion stands for it
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": _ctypes.__file__}
    done = subprocess.run(
        [sys.executable, "-m", "mcrim_mitsuba", "check"],
        env=environment, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 2 and "too old" in done.stderr and done.stderr.count("\n") == 1


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
    assert done.returncode == 0 or "import mcrim_mitsuba before mitsuba" in done.stderr
