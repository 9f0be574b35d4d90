"""Eta of a polished box without photons: cosine modes in the unfolded crystal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.reference.bench import Bench
from mcrim_mitsuba.reference.box_openings import (
    Ends,
    Nodes,
    Sides,
    end_cones,
    side_cone,
    side_light,
)

_Array = NDArray[Any]


class _Dual:
    """An array and its derivative by alpha, the crystal's extinction per mm."""

    __array_ufunc__ = None  # NumPy leaves array * dual to us

    def __init__(self, value: Any, slope: Any = 0.0) -> None:
        self.value, self.slope = np.asarray(value), slope

    def __add__(self, other: Any) -> _Dual:
        other = _dual(other)
        return _Dual(self.value + other.value, self.slope + other.slope)

    def __neg__(self) -> _Dual:
        return _Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> _Dual:
        other = _dual(other)
        return _Dual(self.value - other.value, self.slope - other.slope)

    def __rsub__(self, other: Any) -> _Dual:
        return _Dual(other - self.value, -self.slope)

    def __mul__(self, other: Any) -> _Dual:
        if not isinstance(other, _Dual):
            return _Dual(self.value * other, self.slope * other)
        return _Dual(
            self.value * other.value, self.slope * other.value + self.value * other.slope
        )

    def __truediv__(self, other: _Dual) -> _Dual:
        quotient = self.value / other.value
        return _Dual(quotient, (self.slope - quotient * other.slope) / other.value)

    def __matmul__(self, other: Any) -> _Dual:
        other = _dual(other)
        slope = self.slope @ other.value
        if np.ndim(other.slope):
            slope = slope + self.value @ other.slope
        return _Dual(self.value @ other.value, slope)

    __radd__, __rmul__ = __add__, __mul__

    def __getitem__(self, key: Any) -> _Dual:
        slope = np.broadcast_to(self.slope, np.shape(self.value))
        return _Dual(self.value[key], slope[key])

    def __rtruediv__(self, other: Any) -> _Dual:
        quotient = other / self.value
        return _Dual(quotient, -quotient / self.value * self.slope)

    def exp(self) -> _Dual:
        value = np.exp(self.value)
        return _Dual(value, value * self.slope)

    @property
    def parts(self) -> tuple[_Array, _Array]:
        """The value and its derivative."""
        return self.value, self.slope

    def map(self, linear: Any) -> _Dual:
        """A linear operation, such as a transposition or a sum, on both."""
        return _Dual(linear(self.value), linear(self.slope))


def _dual(x: Any) -> _Dual:
    return x if isinstance(x, _Dual) else _Dual(x)


@dataclass(frozen=True, eq=False)
class _Modes:
    """The box's modes and what of the bench they need, for one choice of nodes."""

    bench: Bench
    nodes: Nodes
    ends: Ends
    cone: Sides
    falling: Sides | None

    @classmethod
    def of(cls, bench: Bench, nodes: Nodes) -> _Modes:
        order = min(nodes.across - 1, 1)
        return cls(
            bench, nodes, end_cones(bench, nodes, order), side_cone(bench, nodes),
            side_light(bench, nodes),
        )  # fmt: skip

    def system(self, alpha: float) -> tuple[_Dual, _Dual, _Dual]:
        """K, and the probabilities to be detected and to leave before the first collision.

        (N, N), (N,) and (N,) for N modes in the order of p, q, r; alpha is per mm.
        """
        across, upwards = self.nodes.across, self.nodes.upwards
        shape = (across, across, upwards)
        kx, kz = self.wave_numbers
        k = np.sqrt(kx[:, None, None] ** 2 + kx[:, None] ** 2 + kz**2)
        k[0, 0, 0] = 1.0
        arc = np.arctan(k / alpha) / k
        kernel = np.zeros((2, *shape, *shape))
        i, j, m = np.ogrid[:across, :across, :upwards]
        kernel[:, i, j, m, i, j, m] = (alpha * arc, arc - alpha / (alpha**2 + k**2))
        kernel[:, 0, 0, 0, 0, 0, 0] = (1.0, 0.0)

        block, coupled, detected, left = self._ends(alpha)
        i, j = np.ogrid[:across, :across]
        for half, part, more in zip(kernel, block.parts, coupled.parts, strict=True):
            half[i, j, :, i, j, :] += part
            half += more.reshape(*shape, *shape)
        i, m = np.ogrid[:across, :upwards]
        block, seen, gone = self._sides(alpha)
        for half, part in zip(kernel, block.parts, strict=True):
            half[:, i, m, :, i, m] += part
            half[i, :, m, i, :, m] += part
        detected = detected + seen + seen.map(lambda x: x.swapaxes(0, 1))
        left = left + gone + gone.map(lambda x: x.swapaxes(0, 1))
        size = math.prod(shape)
        return (
            _Dual(*kernel.reshape(2, size, size)),
            detected.map(lambda x: x.reshape(size)),
            left.map(lambda x: x.reshape(size)),
        )

    @property
    def wave_numbers(self) -> tuple[_Array, _Array]:
        """Across and upwards, per mm."""
        return (
            2.0 * math.pi / self.bench.crystal_width_mm * np.arange(self.nodes.across),
            math.pi / self.bench.crystal_height_mm * np.arange(self.nodes.upwards),
        )

    def _ends(self, alpha: float) -> tuple[_Dual, _Dual, _Dual, _Dual]:
        """What bottom and top do: to K by p, q; to K across p, q; detected; left."""
        ends, height = self.ends, self.bench.crystal_height_mm
        across, upwards = self.nodes.across, self.nodes.upwards
        kx, kz = self.wave_numbers
        top, density = ends.reflectance_top, _Dual(alpha, 1.0)
        many = np.where(kz > 0.0, 2.0, 1.0)
        parity = np.where(np.arange(upwards) % 2, -1.0, 1.0)

        # one lateral wave at a time: kappa = (p, q) and (p, -q)
        phase = kx[:, None, None, None] * ends.across_x
        phase = phase + (kx[:, None] * [1.0, -1.0])[..., None] * ends.across_y
        phase, mirror = phase.reshape(-1, len(ends.cos)), ends.reflection.reshape(-1, len(ends.cos))
        gamma = _Dual((alpha - 1j * phase) / ends.cos, 1.0 / ends.cos)
        e = (gamma * -height).exp()
        wave = _resonance(gamma, kz)
        value = mirror / (1.0 - e * e * (top * mirror))
        block = np.zeros((2, across, across, upwards, upwards))
        for c in (1.0, -1.0):
            start = (1.0 - e * c) + e * top * (c - e)
            bottom = value * start - 1.0
            above = top * (c - e) - c + top * e * value * start
            right = wave[..., parity == c].map(lambda x: x.swapaxes(-1, -2))
            for c_1 in (1.0, -1.0):
                factor = (1.0 - e * c_1) * (above * c_1 + bottom) * (ends.weight / ends.cos)
                product = right * factor[:, None, :]
                rows, columns = np.flatnonzero(parity == c_1), np.flatnonzero(parity == c)
                matrix = product @ wave[..., parity == c_1]
                matrix = (matrix * density).map(lambda x: np.real(x).swapaxes(-1, -2))
                for half, part in zip(block, matrix.parts, strict=True):
                    folded = part.reshape(across, across, 2, len(rows), len(columns)).mean(axis=2)
                    half[..., rows[:, None], columns] = folded / (2.0 * height)
        block *= many[:, None]

        # lateral waves that the place at the bottom couples
        kappa = kx[1] * ends.signed if across > 1 else 0.0 * ends.signed
        phase = ends.across_x[:, None] * kappa[:, 0] + ends.across_y[:, None] * kappa[:, 1]
        cos, top = ends.cos[:, None], top[:, None]
        gamma = _Dual((alpha - 1j * phase) / cos, 1.0 / cos)
        e = (gamma * -height).exp()
        again = e * e * top
        repeated = 1.0 / (1.0 - again * ends.own)
        wave = _resonance(gamma, kz)
        e_r, repeated_r, top_r = e[..., None], repeated[..., None], top[..., None]
        half_wave = wave * (1.0 - e_r * parity)
        rises = half_wave * (e_r * top_r * parity + 1.0)
        starts = wave * ((1.0 - e_r * parity) + e_r * top_r * (parity - e_r)) * repeated_r
        weighted = rises * repeated_r * (ends.weight / ends.cos)[:, None, None]
        modes = len(ends.signed)
        first = weighted.map(lambda x: x.transpose(1, 2, 0))
        coupling = ends.coupling.transpose(1, 0, 2)  # kappa, n, kappa'
        parts = []
        for one, other in ((first.value, starts.value), (first.slope, starts.value), (first.value, starts.slope)):
            inner = coupling[..., None] * other
            parts.append(one @ inner.reshape(modes, len(ends.cos), modes * upwards))
        coupled = _Dual(parts[0], parts[1] + parts[2]) * density
        coupled = coupled.map(lambda x: self._fold(np.real(x).reshape(modes, upwards, modes, upwards)))
        coupled = coupled * (1.0 / (2.0 * height))

        # detected, and left through bottom or top
        def value_at_bottom(source: Any) -> _Dual:
            alone = repeated * source
            reached = again * alone
            more = _Dual(*(np.einsum("nkl,nl->nk", ends.coupling, x) for x in reached.parts))
            return alone + repeated * more

        middle = modes // 2
        still = np.zeros((1, modes))
        still[0, middle] = 1.0
        passed = 1.0 - top
        through = ends.coupling[:, :, middle] + ends.own * still
        leaving = still - through + e[:, middle : middle + 1] * (through * passed)
        weight = ends.weight / (2.0 * height)
        found = []
        for source in (ends.detection, leaving):
            arrived = rises * value_at_bottom(source)[..., None]
            found.append(arrived)
        found[1] = found[1] + half_wave * (passed * still)[..., None] * parity
        detected, left = (
            (x * weight[:, None, None]).map(lambda y: self._unfold(np.real(y).sum(axis=0)) * many)
            for x in found
        )
        return _Dual(*block), coupled, detected, left

    def _unfold(self, waves: _Array) -> _Array:
        """Sums over the signs of kappa: from (m, r) to (p, q, r)."""
        folded = np.zeros((self.nodes.across, self.nodes.across, waves.shape[-1]))
        np.add.at(folded, tuple(np.abs(self.ends.signed).T), waves)
        return folded

    def _fold(self, waves: _Array) -> _Array:
        """The same on both sides of a matrix, whose columns become means: (N, N)."""
        across, upwards = self.nodes.across, self.nodes.upwards
        many = np.where(np.arange(across) > 0, 2.0, 1.0)
        p, q = np.abs(self.ends.signed).T
        once = np.zeros((across, across, upwards, *waves.shape[2:]))
        np.add.at(once, (p, q), waves)
        once = once.transpose(3, 4, 0, 1, 2)
        both = np.zeros((across, across, upwards, across, across, upwards))
        np.add.at(both, (p, q), once / (many[p] * many[q])[:, None, None, None, None])
        both = both.transpose(3, 4, 5, 0, 1, 2)
        both = both * np.where(np.arange(upwards) > 0, 2.0, 1.0)[:, None, None, None]
        return both.reshape(across * across * upwards, -1)

    def _sides(self, alpha: float) -> tuple[_Dual, _Dual, _Dual]:
        """What the two sides across x do: to K by q, r; detected; left."""
        cone, width = self.cone, self.bench.crystal_width_mm
        across, upwards = self.nodes.across, self.nodes.upwards
        kx, _ = self.wave_numbers
        many = np.where(np.arange(across) > 0, 2.0, 1.0)

        gamma, e = self._through_sides(cone, alpha)
        mirror = cone.reflectance
        wave = _resonance(gamma, kx)
        factor = (1.0 - e) / (1.0 - e * mirror) * (2.0 * (mirror - 1.0) * cone.weight / cone.cos)
        turned = wave.map(lambda x: x.swapaxes(-1, -2))
        block = (turned * factor[:, None, :]) @ wave * _Dual(alpha, 1.0)
        block = block.map(
            lambda x: np.real(x).reshape(across, upwards, 2, across, across).mean(axis=2)
            * many[:, None] / (2.0 * width)
        )  # fmt: skip

        value = (1.0 - e[0]) / (1.0 - e[0] * mirror) * ((1.0 - mirror) * cone.weight / width)
        left = np.zeros((2, across, across, upwards))
        flow = (wave[0] * value[:, None]).map(lambda x: np.real(x).sum(axis=0) * many)
        left[:, :, 0, 0] = flow.parts
        detected = _Dual(*np.zeros_like(left))
        if self.falling is not None:
            detected = self._falls(self.falling, alpha)
        return block, detected, _Dual(*left)

    def _falls(self, falling: Sides, alpha: float) -> _Dual:
        """Light that leaves through the sides across x, falls to the window and is detected."""
        width, height = self.bench.crystal_width_mm, self.bench.crystal_height_mm
        across, upwards = self.nodes.across, self.nodes.upwards
        kx, kz = self.wave_numbers
        kz_signed = kz[:, None] * [1.0, -1.0]
        low, high = falling.lowest_mm, falling.highest_mm
        safe = np.where(kz_signed == 0.0, 1.0, 1j * kz_signed)[..., None]
        heights = (np.exp(1j * kz_signed[..., None] * high) - np.exp(1j * kz_signed[..., None] * low)) / safe
        heights = np.where(kz_signed[..., None] == 0.0, high - low, heights)
        source = np.exp(-1j * kx[:, None] * falling.foot_mm)[:, None, None] * heights
        source = (source * (falling.weight / (2.0 * height * width))).reshape(-1, len(falling.cos))
        gamma, e = self._through_sides(falling, alpha)
        flow = (1.0 - e) / (1.0 - e * falling.reflectance) * source
        found = flow[..., None, :] @ _resonance(gamma, kx)
        many, many_z = np.where(kx > 0.0, 2.0, 1.0), np.where(kz > 0.0, 2.0, 1.0)
        return found.map(
            lambda x: np.real(x).reshape(across, upwards, 2, across).mean(axis=2).transpose(2, 0, 1)
            * (many[:, None, None] * many[:, None] * many_z)
        )  # fmt: skip

    def _through_sides(self, sides: Sides, alpha: float) -> tuple[_Dual, _Dual]:
        """Attenuation per mm along x of the waves (q, r) and (q, -r), and over the whole width."""
        kx, kz = self.wave_numbers
        phase = kx[:, None, None, None] * sides.across_y
        phase = phase + (kz[:, None] * [1.0, -1.0])[..., None] * sides.across_z
        phase = phase.reshape(-1, len(sides.cos))
        gamma = _Dual((alpha - 1j * phase) / sides.cos, 1.0 / sides.cos)
        return gamma, (gamma * -self.bench.crystal_width_mm).exp()


def _resonance(gamma: _Dual, k: _Array) -> _Dual:
    """gamma / (gamma^2 + k^2), with k along a new last axis."""
    gamma = gamma[..., None]
    return gamma / (gamma * gamma + k**2)
