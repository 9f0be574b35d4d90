"""The plain form of a raw campaign: numbers, and comments that say where each came from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from mcrim_mitsuba.characters import visible
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.campaign_editor import campaign_with_numbers
from mcrim_mitsuba.files.measurements import Measurements, Reading
from mcrim_mitsuba.files.values import value_text
from mcrim_mitsuba.laboratory.raw_data import SHORT_HASH, RawData, ReducedReading
from mcrim_mitsuba.physics.rounding import pdg

#: Digits of the readings that are written: no fit notices the rest.
_DIGITS = 6


def plain_texts(campaign: Campaign, target: Path, measurements: Path) -> tuple[str, str]:
    """The texts of a campaign file and of its measurement file, without raw data.

    Parameters
    ----------
    campaign : Campaign
        With raw data.
    target, measurements : Path
        Where the two will be written: paths in them are relative to their folders.

    Raises
    ------
    InputError
        If the campaign file cannot be read any more.
    """
    assert campaign.raw is not None
    header = [
        f"Written by mcrim reduce: {campaign.path.name} with numbers in the place of raw data.",
        "SHA-256 of every file in brackets, its first digits.",
        *_origins(campaign.raw),
    ]
    text = campaign_with_numbers(campaign, target, measurements)
    rows = _measurements_text(campaign.measurements, campaign.raw)
    return "".join(_comments(header)) + text, rows


def _comments(lines: Iterable[str]) -> Iterator[str]:
    # a file's name may hold a line end, which would end the comment
    return (f"# {visible(' '.join(line.split()))}\n" for line in lines)


def _hashes(raw: RawData) -> dict[Path, str]:
    return {file.path: file.sha256[:SHORT_HASH] for file in raw.files}


def _named(raw: RawData, paths: Iterable[Path]) -> str:
    """``air_1.csv (0123456789ab), air_2.csv (...)``."""
    hashes = _hashes(raw)
    return ", ".join(f"{path.name} ({hashes[path]})" for path in paths)


def _origins(raw: RawData) -> Iterator[str]:
    """Where priors and efficiency came from, a sentence each."""
    if raw.efficiency is not None:
        entry = raw.efficiency.entry
        yield (
            f"detector_efficiency: {_named(raw, (entry.emission, entry.quantum_efficiency))}, "
            f"{100 * entry.scale_sigma:g} % scale of the curve; errors by origin: "
            + _parts(raw.efficiency.found.contributions)
        )
    if raw.absorption is not None:
        slab = raw.absorption.entry
        measured = (
            f"{pdg(slab.value, slab.transmittance_sigma)}, one number"
            if slab.value is not None
            else _named(raw, slab.files)
        )
        yield (
            f"alpha_abs_per_cm: transmittance of {slab.thickness_mm:g} mm, {measured}; errors by "
            "origin: " + _parts(raw.absorption.found.contributions)
        )
    if raw.source_depth is not None:
        length = raw.source_depth.found
        yield (
            f"source_depth_mm: attenuation length of {length.energy_keV:g} keV gammas in "
            f"{length.formula}, {length.density_g_per_cm3:g} g/cm3"
        )


def _parts(contributions: Mapping[str, float]) -> str:
    """Errors by origin, without those that are none."""
    return ", ".join(f"{name} {part:.2g}" for name, part in contributions.items() if part > 0)


def _measurements_text(measurements: Measurements, raw: RawData) -> str:
    """The measurement file with a signal and its error in every row."""
    comments = [
        *measurements.comments,
        f"Written by mcrim reduce from {measurements.path.name}; SHA-256 in brackets:",
        *(_origin(raw, reduced) for reduced in raw.readings.values()),
    ]
    optional = [
        name
        for name, has in (
            ("use", any(not reading.use for reading in measurements.readings)),
            ("group", any(reading.group is not None for reading in measurements.readings)),
        )
        if has
    ]
    if "group" in optional:
        optional.append("group_sigma")
    header = ["label", "signal", "sigma", *measurements.columns, *optional]
    rows = [_cells(reading, measurements.columns, optional) for reading in measurements.readings]
    return "".join(_comments(comments)) + "".join(
        ",".join(map(_quoted, row)) + "\n" for row in [header, *rows]
    )


def _origin(raw: RawData, reduced: ReducedReading) -> str:
    used = [m.file for m in reduced.mountings if m.use or not reduced.reading.use]
    return f"{reduced.reading.label}: {_named(raw, used)}"


def _cells(reading: Reading, columns: Iterable[str], optional: Iterable[str]) -> list[str]:
    further = {
        "use": str(int(reading.use)),
        "group": reading.group or "",
        "group_sigma": "" if reading.group_sigma is None else f"{reading.group_sigma:g}",
    }
    return [
        reading.label,
        f"{reading.signal:.{_DIGITS}g}",
        f"{reading.sigma:.{_DIGITS}g}",
        *(value_text(reading.parameters[name]) for name in columns),
        *(further[name] for name in optional),
    ]


def _quoted(cell: str) -> str:
    """A cell of a CSV; a label that begins with # would be a comment."""
    if any(sign in cell for sign in ',"#') or cell != cell.strip():
        return '"' + cell.replace('"', '""') + '"'
    return cell
