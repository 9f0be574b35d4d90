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

from mcrim_mitsuba.transport import dielectric
from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.convex import Disc, Plane, Ray, Solid, is_any, slack_of
from mcrim_mitsuba.transport.scene_model import (
    DIELECTRIC,
    DIFFUSE,
    OUTSIDE,
    Kept,
    RoundWall,
    SceneModel,
    Surface,
)
from mcrim_mitsuba.transport.surface_physics import ALIVE, REFLECTOR, Encounter, Outcome

#: Cosine of the angle between faces that count as parallel.
_PARALLEL = 1.0 - 1e-6


@dataclass(frozen=True)
class WrappingFilm:
    """Faces of a convex crystal with walls before them, all at one distance."""

    #: Number of the wall before each face of the crystal, by its number; round ones are numbered
    #: behind the flat faces, as in `flat_path`.
    walls: dict[int, int]
    distance_mm: float
    #: What the walls are.
    surface: Surface
    #: What the walls enclose, their open ends being planes too; and the crystal.
    within: Solid
    crystal: Solid


#: Films by geometry, and by what the surfaces are to them: benches that follow each other often
#: differ in other things alone.
_known_films = Kept[WrappingFilm | None](64)


def film_before(model: SceneModel, crystal: Solid) -> WrappingFilm | None:
    """The film around a crystal, or None where there is none, or light must go from face to face.

    - Faces are polished interfaces with the outside, each alone in its plane, and walls before them
      likewise; what else happens to light from inside is decided before it crosses them.
    - Walls stand in the outside, are all alike and equally far away, and are whole sides of what
      they enclose; a round one has the axis of the crystal's.
    - Nothing else stands in there.
    """
    numbers = {face.surface for face in model.flat_faces if _is_wall(model, face.surface)}
    numbers |= {wall.surface for wall in model.walls if _is_wall(model, wall.surface)}
    surfaces = {model.surfaces[number] for number in numbers}
    if len({replace(surface, name="") for surface in surfaces}) != 1:
        return None
    plain = tuple(_is_plain(surface, crystal.volume) for surface in model.surfaces)
    key = model.geometry, crystal.volume, frozenset(numbers), plain
    film = _known_films.of(key, lambda: _find_film(model, crystal, surfaces.pop()))
    return film and replace(film, surface=model.surfaces[min(numbers)])


def _find_film(model: SceneModel, crystal: Solid, surface: Surface) -> WrappingFilm | None:
    """See `film_before`; the walls are all of one surface."""
    faces, slack = model.flat_faces, slack_of(model)
    own = {number for plane in crystal.planes for number in plane.faces}
    walls = [number for number, face in enumerate(faces) if _is_wall(model, face.surface)]
    mantles = [wall for wall in model.walls if _is_wall(model, wall.surface)]
    rims = [faces[number].corners for number in (*walls, *own)]
    rims += [wall.circle.points(end) for wall in mantles for end in (wall.low_mm, wall.high_mm)]
    low, high = np.concatenate(rims).min(axis=0) + slack, np.concatenate(rims).max(axis=0) - slack
    for number, face in enumerate(faces):
        beside = (face.corners.max(axis=0) <= low) | (face.corners.min(axis=0) >= high)
        if number not in own and number not in walls and not beside.any():
            return None
    if crystal.circle is None:
        within = None if mantles else _enclosed_by(model, walls)
    else:
        within = _enclosed_round(model, crystal, walls, mantles)
    if within is None:
        return None
    pairs: dict[int, int] = {}
    distances: list[float] = []
    for plane in crystal.planes:
        (number, *others) = plane.faces
        if others or not _is_plain(model.surfaces[faces[number].surface], crystal.volume):
            continue
        outwards, before = faces[number].normal, []
        for wall in walls:
            away = (faces[wall].corners - faces[number].corner) @ outwards
            if -outwards @ faces[wall].normal >= _PARALLEL and away.min() > slack:
                before.append((wall, float(away.mean())))
        if len(before) == 1:
            pairs[number] = before[0][0]
            distances.append(before[0][1])
    for number in crystal.walls if mantles else ():
        if _is_plain(model.surfaces[model.walls[number].surface], crystal.volume):
            pairs[len(faces) + number] = len(faces) + model.walls.index(mantles[0])
            distances.append(mantles[0].circle.radius_mm - model.walls[number].circle.radius_mm)
    if not pairs or np.ptp(distances) > slack or distances[0] <= slack:
        return None
    return WrappingFilm(pairs, distances[0], surface, within, crystal)


def _is_wall(model: SceneModel, surface: int) -> bool:
    """Whether a surface is a reflector that stands in the outside."""
    wall = model.surfaces[surface]
    return wall.kind == DIFFUSE and wall.sides == (OUTSIDE, OUTSIDE)


def _is_plain(surface: Surface, crystal: int) -> bool:
    """Whether light crosses a face of the crystal to the outside, and back, by Fresnel alone."""
    loses = surface.roughness or surface.haze or surface.surface_loss or surface.ground_loss
    masked = surface.painted or surface.aperture_radius_mm < np.inf
    is_interface = surface.kind == DIELECTRIC and surface.sides == (crystal, OUTSIDE)
    return is_interface and not loses and not masked


def _enclosed_round(
    model: SceneModel, crystal: Solid, walls: list[int], mantles: list[RoundWall]
) -> Solid | None:
    """What a round wall and a lid enclose, or one of them, around a crystal that stands upright."""
    slack, circle = slack_of(model), crystal.circle
    assert circle is not None
    discs = [model.flat_faces[number].circle for number in walls]
    around = [*(wall.circle for wall in mantles), *(disc for disc in discs if disc is not None)]
    if circle.axis != 2 or len(mantles) > 1 or len(walls) > 1 or None in discs:
        return None
    off = [np.subtract(other.centre_mm, circle.centre_mm) for other in around]
    radii = [other.radius_mm for other in around]
    inside = all(other.inside and other.axis == 2 for other in around)
    if not inside or np.abs(off).max() > slack or np.ptp(radii) > slack:
        return None
    levels = [plane.offset for plane in crystal.planes]
    levels += [end for wall in mantles for end in (wall.low_mm, wall.high_mm)]
    low = mantles[0].low_mm if mantles else min(levels)
    up = (0.0, 0.0, 1.0)
    ends = (Plane(up, True, max(levels) + slack, []), Plane(up, False, low - slack, []))
    return Solid(OUTSIDE, ends, (), circle=replace(around[0], radius_mm=radii[0] + slack))


def _enclosed_by(model: SceneModel, walls: list[int]) -> Solid | None:
    """What flat walls enclose, if they are whole sides of it."""
    faces, slack = model.flat_faces, slack_of(model)
    if any(faces[number].circle is not None for number in walls):
        return None
    corners = np.concatenate([faces[number].corners for number in walls])
    if np.linalg.matrix_rank(corners - corners[0], tol=slack) < 3:
        return None
    from scipy.spatial import ConvexHull  # slow, and most scenes need none

    hull = ConvexHull(corners)
    sides: dict[tuple[float, ...], float] = {}
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    for area, equation in zip(areas.tolist(), np.round(hull.equations, 6) + 0.0, strict=True):
        side = tuple(equation.tolist())
        sides[side] = sides.get(side, 0.0) + area
    covered = dict.fromkeys(sides, 0.0)
    for number in walls:
        face = faces[number]
        beyond = {s: np.abs(face.corners @ s[:3] + s[3]).max() for s in sides}
        nearest = min(beyond, key=beyond.__getitem__)
        if beyond[nearest] > 10.0 * slack:
            return None
        covered[nearest] += face.area
    if any(area and abs(sides[side] - area) > 1e-3 * area for side, area in covered.items()):
        return None
    bounds = []
    for *normal, level in sides:
        largest = max(map(abs, normal))
        axis = tuple(value / largest + 0.0 for value in normal)
        bounds.append(Plane(axis, True, -level / largest + slack, []))
    return Solid(OUTSIDE, tuple(bounds), ())


class FilmTrips:
    """The film before a wrapping, in the kernel."""

    def __init__(self, model: SceneModel, film: WrappingFilm) -> None:
        slack, crystal = slack_of(model), film.crystal
        wider = [
            replace(plane, offset=plane.offset + (slack if plane.high else -slack))
            for plane in crystal.planes
        ]
        circle, self._discs = crystal.circle, None
        if circle is not None:
            circle = replace(circle, radius_mm=circle.radius_mm + slack)
        self._on_wall = film.within.test()
        self._on_face = replace(crystal, planes=tuple(wider), circle=circle).test()
        self._crystal, self._walls = crystal.volume, film.walls
        self._round = [n for n in film.walls if n >= len(model.flat_faces)]
        if self._round:
            assert crystal.circle is not None
            outer = replace(crystal.circle, radius_mm=crystal.circle.radius_mm + film.distance_mm)
            circles = crystal.circle, outer
            self._discs = [Disc(of, lambda value: opaque([value])) for of in circles]
        self._distance = opaque([film.distance_mm])
        self._reflectance = opaque([film.surface.reflectance])
        self._mirrored = opaque([film.surface.reflectance * film.surface.mirror_part])

    def go(self, light: Encounter, outcome: Outcome, face, rng, active) -> None:
        """Take light that leaves by a face (UInt32) to the wall before it and back.

        It has no use yet for the even numbers of a diffuse direction; `rng` gives two more.
        """
        row, volume, leaving = light.row, outcome.volume, outcome.direction
        outwards = at_wall = row.normal
        chance, choice = rng.next_float32(), rng.next_float32()
        goes = active & outcome.crossed & (outcome.fate == ALIVE) & (volume == OUTSIDE)
        goes &= is_any(face, [*self._walls])
        there = self._distance / dr.dot(leaving, outwards)
        if self._discs is not None:
            inner, outer = self._discs
            is_round = is_any(face, self._round)
            there = dr.select(is_round, outer.crossings(Ray(outcome.position, leaving))[0], there)
        wall = dr.fma(leaving, there, outcome.position)
        goes &= self._on_wall(wall)
        kept = goes & (chance < self._reflectance)
        outcome.fate = dr.select(goes & ~kept, mi.UInt32(REFLECTOR), outcome.fate)
        # a flat wall is parallel to the face: what is diffuse at one is so at the other
        diffuse, _ = light.lambertian()
        if self._discs is not None:
            at_wall = dr.select(is_round, outer.outwards(wall), outwards)
            diffuse = light.diffuse_about(-at_wall)
        mirrored = dr.fma(at_wall, -2.0 * dr.dot(leaving, at_wall), leaving)
        flying = dr.select(chance < self._mirrored, mirrored, diffuse)
        cosine = -dr.dot(flying, outwards)
        back = self._distance / cosine
        if self._discs is not None:
            back = dr.select(is_round, inner.crossings(Ray(wall, flying))[1], back)
        place = dr.fma(flying, back, wall)
        returns = kept & (back < dr.inf) & self._on_face(place)
        if self._discs is not None:
            outwards = dr.select(is_round, inner.outwards(place), outwards)
            cosine = -dr.dot(flying, outwards)
        ratio = dr.rcp(row.eta)
        entering, _, stays = dielectric.split(flying, None, outwards, ratio, cosine, choice)
        outcome.direction = dr.select(kept, dr.select(returns, entering, flying), leaving)
        outcome.position = dr.select(kept, dr.select(returns, place, wall), outcome.position)
        outcome.volume = dr.select(returns & ~stays, mi.UInt32(self._crystal), volume)
        outcome.face = mi.UInt32(face)
        for number, opposite in self._walls.items():
            passes = kept & ~returns & (face == number)
            outcome.face = dr.select(passes, mi.UInt32(opposite), outcome.face)
        outcome.from_reflector = outcome.from_reflector | kept
        outcome.in_film = dr.select(goes, there, 0.0) + dr.select(returns, back, 0.0)
