"""Writes campaigns: one that goes on from another, and the plain form of raw data.

Of every function here: `campaign` is as it was read, and its file is not changed; `target` is where
the text will be written, for paths in it are relative to its folder."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import tomlkit

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.campaign.known_physics import CRYSTAL_INDEX, INDEX, material_of
from mcrim_mitsuba.campaign.measurements import ENERGY, KIND, LIGHT, SAMPLE, SHARED, Measurements
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.campaign.raw_data import put_numbers, table_in
from mcrim_mitsuba.campaign.reduction import RawData
from mcrim_mitsuba.campaign.samples import EFFICIENCY_FACTOR
from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import attributes, beside, inside, write_text
from mcrim_mitsuba.core.numbers import MM_PER_CM, value_text
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.effects.effect import OLD_NAMES
from mcrim_mitsuba.laboratory.calibration import ChannelCalibration
from mcrim_mitsuba.laboratory.light_yield import SCALE as TUBE_SCALE

#: Digits of a SHA-256 that are shown where all of them would be in the way.
_SHORT_HASH = 12


def campaign_with_effects(
    campaign: Campaign,
    target: Path,
    scene: Path,
    starts: Mapping[str, float],
    fixed_or_known: Iterable[CampaignParameter] = (),
    remarks: Mapping[str, str] | None = None,
) -> str:
    """The text of a campaign file with another scene, and with all effects of the campaign.

    `scene` has these effects. At `starts` fitted parameters begin; those without a table of their
    own get one, with what the campaign knows of them beforehand. Of `fixed_or_known` it is written
    that they are held, or their prior, in place of what the file says. `remarks`, by key, are put
    in place of the campaign's own.
    """
    document = _document(campaign, target, scene, campaign.measurements.path)
    # a key that is new goes before the first table, or it would belong to the last one
    document["effects"] = [*campaign.treatments, *campaign.effects]
    document.update(remarks or {})
    parameters = document.setdefault("parameters", tomlkit.table(is_super_table=True))
    # what samples have of their own stands in their tables, with what is known of it
    keys = {
        parameter.name: f"samples.{sample.name}.parameters.{of}"
        for sample in campaign.samples.values()
        for of, parameter in sample.own.items()
    }
    for name, start in starts.items():
        value = float(f"{start:.6g}")
        if (given := table_in(document, keys.get(name, f"parameters.{name}"))) is not None:
            given["start"] = value
        if given is not None or name in keys or name == EFFICIENCY_FACTOR:
            continue
        table = tomlkit.table()
        table.add("start", value)
        if name in campaign.priors:
            table.add(tomlkit.comment("What is plausible: the readings leave its size open."))
            for entry, number in zip(("prior", "prior_sigma"), campaign.priors[name], strict=True):
                table.add(entry, float(f"{number:.6g}"))
        table.add(tomlkit.nl())
        parameters[name] = table
    for parameter in fixed_or_known:
        within: Any = document
        key = keys.get(parameter.name, f"parameters.{parameter.name}")
        for part in key.split("."):
            within = within.setdefault(part, tomlkit.table())
        if key in keys.values() and key.endswith(f".{SCALE}"):
            # in place of a light yield that says the same of it
            given = table_in(document, key.replace(f"parameters.{SCALE}", schema.YIELD_TABLE)) or {}
            for entry in (schema.KNOWN_YIELD, schema.KNOWN_YIELD_SIGMA):
                given.pop(entry, None)
        for entry in ("prior", "prior_sigma", "fixed"):
            within.pop(entry, None)
        if parameter.fixed:
            within["start"], within["fixed"] = float(f"{parameter.start:.6g}"), True
        elif parameter.prior is not None:
            within["prior"], within["prior_sigma"] = parameter.prior, parameter.prior_sigma
    return _text(document, campaign)


def campaign_with_measurements(campaign: Campaign, target: Path, measurements: Path) -> str:
    """The text of a campaign file with other readings."""
    return _text(_document(campaign, target, campaign.scene.path, measurements), campaign)


def _text(document: tomlkit.TOMLDocument, campaign: Campaign) -> str:
    """The document as it is written, once it says what it should."""
    text = tomlkit.dumps(document)
    try:
        sound = tomllib.loads(text) == document.unwrap()
    except tomllib.TOMLDecodeError:
        sound = False
    if not sound:
        problem = "the campaign is laid out so that nothing can be added"
        mend = "write a table for each parameter, such as [parameters.alpha_scat_per_cm]"
        raise InputError(problem, f"{mend}, and each table once", path=campaign.path)
    return text


def _document(
    campaign: Campaign, target: Path, scene: Path, measurements: Path
) -> tomlkit.TOMLDocument:
    """The campaign file with its paths as the target needs them."""
    document = tomlkit.parse(campaign.text)
    for old, new in OLD_NAMES.items():
        if table_in(document, f"parameters.{old}") is not None:
            document["parameters"][new] = document["parameters"].pop(old)

    def relative(path: Path) -> str:
        return Path(os.path.relpath(path.absolute(), target.parent.absolute())).as_posix()

    document["scene"] = relative(scene)
    document["measurements"] = relative(measurements)
    if campaign.spectrum is not None:
        document[schema.SPECTRUM] = relative(campaign.spectrum.path)
    if campaign.effects_folder is not None:
        document["effects_folder"] = relative(campaign.effects_folder)
    for key, name in schema.FILE_ENTRIES:
        if (table := table_in(document, key)) is None:
            continue
        given = table.get(name)
        if isinstance(given, str):
            table[name] = relative(beside(campaign.path, given))
        elif isinstance(given, list):
            for place, file in enumerate(given):
                given[place] = relative(beside(campaign.path, file))
    return document


# Raw campaigns for people: in plain numbers, every step as JSON, and a note on the beam.

# In standard errors of the transmittance: it shows clearly less scattering than was fitted.
_CLEARLY = 3.0
# Digits of the readings that are written: no fit notices the rest.
_DIGITS = 6


def beam_notes(raw: RawData, alpha_scat_per_cm: float) -> list[str]:
    """A sentence where isotropic scattering would weaken a spectrophotometer's beam, but does not.

    The beam loses what is scattered out of it, exp(-alpha_scat d), besides what is absorbed;
    `alpha_scat_per_cm` is as fitted.
    """
    if raw.absorption is None:
        return []
    path_mm, through = raw.absorption.thickness_mm, raw.absorption.internal_transmittance
    left = math.exp(-alpha_scat_per_cm * path_mm / MM_PER_CM)
    if through - left < _CLEARLY * raw.absorption.internal_transmittance_sigma:
        return []
    return [
        f"isotropic scattering of {alpha_scat_per_cm:.2g} /cm takes {100 * (1 - left):.0f} % out "
        f"of a beam through {path_mm:g} mm, yet {100 * through:.1f} % of it arrived where the "
        "transmittance was measured: the spectrophotometer collects scattered light, or scattering "
        "is forward (effect anisotropic_scattering), or something else redirects light, such as "
        "the surfaces"
    ]


# The plain form of a raw campaign: numbers, and comments that say where each came from.


def plain_texts(campaign: Campaign, target: Path, measurements: Path) -> tuple[str, str]:
    """The texts of a campaign file and of its measurement file, without raw data.

    Paths in them are relative to the folders where these two will be written.
    """
    raw = campaign.raw
    assert raw is not None
    document = _document(campaign, target, campaign.scene.path, measurements)
    # what was said of the entry may not be true any more
    trivia = document["measurements"].trivia
    trivia.comment_ws = trivia.comment = ""
    put_numbers(document, raw.numbers)
    # raw entries named the material, and the spectrum that its index was averaged over
    if campaign.known_physics and (table := table_in(document, schema.YIELD_TABLE)) is not None:
        table["material"] = material_of(campaign)
    if CRYSTAL_INDEX in campaign.known_physics:
        held = {"start": campaign.scene.parameters[INDEX], "fixed": True}
        document.setdefault("parameters", tomlkit.table(is_super_table=True))[INDEX] = held
    header = [
        f"Written by mcrim reduce: {campaign.path.name} with numbers in the place of raw data.",
        "SHA-256 of every file in brackets, its first digits.",
        *_origins(raw),
    ]
    text = "".join(_comments(header)) + _text(document, campaign)
    return text, _reduced_text(campaign.measurements, raw)


def _comments(lines: Iterable[str]) -> Iterator[str]:
    # a file's name may hold a line end, which would end the comment
    return (f"# {visible(' '.join(line.split()))}\n" for line in lines)


def _named(raw: RawData, paths: Iterable[str | Path]) -> str:
    """``air_1.csv (0123456789ab), air_2.csv (...)``."""
    hashes = {file.path: file.sha256[:_SHORT_HASH] for file in raw.files}
    return ", ".join(f"{path.name} ({hashes[inside(path)[0]]})" for path in map(Path, paths))


def _origins(raw: RawData) -> Iterator[str]:
    """Where priors and efficiency came from, a sentence each."""
    if raw.efficiency is not None:
        curves = raw.efficiency.emission, raw.efficiency.quantum_efficiency
        parts = raw.efficiency.contributions
        yield (
            f"detector_efficiency: {_named(raw, (curve.name for curve in curves))}, "
            f"{100 * parts[TUBE_SCALE] / raw.efficiency.value:g} % scale of the curve; errors by "
            f"origin: {_parts(parts)}"
        )
    if raw.absorption is not None:
        slab = raw.absorption
        numbers = (f"{pdg(value, slab.transmittance_sigma)}, one number" for value in slab.numbers)
        measured = _named(raw, (curve.name for curve in slab.spectra)) or ", ".join(numbers)
        yield (
            f"alpha_abs_per_cm: transmittance of {slab.thickness_mm:g} mm, {measured}; errors by "
            f"origin: {_parts(slab.contributions)}"
        )
    if (digitiser := raw.calibration) is not None:
        runs = (digitiser.gain.spectrum, digitiser.pedestal_run, digitiser.background)
        named = _named(raw, (run.path for run in runs if run is not None)) or "numbers"
        yield (
            f"calibration: {named}; {digitiser.per_channel:.6g} photoelectrons per channel; "
            f"relative errors by origin: {_parts(digitiser.parts)}"
        )
    if raw.source_depth is not None:
        length = raw.source_depth
        yield (
            f"source_depth_mm: attenuation length of {length.energy_keV:g} keV gammas in "
            f"{length.formula}, {length.density_g_per_cm3:g} g/cm3"
        )


def _parts(contributions: Mapping[str, float]) -> str:
    """Errors by origin, without those that are none."""
    return ", ".join(f"{name} {part:.2g}" for name, part in contributions.items() if part > 0)


def _reduced_text(measurements: Measurements, raw: RawData) -> str:
    """The measurement file with the numbers that raw data gave."""
    comments = [
        *measurements.comments,
        f"Written by mcrim reduce from {measurements.path.name}; SHA-256 in brackets:",
        *(
            f"{label}: {_named(raw, (mounting.file for mounting in reduced.counted))}"
            for label, reduced in raw.readings.items()
        ),
    ]
    readings = (
        replace(r, signal=float(f"{r.signal:.{_DIGITS}g}"), sigma=float(f"{r.sigma:.{_DIGITS}g}"))
        for r in measurements.readings
    )
    reduced = replace(measurements, comments=tuple(comments), readings=tuple(readings))
    return measurements_text(reduced)


def measurements_text(measurements: Measurements) -> str:
    """The text of a measurement file with a signal and its error in every row."""
    return table_text(measurements.comments, measurement_cells(measurements))


def measurement_cells(measurements: Measurements) -> dict[str, list[str]]:
    """Cells by column; those of an optional column only where a reading needs it."""
    rows = [
        {
            "label": reading.label,
            "signal": f"{reading.signal:.15g}",
            "sigma": f"{reading.sigma:.15g}",
            KIND: reading.kind,
            SAMPLE: reading.sample,
            ENERGY: "" if reading.energy_keV is None else f"{reading.energy_keV:.15g}",
            **{name: str(int(name not in reading.without)) for name in measurements.switches},
            # beams leave cells of the bench empty, and light those of the beam
            **{name: value_text(reading.parameters.get(name, "")) for name in measurements.columns},
            "use": str(int(reading.use)),
            "group": reading.group or "",
            "group_sigma": "" if reading.group_sigma is None else f"{reading.group_sigma:g}",
            SHARED: " ".join(f"{of:g}" for of in reading.shared),
        }
        for reading in measurements.readings
    ]
    usual = {KIND: LIGHT, "use": "1", SAMPLE: "", ENERGY: "", SHARED: ""}
    usual |= {"group": "", "group_sigma": ""}
    cells = {name: [row[name] for row in rows] for name in rows[0]}
    return {n: of for n, of in cells.items() if any(cell != usual.get(n) for cell in of)}


def table_text(comments: Iterable[str], cells: Mapping[str, Sequence[str]]) -> str:
    """The text of a measurement file, of cells by column."""
    rows = [cells, *zip(*cells.values(), strict=True)]
    lines = (",".join(map(_quoted, row)) + "\n" for row in rows)
    return "".join([*_comments(comments), *lines])


def _quoted(cell: str) -> str:
    """A cell of a CSV; a label that begins with # would be a comment."""
    if any(sign in cell for sign in ',"#') or cell != cell.strip():
        return '"' + cell.replace('"', '""') + '"'
    return cell


def reduce(campaign: str | Path | Campaign, output: str | Path | None = None) -> Campaign:
    """Reduce a campaign's raw data, and write it in plain numbers where asked: into `output`, TOML.

    Its readings go beside it under the same name, with ``.csv``; files that are there are replaced.
    Returns the campaign as it was read: its `raw` has all steps.

    Raises InputError if a file cannot be used or written, or if the campaign has no raw data.
    """
    campaign = as_campaign(campaign)
    if campaign.raw is None:
        problem = "there is nothing to reduce: the campaign names no raw data"
        raise InputError(problem, "it can be calibrated as it is", path=campaign.path)
    if output is not None:
        for path in (Path(output), readings_beside(Path(output))):
            if path.resolve() in map(Path.resolve, campaign.files):
                raise InputError("the campaign reads it", "name another file", path=path)
        write_plain(campaign, Path(output))
    return campaign


def readings_beside(target: Path) -> Path:
    """Where the readings of a plain campaign go."""
    return target.parent / f"{target.stem}.csv"


def write_plain(campaign: Campaign, target: Path) -> None:
    """Write a raw campaign in plain numbers; see `reduce`."""
    text, readings = plain_texts(campaign, target, readings_beside(target))
    write_text(readings_beside(target), readings)
    write_text(target, text)


def to_json(raw: RawData) -> dict[str, Any]:
    """Every step for JSON: where readings come from, and what each orientation absorbs."""
    of_peak = (
        "shape centroid centroid_sigma width width_sigma events chi2 ndf p_value low high warnings "
        "**fitted_below"
    )
    of_mean = "scatter_sigma internal_sigma chi2 ndf p_value consistent"
    absorption: dict[str, Any] = {}
    if raw.absorption is not None:
        files = (curve.name for curve in raw.absorption.spectra)
        pairs = zip_longest(files, raw.absorption.each_per_cm)
        absorption = {
            **attributes(raw.absorption, "alpha_abs_per_cm sigma contributions"),
            "orientations": [{"file": file, "alpha_abs_per_cm": alpha} for file, alpha in pairs],
            **attributes(
                raw.absorption,
                "spread_orientations_per_cm spread_band_per_cm internal_transmittance "
                "internal_transmittance_sigma n thickness_mm",
            ),
        }
    return {
        "readings": [
            {
                **attributes(reduced.reading, "label signal sigma use"),
                **attributes(reduced.combined, of_mean),
                "mountings": [
                    attributes(mounting, "file line=row.line use=row.use consistent")
                    | {"peak": mounting.peak and attributes(mounting.peak, of_peak)}
                    for mounting in reduced.mountings
                ],
            }
            for reduced in raw.readings.values()
        ],
        "detector_efficiency": raw.efficiency
        and attributes(raw.efficiency, "value sigma contributions spread"),
        "absorption": absorption or None,
        "source_depth": raw.source_depth
        and attributes(
            raw.source_depth,
            "formula energy_keV density_g_per_cm3 length_mm sigma_mm tables_sigma_mm "
            "process_sigma_mm",
        ),
        "calibration": raw.calibration and calibration_json(raw.calibration),
        **attributes(raw, "numbers files notes"),
    }


def calibration_json(calibration: ChannelCalibration) -> dict[str, Any]:
    """What turns channels into photoelectrons, and what the spectra for it said."""
    of_fit = (
        "pedestal mean mean_sigma crosstalk crosstalk_sigma afterpulsing afterpulsing_sigma spread "
        "excess_noise_factor excess_noise_factor_sigma events chi2 ndf p_value"
    )
    return {
        **attributes(calibration.gain, "value sigma"),
        "single_photoelectrons": calibration.gain.fit and attributes(calibration.gain.fit, of_fit),
        **attributes(
            calibration,
            "pedestal range_ratio range_ratio_sigma nonlinearity nonlinearity_sigma per_channel "
            "scale_sigma offset_sigma",
        ),
    }
