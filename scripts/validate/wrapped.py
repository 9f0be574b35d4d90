"""Wrapped benches that are shipped, in Geant4 and here.

    python scripts/validate/wrapped.py [--precision 0.0015]

prints a table of Markdown: eta of a bar in Teflon and in mirror foil on a silicon photomultiplier,
and of a cylinder in Teflon on a photomultiplier, dry and with grease, and photons per second of a
processor. The film of air is a volume there, the wrapping the border between it and a foil. Geant4
follows polarisation, as it does where nobody interferes. It needs geant4_pybind.
"""

import math
import sys
import time
from dataclasses import fields
from pathlib import Path

import click
from unified import in_geant4, job_of, trace_and_end

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.transport.simulation import Simulation

sys.path.insert(0, str(Path(__file__).parents[1]))
#: Shipped scenes, and how their wrapping reflects in Geant4's words.
SCENES = {
    "lyso_teflon.xml": "groundfrontpainted",
    "lyso_esr.xml": "polishedfrontpainted",
    "bgo_cylinder.xml": "groundfrontpainted",
}
COUPLINGS = {"air": {"n_gap": 1.0}, "grease": {}}
#: What is around the film, and what has the detector in it. They have no index: there light ends.
FOIL, CHIP = "foil", "chip"
FILM, FOIL_MM = "film", 0.01


def bench_of(scene: str, coupling: str) -> SceneFile:
    return read_scene(scene_path(scene)).with_overrides(COUPLINGS[coupling])


def work(scene: str, coupling: str, photons: int) -> None:
    """Trace, and print how many are detected."""
    import geant4_process as process
    import geant4_pybind as g4

    values = dict(bench_of(scene, coupling).parameters)
    diameter_mm = values.get("crystal_diameter_mm")
    film_mm, rim_mm = values["film_mm"], values.get("dead_rim_mm", 0.0)

    class WrappedBench(process.BenchConstruction):
        def Construct(self):
            world = super().Construct()
            self._paint(FILM, FOIL, getattr(g4, SCENES[scene]), values["wrap_reflectance"])
            if rim_mm:
                self._paint("window", CHIP, g4.groundfrontpainted, values["rim_reflectance"])
            return world

        def _slab(self, name, material, half, bottom, top, mother):
            if name == process.CRYSTAL:
                foot, height = bottom, top - bottom
                # each flush at its foot with what is around it
                for part, medium, thick in (
                    (FOIL, self._material(FOIL), film_mm + FOIL_MM),
                    (FILM, mother.GetMaterial(), film_mm),
                ):
                    high = height + thick
                    mother = super()._slab(part, medium, half + thick, foot, foot + high, mother)
                    foot = -high / 2.0
                bottom, top = foot, foot + height
            elif name == process.DETECTOR and rim_mm:
                mother = super()._slab(CHIP, self._material(CHIP), half, bottom, top, mother)
                half, bottom, top = half - rim_mm, 0.0, (top - bottom) / 2.0
            return super()._slab(name, material, half, bottom, top, mother)

        def _solid(self, name, half, half_height):
            if diameter_mm and name in (FOIL, FILM, process.CRYSTAL, "gap"):
                return g4.G4Tubs(name, 0.0, half, half_height, 0.0, 2.0 * math.pi)
            return super()._solid(name, half, half_height)

        def _paint(self, before, behind, finish, reflectance):
            """Let what light of one volume meets at another reflect a part, and absorb the rest."""
            pair = [
                kept
                for name in (before, behind)
                for kept in self._kept
                if isinstance(kept, g4.G4PVPlacement) and kept.GetName() == name
            ]
            kind = g4.dielectric_dielectric
            paint = self._keep(g4.G4OpticalSurface(behind, g4.unified, finish, kind))
            paint.SetMaterialPropertiesTable(self._properties({"REFLECTIVITY": reflectance}))
            self._keep(g4.G4LogicalBorderSurface(behind, *pair, paint))

    class Births(process.Geant4Source):
        def __init__(self, bench, run):
            super().__init__(bench, run)
            where = self._source.GetCurrentSource().GetPosDist()
            if diameter_mm:
                where.SetPosDisShape("Cylinder")
                where.SetRadius(diameter_mm / 2.0)

    process.BenchConstruction, process.Geant4Source = WrappedBench, Births
    names = {field.name for field in fields(Bench)} & values.keys()
    bench = {"crystal_width_mm": diameter_mm} | {name: values[name] for name in names}
    trace_and_end(Bench(**bench), photons, depolarize=False)


@click.command()
@click.option(
    "--precision",
    type=options.Precision(),
    default="0.15%",
    show_default=True,
    help="Of eta in Geant4.",
)
@job_of(work)
def main(precision: float) -> None:
    """Wrapped benches that are shipped, in Geant4 and here."""
    print("| scene | gap | Mitsuba | Geant4 | difference | z | photons/s of a processor |")
    print("|---|---|---|---|---|---|---|")
    for scene in SCENES:
        for coupling in COUPLINGS:
            simulation = Simulation(bench_of(scene, coupling))
            simulation.collect(1_000_000)  # compiles
            began = time.process_time()
            ours = simulation.collect(16_000_000, seed=1)
            our_rate = ours.photons / (time.process_time() - began)
            photons = round((1.0 / ours.eta - 1.0) / precision**2)
            eta, rate = in_geant4(__file__, photons, scene=scene, coupling=coupling)
            error = math.sqrt(eta * (1.0 - eta) / photons)
            sigma = math.hypot(error, ours.eta_sigma)
            cells = (
                scene,
                coupling,
                f"{ours.eta:.5f} ± {ours.eta_sigma:.5f}",
                f"{eta:.5f} ± {error:.5f}",
                f"{100 * (ours.eta / eta - 1.0):+.2f} ± {100 * sigma / eta:.2f} %",
                f"{(ours.eta - eta) / sigma:+.1f}",
                f"{our_rate / 1e6:.2f} million, {rate / 1e3:.1f} thousand: {our_rate / rate:.0f}",
            )
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    sys.exit(terminal.run(main, "wrapped"))
