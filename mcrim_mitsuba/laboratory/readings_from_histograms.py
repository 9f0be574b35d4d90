"""Readings from histograms of photons per event: a peak for each mounting, and their mean."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.histogram import Histogram, read_histogram
from mcrim_mitsuba.files.measurement_table import MeasurementTable, Row
from mcrim_mitsuba.files.measurements import Reading, reading_in, reading_of
from mcrim_mitsuba.laboratory.raw_data import Mounting, ReducedReading
from mcrim_mitsuba.physics.peak import Peak, fit_peak
from mcrim_mitsuba.physics.repeats import combine


def reduce_table(
    table: MeasurementTable, shape: str
) -> tuple[tuple[Reading, ...], dict[str, ReducedReading]]:
    """All readings of a measurement file, and what those from histograms were made of.

    Parameters
    ----------
    table : MeasurementTable
    shape : str
        Of the peaks; see `physics.peak.fit_peak`.

    Returns
    -------
    readings : tuple of Reading
        In the order of their first rows.
    reduced : dict of str to ReducedReading
        By label.

    Raises
    ------
    InputError
        If a histogram cannot be read, or has no peak and is used: it names that file.
    """
    mountings = {
        row.line: _mounting(table, row, row.histogram, shape)
        for row in table.rows
        if row.histogram is not None
    }
    readings, reduced = [], {}
    for label, rows in table.by_label.items():
        if rows[0].histogram is None:
            readings.append(reading_in(rows[0]))
            continue
        reduced[label] = _reduced([mountings[row.line] for row in rows])
        readings.append(reduced[label].reading)
    return tuple(readings), reduced


def notes_on(reduced: ReducedReading) -> Iterator[str]:
    """What is wrong with the peaks of a reading, or with their mean."""
    label = reduced.reading.label
    for mounting in reduced.mountings:
        # what is not used harms nobody
        if mounting.peak is not None and (mounting.use or not reduced.reading.use):
            for warning in mounting.peak.warnings:
                yield f"{mounting.file.name} ({label}): {warning}"
    shapes = {m.peak.shape for m in reduced.mountings if m.use and m.peak is not None}
    if len(shapes) > 1:
        yield (
            f"the peaks of {label} were fitted with different shapes, which differ in their "
            "means: name one as shape in [histograms]"
        )
    for mounting in reduced.mountings:
        if not mounting.consistent:
            yield (
                f"{mounting.file.name} ({label}) lies far from the other mountings: look "
                "at it, or leave it out with use = 0"
            )
    # what is said of outliers first is said better by their files' names
    for warning in reduced.combined.warnings[len(reduced.combined.outliers) :]:
        yield f"{label}: {warning}"
    if reduced.combined.ndf and reduced.reading.group_sigma is not None:
        yield (
            f"{label} has a group_sigma beside the scatter of its mountings: what mounting does is "
            "in its error already, and would be counted twice"
        )


def _mounting(table: MeasurementTable, row: Row, file: Path, shape: str) -> Mounting:
    histogram = read_histogram(file)
    peak = _peak(table, row, file, histogram, shape)
    if peak is None and row.use:
        raise InputError(
            "no peak stands out of the histogram",
            f"measure longer, or leave it out with use = 0 in {table.path.name}",
            path=file,
        )
    return Mounting(row, histogram, peak, consistent=True)


def _peak(
    table: MeasurementTable, row: Row, file: Path, histogram: Histogram, shape: str
) -> Peak | None:
    try:
        return fit_peak(histogram.photons, histogram.counts, shape=shape, window=row.window)
    except InputError as error:
        if row.window is not None:
            raise table.refusal(
                row, "window_low", f"{file.name}: {error.problem}", error.mend
            ) from None
        raise InputError(error.problem, error.mend, path=file) from None


def _reduced(mountings: list[Mounting]) -> ReducedReading:
    """The mean of the mountings in use; of all, in a reading that is not used."""
    used = any(mounting.use for mounting in mountings)
    peaks = {
        i: mounting.peak
        for i, mounting in enumerate(mountings)
        if mounting.peak is not None and (mounting.use or not used)
    }
    if not peaks:
        row = mountings[0].row
        raise InputError(
            f"no histogram of {row.label}, which is not used, has a peak either",
            "remove its rows", path=row.histogram,
        )  # fmt: skip
    found = peaks.values()
    combined = combine([p.centroid for p in found], [p.centroid_sigma for p in found])
    places = list(peaks)
    for outlier in combined.outliers:
        place = places[outlier]
        mountings[place] = replace(mountings[place], consistent=False)
    reading = reading_of(mountings[0].row, combined.mean, combined.sigma, use=used)
    return ReducedReading(reading, tuple(mountings), combined)
