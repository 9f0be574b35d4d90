"""One photon's walk over the faces of a bench, compiled: free path, nearest face, what is there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.reference.compiling import compiled
from mcrim_mitsuba.reference.interface import (
    about,
    across_incidence,
    cross_rough,
    depolarised,
    dot,
    exponential,
    field_of,
    film_waves,
    followed,
    isotropic,
    lambertian,
    normal,
    plus,
    random_polarisation,
    scattered_cosine,
    seed_photon,
    square,
    times,
    uniform,
    unit,
    vector_product,
)

# Fates; from ABSORBED on, absorption in the volumes by their numbers.
DETECTED = 0
APERTURE = 1
REFLECTOR = 2
SURFACE = 3
ESCAPED = 4
TRUNCATED = 5
LOST = 6
ABSORBED = 7
_ALIVE = -1
#: Their names.
FATES = (
    *("detected", "absorbed_aperture", "absorbed_reflector", "absorbed_surface"),
    *("escaped", "truncated", "lost"),
)
#: What light meets at a surface.
DIELECTRIC = 0
DETECTOR = 1
REFLECTS = 2
METAL = 3
#: Forms of faces.
FLAT = 0
ROUND = 1
#: The volume that is around everything.
OUTSIDE = 0
#: How far, in mm, rounding may put light beyond a face that it has not met yet.
_BEYOND_MM = 1e-9
#: How far off its edges, in mm, a face is still met: no light slips through between two.
_OVERLAP_MM = 1e-10


def _fields(whole: str, real: str, others: Sequence[tuple[str, str]] = ()) -> np.dtype:
    """A row of whole and of real numbers."""
    numbers = [(name, "i8") for name in whole.split()] + [(name, "f8") for name in real.split()]
    return np.dtype([*numbers, *others])


#: A surface: what the faces of a shape have in common. `n_interior` is a detector's glass, too;
#: the axis is that of the mask (radius infinite: none) or of a detector; a reflector mirrors its
#: part `specular` and is diffuse else, a detector first reflects diffusely, then as a metal.
#: Contact is a wrapping's: how often light from inside, or from both sides of paint, finds no
#: film, from a z on. Heights are over the wavelength, as a film's thickness (0: none).
SURFACE_FIELDS = _fields(
    "kind interior exterior two_sided paint beckmann",
    "n_interior n_exterior mask_radius axis_x axis_y mask_reflectance reflectance specular "
    "contact contact_z roughness heights surface_loss ground_loss "
    "angular_falloff radial_falloff least_cosine film_wavelengths",
    [("film_index", "c16")],
)
#: A volume; coefficients per mm. Of light that is born in it the scattering goes with a power, the
#: `exponent`, of the wavelength, whose band has a full width over the wavelength.
VOLUME_FIELDS = _fields(
    "rayleigh endless", "scattering absorption gradient low high g index exponent bandwidth"
)
#: Where light is born: within a box as far as it is in a volume, evenly (depth infinite) or falling
#: off from one end of an axis; as a beam along it, on a disc before the middle of the box.
BIRTH_FIELDS = _fields("volume axis from_high", "x0 y0 z0 x1 y1 z1 depth beam_radius")
#: A face: its unit normal and the product of this with any point of a flat one's plane; the quadric
#: of a round one, or of a hole (`circle` -1) in a flat one, or of what is left of it (+1); of round
#: ones +1 if normals point outwards. Rows of `Tables.half_spaces`, of `surfaces`, and of the latter
#: for the wrapping that touches it, or -1.
FACE_FIELDS = _fields("form circle begin end surface wrapping", "x y z level")
#: What a photon went through: scatterings in the crystal, the path there, and that weighted with
#: the scattering's strength over that at middle height, at the band's maximum (equal where all is
#: even); the largest distance from the axis at which it met the mask's plane, from either side; of
#: its arrival at a detector the surface, the cosine to the normal (in the plate; behind a beam in
#: air), and the distance from the axis.
HISTORY = _fields(
    "fate scatterings surface",
    "path_cm scattering_path_cm mask_radius_mm arrival_cosine arrival_radius_mm",
)


class Tables(NamedTuple):
    """A bench as arrays."""

    #: (faces,) of `FACE_FIELDS`.
    faces: NDArray
    #: (faces, 12): A, row by row, and c of the quadric ``|A (x - c)| = 1``.
    quadrics: NDArray[np.float64]
    #: (half spaces, 4): unit vector u and number m; a face is where u . x <= m of all its bounds.
    half_spaces: NDArray[np.float64]
    #: (surfaces,) of `SURFACE_FIELDS`.
    surfaces: NDArray
    #: (volumes,) of `VOLUME_FIELDS`.
    volumes: NDArray
    #: (volumes + 1,): where faces of a volume begin in the next two.
    first: NDArray[np.int64]
    #: Their numbers, and +1 where the volume is behind the face, -1 where in front, 0: on both.
    bordering: NDArray[np.int64]
    side: NDArray[np.int64]


# Geometry.


@compiled
def _bounded(tables, number, point):
    """Whether a point of a face's plane or quadric is on the face."""
    face, spaces = tables.faces[number], tables.half_spaces
    for k in range(face["begin"], face["end"]):
        u = (spaces[k, 0], spaces[k, 1], spaces[k, 2])
        if dot(u, point) - spaces[k, 3] > _OVERLAP_MM:
            return False
    if face["form"] == FLAT and face["circle"] != 0:
        w = _in_quadric(tables, number, point, 1.0)
        return (dot(w, w) - 1.0) * face["circle"] <= _OVERLAP_MM
    return True


@compiled
def _in_quadric(tables, number, vector, moved):
    """A (x - c) of a point, or A x of a direction where `moved` is 0."""
    q, k = tables.quadrics, number
    x, y, z = plus(vector, -moved, (q[k, 9], q[k, 10], q[k, 11]))
    return (
        q[k, 0] * x + q[k, 1] * y + q[k, 2] * z,
        q[k, 3] * x + q[k, 4] * y + q[k, 5] * z,
        q[k, 6] * x + q[k, 7] * y + q[k, 8] * z,
    )


@compiled
def _distance(tables, number, position, direction, side, on_it, limit):
    """Distance, mm, to where light meets a face; `limit` where it does not, or not before that.

    `side` is +1 where it comes from behind the face, -1 from in front of it, 0 from either; it may
    have its last event `on_it`.
    """
    face = tables.faces[number]
    if face["form"] == FLAT:
        normal = (face["x"], face["y"], face["z"])
        speed = dot(normal, direction)
        if side * speed < 0.0 or speed == 0.0 or (side == 0 and on_it):
            return limit
        t = (face["level"] - dot(normal, position)) / speed
        if -_BEYOND_MM < t < limit and _bounded(tables, number, plus(position, t, direction)):
            return max(t, 0.0)
        return limit
    w = _in_quadric(tables, number, position, 1.0)
    v = _in_quadric(tables, number, direction, 0.0)
    a, b, c = dot(v, v), dot(w, v), dot(w, w) - 1.0
    if on_it:
        c = 0.0
    root = b * b - a * c
    if root <= 0.0 or a == 0.0:
        return limit
    root, within = math.sqrt(root), side * face["circle"]
    least = _BEYOND_MM if within == 0 else -_BEYOND_MM
    # into it, then out of it; light around it that is on it flies away
    for sign in (-1, 1):
        if sign * within < 0 or (sign < 0 and within < 0 and on_it):
            continue
        t = (sign * root - b) / a
        if least < t < limit and _bounded(tables, number, plus(position, t, direction)):
            return max(t, 0.0)
    return limit


@compiled
def _nearest(tables, volume, position, direction, last):
    """How far the face is that light in a volume meets first, mm, and which it is, or -1."""
    nearest, face = math.inf, -1
    for k in range(tables.first[volume], tables.first[volume + 1]):
        i, side = tables.bordering[k], tables.side[k]
        t = _distance(tables, i, position, direction, side, i == last, nearest)
        if t < nearest:
            nearest, face = t, i
    return nearest, face


@compiled
def _encloses(tables, volume, point):
    """Whether a point lies in a volume: by how often a line from it leaves and enters it."""
    direction, count = (0.2672612, 0.5345225, 0.8017837), 0
    for k in range(tables.first[volume], tables.first[volume + 1]):
        i, inside = tables.bordering[k], tables.side[k]
        for side in (inside, -inside):
            if _distance(tables, i, point, direction, side, False, math.inf) < math.inf:
                count += side * inside
    return count > 0


@compiled
def _normal(tables, number, point):
    """Unit normal of a face at a point of it."""
    face, q, k = tables.faces[number], tables.quadrics, number
    if face["form"] == FLAT:
        return face["x"], face["y"], face["z"]
    w = _in_quadric(tables, number, point, 1.0)
    outwards = (
        q[k, 0] * w[0] + q[k, 3] * w[1] + q[k, 6] * w[2],
        q[k, 1] * w[0] + q[k, 4] * w[1] + q[k, 7] * w[2],
        q[k, 2] * w[0] + q[k, 5] * w[1] + q[k, 8] * w[2],
    )
    return times(float(face["circle"]), unit(outwards))


# Births.


@compiled
def _with(a, axis, value):
    """A vector with another component along an axis."""
    return (
        value if axis == 0 else a[0],
        value if axis == 1 else a[1],
        value if axis == 2 else a[2],
    )


@compiled
def _box(birth):
    """Lowest and highest coordinates of births."""
    return (birth["x0"], birth["y0"], birth["z0"]), (birth["x1"], birth["y1"], birth["z1"])


@compiled
def _birth(tables, birth, rng):
    """Where light is born, and its direction."""
    (low, high), axis = _box(birth), birth["axis"]
    if birth["beam_radius"] > 0.0:
        radius = birth["beam_radius"] * math.sqrt(uniform(rng))
        azimuth = 2.0 * math.pi * uniform(rng)
        nowhere = (0.0, 0.0, 0.0)
        # before the crystal
        begin = times(0.5, (low[0] + high[0], low[1] + high[1], low[2] + high[2]))
        begin = plus(begin, radius * math.cos(azimuth), _with(nowhere, (axis + 1) % 3, 1.0))
        begin = plus(begin, radius * math.sin(azimuth), _with(nowhere, (axis + 2) % 3, 1.0))
        return _with(begin, axis, low[axis] - 1.0), _with(nowhere, axis, 1.0)
    while True:
        share = (uniform(rng), uniform(rng), uniform(rng))
        if birth["depth"] < math.inf:
            length = high[axis] - low[axis]
            # the inverse of the distribution function of depths
            rest = math.expm1(-length / birth["depth"])
            depth = -birth["depth"] * math.log1p(share[axis] * rest) / length
            share = _with(share, axis, 1.0 - depth if birth["from_high"] else depth)
        point = (
            low[0] + share[0] * (high[0] - low[0]),
            low[1] + share[1] * (high[1] - low[1]),
            low[2] + share[2] * (high[2] - low[2]),
        )
        if _encloses(tables, birth["volume"], point):
            return point, isotropic(rng)


@compiled
def _strength_of_birth(volume, rng):
    """Scattering of a photon over that at the band's maximum: its wavelength decides."""
    if volume["exponent"] == 0.0:
        return 1.0
    sigma, cut = volume["bandwidth"] / math.sqrt(8.0 * math.log(2.0)), 1.5 * volume["bandwidth"]
    while True:
        away = sigma * normal(rng)
        if abs(away) <= cut:
            return (1.0 + away) ** -volume["exponent"]


@compiled
def _strength_at(volume, position):
    """Scattering over that at middle height."""
    if volume["gradient"] == 0.0:
        return 1.0
    u = (2.0 * position[2] - volume["low"] - volume["high"]) / (volume["high"] - volume["low"])
    return max(0.0, 1.0 + volume["gradient"] * u)


# What happens at a face: the rules give fate, direction, field, and whether light has crossed it.


@compiled
def _reflector(rng, surface, direction, facing, field):
    """Reflect light, which comes from where `facing` points to, or absorb it."""
    choice = uniform(rng)
    if choice >= surface["reflectance"]:
        return SURFACE if surface["kind"] == METAL else REFLECTOR, direction, field
    if choice < surface["reflectance"] * surface["specular"]:
        way = unit(plus(direction, -2.0 * dot(direction, facing), facing))
        # as a perfect metal does
        return _ALIVE, way, plus(times(-1.0 + 0j, field), 2.0 * dot(field, facing), facing)
    way = lambertian(rng, facing)
    return _ALIVE, way, depolarised(rng, field, way)


@compiled
def _detector(rng, surface, radius, direction, facing, field):
    """Send light back, diffusely, then as a mirror, or refuse it, or detect it."""
    if uniform(rng) < surface["reflectance"]:
        way = lambertian(rng, facing)
        return _ALIVE, way, depolarised(rng, field, way)
    cosine = min(1.0, max(1e-9, -dot(direction, facing)))
    # a perfect metal, unpolarised light
    r_s, r_p, t_s, t_p = -1.0 + 0j, 1.0 + 0j, 0.0, 0.0
    e_s, e_p, s = complex(math.sqrt(0.5)), complex(math.sqrt(0.5)), facing
    if followed(field):
        s = across_incidence(direction, facing)
        e_s, e_p = dot(field, s), dot(field, vector_product(s, direction))
    mirror, lost = surface["specular"], 0.0
    if surface["film_wavelengths"] > 0.0:
        film = surface["film_index"], surface["n_interior"], surface["film_wavelengths"]
        r_s, r_p, t_s, t_p = film_waves(film[0], film[1], film[2], cosine)
        mirror = square(r_s * e_s) + square(r_p * e_p)
        lost = square(e_s) * t_s + square(e_p) * t_p
    choice = uniform(rng)
    if choice < mirror:
        way = unit(plus(direction, 2.0 * cosine, facing))
        return _ALIVE, way, field_of(r_s * e_s, r_p * e_p, s, way) if followed(field) else field
    if choice < mirror + lost or cosine < surface["least_cosine"]:
        return SURFACE, direction, field
    falloff = surface["angular_falloff"]
    accepted = min(1.0, max(0.0, (1.0 - falloff * (1.0 - cosine)) / (1.0 - min(falloff, 0.0))))
    accepted *= max(0.0, 1.0 - surface["radial_falloff"] * radius * radius)
    return DETECTED if uniform(rng) < accepted else SURFACE, direction, field


@compiled
def _touches(rng, tables, face, position, leaving):
    """Whether light at a dielectric finds a wrapping, or paint, and no interface."""
    number = tables.faces[face]["wrapping"]
    if number < 0:
        return False
    wrapping = tables.surfaces[number]
    if not (leaving or wrapping["paint"]) or position[2] < wrapping["contact_z"]:
        return False
    return wrapping["contact"] > 0.0 and uniform(rng) < wrapping["contact"]


@compiled
def _indices(tables, surface, volume, leaving):
    """Indices before and behind a dielectric.

    Light of the liquid that is in no place of its own, or of the air in its place, meets faces as
    if these named the volume that it is in.
    """
    inner, outer = surface["n_interior"], surface["n_exterior"]
    n_in, n_out = (inner, outer) if leaving else (outer, inner)
    named = surface["interior"] if leaving else surface["exterior"]
    if named != volume:
        n_in = tables.volumes[volume]["index"]
    return n_in, n_out


# The walk.


@compiled
def _arrival_radius(birth, position, radius):
    """How far from the detector's axis light arrives (mm), or from that of its beam."""
    if birth["beam_radius"] == 0.0:
        return radius
    low, high = _box(birth)
    away = _with(plus(position, -0.5, plus(low, 1.0, high)), birth["axis"], 0.0)
    return math.sqrt(dot(away, away))


@compiled
def _walk(tables, birth, rng, most_flights, polarised, record):
    """Follow a photon to its fate; what it goes through is added to a `HISTORY` of zeros."""
    position, direction = _birth(tables, birth, rng)
    crystal, field = birth["volume"], (0j, 0j, 0j)
    volume = crystal if birth["beam_radius"] == 0.0 else OUTSIDE
    if polarised:
        field = random_polarisation(rng, direction)
    strength = _strength_of_birth(tables.volumes[crystal], rng)
    last, flights = -1, 0
    while flights < most_flights:
        medium = tables.volumes[volume]
        distance, face = _nearest(tables, volume, position, direction, last)
        scattering = medium["scattering"] * (strength if volume == crystal else 1.0)
        most = scattering * (1.0 + abs(medium["gradient"])) + medium["absorption"]
        free_path = exponential(rng) / most if most > 0.0 else math.inf
        if free_path == math.inf and face < 0:
            return ESCAPED if volume == OUTSIDE or medium["endless"] > 0 else LOST
        flight = min(free_path, distance)
        if volume == crystal:
            middle = _strength_at(medium, plus(position, 0.5 * flight, direction))
            record["path_cm"] += flight / MM_PER_CM
            record["scattering_path_cm"] += flight / MM_PER_CM * strength * middle
        position = plus(position, flight, direction)
        if free_path < distance:
            choice, last = uniform(rng) * most - medium["absorption"], -1
            if choice < 0.0:
                return ABSORBED + volume
            # with a gradient, most collisions of the strongest scattering are none
            if choice < scattering * _strength_at(medium, position):
                flights += 1
                record["scatterings"] += volume == crystal
                cosine = scattered_cosine(rng, medium["rayleigh"] > 0, medium["g"])
                direction = about(rng, direction, cosine)
                field = depolarised(rng, field, direction)
            continue
        flights += 1
        number, last = tables.faces[face]["surface"], face
        surface, axis = tables.surfaces[number], _normal(tables, face, position)
        leaving, fate, crossed = dot(direction, axis) > 0.0, _ALIVE, False
        facing = times(-1.0, axis) if leaving else axis
        radius = math.hypot(position[0] - surface["axis_x"], position[1] - surface["axis_y"])
        if surface["mask_radius"] < math.inf:
            record["mask_radius_mm"] = max(record["mask_radius_mm"], radius)
        if radius > surface["mask_radius"]:
            if direction[2] >= 0.0 or uniform(rng) >= surface["mask_reflectance"]:
                return APERTURE
            direction = lambertian(rng, facing)
            field = depolarised(rng, field, direction)
        elif surface["kind"] == DETECTOR:
            record["surface"], record["arrival_cosine"] = number, abs(dot(direction, axis))
            record["arrival_radius_mm"] = _arrival_radius(birth, position, radius)
            fate, direction, field = _detector(rng, surface, radius, direction, facing, field)
        elif surface["kind"] >= REFLECTS:
            if leaving and surface["two_sided"] == 0:
                return REFLECTOR
            fate, direction, field = _reflector(rng, surface, direction, facing, field)
        elif leaving and surface["roughness"] > 0.0 and uniform(rng) < surface["ground_loss"]:
            return SURFACE
        elif _touches(rng, tables, face, position, leaving):
            wrapping = tables.surfaces[tables.faces[face]["wrapping"]]
            fate, direction, field = _reflector(rng, wrapping, direction, facing, field)
        else:
            n_in, n_out = _indices(tables, surface, volume, leaving)
            ahead, slopes = times(-1.0, facing), surface["beckmann"] > 0
            heights, alpha = surface["heights"], surface["roughness"]
            direction, crossed, field = cross_rough(
                rng, direction, ahead, n_in, n_out, field, heights, alpha, slopes
            )
            if leaving and not crossed and uniform(rng) < surface["surface_loss"]:
                return SURFACE
        if fate != _ALIVE:
            return fate
        if crossed:
            volume = surface["exterior"] if leaving else surface["interior"]
        elif medium["endless"] > 0:
            return ESCAPED  # it is in the liquid for ever
    return TRUNCATED


@compiled
def follow(tables, birth, rng, seed, number, most_flights, polarised, records):
    """Follow photons from a `number` on: fill a `HISTORY` of zeros for each."""
    for i in range(len(records)):
        seed_photon(rng, seed, number + np.uint64(i))
        records[i]["fate"] = _walk(tables, birth[0], rng, most_flights, polarised, records[i])
