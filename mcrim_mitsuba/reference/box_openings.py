"""Where light leaves a polished box on the bench: directions, reflectances, what becomes of it.

Nothing here depends on the crystal's coefficients, so a table over them needs this once. By the
mirror symmetry of box and bench a direction is given by its three positive cosines, and a place on
a face by its periodic coordinate, which grows along the flight from 0 at one wall to the crystal's
width at the other. Functions of it have Fourier components, of wave numbers 2 pi p / width.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.reference.bench import Bench

Floats = NDArray[np.float64]
_Array = NDArray[Any]


class Nodes(NamedTuple):
    """How many modes and quadrature nodes are used."""

    #: cos(2 pi p x / width) with p below this, and the same across y.
    across: int
    #: cos(pi r z / height) with r below this.
    upwards: int
    #: Gauss nodes by panel in the cosine towards an opening, and in the azimuth about it.
    cosine: int
    azimuth: int
    #: Gauss nodes by panel along a side's foot, in azimuth and in cosine, for light on its way
    #: through air to the window.
    foot: int
    #: Highest p that the place at the bottom couples; less than `across`.
    coupled: int = 1


@dataclass(frozen=True, eq=False)
class EndCones:
    """Directions in the escape cones of bottom and top, (n,) each where nothing else is said.

    Those closer to x than to y; the others are their mirror images.
    """

    weight: Floats
    cos: Floats
    across_x: Floats
    across_y: Floats
    reflectance_top: Floats
    #: (across, across, 2, n) complex: what arrives at the bottom as exp(i kappa X) leaves it as
    #: this times the same, the gap's shuttles included; for kappa of p, q and of p, -q.
    reflection: _Array
    #: (m, 2) int: the p of kappa_x and kappa_y, negative ones too, that what depends on the place
    #: at the bottom couples.
    signed: NDArray[np.int64]
    #: (n, m) complex: the same reflection for these.
    own: _Array
    #: (n, m, m) complex: what arrives as exp(i kappa' X) and leaves as exp(i kappa X).
    coupling: _Array
    #: (n, m) complex: probability that light arriving at the bottom is detected, by kappa.
    detection: _Array


@dataclass(frozen=True, eq=False)
class SideCone:
    """Directions in the escape cone of a side that looks along x, (n,) float64 each."""

    weight: Floats
    cos: Floats
    across_y: Floats
    across_z: Floats
    reflectance: Floats


@dataclass(frozen=True, eq=False)
class FallingLight(SideCone):
    """Those of light that falls from a side to the window and is detected, with its probability."""

    #: Where along the side it starts, from the wall, and from which heights.
    foot_mm: Floats
    lowest_mm: Floats
    highest_mm: Floats


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


def side_cone(bench: Bench, nodes: Nodes) -> SideCone:
    """Directions that leave through the sides towards +-x."""
    n = bench.n_crystal
    out, w_out = gauss(nodes.cosine)
    azimuth, w_azimuth = gauss(nodes.azimuth, 0.0, math.pi / 2.0)
    out, azimuth = (x.ravel() for x in np.meshgrid(out, azimuth, indexing="ij"))
    sine = np.sqrt(1.0 - out**2) / n
    cos = np.sqrt(1.0 - sine**2)
    weight = 2.0 / math.pi * np.outer(w_out, w_azimuth).ravel() * out / (n * n * cos)
    across = sine * np.cos(azimuth), sine * np.sin(azimuth)
    return SideCone(weight, cos, *across, fresnel(cos, n, 1.0))


def side_light(bench: Bench, nodes: Nodes) -> FallingLight | None:
    """Light that leaves through the sides towards +-x and falls into the mask's hole.

    Directions are those in air, by azimuth about the vertical and by the angle to it, which has
    panels: steep light reaches the hole from every height, flat light only from low ones.
    """
    half, radius = bench.crystal_width_mm / 2.0, bench.aperture_radius_mm
    if radius <= half or bench.window_width_mm <= bench.crystal_width_mm:
        return None
    chord = math.sqrt(radius**2 - half**2)
    starts_inside = chord >= half
    cuts = [-half, half] if starts_inside else [-half, -chord, chord, half]
    foot, w_foot = gauss(nodes.foot, np.array(cuts[:-1]), np.array(cuts[1:]))
    azimuth, w_azimuth = gauss(nodes.foot + 2, 0.0, math.pi / 2.0)
    y, azimuth = np.meshgrid(foot.ravel(), azimuth, indexing="ij")
    near, far = landing(bench, y, np.cos(azimuth), np.sin(azimuth))
    gap, height = bench.gap_thickness_mm, bench.crystal_height_mm
    drops = [(far, gap), (far, gap + height)]
    if not starts_inside:
        drops += [(near, gap), (near, gap + height)]
    # angles at which the ends of the hole are just reached from the lowest and the highest start
    cuts_polar = np.sort([np.zeros_like(y), *(np.arctan2(x, drop) for x, drop in drops)], axis=0)
    angles, w_polar = gauss(nodes.foot, cuts_polar[:-1], cuts_polar[1:])
    shape = angles.shape
    weight_yf = w_foot.ravel()[:, None] * w_azimuth / bench.crystal_width_mm * 2.0 / math.pi
    polar = angles.ravel()
    cos_z, sine = np.cos(polar), np.sin(polar)
    weight = (w_polar * weight_yf[:, :, None]).ravel() * sine
    start, turned, near, far = (
        np.broadcast_to(x[:, :, None], shape).reshape(-1) for x in (y, azimuth, near, far)
    )
    slope = cos_z / np.maximum(sine, 1e-12)  # straight down: Gauss nodes may round to it
    lowest = np.clip(near * slope - gap, 0.0, height)
    highest = np.clip(far * slope - gap, 0.0, height)
    n = bench.n_crystal
    out = sine * np.cos(turned)
    across_y, across_z = sine * np.sin(turned) / n, cos_z / n
    cos = np.sqrt(1.0 - across_y**2 - across_z**2)
    reflectance = fresnel(cos, n, 1.0)
    weight *= out / (n * n * cos) * (1.0 - reflectance)
    weight *= 1.0 - fresnel(cos_z, 1.0, bench.n_window)
    weight *= _detected_below(bench, _cosine(sine, bench.n_window))
    seen = (highest > lowest) & (weight > 0.0)
    found = weight, cos, across_y, across_z, reflectance, start + half, lowest, highest
    return FallingLight(*(x[seen] for x in found))


def _strip(orders: NDArray[np.int64], width: Floats, period: float) -> _Array:
    """Fourier components, (n, orders), of a strip of a width in mm that ends at the far wall."""
    share = (width / period)[:, None]
    order = np.where(orders == 0, 1, orders)
    phase = 2j * math.pi * order
    return np.where(orders == 0, share, (np.exp(phase * share) - 1.0) / phase)


def _hole(bench: Bench, order: int) -> _Array:
    """Fourier components of the mask's hole within the footprint, orders up to +-``order``.

    (2 order + 1, 2 order + 1) float64.
    """
    half, radius = bench.crystal_width_mm / 2.0, bench.aperture_radius_mm
    orders = np.arange(-order, order + 1)
    if radius >= math.sqrt(2.0) * half:
        whole = (orders == 0).astype(float)
        return np.outer(whole, whole)
    cuts = [0.0, math.pi / 2.0]
    if radius > half:
        cuts = [0.0, math.acos(half / radius), math.asin(half / radius)]
    angle, weight = gauss(24 + 4 * order, np.array(cuts[:-1]), np.array(cuts[1:]))
    angle, weight = angle.ravel(), weight.ravel()
    y, dy = radius * np.sin(angle), weight * radius * np.cos(angle)
    x = np.minimum(radius * np.cos(angle), half)
    k = math.pi * orders[:, None] / half
    along_x = np.where(k == 0.0, x, np.sin(k * x) / np.where(k == 0.0, 1.0, k))
    area = (2.0 * half) ** 2
    # coordinates count from the wall, the hole is in the middle
    sign = (-1.0) ** np.abs(orders)
    return 4.0 / area * np.outer(sign, sign) * (along_x @ (dy * np.cos(k * y)).T)


def end_cones(bench: Bench, nodes: Nodes) -> EndCones:
    """Directions that leave through bottom or top; what the gap, the window and the mask do.

    What turns waves into others (light that leaves the gap at its sides, the mask's hole) is exact
    in first order.
    """
    order = nodes.coupled
    n, n_gap, n_window = bench.n_crystal, bench.gap_index, bench.n_window
    width, gap = bench.crystal_width_mm, bench.gap_thickness_mm
    critical = sorted({1.0, n_gap, *([n_window] if 1.0 < n_window < n_gap else [])})
    panels, w_panels = [], []
    for below, index in zip([0.0, *critical], critical, strict=False):
        cos_index, weight = gauss(nodes.cosine, 0.0, math.sqrt(1.0 - (below / index) ** 2))
        panels.append(index * np.sqrt(1.0 - cos_index**2))
        w_panels.append(index**2 * cos_index * weight)
    sine, w_sine, azimuth = _with_azimuths(
        np.concatenate(panels), np.concatenate(w_panels), n_gap, nodes.azimuth
    )
    cos = np.sqrt(1.0 - (sine / n) ** 2)
    weight = 2.0 / math.pi * w_sine / (n * n * cos)
    over_x, over_y = np.cos(azimuth), np.sin(azimuth)

    cos_gap, cos_window = _cosine(sine, n_gap), _cosine(sine, n_window)
    r_crystal, r_window = fresnel(cos, n, n_gap), fresnel(cos_gap, n_gap, n_window)
    enters, lands = 1.0 - r_crystal, (1.0 - r_window) * _detected_below(bench, cos_window)
    orders = np.arange(-order, order + 1)
    signed = np.stack(np.meshgrid(orders, orders, indexing="ij"), axis=-1).reshape(-1, 2)
    step = signed[:, None, :] - signed[None, :, :]  # kappa - kappa'
    wide = np.arange(-2 * order, 2 * order + 1)
    hole = _hole(bench, 2 * order)
    hole_1 = hole[signed[:, 0] + 2 * order, signed[:, 1] + 2 * order]
    hole_2 = hole[step[..., 0] + 2 * order, step[..., 1] + 2 * order]

    # one crossing of the gap: how far, and which light its sides let out
    tan_gap = sine / n_gap / cos_gap
    shift_x, shift_y = gap * tan_gap * over_x, gap * tan_gap * over_y
    kappa = 2.0 * math.pi / width * signed
    crossing = np.exp(1j * (shift_x[:, None] * kappa[:, 0] + shift_y[:, None] * kappa[:, 1]))
    chord = math.sqrt(max(bench.aperture_radius_mm**2 - width**2 / 4.0, 0.0))
    chord = min(chord, width / 2.0)
    kc = np.where(wide == 0, 1.0, wide) * 2.0 * math.pi / width
    uncovered = np.where(wide == 0, 2.0 * chord / width, 2.0 * np.sin(kc * chord) / (kc * width))
    uncovered = uncovered * (-1.0) ** np.abs(wide)
    out_x = 1.0 - fresnel(sine / n_gap * over_x, n_gap, 1.0)
    out_y = 1.0 - fresnel(sine / n_gap * over_y, n_gap, 1.0)
    whole = chord == width / 2.0

    def let_out(crossings: int) -> _Array:
        """Components of the share that leaves: (n, 4 order + 1, 4 order + 1)."""
        by_x = out_x[:, None] * _strip(wide, np.minimum(crossings * shift_x, width), width)
        by_y = out_y[:, None] * _strip(wide, np.minimum(crossings * shift_y, width), width)
        share = by_x[:, :, None] * uncovered[None, None, :] + uncovered[:, None] * by_y[:, None, :]
        if whole:
            share = share - by_x[:, :, None] * by_y[:, None, :]
        return share

    once, twice = let_out(1), let_out(2)
    once_1 = once[:, signed[:, 0] + 2 * order, signed[:, 1] + 2 * order]
    twice_2 = twice[:, step[..., 0] + 2 * order, step[..., 1] + 2 * order]
    # down, off the window and up again
    shuttle = r_window[:, None, None] * (
        crossing[:, :, None] * hole_2 * crossing[:, None, :] - twice_2 * (crossing**2)[:, None, :]
    )
    diagonal = np.einsum("nkk->nk", shuttle).copy()
    series = 1.0 / (1.0 - r_crystal[:, None] * diagonal)
    shuttle -= diagonal[:, :, None] * np.eye(len(signed))
    coupling = shuttle * (enters**2)[:, None, None] * series[:, :, None] * series[:, None, :]

    landed = lands[:, None] * (crossing * hole_1 - once_1)
    landed = landed - lands[:, None] * _over_edges(bench, sine, over_x, over_y, signed)
    leaked = _leaked(bench, nodes, sine, over_x, over_y, signed)
    arrived = (landed + leaked) * series
    arrived = arrived + r_crystal[:, None] * series * np.einsum("nkl,nl->nk", shuttle, arrived)

    # light that the place does not turn into other waves, through all its crossings of the gap
    still = len(signed) // 2
    turns = r_crystal * r_window
    if whole:
        kept = [
            _kept(k * shift_x, out_x, width) * _kept(k * shift_y, out_y, width)
            for k in range(2 * _SHUTTLES + 2)
        ]
        over_edges = _over_edges(bench, sine, over_x, over_y, signed)
        lands_now = lands * (1.0 - over_edges[:, still].real)
        lost = 1.0 - kept[1]
        lands_later = np.where(
            lost > 0.0, leaked[:, still].real / np.where(lost > 0.0, lost, 1.0), 0.0
        )
        terms = [lands_now * kept[2 * j + 1] + lands_later * (kept[2 * j] - kept[2 * j + 1])
                 for j in range(_SHUTTLES + 1)]  # fmt: skip
        arrived[:, still] = _sum_of_shuttles(terms, turns)
        survive = kept[2::2]
    else:
        middle = 2 * order
        mean = hole[middle, middle] - twice[:, middle, middle].real
        survive = [mean ** (j + 1) for j in range(_SHUTTLES)]
    back = r_window * enters**2

    def mirrored(phase: _Array) -> _Array:
        """Reflectance of the bottom for waves of which the gap shifts the phase, (..., n)."""
        twofold = np.exp(2j * phase)
        return r_crystal + back * twofold * _sum_of_shuttles(survive, turns * twofold)

    numbers = 2.0 * math.pi / width * np.arange(nodes.across)
    along_x = numbers[:, None, None, None] * shift_x
    along_y = (numbers[:, None] * [1.0, -1.0])[..., None] * shift_y
    return EndCones(
        weight, cos, sine / n * over_x, sine / n * over_y, fresnel(cos, n, 1.0),
        mirrored(along_x + along_y), signed, mirrored(kappa @ np.stack((shift_x, shift_y))).T,
        coupling, enters[:, None] * arrived,
    )  # fmt: skip


#: Crossings of the gap, there and back, that are counted one by one.
_SHUTTLES = 8


def _kept(shift: Floats, out: Floats, width: float) -> Floats:
    """Share of light that a shift along an axis leaves in the gap; ``out`` get through a side."""
    sides = np.floor(shift / width)
    return (1.0 - out) ** sides * (1.0 - out * (shift / width - sides))


def _sum_of_shuttles(terms: list[Floats], factor: _Array) -> _Array:
    """Sum of terms[j] factor^j, continued as a geometric series from the last two on."""
    before, last = terms[-2], terms[-1]
    ratio = factor * np.where(before > 0.0, last / np.where(before > 0.0, before, 1.0), 0.0)
    total = last / (1.0 - ratio)
    for term in reversed(terms[:-1]):
        total = term + factor * total
    return total


def _with_azimuths(
    sine: Floats, weight: Floats, n_gap: float, count: int
) -> tuple[Floats, Floats, Floats]:
    """Nodes over the azimuth, 0 to pi/4, for each n sin(theta): sine, weight, azimuth, (n,) each.

    The gap's sides reflect totally what is not steep enough to them, so there are panels where
    they begin to let light out, like a square root: nodes lie close to their ends.
    """
    least = math.sqrt(max(n_gap**2 - 1.0, 0.0))
    found = []
    for s, w in zip(sine, weight, strict=True):
        cuts = np.array([0.0, math.pi / 4.0])
        if 0.0 < least < s:
            begins = math.acos(least / s)
            cuts = np.insert(cuts, 1, min(begins, math.pi / 2.0 - begins))
        t, w_t = gauss(count)
        span = np.diff(cuts)[:, None]
        azimuth = (cuts[:-1, None] + span * np.sin(0.5 * math.pi * t) ** 2).ravel()
        w_azimuth = (span * 0.5 * math.pi * np.sin(math.pi * t) * w_t).ravel()
        found.append(np.stack([np.full_like(azimuth, s), w * w_azimuth, azimuth]))
    return tuple(np.concatenate(found, axis=1))


#: Light in the plate that is closer to grazing than this cosine is little.
_GRAZING = 0.2


def edges_in_reach(bench: Bench) -> bool:
    """Whether light from the bottom gets through the plate's edges, but for what is grazing."""
    n_window = bench.n_window
    sine = min(bench.gap_index, n_window * math.sqrt(1.0 - _GRAZING**2))
    reach = bench.window_thickness_mm * sine / math.sqrt(n_window**2 - sine**2)
    margin = (bench.window_width_mm - bench.crystal_width_mm) / 2.0
    return sine > math.sqrt(n_window**2 - 1.0) and reach > margin


def _over_edges(
    bench: Bench, sine: Floats, over_x: Floats, over_y: Floats, signed: NDArray[np.int64]
) -> _Array:  # fmt: skip
    """Components of the share of light in the plate, grazing, that its edges let out."""
    width, n_window = bench.crystal_width_mm, bench.n_window
    margin = (bench.window_width_mm - width) / 2.0
    cos_window = np.maximum(_cosine(sine, n_window), 1e-9)
    reach = bench.window_thickness_mm * sine / n_window / cos_window
    out_x = 1.0 - fresnel(sine / n_window * over_x, n_window, 1.0)
    out_y = 1.0 - fresnel(sine / n_window * over_y, n_window, 1.0)
    along_x = np.clip(reach * over_x - margin, 0.0, width)
    along_y = np.clip(reach * over_y - margin, 0.0, width)
    by_x = out_x[:, None] * _strip(signed[:, 0], along_x, width)
    by_y = out_y[:, None] * _strip(signed[:, 1], along_y, width)
    return by_x * (signed[:, 1] == 0) + by_y * (signed[:, 0] == 0) - by_x * by_y


def _leaked(
    bench: Bench, nodes: Nodes, sine: Floats, over_x: Floats, over_y: Floats,
    signed: NDArray[np.int64],
) -> _Array:  # fmt: skip
    """Components of the light that leaves the gap at its sides, going down, and is detected."""
    width, gap, n_gap = bench.crystal_width_mm, bench.gap_thickness_mm, bench.gap_index
    half = width / 2.0
    chord = math.sqrt(max(bench.aperture_radius_mm**2 - half**2, 0.0))
    found = np.zeros((len(sine), len(signed)), dtype=complex)
    if chord == 0.0 or bench.window_width_mm <= width:
        return found
    y, w_y = gauss(nodes.foot, -min(chord, half), min(chord, half))
    cos_gap = _cosine(sine, n_gap)
    # outside, where the components along the side are n_gap times those in the gap
    cos_air = np.minimum(n_gap * cos_gap, 1.0)
    sine_air = np.sqrt(np.maximum(1.0 - cos_air**2, 1e-30))
    lands = 1.0 - fresnel(cos_air, 1.0, bench.n_window)
    lands = lands * _detected_below(bench, _cosine(sine_air, bench.n_window))
    for ahead, aside, kappa in ((over_x, over_y, signed), (over_y, over_x, signed[:, ::-1])):
        out, other = (1.0 - fresnel(sine / n_gap * over, n_gap, 1.0) for over in (ahead, aside))
        turned = np.minimum(sine * aside / sine_air, 1.0)[:, None]
        _, far = landing(bench, y, np.sqrt(1.0 - turned**2), turned)
        # depths below the crystal at which it leaves; deeper than `met` it met the other side first
        tan_gap = sine / n_gap / cos_gap
        ahead, aside = (tan_gap * ahead)[:, None], (tan_gap * aside)[:, None]
        highest = np.clip(gap - far * (cos_air / sine_air)[:, None], 0.0, gap)
        lowest = np.maximum(np.minimum(gap, width / ahead), highest)
        met = np.clip((y + half) / aside, highest, lowest)
        k_ahead, k_aside = 2.0 * math.pi / width * kappa.T
        turn = (ahead * k_ahead + aside * k_aside)[:, None, :]

        def up_to(depth: Floats, turn: Floats = turn) -> _Array:
            safe = np.where(turn == 0.0, 1.0, 1j * turn)
            depth = depth[..., None]
            return np.where(turn == 0.0, depth, np.exp(1j * turn * depth) / safe)

        first = up_to(met) - up_to(highest)
        second = up_to(lowest) - up_to(met)
        shares = first + (1.0 - other)[:, None, None] * second
        shares = (shares * (np.exp(-1j * np.outer(y + half, k_aside)) * w_y[:, None])).sum(axis=1)
        found += (lands * out)[:, None] * ahead * shares / width**2
    return found
