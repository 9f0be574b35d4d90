"""Raw data to numbers: what histograms, spectra and gammas make of readings and priors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path

import numpy as np

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign import raw_data
from mcrim_mitsuba.campaign.calibration import read_calibration
from mcrim_mitsuba.campaign.entries import SOURCE_DEPTH
from mcrim_mitsuba.campaign.measurements import Measurements, Reading
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.files import inside, read_bytes, sha256
from mcrim_mitsuba.core.numbers import ALPHA_ABS
from mcrim_mitsuba.core.toml_document import TomlDocument
from mcrim_mitsuba.laboratory.calibration import (
    ChannelCalibration,
    combined_photons,
    fit_histogram,
    read_photons,
    window_of,
)
from mcrim_mitsuba.laboratory.histogram import Histogram
from mcrim_mitsuba.laboratory.light_yield import DetectorEfficiency
from mcrim_mitsuba.laboratory.peak import Peak, Repeated
from mcrim_mitsuba.laboratory.peak_shapes import Below
from mcrim_mitsuba.optics.absorption import Absorption
from mcrim_mitsuba.optics.gammas import AttenuationLength
from mcrim_mitsuba.optics.materials import is_known
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Lists of some million events.
LIMIT_MB = 50
#: Digits of the numbers that stand in the place of raw entries: `mcrim reduce` writes them so.
_DIGITS = 6
#: Correlations, and variances of common sources over the largest, that are none.
_LEAST = 1e-4


@dataclass(frozen=True)
class RawFile:
    """A file with raw data."""

    #: What it is for the campaign, such as ``histogram of air``.
    role: str
    path: Path
    #: Of its bytes, hexadecimal.
    sha256: str


@dataclass(frozen=True, eq=False)
class Mounting:
    """One mounting's histogram and its peak."""

    #: Where the measurement file names it, and whether the reading rests on it.
    row: Reading
    histogram: Histogram
    #: None where no peak stands out; such a mounting is not used.
    peak: Peak | None
    #: Whether it agrees with the others; True where it is not used.
    consistent: bool

    @property
    def file(self) -> Path:
        """The histogram's."""
        assert self.row.histogram is not None
        return self.row.histogram


@dataclass(frozen=True, eq=False)
class ReducedReading:
    """A reading from histograms."""

    #: What the campaign has, with the error of `combined` but for a common background's.
    reading: Reading
    #: All of them, those that are not used included.
    mountings: tuple[Mounting, ...]
    #: Mean and errors of the mountings that are used.
    combined: Repeated
    #: (channels,) What the errors of the counts of a common background's run move it by.
    noise: Array

    @property
    def counted(self) -> tuple[Mounting, ...]:
        """The mountings in use; all of them in a reading that is not used."""
        return tuple(m for m in self.mountings if m.row.use or not self.reading.use)


@dataclass(frozen=True, eq=False)
class RawData:
    """All raw data of a campaign, reduced."""

    #: By label; readings that the file gives as numbers are not among them.
    readings: dict[str, ReducedReading]
    efficiency: DetectorEfficiency | None
    absorption: Absorption | None
    #: How deep the source's gammas get.
    source_depth: AttenuationLength | None
    _: KW_ONLY
    #: What they say that the crystal is made of; None where that is no material of the catalogue.
    material: str | None
    #: What stands in the place of raw entries, by its dotted name in the campaign, such as
    #: ``parameters.alpha_abs_per_cm.prior``.
    numbers: dict[str, float] = field(default_factory=dict)
    files: tuple[RawFile, ...] = ()
    #: Of a digitiser's channels; None where histograms are of photoelectrons.
    calibration: ChannelCalibration | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """What there is to draw: ``histograms``, ``calibration``, ``spectra``, ..."""
        absorption = self.absorption
        there = {
            "histograms": self.readings,
            "calibration": self.calibration,
            "spectra": self.efficiency,
            "transmittance": absorption and absorption.spectra,
        }
        return tuple(kind for kind, data in there.items() if data)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader must know before using the numbers."""
        notes = [note for reading in self.readings.values() for note in _notes_on(reading)]
        for reduced in (self.calibration, self.efficiency, self.absorption):
            notes += () if reduced is None else reduced.notes
        return tuple(dict.fromkeys(notes))


# Readings from histograms of photons per event: a peak for each mounting, and their mean.


def _notes_on(reduced: ReducedReading) -> Iterator[str]:
    """What is wrong with the peaks of a reading, or with their mean."""
    label = reduced.reading.label
    for mounting in reduced.counted:
        for warning in mounting.peak.warnings if mounting.peak is not None else ():
            yield f"{mounting.file.name} ({label}): {warning}"
    if len({m.peak.shape for m in reduced.mountings if m.row.use and m.peak is not None}) > 1:
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


def _mounting(
    table: Measurements,
    row: Reading,
    shape: str,
    below: Below,
    calibration: ChannelCalibration | None,
) -> Mounting:
    """A row's histogram with the peak that was fitted in it."""
    file = row.histogram
    assert file is not None
    histogram = read_photons(file, calibration)
    at_window = {"path": table.path, "line": row.line, "column": "window_low"}
    with placed(path=file) if row.window is None else placed(file.name, **at_window):
        window = window_of(histogram, row.window)
        peak = fit_histogram(histogram, shape=shape, window=window, below=below)
    if peak is None and row.use:
        mend = f"measure longer, or leave it out with use = 0 in {table.path.name}"
        raise InputError("no peak stands out of the histogram", mend, path=file)
    return Mounting(row, histogram, peak, consistent=True)


def _reduced_reading(mountings: list[Mounting]) -> ReducedReading:
    """The mean of the mountings in use; of all, in a reading that is not used."""
    used = any(mounting.row.use for mounting in mountings)
    peaks = [
        (place, (mounting.histogram, mounting.peak))
        for place, mounting in enumerate(mountings)
        if mounting.peak is not None and (mounting.row.use or not used)
    ]
    if not peaks:
        row = mountings[0].row
        problem = f"no histogram of {row.label}, which is not used, has a peak either"
        raise InputError(problem, "remove its rows", path=row.histogram)
    with placed(path=mountings[0].file):
        combined, sigma, noise = combined_photons([peak for _, peak in peaks])
    for outlier in combined.outliers:
        place, _ = peaks[outlier]
        mountings[place] = replace(mountings[place], consistent=False)
    reading = replace(
        mountings[0].row, signal=combined.mean, sigma=sigma, use=used, histogram=None, window=None
    )
    return ReducedReading(reading, tuple(mountings), combined, noise)


def _sharing(readings: list[Reading], reduced: Mapping[str, ReducedReading]) -> list[Reading]:
    """Readings with what the noise of their common background makes them share.

    Their covariance is that of its independent sources, the least of which are left out; peaks
    that lie on bins of their own share nothing.
    """
    places = [i for i, reading in enumerate(readings) if reading.label in reduced]
    noises = np.array([reduced[readings[i].label].noise for i in places])
    covariance = noises @ noises.T if noises.size else np.zeros((0, 0))
    sizes = np.sqrt(np.diag(covariance))
    sharing = (np.abs(covariance) > _LEAST * np.outer(sizes, sizes)).sum(axis=1) > 1
    for i in np.flatnonzero(~sharing & (sizes > 0.0)):
        alone = readings[places[i]]
        readings[places[i]] = replace(alone, sigma=math.hypot(alone.sigma, sizes[i]))
    variances, vectors = np.linalg.eigh(covariance[np.ix_(sharing, sharing)])
    clear = variances > _LEAST * variances.max(initial=0.0)
    for i, shared in zip(
        np.flatnonzero(sharing), vectors[:, clear] * np.sqrt(variances[clear]), strict=True
    ):
        digits = tuple(float(f"{of:.{_DIGITS}g}") for of in shared)
        readings[places[i]] = replace(readings[places[i]], shared=digits)
    return readings


# All of them, and the numbers in their place.


def reduce_raw_data(
    document: TomlDocument, table: Measurements, scene: SceneFile
) -> tuple[TomlDocument, Measurements, RawData | None]:
    """The campaign with numbers for raw entries, readings for histograms, and what was reduced.

    The last is None where there is nothing to reduce.
    Raises InputError with the line, if an entry or a file with raw data cannot be used.
    """
    raw_data.refuse_misplaced(document)
    shape, below = raw_data.read_peaks(document)
    efficiency = raw_data.read_efficiency(document.table(schema.YIELD_TABLE))
    light = None if efficiency is None else efficiency.light
    absorption = raw_data.read_absorption(document, light, scene)
    source_depth = raw_data.read_source_depth(document)
    calibration = read_calibration(document)
    energies = {
        name: document.table(f"{schema.SAMPLES}.{name}.{schema.YIELD_TABLE}").number("energy_keV")
        for name in document.table(schema.SAMPLES)
    }
    mountings, readings, reduced = {}, [], {}
    for row in table.readings:
        if row.histogram is not None:
            energy = row.energy_keV or energies.get(row.sample) or below.energy_keV
            asked = replace(below, energy_keV=energy)
            mountings[row.line] = _mounting(table, row, shape, asked, calibration)
    for label, rows in table.by_label.items():
        reading = rows[0]
        if calibration is not None and reading.histogram is None and not reading.of_beam:
            problem = (
                f"{label} is a number beside [{schema.CALIBRATION_TABLE}], whose errors all share"
            )
            mend = "name its histogram, or make it a campaign of its own"
            raise table.refusal(reading, "signal", problem, mend)
        if reading.histogram is not None:
            reduced[label] = _reduced_reading([mountings[row.line] for row in rows])
            reading = reduced[label].reading
        readings.append(reading)
    measurements = table.with_readings(_sharing(readings, reduced))
    if not (reduced or efficiency or absorption or source_depth):
        return raw_data.with_numbers(document, {}), measurements, None
    of_slab = document.table(f"parameters.{ALPHA_ABS}").get("n")
    names = source_depth and source_depth.formula, of_slab
    material = next((n for n in names if isinstance(n, str) and is_known(n)), None)
    raw = RawData(
        reduced, efficiency, absorption, source_depth, material=material, calibration=calibration
    )
    raw = replace(raw, numbers=_numbers(document, raw), files=tuple(_files(raw)))
    return raw_data.with_numbers(document, raw.numbers), measurements, raw


def _numbers(document: TomlDocument, raw: RawData) -> dict[str, float]:
    """What a plain campaign has in the place of raw entries."""
    numbers, priors = dict[str, float](), []
    if raw.absorption is not None:
        priors.append((ALPHA_ABS, raw.absorption.alpha_abs_per_cm, raw.absorption.sigma))
    if raw.source_depth is not None:
        depth = raw.source_depth
        priors.append((SOURCE_DEPTH, depth.length_mm, depth.sigma_mm))
    for name, value, sigma in priors:
        key = f"parameters.{name}"
        numbers |= {f"{key}.prior": value, f"{key}.prior_sigma": sigma}
        if "start" not in document.table(key):
            numbers[f"{key}.start"] = value
    if raw.efficiency is not None:
        numbers["light_yield.detector_efficiency"] = raw.efficiency.value
        numbers["light_yield.detector_efficiency_sigma"] = raw.efficiency.sigma
    if raw.calibration is not None:
        key = schema.CALIBRATION_TABLE
        numbers[f"{key}.{schema.SCALE_SIGMA}"] = raw.calibration.scale_sigma
        numbers[f"{key}.{schema.OFFSET_SIGMA}"] = raw.calibration.offset_sigma
    return {name: float(f"{value:.{_DIGITS}g}") for name, value in numbers.items()}


def _files(raw: RawData) -> Iterator[RawFile]:
    """All raw files with what they are and their SHA-256."""
    # spectra first: where a report has no room for all of them, histograms are cut
    named: list[tuple[str, Path]] = []
    if raw.efficiency is not None:
        named += [
            ("emission spectrum", Path(raw.efficiency.emission.name)),
            ("quantum efficiency", Path(raw.efficiency.quantum_efficiency.name)),
        ]
    if raw.absorption is not None:
        named += [("transmittance", Path(curve.name)) for curve in raw.absorption.spectra]
    if (of := raw.calibration) is not None:
        runs = (of.gain.spectrum, of.pedestal_run, of.background)
        roles = ("single photoelectrons", "pedestal", "background")
        named += [(role, run.path) for role, run in zip(roles, runs, strict=True) if run]
    for label, reading in raw.readings.items():
        named += [(f"histogram of {label}", mounting.file) for mounting in reading.mountings]
    for role, of_role in named:
        path, _ = inside(of_role)
        yield RawFile(role, path, sha256(read_bytes(path, LIMIT_MB)))
