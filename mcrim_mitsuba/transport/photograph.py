"""Photographs bodies in a studio of Mitsuba's: a white floor, a soft sky and two soft boxes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import uniform_filter

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import signals_wait
from mcrim_mitsuba.transport.bulk import GENERATORS, HASH_ROUNDS, seed_words
from mcrim_mitsuba.transport.conversion import opaque, opaque_vector
from mcrim_mitsuba.transport.photograph_parts import (
    GLASS,
    GLOSSY,
    MATTE,
    METAL,
    Body,
    Camera,
    Finish,
    Triangles,
)
from mcrim_mitsuba.transport.scene_model import SceneModel

#: Steps along each of the two coordinates of a curved surface.
STEPS = 96


def surface_triangles(model: SceneModel) -> tuple[Triangles, ...]:
    """The triangles of every surface, in the order of ``model.surfaces``.

    Raises InputError for a curved shape of which Mitsuba knows no points.
    """
    flat: dict[int, list[np.ndarray]] = {}
    round_ones = {face.surface for face in model.flat_faces if face.circle is not None}
    for face in model.flat_faces:
        if face.surface in round_ones:
            continue
        around = face.corners
        fan = [around[[0, i, i + 1]] for i in range(1, len(around) - 1)]
        flat.setdefault(face.surface, []).extend(fan)
    mantles = {wall.surface: wall for wall in model.walls if wall.outwards}
    surfaces = []
    for number, shape in enumerate(model.shapes):
        triangles = Triangles(np.array(flat[number])) if number in flat else _curved(shape)
        if shape.is_mesh() and number in mantles:
            circle, corners = mantles[number].circle, triangles.corners
            normals = np.zeros_like(corners)
            normals[..., circle.across] = corners[..., circle.across] - circle.centre_mm
            normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
            triangles = _orderly(corners, normals)
        surfaces.append(triangles)
    return tuple(surfaces)


def _curved(shape) -> Triangles:
    """The triangles of a shape that is no set of few flat faces."""
    if shape.is_mesh():
        parameters = mi.traverse(shape)
        indices = np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3)
        corners = np.array(parameters["vertex_positions"], dtype=float).reshape(-1, 3)[indices]
        return _orderly(corners[:, ::-1] if shape.has_flipped_normals() else corners, None)
    u = np.linspace(0.0, 1.0, STEPS + 1)
    # closer towards the ends, which are the poles of a sphere
    v = (1.0 - np.cos(np.pi * u)) / 2
    grid_u, grid_v = (g.ravel() for g in np.meshgrid(u, v, indexing="ij"))
    try:
        samples = shape.sample_position(0.0, mi.Point2f(grid_u.tolist(), grid_v.tolist()))
        points = np.array(samples.p, dtype=float).T.reshape(STEPS + 1, STEPS + 1, 3)
    except (RuntimeError, ValueError) as error:
        raise InputError(
            f"{shape.id()}: no picture can be made of a {shape.class_name()} "
            f"({str(error).splitlines()[0]})",
            "write the shape as a mesh",
        ) from None
    normals = np.broadcast_to(np.array(samples.n, dtype=float), (3, grid_u.size))

    def halves(grid):
        a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
        both = [np.stack(three, axis=2).reshape(-1, 3, 3) for three in ((a, b, c), (a, c, d))]
        return np.concatenate(both)

    return _orderly(halves(points), halves(normals.T.reshape(points.shape)))


def _orderly(corners, normals) -> Triangles:
    """Without triangles of no area, and all anticlockwise about their normals."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    kept = area > 1e-9 * area.max()
    corners, across = corners[kept], across[kept]
    if normals is None:
        return Triangles(corners)
    normals = normals[kept]
    turned = (across * normals.sum(axis=1)).sum(axis=1) < 0
    corners[turned], normals[turned] = corners[turned, ::-1], normals[turned, ::-1]
    return Triangles(corners, normals)


#: Reflectance of the floor.
FLOOR = 0.75
#: Interfaces that light meets before it is given up.
DEEPEST = 24
#: Paths that carry less than this part of the light end.
DARKEST = 0.01
#: Light paths that run together: pixels times samples.
MOST_LANES = 2_000_000
#: Where the light comes from that gives matte bodies their shading.
_KEY = (-0.64, -0.48, 0.6)
#: Radiance that an empty floor sends to all sides: the mean of the lighting sky over the cosine.
_FLOOR_RADIANCE = FLOOR * (1.0 + 0.5 * _KEY[2] * 2.0 / 3.0)
#: Pixels between the taps of the smoothing.
_STEPS = (1, 2, 4)
#: Weights of the taps: a cubic spline.
_SPLINE = (0.375, 0.25, 0.0625)
#: Squares of differences that count as noise, over the noise of the two pixels.
_TOLERANCE = 6.0
#: Ratios of indices closer to 1 than this do not refract.
_ALIKE = 1e-4


def photograph(
    bodies: Sequence[Body],
    camera: Camera,
    floor_z_mm: float,
    *,
    samples: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """What the camera sees, in units of what an empty floor sends to it.

    Parameters
    ----------
    floor_z_mm : float
        Height of the floor, which must lie below all bodies.
    samples : int
        Light paths per pixel.
    progress : callable, optional
        ``progress(done, total)`` in samples per pixel.

    Returns
    -------
    ndarray of float32, shape (height, width, 3)
        Linear red, green and blue. The same seed gives the same numbers.
    """
    scene = _studio(bodies, camera, floor_z_mm)
    pixels = camera.width * camera.height
    at_once = max(1, min(samples, MOST_LANES // pixels))
    total, squares, done = np.zeros((3, pixels)), np.zeros(pixels), 0
    while done < samples:
        now = min(at_once, samples - done)
        light = _light(scene, camera, opaque([done], mi.UInt32), now, seed)
        # sums of neighbours in a fixed order: the same seed gives the same picture
        total += np.array([np.array(dr.block_sum(part, now), dtype=float) for part in light])
        squares += np.array(dr.block_sum(dr.square(_grey(light)), now), dtype=float)
        done += now
        if progress is not None:
            progress(done, samples)
    mean = total / samples
    variance = (squares / samples - np.array(_grey(mean)) ** 2) / samples
    guide = _what_is_seen(scene, camera)
    smooth = _smoothed(mean, np.maximum(variance, 0.0), guide, camera)
    return (smooth / _FLOOR_RADIANCE).T.reshape(camera.height, camera.width, 3).astype(np.float32)


def _grey(light):
    return (light[0] + light[1] + light[2]) / 3.0


def _what_is_seen(scene, camera: Camera):
    """A number (UInt32) for every pixel that tells which flat face lies in its middle."""
    pixel = dr.arange(mi.UInt32, camera.width * camera.height)
    si = scene.ray_intersect(_rays(camera, pixel, mi.Point2f(0.5)), mi.RayFlags.Minimal, False)
    word = dr.reinterpret_array(mi.UInt32, si.shape)
    for part in si.n:
        word = 31 * word + mi.UInt32(mi.Int32(dr.round(8.0 * part)) + 8)
    return dr.select(si.is_valid(), word, 0)


def _smoothed(mean: np.ndarray, variance: np.ndarray, guide, camera: Camera) -> np.ndarray:
    """Noise taken out, edges kept: an a-trous filter that knows the noise of every pixel.

    Pixels of the same face that differ by no more than their noise are averaged (H. Dammertz et
    al., HPG 2010; C. Schied et al., HPG 2017). Shapes (3, pixels) and (pixels,).
    """
    variance = uniform_filter(variance.reshape(camera.height, camera.width), 5).ravel()
    light = mi.Color3f(mean.astype(np.float32))
    noise = mi.Float(variance.astype(np.float32))
    pixel = dr.arange(mi.UInt32, len(variance))
    wide, high = (opaque([side], mi.Int32) for side in (camera.width, camera.height))
    x, y = mi.Int32(pixel) % wide, mi.Int32(pixel) // wide
    for step in (opaque([step], mi.Int32) for step in _STEPS):
        total, weights, noises = mi.Color3f(0.0), mi.Float(0.0), mi.Float(0.0)
        for dy, dx in itertools.product(range(-2, 3), repeat=2):
            at_x, at_y = x + dx * step, y + dy * step
            there = (at_x >= 0) & (at_x < wide) & (at_y >= 0) & (at_y < high)
            index = mi.UInt32(at_y * wide + at_x)
            there &= dr.gather(mi.UInt32, guide, index, there) == guide
            other = dr.gather(mi.Color3f, light, index, there)
            other_noise = dr.gather(mi.Float, noise, index, there)
            tolerance = _TOLERANCE * (noise + other_noise) + 1e-7
            difference = dr.squared_norm(other - light) / tolerance
            weight = _SPLINE[abs(dy)] * _SPLINE[abs(dx)] * dr.exp(-difference)
            weight = dr.select(there, weight, 0.0)
            total += weight * other
            weights += weight
            noises += dr.square(weight) * other_noise
        light, noise = total / weights, noises / dr.square(weights)
        dr.eval(light, noise)
    return np.array(light, dtype=float)


@signals_wait()
def _light(scene, camera: Camera, first, samples: int, seed: int):
    """What light paths from all pixels bring (Color3f), the samples of a pixel side by side."""
    lanes = camera.width * camera.height * samples
    lane, per_pixel = dr.arange(mi.UInt32, lanes), opaque([samples], mi.UInt32)
    numbers = _Numbers(lane // per_pixel, first + lane % per_pixel, seed)
    ray = _rays(camera, lane // per_pixel, numbers.pair(0))
    throughput, light = mi.Color3f(1.0), mi.Color3f(0.0)
    depth, active = mi.UInt32(0), mi.Mask(True)
    context = mi.BSDFContext()

    def follow(ray, throughput, light, depth, matte, active):
        si = scene.ray_intersect(ray, mi.RayFlags.All, coherent=False, active=active)
        sky = dr.select(matte, _lighting_sky(ray.d), _seen_sky(ray.d))
        light = light + dr.select(active & ~si.is_valid(), throughput * sky, 0.0)
        active = active & si.is_valid()
        sample, weight = si.bsdf().sample(
            context, si, numbers.one(2 + 3 * depth), numbers.pair(3 + 3 * depth), active
        )
        matte |= active & mi.has_flag(sample.sampled_type, mi.BSDFFlags.DiffuseReflection)
        ray = si.spawn_ray(si.to_world(sample.wo))
        throughput, depth = throughput * weight, depth + 1
        active &= (depth < DEEPEST) & (dr.max(throughput) > DARKEST)
        return ray, throughput, light, depth, matte, active

    state = (ray, throughput, light, depth, mi.Mask(False), active)
    return dr.while_loop(state, lambda *state: state[-1], follow, label="picture")[2]


class _Numbers:
    """Evenly spread random numbers of every sample of every pixel (UInt32 both).

    The first dimensions of a pixel's samples are a shifted lattice (see `bulk`), so that they
    fill lens, first bounces and the choices at them evenly; the others are random.
    """

    def __init__(self, pixel, sample, seed: int) -> None:
        words = [opaque([word], mi.UInt32) for word in seed_words(2, seed)]
        self._pixel, self._salt = pixel ^ words[0], words[1]
        self._sample, self._mirrored = sample, dr.brev(sample)
        self._generators = opaque(GENERATORS, mi.UInt32)

    def one(self, dimension):
        """A number (Float in [0, 1)) of a dimension (int or UInt32)."""
        dimension = mi.UInt32(dimension)
        even = dimension < len(GENERATORS)
        generator = dr.gather(mi.UInt32, self._generators, dimension, even)
        offset = dr.select(even, 0, self._sample * mi.UInt32(0x9E3779B9))
        shift, _ = mi.sample_tea_32(self._pixel ^ offset, self._salt + dimension, HASH_ROUNDS)
        return mi.Float((shift + self._mirrored * generator) >> 8) * 2.0**-24

    def pair(self, dimension):
        """Those of a dimension and of the next one (Point2f)."""
        return mi.Point2f(self.one(dimension), self.one(mi.UInt32(dimension) + 1))


def _rays(camera: Camera, pixel, jitter):
    """Rays (Ray3f) through pixels (UInt32), at a place in each (Point2f)."""
    # numbers of the camera as tables: one compiled kernel serves all of them
    wide, half_high = opaque([camera.width], mi.UInt32), opaque([camera.height / 2])
    x = mi.Float(pixel % wide) + jitter.x - mi.Float(wide) / 2
    y = mi.Float(pixel // wide) + jitter.y - half_high
    right, up, ahead, eye = map(opaque_vector, (*camera.axes, camera.eye))
    scale = opaque([camera.half_width / (camera.width / 2)])
    direction = dr.normalize(ahead + scale * (x * right - y * up))
    return mi.Ray3f(mi.Point3f(eye), direction)


@signals_wait()
def _studio(bodies: Sequence[Body], camera: Camera, floor_z_mm: float):
    """The scene of Mitsuba's."""
    points = np.concatenate([body.triangles.corners.reshape(-1, 3) for body in bodies])
    reach = float(np.abs(points).max() + np.abs(camera.target).max())
    to_world = mi.ScalarTransform4f().translate([0, 0, floor_z_mm]).scale(1e3 * reach)
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": FLOOR}}
    described = {
        "type": "scene",
        "floor": {"type": "rectangle", "to_world": to_world, "bsdf": white},
    }
    finishes: dict[Finish, object] = {}
    for number, body in enumerate(bodies):
        if body.finish.kind == GLASS and abs(body.finish.index_ratio - 1.0) < _ALIKE:
            continue
        if body.finish not in finishes:
            finishes[body.finish] = mi.load_dict(_bsdf(body.finish), parallel=False)
        described[f"body_{number}"] = _mesh(f"body_{number}", body, finishes[body.finish])
    return mi.load_dict(described, parallel=False)


def _mesh(name: str, body: Body, bsdf):
    """A mesh of a body's triangles."""
    corners, normals = body.triangles.corners, body.triangles.normals
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    mesh = mi.Mesh(name, 3 * len(corners), len(corners), properties, normals is not None)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(corners.ravel().tolist())
    parameters["faces"] = dr.arange(mi.UInt32, 3 * len(corners))
    if normals is not None:
        parameters["vertex_normals"] = mi.Float(normals.ravel().tolist())
    parameters.update()
    return mesh


def _bsdf(finish: Finish) -> dict:
    """A finish as Mitsuba describes it."""
    colour = {"type": "rgb", "value": list(finish.colour)}
    if finish.kind == GLASS:
        glass = {"int_ior": finish.index_ratio, "ext_ior": 1.0, "specular_transmittance": colour}
        if finish.roughness > 0.0:
            rough = {"type": "roughdielectric", "distribution": "ggx", "alpha": finish.roughness}
            return rough | glass
        return {"type": "dielectric"} | glass
    sides = {
        METAL: {"type": "roughconductor", "alpha": 0.15, "specular_reflectance": colour},
        GLOSSY: {"type": "roughplastic", "alpha": 0.15, "diffuse_reflectance": colour},
        MATTE: {"type": "diffuse", "reflectance": colour},
    }
    return {"type": "twosided", "bsdf": sides[finish.kind]}


def _seen_sky(direction):
    """Radiance (Float) of the studio as glass and gloss reflect it: soft boxes, dark below."""
    elevation = dr.rad2deg(dr.asin(dr.clip(direction.z, -1.0, 1.0)))
    azimuth = dr.rad2deg(dr.atan2(direction.x, direction.y))  # from +y over +x; camera at -y
    sky = 0.75 + 0.3 * dr.maximum(direction.z, 0.0) - 0.6 * _step(12.0 - elevation, 10.0)

    def box(low, high, left, right):
        inside = _step(elevation - low, 6.0) * _step(high - elevation, 6.0)
        return inside * _step(azimuth - left, 6.0) * _step(right - azimuth, 6.0)

    return sky + 2.5 * box(30.0, 70.0, -110.0, -40.0) + 1.2 * box(15.0, 55.0, 60.0, 105.0)


def _step(value, width: float):
    """From 0 at a value of 0 to 1 at this width."""
    return dr.clip(value / width, 0.0, 1.0)


def _lighting_sky(direction):
    """Radiance (Float) as it lights what is matte: without the boxes' edges, and so their noise."""
    return 1.0 + 0.5 * dr.dot(direction, mi.Vector3f(*_KEY))
