"""The GAGG bar of docs/measured_elsewhere.md in our own Geant4, its faces ground by UNIFIED.

    python scripts/validate/unified_bar.py [--photons 20000]

prints a table of Markdown: the part of isotropic light from the crystal's centre that is detected
in optical contact, with sigma_alpha = 0.2, published and here, with three ways to tell UNIFIED what
facets reflect. It needs geant4_pybind.
"""

import sys
from pathlib import Path

import click
from unified import in_geant4, job_of, trace_and_end

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.efficiency.bench import Bench

sys.path.insert(0, str(Path(__file__).parents[1]))
SIGMA_ALPHA = 0.2
MIRRORS, LAMBERT, PUBLISHED = "facets as mirrors", "Lambert", "constants as published"
#: Air before a mirror that a ground top touches at its peaks, mm; and the mirror.
FILM_MM, FOIL_MM, REFLECTANCE = 0.01, 0.1, 0.98
#: Crystal and window as docs/measured_elsewhere.md has them; all that comes through the foot is
#: detected.
BENCH = {
    "crystal_width_mm": 5.75,
    "crystal_height_mm": 20.0,
    "n_crystal": 1.91,
    "alpha_scat_per_cm": 0.0,
    "alpha_abs_per_cm": 0.0155,
    "gap_mm": 0.01,
    "n_gap": 1.52,
    "n_window": 1.52,
    "window_width_mm": 5.75,
    "window_thickness_mm": 0.01,
}


def work(faces: list[str], model: str, photons: int) -> None:
    """Trace, and print how many are detected.

    Facets are `MIRRORS`; or, where all constants of lobes are 0, Geant4 sends what they reflect,
    totally too, by `LAMBERT`'s law; or all is as `PUBLISHED`: no constants at bottom and sides,
    where those of the surface met last stay in force, the foil's or the black wall's.
    """
    import geant4_process as process
    import geant4_pybind as g4

    mirrors = {"SPECULARLOBECONSTANT": 1.0}
    mirrors |= {"SPECULARSPIKECONSTANT": 0.0, "BACKSCATTERCONSTANT": 0.0}

    class GroundBar(process.BenchConstruction):
        def _surface(self, name, ground, kind, values=None):
            finish = g4.ground if ground else g4.polished
            surface = self._keep(g4.G4OpticalSurface(name, g4.unified, finish, kind))
            surface.SetSigmaAlpha(SIGMA_ALPHA)
            if values is not None:
                surface.SetMaterialPropertiesTable(self._properties(values))
            return surface

        def _border(self, surface, *pairs):
            for pair in pairs:
                self._keep(g4.G4LogicalBorderSurface(surface.GetName(), *pair, surface))

        def Construct(self):
            world, published = super().Construct(), model == PUBLISHED
            around, half = world.GetLogicalVolume(), self._bench.crystal_width_mm / 2.0
            top, film = self._bench.crystal_height_mm, 0.0
            if "top" in faces and not published:
                film = FILM_MM
                self._slab("film", around.GetMaterial(), half, top, top + film, around)
            low = top + film
            self._slab("foil", self._material("foil"), half, low, low + FOIL_MM, around)
            if published:
                beside = self._material("beside")
                for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                    self._blacks(beside, x, y, half, top, around)
            placed = {
                each.GetLogicalVolume().GetName(): each
                for each in self._kept
                if isinstance(each, g4.G4PVPlacement)
            }
            crystal, foil, glass = (placed[n] for n in (process.CRYSTAL, "foil", "gap"))
            mirror = {"REFLECTIVITY": REFLECTANCE, "EFFICIENCY": 0.0} | mirrors
            of_foil = self._surface(
                "foil", published and "top" in faces, g4.dielectric_metal, mirror
            )
            self._border(of_foil, *((each, foil) for each in (crystal, placed.get("film")) if each))
            beyond = {"top": placed.get("film"), "side": world, "bottom": glass}
            table = {MIRRORS: mirrors, LAMBERT: dict.fromkeys(mirrors, 0.0)}.get(model)
            for face in faces:
                if beyond[face] is not None:
                    surface = self._surface(face, True, g4.dielectric_dielectric, table)
                    ways = ((crystal, beyond[face]), (beyond[face], crystal))
                    self._border(surface, *ways[: 1 if published else 2])
            return world

        def _blacks(self, material, x, y, half, height, around):
            """A black wall at one side, 0.1 mm off."""
            away, thick = half + 0.1, 0.5
            box = g4.G4Box("wall", *(thick if n else away for n in (x, y)), height / 2.0)
            wall = self._keep(g4.G4LogicalVolume(self._keep(box), material, f"wall {x} {y}"))
            centre = g4.G4ThreeVector(x * (away + thick), y * (away + thick), height / 2.0)
            self._keep(g4.G4PVPlacement(None, centre, wall, f"wall {x} {y}", around, False, 0))
            black = {"REFLECTIVITY": 0.0, "EFFICIENCY": 0.0}
            surface = self._surface(f"wall {x} {y}", False, g4.dielectric_metal, black)
            self._keep(g4.G4LogicalSkinSurface(surface.GetName(), wall, surface))

    class Centre(process.Geant4Source):
        def __init__(self, bench, run):
            super().__init__(bench, run)
            where = self._source.GetCurrentSource().GetPosDist()
            where.SetPosDisType("Point")

    process.BenchConstruction, process.Geant4Source = GroundBar, Centre
    trace_and_end(Bench(**BENCH), photons)


@click.command()
@options.photons("2e4")
@job_of(work)
def main(photons: int | None) -> None:
    """The GAGG bar of docs/measured_elsewhere.md in our own Geant4, its faces ground by UNIFIED."""
    photons = photons or 20_000
    from measured_elsewhere import CENTRE, FINISHES

    models = MIRRORS, LAMBERT, PUBLISHED
    print(f"| finish | published | {' | '.join(models)} |\n|---|---|---|---|---|")
    for (finish, faces), published in zip(FINISHES.items(), CENTRE, strict=True):
        cells = []
        for model in models:
            detected, _ = in_geant4(__file__, photons, faces=faces, model=model)
            error = (detected * (1.0 - detected) / photons) ** 0.5
            cells.append(f"{detected:.4f} ± {error:.4f}")
        print(f"| {finish} | {published:.4f} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    sys.exit(terminal.run(main, "unified_bar"))
