"""Raw entries of a campaign: spectra, transmittances and gammas, and the numbers they make."""

from __future__ import annotations

import copy
import itertools
import math
import re
from collections.abc import Iterable, Mapping, MutableMapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.entries import choice, number_within
from mcrim_mitsuba.core.errors import said_by
from mcrim_mitsuba.core.files import inside, is_there, look_around, resolved
from mcrim_mitsuba.core.numbers import ALPHA_ABS, MM_PER_CM
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable, is_plain_number
from mcrim_mitsuba.laboratory.light_yield import (
    TUBE_SCALE_SIGMA,
    DetectorEfficiency,
    detector_efficiency,
)
from mcrim_mitsuba.laboratory.peak import AUTO
from mcrim_mitsuba.laboratory.peak_shapes import Below
from mcrim_mitsuba.optics.absorption import (
    EMISSION,
    LARGEST_SIGMA,
    Absorption,
    Index,
    absorption_from_transmittance,
)
from mcrim_mitsuba.optics.emission_band import index_over
from mcrim_mitsuba.optics.gammas import AttenuationLength, attenuation_length_mm
from mcrim_mitsuba.optics.spectrum import Spectrum
from mcrim_mitsuba.optics.spectrum_file import read_spectrum, read_transmittances
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.values import read_index

_NUMBER_LIKE = re.compile(r"[+-]?[\d.,]+(e[+-]?\d+)?\s*%?", re.IGNORECASE | re.ASCII)
#: What raw entries stand in the place of.
_PRIOR = ("prior", "prior_sigma")
_EFFICIENCY = ("detector_efficiency", "detector_efficiency_sigma")
#: Of the light inside the sample: no spectrophotometer is as exact.
_SMALLEST_SIGMA = 2e-4
_CRYSTAL = "n_crystal"
_WITHOUT_LIGHT = (
    "a spectrum says nothing of the crystal's own light without its emission",
    "add emission and quantum_efficiency to [light_yield], or give plain numbers",
)


def refuse_misplaced(document: TomlDocument) -> None:
    """Refuse raw entries of a parameter that they say nothing of."""
    for entries, parameter in (
        (schema.TRANSMITTANCE, ALPHA_ABS),
        (schema.GAMMAS, schema.SOURCE_DEPTH),
    ):
        raw = next(iter(entries))
        for other in document.table("parameters"):
            table = document.table(f"parameters.{other}")
            if other != parameter and raw in table:
                problem = f"{raw} says nothing of {other}"
                raise table.refusal(raw, problem, f"write it into [parameters.{parameter}]")


def with_numbers(document: TomlDocument, numbers: Mapping[str, float]) -> TomlDocument:
    """The document with numbers where it has raw entries; their lines are those of the latter.

    `numbers` by dotted name, such as ``parameters.alpha_abs_per_cm.prior``.
    """
    content, lines = copy.deepcopy(document.content), dict(document.lines)
    put_numbers(content, numbers)
    for key, names in schema.RAW_TABLES:
        given = next((name for name in names if name in document.table(key)), "")
        if (line := document.lines.get(f"{key}.{given}")) is not None:
            lines |= {name: line for name in numbers if name.rpartition(".")[0] == key}
    return replace(document, content=content, lines=lines)


def put_numbers(content: MutableMapping[str, Any], numbers: Mapping[str, float]) -> None:
    """Put `numbers` into a campaign file's content, in the place of raw entries."""
    content.pop(schema.HISTOGRAMS, None)
    for key, names in schema.RAW_TABLES:
        table = table_in(content, key) or {}
        for name in names:
            table.pop(name, None)
    for name, value in numbers.items():
        key, _, entry = name.rpartition(".")
        if (beside := table_in(content, key)) is not None:  # the raw entry stood there
            beside[entry] = value


def table_in(content: MutableMapping[str, Any], key: str) -> MutableMapping[str, Any] | None:
    """The table of a dotted name; None if it is not there."""
    table: Any = content
    for part in key.split("."):
        table = table.get(part)
        if table is None:
            return None
    return table


def read_absorption(
    document: TomlDocument, light: Spectrum | None, scene: SceneFile
) -> Absorption | None:
    """Eq. 4 of the article with the files, or the number, of a campaign; None without these.

    `light`, as the detector of ``[light_yield]`` sees it, is what spectra are weighted with; the
    scene has the crystal's index where the entry gives none.
    """
    table = document.table(f"parameters.{ALPHA_ABS}")
    name = "transmittance"
    if not _has(table, name, schema.TRANSMITTANCE, _PRIOR):
        return None
    files, numbers, transmittance_sigma = _measured(table)
    thickness_mm = _above_zero(table, "thickness_mm", "the sample's thickness in mm")
    thickness_sigma_mm = number_within(table, "thickness_sigma_mm", schema.TRANSMITTANCE) or 0.0
    spectra = read_transmittances(files)
    if light is None and spectra:
        raise table.refusal(name, *_WITHOUT_LIGHT)
    n, n_sigma, notes = _index(table, light, scene)
    with said_by(partial(table.refusal, name), placed_too=False):
        absorption = absorption_from_transmittance(
            spectra or numbers,
            n,
            thickness_mm,
            transmittance_sigma=transmittance_sigma,
            n_sigma=n_sigma,
            thickness_sigma_mm=thickness_sigma_mm,
            emission=light,
        )
    # the emission only weights: its noise is no error of the readings
    parts = [part for origin, part in absorption.contributions.items() if origin != EMISSION]
    sigma = math.hypot(*parts)
    if sigma * thickness_mm / MM_PER_CM < _SMALLEST_SIGMA:
        few = f"with an error of {sigma:.1g} /cm, less than any spectrophotometer's"
        problem = f"the absorption coefficient comes {few if sigma > 0 else 'without any error'}"
        mend = "give transmittance_sigma, the error that all readings share"
        raise table.refusal(name, problem, f"{mend}, or errors as a column of the spectra")
    return replace(absorption, notes=(*absorption.notes, *notes))


def _index(
    table: TomlTable, light: Spectrum | None, scene: SceneFile
) -> tuple[Index, float, tuple[str, ...]]:
    """The crystal's index, a number or a function of the wavelength, its error, and notes."""
    n = table.get("n")
    if not isinstance(n, str):
        n = number_within(table, "n", schema.TRANSMITTANCE)
    elif not n.strip():
        raise table.refusal("n", "n is empty", 'write a material, such as "CaMoO4"')
    if "n_sigma" in table and not isinstance(n, float):
        problem = "n_sigma without an index as a number"
        raise table.refusal("n_sigma", problem, "give n, or remove n_sigma")
    if isinstance(n, float):
        return n, number_within(table, "n_sigma", schema.TRANSMITTANCE) or 0.0, ()
    if n is None:
        index = scene.parameters.get(_CRYSTAL)
        if not isinstance(index, float):
            problem = f"{scene.path.name} has no {_CRYSTAL}"
            mend = 'give the crystal\'s index: n = 2.01, or a material such as n = "CaMoO4"'
            raise table.refusal("transmittance", problem, mend)
        named = scene.materials.get(_CRYSTAL)
        return index, 0.0 if named is None else named.material.sigma, ()
    if light is None and "@" not in n:
        raise table.refusal("n", *_WITHOUT_LIGHT)
    with said_by(partial(table.refusal, "n"), placed_too=False):
        if light is None or "@" in n:
            named = read_index("n", n, table.document.path.parent)
            return named.value, named.material.sigma, ()
        band = index_over(n, light)
        return band.material.held_index, band.sigma, band.notes


def _measured(table: TomlTable) -> tuple[list[Path], list[float], float]:
    """Spectra, or one number; and its standard error, or the one that all spectra share.

    The latter, the accuracy of the spectrophotometer, is 0 where none is given: errors of the
    points are columns of the files.
    """
    name, sigma_name = "transmittance", "transmittance_sigma"
    given = table[name]
    numbers: list[float] = []
    files: list[Path] = []
    if is_plain_number(given):
        number_within(table, name, schema.TRANSMITTANCE)
        numbers = [table.known_number(name)]
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
        files = [file_in(table, name, file) for file in names]
        for position, file in enumerate(files):
            if resolved(file) in map(resolved, files[:position]):
                problem = f"{names[position]} is named twice"
                raise table.refusal(name, problem, "name every spectrum once")
    if not sigma < LARGEST_SIGMA:
        problem = f"{sigma_name} = {sigma:g} is not below {LARGEST_SIGMA:g}"
        mend = "give a fraction of full transmission: 0.005 for 0.5 %"
        raise table.refusal(sigma_name, problem, mend)
    return files, numbers, sigma


def read_efficiency(table: TomlTable) -> DetectorEfficiency | None:
    """The detector's efficiency, eq. 3 of the article; None where the table names no spectra."""
    emission, curve, scale = schema.EFFICIENCY
    for name, other in ((emission, curve), (curve, emission)):
        if name in table and other not in table:
            mend = f"name both spectra, or give {_EFFICIENCY[0]} as a number"
            raise table.refusal(name, f"{name} without {other}", mend)
    if not _has(table, emission, schema.EFFICIENCY, _EFFICIENCY):
        return None
    sigma = number_within(table, scale, schema.EFFICIENCY)
    files = [file_in(table, name, table[name]) for name in (emission, curve)]
    light, tube = read_spectrum(files[0], "emission"), read_spectrum(files[1], "quantum_efficiency")
    return detector_efficiency(light, tube, TUBE_SCALE_SIGMA if sigma is None else sigma)


def read_peaks(document: TomlDocument) -> tuple[str, Below]:
    """``[histograms]``: the shape of peaks, and what lies below those of the campaign's energy.

    Raises InputError with the line, if an entry cannot be used.
    """
    table = document.table(schema.HISTOGRAMS, schema.PEAKS)
    step = table.get("step", False)
    if not isinstance(step, bool):
        raise table.refusal("step", "step is not true or false", "write step = true")
    energies, shares = (_numbers(table, name) for name in ("escape_keV", "escape_share"))
    if shares and len(shares) != len(energies):
        problem = f"{len(shares)} numbers in escape_share for {len(energies)} in escape_keV"
        raise table.refusal("escape_share", problem, "give each quantum its share, or none")
    quanta = tuple(itertools.zip_longest(energies, shares))
    below = Below(quanta, step, document.table(schema.YIELD_TABLE).number("energy_keV"))
    return choice(table, "shape", schema.PEAKS) or AUTO, below


def _numbers(table: TomlTable, name: str) -> list[float]:
    """Numbers above 0 of an entry that is a list of them."""
    numbers = table.get(name, [])
    if isinstance(numbers, list) and all(is_plain_number(n) and 0 < n < math.inf for n in numbers):
        return numbers
    raise table.refusal(name, f"{name} is no list of numbers above 0", f"write {name} = [17.4]")


def read_source_depth(document: TomlDocument) -> AttenuationLength | None:
    """How deep the source's gammas get; None where the campaign names no crystal for them."""
    table = document.table(f"parameters.{schema.SOURCE_DEPTH}")
    name, density = schema.GAMMAS
    if not _has(table, name, schema.GAMMAS, _PRIOR):
        return None
    formula = table[name]
    if not isinstance(formula, str) or not formula.strip():
        raise table.refusal(name, f"{name} is no formula", f'write {name} = "CaMoO4"')
    energy = document.table(schema.YIELD_TABLE).number("energy_keV")
    if energy is None:
        problem = f"{name} needs the energy of the gammas"
        raise table.refusal(name, problem, "add [light_yield] with energy_keV")
    density_g_per_cm3 = None
    if density in table:
        density_g_per_cm3 = _above_zero(table, density, "the crystal's density in g/cm3")
    with said_by(partial(table.refusal, name)):
        return attenuation_length_mm(formula, energy, density_g_per_cm3)


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
    """A file that an entry names; raises InputError with the line, if it does not exist."""
    path = table.path_of(name, given)
    if not is_there(inside(path)[0]):
        mend = look_around(path, "paths are relative to the campaign file")
        raise table.refusal(name, f"{path} does not exist", mend)
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
