"""Is what is hidden in a wrapped bench named, and the light yield covered?

    python scripts/trials wrapped [--trials 90] [--seed 44] [--left-out] [--json FILE]

The independent tracer reads a LYSO bar on a silicon photomultiplier and a BGO cylinder on a
photomultiplier, both in Teflon: eight readings with errors of 1 %, dry and with grease, in two
lengths, wrapped and bare, the light yield, absorption and scattering drawn anew. Every trial hides
a cause in turn. The package has the scene without it, and the campaign's readings; with --left-out
its catalogue lacks the cause's effects too.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.stats import chi2

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.cli.terminal import Screen
from mcrim_mitsuba.core.run import DEFAULT_VARIANT
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.output.description import table
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from trials.executor import Trial, Trials, executor_options
from trials.truth import do_missing

SCENES = Path(__file__).resolve().parents[2] / "scenes"
#: Lengths (mm) of the crystals of a bench.
BENCHES = {"lyso_teflon": (5.0, 15.0), "bgo_cylinder": (10.0, 25.0)}
NOTHING, BAD_READING = "nothing", "bad reading"
#: What is hidden, smallest and largest; numbers of the scene are multiplied, effects have a size.
NUMBERS = {
    "wrap_reflectance": (0.92, 0.96),
    "gap_mm": (3.0, 5.0),
    "rim_reflectance": (2.0, 3.0),
}
EFFECTS = {
    "wrap_contact": (0.08, 0.3),
    "wrap_missing": (0.05, 0.2),
    "ground_top": (0.2, 0.5),
    "surface_absorption": (0.003, 0.01),
}
CAUSES = (*NUMBERS, *EFFECTS, BAD_READING, NOTHING)
#: Probability of chi2 below which readings fail.
FAILS = 0.01
#: What is bad by a factor.
BAD = 1.12
SIGMA, PHOTONS = 0.01, 200_000
ENERGY_KEV, EFFICIENCY, EFFICIENCY_SIGMA = 662.0, 0.35, 0.02
#: Standard error of the absorption that is known beforehand, in parts of it.
ABSORPTION_SIGMA = 0.2
CAMPAIGN = """scene = "{scene}"
measurements = "readings.csv"
[parameters.alpha_scat_per_cm]
start = 0.02
min = 0.0
max = 1.0
[parameters.alpha_abs_per_cm]
start = {absorption}
prior = {absorption}
prior_sigma = {absorption_sigma}
[light_yield]
energy_keV = {energy}
detector_efficiency = {efficiency}
detector_efficiency_sigma = {efficiency_sigma}
"""


def causes_of(bench: str) -> list[str]:
    """What can be hidden in a bench: a cylinder's tube has no dead rim."""
    parameters = read_scene(SCENES / f"{bench}.xml").parameters
    return [cause for cause in CAUSES if cause not in NUMBERS or cause in parameters]


def bare(scene: SceneFile) -> SceneFile:
    """A scene whose wrapping is taken off."""
    text = scene.unwritten_text or scene.path.read_text()
    before, _, after = text.partition('<shape type="wrapping"')
    return scene.edited(before + after.partition("</shape>")[2])


def eta_of(scene: SceneFile, values: Mapping[str, float], seed: int) -> float:
    """Light collection efficiency by the independent tracer, with what a scene has of `values`."""
    used = scene.parameters.keys() - scene.unused
    overrides = {name: value for name, value in values.items() if name in used}
    return trace(scene.with_overrides(overrides), PHOTONS, seed, threads=1).eta


def write_campaign(folder: Path, bench: str, cause: str, seed: int) -> dict[str, Any]:
    """A campaign whose readings the tracer made, and what is true of it."""
    rng = np.random.default_rng((seed, sorted(BENCHES).index(bench), CAUSES.index(cause)))
    plain = scene = read_scene(SCENES / f"{bench}.xml")
    hidden: dict[str, Any] = {"alpha_scat_per_cm": rng.uniform(0.01, 0.05)}
    hidden["alpha_abs_per_cm"] = float(plain.parameters["alpha_abs_per_cm"]) * rng.uniform(0.8, 1.2)
    size = rng.uniform(*(NUMBERS | EFFECTS).get(cause, (0.0, 0.0)))
    if cause in NUMBERS:
        hidden[cause] = float(plain.parameters[cause]) * size
    if cause in EFFECTS:
        scene = scene.edited(add(cause, scene))
        (name,) = scene.parameters.keys() - plain.parameters.keys()
        hidden[name] = size
    light_yield = rng.uniform(20.0, 35.0)
    lines = ["label,signal,sigma,n_gap,crystal_height_mm,wrapping"]
    spoilt = int(rng.integers(8))
    couplings = {"dry": 1.0, "grease": float(plain.parameters["n_gap"])}
    rows = product(couplings, BENCHES[bench], (1, 0))
    for number, (coupling, height, wrapped) in enumerate(rows):
        values = hidden | {"n_gap": couplings[coupling], "crystal_height_mm": height}
        eta = eta_of(scene if wrapped else bare(scene), values, 1000 * seed + number)
        signal = light_yield * ENERGY_KEV * EFFICIENCY * eta * (1.0 + SIGMA * rng.standard_normal())
        if cause == BAD_READING and number == spoilt:
            signal *= BAD
        label = f"{coupling} {height:g} {'wrapped' if wrapped else 'bare'}"
        row = label, f"{signal:.2f}", f"{SIGMA * signal:.2f}", couplings[coupling], height, wrapped
        lines.append(",".join(map(str, row)))
    (folder / "readings.csv").write_text("\n".join(lines) + "\n")
    absorption = plain.parameters["alpha_abs_per_cm"]
    text = CAMPAIGN.format(
        scene=plain.path,
        absorption=absorption,
        absorption_sigma=ABSORPTION_SIGMA * float(absorption),
        energy=ENERGY_KEV,
        efficiency=EFFICIENCY,
        efficiency_sigma=EFFICIENCY_SIGMA,
    )
    (folder / "campaign.toml").write_text(text)
    return {"light_yield": light_yield, "size": float(size), "spoilt": spoilt}


def judge(bench: str, cause: str, seed: int, left_out: bool, photons: int | None) -> dict[str, Any]:
    """What a diagnosis says of a bench with something hidden."""
    with tempfile.TemporaryDirectory() as folder:
        truth = write_campaign(Path(folder), bench, cause, seed)
        campaign = mcrim.read_campaign(Path(folder) / "campaign.toml")
        mine = {cause, f"wrong:{cause}"}
        if left_out:
            kept = {name: e for name, e in campaign.catalogue.items() if name not in mine}
            tolerances = tuple(t for t in campaign.tolerances if t.number.name != cause)
            campaign = dataclasses.replace(campaign, catalogue=kept, tolerances=tolerances)
        found = mcrim.diagnose(campaign, photons=photons, threads=1)
        labels = [reading.label for reading in campaign.measurements.readings]
    averaged = found.light_yield_averaged
    leading = {name.partition("=")[0] for names in found.leading_sets for name in names}
    suspects = [label for suspect in found.suspect_readings for label in suspect.labels]
    if cause == NOTHING:
        named = found.verdict == "adequate"
    elif cause == BAD_READING:
        named = labels[int(truth["spoilt"])] in suspects
    else:
        named = bool(leading & mine)
    return {
        "verdict": found.verdict,
        "chi2": found.baseline.chi2,
        "ndf": found.baseline.ndf,
        "named": named,
        "leading": sorted(leading),
        "suspects": suspects,
        "pull": (averaged.value - truth["light_yield"]) / averaged.sigma if averaged else None,
        "relative_error": averaged.sigma / averaged.value if averaged else None,
        **truth,
    }


@click.command()
@click.option("--trials", type=options.Whole(1, 10_000), default=90, show_default=True)
@click.option("--seed", type=options.Whole(0), default=44, show_default=True)
@click.option("--left-out", is_flag=True, help="Without the cause in the catalogue.")
@click.option("--photons", type=options.Whole(1), help="Of a simulation; default: as `diagnose`.")
@options.json_output
@executor_options
def main(
    trials: int,
    seed: int,
    left_out: bool,
    photons: int | None,
    json_file: str | None,
    executor,
    log,
) -> int:
    """Hidden causes on wrapped benches: are they named, is the light yield covered?"""
    cases = [(bench, cause) for bench in BENCHES for cause in causes_of(bench)]
    wanted = [Trial("-".join(cases[i % len(cases)]).replace(" ", "_"), i) for i in range(trials)]
    common = {"seed": seed, "left_out": left_out, "photons": photons, "variant": DEFAULT_VARIANT}
    done = Trials("wrapped", common, wanted, [Path(__file__)], executor)
    arguments = {
        trial: (*cases[trial.number % len(cases)], seed + trial.number, left_out, photons)
        for trial in done.missing
    }
    screen = terminal.console(json_file)
    status = do_missing(screen, "trials wrapped", done, judge, arguments, log)
    if status is not None:
        return status
    results = [(cases[trial.number % len(cases)][1], done.results[trial]) for trial in wanted]
    show(screen, results)
    terminal.write_json(json_file, {"seed": seed, "left_out": left_out, "outcomes": results})
    return terminal.DONE


def show(screen: Screen, outcomes: Sequence[tuple[str, dict[str, Any]]]) -> None:
    """A row for each cause, and one of all.

    What the readings hardly feel can only be covered: those are counted whose readings fail.
    """
    head = ("hidden", "trials", "readings fail", "named of these", "certain of another")
    head += ("light yield within 2 errors", "median error")
    rows = []
    for cause in (*CAUSES, "all"):
        of_cause = [row for name, row in outcomes if cause in (name, "all")]
        if not of_cause:
            continue
        pulls = [row["pull"] for row in of_cause if row["pull"] is not None]
        errors = [row["relative_error"] for row in of_cause if row["pull"] is not None]
        failing = [row for row in of_cause if chi2.sf(row["chi2"], row["ndf"]) < FAILS]
        astray = sum(row["verdict"] == "missing_effect" and not row["named"] for row in of_cause)
        rows.append(
            (
                cause,
                str(len(of_cause)),
                str(len(failing)),
                str(sum(row["named"] for row in failing)),
                str(astray),
                f"{sum(abs(pull) < 2.0 for pull in pulls)} of {len(pulls)}",
                f"{100 * float(np.median(errors)):.1f} %" if errors else "",
            )
        )
    screen.show(table("wrapped benches with something hidden", head, rows))
