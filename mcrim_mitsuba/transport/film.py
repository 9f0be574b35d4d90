"""Light's way to a wrapping and back within one step: through the film of air before it.

Two flights of three in a wrapped crystal lead through a film of some micrometres. Where a face of
the crystal and a wall of the wrapping are parallel, both are known to be met next: light that
leaves by the face goes to the wall at once, is reflected or absorbed there, comes back to the face
and enters, or is reflected once more. So it goes unless it would pass by the wall, through the
film's open rim, or by the face, round an edge of the crystal; from there it flies as all light
does. Random numbers aside, every photon fares as from face to face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import ConvexHull

from mcrim_mitsuba.transport import dielectric
from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.convex import Plane, Solid, is_any, slack_of
from mcrim_mitsuba.transport.scene_model import DIELECTRIC, DIFFUSE, OUTSIDE, SceneModel, Surface
from mcrim_mitsuba.transport.surface_physics import ALIVE, REFLECTOR, Encounter, Outcome

#: Cosine of the angle between faces that count as parallel.
_PARALLEL = 1.0 - 1e-6


@dataclass(frozen=True)
class WrappingFilm:
    """Faces of a convex crystal with walls before them, all at one distance."""

    #: Number of the wall before each face of the crystal, by its number.
    walls: dict[int, int]
    distance_mm: float
    #: What the walls are.
    surface: Surface
    #: What the walls enclose, their open ends being planes too; and the crystal.
    within: Solid
    crystal: Solid


def film_before(model: SceneModel, crystal: Solid) -> WrappingFilm | None:
    """The film around a crystal, or None where there is none, or light must go from face to face.

    - Faces are polished interfaces with the outside, each alone in its plane; what else happens to
      light from inside is decided before it crosses them.
    - Walls stand in the outside, are all alike and equally far away, and each is a whole side of
      what they enclose.
    - Nothing else stands in there.
    """
    slack, faces = slack_of(model), model.flat_faces
    if crystal.walls:
        return None
    walls = [
        number
        for number, face in enumerate(faces)
        if model.surfaces[face.surface].kind == DIFFUSE
        and model.surfaces[face.surface].sides == (OUTSIDE, OUTSIDE)
        and face.circle is None
    ]
    own = {number for plane in crystal.planes for number in plane.faces}
    surfaces = {replace(model.surfaces[faces[number].surface], name="") for number in walls}
    if len(surfaces) != 1:
        return None
    corners = np.concatenate([faces[number].corners for number in (*walls, *own)])
    low, high = corners.min(axis=0) + slack, corners.max(axis=0) - slack
    for number, face in enumerate(faces):
        beside = (face.corners.max(axis=0) <= low) | (face.corners.min(axis=0) >= high)
        if number not in own and number not in walls and not beside.any():
            return None
    within = _enclosed_by(model, walls)
    if within is None:
        return None
    pairs: dict[int, int] = {}
    distances: list[float] = []
    for plane in crystal.planes:
        surface = model.surfaces[faces[plane.faces[0]].surface]
        if len(plane.faces) > 1 or not _is_plain(surface, crystal.volume):
            continue
        (number,) = plane.faces
        outwards = faces[number].normal
        for wall in walls:
            if -outwards @ faces[wall].normal >= _PARALLEL:
                away = (faces[wall].corners - faces[number].corner) @ outwards
                if away.min() > slack:
                    pairs[number] = wall
                    distances.append(float(away.mean()))
    if not pairs or np.ptp(distances) > slack:
        return None
    return WrappingFilm(pairs, distances[0], surfaces.pop(), within, crystal)


def _is_plain(surface: Surface, crystal: int) -> bool:
    """Whether light crosses a face of the crystal to the outside, and back, by Fresnel alone."""
    loses = surface.roughness or surface.haze or surface.surface_loss or surface.ground_loss
    masked = surface.aperture_radius_mm < np.inf
    is_interface = surface.kind == DIELECTRIC and surface.sides == (crystal, OUTSIDE)
    return is_interface and not loses and not masked


def _enclosed_by(model: SceneModel, walls: list[int]) -> Solid | None:
    """What walls enclose, if each is a whole side of it."""
    faces, slack = model.flat_faces, slack_of(model)
    hull = ConvexHull(np.concatenate([faces[number].corners for number in walls]))
    planes: dict[tuple[float, ...], list[int]] = {}
    for simplex, equation in enumerate(np.round(hull.equations, 6) + 0.0):
        planes.setdefault(tuple(equation), []).append(simplex)
    areas = {
        equation: sum(_area(hull.points[hull.simplices[simplex]]) for simplex in simplices)
        for equation, simplices in planes.items()
    }
    for number in walls:
        face = faces[number]
        beyond = np.array([face.corners @ eq[:3] + eq[3] for eq in planes])
        (sides,) = np.nonzero(np.abs(beyond).max(axis=1) <= 10.0 * slack)
        if not len(sides) or abs(list(areas.values())[sides[0]] - face.area) > 1e-3 * face.area:
            return None
    bounds = []
    for x, y, z, level in planes:
        largest = max((x, y, z), key=abs)
        axis = tuple(value / abs(largest) + 0.0 for value in (x, y, z))
        bounds.append(Plane(axis, True, -level / abs(largest) + slack, []))
    return Solid(OUTSIDE, tuple(bounds), ())


def _area(triangle: np.ndarray) -> float:
    a, b, c = triangle
    return float(np.linalg.norm(np.cross(b - a, c - a))) / 2.0


class FilmTrips:
    """The film before a wrapping, in the kernel."""

    def __init__(self, model: SceneModel, film: WrappingFilm) -> None:
        slack = slack_of(model)
        wider = [
            replace(plane, offset=plane.offset + (slack if plane.high else -slack))
            for plane in film.crystal.planes
        ]
        self._on_wall = film.within.test()
        self._on_face = replace(film.crystal, planes=tuple(wider)).test()
        self._crystal, self._walls = film.crystal.volume, film.walls
        self._distance, self._reflectance, self._mirrored = (
            opaque([value])
            for value in (
                film.distance_mm,
                film.surface.reflectance,
                film.surface.reflectance * film.surface.mirror_part,
            )
        )

    def go(self, light: Encounter, outcome: Outcome, face, rng, active) -> None:
        """Take light that leaves by a face (UInt32) to the wall before it and back.

        It has no use yet for the even numbers of a diffuse direction; `rng` gives two more.
        """
        row, outwards, volume = light.row, light.row.normal, outcome.volume
        at_wall, at_face = rng.next_float32(), rng.next_float32()
        goes = active & outcome.crossed & (outcome.fate == ALIVE) & (volume == OUTSIDE)
        goes &= is_any(face, [*self._walls])
        there = self._distance / dr.dot(outcome.direction, outwards)
        wall = dr.fma(outcome.direction, there, outcome.position)
        goes &= self._on_wall(wall)
        kept = goes & (at_wall < self._reflectance)
        outcome.fate = dr.select(goes & ~kept, mi.UInt32(REFLECTOR), outcome.fate)
        # the wall is parallel to the face: what is diffuse at one is so at the other
        diffuse, _ = light.lambertian()
        arriving = dr.dot(outcome.direction, outwards)
        mirrored = dr.fma(outwards, -2.0 * arriving, outcome.direction)
        flying = dr.select(at_wall < self._mirrored, mirrored, diffuse)
        cosine = -dr.dot(flying, outwards)
        back = self._distance / cosine
        place = dr.fma(flying, back, wall)
        returns = kept & self._on_face(place)
        ratio = dr.rcp(row.eta)
        entering, _, stays = dielectric.split(flying, None, outwards, ratio, cosine, at_face)
        outcome.direction = dr.select(kept, dr.select(returns, entering, flying), outcome.direction)
        outcome.position = dr.select(kept, dr.select(returns, place, wall), outcome.position)
        outcome.volume = dr.select(returns & ~stays, mi.UInt32(self._crystal), volume)
        outcome.face = mi.UInt32(face)
        for number, opposite in self._walls.items():
            passes = kept & ~returns & (face == number)
            outcome.face = dr.select(passes, mi.UInt32(opposite), outcome.face)
        outcome.from_reflector = outcome.from_reflector | kept
        outcome.in_film = dr.select(goes, there, 0.0) + dr.select(returns, back, 0.0)
