"""Faces of a bench: polygons, discs, mantles and spheres, with what is on their sides, as tables.

They come from a scene's text (`scene_faces`), or are typed in by hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.reference import walk
from mcrim_mitsuba.reference.interface import film_waves, square

Floats = NDArray[np.float64]
#: (4,): u and m of the half space u . x <= m.
HalfSpace = Floats


@dataclass(frozen=True, eq=False)
class Face:
    """A convex flat face, perhaps with a round hole, or a mantle or sphere; arrays in mm."""

    #: (4,): unit normal, towards what is in front, and its product with a point; None if round.
    plane: Floats | None
    _: KW_ONLY
    bounds: Sequence[HalfSpace] = ()
    #: (3, 4): A and c of ``|A (x - c)| = 1``, columns first.
    quadric: Floats | None = None
    #: Of a flat face +1 if it is what lies within the quadric, -1 if it is what lies around; of
    #: a round one +1 if its front is outside.
    circle: int = 0
    #: Id of the wrapping that may touch it.
    wrapping: str = ""
    #: (2, 3): lowest and highest coordinates.
    box: Floats

    @property
    def flipped(self) -> Face:
        """The face with back and front exchanged."""
        if self.plane is None:
            return replace(self, circle=-self.circle)
        return replace(self, plane=-self.plane)


def half_space(direction: ArrayLike, point: ArrayLike) -> HalfSpace:
    """What lies before a point in a direction."""
    u = np.asarray(direction, float)
    u = u / np.linalg.norm(u)
    return np.append(u, u @ np.asarray(point, float))


def polygon(corners: ArrayLike) -> Face:
    """A convex polygon, by its corners, (n, 3), anticlockwise seen from the front."""
    corners = np.asarray(corners, float)
    ends = np.roll(corners, -1, axis=0)
    plane = half_space(np.cross(corners - corners[0], ends - corners[0]).sum(axis=0), corners[0])
    pairs = zip(corners, ends, strict=True)
    bounds = [half_space(np.cross(end - start, plane[:3]), start) for start, end in pairs]
    return Face(plane, bounds=bounds, box=np.array([corners.min(axis=0), corners.max(axis=0)]))


def around(face: Face, hole: ArrayLike) -> list[Face]:
    """What is left of a polygon around another in its plane: a face at each edge of the hole."""
    edges = polygon(hole).bounds
    return [replace(face, bounds=[*face.bounds, -edge, *edges[:i]]) for i, edge in enumerate(edges)]


def ellipse(centre: ArrayLike, u: ArrayLike, v: ArrayLike) -> Face:
    """A disc, or an ellipse, of these half axes, (3,) each; its front is where u x v points."""
    centre, u, v = (np.asarray(a, float) for a in (centre, u, v))
    plane, reach = half_space(np.cross(u, v), centre), np.hypot(u, v)
    box = np.array([centre - reach, centre + reach])
    return Face(plane, quadric=_across(centre, u, v, plane[:3]), circle=1, box=box)


def with_round_hole(face: Face, centre: ArrayLike, u: ArrayLike, v: ArrayLike) -> Face:
    """A flat face without the disc of these half axes."""
    return replace(face, quadric=ellipse(centre, u, v).quadric, circle=-1)


def mantle(foot: ArrayLike, u: ArrayLike, v: ArrayLike, along: ArrayLike) -> Face:
    """A cylinder without its ends, from the middle of its foot; its front is outside."""
    foot, u, v, along = (np.asarray(a, float) for a in (foot, u, v, along))
    across = np.cross(u, v)
    across = across if across @ along > 0.0 else -across
    bounds = half_space(across, foot + along), half_space(-across, foot)
    ends, reach = np.array([foot, foot + along]), np.hypot(u, v)
    box = np.array([ends.min(axis=0) - reach, ends.max(axis=0) + reach])
    return Face(None, bounds=bounds, quadric=_across(foot, u, v, along), circle=1, box=box)


def ellipsoid(centre: ArrayLike, axes: ArrayLike) -> Face:
    """A sphere, or an ellipsoid, of these half axes, as columns; its front is outside."""
    centre, axes = np.asarray(centre, float), np.asarray(axes, float)
    reach = np.linalg.norm(axes, axis=1)
    quadric = np.column_stack((np.linalg.inv(axes), centre))
    return Face(None, quadric=quadric, circle=1, box=np.array([centre - reach, centre + reach]))


def _across(centre: Floats, u: Floats, v: Floats, along: Floats) -> Floats:
    """The quadric of what is within these half axes, whatever is along the third direction."""
    rows = np.linalg.inv(np.column_stack((u, v, along)))
    rows[2] = 0.0
    return np.column_stack((rows, centre))


@dataclass(frozen=True, eq=False, kw_only=True)
class BenchSurface:
    """What the faces of a shape have in common, under the shape's id."""

    name: str
    faces: Sequence[Face]
    #: Names of the volumes behind and in front of it; empty: outside.
    interior: str = ""
    exterior: str = ""
    #: Values of `walk.SURFACE_FIELDS`; what is not named is not there.
    optics: dict[str, complex] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class FacedBench:
    """A bench by its faces, media and where its light is born."""

    surfaces: Sequence[BenchSurface]
    #: By name values of `walk.VOLUME_FIELDS`; coefficients per mm.
    volumes: dict[str, dict[str, float]]
    #: Values of `walk.BIRTH_FIELDS` but the box, and the volume by its name.
    birth: dict[str, float]
    crystal: str = "crystal"
    #: Lowest and highest z of births, mm, above the crystal's lowest; None: everywhere.
    slab_mm: tuple[float, float] | None = None
    #: Width of the square column about the crystal's axis in which light is born, mm.
    across_mm: float = math.inf
    #: The detector whose light eta is of; empty: all of them.
    read: str = ""
    polarised: bool = False
    #: Flights after which a photon is given up; None: nothing is said of it.
    most_flights: int | None = None

    @property
    def volume_names(self) -> tuple[str, ...]:
        """In the order of their numbers, that outside being 0."""
        return "outside", *self.volumes

    def number(self, name: str) -> int:
        """Of the volume of this name, or outside."""
        return self.volume_names.index(name) if name else walk.OUTSIDE

    def box(self, name: str) -> Floats:
        """Lowest and highest coordinates, (2, 3), of a volume: of the faces that border it."""
        own = [f.box for s in self.surfaces if name in (s.interior, s.exterior) for f in s.faces]
        return np.array([np.min(own, axis=0)[0], np.max(own, axis=0)[1]])

    @property
    def detectors(self) -> dict[int, str]:
        """Ids of the detectors by the numbers of their surfaces."""
        kinds = enumerate(self.surfaces)
        return {i: s.name for i, s in kinds if s.optics.get("kind") == walk.DETECTOR}

    @property
    def head_on(self) -> float:
        """Part that the detectors, all alike, detect of head-on light; they were calibrated so."""
        if not self.detectors:
            return 1.0
        detector = self.surfaces[min(self.detectors)].optics
        part = 1.0 / (1.0 - min(0.0, float(detector.get("angular_falloff", 0.0).real)))
        if wavelengths := detector.get("film_wavelengths", 0.0):
            index, glass = complex(detector["film_index"]), detector["n_interior"]
            r_s, _, t_s, _ = film_waves(index, float(glass.real), float(wavelengths.real), 1.0)
            part *= 1.0 - square(r_s) - t_s
        return part

    def tables(self) -> tuple[walk.Tables, NDArray]:
        """What the walk takes: the bench, and where light is born, (1,) of `walk.BIRTH_FIELDS`."""
        faces = [(number, face) for number, s in enumerate(self.surfaces) for face in s.faces]
        surfaces = self._surfaces()
        volumes = self._volumes(surfaces)
        names = [surface.name for surface in self.surfaces]
        rows, spaces = np.zeros(len(faces), walk.FACE_FIELDS), list[HalfSpace]()
        quadrics = np.zeros((len(faces), 12))
        for row, quadric, (number, face) in zip(rows, quadrics, faces, strict=True):
            row["form"], row["circle"] = walk.ROUND, face.circle
            if face.plane is not None:
                row["form"] = walk.FLAT
                row["x"], row["y"], row["z"], row["level"] = face.plane
            if face.quadric is not None:
                quadric[:] = (*face.quadric[:, :3].ravel(), *face.quadric[:, 3])
            row["surface"], row["begin"] = number, len(spaces)
            spaces += face.bounds
            row["end"] = len(spaces)
            row["wrapping"] = names.index(face.wrapping) if face.wrapping else -1
        sides = surfaces[rows["surface"]]
        bordering = [self._bordering(v, volumes, sides) for v in range(len(volumes))]
        tables = walk.Tables(
            faces=rows,
            quadrics=quadrics,
            half_spaces=np.array(spaces, float).reshape(-1, 4),
            surfaces=surfaces,
            volumes=volumes,
            first=np.cumsum([0, *map(len, bordering)]),
            bordering=np.array([face for pairs in bordering for face, _ in pairs]),
            side=np.array([side for pairs in bordering for _, side in pairs]),
        )
        birth = np.zeros(1, walk.BIRTH_FIELDS)
        values = {"depth": math.inf, **self.birth, "volume": self.number(self.crystal)}
        for name, value in values.items():
            birth[name] = value
        low, high = self.box(self.crystal)
        if self.slab_mm is not None:
            high[2] = min(high[2], low[2] + self.slab_mm[1])
            low[2] = max(low[2], low[2] + self.slab_mm[0])
        middle = (low + high)[:2] / 2.0
        low[:2] = np.maximum(low[:2], middle - self.across_mm / 2.0)
        high[:2] = np.minimum(high[:2], middle + self.across_mm / 2.0)
        for axis, ends in zip("xyz", zip(low, high, strict=True), strict=True):
            birth[f"{axis}0"], birth[f"{axis}1"] = ends
        return tables, birth

    def _surfaces(self) -> NDArray:
        """(surfaces,) of `walk.SURFACE_FIELDS`."""
        rows = np.zeros(len(self.surfaces), walk.SURFACE_FIELDS)
        rows["mask_radius"] = math.inf
        for row, surface in zip(rows, self.surfaces, strict=True):
            sides = {side: self.number(getattr(surface, side)) for side in ("interior", "exterior")}
            for name, value in (sides | surface.optics).items():
                row[name] = value
        return rows

    def _volumes(self, surfaces: NDArray) -> NDArray:
        """(volumes,) of `walk.VOLUME_FIELDS`."""
        rows = np.zeros(len(self.volumes) + 1, walk.VOLUME_FIELDS)
        rows["index"][walk.OUTSIDE] = 1.0
        for number, (name, values) in enumerate(self.volumes.items(), start=1):
            for key, value in values.items():
                rows[key][number] = value
            low, high = self.box(name)
            rows["low"][number], rows["high"][number] = low[2], high[2]
        interfaces = surfaces[surfaces["kind"] == walk.DIELECTRIC]
        for side in ("interior", "exterior"):
            rows["index"][interfaces[side]] = interfaces[f"n_{side}"]
        return rows

    @staticmethod
    def _bordering(volume: int, volumes: NDArray, sides: NDArray) -> list[tuple[int, int]]:
        """Faces that light in a volume meets, and on which side of them it is."""
        here = {volume}
        if volume == walk.OUTSIDE or volumes["endless"][volume]:
            # an endless volume is where the outside is
            here |= {walk.OUTSIDE, *np.flatnonzero(volumes["endless"]).tolist()}
        behind, in_front = (np.isin(sides[side], list(here)) for side in ("interior", "exterior"))
        faces = np.flatnonzero(behind | in_front)
        return list(zip(faces, behind[faces].astype(int) - in_front[faces], strict=True))
