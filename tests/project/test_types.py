"""Results as a type checker and an editor see them: every field of every result is known."""

import dataclasses
import inspect
import os
import subprocess
import sys
from pathlib import Path

import jedi
import pytest
from places import ROOT

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.output import campaign_results, registry, scene_results

SCRIPT = Path(__file__).with_name("every_function.py")
#: What each function gives.
RESULTS = {
    "simulate": scene_results.LightResult,
    "table": scene_results.TableResult,
    "eta_map": scene_results.MapResult,
    "eta_spectrum": scene_results.SpectrumResult,
    "arrival_times": scene_results.TimesResult,
    "check": scene_results.CheckResult,
    "crosscheck": scene_results.CrosscheckResult,
    "reduce": campaign_results.ReductionResult,
    "calibrate": campaign_results.FitResult,
    "compare": campaign_results.ComparisonResult,
    "diagnose": campaign_results.DiagnosisResult,
    "repair": campaign_results.RepairResult,
    "budget": campaign_results.BudgetResult,
    "plan": campaign_results.PlanResult,
    "report": campaign_results.ReportResult,
}
RUN = ("run", "photons", "precision", "seed", "threads", "variant")


#: What `mypy --strict` asks of a script, without asking it of the package.
STRICT = """
[[tool.mypy.overrides]]
module = ["every_function", "wrong"]
disallow_any_generics = true
disallow_subclassing_any = true
disallow_untyped_calls = true
disallow_untyped_decorators = true
warn_return_any = true
implicit_reexport = false
"""


#: Of what a user may mistake; nothing passes because it may be anything.
SLIPS = ("light.etta", "fit.light_yield", "mcrim.simulat", "fit.rows[0].pul", "table.axis")


@pytest.fixture(scope="module")
def complaints(tmp_path_factory) -> list[str]:
    """What mypy has against the package, a user's script, and the script with slips: in one run."""
    folder = tmp_path_factory.mktemp("mypy")
    config, wrong = folder / "strict.toml", folder / "wrong.py"
    config.write_text((ROOT / "pyproject.toml").read_text() + STRICT)
    wrong.write_text(SCRIPT.read_text() + "".join(f"\nprint({slip})" for slip in SLIPS))
    # the cache would be read by nobody
    words = ["--no-pretty", "--cache-dir", os.devnull, f"--config-file={config}"]
    command = [sys.executable, "-m", "mypy", *words, "mcrim_mitsuba", SCRIPT, wrong]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1].startswith("Found "), done.stdout + done.stderr
    return done.stdout.splitlines()[:-1]


def test_what_functions_say_of_their_arguments_holds(complaints):
    assert [line for line in complaints if line.startswith("mcrim_mitsuba/")] == []


def test_a_script_of_every_function_is_typed(complaints):
    """Of a user, who has the package installed, and mypy strict."""
    assert (ROOT / "mcrim_mitsuba" / "py.typed").is_file()  # which the wheel has too
    used = SCRIPT.read_text()
    functions = set(mcrim.__all__) - {
        "Campaign",
        "InputError",
        "Result",
        "SceneFile",
        "use_variant",
    }
    assert [name for name in functions if f"mcrim.{name}(" not in used] == []
    of_scripts = [line for line in complaints if not line.startswith("mcrim_mitsuba/")]
    errors = [line for line in of_scripts if ": error: " in line]
    assert ["wrong.py:" in line for line in errors] == [True] * len(SLIPS), of_scripts
    assert all(line.endswith("[attr-defined]") for line in errors), of_scripts


@pytest.mark.parametrize("function", RESULTS)
def test_an_editor_completes_every_field(function):
    result = RESULTS[function]
    script = jedi.Script(f"import mcrim_mitsuba as mcrim\nmcrim.{function}('x').")
    completed = {completion.name for completion in script.complete(2)}
    names = {field.name for field in dataclasses.fields(result)}
    names |= {name for name, _ in inspect.getmembers(result, lambda x: isinstance(x, property))}
    shown = {"plot", "draw", "to_json", "to_dataframe", "to_xarray", "document", "description"}
    assert {name for name in names if name[0] != "_"} | shown <= completed


def test_signatures_name_the_fields_of_a_run():
    for name in set(RESULTS) - {"reduce", "check"}:
        parameters = inspect.signature(getattr(mcrim, name)).parameters
        assert set(RUN) <= set(parameters), name
        # and as an editor has them, which reads the code and runs nothing
        call = f"import mcrim_mitsuba as mcrim\nmcrim.{name}('x', phot"
        offered = jedi.Script(call).complete(2, len(call.splitlines()[1]))
        assert "photons=" in {completion.name for completion in offered}, name
    assert set(registry.PRESENTERS) == {
        "HypothesesResult",
        *(result.__name__ for result in RESULTS.values()),
    }


@pytest.mark.usefixtures("kept_records")  # the page has simulated the same bench
def test_dir_shows_what_there_is():
    light = mcrim.simulate(SCRIPT.parents[2] / "scenes/camoo4.xml", photons=20_000, seed=1)
    assert {"eta", "budget", "gap_mm", "plot"} <= set(dir(light)) and light.gap_mm == 0.05
    fit = mcrim.calibrate(SCRIPT.parents[2] / "scenes/camoo4_spot.toml", photons=16_384)
    assert set(fit.parameters) <= set(dir(fit))
    assert float(fit.alpha_scat_per_cm) == fit.parameters["alpha_scat_per_cm"].value
    # those that are shown
    assert all(f"note: {note}" in str(fit) for note in fit.notes)
    with pytest.raises(AttributeError, match="has no light_yield_ph_per_keV; it has fitted"):
        _ = dataclasses.replace(fit, parameters={}).light_yield_ph_per_keV
    assert not hasattr(fit, "n_crystal_of_nothing")
