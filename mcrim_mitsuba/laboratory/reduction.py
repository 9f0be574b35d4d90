"""Reduces the raw data that a campaign names, and puts the numbers in their place."""

from __future__ import annotations

from collections.abc import Iterator

from mcrim_mitsuba.files.measurement_table import MeasurementTable
from mcrim_mitsuba.files.measurements import Measurements, measurements_of, reading_in
from mcrim_mitsuba.files.raw_entries import (
    ABSORPTION,
    SOURCE_DEPTH,
    RawEntries,
    read_raw_entries,
    with_numbers,
)
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.toml_document import TomlDocument
from mcrim_mitsuba.laboratory.raw_data import (
    RawData,
    RawFile,
    ReducedAbsorption,
    ReducedEfficiency,
    ReducedReading,
    ReducedSourceDepth,
    raw_file,
)

#: Digits of the numbers that stand in the place of raw entries: `mcrim reduce` writes them so.
_DIGITS = 6


def reduce_raw_data(
    document: TomlDocument, table: MeasurementTable, scene: SceneFile
) -> tuple[TomlDocument, Measurements, RawData | None]:
    """A campaign's raw data as numbers.

    Parameters
    ----------
    document : TomlDocument
        The campaign.
    table : MeasurementTable
        Its measurement file.
    scene : SceneFile
        Its scene, for the crystal's index.

    Returns
    -------
    document : TomlDocument
        With numbers where there were raw entries.
    measurements : Measurements
    raw : RawData or None
        None where there is nothing to reduce.

    Raises
    ------
    InputError
        If an entry is impossible, or a file with raw data cannot be used: with its line.
    """
    entries = read_raw_entries(document)
    if not _is_raw(entries, table):
        readings = (reading_in(row) for row in table.rows)
        return with_numbers(document, {}), measurements_of(table, readings), None
    raw, measurements = _reduced(document, entries, table, scene)
    return with_numbers(document, raw.numbers), measurements, raw


def _is_raw(entries: RawEntries, table: MeasurementTable) -> bool:
    named = (entries.transmittance, entries.efficiency, entries.gammas)
    return any(one is not None for one in named) or any(
        row.histogram is not None for row in table.rows
    )


def _reduced(
    document: TomlDocument, entries: RawEntries, table: MeasurementTable, scene: SceneFile
) -> tuple[RawData, Measurements]:
    # what reads spectra and looks up cross-sections is of no use to plain campaigns
    from mcrim_mitsuba.laboratory.absorption import reduce_transmittance
    from mcrim_mitsuba.laboratory.efficiency import reduce_efficiency
    from mcrim_mitsuba.laboratory.readings_from_histograms import reduce_table
    from mcrim_mitsuba.laboratory.source_depth import reduce_gammas
    from mcrim_mitsuba.physics.spectrum import detected_light

    readings, reduced = reduce_table(table, entries.shape)
    efficiency = absorption = source_depth = None
    if entries.efficiency is not None:
        efficiency = reduce_efficiency(entries.efficiency)
    if entries.transmittance is not None:
        light = None
        if efficiency is not None:
            light = detected_light(efficiency.emission, efficiency.quantum_efficiency)
        absorption = reduce_transmittance(document, entries.transmittance, light, scene)
    if entries.gammas is not None:
        source_depth = reduce_gammas(document, entries.gammas)
    raw = RawData(
        readings=reduced,
        efficiency=efficiency,
        absorption=absorption,
        source_depth=source_depth,
        numbers=_numbers(document, efficiency, absorption, source_depth),
        files=tuple(_files(reduced, efficiency, absorption)),
        notes=tuple(dict.fromkeys(_notes(reduced, efficiency, absorption))),
    )
    return raw, measurements_of(table, readings)


def _numbers(
    document: TomlDocument,
    efficiency: ReducedEfficiency | None,
    absorption: ReducedAbsorption | None,
    source_depth: ReducedSourceDepth | None,
) -> dict[str, float]:
    """What a plain campaign has in the place of raw entries."""
    numbers: dict[str, float] = {}
    priors = []
    if absorption is not None:
        found = absorption.found
        priors.append((ABSORPTION, found.alpha_abs_per_cm, found.sigma))
    if source_depth is not None:
        priors.append((SOURCE_DEPTH, source_depth.found.length_mm, source_depth.found.sigma_mm))
    for name, value, sigma in priors:
        key = f"parameters.{name}"
        numbers[f"{key}.prior"], numbers[f"{key}.prior_sigma"] = value, sigma
        if "start" not in document.table(key):
            numbers[f"{key}.start"] = value
    if efficiency is not None:
        numbers["light_yield.detector_efficiency"] = efficiency.found.value
        numbers["light_yield.detector_efficiency_sigma"] = efficiency.found.sigma
    return {name: float(f"{value:.{_DIGITS}g}") for name, value in numbers.items()}


def _files(
    readings: dict[str, ReducedReading],
    efficiency: ReducedEfficiency | None,
    absorption: ReducedAbsorption | None,
) -> Iterator[RawFile]:
    # spectra first: where a report has no room for all of them, histograms are cut
    if efficiency is not None:
        yield raw_file("emission spectrum", efficiency.entry.emission)
        yield raw_file("quantum efficiency", efficiency.entry.quantum_efficiency)
    if absorption is not None:
        for path in absorption.entry.files:
            yield raw_file("transmittance", path)
    for label, reading in readings.items():
        for mounting in reading.mountings:
            yield raw_file(f"histogram of {label}", mounting.file)


def _notes(
    readings: dict[str, ReducedReading],
    efficiency: ReducedEfficiency | None,
    absorption: ReducedAbsorption | None,
) -> Iterator[str]:
    from mcrim_mitsuba.laboratory.readings_from_histograms import notes_on

    for reading in readings.values():
        yield from notes_on(reading)
    if efficiency is not None:
        for spectrum in (efficiency.emission, efficiency.quantum_efficiency):
            yield from spectrum.notes
        yield from efficiency.found.notes
    if absorption is not None:
        for spectrum in absorption.spectra:
            yield from spectrum.notes
        yield from absorption.found.notes
