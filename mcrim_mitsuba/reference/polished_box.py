"""Eta of a polished box without photons: cosine modes in the unfolded crystal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.core.run import one_thread
from mcrim_mitsuba.reference.bench import Bench
from mcrim_mitsuba.reference.box_openings import (
    EndCones,
    FallingLight,
    Floats,
    Nodes,
    SideCone,
    edges_in_reach,
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

    def __sub__(self, other: Any) -> _Dual:
        other = _dual(other)
        return _Dual(self.value - other.value, self.slope - other.slope)

    def __rsub__(self, other: Any) -> _Dual:
        return _Dual(other - self.value, -self.slope)

    def __mul__(self, other: Any) -> _Dual:
        if not isinstance(other, _Dual):
            return _Dual(self.value * other, self.slope * other)
        return _Dual(self.value * other.value, self.slope * other.value + self.value * other.slope)

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
    ends: EndCones
    cone: SideCone
    falling: FallingLight | None

    @classmethod
    def of(cls, bench: Bench, nodes: Nodes) -> _Modes:
        ends, cone = end_cones(bench, nodes), side_cone(bench, nodes)
        return cls(bench, nodes, ends, cone, side_light(bench, nodes))

    def source(self) -> Floats:
        """Means of the modes over the places where light is born: (N,)."""
        depth, height = self.bench.source_depth_mm, self.bench.crystal_height_mm
        across, upwards = self.nodes.across, self.nodes.upwards
        means = np.zeros((across, across, upwards))
        means[0, 0, 0] = 1.0
        if depth < math.inf:
            _, kz = self.wave_numbers
            parity = np.where(np.arange(upwards) % 2, -1.0, 1.0)
            rest = math.exp(-height / depth)
            means[0, 0] = (
                parity * (1.0 - rest * parity) / ((1.0 + (kz * depth) ** 2) * (1.0 - rest))
            )
        return means.ravel()

    def fewer(self) -> _Array:
        """Indices of a part of the modes that is enough for an estimate of the others' share."""
        across, upwards = self.nodes.across, self.nodes.upwards
        kept = np.zeros((across, across, upwards), dtype=bool)
        kept[: across - 1, : across - 1, : math.ceil(0.7 * upwards)] = True
        return np.flatnonzero(kept.ravel())

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
            half[i, j, :, i, j, :] += part + part.swapaxes(0, 1)
            half += more + more.transpose(1, 0, 2, 4, 3, 5)
        i, m = np.ogrid[:across, :upwards]
        block, seen, gone = self._sides(alpha)
        for half, part in zip(kernel, block.parts, strict=True):
            half[:, i, m, :, i, m] += part
            half[i, :, m, i, :, m] += part
        detected, left = detected + seen, left + gone
        detected = detected + detected.map(lambda x: x.swapaxes(0, 1))
        left = left + left.map(lambda x: x.swapaxes(0, 1))
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
        _, kz = self.wave_numbers
        top, density = ends.reflectance_top, _Dual(alpha, 1.0)
        many = np.where(kz > 0.0, 2.0, 1.0)
        parity = np.where(np.arange(upwards) % 2, -1.0, 1.0)

        # one lateral wave at a time: kappa = (p, q) and (p, -q)
        mirror = ends.reflection.reshape(-1, len(ends.cos))
        gamma, e = _attenuation(alpha, self._phase_by_ends, ends.cos, height)
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
        cos, top = ends.cos[:, None], top[:, None]
        gamma, e = _attenuation(alpha, self._phase_of_coupled, cos, height)
        again = e * e * top
        repeated = 1.0 / (1.0 - again * ends.own)
        wave = _resonance(gamma, kz)
        e_r, repeated_r, top_r = e[..., None], repeated[..., None], top[..., None]
        half_wave = wave * (1.0 - e_r * parity)
        rises = half_wave * (e_r * top_r * parity + 1.0)
        starts = wave * ((1.0 - e_r * parity) + e_r * top_r * (parity - e_r)) * repeated_r
        weighted = rises * repeated_r * (ends.weight / ends.cos)[:, None, None]
        modes = len(ends.signed)
        # many small products: of large ones BLAS makes several threads, which wait for each other
        first = weighted.map(lambda x: x.transpose(1, 2, 0)[:, None])
        second = starts.map(lambda x: x.transpose(1, 0, 2))
        coupling = ends.coupling.transpose(1, 2, 0)[..., None]  # kappa, kappa', n
        coupled = first @ _Dual(coupling * second.value, coupling * second.slope) * density
        coupled = coupled.map(lambda x: self._fold(np.real(x).swapaxes(1, 2)))
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
        seen, gone = (rises * value_at_bottom(x)[..., None] for x in (ends.detection, leaving))
        gone = gone + half_wave * (passed * still)[..., None] * parity
        detected, left = (
            (x * weight[:, None, None]).map(lambda y: self._unfold(np.real(y).sum(axis=0)) * many)
            for x in (seen, gone)
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
        return both

    def _sides(self, alpha: float) -> tuple[_Dual, _Dual, _Dual]:
        """What the two sides across x do: to K by q, r; detected; left."""
        cone, width = self.cone, self.bench.crystal_width_mm
        across, upwards = self.nodes.across, self.nodes.upwards
        kx, _ = self.wave_numbers
        many = np.where(np.arange(across) > 0, 2.0, 1.0)

        gamma, e = self._through_sides(cone, self._phase_by_sides, alpha)
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

    def _falls(self, falling: FallingLight, alpha: float) -> _Dual:
        """Light that leaves through the sides across x, falls to the window and is detected."""
        across, upwards = self.nodes.across, self.nodes.upwards
        kx, kz = self.wave_numbers
        gamma, e = self._through_sides(falling, self._phase_of_falling, alpha)
        flow = (1.0 - e) / (1.0 - e * falling.reflectance) * self._falling_light
        found = flow[..., None, :] @ _resonance(gamma, kx)
        many, many_z = np.where(kx > 0.0, 2.0, 1.0), np.where(kz > 0.0, 2.0, 1.0)
        return found.map(
            lambda x: np.real(x).reshape(across, upwards, 2, across).mean(axis=2).transpose(2, 0, 1)
            * (many[:, None, None] * many[:, None] * many_z)
        )  # fmt: skip

    def _through_sides(self, sides: SideCone, phase: _Phase, alpha: float) -> tuple[_Dual, _Dual]:
        """Attenuation per mm along x, and over the width, of the waves (q, r) and (q, -r)."""
        return _attenuation(alpha, phase, sides.cos, self.bench.crystal_width_mm)

    # Phases do not depend on the coefficients.

    @cached_property
    def _phase_by_ends(self) -> _Phase:
        """Of the waves (p, q) and (p, -q), (waves, n)."""
        ends, (kx, _) = self.ends, self.wave_numbers
        phase = kx[:, None, None, None] * ends.across_x
        phase = phase + (kx[:, None] * [1.0, -1.0])[..., None] * ends.across_y
        phase = phase.reshape(-1, len(ends.cos))
        return _Phase.of(phase, ends.cos, self.bench.crystal_height_mm)

    @cached_property
    def _phase_of_coupled(self) -> _Phase:
        ends, width = self.ends, self.bench.crystal_width_mm
        kappa = 2.0 * math.pi / width * ends.signed
        phase = ends.across_x[:, None] * kappa[:, 0] + ends.across_y[:, None] * kappa[:, 1]
        return _Phase.of(phase, ends.cos[:, None], self.bench.crystal_height_mm)

    @cached_property
    def _phase_by_sides(self) -> _Phase:
        return self._phase_across(self.cone)

    @cached_property
    def _phase_of_falling(self) -> _Phase:
        assert self.falling is not None
        return self._phase_across(self.falling)

    def _phase_across(self, sides: SideCone) -> _Phase:
        kx, kz = self.wave_numbers
        phase = kx[:, None, None, None] * sides.across_y
        phase = phase + (kz[:, None] * [1.0, -1.0])[..., None] * sides.across_z
        return _Phase.of(phase.reshape(-1, len(sides.cos)), sides.cos, self.bench.crystal_width_mm)

    @cached_property
    def _falling_light(self) -> _Array:
        """Fourier components over a side of what leaves it, by (q, r) and (q, -r): (waves, n)."""
        falling = self.falling
        assert falling is not None
        width, height = self.bench.crystal_width_mm, self.bench.crystal_height_mm
        kx, kz = self.wave_numbers
        low, high = falling.lowest_mm, falling.highest_mm
        k = (kz[:, None] * [1.0, -1.0])[..., None]
        waves = (np.exp(1j * k * high) - np.exp(1j * k * low)) / np.where(k == 0.0, 1.0, 1j * k)
        heights = np.where(k == 0.0, high - low, waves)
        light = np.exp(-1j * kx[:, None] * falling.foot_mm)[:, None, None] * heights
        light = light * (falling.weight / (2.0 * height * width))
        return light.reshape(-1, len(falling.cos))


class _Phase(NamedTuple):
    """Phases of waves along a flight, by mm and by the box's length, both along an axis."""

    per_mm: _Array
    turn: _Array

    @classmethod
    def of(cls, across: _Array, cos: Floats, length_mm: float) -> _Phase:
        per_mm = across / cos
        return cls(per_mm, np.exp(1j * per_mm * length_mm))


def _attenuation(alpha: float, phase: _Phase, cos: Floats, length_mm: float) -> tuple[_Dual, _Dual]:
    """Complex attenuation per mm along an axis, and over a length."""
    passed = np.exp(-alpha * length_mm / cos) * phase.turn
    return (
        _Dual(alpha / cos - 1j * phase.per_mm, 1.0 / cos),
        _Dual(passed, -length_mm / cos * passed),
    )


def _resonance(gamma: _Dual, k: _Array) -> _Dual:
    """gamma / (gamma^2 + k^2), with k along a new last axis."""
    g, slope = gamma.value[..., None], np.asarray(gamma.slope)[..., None]
    squared, k_squared = g * g, k * k
    inverse = 1.0 / (squared + k_squared)
    return _Dual(g * inverse, (k_squared - squared) * inverse * inverse * slope)


@dataclass(frozen=True, eq=False)
class BoxEfficiency:
    """Light collection of one bench at pairs of coefficients; arrays of the pairs' shape."""

    #: 1/cm.
    alpha_scat_per_cm: Floats
    alpha_abs_per_cm: Floats
    #: Probability that emitted light is detected.
    eta: Floats
    #: Its derivatives by the two coefficients, in cm; NaN where both are 0: trapped light is freed
    #: by the least of scattering.
    eta_by_alpha_scat_cm: Floats
    eta_by_alpha_abs_cm: Floats
    #: Estimate of the error of `eta`, absolute, from fewer modes and nodes.
    error: Floats
    #: What becomes of emitted light: detected; absorbed_crystal; trapped, for ever, where both
    #: coefficients are 0; and elsewhere, which left the crystal and is not detected. Each is worked
    #: out on its own, so that their sum is a check.
    fates: dict[str, Floats]


@one_thread()
def solve_box(
    bench: Bench,
    alpha_scat_per_cm: ArrayLike | None = None,
    alpha_abs_per_cm: ArrayLike | None = None,
) -> BoxEfficiency:
    """Light collection of a polished box, without statistical noise.

    Method and limits: docs/theory.md, "Without photons".

    Parameters
    ----------
    alpha_scat_per_cm, alpha_abs_per_cm : array_like, optional
        Pairs of coefficients, which broadcast; the bench's own if not given.

    Raises
    ------
    InputError
        If the bench has what the method does not know, or a coefficient is negative.
    """
    refuse_other_boxes(bench)
    scat = bench.alpha_scat_per_cm if alpha_scat_per_cm is None else alpha_scat_per_cm
    absorb = bench.alpha_abs_per_cm if alpha_abs_per_cm is None else alpha_abs_per_cm
    scat, absorb = np.broadcast_arrays(np.asarray(scat, float), np.asarray(absorb, float))
    for name, values in (("alpha_scat_per_cm", scat), ("alpha_abs_per_cm", absorb)):
        if not (np.isfinite(values).all() and (values >= 0.0).all()):
            raise InputError(f"{name} has a value that is negative or no number", "give 0 or more")
    choices = [_nodes(bench, s, a) for s, a in zip(scat.flat, absorb.flat, strict=True)]
    columns = np.empty((len(_COLUMNS), scat.size))
    for nodes in set(choices):
        which = [i for i, choice in enumerate(choices) if choice == nodes]
        modes, fewer = _Modes.of(bench, nodes), _Modes.of(bench, _coarser(nodes))
        # nodes matter most where light goes far and where it does not
        total = (scat + absorb).flat
        ends = {min(which, key=total.__getitem__), max(which, key=total.__getitem__)}
        by_nodes = 0.0
        for i in which:
            columns[:, i] = _point(modes, scat.flat[i], absorb.flat[i])
            if i in ends:
                other = _point(fewer, scat.flat[i], absorb.flat[i])
                by_nodes = max(by_nodes, abs(columns[0, i] / other[0] - 1.0))
        relative = (
            (_LEAST_ERROR_OF_CUT_HOLES if _is_cut(bench) else _LEAST_ERROR)
            + by_nodes
            + _SECOND_ORDER * (bench.gap_thickness_mm / bench.crystal_width_mm) ** 2
        )
        columns[3, which] += relative * columns[0, which]
    shaped = columns.reshape(-1, *scat.shape)
    eta, by_scat, by_abs, error, absorbed, trapped, left = shaped
    fates = {
        "detected": eta, "absorbed_crystal": absorbed, "trapped": trapped, "elsewhere": left - eta,
    }  # fmt: skip
    return BoxEfficiency(scat, absorb, eta, by_scat, by_abs, error, fates)


_COLUMNS = ("eta", "by scattering", "by absorption", "error", "absorbed", "trapped", "left")
#: What light that leaves a gap of a crystal's width at its sides, and what is worked out for it in
#: first order only, changes of eta: from 100 million photons at gaps of 0.5 and 2 mm.
_SECOND_ORDER = 0.01
#: Relative; fewer nodes may agree by chance, as they did to this on some of 200 random benches.
_LEAST_ERROR, _LEAST_ERROR_OF_CUT_HOLES = 4e-5, 2e-4
#: Extinction, per mm, that stands for none: the first flights of trapped light end somewhere.
_NO_EXTINCTION = 1e-9
#: Radius of a mask, in widths of the crystal, that covers no more than the tips of its corners.
_TIPS = 0.68


def _nodes(bench: Bench, scat_per_cm: float, abs_per_cm: float) -> Nodes:
    """How many modes and nodes a pair of coefficients takes."""
    per_mm = (scat_per_cm + abs_per_cm) / MM_PER_CM
    collides = scat_per_cm / max(scat_per_cm + abs_per_cm, 1e-300)
    thick, wide = (collides * per_mm * x for x in (bench.crystal_height_mm, bench.crystal_width_mm))
    upwards = 5 + 2 * min(math.ceil(0.6 * thick), 12)
    across = min(2 + math.ceil(0.4 * max(wide - 1.5, 0.0)), 7)
    if bench.source_depth_mm < math.inf:
        upwards = max(upwards, 16)
    foot, coupled = (10 if _is_cut(bench) else 7), 1
    cosine = 14 if bench.gap_index <= bench.n_window else 18
    if _covers_corners(bench):
        across = max(across, 3)
        # under the tips of the corners alone the mask couples no further waves
        tips = bench.aperture_radius_mm >= _TIPS * bench.crystal_width_mm
        foot, coupled = (8, 1) if tips else (foot, 2)
    return Nodes(across, upwards, cosine, azimuth=5, foot=foot, coupled=coupled)


def _covers_corners(bench: Bench) -> bool:
    """Whether the mask reaches under the crystal."""
    return bench.aperture_radius_mm < bench.crystal_width_mm / math.sqrt(2.0)


def _is_cut(bench: Bench) -> bool:
    """Whether crystal or plate cut the mask's hole: what falls into it has kinks then."""
    return _covers_corners(bench) or bench.aperture_radius_mm > bench.window_width_mm / 2.0


def _coarser(nodes: Nodes) -> Nodes:
    return nodes._replace(cosine=nodes.cosine - 3, azimuth=4, foot=nodes.foot - 2, coupled=1)


def _point(modes: _Modes, scat_per_cm: float, abs_per_cm: float) -> tuple[float, ...]:
    """`_COLUMNS` of one pair."""
    alpha = max((scat_per_cm + abs_per_cm) / MM_PER_CM, _NO_EXTINCTION)
    albedo = scat_per_cm / MM_PER_CM / alpha
    kernel, detected, left = modes.system(alpha)
    source = modes.source()
    size = len(source)
    equations = np.eye(size) - albedo * kernel.value
    f = np.linalg.solve(equations, detected.value)
    visits = np.linalg.solve(equations.T, source)
    eta = source @ f
    by_alpha = visits @ (detected.slope + albedo * (kernel.slope @ f)) / MM_PER_CM
    by_albedo = visits @ kernel.value @ f / (alpha * MM_PER_CM)
    by_scat = by_alpha + (1.0 - albedo) * by_albedo
    by_abs = by_alpha - albedo * by_albedo
    absorbed = (1.0 - albedo) * (visits @ kernel.value[:, 0])
    trapped = 0.0
    if scat_per_cm + abs_per_cm == 0.0:
        absorbed, trapped, by_scat, by_abs = 0.0, absorbed, math.nan, math.nan
    few = modes.fewer()
    rougher = source[few] @ np.linalg.solve(equations[np.ix_(few, few)], detected.value[few])
    gone = visits @ left.value
    error = abs(eta - rougher) + eta * abs(1.0 - gone - absorbed - trapped)
    return tuple(map(float, (eta, by_scat, by_abs, error, absorbed, trapped, gone)))


_ABSENT = (
    "polarization", "wrap_reflectance", "scattering_g", "rayleigh_scattering",
    "scattering_gradient", "roughness_alpha", "top_roughness_alpha", "side_roughness_alpha",
    "bottom_roughness_alpha", "rms_roughness_nm", "surface_loss", "chamfer_mm", "top_reflectance",
    "gap_absorption_per_cm", "bubble_fraction", "bubble_area_fraction", "collar_mm",
    "aperture_at_detector", "detector_reflectance", "detector_specular", "cathode_nm",
    "radial_falloff", "mask_offset_mm", "housing_reflectance", "beam_diameter_mm",
    "narrow_collar_mm", "black_spot_mm",
)  # fmt: skip


def refuse_other_boxes(bench: Bench) -> None:
    """Refuse what the solver does not know, in one line.

    Raises
    ------
    InputError
        Names the parameter and the mend.
    """
    mend = "leave it out, or simulate photons"
    # modes that are odd in x would be needed for a source at a side
    for name in (*_ABSENT, *(["side_depth_mm"] if bench.side_depth_mm < math.inf else [])):
        if getattr(bench, name):
            raise InputError(f"the solver without photons knows no {name}", mend)
    n, n_gap, n_window = bench.n_crystal, bench.gap_index, bench.n_window
    if edges_in_reach(bench):
        raise InputError(
            f"window_width_mm = {bench.window_width_mm:g}: light leaves through the plate's edges, "
            "which the solver without photons does not know",
            "take a wider or thinner plate, or simulate photons",
        )  # fmt: skip
    half, radius = bench.crystal_width_mm / 2.0, bench.aperture_radius_mm
    least = math.sqrt(2.0) * half if n_gap > n_window else half
    if radius < least:
        raise InputError(
            f"aperture_radius_mm = {radius:g}: the mask lies under much of the crystal, which "
            "the solver without photons does not know",
            f"take {least:.4g} or more, or simulate photons",
        )  # fmt: skip
    for name, value, least, why in (
        ("n_crystal", n, math.sqrt(n_gap**2 + 1.0), "light may leave through bottom and sides"),
        ("n_window", n_window, math.sqrt(2.0), "light from air may leave the plate's edges"),
    ):
        if value < least:
            raise InputError(
                f"{name} = {value:g}: below {least:.4g} {why}, which the solver without photons "
                "does not know", "take a larger one, or simulate photons",
            )  # fmt: skip
