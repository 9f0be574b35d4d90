"""Photographs bodies in a studio of Mitsuba's, by its path tracer: a white floor, a soft sky."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import uniform_filter

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import signals_wait
from mcrim_mitsuba.transport.bulk import seed_words
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
    """Triangles of every surface, in order; InputError for a curved shape without points."""
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
#: Light paths per pixel that run together, and fill it evenly.
TOGETHER = 8
#: Ratios of indices closer to 1 than this do not refract.
_ALIKE = 1e-4
#: Pixels over which noise is averaged, and over which it is measured.
_SMOOTH = 5
_MEASURED = 7
#: What may be noise, over what was measured: the variance of few pixels is not known well.
_NOISE = 1.5
#: Rows of the picture of the sky, and its columns.
_SKY = (128, 256)
#: Where the sky is brightest.
_KEY = (-0.64, -0.48, 0.6)


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

    Linear red, green and blue: float32, shape (height, width, 3). The same seed gives the same
    numbers. The floor must lie below all bodies. `samples` are light paths per pixel; many are
    rounded up to a multiple of `TOGETHER`. ``progress(done, total)`` is in samples per pixel.
    """
    # radiance of the sky, from the zenith down and around: so soft that what is matte needs few
    # light paths, and dark below, which glass shows
    from_zenith, azimuth = (np.pi * (np.arange(n) + 0.5) / _SKY[0] for n in _SKY)
    up, level = np.cos(from_zenith)[:, None], np.sin(from_zenith)[:, None]
    x, y, z = _KEY
    key = np.clip(level * (x * np.sin(azimuth) + y * np.cos(azimuth)) + z * up, 0.0, 1.0)
    dark = np.clip((12.0 - np.degrees(np.arcsin(up))) / 10.0, 0.0, 1.0)
    sky = 0.75 + 0.3 * np.maximum(up, 0.0) - 0.6 * dark + 0.8 * key**4
    lights = np.broadcast_to(np.maximum(up, 0.0) * level, sky.shape)
    floor_light = FLOOR * float(np.average(sky, weights=lights))
    scene = _studio(bodies, camera, floor_z_mm, sky)
    at_once = TOGETHER if samples >= 2 * TOGETHER else 1
    count = -(-samples // at_once)
    total = squares = np.zeros(())
    for number, word in enumerate(seed_words(count, seed), start=1):
        with signals_wait():
            # (height, width, 3)
            light = np.array(mi.render(scene, spp=at_once, seed=word), dtype=float)
        total, squares = total + light, squares + light**2
        if progress is not None:
            progress(min(number * at_once, samples), samples)
    mean = total / count
    if count > 1:
        # how much exposures differ is the noise that the filter takes out, of each pixel its own
        noise: Any = np.maximum(squares / count - mean**2, 0.0) / (count - 1)
        noise = _NOISE * uniform_filter(noise, (_MEASURED, _MEASURED, 0)) + 1e-9
        # the filter of Wiener, by itself: its import takes half a second (`scipy.signal.wiener`)
        smooth, both = (
            uniform_filter(light, (_SMOOTH, _SMOOTH, 0), mode="constant")
            for light in (mean, mean**2)
        )
        variance = np.maximum(both - smooth**2, noise)
        mean = smooth + (1.0 - noise / variance) * (mean - smooth)
    return (mean / floor_light).astype(np.float32)


@signals_wait()
def _studio(bodies: Sequence[Body], camera: Camera, floor_z_mm: float, sky: np.ndarray):
    """The scene of Mitsuba's: bodies on a white floor below a sky, and a camera."""
    points = np.concatenate([body.triangles.corners.reshape(-1, 3) for body in bodies])
    reach = float(np.abs(points).max() + np.abs(camera.target).max())
    placed = mi.ScalarTransform4f()
    eye, target = camera.eye.tolist(), camera.target.tolist()
    bitmap = mi.Bitmap(np.dstack([sky] * 3).astype(np.float32))
    described = {
        "type": "scene",
        # no path is ended by chance: that is noise
        "integrator": {"type": "path", "max_depth": DEEPEST, "rr_depth": DEEPEST + 1},
        "floor": {
            "type": "rectangle",
            "to_world": placed.translate([0, 0, floor_z_mm]).scale(1e3 * reach),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": FLOOR}},
        },
        "sky": {"type": "envmap", "bitmap": bitmap, "to_world": placed.rotate([1, 0, 0], 90)},
        "camera": {
            "type": "perspective",
            "fov": camera.field_deg,
            "to_world": placed.look_at(eye, target, [0, 0, 1]),
            "sampler": {"type": "multijitter", "sample_count": TOGETHER},
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "pixel_format": "rgb",
                "component_format": "float32",
                # each light path counts in its own pixel: sums are the same each time
                "rfilter": {"type": "box"},
            },
        },
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
