"""Blind checks of docs/measured_elsewhere.md: benches with something hidden, and what is said.

    python scripts/measured_blind.py gagg | pixel [--results FOLDER] [--campaigns N] [--photons N]
                                                  [--error 5%]

The independent tracer reads a bench of somebody else's with a hidden cause, at the errors of the
real campaign; a diagnosis is to say what it is. `gagg`: the bar with six finishes. `pixel`: the
LSO pixel against depth, with two lines. What is done goes into FOLDER, in a folder for the bench
and its errors, and is not done again: readings N.csv and what is said N.json, with a number of
photons N_PHOTONS.json. A table of Markdown is printed in the end.
"""

from __future__ import annotations

import functools
import io
import json
import sys
import tempfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np
from measured_elsewhere import FINISHES, GAGG, PIXEL, campaign_in

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import make_folder, write_bytes, write_text
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

NOTHING = "none"
#: What is hidden in the GAGG bar: its sizes, and the effects that may stand for it.
OF_BAR: dict[str, tuple[float, float, set[str]]] = {
    "ground_loss": (0.05, 0.3, {"ground_loss"}),
    "wrap_contact": (0.05, 0.4, {"wrap_contact"}),
    "surface_absorption": (0.005, 0.03, {"surface_absorption"}),
    "detector_reflection": (0.1, 0.4, {"detector_reflection", "detector_specular"}),
    NOTHING: (0.0, 0.0, set()),
}
#: The same of the pixel. Its far face is ground and loses light; depth's zero is off by
#: millimetres, either way; of two treatments the labels are exchanged.
FAR_FACE, ZERO, MISLABELLED = "lossy far face", "source_z_mm", "mislabelled"
OF_PIXEL: dict[str, tuple[float, float, set[str]]] = {
    "nonlinearity": (0.2, 1.2, {"nonlinearity"}),
    "wrap_contact": (0.05, 0.4, {"wrap_contact"}),
    FAR_FACE: (0.05, 0.3, {"ground_top", "top_roughness"}),
    "surface_absorption": (0.002, 0.02, {"surface_absorption"}),
    ZERO: (0.5, 1.0, {"wrong:source_z_mm"}),
    MISLABELLED: (0.0, 0.0, set()),
}
#: Of these causes that change no bench.
OF_READINGS = ("nonlinearity", ZERO, MISLABELLED)
#: And those that cost no light of their own.
OF_DETECTOR = ("nonlinearity", MISLABELLED)
#: Photons of the tracer for a reading of the bar, an error of 0.5 % beside 5 %; and of the pixel,
#: 0.2 % beside 0.7 %.
PHOTONS_OF_BAR, PHOTONS_OF_PIXEL = 60_000, 250_000
#: Scattering and absorption, 1/cm, with which the pixel is traced; others are reweighted.
REFERENCE = 0.04, 0.005
#: Pulse height of the first reading of the pixel, V.
FIRST_V = 0.45


def with_cause(scene: SceneFile, cause: str, size: float) -> SceneFile:
    """The scene with an effect of one parameter, where it acts in it: what is not ground loses
    nothing as ground faces do."""
    if not catalogue()[cause].acts_in(scene):
        return scene
    (parameter,) = catalogue()[cause].parameters
    return scene.edited(add(cause, scene)).with_overrides({parameter.name: size})


def bar_readings(cause: str, size: float, seed: int, share: float) -> str:
    """The six readings by the independent tracer with such errors, as a measurement file."""
    rng = np.random.default_rng(seed)
    alpha, etas = rng.uniform(0.2, 0.8), []
    values = {"alpha_scat_per_cm": rng.uniform(0.01, 0.08), "alpha_abs_per_cm": 0.0155}
    for number, faces in enumerate(FINISHES.values()):
        scene = read_scene(GAGG / "gagg.xml")
        for face in faces:
            scene = scene.edited(add(f"ground_{face}", scene))
        scene = scene if cause == NOTHING else with_cause(scene, cause, size)
        values |= {f"ground_{face}_alpha": alpha for face in faces}
        of_scene = {name: value for name, value in values.items() if name in scene.parameters}
        etas.append(trace(scene.with_overrides(of_scene), PHOTONS_OF_BAR, seed + number).eta)
    header, *rows = (GAGG / "gagg.csv").read_text().splitlines()[-7:]
    lines = [header]
    for row, eta in zip(rows, etas, strict=True):
        cells = row.split(",")
        signal = eta / etas[0] * (1.0 + share * rng.standard_normal())
        lines.append(",".join([cells[0], f"{signal:.4f}", f"{share * signal:.4f}", *cells[3:]]))
    return "\n".join(lines) + "\n"


@functools.cache
def pixel_bench(cause: str, size: float) -> SceneFile:
    """The pixel's scene with what is hidden in it, where that is in the scene."""
    scene = mcrim.read_campaign(PIXEL / "lso_pixel.toml").scene
    if cause == FAR_FACE:
        scene = scene.edited(add("ground_top", scene)).with_overrides({"ground_top_alpha": 0.3})
        return with_cause(scene, "ground_loss", size)
    return scene if cause == NOTHING else with_cause(scene, cause, size)


@functools.cache
def histories_of(
    cause: str, size: float, without: str, place: float, kept: Path
) -> tuple[np.ndarray, ...]:
    """Scatterings and paths of the light that a pixel detects, kept in a folder."""
    name = f"{cause} {size} {without} {place}"
    file = kept / f"{name}.npz".replace(" ", "_")
    if not file.exists():
        values = {"ptfe_without": without, "source_z_mm": place}
        values |= {ALPHA_SCAT: REFERENCE[0], ALPHA_ABS: REFERENCE[1]}
        scene = pixel_bench(cause, size).with_overrides(values)
        seed = zlib.crc32(name.encode())
        light = trace(scene, PHOTONS_OF_PIXEL, seed, histories=True).histories
        assert light is not None
        columns = light.scatterings, light.scattering_path_cm, light.path_cm
        content = io.BytesIO()
        np.savez(content, *(column.astype(np.float32) for column in columns))
        write_bytes(file, content.getvalue())
    with np.load(file) as arrays:
        return tuple(arrays.values())


def pixel_eta(light: tuple[np.ndarray, ...], coefficients: tuple[float, float]) -> float:
    """Efficiency with other coefficients, 1/cm, than light was traced with."""
    scatterings, scattering_path, path = light
    (scat, loss), (from_scat, from_loss) = coefficients, REFERENCE
    weights = (scat / from_scat) ** scatterings
    weights *= np.exp(-(scat - from_scat) * scattering_path - (loss - from_loss) * path)
    return float(weights.sum(dtype=float)) / PHOTONS_OF_PIXEL


def pixel_readings(cause: str, size: float, seed: int, kept: Path) -> str:
    """The pixel's readings by the independent tracer, with its errors, as a measurement file."""
    rng = np.random.default_rng(seed)
    readings = mcrim.read_campaign(PIXEL / "lso_pixel.toml").measurements.readings
    coefficients = rng.uniform(0.01, 0.08), rng.uniform(0.005, 0.04)
    shift = size if cause == ZERO else 0.0
    bench = (NOTHING, 0.0) if cause in OF_READINGS else (cause, size)
    bend = size if cause == "nonlinearity" else 0.0
    names = list(dict.fromkeys(reading.group for reading in readings))
    label_of = {name: name for name in names}
    if cause == MISLABELLED:
        first, second = rng.permutation(len(names))[:2]
        label_of |= {names[first]: names[second], names[second]: names[first]}
    of_group = {name: 1.0 + 0.05 * rng.standard_normal() for name in names}

    def eta_of(reading: Reading) -> float:
        # what was done to its crystal is what another label says
        done = next(r for r in readings if r.group == label_of[reading.group])
        place = float(reading.parameters["source_z_mm"]) + shift
        without = str(done.parameters.get("ptfe_without", "none"))
        return pixel_eta(histories_of(*bench, without, place, kept), coefficients)

    height = FIRST_V / (1.0 - FIRST_V * bend) / eta_of(readings[0])
    lines = [",".join(x) for x in table_of(PIXEL / "lso_pixel.csv")[:1]]
    for cells, reading in zip(table_of(PIXEL / "lso_pixel.csv")[1:], readings, strict=True):
        light = height * eta_of(reading) * (reading.energy_keV or 511.0) / 511.0
        share = reading.sigma / reading.signal
        signal = light / (1.0 + bend * light) * of_group[reading.group]
        signal *= 1.0 + share * rng.standard_normal()
        lines.append(",".join([cells[0], f"{signal:.4f}", f"{share * signal:.4f}", *cells[3:]]))
    return "\n".join(lines) + "\n"


def table_of(path: Path) -> list[list[str]]:
    """Cells of a measurement file, its header first."""
    lines = path.read_text().splitlines()
    return [line.split(",") for line in lines if not line.startswith("#")]


def judged(path: Path, photons: int | None) -> dict[str, Any]:
    """What a diagnosis says of a campaign."""
    diagnosis = mcrim.diagnose(path, photons=photons)
    offsets = {each.tolerance.number.name: each for each in diagnosis.baseline.offsets}
    zero = offsets.get(ZERO)
    return {
        "verdict": diagnosis.verdict,
        "chi2": diagnosis.baseline.chi2,
        "ndf": diagnosis.baseline.ndf,
        "leading": sorted({name for names in diagnosis.leading_sets for name in names}),
        "suspects": [suspect.words for suspect in diagnosis.suspect_readings],
        "credible": credible_of(diagnosis.probabilities),
        "zero": None if zero is None else [zero.offset, zero.sigma],
    }


def credible_of(probabilities: Mapping[str, float]) -> list[str]:
    """The fewest explanations that hold 95 % of the probability, `+` between their causes."""
    names, shares = zip(*probabilities.items(), strict=True)
    return list(names[: int(np.searchsorted(np.cumsum(shares), 0.95)) + 1])


def is_credible(row: Mapping[str, Any], accepted: set[str]) -> bool:
    """Whether what was hidden is in one of the fewest explanations that hold 95 %."""
    causes = {cause for name in row["credible"] for cause in name.split(" + ")}
    return bool(accepted & causes)


def is_named(row: Mapping[str, Any], accepted: set[str]) -> bool:
    """Whether what was hidden leads, or is among what leads.

    What is within the campaign's tolerances, as depth's zero, is no cause but an offset: it is to
    come back within two of its errors.
    """
    if accepted & {*row["leading"]}:
        return True
    if row["cause"] == NOTHING:
        return row["verdict"] == "adequate"
    if row["cause"] == MISLABELLED:
        return any("swapped labels" in words for words in row["suspects"])
    if row["cause"] == ZERO and row["verdict"] == "adequate":
        offset, sigma = row["zero"]
        return abs(offset - row["size"]) < 2.0 * sigma
    return False


def place_of(bench: str, error: float | None, number: int, photons: int | None) -> tuple[str, str]:
    """Names of a campaign's readings and of what is said of them: all that they depend on."""
    folder = bench if error is None else f"{bench}_{error:g}"
    said = number if photons is None else f"{number}_{photons}"
    return f"{folder}/{number}.csv", f"{folder}/{said}.json"


@click.command()
@click.argument("bench", type=click.Choice(["gagg", "pixel"]))
@click.option("--results", type=Path, metavar="FOLDER", help="Of what is done (default: none).")
@click.option(
    "--campaigns", type=options.Whole(1, 10_000), default=30, show_default=True, help="How many."
)
@options.photons("as diagnose")
@click.option(
    "--error", type=options.Precision(), help="Of the bar's readings; the pixel's have their own."
)
def main(
    bench: str, results: Path | None, campaigns: int, photons: int | None, error: float | None
) -> None:
    """Blind checks of docs/measured_elsewhere.md: benches with something hidden, what is said."""
    of_bar = bench == "gagg"
    if error and not of_bar:
        raise InputError("the pixel's readings have errors of their own", "leave --error out")
    error = (error or 0.05) if of_bar else None
    source, hidden = (GAGG, OF_BAR) if of_bar else (PIXEL, OF_PIXEL)
    rows: list[dict[str, Any]] = []
    rng, sizes = np.random.default_rng(45), list[float]()
    with tempfile.TemporaryDirectory() as temporary:
        kept = results or Path(temporary)
        make_folder(kept / Path(place_of(bench, error, 0, None)[0]).parent)
        for number in range(campaigns):
            cause, (low, high, _) = list(hidden.items())[number % len(hidden)]
            # campaigns whose bench has a cause are of two sizes, of a shift either way; from the
            # second on they share its light
            again = not of_bar and cause not in OF_DETECTOR and number >= 2 * len(hidden)
            sizes.append(sizes[number - len(hidden)] if again else rng.uniform(low, high))
            if cause == ZERO and number // len(hidden) == 1:
                sizes[-1] = -sizes[-1]
            size = sizes[-1]
            readings, result = (kept / name for name in place_of(bench, error, number, photons))
            if not readings.exists():
                seed = 1000 * (number + 1)
                text = (
                    pixel_readings(cause, size, seed, kept)
                    if error is None
                    else bar_readings(cause, size, seed, error)
                )
                write_text(readings, text)
            if not result.exists():
                with tempfile.TemporaryDirectory() as folder:
                    path = campaign_in(Path(folder), source, {}, csv=readings.read_text())
                    said = judged(path, photons)
                write_text(result, json.dumps({"cause": cause, "size": size, **said}))
            rows.append(json.loads(result.read_text()))
    print(
        "| hidden | size | verdict | chi2 as it is | leading | named | among 95 % |\n"
        "|---|---|---|---|---|---|---|"
    )
    for row in rows:
        accepted = hidden[row["cause"]][2]
        named, credible = is_named(row, accepted), is_credible(row, accepted)
        held = f"{'yes' if named or credible else 'no'}, of {len(row['credible'])}"
        chi2 = f"{row['chi2']:.1f} of {row['ndf']}"
        names = ", ".join([*row["leading"][:6], *row["suspects"][:2]])
        cells = row["cause"], f"{row['size']:.3g}", row["verdict"], chi2, names
        print(f"| {' | '.join(cells)} | {'yes' if named else 'no'} | {held} |")


if __name__ == "__main__":
    sys.exit(terminal.run(main, "measured_blind"))
