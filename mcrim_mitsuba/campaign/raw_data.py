"""The raw data that a campaign names: its raw entries, checked by themselves."""

from __future__ import annotations

import copy
import functools
import re
from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Any

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.entries import choice, number_within
from mcrim_mitsuba.core.files import is_there, look_around, resolved
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable
from mcrim_mitsuba.laboratory.peak import SHAPES
from mcrim_mitsuba.optics.absorption import LARGEST_SIGMA

_NUMBER_LIKE = re.compile(r"[+-]?[\d.,]+(e[+-]?\d+)?\s*%?", re.IGNORECASE | re.ASCII)
#: What raw entries stand in the place of.
_PRIOR = ("prior", "prior_sigma")
_EFFICIENCY = ("detector_efficiency", "detector_efficiency_sigma")
#: Of a photomultiplier's absolute calibration, relative: section 6.2 of the article.
_USUAL_SCALE_SIGMA = 0.05


@dataclass(frozen=True)
class TransmittanceEntry:
    """What the absorption comes from."""

    #: Spectra, one per orientation; empty where one number was measured.
    files: tuple[Path, ...]
    #: That number, a fraction.
    value: float | None
    #: Standard error of that number; beside files, the absolute standard error that all readings
    #: of all spectra share, the accuracy of the spectrophotometer (0 where none is given; errors
    #: of the points are columns of the files).
    transmittance_sigma: float
    thickness_mm: float
    _: KW_ONLY
    thickness_sigma_mm: float
    #: A material, or an index; None: the scene's ``n_crystal``.
    n: str | float | None
    n_sigma: float


@dataclass(frozen=True)
class EfficiencyEntry:
    """What the detector's efficiency comes from."""

    #: Spectra.
    emission: Path
    quantum_efficiency: Path
    #: Relative error of the whole efficiency curve.
    scale_sigma: float


@dataclass(frozen=True)
class GammasEntry:
    """What the depth comes from at which the source's gammas stop."""

    #: Of the crystal.
    formula: str
    #: None: that of the catalogue of materials.
    density_g_per_cm3: float | None
    energy_keV: float


@dataclass(frozen=True)
class RawEntries:
    """Raw data that a campaign names, its measurement table apart."""

    #: One of `SHAPES`.
    shape: str
    transmittance: TransmittanceEntry | None = None
    efficiency: EfficiencyEntry | None = None
    gammas: GammasEntry | None = None


def read_raw_entries(document: TomlDocument) -> RawEntries:
    """The raw entries of a campaign, checked by themselves.

    Raises InputError with the line, if one is impossible, lacks what it needs, or stands beside the
    number that it replaces.
    """
    for entries, parameter in (
        (schema.TRANSMITTANCE, schema.ABSORPTION),
        (schema.GAMMAS, schema.SOURCE_DEPTH),
    ):
        raw = next(iter(entries))
        for other in document.table("parameters"):
            table = document.table(f"parameters.{other}")
            if other != parameter and raw in table:
                problem = f"{raw} says nothing of {other}"
                raise table.refusal(raw, problem, f"write it into [parameters.{parameter}]")
    return RawEntries(
        shape=choice(document.table(schema.HISTOGRAMS, schema.PEAKS), "shape", schema.PEAKS)
        or SHAPES[0],
        transmittance=_read_transmittance(document.table(f"parameters.{schema.ABSORPTION}")),
        efficiency=_read_efficiency(document.table(schema.YIELD_TABLE)),
        gammas=_read_gammas(
            document.table(f"parameters.{schema.SOURCE_DEPTH}"), document.table(schema.YIELD_TABLE)
        ),
    )


def with_numbers(document: TomlDocument, numbers: Mapping[str, float]) -> TomlDocument:
    """The document with numbers where it has raw entries; their lines are those of the latter.

    `numbers` by dotted name, such as ``parameters.alpha_abs_per_cm.prior``.
    """
    content, lines = copy.deepcopy(document.content), dict(document.lines)
    content.pop(schema.HISTOGRAMS, None)
    for key, names in schema.RAW_TABLES:
        given = [name for name in names if name in document.table(key)]
        if not given:
            continue
        table = functools.reduce(dict.__getitem__, key.split("."), content)
        for name in given:
            del table[name]
        for name, value in numbers.items():
            of_table, _, entry = name.rpartition(".")
            if of_table == key:
                table[entry] = value
                if (line := document.lines.get(f"{key}.{given[0]}")) is not None:
                    lines[name] = line
    return replace(document, content=content, lines=lines)


def _read_transmittance(table: TomlTable) -> TransmittanceEntry | None:
    """What is measured of the transmittance; None where the table has no raw entries."""
    if not _has(table, "transmittance", schema.TRANSMITTANCE, _PRIOR):
        return None
    files, value, sigma = _measured(table)
    n = table.get("n")
    if not isinstance(n, str):
        n = number_within(table, "n", schema.TRANSMITTANCE)
    elif not n.strip():
        raise table.refusal("n", "n is empty", 'write a material, such as "CaMoO4"')
    if "n_sigma" in table and not isinstance(n, float):
        problem = "n_sigma without an index as a number"
        raise table.refusal("n_sigma", problem, "give n, or remove n_sigma")
    return TransmittanceEntry(
        files=files,
        value=value,
        transmittance_sigma=sigma,
        thickness_mm=_above_zero(table, "thickness_mm", "the sample's thickness in mm"),
        thickness_sigma_mm=number_within(table, "thickness_sigma_mm", schema.TRANSMITTANCE) or 0.0,
        n=n,
        n_sigma=number_within(table, "n_sigma", schema.TRANSMITTANCE) or 0.0,
    )


def _measured(table: TomlTable) -> tuple[tuple[Path, ...], float | None, float]:
    """Spectra, or one number; and the error of the number, or that all spectra share."""
    name, sigma_name = "transmittance", "transmittance_sigma"
    given = table[name]
    value: float | None = None
    files: tuple[Path, ...] = ()
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        value = number_within(table, name, schema.TRANSMITTANCE)
        sigma = _above_zero(table, sigma_name, f"the standard error of {name}")
    else:
        if isinstance(given, str) and _NUMBER_LIKE.fullmatch(given.strip()):
            mend = f"write it without quotes, a fraction with a decimal point: {name} = 0.76"
            raise table.refusal(name, f'{name} = "{given}" is a number in quotes', mend)
        names = [given] if isinstance(given, str) else given
        if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
            mend = f'write {name} = ["along.csv", "across.csv"], or {name} = 0.76'
            raise table.refusal(name, f"{name} is neither a list of files nor a number", mend)
        sigma = number_within(table, sigma_name, schema.TRANSMITTANCE) or 0.0
        files = tuple(file_in(table, name, file) for file in names)
        for position, file in enumerate(files):
            if resolved(file) in map(resolved, files[:position]):
                problem = f"{names[position]} is named twice"
                raise table.refusal(name, problem, "name every spectrum once")
    if not sigma < LARGEST_SIGMA:
        problem = f"{sigma_name} = {sigma:g} is not below {LARGEST_SIGMA:g}"
        mend = "give a fraction of full transmission: 0.005 for 0.5 %"
        raise table.refusal(sigma_name, problem, mend)
    return files, value, sigma


def _read_efficiency(table: TomlTable) -> EfficiencyEntry | None:
    """The spectra that give the detector's efficiency; None where the table names none."""
    emission, curve, scale = schema.EFFICIENCY
    for name, other in ((emission, curve), (curve, emission)):
        if name in table and other not in table:
            mend = f"name both spectra, or give {_EFFICIENCY[0]} as a number"
            raise table.refusal(name, f"{name} without {other}", mend)
    if not _has(table, emission, schema.EFFICIENCY, _EFFICIENCY):
        return None
    sigma = number_within(table, scale, schema.EFFICIENCY)
    return EfficiencyEntry(
        file_in(table, emission, table[emission]),
        file_in(table, curve, table[curve]),
        _USUAL_SCALE_SIGMA if sigma is None else sigma,
    )


def _read_gammas(table: TomlTable, light_yield: TomlTable) -> GammasEntry | None:
    """What tells how deep gammas go; None where the table names no crystal."""
    name, density = schema.GAMMAS
    if not _has(table, name, schema.GAMMAS, _PRIOR):
        return None
    formula = table[name]
    if not isinstance(formula, str) or not formula.strip():
        raise table.refusal(name, f"{name} is no formula", f'write {name} = "CaMoO4"')
    energy = light_yield.number("energy_keV")
    if energy is None:
        problem = f"{name} needs the energy of the gammas"
        raise table.refusal(name, problem, "add [light_yield] with energy_keV")
    density_g_per_cm3 = None
    if density in table:
        density_g_per_cm3 = _above_zero(table, density, "the crystal's density in g/cm3")
    return GammasEntry(formula, density_g_per_cm3, energy)


def _has(table: TomlTable, raw: str, belonging: Iterable[str], replaced: Iterable[str]) -> bool:
    """Whether a table has a raw entry; one without the other, or beside a number, is refused."""
    for name in belonging:
        if name in table and raw not in table:
            raise table.refusal(name, f"{name} without {raw}", f"add {raw}, or remove {name}")
    if raw not in table:
        return False
    for name in replaced:
        if name in table:
            problem = f"{name} beside {raw}, which gives it"
            raise table.refusal(name, problem, "remove one of the two")
    return True


def file_in(table: TomlTable, name: str, given: Any) -> Path:
    """A file that an entry names.

    Raises InputError with the line, if it does not exist.
    """
    path = table.path_of(name, given)
    if not is_there(path):
        problem = f"{path} does not exist"
        mend = look_around(path, "paths are relative to the campaign file")
        raise table.refusal(name, problem, mend)
    return path


def _above_zero(table: TomlTable, name: str, what: str) -> float:
    """A number that must be there and above 0; `what` says it to the reader."""
    value = table.number(name)
    if value is None:
        # thickness_cm for thickness_mm
        stem, names = name.partition("_")[0], {**schema.TRANSMITTANCE, **schema.GAMMAS}
        others = [other for other in table if other.startswith(stem) and other not in names]
        instead = f", {name} instead of {others[0]}" if others else ""
        raise table.refusal("", f"[{table.key}] has no {name}", f"give {what}{instead}")
    if value <= 0:
        raise table.refusal(name, f"{name} = {value:g} is not above 0", f"give {what}")
    return value
