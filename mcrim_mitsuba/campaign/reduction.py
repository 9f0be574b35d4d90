"""Raw data to numbers: what histograms, spectra and gammas make of readings and priors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from pathlib import Path

from mcrim_mitsuba.campaign.entries import ABSORPTION, SOURCE_DEPTH
from mcrim_mitsuba.campaign.measurements import Measurements, Reading
from mcrim_mitsuba.campaign.raw_data import (
    EfficiencyEntry,
    RawEntries,
    TransmittanceEntry,
    read_raw_entries,
    with_numbers,
)
from mcrim_mitsuba.core.errors import InputError, said_by
from mcrim_mitsuba.core.files import read_bytes, sha256
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.core.toml_document import TomlDocument
from mcrim_mitsuba.laboratory.histogram import Histogram, read_histogram
from mcrim_mitsuba.laboratory.light_yield import DetectorEfficiency, detector_efficiency
from mcrim_mitsuba.laboratory.peak import Peak, Repeated, combine, fit_peak
from mcrim_mitsuba.optics.absorption import (
    EMISSION,
    Absorption,
    Index,
    absorption_from_transmittance,
)
from mcrim_mitsuba.optics.emission_band import index_over
from mcrim_mitsuba.optics.gammas import AttenuationLength, attenuation_length_mm
from mcrim_mitsuba.optics.spectrum import Spectrum, detected_light
from mcrim_mitsuba.optics.spectrum_file import read_spectra, read_spectrum
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.values import read_index

#: Lists of some million events.
LIMIT_MB = 50
#: Of the light inside the sample: no spectrophotometer is as exact.
_SMALLEST_SIGMA = 2e-4
_KEY = f"parameters.{ABSORPTION}"
_CRYSTAL = "n_crystal"
#: Digits of the numbers that stand in the place of raw entries: `mcrim reduce` writes them so.
_DIGITS = 6


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

    #: Where the measurement file names it.
    row: Reading
    histogram: Histogram
    #: None where no peak stands out; such a mounting is not used.
    peak: Peak | None
    #: Whether it agrees with the others; True where it is not used.
    consistent: bool

    @property
    def use(self) -> bool:
        """Whether the reading rests on it."""
        return self.row.use

    @property
    def file(self) -> Path:
        """The histogram's."""
        assert self.row.histogram is not None
        return self.row.histogram


@dataclass(frozen=True, eq=False)
class ReducedReading:
    """A reading from histograms."""

    #: What the campaign has, with the error of `combined`.
    reading: Reading
    #: All of them, those that are not used included.
    mountings: tuple[Mounting, ...]
    #: Mean and errors of the mountings that are used.
    combined: Repeated

    @property
    def counted(self) -> tuple[Mounting, ...]:
        """The mountings in use; all of them in a reading that is not used."""
        return tuple(m for m in self.mountings if m.use or not self.reading.use)


@dataclass(frozen=True, eq=False)
class ReducedEfficiency:
    """The detector's efficiency from spectra: eq. 3 of the article."""

    entry: EfficiencyEntry
    emission: Spectrum
    quantum_efficiency: Spectrum
    found: DetectorEfficiency


@dataclass(frozen=True, eq=False)
class ReducedAbsorption:
    """The absorption coefficient from transmittances."""

    entry: TransmittanceEntry
    #: One per orientation; empty where one number was measured.
    spectra: tuple[Spectrum, ...]
    #: What they are weighted with: the light as the detector sees it.
    light: Spectrum | None
    #: The crystal's index, or a function of the wavelength in nm.
    n: Index
    _: KW_ONLY
    found: Absorption


@dataclass(frozen=True, eq=False)
class RawData:
    """All raw data of a campaign, reduced."""

    #: By label; readings that the file gives as numbers are not among them.
    readings: dict[str, ReducedReading]
    efficiency: ReducedEfficiency | None
    absorption: ReducedAbsorption | None
    #: How deep the source's gammas get.
    source_depth: AttenuationLength | None
    _: KW_ONLY
    #: What stands in the place of raw entries, by its dotted name in the campaign, such as
    #: ``parameters.alpha_abs_per_cm.prior``.
    numbers: dict[str, float]
    files: tuple[RawFile, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """What there is to draw: ``histograms``, ``spectra``, ``transmittance``."""
        absorption = self.absorption
        there = {
            "histograms": self.readings,
            "spectra": self.efficiency,
            "transmittance": absorption and absorption.spectra,
        }
        return tuple(kind for kind, data in there.items() if data)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader must know before using the numbers."""
        notes = [note for reading in self.readings.values() for note in _notes_on(reading)]
        if (efficiency := self.efficiency) is not None:
            notes += efficiency.emission.notes
            notes += efficiency.quantum_efficiency.notes
            notes += efficiency.found.notes
        if (absorption := self.absorption) is not None:
            notes += [note for spectrum in absorption.spectra for note in spectrum.notes]
            notes += absorption.found.notes
        return tuple(dict.fromkeys(notes))


def _reduce_transmittance(
    document: TomlDocument, entry: TransmittanceEntry, light: Spectrum | None, scene: SceneFile
) -> ReducedAbsorption:
    """Eq. 4 of the article with the files, or the number, of a campaign.

    `light`, as the detector of ``[light_yield]`` sees it, is what spectra are weighted with; the
    scene has the crystal's index where the entry gives none.
    """
    spectra = tuple(read_spectra(entry.files, "transmittance"))
    of_curve = entry.n is not None and not isinstance(entry.n, float) and "@" not in entry.n
    if light is None and (spectra or of_curve):
        problem = "a spectrum says nothing of the crystal's own light without its emission"
        mend = "add emission and quantum_efficiency to [light_yield], or give plain numbers"
        raise document.refusal(f"{_KEY}.{'transmittance' if spectra else 'n'}", problem, mend)
    n, n_sigma, notes = _index(document, entry, scene, light)
    numbers = () if entry.value is None else (entry.value,)
    try:
        absorption = absorption_from_transmittance(
            spectra or numbers,
            n,
            entry.thickness_mm,
            transmittance_sigma=entry.transmittance_sigma,
            n_sigma=n_sigma,
            thickness_sigma_mm=entry.thickness_sigma_mm,
            emission=light,
        )
    except InputError as error:
        if error.path is not None:
            raise
        raise document.refusal(f"{_KEY}.transmittance", error.problem, error.mend) from None
    # the emission only weights: its noise is no error of the readings
    parts = [part for origin, part in absorption.contributions.items() if origin != EMISSION]
    sigma = math.hypot(*parts)
    if sigma * entry.thickness_mm / MM_PER_CM < _SMALLEST_SIGMA:
        raise document.refusal(
            f"{_KEY}.transmittance",
            f"the absorption coefficient comes with an error of {sigma:.1g} /cm, less than any "
            "spectrophotometer's"
            if sigma > 0
            else "the absorption coefficient comes without any error",
            "give transmittance_sigma, the error that all readings share, or errors as a column of "
            "the spectra",
        )
    absorption = replace(absorption, notes=(*absorption.notes, *notes))
    return ReducedAbsorption(entry, spectra, light, n, found=absorption)


def _index(
    document: TomlDocument, entry: TransmittanceEntry, scene: SceneFile, light: Spectrum | None
) -> tuple[Index, float, tuple[str, ...]]:
    """The crystal's index, a number or a function of the wavelength, its error, and notes."""
    if isinstance(entry.n, float):
        return entry.n, entry.n_sigma, ()
    if entry.n is None:
        index = scene.parameters.get(_CRYSTAL)
        if not isinstance(index, float):
            problem = f"{scene.path.name} has no {_CRYSTAL}"
            mend = 'give the crystal\'s index: n = 2.01, or a material such as n = "CaMoO4"'
            raise document.refusal(f"{_KEY}.transmittance", problem, mend)
        named = scene.materials.get(_CRYSTAL)
        return index, 0.0 if named is None else named.material.sigma, ()
    try:
        if "@" in entry.n:
            named = read_index("n", entry.n, document.path.parent)
            return named.value, named.material.sigma, ()
        assert light is not None  # without it an index over wavelengths was refused
        band = index_over(entry.n, light)
    except InputError as error:
        if error.path is not None:
            raise
        raise document.refusal(f"{_KEY}.n", error.problem, error.mend) from None
    return band.material.held_index, band.sigma, band.notes


# Readings from histograms of photons per event: a peak for each mounting, and their mean.


def _reduce_table(
    table: Measurements, shape: str
) -> tuple[list[Reading], dict[str, ReducedReading]]:
    """All readings of a measurement file, and by label what those from histograms were made of."""
    mountings = {
        row.line: _mounting(table, row, row.histogram, shape)
        for row in table.readings
        if row.histogram is not None
    }
    readings, reduced = [], {}
    for label, rows in table.by_label.items():
        reading = rows[0]
        if reading.histogram is not None:
            reduced[label] = _reduced_reading([mountings[row.line] for row in rows])
            reading = reduced[label].reading
        readings.append(reading)
    return readings, reduced


def _notes_on(reduced: ReducedReading) -> Iterator[str]:
    """What is wrong with the peaks of a reading, or with their mean."""
    label = reduced.reading.label
    for mounting in reduced.counted:
        for warning in mounting.peak.warnings if mounting.peak is not None else ():
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


def _mounting(table: Measurements, row: Reading, file: Path, shape: str) -> Mounting:
    """A histogram with the peak that was fitted in it."""
    histogram = read_histogram(file)
    try:
        peak = fit_peak(histogram.photons, histogram.counts, shape=shape, window=row.window)
    except InputError as error:
        if row.window is None:
            raise InputError(error.problem, error.mend, path=file) from None
        problem = f"{file.name}: {error.problem}"
        raise table.refusal(row, "window_low", problem, error.mend) from None
    if peak is None and row.use:
        mend = f"measure longer, or leave it out with use = 0 in {table.path.name}"
        raise InputError("no peak stands out of the histogram", mend, path=file)
    return Mounting(row, histogram, peak, consistent=True)


def _reduced_reading(mountings: list[Mounting]) -> ReducedReading:
    """The mean of the mountings in use; of all, in a reading that is not used."""
    used = any(mounting.use for mounting in mountings)
    peaks = [
        (place, mounting.peak)
        for place, mounting in enumerate(mountings)
        if mounting.peak is not None and (mounting.use or not used)
    ]
    if not peaks:
        row = mountings[0].row
        problem = f"no histogram of {row.label}, which is not used, has a peak either"
        raise InputError(problem, "remove its rows", path=row.histogram)
    combined = combine([p.centroid for _, p in peaks], [p.centroid_sigma for _, p in peaks])
    for outlier in combined.outliers:
        place, _ = peaks[outlier]
        mountings[place] = replace(mountings[place], consistent=False)
    reading = replace(
        mountings[0].row,
        signal=combined.mean,
        sigma=combined.sigma,
        use=used,
        histogram=None,
        window=None,
    )
    return ReducedReading(reading, tuple(mountings), combined)


# All of them, and the numbers in their place.


def reduce_raw_data(
    document: TomlDocument, table: Measurements, scene: SceneFile
) -> tuple[TomlDocument, Measurements, RawData | None]:
    """The campaign with numbers for raw entries, readings for histograms, and what was reduced.

    The last is None where there is nothing to reduce.
    Raises InputError with the line, if an entry or a file with raw data cannot be used.
    """
    entries = read_raw_entries(document)
    readings, reduced = _reduce_table(table, entries.shape)
    measurements = table.with_readings(readings)
    if not reduced and entries == RawEntries(entries.shape):
        return with_numbers(document, {}), measurements, None
    efficiency = absorption = source_depth = light = None
    if (entry := entries.efficiency) is not None:
        emission = read_spectrum(entry.emission, "emission")
        curve = read_spectrum(entry.quantum_efficiency, "quantum_efficiency")
        value = detector_efficiency(emission, curve, entry.scale_sigma)
        efficiency = ReducedEfficiency(entry, emission, curve, value)
        light = detected_light(emission, curve)
    if entries.transmittance is not None:
        absorption = _reduce_transmittance(document, entries.transmittance, light, scene)
    if (gammas := entries.gammas) is not None:
        with said_by(partial(document.refusal, f"parameters.{SOURCE_DEPTH}.gammas_in")):
            source_depth = attenuation_length_mm(
                gammas.formula, gammas.energy_keV, gammas.density_g_per_cm3
            )
    raw = RawData(reduced, efficiency, absorption, source_depth, numbers={}, files=())
    raw = replace(raw, numbers=_numbers(document, raw), files=tuple(_files(raw)))
    return with_numbers(document, raw.numbers), measurements, raw


def _numbers(document: TomlDocument, raw: RawData) -> dict[str, float]:
    """What a plain campaign has in the place of raw entries."""
    numbers: dict[str, float] = {}
    priors = []
    if raw.absorption is not None:
        absorption = raw.absorption.found
        priors.append((ABSORPTION, absorption.alpha_abs_per_cm, absorption.sigma))
    if raw.source_depth is not None:
        depth = raw.source_depth
        priors.append((SOURCE_DEPTH, depth.length_mm, depth.sigma_mm))
    for name, value, sigma in priors:
        key = f"parameters.{name}"
        numbers |= {f"{key}.prior": value, f"{key}.prior_sigma": sigma}
        if "start" not in document.table(key):
            numbers[f"{key}.start"] = value
    if raw.efficiency is not None:
        numbers["light_yield.detector_efficiency"] = raw.efficiency.found.value
        numbers["light_yield.detector_efficiency_sigma"] = raw.efficiency.found.sigma
    return {name: float(f"{value:.{_DIGITS}g}") for name, value in numbers.items()}


def _files(raw: RawData) -> Iterator[RawFile]:
    """All raw files with what they are and their SHA-256."""
    # spectra first: where a report has no room for all of them, histograms are cut
    named: list[tuple[str, Path]] = []
    if raw.efficiency is not None:
        entry = raw.efficiency.entry
        named += [
            ("emission spectrum", entry.emission),
            ("quantum efficiency", entry.quantum_efficiency),
        ]
    if raw.absorption is not None:
        named += [("transmittance", path) for path in raw.absorption.entry.files]
    for label, reading in raw.readings.items():
        named += [(f"histogram of {label}", mounting.file) for mounting in reading.mountings]
    for role, path in named:
        yield RawFile(role, path, sha256(read_bytes(path, LIMIT_MB)))
