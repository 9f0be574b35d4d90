"""Geant4's UNIFIED model of a ground top face beside facets that a photon walks among.

    python scripts/validate/unified.py [--photons 200000]

prints a table of Markdown: eta in air and gel, UNIFIED with sigma_alpha (radians) and Beckmann's
facets of alpha = sqrt(2) tan(sigma_alpha), of which UNIFIED lets a photon meet one at a time. It
needs geant4_pybind.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.run import Run, processors
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.shipped import scene_path

sys.path.insert(0, str(Path(__file__).parents[1]))
from geant4 import refuse_missing

SIGMAS_ALPHA = (0.02, 0.05, 0.1, 0.2, 0.35)
COEFFICIENTS = {"alpha_scat_per_cm": 0.05, "alpha_abs_per_cm": 0.001}
#: So thin that its sides let nothing out, so thick that Geant4 does not take it for its tolerance.
CAP_MM = 1e-3


def job_of(work: Callable[..., None]):
    """``--job``, by which a script that lets Geant4 trace calls its own `work`.

    Without it, Geant4 must be there before anything is simulated.
    """

    def do(ctx: click.Context, param: click.Parameter, job: str | None) -> None:
        if job:
            work(**json.loads(job))
        else:
            refuse_missing()

    return click.option("--job", hidden=True, expose_value=False, callback=do)


def in_geant4(script: str, photons: int, **job: Any) -> tuple[float, float]:
    """Part detected, and photons per second of a processor, where a script does its `work`.

    That is in a process of its own: Geant4 can be initialised once in each.
    """
    with tempfile.TemporaryDirectory() as folder:
        # light needs none of Geant4's data, but without this file it does not start
        Path(folder, "ENSDFSTATE.dat").touch()
        data = {"GEANT4_DATA_DIR": folder, "G4ENSDFSTATEDATA": folder}
        done = subprocess.run(
            [sys.executable, script, "--job", json.dumps(job | {"photons": photons})],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            check=True,
            env=os.environ | data,
        )
    found = json.loads(done.stdout.splitlines()[-1])
    return found["detected"] / photons, photons / found["seconds"]


def trace_and_end(bench: Bench, photons: int, depolarize: bool = True) -> None:
    """Trace in Geant4, print how many are detected and in what time, and end the process."""
    import geant4_process as process

    reports = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    run = process.Geant4Run(bench, 1, processors(), depolarize, lambda **_: None)
    started = time.process_time()
    detected = run.beam_on(photons)[process.DETECTOR]
    found = {"detected": detected, "seconds": time.process_time() - started}
    print(json.dumps(found), file=reports, flush=True)
    os._exit(0)


def work(sigma_alpha: float, n_gap: float, photons: int) -> None:
    """Trace, and print how many are detected; a cap of the crystal's medium has the ground face."""
    import geant4_process as process
    import geant4_pybind as g4

    class GroundTop(process.BenchConstruction):
        def Construct(self):
            world = super().Construct()
            bench, half = self._bench, self._bench.crystal_width_mm / 2.0
            crystal = self._counted[process.CRYSTAL]
            top = bench.crystal_height_mm
            medium, around = crystal.GetMaterial(), world.GetLogicalVolume()
            self._keep(self._slab("cap", medium, half, top, top + CAP_MM, around))
            placements = [each for each in self._kept if isinstance(each, g4.G4PVPlacement)]
            placed = next(p for p in placements if p.GetLogicalVolume().GetName() == "cap")
            ground = g4.G4OpticalSurface("ground", g4.unified, g4.ground, g4.dielectric_dielectric)
            self._keep(ground).SetSigmaAlpha(sigma_alpha)
            # every facet is a mirror of its own: no spike, no lobe about the mean face, no Lambert
            lobes = {"SPECULARSPIKECONSTANT": 0.0, "BACKSCATTERCONSTANT": 0.0}
            table = self._properties({"SPECULARLOBECONSTANT": 1.0} | lobes)
            ground.SetMaterialPropertiesTable(table)
            for pair in ((placed, world), (world, placed)):
                self._keep(g4.G4LogicalBorderSurface("top", *pair, ground))
            return world

    process.BenchConstruction = GroundTop
    trace_and_end(Bench(n_gap=n_gap, **COEFFICIENTS), photons)


@click.command()
@options.photons("2e5, in Geant4")
@job_of(work)
def main(photons: int | None) -> None:
    """Geant4's UNIFIED model of a ground top face beside facets that a photon walks among."""
    photons = photons or 200_000
    scene = read_scene(scene_path("camoo4.xml"))
    print("| sigma_alpha | alpha | UNIFIED air, gel, ratio | walked facets air, gel, ratio |")
    print("|---|---|---|---|")
    for sigma in SIGMAS_ALPHA:
        alpha = math.sqrt(2.0) * math.tan(sigma)
        effect = "top_roughness" if alpha < 0.5 else "ground_top"
        rough = scene.edited(add(effect, scene, {f"{effect}_alpha": alpha}))
        alone = f'value="${effect}_alpha"/>'
        beckmann = f'{alone}\n    <string name="distribution" value="beckmann"/>'
        rough = scene.edited(rough.unwritten_text.replace(alone, beckmann, 1))
        run = Run(photons=4_000_000)
        ours = [
            mcrim.simulate(rough.with_overrides({**COEFFICIENTS, "n_gap": n}), run=run).eta
            for n in (1.0, 1.46)
        ]
        theirs = [in_geant4(__file__, photons, sigma_alpha=sigma, n_gap=n)[0] for n in (1.0, 1.46)]
        cells = [f"{a:.4f}, {g:.4f}, {a / g:.3f}" for a, g in (theirs, ours)]
        print(f"| {sigma:g} | {alpha:.3f} | {cells[0]} | {cells[1]} |", flush=True)


if __name__ == "__main__":
    sys.exit(terminal.run(main, "unified"))
