"""Short rows of docs/measured_elsewhere.md: what others measured or say, what comes of it here.

    python scripts/measured_plausible.py lengths | others [--photons N]

prints a table of Markdown. `lengths`: crystals of the LSO pixel's kind and of five lengths, by what
was found of the pixel. `others`: benches whose dimensions are known in part, as checks of
plausibility; what is assumed stands in the rows.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import click
import numpy as np
from measured_elsewhere import PIXEL, SCENES, replaced

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

#: Transmittances of PTFE sheets by their thickness in mm, 5.6 % each: simop07/
#: swiss_summer_student_program, commit 6bc326c.
SHEETS = {
    0.20: 0.467,
    0.80: 0.217,
    1.55: 0.196,
    2.05: 0.130,
    3.10: 0.105,
    3.60: 0.077,
    4.10: 0.065,
    5.15: 0.058,
}
SHEET_ERROR = 0.056
#: A fibre of BCF-12 that is lit at its far end; core and dimensions as published, attenuation and
#: scattering of a data sheet's order.
FIBRE = {
    "crystal_width_mm": 1.0,
    "crystal_height_mm": 200.0,
    "n_crystal": 1.60,
    "film_mm": 0.1,
    "source_z_mm": 195.0,
    "source_width_mm": 10.0,
    "alpha_scat_per_cm": 0.001,
    "alpha_abs_per_cm": 0.004,
}
#: Bars of 252 x 6 x 2.54 cm, as one of a square of as much circumference; all lengths a tenth.
TENTH = 0.1
BAR = {
    "crystal_width_mm": 43.0 * TENTH,
    "crystal_height_mm": 2520.0 * TENTH,
    "n_crystal": 1.58,
    "film_mm": 0.1,
    "gap_mm": 0.1,
    "window_width_mm": 46.0 * TENTH,
    "dead_rim_mm": 0.0,
    "alpha_scat_per_cm": 0.0,
    "alpha_abs_per_cm": 1.0 / 380.0 / TENTH,
    "source_width_mm": 2.0,
}


def eta_of(scene: SceneFile | Path, photons: int, **values: float) -> float:
    """Light collection efficiency of a bench."""
    return mcrim.simulate(scene, run=Run(photons=photons), **values).eta


def bare(faces: str) -> SceneFile:
    """The pixel's scene without PTFE at some faces."""
    scene = read_scene(PIXEL / "lso_pixel.xml")
    film = r'(<float name="film" value="\$film_mm"/>)'
    return scene.edited(
        replaced(scene.path.read_text(), film, rf'\1\n    <string name="without" value="{faces}"/>')
    )


def row(measured: str, theirs: str, ours: str, difference: str) -> None:
    """Print a row."""
    print(f"| {measured} | {theirs} | {ours} | {difference} |", flush=True)


def others(photons: int | None) -> None:
    """All short rows."""
    number = photons or 200_000
    print("| measured elsewhere | theirs | ours | difference |\n|---|---|---|---|")
    of_couplings(number)
    of_cylinder(number)
    of_fibres(number)
    of_sheets(number // 5)
    of_bars(number)


def of_couplings(photons: int) -> None:
    """LYSO dry over LYSO with grease."""
    teflon = read_scene(SCENES / "lyso_teflon.xml")
    touched = teflon.edited(add("wrap_contact", teflon)).with_overrides({"wrap_contact": 0.12})
    benches = {
        "bare": read_scene(SCENES / "lyso_sipm.xml"),
        "Teflon behind a film": teflon,
        "Teflon that touches 12 %": touched,
    }
    for name, scene in benches.items():
        dry, wet = (eta_of(scene, photons, n_gap=n) for n in (1.0, 1.55))
        measured = f"LYSO on a SiPM, dry over grease of 1.55; here {name}, 3 × 3 × 15 mm"
        row(measured, "0.548", f"{dry / wet:.3f}", f"{dry / wet - 0.548:+.3f}")


def of_cylinder(photons: int) -> None:
    """A wrapped cylinder of Cs2ZrCl6, with and without absorption."""
    bench = {"crystal_diameter_mm": 22.0, "crystal_height_mm": 60.0, "n_crystal": 1.65}
    for absorption in (0.0, 0.01):
        eta = eta_of(
            SCENES / "bgo_cylinder.xml",
            photons,
            **bench,
            wrap_reflectance=0.98,
            alpha_abs_per_cm=absorption,
        )
        measured = f"Cs₂ZrCl₆, 22 × 60 mm in Teflon, light collected; here with {absorption:g} /cm"
        row(measured, "0.81", f"{eta:.3f}", f"{eta - 0.81:+.3f}")


def of_fibres(photons: int) -> None:
    """A fibre without cladding, and one whose far end is cut and not polished."""
    fibre = bare("sides")
    clean = eta_of(fibre, photons, **FIBRE)
    lossy = fibre.edited(add("surface_absorption", fibre))
    for loss in (0.002, 0.0034, 0.005):
        left = eta_of(lossy, photons, **FIBRE, surface_loss=loss) / clean
        measured = (
            f"BCF-12, 1 × 200 mm: no cladding over one that was cleaned; here "
            f"{100 * loss:.2g} % lost at each reflection"
        )
        row(measured, "0.50 ± 0.03", f"{left:.2f}", f"{left - 0.5:+.2f}")
    rough = fibre.edited(add("ground_top", fibre))
    rough = rough.edited(add("ground_loss", rough)).with_overrides({"ground_top_alpha": 0.3})
    for loss in (0.0, 0.35):
        left = eta_of(rough, photons, **FIBRE, ground_loss=loss) / clean
        measured = (
            "fibre, far end not polished, under PTFE; here facets of 0.3 that take "
            f"{100 * loss:.0f} %"
        )
        row(measured, "0.80", f"{left:.2f}", f"{left - 0.8:+.2f}")


def of_sheets(photons: int) -> None:
    """Sheets of PTFE that scatter and do not absorb: one coefficient for all."""
    away = []
    for thickness, theirs in SHEETS.items():
        ours = eta_of(
            SCENES / "spectrophotometer.xml",
            photons,
            crystal_width_mm=40.0,
            crystal_height_mm=thickness,
            n_crystal=1.35,
            alpha_scat_per_cm=85.0,
            alpha_abs_per_cm=0.0,
            beam_axis="z",
            acceptance_deg=90.0,
        )
        away.append((ours / theirs - 1.0) / SHEET_ERROR)
        measured = f"PTFE, {thickness:.2f} mm, transmittance; here 85 /cm, isotropic, n = 1.35"
        row(measured, f"{theirs:.3f} ± 5.6 %", f"{ours:.3f}", f"{100 * (ours / theirs - 1):+.0f} %")
    print(f"chi2 of the sheets: {sum(np.square(away)):.0f} of {len(away) - 1}")


def of_bars(photons: int) -> None:
    """Attenuation lengths of a long bar, by where along it they are fitted."""
    places = np.linspace(0.025, 0.975, 13) * BAR["crystal_height_mm"]
    scene = bare("top sides")
    light = [np.log(eta_of(scene, photons, **BAR, source_z_mm=z)) for z in places.tolist()]
    parts = {"near third": slice(0, 5), "middle third": slice(4, 9), "far third": slice(8, 13)}
    for name, part in parts.items():
        slope = np.polyfit(places[part] / TENTH, light[part], 1)[0]
        middle, ours = name == "middle third", -0.1 / slope
        theirs = "225 cm" if middle else "75 and 485 cm in sum"
        difference = f"{ours - 225:+.0f} cm" if middle else ""
        row(f"plastic, 252 cm, {name}; here 380 cm", theirs, f"{ours:.0f} cm", difference)


def lengths(photons: int | None) -> None:
    """Heights of five lengths, as found of the pixel and with a straight readout."""
    text, table = ((PIXEL / f"lengths.{end}").read_text() for end in ("toml", "csv"))
    benches = {
        "as found of the pixel": text,
        "with a straight readout": replaced(text, r"start = 1\.047", "start = 0"),
        "and nearly clear": replaced(
            replaced(text, r"start = 1\.047", "start = 0"), r"start = 0\.157", "start = 0.02"
        ),
    }
    columns, titles = [], []
    for name, campaign in benches.items():
        with tempfile.TemporaryDirectory() as folder:
            for file in PIXEL.iterdir():
                (Path(folder) / file.name).write_text(file.read_text())
            path = Path(folder) / "lengths.toml"
            path.write_text(campaign)
            fit = mcrim.compare(path, photons=photons)
        columns.append([pulse.model for pulse in fit.rows[::2]])
        titles.append(f"{name}: χ² {fit.chi2:.0f} of {fit.ndf}")
    pulses = [line.split(",") for line in table.splitlines() if line[0].isdigit()]
    print(f"| length | two wrappings | {' | '.join(titles)} |\n|{'---|' * (len(titles) + 2)}")
    for first, second, *models in zip(pulses[::2], pulses[1::2], *columns, strict=True):
        cells = [f"{first[3]} mm", f"{float(first[1]):.3f}, {float(second[1]):.3f} V"]
        print(f"| {' | '.join([*cells, *(f'{model:.3f}' for model in models)])} |")


@click.command()
@click.argument("what", type=click.Choice(["lengths", "others"]))
@options.photons("what compare takes for lengths, 2e5 for others")
def main(what: str, photons: int | None) -> None:
    """Short rows of docs/measured_elsewhere.md: what others measured or say, what comes of it."""
    {"lengths": lengths, "others": others}[what](photons)


if __name__ == "__main__":
    sys.exit(terminal.run(main, "measured_plausible"))
