"""Eta of a polished box without photons: cosine modes in the unfolded crystal."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.core.run import one_thread
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.efficiency.box_openings import (
    EndFaceTransfer,
    FallingLight,
    Floats,
    Nodes,
    Rules,
    SideCone,
    chebyshev_nodes,
    covers_corners,
    edges_in_reach,
    end_transfer,
    side_cone,
    side_light,
    through_chebyshev_nodes,
)

_Array = NDArray[Any]


class _Systems(NamedTuple):
    """What the openings add to K, and the probabilities to be detected and to leave uncollided.

    (rules, alphas, N, N), (rules, alphas, N) and (rules, alphas, N) for N modes by p, q, r.
    """

    kernel: Floats
    detected: Floats
    left: Floats


@dataclass(frozen=True, eq=False)
class _Modes:
    """The box's modes and what of the bench they need, for one choice of nodes."""

    bench: Bench
    rules: Rules
    ends: EndFaceTransfer
    cone: SideCone
    falling: FallingLight | None

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, bench: Bench, rules: Rules) -> _Modes:
        """Those of a bench, whose coefficients do not matter: what is made is kept."""
        ends, cone = end_transfer(bench, rules), side_cone(bench, rules)
        return cls(bench, rules, ends, cone, side_light(bench, rules))

    @property
    def shape(self) -> tuple[int, int, int]:
        """How many p, q and r there are."""
        across = self.rules[0].across
        return across, across, self.rules[0].upwards

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    def source(self) -> Floats:
        """Means of the modes over the places where light is born: (N,)."""
        depth, height = self.bench.source_depth_mm, self.bench.crystal_height_mm
        means = np.zeros(self.shape)
        means[0, 0, 0] = 1.0
        if depth < math.inf:
            kz, parity, _ = self._upwards
            rest = math.exp(-height / depth)
            means[0, 0] = (
                parity * (1.0 - rest * parity) / ((1.0 + (kz * depth) ** 2) * (1.0 - rest))
            )
        return means.ravel()

    def fewer(self) -> _Array:
        """Indices of a part of the modes that is enough for an estimate of the others' share."""
        across, _, upwards = self.shape
        kept = np.zeros(self.shape, dtype=bool)
        fewer = max(across - 1, 1)
        kept[:fewer, :fewer, : min(math.ceil(0.7 * upwards), upwards - 1)] = True
        return np.flatnonzero(kept.ravel())

    def closed(self, alpha: Floats) -> Floats:
        """K, which is diagonal, where every face reflects all: (alphas, N)."""
        kx, (kz, *_) = self._across[0], self._upwards
        k = np.sqrt(kx[:, None, None] ** 2 + kx[:, None] ** 2 + kz**2).ravel()
        k[0], alpha = 1.0, alpha[:, None]
        value = alpha / k * np.arctan(k / alpha)
        value[:, 0] = 1.0
        return value

    def systems(self, alpha: Floats) -> _Systems:
        """At values of the extinction per mm, (alphas,)."""
        shape = 2, len(alpha), *self.shape
        kernel = np.zeros((*shape, *self.shape))
        detected, left = np.zeros((2, *shape))
        self._add_ends(alpha, kernel, detected, left)
        self._add_sides(alpha, kernel, left)
        if self.falling is not None:
            self._add_falling(self.falling, alpha, detected)
        # what one direction across does, the other does
        kernel = kernel + kernel.transpose(0, 1, 3, 2, 4, 6, 5, 7)
        detected, left = (x + x.swapaxes(2, 3) for x in (detected, left))
        size = self.size
        whole = kernel.reshape(*shape[:2], size, size)
        return _Systems(whole, detected.reshape(*shape[:2], size), left.reshape(*shape[:2], size))

    @property
    def _across(self) -> tuple[_Array, _Array]:
        """Wave numbers per mm, and how many terms a cosine has."""
        p = np.arange(self.shape[0])
        return 2.0 * math.pi / self.bench.crystal_width_mm * p, np.where(p > 0, 2.0, 1.0)

    @property
    def _upwards(self) -> tuple[_Array, _Array, _Array]:
        """Wave numbers per mm upwards, the cosines' signs at the top, their terms."""
        r = np.arange(self.shape[2])
        kz = math.pi / self.bench.crystal_height_mm * r
        return kz, np.where(r % 2, -1.0, 1.0), np.where(r > 0, 2.0, 1.0)

    def _add_ends(self, alpha: Floats, kernel: _Array, detected: _Array, left: _Array) -> None:
        """What bottom and top do, in directions closer to x than to y.

        Arrays are by alphas, waves, nodes, and modes r or their signs at the top.
        """
        ends, height = self.ends, self.bench.crystal_height_mm
        (across, _, upwards), (kz, parity, many) = self.shape, self._upwards
        kernel = kernel.reshape(2, len(alpha), across**2, upwards, across**2, upwards)
        top, odd, sign = ends.reflectance_top[:, None], np.arange(upwards) % 2, _BOTH_SIGNS
        gamma, e = _attenuation(alpha, self._phase_by_ends, ends.cos, height)
        resonance, e = _resonance(gamma, kz), e[..., None]
        crossed = 1.0 - e * sign
        part = resonance * crossed[..., odd]
        repeated = 1.0 / (1.0 - e * e * (top * ends.unturned[..., None]))
        start = (crossed + e * top * (sign - e)) * repeated
        weight = ends.weight / (2.0 * height)
        resonance *= alpha[:, None, None, None] * (weight / ends.cos)[:, None]

        # every wave by itself: what bottom and top send back, instead of all that arrives
        bottom = ends.unturned[..., None] * start - 1.0
        above = top * e * bottom - sign * (1.0 - top)
        back = np.stack((bottom[..., odd], above[..., odd]), axis=-2) * resonance[..., None, :]
        out = np.stack((part, part * parity), axis=-2)
        itself = np.einsum("xapmpn->xapmn", kernel)
        for half, product in zip(itself, _over_nodes(out, back, ends.rules), strict=True):
            half[:, ends.waves.places(across)] += ends.waves.means(product) * many[:, None]

        # light that the place at the bottom turns into other waves, or lets out
        coupled, here = ends.coupled, ends.among_waves
        e, repeated, m = e[:, here], repeated[:, here], len(ends.coupled.signed)
        rises = part[:, here] * (e * top * parity + 1.0) * repeated
        starts = np.swapaxes(resonance[:, here] * start[:, here][..., odd], 1, 2)[:, None]
        turned = ends.coupling[..., :m, None] * starts
        turned[..., 1:, :] += ends.coupling[..., m:, None] * starts[..., 1:, :].conj()
        turned = coupled.sums(turned, axis=3) / coupled.of_each_fold[:, None]
        e, again = e[..., 0], (e * e * top * repeated)[..., 0]
        straight, passed = (coupled.stands_for == 1.0)[:, None], 1.0 - ends.reflectance_top
        through = ends.coupling[:, :, 0] + ends.unturned[here] * straight
        leaving = straight - through + e[:, :1] * (through * passed)
        flows = np.empty((*rises.shape[:3], 2), dtype=complex)
        for column, source in enumerate((ends.detection, leaving)):
            reached = again * source
            reached = np.concatenate((reached, reached[:, 1:].conj()), axis=1)
            more = np.einsum("knl,aln->akn", ends.coupling, reached)
            flows[..., column] = weight * (source + more)
        columns = np.concatenate((turned.reshape(*turned.shape[:3], -1), flows), axis=-1)
        upward = part[:, :1] * (weight * passed)[:, None] * parity
        upward = [upward[:, 0, rule].real.sum(axis=1) for rule in ends.rules]
        products = _over_nodes(rises, columns, ends.rules)
        places = coupled.places(across)
        detected, left = (x.reshape(2, len(alpha), across**2, upwards) for x in (detected, left))
        for rule, product in enumerate(products):
            product *= coupled.stands_for[:, None, None]
            product = coupled.sums(product, axis=1) * many[:, None]
            block = product[..., :-2].reshape(len(alpha), len(places), upwards, -1, upwards)
            kernel[rule][:, places[:, None], :, places] += block.transpose(1, 3, 0, 2, 4)
            detected[rule][:, places] += product[..., -2]
            left[rule][:, places] += product[..., -1]
            left[rule][:, 0] += upward[rule] * many

    def _add_sides(self, alpha: Floats, kernel: _Array, left: _Array) -> None:
        """What the two sides across x do."""
        cone, width = self.cone, self.bench.crystal_width_mm
        kx, many = self._across
        gamma, e = _attenuation(alpha, self._phase_by_sides, cone.cos, width)
        mirror, wave = cone.reflectance, _resonance(gamma, kx)
        factor = (1.0 - e) / (1.0 - e * mirror) * (1.0 - mirror)
        changed = factor * (alpha[:, None, None] * (cone.weight / cone.cos / -width))
        both = np.einsum("xaijmkjm->xajmik", kernel)
        flow = wave[:, 0] * (factor[:, 0] * (cone.weight / width))[..., None]
        for rule, product in enumerate(_over_nodes(wave, wave * changed[..., None], cone.rules)):
            both[rule] += self._by_signs(product) * many[:, None]
            left[rule, :, :, 0, 0] += flow[:, cone.rules[rule]].real.sum(axis=1) * many

    def _add_falling(self, falling: FallingLight, alpha: Floats, detected: _Array) -> None:
        """Light that leaves through the sides across x, falls to the window and is detected."""
        (kx, many), (*_, many_z) = self._across, self._upwards
        width = self.bench.crystal_width_mm
        gamma, e = _attenuation(alpha, self._phase_of_falling, falling.cos, width)
        flow = (1.0 - e) / (1.0 - e * falling.reflectance) * self._falling_light
        flow *= gamma
        gamma *= gamma
        for p, k in enumerate(kx):
            light = (flow / (gamma + k * k)).real
            for rule, nodes in enumerate(falling.rules):
                by_wave = self._by_signs(light[..., nodes].sum(axis=-1))
                detected[rule][:, p] += by_wave * (many[p] * many[:, None] * many_z)

    # Waves (q, r) along a side, and those (q, -r) that are not their opposites.

    def _by_signs(self, waves: _Array) -> _Array:
        """The mean of both signs of r: from (alphas, waves, ...) to (alphas, q, r, ...)."""
        _, across, upwards = self.shape
        size, rest = across * upwards, waves.shape[2:]
        mean = waves[:, :size].reshape(-1, across, upwards, *rest)
        opposite = waves[:, size:].reshape(len(waves), across - 1, upwards - 1, *rest)
        mean[:, 1:, 1:] = 0.5 * (mean[:, 1:, 1:] + opposite)
        return mean

    # Phases do not depend on the coefficients.

    @cached_property
    def _phase_by_ends(self) -> _Phase:
        ends, kx = self.ends, 2.0 * math.pi / self.bench.crystal_width_mm
        phase = (kx * ends.waves.signed) @ np.stack((ends.across_x, ends.across_y))
        return _Phase.of(phase, ends.cos, self.bench.crystal_height_mm)

    @cached_property
    def _phase_by_sides(self) -> _Phase:
        return self._phase_across(self.cone)

    @cached_property
    def _phase_of_falling(self) -> _Phase:
        assert self.falling is not None
        return self._phase_across(self.falling)

    def _phase_across(self, sides: SideCone) -> _Phase:
        by_q = self._across[0][:, None] * sides.across_y
        by_r = self._upwards[0][:, None] * sides.across_z
        both = by_q[:, None] + by_r, by_q[1:, None] - by_r[1:]
        phase = np.concatenate([x.reshape(-1, x.shape[-1]) for x in both])
        return _Phase.of(phase, sides.cos, self.bench.crystal_width_mm)

    @cached_property
    def _falling_light(self) -> _Array:
        """Fourier components over a side of what leaves it: (waves, n)."""
        falling = self.falling
        assert falling is not None
        width, height = self.bench.crystal_width_mm, self.bench.crystal_height_mm
        kx, kz = self._across[0], self._upwards[0][1:, None]
        components = []
        for starts in falling.starts:
            low, high = starts.lowest_mm[:, None], starts.highest_mm[:, None]
            waves = (np.exp(1j * kz * high) - np.exp(1j * kz * low)) / (1j * kz)
            heights = np.concatenate((high - low, waves), axis=1)
            foot = np.exp(-1j * kx[:, None] * starts.foot_mm[:, None])
            both = foot[:, :, None] * heights[:, None], foot[:, 1:, None] * waves.conj()[:, None]
            rows, _, columns = foot.shape
            light = np.concatenate([x.reshape(rows, -1, columns) for x in both], axis=1)
            components.append(np.swapaxes(light @ starts.share, 0, 1).reshape(light.shape[1], -1))
        return np.concatenate(components, axis=1) * (falling.weight / (2.0 * height * width))


_BOTH_SIGNS = np.array([1.0, -1.0])


class _Phase(NamedTuple):
    """Phases of waves along a flight, by mm and by the box's length, both along an axis."""

    per_mm: _Array
    turn: _Array

    @classmethod
    def of(cls, across: _Array, cos: Floats, length_mm: float) -> _Phase:
        per_mm = across / cos
        return cls(per_mm, np.exp(1j * length_mm * per_mm))


def _attenuation(
    alpha: Floats, phase: _Phase, cos: Floats, length_mm: float
) -> tuple[_Array, _Array]:
    """Complex attenuation per mm along an axis, and over a length: (alphas, waves, n) each."""
    per_mm = (alpha[:, None] / cos)[:, None]
    return per_mm - 1j * phase.per_mm, np.exp(-length_mm * per_mm) * phase.turn


def _resonance(gamma: _Array, k: _Array) -> _Array:
    """gamma / (gamma^2 + k^2), with k along a new last axis."""
    gamma = gamma[..., None]
    return gamma / (gamma * gamma + k * k)


def _over_nodes(left: _Array, right: _Array, rules: tuple[slice, slice]) -> list[Floats]:
    """Products of matrices, summed over each rule's nodes, which are the third axis."""
    products = []
    for rule in rules:
        rows, columns = (
            x[:, :, rule].reshape(*x.shape[:2], -1, x.shape[-1]) for x in (left, right)
        )
        products.append((rows.swapaxes(-1, -2) @ columns).real)
    return products


@dataclass(frozen=True, eq=False)
class BoxEfficiency:
    """Light collection of one bench at pairs of coefficients; arrays of the pairs' shape."""

    #: 1/cm.
    alpha_scat_per_cm: Floats
    alpha_abs_per_cm: Floats
    #: Probability that emitted light is detected, over that of light which arrives head-on.
    eta: Floats
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
    *,
    precision: float | None = None,
) -> BoxEfficiency:
    """Light collection of a polished box, without statistical noise.

    Method and limits: docs/theory.md, "Without photons". Coefficients, arrays that broadcast, are
    the bench's own if not given. `precision` is a relative error of eta that is enough: where fewer
    nodes are estimated to reach it, they do the work; None: as good as it gets.

    Raises InputError if the bench has what the method does not know, or a coefficient is negative.
    """
    refuse_other_boxes(bench)
    scat = bench.alpha_scat_per_cm if alpha_scat_per_cm is None else alpha_scat_per_cm
    absorb = bench.alpha_abs_per_cm if alpha_abs_per_cm is None else alpha_abs_per_cm
    scat, absorb = np.broadcast_arrays(np.asarray(scat, float), np.asarray(absorb, float))
    for name, values in (("alpha_scat_per_cm", scat), ("alpha_abs_per_cm", absorb)):
        if not (np.isfinite(values).all() and (values >= 0.0).all()):
            raise InputError(f"{name} has a value that is negative or no number", "give 0 or more")
    pairs = np.stack((scat.ravel(), absorb.ravel()))
    shape = replace(bench, alpha_scat_per_cm=0.0, alpha_abs_per_cm=0.0)
    columns = np.empty((len(_COLUMNS), scat.size))
    wanting = np.arange(scat.size)
    thick = bench.gap_thickness_mm > SETTINGS.thick_gap * bench.crystal_width_mm
    few_first = precision is not None and precision >= SETTINGS.rough and not thick
    for rough in (True, False) if few_first else (False,):
        choices = [_nodes(bench, *pair, rough=rough) for pair in pairs[:, wanting].T]
        for rules in set(choices):
            which = wanting[[choice == rules for choice in choices]]
            columns[:, which] = _points(
                _Modes.of(shape, rules), pairs[0, which], pairs[1, which], rough
            )
        if rough:
            wanting = wanting[columns[1, wanting] > precision * columns[0, wanting]]
        if not wanting.size:
            break
    eta, error, absorbed, trapped, left = columns.reshape(-1, *scat.shape)
    # eta is relative to light that arrives head-on, of which a falloff below 0 detects a part
    detected = eta * (1.0 / max(1.0, 1.0 - bench.angular_falloff))
    fates = {
        "detected": detected,
        "absorbed_crystal": absorbed,
        "trapped": trapped,
        "elsewhere": left - detected,
    }
    return BoxEfficiency(scat, absorb, eta, error, fates)


_COLUMNS = ("eta", "error", "absorbed", "trapped", "left")
#: Extinction, per mm, that stands for none: the first flights of trapped light end somewhere.
_NO_EXTINCTION = 1e-9


@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """What is enough for the solver. Errors are relative, lengths in widths of the crystal."""

    #: The least error that is told; fewer nodes may agree by chance, as they did to this on some of
    #: 200 random benches.
    least_error: float = 4e-5
    #: The same where crystal or plate cut the mask's hole.
    least_error_cut_hole: float = 2e-4
    #: The same of holes under the crystal alone, whose edge couples more waves: seven benches with
    #: 100 million photons each differ by 1 to 7e-4, which is 0.1 to 2 standard errors.
    least_error_small_hole: float = 5e-4
    #: What light that leaves a gap of a crystal's width at its sides, and what is worked out for it
    #: in first order only, changes of eta: from 100 million photons at gaps of 0.5 and 2 mm.
    second_order: float = 0.01
    #: The same, times the gap's thickness over the crystal's height, of the light that a window of
    #: lower index sends back into the gap, and a flat crystal soon again: from 30 million photons
    #: each at 40 benches, of which it was up to seven times the error that was told.
    sent_back: float = 0.3
    #: Error from which on few nodes are tried first, and how much larger their least error is.
    rough: float = 4e-4
    more_error_when_rough: float = 2e-4
    #: Thickness of a gap whose sides let out too much for few nodes.
    thick_gap: float = 0.06
    #: Thickness of a gap whose sides let out too little to couple waves, where there is no
    #: scattering that has many.
    thin_gap: float = 0.02
    #: Radius of a mask that covers no more than the tips of the crystal's corners.
    tips: float = 0.68
    #: Numbers of a matrix of all modes, times points, that are worked on at once.
    at_once: int = 1_000_000
    #: How well matrices are interpolated, and where few nodes are enough.
    interpolated: float = 1e-7
    interpolated_when_rough: float = 1e-5


SETTINGS = SolverSettings()


def _nodes(bench: Bench, scat_per_cm: float, abs_per_cm: float, *, rough: bool = False) -> Rules:
    """How many modes and nodes a pair of coefficients takes, and the coarser rule beside it."""
    per_mm = (scat_per_cm + abs_per_cm) / MM_PER_CM
    collides = scat_per_cm / max(scat_per_cm + abs_per_cm, 1e-300)
    thick, wide = (collides * per_mm * x for x in (bench.crystal_height_mm, bench.crystal_width_mm))
    upwards = 3 + 2 * min(round(0.6 * thick) if rough else 1 + math.ceil(0.6 * thick), 13)
    across = min(2 + math.ceil(0.4 * max(wide - 1.5, 0.0)), 7)
    if bench.source_depth_mm < math.inf:
        upwards = max(upwards, 16)
    foot, coupled = (12 if _is_cut(bench) else 9), 1
    cosine = 14 if bench.gap_index <= bench.n_window else 18
    if covers_corners(bench):
        across = max(across, 3)
        # under the tips of the corners alone the mask couples no further waves
        tips = bench.aperture_radius_mm >= SETTINGS.tips * bench.crystal_width_mm
        foot, coupled = (10, 1) if tips else (foot, 2)
    elif bench.gap_thickness_mm * (1.0 + wide) < SETTINGS.thin_gap * bench.crystal_width_mm:
        coupled = 0
    if rough:
        if coupled == 0 and wide < 1.0:
            across = 1
        fine = Nodes(across, upwards, 6, 2, 3, 6, coupled)
        return fine, fine._replace(cosine=4, around_ends=1, around_sides=2, foot=4)
    fine = Nodes(across, upwards, cosine, 5, 5, foot, coupled)
    coarser = fine._replace(cosine=cosine - 3, around_ends=4, around_sides=4, foot=foot - 3)
    return fine, coarser._replace(coupled=min(coupled, 1))


def _is_cut(bench: Bench) -> bool:
    """Whether crystal or plate cut the mask's hole: what falls into it has kinks then."""
    return covers_corners(bench) or bench.aperture_radius_mm > bench.window_width_mm / 2.0


def _extinctions(alpha: Floats, within: float) -> list[tuple[_Array, Floats]]:
    """Where the equations are worked out: indices of some of the alphas, and log(alpha) of nodes.

    In log(alpha) they are analytic at a distance of up to pi/2 from the real axis, so a
    polynomial through Chebyshev's nodes converges as fast as the ellipse is wide in between.
    """
    log_alpha = np.log(alpha)

    def nodes_over(low: float, high: float) -> Floats:
        half = 0.5 * (high - low)
        if not half:
            return np.array([low])
        width = 0.5 * math.pi / half
        count = max(math.ceil(-math.log(within) / math.asinh(width)), 2)
        return 0.5 * (low + high) + half * chebyshev_nodes(count)

    groups, clear = [], alpha <= _NO_EXTINCTION
    for some in (np.flatnonzero(clear), np.flatnonzero(~clear)):
        if not some.size:
            continue
        different = np.unique(log_alpha[some])
        nodes = nodes_over(different[0], different[-1])
        if len(nodes) <= len(different):
            groups.append((some, nodes))
        else:
            alike = ((x, some[log_alpha[some] == x]) for x in different)
            groups += [(same, nodes_over(x, x)) for x, same in alike]
    return groups


def _weights(nodes: Floats, at: Floats) -> Floats:
    """Of the values at Chebyshev's nodes in the polynomial through them."""
    if len(nodes) == 1:
        return np.ones((len(at), 1))
    middle, half = 0.5 * (nodes[0] + nodes[-1]), 0.5 * (nodes[0] - nodes[-1])
    half /= chebyshev_nodes(len(nodes))[0]
    return through_chebyshev_nodes(len(nodes), (at - middle) / half)


def _points(modes: _Modes, scat_per_cm: Floats, abs_per_cm: Floats, rough: bool) -> Floats:
    """`_COLUMNS` of pairs."""
    bench = modes.bench
    alpha = np.maximum((scat_per_cm + abs_per_cm) / MM_PER_CM, _NO_EXTINCTION)
    albedo = scat_per_cm / MM_PER_CM / alpha
    columns = np.empty((len(_COLUMNS), len(alpha)))
    least = SETTINGS.least_error_cut_hole if _is_cut(bench) else SETTINGS.least_error
    if bench.aperture_radius_mm < 0.5 * bench.crystal_width_mm:
        least = SETTINGS.least_error_small_hole
    least += SETTINGS.more_error_when_rough if rough else 0.0
    least += SETTINGS.second_order * (bench.gap_thickness_mm / bench.crystal_width_mm) ** 2
    sent_back = max(bench.gap_index**2 - bench.n_window**2, 0.0) / bench.n_crystal**2
    least += SETTINGS.sent_back * sent_back * bench.gap_thickness_mm / bench.crystal_height_mm
    within = SETTINGS.interpolated_when_rough if rough else SETTINGS.interpolated
    for those, nodes in _extinctions(alpha, within):
        length = max(1, SETTINGS.at_once // (modes.size * len(modes.ends.cos)))
        parts = [modes.systems(np.exp(nodes[i : i + length])) for i in range(0, len(nodes), length)]
        systems = _Systems(*(np.concatenate(x, axis=1) for x in zip(*parts, strict=True)))
        length = max(1, SETTINGS.at_once // modes.size**2)
        for first in range(0, len(those), length):
            some = those[first : first + length]
            columns[:, some] = _solved(modes, systems, nodes, alpha[some], albedo[some])
    columns[1] += least * columns[0]
    return columns


def _solved(
    modes: _Modes, systems: _Systems, nodes: Floats, alpha: Floats, albedo: Floats
) -> Floats:
    """`_COLUMNS` of pairs, by interpolation between systems at nodes of log(alpha)."""
    values, size = _weights(nodes, np.log(alpha)), modes.size
    kernel = (values @ systems.kernel.reshape(2, len(nodes), -1)).reshape(2, -1, size, size)
    detected = values @ systems.detected
    diagonal = np.arange(size)
    kernel[..., diagonal, diagonal] += modes.closed(alpha)

    source = modes.source()
    equations = np.eye(size) - albedo[:, None, None] * kernel
    f, coarser = np.linalg.solve(equations, detected[..., None])
    equations, kernel, detected = equations[0], kernel[0], detected[0]
    visits = np.linalg.solve(equations.swapaxes(1, 2), source[:, None])[..., 0]
    eta = f[..., 0] @ source
    absorbed = (1.0 - albedo) * (visits * kernel[:, :, 0]).sum(axis=1)
    trapped = np.where(alpha <= _NO_EXTINCTION, absorbed, 0.0)
    absorbed = absorbed - trapped
    few = modes.fewer()
    rougher = np.linalg.solve(equations[:, few[:, None], few], detected[:, few, None])[..., 0]
    gone = (visits * (values @ systems.left[0])).sum(axis=1)
    error = (
        abs(eta - rougher @ source[few])
        + abs(eta - coarser[..., 0] @ source)
        + eta * abs(1.0 - gone - absorbed - trapped)
    )
    return np.stack((eta, error, absorbed, trapped, gone))


def refuse_other_boxes(bench: Bench) -> None:
    """Refuse what the solver does not know: InputError names the parameter and the mend."""
    unknown, mend = "which the solver without photons does not know", "or simulate photons"
    for name in ("polarization", "gap_absorption_per_cm"):
        if getattr(bench, name):
            problem = f"the solver without photons knows no {name}"
            raise InputError(problem, f"leave it out, {mend}")
    n, n_gap, n_window = bench.n_crystal, bench.gap_index, bench.n_window
    if edges_in_reach(bench):
        where = (
            f"window_width_mm = {bench.window_width_mm:g}: light leaves through the plate's edges"
        )
        raise InputError(f"{where}, {unknown}", f"take a wider or thinner plate, {mend}")
    radius, least = bench.aperture_radius_mm, bench.crystal_width_mm / math.sqrt(2.0)
    if n_gap > n_window and radius < least:
        where = "the mask lies under the crystal and n_gap is above n_window"
        problem = f"aperture_radius_mm = {radius:g}: {where}, {unknown}"
        raise InputError(problem, f"take {least:.4g} or more, {mend}")
    for name, value, least, why in (
        ("n_crystal", n, math.sqrt(n_gap**2 + 1.0), "light may leave through bottom and sides"),
        ("n_window", n_window, math.sqrt(2.0), "light from air may leave the plate's edges"),
    ):
        if value < least:
            problem = f"{name} = {value:g}: below {least:.4g} {why}, {unknown}"
            raise InputError(problem, f"take a larger one, {mend}")
