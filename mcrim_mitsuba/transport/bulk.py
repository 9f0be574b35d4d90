"""Where photons are born, how they scatter, and the random numbers of both.

Births fill position and direction evenly, by a shifted lattice per batch and proposal. Photon i of
a batch is born at the fractional part of shift + z phi(i): phi mirrors the bits of
i at the point, so that the first n photons are nearly even for every n, and z is a generating
vector of a good lattice (F. Y. Kuo's lattice-32001-1024-1048576, found as described by R. Cools,
F. Y. Kuo and D. Nuyens, SIAM J. Sci. Comput. 28 (2006) 2162). The shifts are random and
independent (R. Cranley and T. N. L. Patterson, SIAM J. Numer. Anal. 13 (1976) 904), so that
every point is uniform, nothing is biased, and the spread between batches is the error.

Formulas of scattering: L. G. Henyey and J. L. Greenstein, Astrophys. J. 93 (1941) 70, and J. R.
Frisvad, J. Opt. Soc. Am. A 28 (2011) 2436 for Rayleigh's; both invert the distribution of the
cosine.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.optics.emission_band import WIDTHS
from mcrim_mitsuba.transport.conversion import (
    opaque,
    opaque_vector,
    read_scene_model,
    surface_numbers,
)
from mcrim_mitsuba.transport.convex import convex_solids
from mcrim_mitsuba.transport.launch_plan import BATCHES, LanePlan
from mcrim_mitsuba.transport.scene_model import DETECTOR, OUTSIDE, SceneModel, cross

#: Rounds of the cipher that spreads the lanes' seeds over all states.
HASH_ROUNDS = 8
#: Of the lattice, per coordinate: three of the position, two of the direction, the angle of
#: polarisation, the wavelength; others are not used yet.
GENERATORS = (1, 182_667, 469_891, 498_753, 110_745, 446_247, 250_185, 118_627, 245_333, 283_199)


def seed_words(count: int, *seed: int) -> list[int]:
    """`count` well-mixed 32-bit words from integers of 0 to 2^64 - 1, of which all count."""
    # Two words each: SeedSequence pads shorter numbers with zeros, so that others' would coincide.
    halves = [half for value in seed for half in (value & 0xFFFFFFFF, value >> 32)]
    return np.random.SeedSequence(halves).generate_state(count, np.uint32).tolist()


def lane_generators(lanes: int, *seed: int):
    """Independent generators (``mitsuba.PCG32``), one per lane.

    PCG32's own way of making many generators numbers their streams 0, 1, 2, ..., and
    such neighbours draw visibly correlated numbers (a chi-square test across lanes fails
    at once). So start and stream of every lane are hashed from its number and the seed, as in
    Mitsuba's independent sampler (F. Zafar et al., GPU random numbers via the tiny
    encryption algorithm, HPG 2010). `seed` is as of `seed_words`.
    """
    start, start_too, stream, stream_too = (
        opaque([word], mi.UInt32) for word in seed_words(4, *seed)
    )
    lane = dr.arange(mi.UInt32, lanes)
    return mi.PCG32(
        initstate=mi.sample_tea_64(lane ^ start, start_too, HASH_ROUNDS),
        initseq=mi.sample_tea_64(lane ^ stream, stream_too, HASH_ROUNDS),
    )


class PhotonSeeds:
    """States from which a lane's generator starts, one for each of the lane's photons.

    With these a photon's numbers do not depend on how many the photons before it took: in two
    scenes that differ a little, most photons do the same, and differences of eta are known far
    better than the etas. `seed` is as of `seed_words`.
    """

    def __init__(self, lanes: int, *seed: int) -> None:
        words = [opaque([word], mi.UInt32) for word in seed_words(2, *seed)]
        lane = dr.arange(mi.UInt32, lanes)
        self._low, self._high = mi.sample_tea_32(lane ^ words[0], words[1], HASH_ROUNDS)
        dr.eval(self._low, self._high)

    def state(self, serial):
        """State (UInt64) for every lane's photon number `serial` (UInt32)."""
        low = _mixed(self._low + serial * mi.UInt32(0x9E3779B9))
        high = _mixed(self._high + serial * mi.UInt32(0x85EBCA6B))
        return mi.UInt64(low) | (mi.UInt64(high) << 32)


def _mixed(word):
    """A permutation of 32-bit words whose every output bit depends on all input bits.

    C. Wellons, "Prospecting for hash functions" (2018), lowbias32.
    """
    word = (word ^ (word >> 16)) * mi.UInt32(0x7FEB352D)
    word = (word ^ (word >> 15)) * mi.UInt32(0x846CA68B)
    return word ^ (word >> 16)


class BirthLattice:
    """The lattice points of one launch; `seed` is as of `seed_words`."""

    def __init__(self, plan: LanePlan, *seed: int) -> None:
        group = plan.proposal * BATCHES + plan.batch
        self._rank, self._stride, group = (
            opaque(values, mi.UInt32) for values in (plan.rank, plan.stride, group)
        )
        words = [opaque([word], mi.UInt32) for word in seed_words(2 * len(GENERATORS), *seed)]
        self._shift = [
            mi.sample_tea_32(group ^ first, second, HASH_ROUNDS)[0]
            for first, second in zip(words[::2], words[1::2], strict=True)
        ]
        dr.eval(self._shift)

    def mirrored(self, serial):
        """Bit-mirrored number (UInt32) of every lane's photon number `serial` (UInt32)."""
        return dr.brev(self._rank + self._stride * serial)

    def coordinate(self, mirrored, dimension: int):
        """Coordinate (Float in [0, 1)) of the photons that `mirrored` tells."""
        # 32-bit integers wrap, which is just what a fractional part needs
        word = self._shift[dimension] + mirrored * mi.UInt32(GENERATORS[dimension])
        return mi.Float(word >> 8) * 2.0**-24


@functools.lru_cache(maxsize=4)
def lane_numbers(_variant: str, plan: LanePlan, *seed: int):
    """What lanes draw numbers by, kept for launches of one plan and seed, as of `seed_words`.

    Streams of PCG32 (UInt64), `PhotonSeeds`, `BirthLattice`, slots of first photons (UInt32).
    """
    stream = mi.UInt64(lane_generators(plan.lanes, *seed).inc)
    seeds, lattice = PhotonSeeds(plan.lanes, *seed, 2), BirthLattice(plan, *seed)
    first_slot = opaque(plan.first_slot, mi.UInt32)
    dr.eval(stream)
    dr.sync_thread()  # other threads that use them would not wait for this one
    return stream, seeds, lattice, first_slot


#: Candidates per wanted birth after which a volume counts as empty.
MOST_ROUNDS = 1000
#: Points along each side of a cell at which it is looked whether it lies inside.
POINTS_ALONG_A_CELL = 12
#: Height of the volume, over the depth of the source, below which births are even to 1e-6.
EVEN_BELOW = 1e-6
#: Depth of the uppermost births over the height: born on the face itself, light could miss it.
LEAST_DEPTH = 2.0**-20


#: The middle above the volume's bottom, and the thickness, of no slab.
NO_SLAB_MM = (0.0, np.inf)


class CrystalVolume:
    """The volume inside the shapes that border a medium.

    A parallelepiped of flat faces is sampled directly (where births fall with depth, one with two
    horizontal edges), and so is a cylinder (where births fall, along its axis; in a slab, one that
    stands); any other closed solid by rejection from its bounding box. A point is inside a convex
    solid when it is on the inner side of all its planes and of its round wall, and inside another
    solid when the first face that it sees has the medium on the near side.

    `volume` is the medium's index among ``model.volumes``. Births fall with the depth below the
    top, or with the distance from the side of the lowest x, as exp(-depth / ``source_depth_mm``, or
    ``side_depth_mm``); infinite: evenly. One of the two at most is finite. They may be in a slab
    alone, which is told by the height of its middle above the bottom and its thickness, or in an
    upright square column about the middle, so wide across.

    Raises InputError if the slab lies outside of the volume, or if births fall along its thickness.
    """

    #: Unit direction of all photons at birth; ``None``: any direction.
    aim: np.ndarray | None = None

    def __init__(
        self,
        model: SceneModel,
        volume: int,
        source_depth_mm: float = np.inf,
        side_depth_mm: float = np.inf,
        slab_mm: tuple[float, float] = NO_SLAB_MM,
        across_mm: float = np.inf,
    ) -> None:
        self.model, self.volume = model, volume
        #: Index of the volume that photons are in at birth.
        self.birth_volume = volume
        self.source_depth_mm, self.side_depth_mm = source_depth_mm, side_depth_mm
        # the axis along which births fall, and whether from its high end
        self._axis, self._from_high = (0, False) if side_depth_mm < np.inf else (2, True)
        owned = model.bordering(volume)
        #: Bounding box, float64, shape (3,), mm.
        self.lower, self.upper = model.bounds(volume)
        #: That of the births, likewise.
        self.born_lower, self.born_upper = self.lower.copy(), self.upper.copy()
        self._limit_to_slab(*slab_mm)
        self._limit_across(across_mm)
        # the height, or width, in depths, which is all that the distribution of depths needs
        length_mm = float(self.upper[self._axis] - self.lower[self._axis])
        steepness = length_mm / min(source_depth_mm, side_depth_mm)
        self._steepness = steepness if steepness > EVEN_BELOW else 0.0
        if self._steepness:
            self._length_in_depths = opaque([steepness])
            self._born_above = opaque([-np.expm1(-steepness)])
        self._solid = None
        #: Corner and three edges (float64, mm) of a parallelepiped that is sampled directly.
        self.frame = _parallelepiped([f for f in model.faces or () if f.surface in owned])
        if self.frame is not None and self._steepness:
            self.frame = _along(self._axis, self.frame)
        for axis in self._limited:
            if self.frame is not None:
                ends = self.born_lower[axis], self.born_upper[axis]
                self.frame = _between(axis, *ends, self.frame)
        if model.faces is not None and self.frame is None:
            self._solid = next((s for s in convex_solids(model) if s.volume == volume), None)
        if self.frame is not None:
            self._corner, *self._edges = map(opaque_vector, self.frame)
        #: The circle around a cylinder, if its births are sampled directly.
        self.circle = None if self._solid is None else self._solid.circle
        if self.circle is not None:
            axes = {self._axis} if self._steepness else set()
            if (axes | self._limited) - {self.circle.axis}:
                self.circle = None
        if self.circle is not None:
            middle = (self.lower + self.upper) / 2.0
            middle[self.circle.axis] = self.born_lower[self.circle.axis]
            self._corner = opaque_vector(middle)
            self._radius = opaque([self.circle.radius_mm])
            self._length = opaque([(self.born_upper - self.born_lower)[self.circle.axis]])

    @property
    def in_part(self) -> bool:
        """Whether light is born in a slab or a column alone."""
        return bool(self._limited)

    @property
    def _limited(self) -> set[int]:
        """Axes along which births do not take all of the volume."""
        less = self.born_upper - self.born_lower < self.upper - self.lower
        return set(np.flatnonzero(less).tolist())

    def _limit_across(self, across_mm: float) -> None:
        """Let light be born in a square column about the middle alone, unless that covers all."""
        if self.side_depth_mm < np.inf > across_mm:
            problem = "light is born in a column and falls with the distance from a side"
            raise InputError(problem, "give source_across_mm or side_depth_mm")
        middle = (self.lower + self.upper)[:2] / 2.0
        self.born_lower[:2] = np.maximum(self.lower[:2], middle - across_mm / 2.0)
        self.born_upper[:2] = np.minimum(self.upper[:2], middle + across_mm / 2.0)

    def _limit_to_slab(self, middle_mm: float, width_mm: float) -> None:
        """Let light be born in a slab alone, unless that covers the volume."""
        height_mm = float(self.upper[2] - self.lower[2])
        low, high = middle_mm - width_mm / 2.0, middle_mm + width_mm / 2.0
        rounding = 1e-6 * height_mm
        if low <= rounding and high >= height_mm - rounding:
            return
        if high <= rounding or low >= height_mm - rounding:
            problem = f"light is born from {low:g} to {high:g} mm above the crystal's bottom"
            mend = f"give source_z_mm and source_width_mm a slab within 0 to {height_mm:g} mm"
            raise InputError(f"{problem}, outside of it", mend)
        if height_mm / self.source_depth_mm > EVEN_BELOW:
            problem = "light is born in a slab and falls with the depth below the top"
            raise InputError(problem, "give source_z_mm or source_depth_mm")
        self.born_lower[2] = self.lower[2] + max(low, 0.0)
        self.born_upper[2] = self.lower[2] + min(high, height_mm)

    @property
    def scatters(self) -> bool:
        """Whether the medium scatters light."""
        return self.model.volumes[self.volume].alpha_scat_per_mm > 0

    @property
    def direct(self) -> bool:
        """Whether `from_uniforms` can be used."""
        return self.frame is not None or self.circle is not None

    def from_uniforms(self, a, b, c):
        """A birth (Point3f, mm) in a parallelepiped or cylinder from three uniforms (Float)."""
        if self.circle is None:
            u, v, w = self._edges
            if self._steepness and self.frame is not None:
                c = self._share(c, self._from_high == bool(self.frame[3][self._axis] > 0.0))
            return mi.Point3f(self._corner) + u * a + v * b + w * c
        if self._steepness:
            c = self._share(c, self._from_high)
        radius = self._radius * dr.sqrt(a)
        sine, cosine = dr.sincos(dr.two_pi * b)
        u, v = self.circle.across
        away = mi.Vector3f(0.0)
        away[u], away[v] = radius * cosine, radius * sine
        away[self.circle.axis] = self._length * c
        return mi.Point3f(self._corner) + away

    def hashed_birth(self, slot, seed: Sequence[int]):
        """A random birth (Point3f, mm) in these, by a number (UInt32), see `seed_words`."""
        words = (opaque([word], mi.UInt32) for word in seed_words(3, *seed))
        shares = (mi.sample_tea_float32(slot, word, HASH_ROUNDS) for word in words)
        return mi.Point3f(self.from_uniforms(*shares))

    def _share(self, uniform, from_high: bool):
        """Where a birth lies along the volume, from 0 to 1, from a uniform."""
        return 1.0 - self._depth(1.0 - uniform) if from_high else self._depth(uniform)

    def _depth(self, uniform):
        """Depth of a birth, over the volume's height or width, from a uniform."""
        # -log1p(-x) / steepness, written so that small x are right as well (W. Kahan)
        x = uniform * self._born_above
        rest = 1.0 - x
        minus_log = dr.select(rest == 1.0, x, -dr.log(rest) * x / (1.0 - rest))
        return dr.clip(minus_log / self._length_in_depths, LEAST_DEPTH, 1.0)

    def sample(self, rng, count: int):
        """`count` births (Point3f, mm) in any closed solid, by rejection; advances `rng`."""
        point, rounds = self._searched(rng, count)
        if int(dr.max(rounds)[0]) >= MOST_ROUNDS:
            raise InputError(
                f"the shapes around medium {self.model.volumes[self.volume].name!r} enclose no "
                "volume",
                "close the crystal: every face needs the medium on its inner side",
            )
        return point

    def born_from(self, a, b, c):
        """A birth (Point3f, mm) that three uniforms (Float) fix; they may seed the rejection."""
        if self.direct:
            return self.from_uniforms(a, b, c)
        bits = [dr.reinterpret_array(mi.UInt32, uniform) for uniform in (a, b, c)]
        start, stream = (mi.sample_tea_64(bits[i], bits[i + 1], HASH_ROUNDS) for i in (0, 1))
        return self._searched(mi.PCG32(initstate=start, initseq=stream), dr.width(start))[0]

    def _searched(self, rng, count: int):
        """Births (Point3f, mm) and the rounds they took (UInt32), `MOST_ROUNDS` where in vain."""
        lower = opaque_vector(self.born_lower)
        extent = opaque_vector(self.born_upper - self.born_lower)
        inside = self._sees_itself() if self._solid is None else self._solid.test()

        def body(point, searching, rng, rounds):
            shares = [rng.next_float32() for _ in range(3)]
            if self._steepness:
                shares[self._axis] = self._share(shares[self._axis], self._from_high)
            candidate = dr.fma(extent, mi.Point3f(*shares), lower)
            point = dr.select(searching, candidate, point)
            rounds += 1
            searching = searching & ~inside(point) & (rounds < MOST_ROUNDS)
            return point, searching, rng, rounds

        begin, all_of_them = dr.zeros(mi.Point3f, count), dr.full(mi.Bool, True, count)
        point, _, rng, rounds = dr.while_loop(
            state=(begin, all_of_them, rng, dr.zeros(mi.UInt32, count)),
            cond=lambda point, searching, rng, rounds: searching,
            body=body,
            labels=("point", "searching", "rng", "rounds"),
        )
        return point, rounds

    def part_inside(self, edges_mm: Sequence[np.ndarray]) -> np.ndarray:
        """Part of the volume of each cell of a grid that lies inside, by its edges along x, y, z.

        float64, one dimension per axis: 1 throughout a box, and to a per cent at the borders of
        other shapes, from a lattice of points.
        """
        shape = tuple(len(edges) - 1 for edges in edges_mm)
        if self.frame is not None and all(np.count_nonzero(e) == 1 for e in self.frame[1:]):
            return np.ones(shape)
        inside = self._sees_itself() if self._solid is None else self._solid.test()
        share = (np.arange(POINTS_ALONG_A_CELL) + 0.5) / POINTS_ALONG_A_CELL
        along = [(e[:-1, None] + share * np.diff(e)[:, None]).ravel() for e in edges_mm]
        points = np.stack(np.meshgrid(*along, indexing="ij")).reshape(3, -1)
        hit = np.array(inside(mi.Point3f(*points.astype(np.float32))))
        lattice = [side for n in shape for side in (n, POINTS_ALONG_A_CELL)]
        return hit.reshape(lattice).mean(axis=(1, 3, 5))

    def birth_density(self, edges_mm: Sequence[np.ndarray]) -> np.ndarray:
        """Of births in each cell of such a grid over the bounding box; float64, its mean is 1."""
        density = np.ones([len(edges) - 1 for edges in edges_mm])
        if self._steepness:
            low, high = self.lower[self._axis], self.upper[self._axis]
            depth = (edges_mm[self._axis] - low) / (high - low)
            born_before = np.expm1(-self._steepness * (1.0 - depth if self._from_high else depth))
            along = np.abs(np.diff(born_before)) / np.diff(depth) / -np.expm1(-self._steepness)
            density *= np.expand_dims(along, [i for i in range(3) if i != self._axis])
        return density

    def _sees_itself(self):
        """A function that tells of points (Point3f, mm) whether they lie in the volume (Mask)."""
        borders = [
            opaque([s.sides[side] == self.volume for s in self.model.surfaces], mi.Bool)
            for side in (0, 1)
        ]
        number_of = surface_numbers(self.model)

        def inside(point):
            # an oblique direction, which no bench has a face along
            probe = mi.Ray3f(point, mi.Vector3f(0.2672612, 0.5345225, 0.8017837))
            si = self.model.scene.ray_intersect(probe, mi.RayFlags.Minimal, coherent=False)
            hit = si.is_valid()
            number = number_of(si.shape, hit)
            behind = dr.dot(probe.d, si.n) > 0
            interior, exterior = (dr.gather(mi.Bool, sides, number, hit) for sides in borders)
            return hit & dr.select(behind, interior, exterior)

        return inside


#: Distance before the crystal at which the photons of a beam begin, mm.
BEAM_START_MM = 1.0


class CollimatedBeam(CrystalVolume):
    """Parallel light that enters the crystal from outside, through the middle of one side.

    Photons are born evenly on a disc before the side of the lowest coordinate along the beam.

    The beam flies along +x, +y or +z, which `axis` (0, 1, 2) tells.

    Raises InputError if some of the light would miss the crystal.
    """

    def __init__(self, model: SceneModel, volume: int, axis: int, diameter_mm: float) -> None:
        super().__init__(model, volume)
        self.birth_volume, self.axis, self.diameter_mm = OUTSIDE, axis, diameter_mm
        self.aim = np.eye(3)[axis]
        across = [other for other in range(3) if other != axis]
        width_mm = float((self.upper - self.lower)[across].min())
        if not diameter_mm < width_mm:
            raise InputError(
                f"the beam is {diameter_mm:g} mm wide, and the crystal's side {width_mm:.4g} mm",
                "make the beam narrower: what misses the crystal would count as transmitted",
            )
        begin = (self.lower + self.upper) / 2.0
        begin[axis] = self.lower[axis] - BEAM_START_MM
        self._begin = opaque_vector(begin)
        self._radius_mm = opaque([diameter_mm / 2.0])
        self._across = [opaque_vector(np.eye(3)[other]) for other in across]

    @property
    def direct(self) -> bool:
        """Whether `from_uniforms` can be used."""
        return True

    def from_uniforms(self, a, b, c):
        """A birth (Point3f, mm) on the disc from two of three uniforms (Float)."""
        radius = self._radius_mm * dr.sqrt(a)
        sine, cosine = dr.sincos(dr.two_pi * b)
        u, v = self._across
        return mi.Point3f(self._begin + u * (radius * cosine) + v * (radius * sine))


def read_crystal(scene) -> CrystalVolume:
    """Where light is born in a loaded scene, with the model of that scene.

    Raises InputError if the scene has no detector, or not one emitter; and as `read_scene_model`.
    """
    emitters = [e for e in scene.emitters() if hasattr(e, "volume")]
    if len(emitters) != 1:
        problem = f"the scene has {len(emitters)} scintillation emitters, not one"
        mend = 'write one <emitter type="scintillation"><ref id="crystal"/></emitter>'
        raise InputError(problem, mend)
    crystal = emitters[0].volume(read_scene_model(scene))
    if not any(surface.kind == DETECTOR for surface in crystal.model.surfaces):
        problem = "no shape of the scene is a detector"
        raise InputError(problem, 'give the detecting face <bsdf type="photodetector"/>')
    return crystal


def _along(axis: int, frame):
    """A parallelepiped with its one edge not across an axis last; ``None`` if there are more."""
    corner, *edges = frame
    edges.sort(key=lambda edge: abs(edge[axis]))
    return None if abs(edges[1][axis]) > 1e-6 * np.abs(edges).max() else (corner, *edges)


def _between(axis: int, low_mm: float, high_mm: float, frame):
    """The part of a parallelepiped between two places along an axis, its edges in their order.

    ``None`` if more than one edge goes along it.
    """
    corner, *edges = frame
    along = [abs(edge[axis]) > 1e-6 * np.abs(edges).max() for edge in edges]
    if sum(along) != 1:
        return None
    up = along.index(True)
    edge = edges[up]
    ends = [corner + edge * ((x - corner[axis]) / edge[axis]) for x in (low_mm, high_mm)]
    start, end = ends if edge[axis] > 0.0 else reversed(ends)
    edges[up] = end - start
    return (start, *edges)


def _parallelepiped(faces):
    """Corner and edges of the parallelepiped that faces make up, or ``None``.

    All but the first may be in parts, so that births are those of a crystal whose faces are whole.
    """
    if not faces or any(face.triangle for face in faces):
        return None
    corners = np.concatenate([face.corners for face in faces])
    size, area = np.ptp(corners, axis=0).max(), sum(face.area for face in faces)
    corner, u, v = faces[0].corner, faces[0].edge_u, faces[0].edge_v
    # The third edge leads from the first face to a corner of the opposite one.
    for candidate in corners:
        w = candidate - corner
        if abs(w @ faces[0].normal) < 1e-5 * size:
            continue
        shares = np.linalg.solve(np.column_stack([u, v, w]), (corners - corner).T).T
        whole = 2.0 * sum(math.hypot(*cross(*pair)) for pair in ((u, v), (v, w), (w, u)))
        inside = shares.min() > -1e-5 and shares.max() < 1.0 + 1e-5
        ends = shares.reshape(len(faces), -1, 3)
        away = np.minimum(np.abs(ends).max(axis=1), np.abs(ends - 1.0).max(axis=1))
        on_sides = away.min(axis=1).max() < 1e-5
        if inside and on_sides and abs(area - whole) < 1e-4 * whole:
            return corner, u, v, w
    return None


#: Part of a Gaussian band that is not cut off.
_WITHIN_CUT = math.erf(WIDTHS * FWHM / math.sqrt(2.0))


@dataclass
class Strength:
    """Scattering relative to the volume's coefficient, along a straight flight."""

    #: Where the flight begins.
    here: Any
    #: Its change per millimetre of flight.
    per_mm: Any

    def until(self, path):
        """Distance (mm, Float) at which the weighted path is `path`; infinite if it never is."""
        discriminant = dr.fma(2.0 * self.per_mm, path, dr.square(self.here))
        # the root that does not cancel; no volume with nothing to scatter has one
        denominator = dr.maximum(self.here + dr.safe_sqrt(discriminant), dr.smallest(mi.Float))
        return dr.select(discriminant < 0.0, dr.inf, 2.0 * path / denominator)

    def path(self, distance):
        """Path (mm, Float) of a flight over `distance`, weighted with the strength."""
        return distance * dr.fma(0.5 * self.per_mm, distance, self.here)


class Scattering:
    """How the volumes of these numbers scatter light born in one, as numbers of the loop."""

    def __init__(self, model: SceneModel, scattering, born_in: int) -> None:
        self._mean_cosine, self._rayleigh, self._graded = {}, [], {}
        self._coloured = {}
        for number in scattering:
            volume = model.volumes[number]
            if volume.phase == "hg":
                self._mean_cosine[number] = opaque([volume.scattering_g])
            if volume.phase == "rayleigh":
                self._rayleigh.append(number)
            if volume.scattering_exponent and number == born_in:
                width = [volume.relative_bandwidth / FWHM * math.sqrt(2.0)]
                self._coloured[number] = (opaque([-volume.scattering_exponent]), opaque(width))
            if volume.scattering_gradient:
                bottom, top = (float(corner[2]) for corner in model.bounds(number))
                slope = 2.0 * volume.scattering_gradient / (top - bottom)
                middle = (top + bottom) / 2.0
                self._graded[number] = (opaque([1.0 - slope * middle]), opaque([slope]))

    @property
    def coloured(self) -> bool:
        """Whether light of other wavelengths scatters otherwise."""
        return bool(self._coloured)

    def strength(self, inside, origin, direction, colour=None) -> Strength | None:
        """Along a flight in the volume that `inside` (list of Mask) tells; ``None`` if 1.

        `colour` (Float, even in [0, 1)) tells the photon's wavelength; without it that is where
        the coefficients are given.
        """
        coloured = {} if colour is None else self._coloured
        if not self._graded and not coloured:
            return None
        here, per_mm = mi.Float(1.0), mi.Float(0.0)
        for number, (at_zero, slope) in self._graded.items():
            here_strength = dr.maximum(dr.fma(slope, origin.z, at_zero), 0.0)
            here = dr.select(inside[number], here_strength, here)
            per_mm = dr.select(inside[number], slope * direction.z, per_mm)
        for number, (power, width) in coloured.items():
            # erfinv turns even numbers into those of a Gaussian
            z = dr.erfinv(_WITHIN_CUT * dr.fma(2.0, colour, -1.0))
            factor = dr.power(dr.fma(width, z, 1.0), power)
            factor = dr.select(inside[number], factor, 1.0)
            here, per_mm = here * factor, per_mm * factor
        return Strength(here, per_mm)

    def direction(self, inside, old, uniforms, afresh):
        """Unit direction (Vector3f) after a scattering; where `afresh` (Mask), any at all.

        `inside` (list of Mask) tells the volume, `uniforms` give the azimuth and the angle.
        """
        if not (self._mean_cosine or self._rayleigh):
            return mi.warp.square_to_uniform_sphere(mi.Point2f(*uniforms))
        even = dr.fma(-2.0, uniforms[1], 1.0)
        cosine = even
        for number, g in self._mean_cosine.items():
            cosine = dr.select(inside[number], henyey_greenstein_cosine(even, g), cosine)
        for number in self._rayleigh:
            cosine = dr.select(inside[number], rayleigh_cosine(even), cosine)
        cosine = dr.select(afresh, even, cosine)
        sine = dr.safe_sqrt(dr.fma(-cosine, cosine, 1.0))
        across, along = dr.sincos(dr.two_pi * uniforms[0])
        axis = dr.select(afresh, mi.Vector3f(0.0, 0.0, 1.0), old)
        return dr.normalize(
            mi.Frame3f(axis).to_world(mi.Vector3f(sine * along, sine * across, cosine))
        )


def henyey_greenstein_cosine(even, g):
    """Cosine of the scattering angle, from a number even in [-1, 1]; good for g = 0 as well."""
    # (1 + g^2 - ((1 - g^2) / (1 + g t))^2) / (2 g), multiplied out so that nothing is over g
    numerator = even + g * (0.5 * (dr.square(even) + 3.0) + g * even)
    numerator += 0.5 * g * g * g * (dr.square(even) - 1.0)
    return dr.clip(numerator / dr.square(dr.fma(g, even, 1.0)), -1.0, 1.0)


def rayleigh_cosine(even):
    """Cosine of the scattering angle by 3/8 (1 + cos^2), from a number even in [-1, 1]."""
    half = 2.0 * dr.abs(even)
    root = dr.cbrt(half + dr.sqrt(dr.fma(half, half, 1.0)))
    return dr.mulsign(dr.minimum(root - dr.rcp(root), 1.0), even)
