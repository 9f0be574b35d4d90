"""Makes scenes/camoo4_raw: the article's measurement as a laboratory would have it on its disk.

    python scripts/make_raw_example.py [FOLDER]

The article prints its numbers, not its raw data. These are SYNTHETIC: histograms, spectra and
transmittances from which its numbers come out again (14.3 ± 0.2 and 24.5 ± 0.4 photons, 0.127 with
10 % error, 76 % at 540 nm), in the formats that instruments and spreadsheets really write. The
same seed makes the same bytes. Campaigns and the table of mountings, written by hand, are copied.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.article import published
from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import is_there, make_folder, write_bytes
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum
from mcrim_mitsuba.optics.slab_transmittance import measured_transmittance
from mcrim_mitsuba.optics.spectrum import Spectrum, weighted_mean

FOLDER = Path(__file__).parents[1] / "scenes" / "camoo4_raw"
SEED = 20130602
EVENTS = 20_000
#: How four mountings of one coupling deviate, in units of the error of their mean.
DEVIATIONS = np.array([0.1, -1.9, 2.4, -0.6])
#: And how they are written.
KINDS = {"air": ("csv", "events", "csv", "csv"), "gel": ("csv", "excel", "tabs", "csv")}
#: Emission of CaMoO4 at room temperature: a broad band, nm.
EMISSION_NM = np.arange(420.0, 751.0, 5.0)
EMISSION_MAXIMUM_NM, EMISSION_FWHM_NM = 540.0, 130.0
#: A bialkali cathode as read off a maker's plot, before it is scaled to the article's efficiency,
#: and the relative error of reading a point.
CATHODE_NM = np.array([350.0, 400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0, 750.0])
CATHODE = np.array([0.27, 0.275, 0.245, 0.185, 0.105, 0.050, 0.017, 0.004, 0.001])
READING_OFF = 0.16
#: Internal transmittance of 10 mm at the ends of the spectra and at 540 nm; three orientations.
TRANSMITTANCE_NM = np.arange(400.0, 751.0, 5.0)
KNOTS_NM = (400.0, 540.0, 650.0, 750.0)
INTERNAL = (
    (0.930, 0.9415, 0.962, 0.963),
    (0.945, 0.954, 0.974, 0.975),
    (0.960, 0.966, 0.986, 0.987),
)
TRANSMITTANCE_NOISE = 0.0005
BY_HAND = ("campaign.toml", "campaign_source_depth.toml", "mountings.csv")
SYNTHETIC = "SYNTHETIC, not measured: made by scripts/make_raw_example.py"


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), default=FOLDER)
def main(folder: Path) -> None:
    """Write the raw example to FOLDER, a new one (default: that of scenes/, written anew)."""
    if folder != FOLDER and is_there(folder) and (folder.is_file() or any(folder.iterdir())):
        raise InputError("something is there already", "name a new folder", path=folder)
    write_example(folder)


def write_example(folder: Path) -> None:
    """Write all files of the example; the folder is made if it is not there."""
    make_folder(folder)
    random = np.random.default_rng(SEED)
    for name, signal in (("air", published.SIGNAL_AIR), ("gel", published.SIGNAL_GEL)):
        _write_histograms(folder, name, signal.value, signal.sigma, random)
    # a Gaussian of energy, whose full width is that of the band in wavenumbers
    half = EMISSION_FWHM_NM / 2
    width_per_cm = 1e7 / (EMISSION_MAXIMUM_NM - half) - 1e7 / (EMISSION_MAXIMUM_NM + half)
    emission = np.exp(
        -4 * np.log(2) * ((1e7 / EMISSION_NM - 1e7 / EMISSION_MAXIMUM_NM) / width_per_cm) ** 2
    )
    _write_emission(folder / "emission.csv", emission, random)
    _write_cathode(folder / "quantum_efficiency.csv", emission)
    for number, internal in enumerate(INTERNAL, start=1):
        _write_transmittance(folder / f"transmittance_{number}.csv", number, internal, random)
    for name in BY_HAND:
        write_bytes(folder / name, (FOLDER / name).read_bytes())


def mounting_means(mean: float, sigma: float) -> NDArray[np.float64]:
    """(mountings,) photons whose mean is `mean` and whose scatter gives it the error `sigma`."""
    deviations = DEVIATIONS - DEVIATIONS.mean()
    error = deviations.std(ddof=1) / np.sqrt(deviations.size)
    return mean + sigma * deviations / error


def _write_histograms(
    folder: Path, name: str, mean: float, sigma: float, random: np.random.Generator
) -> None:
    means = mounting_means(mean, sigma)
    for number, (mounting, kind) in enumerate(zip(means, KINDS[name], strict=True), start=1):
        spectrum = PhotonSpectrum(round(float(mounting), 3), EVENTS)
        comments = [
            f"photons per event, CaMoO4, 59.5 keV of Am-241, {name} in the gap, mounting {number}, "
            "10 minutes",
            f"mean of the band {spectrum.mean_photons:g} photons, {EVENTS} events",
        ]
        lines = _lines_of(kind, spectrum.photons(), spectrum.sample(random))
        _write(folder / f"{name}_{number}.csv", comments, lines, excel=kind == "excel")


def _lines_of(kind: str, photons: NDArray, counts: NDArray) -> list[str]:
    """A histogram as CSV, as tabs, or as Excel writes CSV in most of Europe; or of its events each.

    Events are the numbers of photons, one a line, as the electronics saw them.
    """
    pairs = list(zip(photons, counts, strict=True))
    if kind == "events":
        events = np.repeat(photons, counts.astype(int))
        np.random.default_rng(SEED).shuffle(events)
        return [f"{n:g}" for n in events]
    if kind == "tabs":
        return [f"{n:g}\t{c:g}" for n, c in pairs]
    if kind == "excel":
        rows = [f"{n:.1f};{c:.0f}".replace(".", ",") for n, c in pairs]
        return ["photons per event;events", *rows]
    return ["photons_per_event,events", *(f"{n:g},{c:g}" for n, c in pairs)]


def _write_emission(path: Path, emission: NDArray[np.float64], random: np.random.Generator) -> None:
    """From a grating spectrometer that scans downwards: tabs, descending wavelengths."""
    counts = 10_000 * emission
    measured = np.maximum(counts + random.normal(0, np.sqrt(counts + 20)), 0)
    rows = [
        f"{nm:.1f}\t{value:.1f}\t{0.05 * value + 10:.1f}"
        for nm, value in zip(EMISSION_NM[::-1], measured[::-1], strict=True)
    ]
    comments = [
        "emission of CaMoO4 at room temperature, corrected for the spectrometer's response",
        "errors: 5 % of the correction, and the counting",
    ]
    _write(path, comments, ["Wavelength (nm)\tIntensity (counts)\tsigma", *rows])


def _write_cathode(path: Path, emission: NDArray[np.float64]) -> None:
    """Read off a plot into a spreadsheet: per cent, semicolons, decimal commas."""
    curve = (
        CATHODE
        * published.EFFICIENCY.value
        / weighted_mean(Spectrum(EMISSION_NM, emission), Spectrum(CATHODE_NM, CATHODE)).value
    )
    rows = [
        f"{nm:g};{100 * value:.3g};{100 * READING_OFF * value:.2g}".replace(".", ",")
        for nm, value in zip(CATHODE_NM, curve, strict=True)
    ]
    comment = f"quantum efficiency of a bialkali tube, read off a plot; errors {READING_OFF:.0%}"
    head = "wavelength (nm);quantum efficiency (%);sigma (%)"
    _write(path, [comment.replace("%", " %") + " a point"], [head, *rows], excel=True)


def _write_transmittance(
    path: Path, number: int, internal: Iterable[float], random: np.random.Generator
) -> None:
    """From a spectrophotometer, which scans from red to blue."""
    of_bulk = np.interp(TRANSMITTANCE_NM, KNOTS_NM, internal)
    measured = measured_transmittance(of_bulk, published.N_CRYSTAL.value)
    measured = measured + random.normal(0, TRANSMITTANCE_NOISE, measured.size)
    rows = [
        f"{nm:g},{100 * value:.2f}"
        for nm, value in zip(TRANSMITTANCE_NM[::-1], measured[::-1], strict=True)
    ]
    _write(path, [f"CaMoO4, 10.0 mm, polished, in air; orientation {number}"], ["nm,%T", *rows])


def _write(
    path: Path, comments: Iterable[str], lines: Iterable[str], *, excel: bool = False
) -> None:
    """Excel has a byte order mark and line ends of its own."""
    end = "\r\n" if excel else "\n"
    every = [*(f"# {comment}" for comment in (SYNTHETIC, *comments)), *lines]
    text = "".join(line + end for line in every)
    write_bytes(path, text.encode("utf-8-sig" if excel else "utf-8"))


if __name__ == "__main__":
    sys.exit(terminal.run(main, "make_raw_example"))
