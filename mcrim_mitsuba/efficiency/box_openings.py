"""Where light leaves a polished box on the bench: directions, reflectances, what becomes of it.

Nothing here depends on the crystal's coefficients, so a table over them needs this once. By the
mirror symmetry of box and bench a direction is given by its three positive cosines, and a place on
a face by its periodic coordinate, which grows along the flight from 0 at one wall to the crystal's
width at the other. Functions of it have Fourier components, of wave numbers 2 pi p / width.

In the gap, light that enters at the place X = (x, y) of the crystal's bottom moves by
s = `shift_mm` with each crossing: it lands on the window at X + s, is back at the crystal at
X + 2 s, and so on. All components are over the place where it entered: of a function g they are the
mean of g(X) exp(-i kappa X) over the crystal's bottom, written <g exp(-i kappa X)> below.

Two rules of quadrature go side by side, so that what the second and coarser gives tells the error
of the first at the cost of its nodes alone: nodes of both are in one array, the first rule's first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.efficiency.bench import Bench

Floats = NDArray[np.float64]
_Array = NDArray[Any]


class Nodes(NamedTuple):
    """How many modes and quadrature nodes are used."""

    #: cos(2 pi p x / width) with p below this, and the same across y.
    across: int
    #: cos(pi r z / height) with r below this.
    upwards: int
    #: Gauss nodes by panel in the cosine towards an opening, and in the azimuth about it, for the
    #: ends and for the sides.
    cosine: int
    around_ends: int
    around_sides: int
    #: Gauss nodes by panel along a side's foot, in azimuth and in cosine, for light on its way
    #: through air to the window.
    foot: int
    #: Highest p that the place at the bottom couples; less than `across`.
    coupled: int = 1


Rules = tuple[Nodes, Nodes]


@dataclass(frozen=True, eq=False)
class Waves:
    """Plane waves across the box, one of each pair of opposite ones, (m,), by ``(p, |q|)``."""

    #: (m, 2) int: p and q, wave numbers in 2 pi / width; the first is (0, 0).
    signed: NDArray[np.int64]
    #: (m,) float64: how many waves each stands for, itself and its opposite.
    stands_for: Floats
    #: (groups,) int: where waves begin that have the next p and ``|q|``; (groups, 2) int: these.
    begins: NDArray[np.int64]
    folded: NDArray[np.int64]

    #: (groups,) float64: how many waves have these, of either sign.
    of_each_fold: Floats

    @classmethod
    @lru_cache
    def up_to(cls, order: int) -> Waves:
        """All with p and q up to an order."""
        pairs = [
            (p, q)
            for p in range(order + 1)
            for size in range(order + 1)
            for q in ((size,) if 0 in (p, size) else (size, -size))
        ]
        signed = np.array(pairs)
        folded, begins = np.unique(np.abs(signed), axis=0, return_index=True)
        stands_for = np.where(signed.any(axis=1), 2.0, 1.0)
        return cls(signed, stands_for, begins, folded, np.add.reduceat(stands_for, begins))

    def places(self, across: int) -> NDArray[np.int64]:
        """Where the groups are among all p and q below a number, (groups,)."""
        return self.folded @ np.array([across, 1])

    def sums(self, waves: _Array, axis: int) -> _Array:
        """Sums over the waves of each group."""
        return np.add.reduceat(waves, self.begins, axis=axis)

    def means(self, waves: _Array) -> _Array:
        """Means over each group and the opposite waves, whose values are alike; axis 1."""
        sums = self.sums(waves * self.stands_for[:, None, None], axis=1)
        return sums / self.of_each_fold[:, None, None]


def with_opposite(x: _Array) -> _Array:
    """Of half the waves, along the last axis, and then of their opposites."""
    return np.concatenate((x, x[..., 1:].conj()), axis=-1)


def _slices(first: int) -> tuple[slice, slice]:
    return slice(0, first), slice(first, None)


@dataclass(frozen=True, eq=False)
class Openings:
    """Directions that leave through a face, nodes of both rules one after the other, (n,) each."""

    #: How many nodes are the first rule's.
    first: int
    #: Of a quadrature over the directions.
    weight: Floats
    #: Direction cosine inside the crystal, towards the face.
    cos: Floats

    @property
    def rules(self) -> tuple[slice, slice]:
        """The nodes of each rule."""
        return _slices(self.first)


@dataclass(frozen=True, eq=False)
class EndFaceTransfer(Openings):
    """Directions in the escape cones of bottom and top.

    Those closer to x than to y; the others are their mirror images.
    """

    across_x: Floats
    across_y: Floats
    reflectance_top: Floats
    #: All up to the modes' highest.
    waves: Waves
    #: (waves, n) complex: what arrives at the bottom as exp(i kappa X) leaves it as this times the
    #: same, all shuttles in the gap included.
    unturned: _Array
    #: Those that the place at the bottom couples, m, and where they are among `waves`.
    coupled: Waves
    among_waves: Any
    #: (m, n, 2 m - 1) complex: what arrives as exp(i kappa' X), opposite waves too, and leaves as
    #: exp(i kappa X).
    coupling: _Array
    #: (m, n) complex: probability that light arriving at the bottom is detected.
    detection: _Array


@dataclass(frozen=True, eq=False)
class SideCone(Openings):
    """Directions in the escape cone of a side that looks along x."""

    across_y: Floats
    across_z: Floats
    reflectance: Floats


class Starts(NamedTuple):
    """Where light starts at a side that falls into the mask's hole, for one rule."""

    #: (azimuths, starts): where along the side, from the wall, and from which heights.
    foot_mm: Floats
    lowest_mm: Floats
    highest_mm: Floats
    #: (azimuths, starts, angles): how much it counts for the directions of its azimuth.
    share: Floats


@dataclass(frozen=True, eq=False)
class FallingLight(SideCone):
    """Directions of light that falls from a side to the window and is detected."""

    #: Of each rule, whose directions are by azimuth and angle.
    starts: tuple[Starts, Starts]


def _joined(first: tuple[Floats, ...], second: tuple[Floats, ...]) -> tuple[int, list[Floats]]:
    """Nodes of two rules, one after the other, and how many are the first's."""
    return len(first[0]), [np.concatenate(pair) for pair in zip(first, second, strict=True)]


def fresnel(cos_in: Floats, n_in: float, n_out: float) -> Floats:
    """Reflectance of unpolarised light; 1 where it is total."""
    squared = 1.0 - (n_in / n_out) ** 2 * (1.0 - cos_in * cos_in)
    cos_out = np.sqrt(np.maximum(squared, 0.0))
    s = (n_in * cos_in - n_out * cos_out) / (n_in * cos_in + n_out * cos_out)
    p = (n_out * cos_in - n_in * cos_out) / (n_out * cos_in + n_in * cos_out)
    return 0.5 * (s * s + p * p)


_leggauss = lru_cache(np.polynomial.legendre.leggauss)


def gauss(count: int, low: Any = 0.0, high: Any = 1.0) -> tuple[Floats, Floats]:
    """Gauss and Legendre's nodes and weights between limits, along a new last axis."""
    x, w = _leggauss(count)
    half = 0.5 * (np.asarray(high) - np.asarray(low))[..., None]
    return np.asarray(low)[..., None] + half * (1.0 + x), half * w


def _cosine(sine_index: Floats, index: float) -> Floats:
    """Cosine to the normal in a medium, of light with n sin(theta); 0 beyond the critical angle."""
    return np.sqrt(np.maximum(1.0 - (sine_index / index) ** 2, 0.0))


def _detected_below(bench: Bench, cos_window: Floats) -> Floats:
    """Share of the light in the plate that its absorption and the detector's angles leave."""
    way_cm = bench.window_thickness_mm / MM_PER_CM / np.maximum(cos_window, 1e-9)
    seen = 1.0 - bench.angular_falloff * (1.0 - cos_window)
    return np.exp(-bench.window_absorption_per_cm * way_cm) * seen


def landing(bench: Bench, y: Floats, cos: Floats, sin: Floats) -> tuple[Floats, Floats]:
    """Between which horizontal distances light from a side is above the mask's hole, in mm.

    It starts at (width/2, y) along (cos, sin), both positive. Both are 0 where it never is.
    """
    half, radius = bench.crystal_width_mm / 2.0, bench.aperture_radius_mm
    half_window = bench.window_width_mm / 2.0
    middle = -(half * cos + y * sin)
    squared = middle**2 - (half**2 + y**2 - radius**2)
    root = np.sqrt(np.maximum(squared, 0.0))
    with np.errstate(divide="ignore"):
        edge = np.minimum((half_window - half) / cos, (half_window - y) / sin)
    far = np.where(squared > 0.0, np.clip(middle + root, 0.0, edge), 0.0)
    return np.clip(middle - root, 0.0, far), far


def side_cone(bench: Bench, rules: Rules) -> SideCone:
    """Directions that leave through the sides towards +-x."""
    n = bench.n_crystal

    def nodes_of(rule: Nodes) -> tuple[Floats, ...]:
        out, w_out = gauss(rule.cosine)
        azimuth, w_azimuth = gauss(rule.around_sides, 0.0, math.pi / 2.0)
        weight = w_out[:, None] * w_azimuth
        return np.repeat(out, len(azimuth)), np.tile(azimuth, len(out)), weight.ravel()

    first, (out, azimuth, weight) = _joined(*map(nodes_of, rules))
    sine = np.sqrt(1.0 - out**2) / n
    cos = np.sqrt(1.0 - sine**2)
    weight = 2.0 / math.pi * weight * out / (n * n * cos)
    across = sine * np.cos(azimuth), sine * np.sin(azimuth)
    return SideCone(first, weight, cos, *across, fresnel(cos, n, 1.0))


def side_light(bench: Bench, rules: Rules) -> FallingLight | None:
    """Light that leaves through the sides towards +-x and falls into the mask's hole.

    Directions are those in air, by azimuth about the vertical and by the angle to it. Where light
    of a direction starts has kinks in the angle, since steep light reaches the hole from every
    height and flat light only from low ones, and is integrated in panels; what becomes of the
    direction has none, so that few angles, and polynomials through them, are enough.
    """
    half, n = bench.crystal_width_mm / 2.0, bench.n_crystal
    if bench.aperture_radius_mm <= half or bench.window_width_mm <= bench.crystal_width_mm:
        return None
    (starts, fine), (coarser_starts, coarser) = (_falling(bench, rule) for rule in rules)
    first, (turned, weight, polar) = _joined(fine, coarser)
    cos_z, sine = np.cos(polar), np.sin(polar)
    out = sine * np.cos(turned)
    across_y, across_z = sine * np.sin(turned) / n, cos_z / n
    cos = np.sqrt(1.0 - across_y**2 - across_z**2)
    reflectance = fresnel(cos, n, 1.0)
    weight = weight * (2.0 / math.pi / bench.crystal_width_mm) * sine
    weight = weight * (out / (n * n * cos) * (1.0 - reflectance))
    weight *= 1.0 - fresnel(cos_z, 1.0, bench.n_window)
    weight *= _detected_below(bench, _cosine(sine, bench.n_window))
    return FallingLight(
        first=first,
        weight=weight,
        cos=cos,
        across_y=across_y,
        across_z=across_z,
        reflectance=reflectance,
        starts=(starts, coarser_starts),
    )


def _falling(bench: Bench, rule: Nodes) -> tuple[Starts, tuple[Floats, Floats, Floats]]:
    """Where falling light starts; and azimuth, weight and angle of its directions, (n,) each."""
    half, gap, height = bench.crystal_width_mm / 2, bench.gap_thickness_mm, bench.crystal_height_mm
    chord = math.sqrt(bench.aperture_radius_mm**2 - half**2)
    starts_inside = chord >= half
    cuts = [-half, half] if starts_inside else [-half, -chord, chord, half]
    foot, w_foot = gauss(rule.foot, np.array(cuts[:-1]), np.array(cuts[1:]))
    turned, w_turned = gauss(rule.foot + 2, 0.0, math.pi / 2.0)
    y, w_y = foot.ravel(), w_foot.ravel()[:, None, None]
    near, far = landing(bench, y, np.cos(turned)[:, None], np.sin(turned)[:, None])
    # angles at which the ends of the hole are just reached from the lowest and highest start
    ends = (far,) if starts_inside else (far, near)
    reached = np.arctan2(np.stack(ends, axis=-1)[..., None], [gap, gap + height])
    reached = np.sort(reached.reshape(*far.shape, -1), axis=-1)
    below = np.concatenate((np.zeros_like(far)[..., None], reached[..., :-1]), axis=-1)
    angle, w_angle = gauss(rule.foot, below, reached)
    slope = 1.0 / np.tan(np.maximum(angle, 1e-12))  # Gauss nodes may round to straight down
    lowest, highest = (np.clip(x[..., None, None] * slope - gap, 0.0, height) for x in (near, far))
    largest = reached.max(axis=(1, 2), keepdims=True)[..., None]
    angles = rule.foot + _ANGLES + rule.upwards // 4
    polar = largest[:, 0, 0] * (0.5 * (1.0 + chebyshev_nodes(angles)))
    shares = through_chebyshev_nodes(angles, 2.0 * angle / largest - 1.0)
    shares *= (w_angle * w_y)[..., None]
    y = np.broadcast_to((y + half)[:, None, None], angle.shape)
    rows = len(turned)
    starts = Starts(
        foot_mm=y.reshape(rows, -1),
        lowest_mm=lowest.reshape(rows, -1),
        highest_mm=highest.reshape(rows, -1),
        share=shares.reshape(rows, -1, angles),
    )
    return starts, (np.repeat(turned, angles), np.repeat(w_turned, angles), polar.ravel())


#: Angles of falling light, more than nodes of its foot's panels.
_ANGLES = 5


def chebyshev_nodes(count: int) -> Floats:
    """Chebyshev's nodes, (count,), from near 1 down to near -1."""
    return np.cos(math.pi * (np.arange(count) + 0.5) / count)


def through_chebyshev_nodes(count: int, x: Floats) -> Floats:
    """Polynomials that are 1 at one of Chebyshev's nodes and 0 at the others: (..., count)."""
    order, angles = np.arange(count)[:, None], math.pi * (np.arange(count) + 0.5) / count
    shares = np.cos(order * angles) * np.where(order > 0, 2.0, 1.0) / count
    return np.cos(np.arccos(np.clip(x, -1.0, 1.0))[..., None] * np.arange(count)) @ shares


@dataclass(frozen=True, eq=False, kw_only=True)
class _GapLight:
    """Light in the gap, by direction: (n,) each, or (2, n) along x and y."""

    #: How far one crossing goes.
    shift_mm: Floats
    #: Share that gets out through a side of the gap which it meets.
    out: Floats
    #: Of the crystal and of the window, met from the gap.
    r_crystal: Floats
    r_window: Floats
    #: Share of the light on the window that is detected.
    lands: Floats
    #: From how far off its far wall's foot light in the plate gets to the plate's edge, and the
    #: share that gets out there.
    to_edge_mm: Floats
    edge_out: Floats

    @property
    def turns(self) -> Floats:
        """Share that one shuttle between window and crystal leaves."""
        return self.r_crystal * self.r_window

    def kept(
        self, crossings: NDArray[np.int64], width_mm: float, *, in_plate: bool = False
    ) -> Floats:
        """Share of evenly spread light that is in the gap after each number of crossings.

        (crossings, n). With `in_plate` it then goes into the plate, and is no more if it gets out
        at the plate's edges.
        """
        shift = crossings[:, None, None] * self.shift_mm / width_mm
        walls = np.floor(shift)
        near = shift - walls
        share = 1.0 - self.out * near
        if in_plate:
            far = self.to_edge_mm / width_mm
            share -= self.edge_out * (far - self.out * np.maximum(far + near - 1.0, 0.0))
        return np.prod((1.0 - self.out) ** walls * share, axis=1)


def _crossings(bench: Bench, order: int, light: _GapLight) -> tuple[_Array, _Array]:
    """Light that crosses the gap into the mask's hole, and light that is back at the crystal then.

    <P exp(-i kappa X)>, of all kappa up to +-``order`` along x and y: twice (n, 2 order + 1,
    2 order + 1) complex. P(X) is 0 where light lands outside the hole, and else the share that one
    crossing, or two, keep in the gap. Light gets out of the gap's sides, and of the plate's edges,
    only from nearer to a wall than it goes: P is a product of steps along x and along y, and a hole
    under the crystal is integrated chord by chord between all that has a kink.
    """
    half = bench.crystal_width_mm / 2.0
    walls = light.shift_mm // (2.0 * half)
    down = light.shift_mm - 2.0 * half * walls - half
    # what the way up loses is the mirror image of what the way down loses
    ends = ((half - light.to_edge_mm, light.edge_out), (-down, light.out))
    along = _Chords(half, order, down, light.out, ends)
    if covers_corners(bench):
        in_hole = _in_small_hole(bench, along, kinks_at_edge=bool(light.to_edge_mm.any()))
    else:
        everywhere = np.full((len(light.lands), 1), half)
        along_x, along_y = (along.kept(axis, everywhere) for axis in (0, 1))
        in_hole = [x.swapaxes(1, 2) * y for x, y in zip(along_x, along_y, strict=True)]
    # integrated over where light lands, from the middle of the hole: means over where it entered,
    # one crossing before, from the wall
    entered = np.exp(1j * math.pi / half * (light.shift_mm - half))
    of_x, of_y = _powers(entered, order) / (2.0 * half)
    once, twice = (
        np.prod((1.0 - light.out) ** (number * walls), axis=0)[:, None, None]
        * (integrals * of_x[:, :, None] * of_y[:, None, :])
        for number, integrals in enumerate(in_hole, start=1)
    )
    return once, twice


@dataclass(frozen=True, eq=False)
class _Chords:
    """Light that is kept along chords of the hole, which are symmetric about its middle.

    Places here are those where light lands, from the middle of the hole.
    """

    #: Half the crystal's width, and the highest order of the components.
    half_mm: float
    order: int
    #: (2, n) along x and y: from where on light meets a wall on its way down, and the share of it
    #: that gets out there.
    down_mm: Floats
    out: Floats
    #: The same of the way on: through the plate to the detector, or up to the crystal again.
    ends: tuple[tuple[Floats, Floats], ...]

    def kept(self, axis: int, chord: Floats) -> list[_Array]:
        """Integrals over (n, chords) half chords of what one and what two crossings keep.

        Of P exp(-i k x), (n, chords, 2 order + 1) each. On the way down P = 1 - out left of
        `down_mm`, and 1 right of it; on the way on it is less by the share `lost` right of `far`.
        """
        between = self._between
        start = np.clip(self.down_mm[axis][:, None], -chord, chord)
        out = self.out[axis][:, None, None]
        entered = between(-chord, chord) - out * between(-chord, start)
        components = []
        for far, lost in self.ends:
            end = np.clip(far[axis][:, None], -chord, chord)
            both = out * between(np.minimum(end, start), start)
            components.append(entered - lost[axis][:, None, None] * (between(end, chord) - both))
        return components

    def _between(self, low: Floats, high: Floats) -> _Array:
        """Integrals of exp(-i k x) between two places, for all orders."""
        k = math.pi / self.half_mm * np.arange(-self.order, self.order + 1)
        first, last = (self.waves(x) for x in (low, high))
        safe = np.where(k == 0.0, 1.0, -1j * k)
        return np.where(k == 0.0, (high - low)[..., None], (last - first) / safe)

    def waves(self, x: Floats) -> _Array:
        """Waves of all orders at places, along a new last axis."""
        return _powers(np.exp(-1j * math.pi / self.half_mm * x), self.order)


def _in_small_hole(bench: Bench, along: _Chords, *, kinks_at_edge: bool) -> list[_Array]:
    """Integrals over a hole under the crystal of what one and what two crossings keep.

    Of P_x exp(-i k x) P_y exp(-i k' y) over the hole's chords along x, whose half lengths are
    sqrt(radius^2 - y^2), or half the crystal's width: over x in closed form, over y by Gauss's
    nodes. The function of y has kinks where a step of P_y lies, where a chord's end passes a step
    of P_x, and where chords begin to end at the crystal's outline; nodes lie between two of these.
    """
    half, radius, down = along.half_mm, bench.aperture_radius_mm, along.down_mm
    highest = min(radius, half)
    outline = math.sqrt(max(radius**2 - half**2, 0.0))
    # where shares fall in a step: where light begins to meet the gap's sides, or the plate's edge
    to_edge, _ = along.ends[0]
    steps = [down, to_edge] if kinks_at_edge else [down]
    kinks = [
        *(np.stack((y, np.sqrt(np.maximum(radius**2 - x**2, 0.0)))) for x, y in steps),
        np.broadcast_to([[outline], [highest]], down.shape),
    ]
    cuts = np.concatenate([*kinks, *(-kink for kink in kinks)]).T
    # y = radius sin(angle): a chord's length has its roots at the ends taken out
    cuts = np.sort(np.arcsin(np.clip(cuts, -highest, highest) / radius), axis=1)
    nodes = gauss(_ON_CHORDS + along.order, cuts[:, :-1], cuts[:, 1:])
    angle, weight = (x.reshape(len(cuts), -1) for x in nodes)
    y, chord = radius * np.sin(angle), np.minimum(radius * np.cos(angle), half)
    weight = weight * radius * np.cos(angle)
    entered = 1.0 - along.out[1][:, None] * (y < down[1][:, None])
    kept_along_y = [
        entered * (1.0 - lost[1][:, None] * (y > far[1][:, None])) for far, lost in along.ends
    ]
    waves = along.waves(y)
    pairs = zip(along.kept(0, chord), kept_along_y, strict=True)
    return [over_x.swapaxes(1, 2) @ ((weight * kept)[..., None] * waves) for over_x, kept in pairs]


#: Gauss nodes on each part of the hole, more than orders.
_ON_CHORDS = 8


def _powers(phase: _Array, order: int) -> _Array:
    """Powers of phases from -``order`` to ``order``, along a new last axis."""
    powers = np.repeat(phase[..., None], order + 1, axis=-1)
    powers[..., 0] = 1.0
    np.cumprod(powers, axis=-1, out=powers)
    return np.concatenate((powers[..., :0:-1].conj(), powers), axis=-1)


def _returns(bench: Bench, order: int, light: _GapLight) -> Iterator[tuple[_Array, _Array, _Array]]:
    """What lands in the hole under the crystal and what comes back to it, shuttle by shuttle.

    Which of the directions, (those,); and of these, as `_crossings`, <P exp(-i kappa X)> after 1,
    3, 5, ... and after 2, 4, 6, ... crossings, P being 0 unless every landing so far was in the
    hole. Light in the hole is likely to be in it again: the overlap of all these holes has no
    closed form, and is a sum over a lattice of places.
    """
    width, half = bench.crystal_width_mm, bench.crystal_width_mm / 2.0
    number = np.arange(_PLACES)
    place = width * np.stack(((number + 0.5) / _PLACES, (number * _STEP / _PLACES) % 1.0))
    along_x, along_y = _powers(np.exp(-2j * math.pi / width * place), order)
    phase = (along_x[:, :, None] * along_y[:, None, :]).reshape(_PLACES, -1) / _PLACES
    shape = -1, 2 * order + 1, 2 * order + 1
    those = np.arange(len(light.lands))
    kept = np.ones((len(those), _PLACES))
    for shuttle in range(_SHUTTLES):
        enough = light.turns[those] ** shuttle > _LEAST_TURNS
        those, kept = those[enough], kept[enough]
        shift, out = light.shift_mm[:, those, None], light.out[:, those, None]
        x, y = (place[:, None] + (2 * shuttle + 1) * shift) % width - half
        kept *= x * x + y * y <= bench.aperture_radius_mm**2
        components = []
        for crossings in (2 * shuttle + 1, 2 * shuttle + 2):
            # walls are at the multiples of the width
            walls = (place[:, None] + crossings * shift) // width
            in_gap = np.prod((1.0 - out) ** walls, axis=0)
            components.append(((kept * in_gap) @ phase).reshape(shape))
        yield those, components[0], components[1]


#: Places of a Fibonacci lattice.
_PLACES = 377
#: Its step, a Fibonacci number too.
_STEP = 233
#: Of light in the gap, what part is followed until it is less.
_LEAST_TURNS = 1e-6


def end_transfer(bench: Bench, rules: Rules) -> EndFaceTransfer:
    """Directions that leave through bottom or top; what the gap, the window and the mask do.

    What turns waves into others (light that leaves the gap at its sides, the mask's hole) is exact
    in first order.
    """
    n, width, order = bench.n_crystal, bench.crystal_width_mm, rules[0].coupled
    first, (sine, weight, azimuth) = _joined(
        *(_towards_ends(bench.gap_index, bench.n_window, rule) for rule in rules)
    )
    cos = np.sqrt(1.0 - (sine / n) ** 2)
    over = np.stack((np.cos(azimuth), np.sin(azimuth)))
    light = _gap_light(bench, sine, cos, over)
    enters = 1.0 - light.r_crystal
    shuttle = _first_shuttle(bench, rules, first, sine, over, light)
    through = _through_small_hole if covers_corners(bench) else _through_wide_hole
    coupling, arrived, survive = through(bench, light, shuttle)
    for rule, beyond in shuttle.beyond:
        arrived[rule, beyond[: shuttle.m]] = 0.0
    coupling *= (enters**2)[:, None, None]

    # the same for every wave, of which the gap shifts the phase
    waves = Waves.up_to(rules[0].across - 1)
    among = np.flatnonzero((np.abs(waves.signed) <= order).all(axis=1))
    twofold = np.exp(2j * (2.0 * math.pi / width * waves.signed @ light.shift_mm))
    later = _sum_of_shuttles(survive, light.turns * twofold)
    unturned = light.r_crystal + light.r_window * enters**2 * twofold * later
    if covers_corners(bench):
        here = np.arange(len(among))
        coupling[:, here, here] -= (unturned[among] - light.r_crystal).T
        shuttle.clear_coupling(coupling)
    return EndFaceTransfer(
        first=first,
        weight=2.0 / math.pi * weight / (n * n * cos),
        cos=cos,
        across_x=sine / n * over[0],
        across_y=sine / n * over[1],
        reflectance_top=fresnel(cos, n, 1.0),
        waves=waves,
        unturned=unturned,
        coupled=Waves.up_to(order),
        among_waves=slice(None) if len(among) == len(waves.signed) else among,
        coupling=np.ascontiguousarray(coupling.transpose(1, 0, 2)),
        detection=(enters[:, None] * arrived).T,
    )


def _gap_light(bench: Bench, sine: Floats, cos: Floats, over: Floats) -> _GapLight:
    """Light in the gap, by n sin(theta), the cosine in the crystal and those of the azimuth."""
    n_gap, n_window, width = bench.gap_index, bench.n_window, bench.crystal_width_mm
    cos_gap, cos_window = _cosine(sine, n_gap), _cosine(sine, n_window)
    r_window = fresnel(cos_gap, n_gap, n_window)
    margin = (bench.window_width_mm - width) / 2.0
    in_plate = bench.window_thickness_mm * sine / n_window / np.maximum(cos_window, 1e-9)
    return _GapLight(
        shift_mm=bench.gap_thickness_mm * sine / n_gap / cos_gap * over,
        out=1.0 - fresnel(sine / n_gap * over, n_gap, 1.0),
        r_crystal=fresnel(cos, bench.n_crystal, n_gap),
        r_window=r_window,
        lands=(1.0 - r_window) * _detected_below(bench, cos_window),
        to_edge_mm=np.clip(in_plate * over - margin, 0.0, width),
        edge_out=1.0 - fresnel(sine / n_window * over, n_window, 1.0),
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _FirstShuttle:
    """What becomes of light in its first two crossings of the gap, between the coupled waves.

    It enters at X, lands at X + s and is back at X + 2 s. P_1 and P_2 are what `_crossings` keep.
    """

    #: Highest order of the coupled waves.
    order: int
    #: (n, m) complex: lands <P_1 exp(-i kappa X)> + leaked, what is detected of light on its way
    #: down; and what of it has left the gap at its sides.
    landed: _Array
    leaked: _Array
    #: (n,): <P_2>, what of evenly spread light is in the gap after landing in the hole.
    even: Floats
    #: (n, m, 2 m - 1) complex: r_window <P_2 exp(-i kappa X) exp(i kappa' (X + 2 s))>: a wave
    #: kappa' over the places where light comes back is so much of kappa where it entered.
    returned: _Array
    #: (n, 2 m - 1): kappa' s, by how much one crossing shifts the phase of every wave.
    phase: Floats
    #: Where components of a wave, and of the step between two waves, are among all of `_crossings`.
    at_wave: tuple[Any, Any]
    at_step: tuple[Any, Any]
    #: Nodes of each rule, and the waves that it does not couple: the coarser may couple fewer.
    beyond: tuple[tuple[slice, NDArray[np.bool_]], ...]

    @property
    def m(self) -> int:
        """How many waves there are, one of each pair of opposite ones."""
        return self.landed.shape[1]

    def clear_coupling(self, coupling: _Array) -> None:
        """Take away the couplings of waves that a rule does not couple."""
        for rule, waves in self.beyond:
            coupling[rule, :, waves] = 0.0
            coupling[rule, waves[: self.m]] = 0.0


def _first_shuttle(
    bench: Bench, rules: Rules, first: int, sine: Floats, over: Floats, light: _GapLight
) -> _FirstShuttle:
    """The first shuttle between the waves that `rules` couple, without error.

    Directions are as in `end_transfer`: n sin(theta), (n,), the cosine and sine of the azimuth,
    (2, n), and light in the gap; `first` of them are of the first rule.
    """
    order = rules[0].coupled
    signed = Waves.up_to(order).signed
    every = np.concatenate((signed, -signed[1:]))
    step = signed[:, None, :] - every[None, :, :]  # kappa - kappa'
    at_step = step[..., 0] + 2 * order, step[..., 1] + 2 * order
    at_wave = signed[:, 0] + 2 * order, signed[:, 1] + 2 * order
    phase = 2.0 * math.pi / bench.crystal_width_mm * (light.shift_mm.T @ every.T)
    once, twice = _crossings(bench, 2 * order, light)
    leaked = _leaked(bench, rules, first, sine, over, signed)
    waves = [np.abs(every).max(axis=1) > rule.coupled for rule in rules]
    return _FirstShuttle(
        order=order,
        landed=light.lands[:, None] * once[:, *at_wave] + leaked,
        leaked=leaked,
        # exp(-i kappa X) exp(i kappa' (X + 2 s)) = exp(-i (kappa - kappa') X) exp(2 i kappa' s)
        returned=light.r_window[:, None, None] * twice[:, *at_step] * np.exp(2j * phase[:, None]),
        phase=phase,
        even=twice[:, 2 * order, 2 * order].real,
        at_wave=at_wave,
        at_step=at_step,
        beyond=tuple(zip(_slices(first), waves, strict=True)),
    )


#: (n, m, 2 m - 1) couplings of waves, (n, m) what arrives at the detector, and (shuttles, n) what
#: is kept of each wave from shuttle to shuttle.
_Through = tuple[_Array, _Array, Floats]


def _through_small_hole(bench: Bench, light: _GapLight, shuttle: _FirstShuttle) -> _Through:
    """All shuttles above a hole under the crystal, through which light is detected.

    Shuttle j = 0, 1, 2, ... begins with the share turns^j of the light, which its landings left in
    the hole, P_2j; it is back at X + 2 (j + 1) s. So what arrives is the sum over j of
    turns^j (lands <P_2j+1 exp(-i kappa X)> + leaked <P_2j>), and the coupling that of
    r_window turns^j <P_2j+2 exp(-i kappa X) exp(i kappa' (X + 2 (j + 1) s))>. The first shuttle is
    exact; a lattice of places tells how later ones compare with it, to which all its means are
    scaled: `to_exact`.
    """
    order, turns = 2 * shuttle.order, light.turns
    survive = np.zeros((_SHUTTLES, len(turns)))
    arrived, coupling = shuttle.landed.copy(), shuttle.returned
    to_exact = np.ones(len(turns))
    for j, (those, landing, returned) in enumerate(_returns(bench, order, light)):
        even = returned[:, order, order].real
        if j == 0:
            to_exact = shuttle.even / np.maximum(even, 1e-9)
        survive[j, those] = to_exact[those] * even
        if j == 0:
            continue
        again = landing[:, *shuttle.at_wave] * (light.lands * to_exact)[those, None]
        again += shuttle.leaked[those] * survive[j - 1, those, None]
        arrived[those] += (turns[those] ** j)[:, None] * again
        later = returned[:, *shuttle.at_step] * np.exp(2j * (j + 1) * shuttle.phase[those, None])
        factor = to_exact * light.r_window * turns**j
        coupling[those] += factor[those, None, None] * later
    return coupling, arrived, survive


def _through_wide_hole(bench: Bench, light: _GapLight, shuttle: _FirstShuttle) -> _Through:
    """All shuttles where the mask leaves the crystal free: a series that couples waves once.

    One shuttle leaves a wave as it was but for its diagonal element c of `returned`: r_crystal c
    multiplies it each time, and all times give 1 / (1 - r_crystal c). Evenly spread light, of which
    the most arrives, is followed shuttle by shuttle, as what it keeps is no power of one shuttle.
    """
    width, coupling, here = bench.crystal_width_mm, shuttle.returned, np.arange(shuttle.m)
    series = 1.0 / (1.0 - light.r_crystal[:, None] * coupling[:, here, here])
    coupling[:, here, here] = 0.0
    shuttle.clear_coupling(coupling)
    arrived = shuttle.landed * series
    more = (coupling @ with_opposite(arrived)[:, :, None])[..., 0]
    coupling = coupling * series[:, :, None] * with_opposite(series)[:, None, :]
    arrived += light.r_crystal[:, None] * series * more

    # light that the place does not turn into other waves, through all its crossings
    kept = light.kept(np.arange(2 * _SHUTTLES + 2), width)
    within = light.kept(np.arange(1, 2 * _SHUTTLES + 2, 2), width, in_plate=True)
    lost, leaked = 1.0 - kept[1], shuttle.leaked[:, 0].real
    lands_later = np.where(lost > 0.0, leaked / np.where(lost > 0.0, lost, 1.0), 0.0)
    terms = light.lands * within + lands_later * (kept[0::2] - kept[1::2])
    arrived[:, 0] = _sum_of_shuttles(terms, light.turns)
    return coupling, arrived, kept[2::2]


#: Crossings of the gap, there and back, that are counted one by one.
_SHUTTLES = 8


def _sum_of_shuttles(terms: Floats, factor: _Array) -> _Array:
    """Sum of terms[j] factor^j, continued as a geometric series from the last two on."""
    before, last = terms[-2], terms[-1]
    ratio = factor * np.where(before > 0.0, last / np.where(before > 0.0, before, 1.0), 0.0)
    total = last / (1.0 - ratio)
    for term in terms[-2::-1]:
        total = term + factor * total
    return total


@lru_cache
def _towards_ends(n_gap: float, n_window: float, rule: Nodes) -> tuple[Floats, Floats, Floats]:
    """n sin(theta), its weight and the azimuth, 0 to pi/4, of light that leaves at an end: (n,).

    The gap's sides reflect totally what is not steep enough to them, so there are panels where
    they begin to let light out, like a square root: nodes lie close to there.
    """
    critical = sorted({1.0, n_gap, *([n_window] if 1.0 < n_window < n_gap else [])})
    index = np.array(critical)[:, None]
    below = np.array([0.0, *critical[:-1]])
    cos_index, weight = gauss(rule.cosine, 0.0, np.sqrt(1.0 - (below / critical) ** 2))
    sine = (index * np.sqrt(1.0 - cos_index**2)).ravel()
    weight = (index**2 * cos_index * weight).ravel()
    t, w_t = gauss(rule.around_ends)
    begins = np.arccos(np.minimum(math.sqrt(max(n_gap**2 - 1.0, 0.0)) / sine, 1.0))
    begins = np.minimum(begins, math.pi / 2.0 - begins)
    panels = []
    for end in (np.zeros_like(sine), np.full_like(sine, math.pi / 4.0)):
        (those,) = np.nonzero(begins != end)
        span = (end - begins)[those, None]
        nodes = sine[those, None], weight[those, None], begins[those, None] + span * t * t
        panels.append((nodes[0], nodes[1] * abs(span) * 2.0 * t * w_t, nodes[2]))
    sine, weight, azimuth = (
        np.concatenate([np.broadcast_to(x, (len(x), len(t))).ravel() for x in part])
        for part in zip(*panels, strict=True)
    )
    return sine, weight, azimuth


#: Light in the plate that is closer to grazing than this cosine is little.
_GRAZING = 0.2


def covers_corners(bench: Bench) -> bool:
    """Whether the mask reaches under the crystal."""
    return bench.aperture_radius_mm < bench.crystal_width_mm / math.sqrt(2.0)


def edges_in_reach(bench: Bench) -> bool:
    """Whether light from the bottom gets through the plate's edges, but for what is grazing."""
    n_window = bench.n_window
    sine = min(bench.gap_index, n_window * math.sqrt(1.0 - _GRAZING**2))
    reach = bench.window_thickness_mm * sine / math.sqrt(n_window**2 - sine**2)
    margin = (bench.window_width_mm - bench.crystal_width_mm) / 2.0
    return sine > math.sqrt(n_window**2 - 1.0) and reach > margin


def _leaked(
    bench: Bench, rules: Rules, first: int, sine: Floats, over: Floats, signed: NDArray[np.int64]
) -> _Array:
    """Light that leaves the gap at its sides on its way down, and is detected: (n, waves) complex.

    Its share, as components over the place where it entered the gap,

        <g exp(-i kappa X)> = out lands / w^2  int dy int a dt  P exp(-i kappa (w - a t, y - b t))

    summed over the side that it has before it along x, and that along y. It gets out at the place y
    along the side and the depth t below the crystal, so that it had entered a t before the side and
    b t to one side of y (a, b: tan(theta) times the cosines of the azimuth). ``out`` is what the
    side lets through, ``lands`` what is detected of the light that reaches the window; P is what
    the other side has left, if the light met that before. t goes from where it would land beyond
    the far end of the mask's hole to where it would land before the near end.
    """
    width, gap, n_gap = bench.crystal_width_mm, bench.gap_thickness_mm, bench.gap_index
    half = width / 2.0
    chord = math.sqrt(max(bench.aperture_radius_mm**2 - half**2, 0.0))
    leaked = np.zeros((len(sine), len(signed)), dtype=complex)
    if chord == 0.0 or bench.window_width_mm <= width:
        return leaked
    cuts = np.array([-half, half] if chord >= half else [-half, -chord, chord, half])
    # the coarser rule has fewer nodes: the others of its directions weigh nothing
    foot, w_foot = np.zeros((2, len(sine), rules[0].foot * (len(cuts) - 1)))
    for rule, those in zip(rules, _slices(first), strict=True):
        nodes = [x.ravel() for x in gauss(rule.foot, cuts[:-1], cuts[1:])]
        foot[those, : len(nodes[0])], w_foot[those, : len(nodes[0])] = nodes
    y = foot + half
    cos_gap = _cosine(sine, n_gap)
    tan_gap = sine / n_gap / cos_gap
    # outside, where the components along the side are n_gap times those in the gap
    cos_air = np.minimum(n_gap * cos_gap, 1.0)
    sine_air = np.sqrt(np.maximum(1.0 - cos_air**2, 1e-30))
    cot_air = (cos_air / sine_air)[:, None]
    lands = 1.0 - fresnel(cos_air, 1.0, bench.n_window)
    lands = lands * _detected_below(bench, _cosine(sine_air, bench.n_window))
    outs = 1.0 - fresnel(sine / n_gap * over, n_gap, 1.0)
    for ahead, aside in ((0, 1), (1, 0)):
        turned = np.minimum(sine * over[aside] / sine_air, 1.0)[:, None]
        near, far = landing(bench, foot, np.sqrt(1.0 - turned**2), turned)
        a, b = ((tan_gap * over[axis])[:, None] for axis in (ahead, aside))
        least = np.clip(gap - far * cot_air, 0.0, gap)
        # not deeper than light that entered at the opposite wall
        most = np.maximum(np.minimum(gap - near * cot_air, width / a), least)
        other_met = np.clip(y / b, least, most)
        k_ahead, k_aside = 2.0 * math.pi / width * signed.T[[ahead, aside]]
        # exp(-i kappa (w - a t, y - b t)) = exp(-i k_aside y) exp(i turn t)
        turn = (a * k_ahead + b * k_aside)[:, None, :]
        over_t = _integral_of_wave(turn, least, other_met)
        left = (1.0 - outs[aside])[:, None, None]
        over_t = over_t + left * _integral_of_wave(turn, other_met, most)
        start = np.exp(-1j * y[..., None] * k_aside)
        over_foot = (over_t * (start * w_foot[..., None])).sum(axis=1)
        leaked += (lands * outs[ahead])[:, None] * a * over_foot / width**2
    return leaked


def _integral_of_wave(turn: Floats, low: Floats, high: Floats) -> _Array:
    """Integral of exp(i turn t) over t between two depths; ``turn`` has one more axis, of waves."""
    low, high = low[..., None], high[..., None]
    if turn.shape[-1] == 1:  # the even wave alone
        return high - low
    safe = np.where(turn == 0.0, 1.0, 1j * turn)
    waves = (np.exp(1j * turn * high) - np.exp(1j * turn * low)) / safe
    return np.where(turn == 0.0, high - low, waves)
