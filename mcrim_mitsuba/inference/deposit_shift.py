"""What it does to a campaign's readings where gammas stop, by a map of eta.

A model whose light is born everywhere predicts the mean of eta over the crystal. Gammas of low
energy stop near the face that they enter by, and their peak has the mean over these places: by as
much as this is lower, the light yield comes out too low. A source whose place is not known makes
this an error, which all readings share.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.efficiency.lighting import EtaMap, Spread, all_spreads, read_map


@dataclass(frozen=True)
class PlaceShift:
    """Gammas that stop in these places instead of everywhere."""

    #: In words.
    source: str
    #: Mean of eta over them, and its Monte Carlo error.
    eta: float
    eta_sigma: float
    #: Relative shifts of eta and, if the model has light born everywhere, of the light yield that
    #: the reading gives when it is put right, with their common error.
    eta_shift: float
    yield_shift: float
    sigma: float


@dataclass(frozen=True)
class Places:
    """Shifts of the readings whose bench the map is of."""

    #: Labels of these readings.
    readings: tuple[str, ...]
    #: The first is everywhere.
    shifts: tuple[PlaceShift, ...]

    @property
    def half_range(self) -> float:
        """Half of what lies between the largest and the smallest of the light yields, relative."""
        moved = [one.yield_shift for one in self.shifts]
        return 0.5 * (max(moved) - min(moved))

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts."""
        return asdict(self) | {"half_range": self.half_range}


def places_of(
    campaign: Campaign, path: str | Path, depth_mm: float, deposits: str | Path | None = None
) -> Places:
    """What the places do to the readings of the bench of the map that ``simulate --map`` wrote.

    `depth_mm` is the 1/e depth of gammas that stop near a face, deposits as of
    `EtaMap.of_deposits`.

    Raises InputError if the file is no map, or one of another bench than every reading, or deposits
    are wrong.
    """
    mapped = read_map(path)
    scene = campaign.scene.parameters
    # fitted ones move eta everywhere alike
    free = {ALPHA_SCAT, ALPHA_ABS, *campaign.parameters}
    readings = tuple(
        one.label
        for one in campaign.measurements.readings
        if not one.of_beam and _same_bench({**scene, **one.parameters}, mapped.parameters, free)
    )
    if not readings:
        problem = "the map is of another bench than any reading of the campaign"
        mend = "map the campaign's scene with the parameters of a reading (-D n_gap=...)"
        raise InputError(problem, mend, path=path)
    everywhere, *others = all_spreads(mapped, depth_mm, deposits)
    shifts = [_shift(mapped, one, everywhere) for one in (everywhere, *others)]
    return Places(readings, tuple(shifts))


def _same_bench(reading: dict[str, Value], mapped: Any, free: set[str]) -> bool:
    """Whether a reading's bench is that of a map, `free` parameters left out."""
    for name in (reading.keys() & mapped.keys()) - free:
        one, other = reading[name], mapped[name]
        numbers = not any(isinstance(value, str | bool) for value in (one, other))
        alike = np.isclose(one, other, rtol=1e-9) if numbers else str(one) == str(other)
        if not alike:
            return False
    return True


def _shift(mapped: EtaMap, spread: Spread, everywhere: Spread) -> PlaceShift:
    """Cells are common to both, and so is their noise."""
    inside = mapped.volume > 0.0
    part, own = (one.light[inside] / one.light.sum() for one in (everywhere, spread))
    ratio = spread.eta / everywhere.eta
    away = (own / spread.eta - part / everywhere.eta) * mapped.eta_sigma[inside]
    sigma = ratio * float(np.sqrt(away @ away))
    return PlaceShift(
        spread.source, spread.eta, spread.eta_sigma, ratio - 1.0, 1.0 / ratio - 1.0, sigma
    )
