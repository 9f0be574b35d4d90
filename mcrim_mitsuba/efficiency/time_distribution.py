"""Distributions of arrival times in cells: their means, quantiles, folding with a decay, and the
first photons of many.

Times are kept in cells of a ten-thousandth of their range, each at the mean time of the light in
it, so that light that arrives at once does so here as well. Weights are kept by groups of
independent photons: leaving one group out after the other gives the error of every number that is
made of the distribution (the jackknife; B. Efron and C. Stein, Ann. Stat. 9 (1981) 586).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.descent import Array

#: Groups of the jackknife: they tell an error to 13 per cent.
GROUPS = 32
#: How many of an event's first photons are told of.
FIRST = 10


@dataclass(frozen=True, kw_only=True)
class CellSettings:
    """How finely times are kept."""

    #: Cells of one width over the times of nearly all light; those beyond grow by this part.
    cells: int = 8192
    growth: float = 0.002
    #: What the cells reach to: times that of nearly all light, and decay times.
    latest: float = 64.0
    decays: float = 40.0
    #: What cells add to the error of a time: of their width, and of the time, with which they grow.
    error_of_width: float = 0.02
    error_of_time: float = 1e-6


SETTINGS = CellSettings()


def cell_edges(begin_ps: float, end_ps: float, decay_ps: float) -> Array:
    """Borders of cells, (n + 1,) float64, ps: from 0, fine from `begin_ps` to `end_ps`.

    Beyond they grow, over the tail of light that decays with a time of `decay_ps` (or 0), too; the
    last cell has no end.
    """
    begin_ps = max(begin_ps, 0.0)
    # light of one path has no range: cells of the width of rounding
    step = max(end_ps - begin_ps, 1e-3 * max(end_ps, 1e-3)) / SETTINGS.cells
    fine = begin_ps + step * np.arange(SETTINGS.cells + 1)
    latest = SETTINGS.latest * fine[-1] + SETTINGS.decays * decay_ps
    growing = math.ceil(math.log1p((latest - fine[-1]) * SETTINGS.growth / step) / SETTINGS.growth)
    numbers = np.arange(1, growing + 1)
    beyond = fine[-1] + step * np.expm1(SETTINGS.growth * numbers) / SETTINGS.growth
    before = [0.0] if begin_ps > 0.0 else []
    return np.array([*before, *fine, *beyond, math.inf])


class TimeCells:
    """Weights of light in cells of time.

    Their (n + 1,) borders are as `cell_edges` makes them; `slices` are kinds of light that are told
    apart, where it was born, and `parts` are those of the bench that it crosses.
    """

    def __init__(self, edges_ps: Array, slices: int, parts: int = 1) -> None:
        self.edges_ps = edges_ps
        #: Photons that were taken in.
        self.detected = 0
        self._shape = GROUPS, slices, len(edges_ps) - 1
        #: (groups, slices, cells) and (cells,): of light, and of light times time.
        self.light, self._times = np.zeros(self._shape), np.zeros(self._shape[-1])
        #: (groups, 3): of light times the powers 0, 1 and 2 of time.
        self.moments = np.zeros((GROUPS, 3))
        #: (groups, parts): of light times the time that it spends in a part.
        self.spent = np.zeros((GROUPS, parts))

    def add(
        self, times_ps: Array, weight: Array, group: NDArray[np.int64], kind: NDArray[np.int64]
    ) -> None:
        """Take in photons: (parts, detected) times, (detected,) weights, groups and slices."""
        time_ps = times_ps.sum(axis=0)
        cell = np.searchsorted(self.edges_ps, time_ps, side="right") - 1
        place = np.ravel_multi_index((group, kind, cell), self._shape)
        # most of the many cells get none
        np.add.at(self.light.reshape(-1), place, weight)
        self._times += np.bincount(cell, weight * time_ps, self._shape[-1])
        for power in range(3):
            self.moments[:, power] += np.bincount(group, weight * time_ps**power, GROUPS)
        for part, in_part_ps in enumerate(times_ps):
            self.spent[:, part] += np.bincount(group, weight * in_part_ps, GROUPS)
        self.detected += len(weight)

    @property
    def times_ps(self) -> Array:
        """(cells,) mean time of a cell's light; its beginning where there is none."""
        light, begins = self.light.sum(axis=(0, 1)), self.edges_ps[:-1]
        return np.where(light > 0.0, self._times / np.where(light > 0.0, light, 1.0), begins)

    def emitted(self, light: Array, decay_ps: float) -> Array:
        """Light, (..., cells), with the decay of its emission; 0: all is emitted at once."""
        return decayed(self.edges_ps, self.times_ps, light, decay_ps) if decay_ps else light

    def with_cell_errors(self, times_ps: Array, sigmas_ps: Array) -> Array:
        """Errors of times, ps, with what the cells' widths add."""
        of_cells = SETTINGS.error_of_width * (self.edges_ps[2] - self.edges_ps[1])
        return np.sqrt(sigmas_ps**2 + of_cells**2 + (SETTINGS.error_of_time * times_ps) ** 2)


def jackknife(number: Callable[[Array], Array], light: Array) -> tuple[Array, Array]:
    """A number, or several, of all light, and their standard errors.

    `number` makes it of light of the shape (...), of any unit; `light` is (groups, ...) float64.
    """
    whole = light.sum(axis=0)
    without = np.array([number(whole - group) for group in light])
    spread = np.square(without - without.mean(axis=0)).sum(axis=0)
    return number(whole), np.sqrt(spread * (len(light) - 1) / len(light))


def mean_and_rms(moments: Array) -> Array:
    """(2,) mean and standard deviation, from the (3,) sums of `TimeCells.moments`."""
    light, first, second = moments
    mean = first / light
    return np.array([mean, math.sqrt(max(second / light - mean**2, 0.0))])


def before(light: Array) -> Array:
    """Part of the light up to the end of each cell: the shape of the light, (..., cells)."""
    so_far = np.cumsum(light, axis=-1)
    return so_far / so_far[..., -1:]


def arrived_at(edges_ps: Array, light: Array, times_ps: Array) -> Array:
    """Parts of the light, (cells,), that have arrived at times, ps."""
    return -np.expm1(-np.interp(times_ps, *_depletion(edges_ps, light)))


def quantiles(edges_ps: Array, light: Array, parts: Array) -> Array:
    """Times, ps, at which so large parts of the light, (cells,), have arrived."""
    times_ps, depletion = _depletion(edges_ps, light)
    return np.interp(-np.log1p(-parts), depletion, times_ps)


def _depletion(edges_ps: Array, light: Array) -> tuple[Array, Array]:
    """Ends of the cells, and -log of what is still to come there: a line where light decays."""
    ends = np.append(edges_ps[:-1], 2.0 * edges_ps[-2])
    still = np.maximum(1.0 - before(light), np.finfo(float).eps)
    return ends, np.concatenate([[0.0], -np.log(still)])


def decayed(edges_ps: Array, times_ps: Array, light: Array, decay_ps: float) -> Array:
    """Light, (..., cells), that is emitted with a decay of exp(-t / `decay_ps`), by its arrival.

    The cells have (cells + 1,) edges, and the light in them (cells,) times; `light`, (..., cells)
    float64, would arrive there if all were emitted at once.
    """
    widths = np.diff(edges_ps)
    kept = np.exp(-widths / decay_ps)
    # of light that began in a cell, what is still to come at its end
    to_come = np.exp(-np.where(np.isfinite(widths), edges_ps[1:] - times_ps, math.inf) / decay_ps)
    # cell after cell: what waits is one row of memory
    emitted = np.ascontiguousarray(np.moveaxis(light, -1, 0))
    arrived, waiting = np.empty(emitted.shape), np.zeros(emitted.shape[1:])
    for cell, begun in enumerate(emitted):
        remaining = waiting * kept[cell] + begun * to_come[cell]
        arrived[cell] = waiting + begun - remaining
        waiting = remaining
    return np.moveaxis(arrived, 0, -1)


def first_photons(times_ps: Array, light: Array, detected: int, most: int) -> Array:
    """Mean and rms, (2, most), ps, of the arrival of the first, second, ... of `detected` photons.

    They are independent, and each arrives as the light, (cells,), does: the k-th has arrived when
    k or more of them have, which is a binomial probability (H. A. David and H. N. Nagaraja, Order
    Statistics, 3rd ed., Wiley 2003, section 2.1).
    """
    arrived = np.minimum(before(light), 1.0)
    # nothing comes in cells without light, nor where 60 more are expected than are told of, twice:
    # that not all of these are there has a probability of 1e-23
    end = int(np.searchsorted(arrived, (2 * most + 60) / detected)) + 1
    (at,) = light[:end].nonzero()
    arrived, times_ps = arrived[at], times_ps[at]
    left = 1.0 - arrived
    odds = arrived / np.where(left > 0.0, left, 1.0)
    # probability of 0, 1, ... arrivals so far
    chance = np.where(
        left > 0.0, np.exp(detected * np.log1p(-np.where(left > 0.0, arrived, 0.0))), 0.0
    )
    # that fewer have arrived, at the beginning and at the end of every cell
    fewer, mean_and_spread = np.zeros(len(arrived) + 1), np.empty((2, most))
    fewer[0] = 1.0
    for number in range(most):
        fewer[1:] += chance
        part = fewer[:-1] - fewer[1:]
        # no products of BLAS, whose threads wait for each other
        mean = float((part * times_ps).sum())
        variance = float((part * (times_ps - mean) ** 2).sum())
        mean_and_spread[:, number] = mean, math.sqrt(max(variance, 0.0))
        chance = chance * odds * ((detected - number) / (number + 1))
    return mean_and_spread


@dataclass(frozen=True, eq=False, kw_only=True)
class FirstPhotons:
    """When the first, second, ... photon of an event is detected; arrays are (photons,) float64."""

    #: Where the light of an event is born, in words.
    born: str
    mean_ps: Array
    mean_ps_sigma: Array
    rms_ps: Array
    rms_ps_sigma: Array


def first_of_event(
    cells: TimeCells, decay_ps: float, detected: int, births: Array
) -> tuple[FirstPhotons, ...]:
    """First photons of an event of so many detected ones: born everywhere, and at one depth.

    `births`, (slices,) float64, is the part of the events at each depth; without several depths
    there is the first answer alone.
    """
    light, times = cells.emitted(cells.light, decay_ps), cells.times_ps
    if decay_ps:
        edges = cells.edges_ps
        times = np.append(0.5 * (edges[1:-1] + edges[:-2]), edges[-2])
    most = min(FIRST, detected)

    def everywhere(light: Array) -> Array:
        return first_photons(times, light.sum(axis=0), detected, most)

    def at_one_depth(light: Array) -> Array:
        # where no light is detected there is no event of so many photons
        seen = (births > 0.0) & (light.sum(axis=1) > 0.0)
        share = births[seen] / births[seen].sum()
        arrivals = [first_photons(times, of_slice, detected, most) for of_slice in light[seen]]
        means, rms = np.moveaxis(np.array(arrivals), 1, 0)
        mean = share @ means
        return np.array([mean, np.sqrt(share @ (rms**2 + (means - mean) ** 2))])

    numbers = {"everywhere": everywhere}
    if len(births) > 1:
        numbers["at one depth"] = at_one_depth
    first = []
    for born, number in numbers.items():
        values, sigmas = jackknife(number, light)
        (mean, rms), (mean_sigma, rms_sigma) = values, cells.with_cell_errors(values, sigmas)
        photons = FirstPhotons(
            born=born, mean_ps=mean, mean_ps_sigma=mean_sigma, rms_ps=rms, rms_ps_sigma=rms_sigma
        )
        first.append(photons)
    return tuple(first)
