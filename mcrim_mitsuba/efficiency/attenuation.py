"""Attenuation lengths of a bar or fibre, from eta by where along it light is born.

Light that flies along it to an end at the distance x falls as exp(-x / L), so that ln(eta) of one
end is a straight line over the place of birth, with the slope 1 / L, and the logarithm of the ratio
of two ends one with 2 / L, in which losses at birth cancel. Light that an end sees directly falls
otherwise: what the line leaves over tells whether L means anything.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.numbers import ALL_DETECTORS, COUNTED, SOURCE_Z, Value
from mcrim_mitsuba.efficiency.eta_grid import standard_error

#: Scene parameter: in how thick a slab light is born.
SOURCE_WIDTH = "source_width_mm"
#: Places that tell whether a line is straight, at least.
_LEAST_PLACES = 3
#: Standard errors below which a Gaussian number lies with 95 %.
_ONE_SIDED_95 = 1.645


@dataclass(frozen=True, kw_only=True)
class Attenuation:
    """A fitted attenuation length."""

    #: The detector, or two of them as ``left / right``; ``eta`` where the table names none.
    light: str
    #: Other parameters of the table.
    parameters: dict[str, Value]
    #: L, positive, and its standard error: the simulation's, with all that its points share.
    length_mm: float
    length_mm_sigma: float
    #: Largest departure of eta, or of the ratio, from the exponential, relative.
    departure: float

    @property
    def lower_limit_mm(self) -> float:
        """What L exceeds with 95 %: the errors of its inverse, the slope, are Gaussian."""
        return self.length_mm**2 / (self.length_mm + _ONE_SIDED_95 * self.length_mm_sigma)


def attenuations(
    axes: Mapping[str, Sequence[Value]], log_eta: NDArray, deviations: NDArray
) -> tuple[Attenuation, ...]:
    """Lengths for every combination of a table's other values; none without enough places.

    `log_eta` is (values of each axis...), `deviations` (batches, values of each axis...): every
    batch's ln(eta) less that. All is weighted alike: relative errors hardly differ.
    """
    places = np.array(axes.get(SOURCE_Z, ()), dtype=float)
    if len(set(places)) < _LEAST_PLACES or not np.isfinite(log_eta).all():
        return ()
    names = list(axes)
    along = places - places.mean()
    slope_of = along / (along @ along)
    others = [name for name in names if name not in (SOURCE_Z, COUNTED)]
    named = list(axes.get(COUNTED, ["eta"]))
    ends = [name for name in named if name != ALL_DETECTORS] or named
    fits = []
    for values in itertools.product(*(axes[name] for name in others)):
        parameters = dict(zip(others, values, strict=True))
        at = {name: axes[name].index(value) for name, value in parameters.items()}
        lines = {}
        for end in ends:
            chosen = at | ({COUNTED: axes[COUNTED].index(end)} if COUNTED in axes else {})
            place = tuple(chosen.get(name, slice(None)) for name in names)
            lines[str(end)] = log_eta[place], deviations[(slice(None), *place)], 1.0
        if len(lines) == 2:
            (first, of_first, _), (second, of_second, _) = lines.values()
            lines[" / ".join(lines)] = first - second, of_first - of_second, 2.0
        for light, (line, of_batches, times) in lines.items():
            slope = float(slope_of @ line)
            left = line - line.mean() - slope * along
            length_mm = abs(times / slope)
            fit = Attenuation(
                light=light,
                parameters=parameters,
                length_mm=length_mm,
                length_mm_sigma=length_mm**2 / times * float(standard_error(of_batches @ slope_of)),
                departure=float(np.expm1(np.abs(left).max())),
            )
            fits.append(fit)
    return tuple(fits)
