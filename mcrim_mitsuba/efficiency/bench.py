"""The plain bench by its parameters, as scenes name them, for what knows no scenes.

The solver without photons (`polished_box`) and Geant4 (`scripts/geant4.py`) are told theirs so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.scene.check_text import is_filled


def _between(default: Any, lowest: float, highest: float) -> Any:
    """A field whose value is a number from `lowest` to `highest`."""
    return field(default=default, metadata={"range": (lowest, highest)})


#: The least number above 0.
_ABOVE_0 = math.ulp(0.0)


@dataclass(frozen=True)
class Bench:
    """A box-shaped, polished, bare crystal on a window, coupled through a thin gap.

    Lengths are in mm, coefficients in 1/cm. The defaults are the CaMoO4 bench
    of V. Alenkov et al., JINST 8 P06002 (2013).

    Raises InputError if a value has the wrong type or lies outside its range.
    """

    #: The crystal: x, y in +-width/2, z in [0, height].
    crystal_width_mm: float = 10.0
    crystal_height_mm: float = 10.0
    #: Refractive indices, at least 1 (outside is air, exactly 1).
    n_crystal: float = 2.01
    #: Isotropic bulk scattering and absorption of the crystal.
    alpha_scat_per_cm: float = 0.54
    alpha_abs_per_cm: float = 0.039
    #: Thickness of the coupling slab under the crystal's footprint.
    gap_mm: float = 0.05
    n_gap: float = 1.0
    #: The square plate under the gap; its whole back face detects.
    window_width_mm: float = 28.0
    window_thickness_mm: float = 1.0
    n_window: float = 1.52
    #: Hole of the black mask that lies on the plate's entrance face.
    aperture_radius_mm: float = 14.0
    #: Track the polarisation state instead of averaging s and p.
    polarization: bool = False
    #: Absorption in the window, and of a liquid in the gap.
    window_absorption_per_cm: float = 0.0
    gap_absorption_per_cm: float = 0.0
    #: Emission falls off below the top face as exp(-depth / source_depth_mm);
    #: infinity for uniform emission.
    source_depth_mm: float = _between(math.inf, _ABOVE_0, math.inf)
    #: Added to ``gap_mm``, and to the index of a liquid.
    gap_offset_mm: float = _between(0.0, -math.inf, math.inf)
    gap_index_offset: float = _between(0.0, -math.inf, math.inf)
    #: Light is detected with probability 1 - angular (1 - cos theta), over 1 - angular if that is
    #: negative, else absorbed.
    angular_falloff: float = _between(0.0, -1.0, 1.0)

    def __post_init__(self) -> None:
        for attribute in fields(self):
            name, value = attribute.name, getattr(self, attribute.name)
            if isinstance(attribute.default, bool):
                _require(isinstance(value, bool), name, value, "true or false")
            else:
                # an index, a length or a coefficient
                lowest = {"mm": _ABOVE_0, "cm": 0.0}.get(name.rpartition("_")[2], 1.0)
                limits = attribute.metadata.get("range", (lowest, math.inf))
                object.__setattr__(self, name, _number(name, value, *limits))
        covers = self.window_width_mm >= self.crystal_width_mm
        leaves_1 = f"an offset that leaves an index of at least 1 (n_gap = {self.n_gap})"
        for name, fits, expected in (
            ("window_width_mm", covers, f"at least crystal_width_mm = {self.crystal_width_mm}"),
            ("gap_offset_mm", self.gap_thickness_mm > 0.0, f"more than -gap_mm = -{self.gap_mm}"),
            ("gap_index_offset", self.gap_index >= 1.0, leaves_1),
        ):
            _require(fits, name, getattr(self, name), expected)

    @property
    def is_filled(self) -> bool:
        """Whether a liquid fills the gap."""
        return is_filled(self.n_gap)

    @property
    def gap_thickness_mm(self) -> float:
        """Thickness of the gap, its offset included."""
        return self.gap_mm + self.gap_offset_mm

    @property
    def gap_index(self) -> float:
        """Index of what fills the gap, its offset included."""
        return self.n_gap + (self.gap_index_offset if self.is_filled else 0.0)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Any]) -> Bench:
        """Build a bench from scene parameters; what is not named keeps its default.

        Raises InputError for a name that is not an attribute, unless its value is 0: silently
        leaving a parameter out would make the comparison meaningless.
        """
        names = {attribute.name for attribute in fields(cls)}
        unknown = sorted(name for name, value in parameters.items() if value and name not in names)
        if unknown:
            problem = f"the plain bench knows no {', '.join(unknown)}"
            raise InputError(problem, "leave it out, or simulate photons")
        return cls(**{name: value for name, value in parameters.items() if name in names})


def _number(name: str, value: Any, lowest: float, highest: float) -> float:
    """A number in its range as a plain float (NumPy scalars and ints come in)."""
    infinite = name == "source_depth_mm"
    expected = _range_in_words(lowest, highest, infinite)
    _require(not isinstance(value, (bool, str)), name, value, expected)
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        _require(False, name, value, expected)
    finite = math.isfinite(number) or (infinite and number == math.inf)
    _require(finite and lowest <= number <= highest, name, value, expected)
    return number


def _range_in_words(lowest: float, highest: float, infinite: bool) -> str:
    if lowest == -math.inf:
        return "a finite number"
    if highest < math.inf:
        return f"a number from {lowest:g} to {highest:g}"
    if infinite:
        return "a number above 0, or infinity"
    if lowest == math.ulp(0.0):
        return "a finite number above 0"
    return f"a finite number, at least {lowest:g}"


def _require(condition: bool, name: str, value: Any, expected: str) -> None:
    if not condition:
        raise InputError(f"{name} = {value!r} cannot be used", f"give {expected}")
