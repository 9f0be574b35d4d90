"""Pictures of a campaign's raw data: histograms, spectra, transmittances."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from mcrim_mitsuba.figures.histograms import (
    FittedHistogram,
    histograms_figure,
    histograms_numbers,
)
from mcrim_mitsuba.figures.spectra import (
    absorption_figure,
    absorption_numbers,
    efficiency_figure,
    efficiency_numbers,
)
from mcrim_mitsuba.figures.style import Numbers, save, write_numbers
from mcrim_mitsuba.laboratory.raw_data import Mounting, RawData, ReducedAbsorption
from mcrim_mitsuba.physics.spectrum import Spectrum

#: Histograms that one picture can show.
MOST_HISTOGRAMS = 8

#: A picture with the numbers behind it.
Drawn = tuple[Figure, Numbers]


def histograms_drawn(raw: RawData) -> Drawn | None:
    """Histograms with their peaks; None where there are none.

    Of too many, the first mounting of every reading; the numbers are those of all.
    """
    every = [_fitted(label, m) for label, one in raw.readings.items() for m in one.mountings]
    if not every:
        return None
    shown = every
    if len(every) > MOST_HISTOGRAMS:
        shown = [_fitted(label, one.mountings[0]) for label, one in raw.readings.items()]
    return histograms_figure(shown[:MOST_HISTOGRAMS]), histograms_numbers(every)


def efficiency_drawn(raw: RawData) -> Drawn | None:
    """Emission and quantum efficiency; None where there are none."""
    if raw.efficiency is None:
        return None
    of = (raw.efficiency.emission, raw.efficiency.quantum_efficiency, raw.efficiency.found)
    return efficiency_figure(*of), efficiency_numbers(*of)


def absorption_drawn(raw: RawData) -> Drawn | None:
    """Transmittances and the coefficient; None where there are no spectra."""
    reduced = raw.absorption
    if reduced is None or not reduced.spectra:
        return None
    named = _named(reduced)
    return (
        absorption_figure(named, reduced.n, reduced.found, reduced.light),
        absorption_numbers(named, reduced.n, reduced.found),
    )


def draw_raw_data(paths: Sequence[str | Path], raw: RawData) -> tuple[Path, ...]:
    """Write the pictures that there are (PNG or PDF), each with its numbers (CSV).

    Parameters
    ----------
    paths : sequence of str or Path
        Of the histograms, of the efficiency and of the absorption.
    raw : RawData

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    written: list[Path] = []
    made = (histograms_drawn(raw), efficiency_drawn(raw), absorption_drawn(raw))
    for path, drawn in zip(paths, made, strict=True):
        if drawn is not None:
            figure, (columns, rows) = drawn
            written += [save(figure, path), write_numbers(path, columns, rows)]
    return tuple(written)


def _fitted(label: str, mounting: Mounting) -> FittedHistogram:
    name = mounting.file.name
    return FittedHistogram(
        name if mounting.use else f"{name} (not used)", mounting.histogram, mounting.peak, label
    )


def _named(reduced: ReducedAbsorption) -> list[tuple[str, Spectrum]]:
    return [
        (path.name, spectrum)
        for path, spectrum in zip(reduced.entry.files, reduced.spectra, strict=True)
    ]
