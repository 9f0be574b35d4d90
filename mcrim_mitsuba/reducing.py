"""Reduce a campaign's raw data: every step with its errors, and the campaign in plain numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign, read_campaign
from mcrim_mitsuba.files.writing import write_text
from mcrim_mitsuba.laboratory.plain_campaign import plain_texts
from mcrim_mitsuba.laboratory.raw_data import Mounting, RawData, ReducedReading


def reduce(campaign: str | Path | Campaign, output: str | Path | None = None) -> Campaign:
    """Reduce a campaign's raw data, and write it in plain numbers where asked.

    Parameters
    ----------
    campaign : str, Path or Campaign
    output : str or Path, optional
        Where the plain campaign is written (TOML); its readings go beside it under the same
        name, with ``.csv``. Files that are there are replaced.

    Returns
    -------
    Campaign
        As it was read: its `raw` has all steps.

    Raises
    ------
    InputError
        If a file cannot be used or written, or if the campaign has no raw data.
    """
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(campaign)
    if campaign.raw is None:
        raise InputError(
            "there is nothing to reduce: the campaign names no raw data",
            "it can be calibrated as it is", path=campaign.path,
        )  # fmt: skip
    if output is not None:
        write_plain(campaign, Path(output))
    return campaign


def readings_beside(target: Path) -> Path:
    """Where the readings of a plain campaign go."""
    return target.with_suffix(".csv")


def write_plain(campaign: Campaign, target: Path) -> None:
    """Write a raw campaign in plain numbers; see `reduce`."""
    measurements = readings_beside(target)
    text, readings = plain_texts(campaign, target, measurements)
    write_text(measurements, readings)
    write_text(target, text)


def to_json(raw: RawData) -> dict[str, Any]:
    """Every step for JSON."""
    return {
        "readings": [_reading_json(reduced) for reduced in raw.readings.values()],
        "detector_efficiency": _efficiency_json(raw),
        "absorption": _absorption_json(raw),
        "source_depth": _source_depth_json(raw),
        "numbers": raw.numbers,
        "files": [vars(file) for file in raw.files],
        "notes": list(raw.notes),
    }


def _reading_json(reduced: ReducedReading) -> dict[str, Any]:
    combined = reduced.combined
    return {
        "label": reduced.reading.label,
        "signal": reduced.reading.signal,
        "sigma": reduced.reading.sigma,
        "use": reduced.reading.use,
        "scatter_sigma": combined.scatter_sigma,
        "internal_sigma": combined.internal_sigma,
        "chi2": combined.chi2,
        "ndf": combined.ndf,
        "p_value": combined.p_value,
        "consistent": combined.consistent,
        "mountings": [_mounting_json(mounting) for mounting in reduced.mountings],
    }


def _mounting_json(mounting: Mounting) -> dict[str, Any]:
    peak = mounting.peak
    found = {
        "file": mounting.row.histogram,
        "line": mounting.row.line,
        "use": mounting.use,
        "consistent": mounting.consistent,
    }
    if peak is None:
        return {**found, "peak": None}
    names = ("shape", "centroid", "centroid_sigma", "width", "width_sigma", "events", "chi2", "ndf",
             "p_value", "low", "high")  # fmt: skip
    values = {name: getattr(peak, name) for name in names}
    return {**found, "peak": {**values, "warnings": list(peak.warnings)}}


def _efficiency_json(raw: RawData) -> dict[str, Any] | None:
    if raw.efficiency is None:
        return None
    found = raw.efficiency.found
    return {
        "value": found.value, "sigma": found.sigma, "contributions": found.contributions,
        "spread": found.spread,
    }  # fmt: skip


def _absorption_json(raw: RawData) -> dict[str, Any] | None:
    if raw.absorption is None:
        return None
    entry, found = raw.absorption.entry, raw.absorption.found
    return {
        "alpha_abs_per_cm": found.alpha_abs_per_cm,
        "sigma": found.sigma,
        "contributions": found.contributions,
        "orientations": [
            {"file": path, "alpha_abs_per_cm": alpha}
            for path, alpha in zip(entry.files or (None,), found.each_per_cm, strict=True)
        ],
        "spread_orientations_per_cm": found.spread_orientations_per_cm,
        "spread_band_per_cm": found.spread_band_per_cm,
        "internal_transmittance": found.internal_transmittance,
        "internal_transmittance_sigma": found.internal_transmittance_sigma,
        "n": found.n,
        "thickness_mm": entry.thickness_mm,
    }


def _source_depth_json(raw: RawData) -> dict[str, Any] | None:
    if raw.source_depth is None:
        return None
    found = raw.source_depth.found
    return {
        "formula": found.formula,
        "energy_keV": found.energy_keV,
        "density_g_per_cm3": found.density_g_per_cm3,
        "length_mm": found.length_mm,
        "sigma_mm": found.sigma_mm,
        "tables_sigma_mm": found.tables_sigma_mm,
        "process_sigma_mm": found.process_sigma_mm,
    }
