"""The scene's parameters: what the tracer can express, in the units people use."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from mcrim_mitsuba.errors import InputError


@dataclass(frozen=True)
class Bench:
    """A scintillating crystal on a window, coupled through a thin gap.

    Lengths are in mm, coefficients in 1/cm. The defaults are the CaMoO4 bench
    of V. Alenkov et al., JINST 8 P06002 (2013).

    Attributes
    ----------
    crystal_width_mm, crystal_height_mm : float
        The crystal: x, y in +-width/2, z in [0, height].
    n_crystal, n_gap, n_window : float
        Refractive indices, at least 1 (outside is air, exactly 1).
    alpha_scat_per_cm, alpha_abs_per_cm : float
        Isotropic bulk scattering and absorption of the crystal.
    gap_mm : float
        Thickness of the coupling slab under the crystal's footprint.
    window_width_mm, window_thickness_mm : float
        The square plate under the gap; its whole back face detects.
    aperture_radius_mm : float
        Hole of the black mask that lies on the plate's entrance face.
    polarization : bool
        Track the polarisation state instead of averaging s and p.
    gap_absorption_per_cm, window_absorption_per_cm : float
        Absorption in gap and window, whatever fills the gap.
    wrap_reflectance : float or None
        Reflectance, 0 to 1, of a Lambertian wrap behind an air film around the
        top and the four sides; None for a bare crystal. The wrap is a box open
        at z = 0, and its outside absorbs.
    film_mm : float
        Thickness of that air film; without meaning for a bare crystal.

    Raises
    ------
    InputError
        If a value has the wrong type or lies outside its range.
    """

    crystal_width_mm: float = 10.0
    crystal_height_mm: float = 10.0
    n_crystal: float = 2.01
    alpha_scat_per_cm: float = 0.54
    alpha_abs_per_cm: float = 0.039
    gap_mm: float = 0.05
    n_gap: float = 1.0
    window_width_mm: float = 28.0
    window_thickness_mm: float = 1.0
    n_window: float = 1.52
    aperture_radius_mm: float = 14.0
    polarization: bool = False
    gap_absorption_per_cm: float = 0.0
    window_absorption_per_cm: float = 0.0
    wrap_reflectance: float | None = None
    film_mm: float = 0.01

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "polarization":
                _require(isinstance(value, bool), field.name, value, "true or false")
            elif field.name == "wrap_reflectance":
                if value is not None:
                    self._keep_number(field.name, value, 0.0, 1.0)
            elif field.name.endswith("_mm"):
                self._keep_number(field.name, value, math.ulp(0.0), math.inf)
            elif field.name.endswith("_per_cm"):
                self._keep_number(field.name, value, 0.0, math.inf)
            else:
                self._keep_number(field.name, value, 1.0, math.inf)
        _require(
            self.window_width_mm >= self.crystal_width_mm,
            "window_width_mm",
            self.window_width_mm,
            f"at least crystal_width_mm = {self.crystal_width_mm}",
        )

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Any]) -> Bench:
        """Build a bench from scene parameters; what is not named keeps its default.

        Parameters
        ----------
        parameters : mapping of str to float or bool
            Values by the names of this class's attributes.

        Raises
        ------
        InputError
            For a name that is not an attribute: silently leaving a parameter
            out would make the comparison meaningless.
        """
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(parameters) - known)
        if unknown:
            raise InputError(
                f"the NumPy tracer cannot express {', '.join(unknown)}",
                f"leave it out, or use only {', '.join(sorted(known))}",
            )
        return cls(**parameters)

    def _keep_number(self, name: str, value: Any, lowest: float, highest: float) -> None:
        """Check a number and keep it as a plain float (NumPy scalars and ints come in)."""
        expected = _range_in_words(lowest, highest)
        _require(not isinstance(value, (bool, str)), name, value, expected)
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            _require(False, name, value, expected)
        _require(math.isfinite(number) and lowest <= number <= highest, name, value, expected)
        object.__setattr__(self, name, number)


def whole_number(name: str, value: Any, lowest: int) -> int:
    """Return ``value`` as an int of at least ``lowest``.

    Raises
    ------
    InputError
        If it is no whole number or too small.
    """
    expected = f"a whole number, at least {lowest}"
    _require(not isinstance(value, bool), name, value, expected)
    try:
        number = operator.index(value)
    except TypeError:
        _require(False, name, value, expected)
    _require(number >= lowest, name, value, expected)
    return number


def _range_in_words(lowest: float, highest: float) -> str:
    if highest < math.inf:
        return f"a number from {lowest:g} to {highest:g}"
    if lowest == math.ulp(0.0):
        return "a finite number above 0"
    return f"a finite number, at least {lowest:g}"


def _require(condition: bool, name: str, value: Any, expected: str) -> None:
    if not condition:
        raise InputError(f"{name} = {value!r} cannot be used", f"give {expected}")
