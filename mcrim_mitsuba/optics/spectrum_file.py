"""Reads spectra: emission, quantum efficiency, transmittance, in any unit of wavelength."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.data_table import DataTable, read_data_table
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import first_duplicates
from mcrim_mitsuba.core.rounding import counted
from mcrim_mitsuba.optics.spectrum import Spectrum

#: hc in eV nm (exact in the SI of 2019, rounded) and the same for wavenumbers: wavelengths are
#: taken in vacuum, 0.03 % longer than in air.
HC_EV_NM = 1239.841984
NM_PER_CM = 1e7

#: Scintillators emit, and detectors see, within these.
SHORTEST_NM = 100.0
LONGEST_NM = 2500.0
#: Times the usual step: a longer one is a gap.
_GAP = 5.0
#: A longer step is refused.
LARGEST_STEP_NM = 100.0
_MOST_GAPS_NAMED = 3
_FACTORS = {None: 1.0, "nm": 1.0, "µm": 1000.0, "Å": 0.1, "A": 0.1}
_RECIPROCAL: dict[str | None, float] = {"eV": HC_EV_NM, "1/cm": NM_PER_CM}
#: Names of columns beside which numbers without a unit are no wavelengths.
_OTHER_AXIS = re.compile(
    r"freq|pixel|chan|kanal|\bbins?\b|\bbin_|photon|\bhv\b|\bhν|event|trigger|time|zeit|\badc\b"
    r"|angle|winkel|position|volt|temp|count|charge|ampl|index|[ek]v\b"
    r"|^(no|nr|n|row|run|point)\.?$|^#$",
    re.IGNORECASE,
)
_WITH_UNIT = re.compile(r"energ|wave ?number|^e$", re.IGNORECASE)
_WAVELENGTH_NAME = re.compile(r"wave ?length|lambda|λ|wellenl|длин", re.IGNORECASE)
#: What numbers without a unit may be, by their range.
_LOOKS_LIKE = (
    (0.1, 1.2, "µm"),
    (1.2, 12.0, "eV"),
    (2500.0, 10_000.0, "Å"),
    (10_000.0, 100_000.0, "1/cm"),
)


@dataclass(frozen=True, eq=False)
class _WavelengthAxis:
    """Wavelengths of a table's rows, ascending."""

    #: (points,) float64
    wavelength_nm: Array
    #: (points,) int64: Row of the table for each point; repeated rows are left out.
    rows: NDArray[np.int64]
    #: (points,) float64: What turns a density over the table's own axis into one over wavelength: 1
    #: for wavelengths, E^2/hc for energies, up to a constant factor.
    per_nm: Array
    #: Gaps, and conversions that rest on an assumption.
    notes: tuple[str, ...]


def _read_axis(table: DataTable, column: int) -> _WavelengthAxis:
    """Wavelengths in nm from a column in nm, µm, Å, eV or 1/cm.

    Descending rows are turned round; a row that repeats the one before is left out.
    """
    given = table.values[:, column]
    unit = table.units[column]
    if unit is None:
        _refuse_other_axis(table, column)
    if unit not in _RECIPROCAL and unit not in _FACTORS:
        mend = "write nm, µm, Å, eV or 1/cm in the column's name"
        raise table.refusal(None, column, f"'{unit}' is no unit of a wavelength that is read", mend)
    reciprocal = _RECIPROCAL.get(unit)
    with np.errstate(divide="ignore"):
        wavelengths = _FACTORS[unit] * given if reciprocal is None else reciprocal / given
    _refuse_range(table, column, given, wavelengths)
    per_nm = np.ones_like(given) if reciprocal is None else given**2 / reciprocal
    # rows by ascending wavelength, in the order of most of the steps: the others are wrong
    steps = np.diff(given)
    direction = 1.0 if np.count_nonzero(steps > 0) >= np.count_nonzero(steps < 0) else -1.0
    for i in np.flatnonzero(direction * steps <= 0):
        row = int(i) + 1
        if steps[i] == 0:
            if np.array_equal(table.values[i], table.values[row]):
                continue
            problem = f"{given[row]:g} is on line {table.lines[i]} already, with another value"
            raise table.refusal(row, column, problem, "keep one of the rows, or their mean")
        problem = f"{given[row]:g} after {given[i]:g}: the rows neither ascend nor descend"
        raise table.refusal(row, column, problem, "sort them, and give each scan a file of its own")
    kept = np.flatnonzero(np.concatenate(([True], steps != 0)))
    rows = kept[np.argsort(wavelengths[kept])]
    notes = _notes_on_gaps(table, column, wavelengths[rows], rows)
    return _WavelengthAxis(wavelengths[rows], rows, per_nm[rows], notes)


def _refuse_other_axis(table: DataTable, column: int) -> None:
    """Refuse a column without unit whose name needs one, or is that of something else."""
    name = table.names[column] if table.names else ""
    if _WAVELENGTH_NAME.search(name):  # which is in nm
        return
    if _WITH_UNIT.search(name):  # an energy or a wave number
        problem = f"'{name}' has no unit"
        raise table.refusal(None, column, problem, f"write '{name} (eV)' or (1/cm), or give nm")
    if _OTHER_AXIS.search(name):
        problem = f"a wavelength is wanted, and '{name}' is something else"
        mend = "name the right file, or the column by its unit: nm, µm, Å, eV or 1/cm"
        raise table.refusal(None, column, problem, mend)


def _refuse_range(table: DataTable, column: int, given: Array, wavelengths: Array) -> None:
    """Refuse wavelengths that no light here has; a unit that was forgotten is guessed."""
    wrong = (wavelengths < SHORTEST_NM) | (wavelengths > LONGEST_NM) | (given <= 0)
    if not np.any(wrong):
        return
    row = int(np.argmax(wrong))
    value = float(given[row])
    unit = table.units[column]
    if unit is None and np.all(wrong):
        for low, high, looks in _LOOKS_LIKE:
            if low <= value < high:
                problem = f"{value:g} is no wavelength in nm; these look like {looks}"
                mend = f"write ({looks}) in the column's name, or convert to nm"
                raise table.refusal(row, column, problem, mend)
    problem = f"{value:g} {unit or 'nm'} is no wavelength from {SHORTEST_NM:g} to {LONGEST_NM:g} nm"
    raise table.refusal(row, column, problem, "correct it, or write the unit in the column's name")


def _notes_on_gaps(
    table: DataTable, column: int, wavelengths: Array, rows: NDArray[np.int64]
) -> tuple[str, ...]:
    """Refuse gaps in which a straight line is no curve, and name smaller ones in a note."""
    steps = np.diff(wavelengths)
    if not steps.size:
        return ()
    largest = int(np.argmax(steps))
    if steps[largest] > LARGEST_STEP_NM:
        problem = f"no points from {wavelengths[largest]:.6g} to {wavelengths[largest + 1]:.6g} nm"
        mend = f"give points every {LARGEST_STEP_NM:g} nm at least, or cut the table there"
        raise table.refusal(int(max(rows[largest], rows[largest + 1])), column, problem, mend)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    if not gaps.size:
        return ()
    named = [f"{wavelengths[i]:.5g} to {wavelengths[i + 1]:.5g} nm" for i in gaps]
    more = len(named) - _MOST_GAPS_NAMED
    text = ", ".join(named[:_MOST_GAPS_NAMED]) + (f" and {more} more gaps" if more > 0 else "")
    return (f"{table.path.name}: no points from {text}: the curve is a straight line there",)


Kind = Literal["emission", "quantum_efficiency", "transmittance"]
_FEWEST_POINTS = 3
#: Noise about zero, as a part of an emission's maximum: what is further below is no noise, but a
#: background that was subtracted twice.
_NOISE_OF_EMISSION = 0.02
#: Noise about zero of a transmittance.
_NOISE_OF_TRANSMITTANCE = 0.01
#: In standard errors of its own: noise too,
_NOISE_SIGMAS = 3.0
#: up to this part of the maximum.
_MOST_NOISE = 0.3
#: Of the values: errors that are larger at most high points are no errors of these values.
_LARGEST_ERROR = {"emission": 1.0, "quantum_efficiency": 0.5, "transmittance": 0.5}
#: Of the maximum: points above it are high.
_HIGH = 0.5

_WAVELENGTH_TITLE = re.compile(
    r"wave ?length|wave ?number|\blambda\b|^(λ|wl|w\.l\.)$|energy|^e$", re.I
)
_SIGMA = re.compile(
    r"sigma|σ|±|\+/?-|error|(?<![a-z])err|err$|uncert|unsicher|fehler|deviation|\bstd|\bsd$"
    r"|\bunc\b|^u$|погреш|ошиб",
    re.I,
)
_RELATIVE = re.compile(r"\brel", re.I)
#: What is not one standard error.
_NOT_STANDARD = re.compile(
    r"\b[2-9]\s*[-*x×]?\s*_?(sigma|σ|s\.?d|std|err|stand)|varian[cz]|squared?|\^\s*2|\*\*\s*2"
    r"|(sigma|σ|err|error|std|fehler)\s*2$|[fh]whm|\bk\s*=\s*(?!1(\.0*)?\b)\d|\b9[05-9]\b|confid",
    re.I,
)
#: What an emission counts, by its column's name and unit, or by a comment's "photons per nm".
_PHOTONS = re.compile(r"photon|\bquanta\b|\bcounts?\b|\bcps\b|\bph\b", re.I)
_POWER = re.compile(
    r"(^|[^A-Za-z])[mµμun]?(W|J)($|[^A-Za-z])|(?i:power|energy|irradian|radian[ct]|\bwatts?\b)"
)
_PER_NM = re.compile(r"(\S+?)\s*(?:\bper\b|/)\s*(?:nm|µm|μm|Å|eV)\b", re.I)
#: What a density is over: wavelengths, and energies or wave numbers.
_OVER_LENGTH = re.compile(r"(\bper|/)\s*(nm|[uµμ]m|Å)\b|\bnm\s*\^?[-−⁻][1¹]", re.I)
_OVER_ENERGY = re.compile(r"(\bper|/)\s*(eV|1/cm|cm\s*\^?[-−⁻]1)|\beV\s*\^?[-−⁻][1¹]", re.I)
# "5 percent" is a number of something else
_SAYS_PERCENT = re.compile(
    r"[(\[/,]\s*%\s*([)\],;\t]|$)|%\s*T\b|\bT\s*%"
    r"|(?<!\d)(?<!\d )\b(per ?cent|prozent|procent|pct\b|proc\.|процент)|\bin %",
    re.I,
)
_TRANSMITTANCE = re.compile(r"transmi|transpar|^i?t([\W_\d]|$)|durchl|пропуск", re.I)
_ABSORBANCE = re.compile(
    r"absorban[cz]e?|absorption\b(?! coeff)|extin[ck]tion|optical density", re.I
)
#: Names of what a table of each kind does not hold.
_FOREIGN = {
    "emission": re.compile(
        r"\bq\.?e\b|quantum|\bpde\b|efficien|transmi|^t$|absor[bp]|^abs|excitation", re.I
    ),
    "quantum_efficiency": re.compile(
        r"respons|sensitiv|emission|intensity|counts|transmi|^t$|absor[bp]", re.I
    ),
    "transmittance": re.compile(
        r"absor[bp]|^[ad]$|^abs\b|\bod\b|\bau\b|optical density|extin[ck]|loss|verlust|atten"
        r"|-\s*lo?g|\blo?g|^r$|reflect|emission|intensity|\bq\.?e\b|quantum",
        re.I,
    ),
}
_WANTED = {
    "emission": ("an emission spectrum", "intensities"),
    "quantum_efficiency": (
        "a quantum efficiency",
        "% or fractions (QE = 1240 S / λ, S in A/W, λ in nm)",
    ),
    "transmittance": ("a transmittance", "% or fractions (T = 10^-A from an absorbance A)"),
}


def read_transmittances(paths: Sequence[str | Path]) -> list[Spectrum]:
    """Read and check several transmittances, as fractions.

    Raises InputError if one cannot be used, or two are one file or alike byte for byte.
    """
    spectra = [read_spectrum(path, "transmittance") for path in paths]
    duplicates = first_duplicates([Path(path) for path in paths])
    if duplicates is not None:
        first, second = (paths[place] for place in duplicates)
        mend = "name every measurement once"
        raise InputError(f"the same data as {first}", mend, path=Path(second))
    return spectra


def read_spectrum(path: str | Path, kind: Kind) -> Spectrum:
    """Read and check a spectrum; efficiencies and transmittances are fractions then.

    The table (see `data_table`) has two columns, wavelength and value, or three, the third named as
    the value's standard error (sigma, error, uncertainty, ±), in the value's unit; errors that
    exceed most of the high values are refused. Wavelengths are in nm, or in µm, Å, eV or 1/cm where
    the column's name says so; they ascend or descend. An emission is of photons or power, which the
    column's name or a comment says, in any unit, per nm (per eV or per 1/cm where the column is one
    of these). Both are converted to photons per nm; noise below zero is kept: without it the mean
    would be biased. Efficiencies and transmittances are fractions, or % where the name says so.

    Raises InputError, with file, line and column, if anything cannot be used or may be meant
    otherwise.
    """
    table = read_data_table(path, roles=("wavelength", "value", "sigma"))
    wavelength, value, sigma = _columns(table)
    _refuse_foreign(table, value, kind)
    axis = _read_axis(table, wavelength)
    if axis.rows.size < _FEWEST_POINTS:
        problem = f"only {counted(axis.rows.size, 'point')}"
        raise InputError(problem, f"a spectrum has {_FEWEST_POINTS} at least", path=table.path)
    sigmas = None if sigma is None else _sigmas(table, value, sigma, kind)
    scale, notes = (
        _emission(table, wavelength, value, sigmas, axis)
        if kind == "emission"
        else (_scale(table, value, kind), axis.notes)
    )
    values = table.values[axis.rows, value] * scale
    sigmas = None if sigmas is None else sigmas[axis.rows] * scale
    return Spectrum(axis.wavelength_nm, values, sigmas, str(table.path), notes=notes)


def _columns(table: DataTable) -> tuple[int, int, int | None]:
    """Columns of the wavelength, else the first; of the value; and of its error, or None."""
    count = table.values.shape[1]
    names = table.names or ("",) * count
    if count == 1:
        mend = "write the wavelength in nm before each value"
        raise InputError("one column of numbers", mend, path=table.path, line=int(table.lines[0]))
    wavelengths = [
        i
        for i in range(count)
        if table.units[i] in ("nm", "µm", "Å", "eV", "1/cm") or _WAVELENGTH_TITLE.search(names[i])
    ]
    if len(wavelengths) > 1:
        mend = "keep one of them, and give each spectrum a file of its own"
        raise InputError(f"{len(wavelengths)} columns are wavelengths", mend, path=table.path)
    wavelength = wavelengths[0] if wavelengths else 0
    others = [i for i in range(count) if i != wavelength]
    if count == 2:
        return wavelength, others[0], None
    errors = [i for i in others if _SIGMA.search(names[i])]
    if count == 3 and len(errors) == 1:
        return wavelength, next(i for i in others if i != errors[0]), errors[0]
    problem = f"{count} columns" + (", and none is named as an error" if count == 3 else "")
    third = "the value's standard error in a third column named sigma"
    mend = f"keep wavelength and value, and if it is known {third}"
    raise InputError(problem, mend, path=table.path, line=int(table.lines[0]))


def _refuse_foreign(table: DataTable, value: int, kind: Kind) -> None:
    """Refuse a column that its name, unit or a comment calls something else than is wanted."""
    name = table.names[value] if table.names else ""
    wanted, mend = _WANTED[kind]
    if _FOREIGN[kind].search(name):
        problem = f"{wanted} is wanted, and '{name}' is something else"
        raise table.refusal(None, value, problem, f"name the right file, or give {mend}")
    if kind == "transmittance" and not _TRANSMITTANCE.search(name):
        comment = next(filter(None, map(_ABSORBANCE.search, table.comments)), None)
        if comment is not None:
            problem = f"a comment says '{comment[0]}', and a transmittance is wanted"
            mend = f"name the column T if it is one, else give {mend}"
            raise table.refusal(None, value, problem, mend)
    unit = table.units[value]
    if kind != "emission" and unit not in (None, "%", "fraction"):
        problem = f"{wanted} in '{unit}'"
        raise table.refusal(None, value, problem, f"give {mend} and say so in the column's name")


def _sigmas(table: DataTable, value: int, sigma: int, kind: Kind) -> Array:
    """(rows,) standard errors in the values' unit; refuses those that such values cannot have."""
    sigmas = _in_unit_of_value(table, value, sigma, kind)
    values = table.values[:, value]
    full = np.inf if kind == "emission" else 100.0 if table.units[value] == "%" else 1.0
    impossible = sigmas > full
    high = values > _HIGH * values.max()
    unlikely = high & (sigmas > np.minimum(_LARGEST_ERROR[kind] * np.abs(values), full))
    if np.any(impossible) or np.count_nonzero(unlikely) > np.count_nonzero(high) / 2:
        row = int(np.argmax(impossible if np.any(impossible) else unlikely))
        problem = f"an error of {sigmas[row]:g} for a value of {values[row]:g}"
        mend = "give standard errors in the value's unit, or write 'relative sigma (%)'"
        raise table.refusal(row, sigma, problem, mend)
    return sigmas


def _in_unit_of_value(table: DataTable, value: int, sigma: int, kind: Kind) -> Array:
    """The errors, converted if relative; refuses other than standard errors in the value's unit."""
    sigmas = table.values[:, sigma]
    assert table.names is not None  # a column of errors is found by its name
    title = table.names[sigma]
    unit, of_value = table.units[sigma], table.units[value]
    name = " ".join(filter(None, (title, unit)))
    if _NOT_STANDARD.search(name):
        mend = "convert it to standard errors, and name the column sigma"
        raise table.refusal(None, sigma, f"'{name}' is not one standard error", mend)
    if np.any(sigmas < 0):
        row = int(np.argmax(sigmas < 0))
        problem = f"the error {sigmas[row]:g} is negative"
        raise table.refusal(row, sigma, problem, "give standard errors")
    relative = _RELATIVE.search(title) is not None
    # intensities have no per cent of their own
    if unit == "%" and (relative or (kind == "emission" and of_value != "%")):
        return sigmas / 100 * np.abs(table.values[:, value])
    if relative or (unit is not None and unit != of_value):
        mend = "give both in one unit, or write 'relative sigma (%)'"
        raise table.refusal(None, sigma, "an error in another unit than its value", mend)
    return sigmas


def _emission(
    table: DataTable, wavelength: int, value: int, sigmas: Array | None, axis: _WavelengthAxis
) -> tuple[Array, tuple[str, ...]]:
    """What turns intensities of an emission into photons per nm, (points,), and all notes.

    Raises InputError if no intensity is above 0, or one is below 0 by more than noise.
    """
    intensities = table.values[:, value]
    highest = float(intensities.max())
    if not highest > 0:
        mend = "subtract the background once, and give the light as positive"
        raise table.refusal(int(np.argmax(intensities)), value, "no intensity is above 0", mend)
    noise = np.full(intensities.shape, _NOISE_OF_EMISSION * highest)
    if sigmas is not None:
        noise = np.maximum(noise, np.minimum(_NOISE_SIGMAS * sigmas, _MOST_NOISE * highest))
    below = intensities < -noise
    if np.any(below):
        row = int(np.argmax(below))
        most = f"{100 * _NOISE_OF_EMISSION:g} % of the maximum {highest:g}"
        problem = f"{intensities[row]:g} is below 0 by more than {most}"
        mend = "subtract the right background, or cut the spectrum there"
        raise table.refusal(row, value, problem, mend)
    unit, notes, file = table.units[wavelength], list(axis.notes), table.path.name
    if unit in _RECIPROCAL:
        converted = f"intensities are taken per {unit} and were converted to intensities per nm"
        notes.append(f"{file}: {converted}")
    photons = photons_over_emission(table, value, axis.wavelength_nm, unit in _RECIPROCAL)
    if np.ndim(photons):
        notes.append(f"{file}: power was converted to numbers of photons")
    return axis.per_nm * photons, tuple(notes)


def photons_over_emission(
    table: DataTable, value: int, wavelength_nm: Array, over_energy: bool = False
) -> Array | float:
    """What turns an emission into photons, up to a constant: 1, or (points,) that rise with nm.

    Raises InputError if neither the column's name and unit nor comments say photons or power, or if
    they say per eV where the table is over wavelengths, or per nm where it is `over_energy`.
    """
    title = " ".join(filter(None, (table.names[value] if table.names else "", table.units[value])))
    over = _OVER_LENGTH, _OVER_ENERGY
    right, wrong = over[::-1] if over_energy else over
    words = title, *table.comments
    densities = [text for text in words if right.search(text) or wrong.search(text)]
    if densities and not right.search(densities[0]):
        problem = f"'{densities[0]}' is not per unit of the table's wavelengths or energies"
        raise table.refusal(None, value, problem, "give both in nm and per nm, or both in eV")
    comments = [text for text in table.comments for text in _PER_NM.findall(text)]
    for texts in ([title], comments):
        photons, power = (any(map(word.search, texts)) for word in (_PHOTONS, _POWER))
        if photons != power:
            # a photon's energy goes as 1 / wavelength; 1 in the middle of the table
            return 1.0 if photons else 2.0 * wavelength_nm / (wavelength_nm[0] + wavelength_nm[-1])
    mend = "name the column such as 'emission (photons/nm)' or 'emission (mW/nm)'"
    problem = "nothing says whether the emission is photons or power per nm"
    raise table.refusal(None, value, problem, mend)


def _scale(table: DataTable, value: int, kind: Kind) -> float:
    """What makes fractions of the values, 1 or 0.01; refuses values outside 0..1, unsure units."""
    values, unit = table.values[:, value], table.units[value]
    row, smallest = int(np.argmax(values)), int(np.argmin(values))
    largest = values[row]
    lowest = -_NOISE_OF_TRANSMITTANCE if kind == "transmittance" else 0.0
    full = 100.0 if unit == "%" else 1.0
    if largest > full and unit is None and largest <= 100:
        problem = f"{largest:g} is more than 1, and no unit is given"
        name = "T (%)" if kind == "transmittance" else "QE (%)"
        mend = f"write % in the column's name, such as {name}"
        raise table.refusal(row, value, problem, mend)
    if largest > full:
        percent = " %" if unit == "%" else ""
        problem = f"{largest:g}{percent} is more than {full:g}{percent}"
        mend = "correct it; if a baseline drifted, measure it again"
        raise table.refusal(row, value, problem, mend)
    if values[smallest] < lowest * full:
        mend = "write 0" if kind == "quantum_efficiency" else "subtract the right dark signal"
        problem = f"{values[smallest]:g} is negative"
        raise table.refusal(smallest, value, problem, f"{mend}, or cut the curve there")
    if not largest > 0:
        raise table.refusal(row, value, "no value is above 0", "check the column")
    if unit is None and any(map(_SAYS_PERCENT.search, table.comments)):
        problem = "a comment says %, and the column's name does not"
        raise table.refusal(None, value, problem, "name the column with its unit: fraction or %")
    if unit == "%" and largest <= 1:
        problem = f"the largest value is {largest:g} %: these look like fractions"
        mend = "remove the % from the column's name, or give per cent"
        raise table.refusal(row, value, problem, mend)
    return 1 / full
