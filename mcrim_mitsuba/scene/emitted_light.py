"""Light over its wavelengths: what is emitted, what a detector sees, what the bench is like."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path

import numpy as np

from mcrim_mitsuba.core.data_table import DataTable, read_data_table
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.numbers import COEFFICIENTS, unit_of
from mcrim_mitsuba.optics.materials import Material
from mcrim_mitsuba.optics.spectrum import Spectrum
from mcrim_mitsuba.optics.spectrum_file import photons_over_emission, read_spectrum
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Columns of a table that are no parameters of the scene.
WAVELENGTH = "wavelength_nm"
EMISSION = "emission"
EFFICIENCY = "efficiency"
#: Step of integrals.
_STEP_NM = 5.0
#: Part of the light outside an index's range that is told.
_NOTEWORTHY = 1e-3
#: Light over its maximum below which a wavelength is left out.
_FAINT = 1e-3


@dataclass(frozen=True, eq=False)
class Colours:
    """Light of several colours: all (colours,) float64."""

    #: Of the light; they sum to 1.
    parts: Array
    #: Coefficients over those that are named.
    scattering: Array
    absorption: Array


@dataclass(frozen=True, eq=False)
class EmittedLight:
    """Light over its wavelengths, and what the bench is like at each: (wavelengths,) float64."""

    #: Rising.
    wavelength_nm: Array
    #: Photons per nm, in any unit.
    emission: Array
    #: Of the detector, a fraction; 1 where it is not known.
    efficiency: Array
    #: Scene parameters that vary, or differ from the scene's.
    parameters: Mapping[str, Array]
    _: KW_ONLY
    #: Whether the efficiency was given.
    detected: bool
    #: The file.
    path: Path
    #: Where indices are not known, and held.
    notes: tuple[str, ...] = ()

    @property
    def weights(self) -> Array:
        """Weights of wavelengths in integrals over the emission, by trapezoids; their sum is 1."""
        step = np.diff(self.wavelength_nm)
        weights = self.emission * (np.append(step, 0.0) + np.insert(step, 0, 0.0)) / 2.0
        return np.asarray(weights / weights.sum(), float)

    @property
    def mean_nm(self) -> float:
        """Mean wavelength of the light as it is detected."""
        seen = self.weights * self.efficiency
        return float(seen @ self.wavelength_nm / seen.sum())

    def seen_by(self, efficiency: Spectrum) -> EmittedLight:
        """This light before a detector of another efficiency, 0 beyond its points."""
        at, curve = self.wavelength_nm, efficiency
        seen = np.interp(at, curve.wavelength_nm, curve.values, left=0.0, right=0.0)
        return replace(self, efficiency=seen, detected=True)

    def colours(self, most: int) -> Colours:
        """Parts of the detected light, and coefficients over those at the mean wavelength.

        Of `most` pieces of the band at most, each with as much light as any other.
        """
        seen = self.weights * self.efficiency
        upto = np.concatenate(([0.0], np.cumsum(seen))) / seen.sum()
        pieces = min(most, len(seen))
        middle = 0.5 * (upto[1:] + upto[:-1])
        piece = np.minimum((middle * pieces).astype(int), pieces - 1)
        parts = np.bincount(piece, seen, pieces)
        at_mean = self.at(self.mean_nm)

        def over_mean(name: str) -> Array:
            if name not in self.parameters:
                return np.ones(np.count_nonzero(parts))
            means = np.bincount(piece, seen * self.parameters[name], pieces)
            return np.asarray(means[parts > 0.0] / parts[parts > 0.0] / at_mean[name], float)

        shares = parts[parts > 0.0] / parts.sum()
        return Colours(np.asarray(shares, float), *map(over_mean, COEFFICIENTS))

    def at(self, wavelength_nm: float) -> dict[str, float]:
        """The parameters at one wavelength, between the points by straight lines."""
        points, curves = self.wavelength_nm, self.parameters.items()
        return {name: float(np.interp(wavelength_nm, points, curve)) for name, curve in curves}


def read_light(
    path: str | Path, scene: SceneFile, quantum_efficiency: str | Path | None = None
) -> EmittedLight:
    """Light over wavelengths, from a table.

    It has columns ``wavelength_nm`` and ``emission`` (photons or power per nm, which its name or a
    comment says), and if known ``efficiency`` (of the detector, a fraction; else that of another
    spectrum) and any parameters of the scene, such as ``alpha_abs_per_cm``, at these wavelengths.
    Or it is an emission spectrum as campaigns name one. Indices of the scene that name a material
    follow its dispersion, beyond the formula's range that at its end.

    Raises InputError if a file cannot be read, or a column is none of the scene's parameters.
    """
    exponents = (e for e in scene.root.iter("float") if e.get("name") == "scattering_exponent")
    if any(float(exponent.get("value", "0")) for exponent in exponents):
        problem = "the light has wavelengths, and scattering_exponent gives it others"
        mend = "set that to 0, and let a column alpha_scat_per_cm say how scattering varies"
        raise InputError(problem, mend, path=scene.path)
    table = read_data_table(path, roles=(WAVELENGTH, EMISSION))
    names = [_as_named(table, column) for column in range(table.values.shape[1])]
    columns: dict[str, Array] = {}
    if EMISSION in names and WAVELENGTH in names:
        at, columns = _columns(table, names, scene)
        photons = photons_over_emission(table, names.index(EMISSION), at)
        emission = Spectrum(at, photons * columns.pop(EMISSION), name=str(path))
    else:
        emission = read_spectrum(path, "emission")
    grid = _grid(emission)
    light = np.clip(emission.at(grid), 0.0, None)
    if not light.max() > 0.0:
        raise emission.refusal("the emission has no area", "give intensities above 0")
    seen = columns.pop(EFFICIENCY, None)
    if seen is not None and quantum_efficiency is not None:
        problem = "the detector's efficiency is given twice"
        mend = f"leave the column {EFFICIENCY} or the other file out"
        raise InputError(problem, mend, path=table.path)
    followed = {n: index.material for n, index in scene.materials.items() if n not in columns}
    varying = {name: of.held_index(grid) for name, of in followed.items()}
    varying |= {n: np.interp(grid, emission.wavelength_nm, v) for n, v in columns.items()}
    # what is the same at all wavelengths may still be another number than the scene's
    varying = {n: values for n, values in varying.items() if (values != scene.parameters[n]).any()}
    all_seen = np.ones_like(grid)
    emitted = EmittedLight(grid, light, all_seen, varying, detected=False, path=Path(path))
    emitted = replace(emitted, notes=tuple(_held(emitted, followed)))
    if seen is not None:
        return emitted.seen_by(Spectrum(emission.wavelength_nm, seen))
    if quantum_efficiency is not None:
        return emitted.seen_by(read_spectrum(quantum_efficiency, "quantum_efficiency"))
    return emitted


def _held(light: EmittedLight, followed: Mapping[str, Material]) -> Iterator[str]:
    """What is to be told of indices that follow materials beyond where these are known."""
    for name, of in followed.items():
        shortest, longest = of.range_nm
        at = light.wavelength_nm
        outside = float(light.weights[(at < shortest) | (at > longest)].sum())
        if of.is_dispersive and outside > _NOTEWORTHY:
            yield (
                f"{100 * outside:.1f} % of the emission is outside {shortest:g} to {longest:g} nm, "
                f"where the index of {of.name} is known: {name} is held there as at the end"
            )


def _as_named(table: DataTable, column: int) -> str:
    """Name of a column with its unit, as scenes have it."""
    if table.names is None:
        return ""
    name, unit = table.names[column].strip(), table.units[column]
    return f"{name}_nm" if unit == "nm" and not name.endswith("nm") else name


def _columns(
    table: DataTable, names: list[str], scene: SceneFile
) -> tuple[Array, dict[str, Array]]:
    """Wavelengths, rising, and the other columns by name."""
    columns: dict[str, Array] = {}
    for column, name in enumerate(names):
        numbers = [n for n, value in scene.parameters.items() if isinstance(value, float)]
        if name not in (WAVELENGTH, EMISSION, EFFICIENCY, *numbers):
            mend = did_you_mean(name, [EMISSION, EFFICIENCY, *numbers])
            problem = f"{scene.path.name} has no parameter {name!r}"
            raise table.refusal(None, column, problem, mend)
        unit, of_name = table.units[column], unit_of(name)
        if None not in (unit, of_name) and unit != of_name:
            problem = f"{name} is said to be in {unit}"
            raise table.refusal(None, column, problem, f"give it in {of_name}, as its name says")
        values = table.values[:, column]
        low, high = (0.0, 1.0) if name == EFFICIENCY else (0.0, math.inf)
        wrong = (values < low) | (values > high)
        if name in (EFFICIENCY, *COEFFICIENTS) and wrong.any():
            row = int(wrong.argmax())
            problem = f"{name} = {values[row]:g} is out of range"
            raise table.refusal(row, column, problem, f"give {low:g} to {high:g}")
        if name in scene.overrides:
            problem = f"{name} is a column, and was given a value too"
            raise table.refusal(None, column, problem, "leave one of them out")
        columns[name] = values
    order = np.argsort(columns[WAVELENGTH], kind="stable")
    same = np.diff(columns[WAVELENGTH][order]) <= 0.0
    if same.any():
        row = int(order[int(same.argmax()) + 1])
        problem = f"{columns[WAVELENGTH][row]:g} nm stands there twice"
        raise table.refusal(row, names.index(WAVELENGTH), problem, "keep one of the rows")
    columns = {name: values[order] for name, values in columns.items()}
    return columns.pop(WAVELENGTH), columns


def _grid(emission: Spectrum) -> Array:
    """Wavelengths at which eta is asked for: steps of `_STEP_NM`, where there is light."""
    steps = max(math.ceil((emission.last_nm - emission.first_nm) / _STEP_NM), 2)
    grid = np.linspace(emission.first_nm, emission.last_nm, steps + 1)
    bright = np.flatnonzero(emission.at(grid) > _FAINT * emission.values.max())
    if len(bright) < 2:
        return grid
    first, last = max(int(bright[0]) - 1, 0), min(int(bright[-1]) + 2, len(grid))
    return np.asarray(grid[first:last], float)
