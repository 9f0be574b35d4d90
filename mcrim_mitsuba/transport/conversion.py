"""Between Mitsuba and numbers: a loaded scene is read, and tables go into compiled kernels.

Everything is read from the loaded scene, never from our own idea of the bench.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.numbers import ALL_DETECTORS, ALPHA_ABS, ALPHA_SCAT, MM_PER_CM, judge
from mcrim_mitsuba.transport.scene_model import (
    DETECTOR,
    DIELECTRIC,
    DIFFUSE,
    OTHER,
    OUTSIDE,
    RESERVED_NAMES,
    Circle,
    FlatFace,
    RoundWall,
    SceneModel,
    Surface,
    Volume,
    cross,
)
from mcrim_mitsuba.transport.wrapped import WrappedFaces, outlines

#: A mesh of more triangles than this is not listed face by face: it counts as curved.
MOST_TRIANGLES = 128
#: Meshes whose faces are kept: benches that follow each other have most of theirs in common.
_MESHES = 256


class Listener(mi.Appender):
    """Keeps the lines of a log of Mitsuba's."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def append(self, _level, text: str) -> None:
        """Take a line, which Mitsuba's own appenders would print."""
        self.lines.append(text)


def parameters_of(node, *, nested: bool = True) -> dict[str, Any]:
    """What ``mi.traverse`` gives of an object, and of those `nested` in it: to be read only."""
    parts, met, collect = dict[str, Any](), {node}, _collector()
    objects = [("", node)]
    for path, owner in objects:
        for name, value, cpptype in collect(owner):
            if not isinstance(value, mi.Object):
                parts[path + name] = (
                    value if cpptype is None else mi.get_property(value, cpptype, owner)
                )
            elif nested and value not in met:  # what is met twice is named once
                met.add(value)
                objects.append((f"{path}{name}.", value))
    return parts


def write_parameters(node, **values: Any) -> None:
    """Give an object other parameters of its own, sooner than by ``mi.traverse``."""
    for name, place, cpptype in _collector()(node):
        if name in values:
            mi.set_property(place, cpptype, values[name])
    node.parameters_changed(list(values))


@functools.cache
def _collector() -> Callable[[Any], list[tuple]]:
    """A function that lists an object's parts; what Mitsuba tells them to begins with a variant."""

    class Collector(mi.TraversalCallback):
        def put(self, name: str, value, flags, cpptype=None) -> None:
            if value is not None:
                self.parts.append((name, value, cpptype))

        # plugins in Python call the first, those in C++ these
        put_value = put_object = put

    def collect(node) -> list[tuple]:
        callback = Collector()
        callback.parts = []
        node.traverse(callback)
        return callback.parts

    return collect


def read_scene_model(scene) -> SceneModel:
    """Translate a scene; every shape keeps its id where it was loaded with ``optimize=False``.

    Raises InputError for a medium, a phase function or a shape that the transport cannot follow.
    """
    box = mi.ScalarBoundingBox3f()
    for shape in scene.shapes():
        if shape.is_mesh() and not shape.bbox().valid():
            # made of several by Mitsuba, which forgets where it is
            shape.recompute_bbox()
        box.expand(shape.bbox())
    shapes = tuple(shape for shape in scene.shapes() if not getattr(shape, "empty", False))
    volumes = [Volume(RESERVED_NAMES[OUTSIDE], 0.0, 0.0)]
    for shape in shapes:
        for medium in filter(None, _media(shape)):
            if not medium.id() or medium.id() in RESERVED_NAMES:
                problem = f"{shape.id()}: a medium is called {medium.id()!r}"
                raise InputError(problem, f"give it an id, other than {', '.join(RESERVED_NAMES)}")
            if medium.id() not in [v.name for v in volumes]:
                volumes.append(_volume(medium))
    names = [v.name for v in volumes]
    endless = next((number for number, v in enumerate(volumes) if v.endless), OUTSIDE)
    if sum(v.endless for v in volumes) > 1:
        raise InputError("two media are endless", "light outside is in one liquid at most")
    surfaces, faces, curved, walls = [], [], [], []
    for number, shape in enumerate(shapes):
        inner, outer = (OUTSIDE if m is None else names.index(m.id()) for m in _media(shape))
        try:
            properties = _followed(shape, inner, outer)
            flat = _flat_faces(shape, number)
        except InputError as error:
            raise InputError(f"{shape.id()}: {error.problem}", error.mend) from None
        if properties["kind"] != DIELECTRIC and {inner, outer} <= {OUTSIDE, endless}:
            inner = outer = OUTSIDE  # it stands in the liquid, which is where outside is
        elif inner != outer and {inner, outer} == {OUTSIDE, endless}:
            problem = f"{shape.id()} is a surface of {names[endless]!r}, which is endless"
            raise InputError(problem, "close that liquid with faces, and let it not be endless")
        surfaces.append(Surface(shape.id(), inner, outer, **properties))
        wall = _wall(shape)
        if wall is not None:
            walls.append(replace(wall, surface=number))
        elif flat is None:
            curved.append(number)
        faces.extend(flat or [])
    notes = _let_wrappings_touch(scene, surfaces, shapes, faces, walls, volumes)
    if len({(s.film, s.head_on) for s in surfaces if s.kind == DETECTOR}) > 1:
        problem = "the detectors differ in what they take of light that arrives head-on"
        raise InputError(problem, "let all have the same cathode_nm and angular_falloff")
    detectors = [number for number, s in enumerate(surfaces) if s.kind == DETECTOR]
    for detector, number in enumerate(detectors):
        surfaces[number] = replace(surfaces[number], detector=detector)
    size = float(max(np.abs(np.array(box.min)).max(), np.abs(np.array(box.max)).max()))
    return SceneModel(
        scene,
        shapes,
        tuple(volumes),
        tuple(surfaces),
        tuple(faces),
        tuple(curved),
        size,
        tuple(walls),
        _counted(scene, [surfaces[number].name for number in detectors]),
        tuple(notes),
    )


def _counted(scene, detectors: list[str]) -> int | None:
    """Number of the detector that the integrator counts; ``None`` for all."""
    name = getattr(scene.integrator(), "detector", ALL_DETECTORS)
    if name != ALL_DETECTORS and name not in detectors:
        problem = f"no shape that wears a photodetector has the id {name!r}"
        raise InputError(problem, did_you_mean(name, [ALL_DETECTORS, *detectors]))
    return None if name == ALL_DETECTORS else detectors.index(name)


def _let_wrappings_touch(scene, surfaces, shapes, faces, walls, volumes) -> list[str]:
    """Give faces that wrappings touch, or are painted on, what light finds of these behind them.

    Returns what is to be told of wrappings.
    """
    wraps = [shape for shape in scene.shapes() if hasattr(shape, "is_paint")]
    rims = outlines(shapes, faces, walls) if wraps else []
    names, notes = [volume.name for volume in volumes], list[str]()
    for shape in wraps:
        inner, outer = (OUTSIDE if m is None else names.index(m.id()) for m in _media(shape))
        wrapping = Surface(shape.id(), inner, outer, **_followed(shape, inner, outer))
        wrapped = WrappedFaces(shape, wrapping, surfaces, rims)
        within = wrapped.volumes(volumes)
        notes += wrapped.looseness(within)
        if shape.contact or shape.is_paint:
            for number, surface in wrapped.touched(within).items():
                surfaces[number] = surface
    return notes


def _media(shape) -> tuple:
    """Mitsuba's media behind a shape and in front of it; ``None`` is the outside."""
    return shape.interior_medium(), shape.exterior_medium()


def _volume(medium) -> Volume:
    """The volume of a medium, and how it scatters."""
    scattering = _phase(medium)
    if hasattr(medium, "alpha_scat_per_cm"):
        # Mitsuba's own way may have set them
        alphas = {name: getattr(medium, name)[0] for name in (ALPHA_SCAT, ALPHA_ABS)}
        for name, alpha in alphas.items():
            if not 0.0 <= alpha < math.inf:
                problem = f"{name} of medium {medium.id()!r} is {alpha:g}"
                raise InputError(problem, "give a number of 0 or more")
        for name in ("scattering_gradient", "scattering_exponent", "endless"):
            scattering[name] = getattr(medium, name)
        if medium.scattering_exponent:
            scattering["relative_bandwidth"] = medium.relative_bandwidth
        return Volume(medium.id(), *(alpha / MM_PER_CM for alpha in alphas.values()), **scattering)
    parameters = parameters_of(medium)
    try:
        sigma_t = _first(parameters["sigma_t.value.value"]) * _first(parameters["scale"])
        albedo = _first(parameters["albedo.value.value"])
    except KeyError:
        problem = f"medium {medium.id()!r} ({medium.class_name()}) is not homogeneous"
        mend = 'use <medium type="bulk"> or <medium type="homogeneous"> with single values'
        raise InputError(problem, mend) from None
    return Volume(medium.id(), albedo * sigma_t, (1.0 - albedo) * sigma_t, **scattering)


def _phase(medium) -> dict:
    """How a medium scatters, as keyword arguments of `Volume`."""
    phase = medium.phase_function()
    name = "IsotropicPhaseFunction" if phase is None else phase.class_name()
    if name == "HGPhaseFunction":
        return {"phase": "hg", "scattering_g": _first(parameters_of(phase)["g"])}
    if name not in ("IsotropicPhaseFunction", "RayleighPhaseFunction"):
        mend = "the transport follows the phase functions isotropic, hg and rayleigh"
        raise InputError(f"medium {medium.id()!r} scatters with {name}", mend)
    return {"phase": "rayleigh" if name == "RayleighPhaseFunction" else "isotropic"}


def surface_properties(bsdf) -> dict:
    """What the loop needs of a BSDF, as keyword arguments of `Surface`; else it is `OTHER`."""
    name = type(bsdf).__name__
    if name == "BSDF":  # none of Python's
        name = bsdf.class_name()
    properties = _READERS[name](bsdf) if name in _READERS else None
    return properties or {"kind": OTHER, "plugin": name}


def _of_aperture(bsdf) -> dict:
    properties = surface_properties(bsdf.interface)
    if "aperture_radius_mm" in properties:
        raise InputError("an aperture lies in an aperture", "keep the narrower one")
    return properties | {
        "aperture_radius_mm": bsdf.radius,
        "axis_mm": bsdf.centre,
        "mask_reflectance": bsdf.reflectance,
    }


def _of_photodetector(bsdf) -> dict:
    return {
        "kind": DETECTOR,
        "axis_mm": bsdf.centre,
        "reflectance": bsdf.reflectance,
        "specular": bsdf.specular,
        "film": bsdf.film,
        "angular_falloff": bsdf.angular_falloff,
        "radial_falloff_per_mm2": bsdf.radial_falloff_per_mm2,
        "least_cosine": math.cos(math.radians(min(bsdf.acceptance_deg, 90.0))),
    }


def _of_polish(bsdf) -> dict:
    return surface_properties(bsdf.smooth) | {
        "roughness": bsdf.roughness_alpha,
        "beckmann": bsdf.distribution == "beckmann",
        "surface_loss": bsdf.surface_loss,
        "ground_loss": bsdf.ground_loss if bsdf.roughness_alpha else 0.0,
        "haze": 2.0 * math.pi * (bsdf.rms_roughness_nm / bsdf.wavelength_nm) * bsdf.int_ior,
    }


def _of_dielectric(bsdf) -> dict | None:
    parameters = parameters_of(bsdf)
    if any("specular" in name for name in parameters):
        return None
    return {"kind": DIELECTRIC, "eta": _first(parameters["eta"])}


def _of_two_sided(bsdf) -> dict | None:
    parameters = parameters_of(bsdf)
    if "brdf_0.acceptance_deg" in parameters:
        problem = "a photodetector stands in a twosided bsdf"
        raise InputError(problem, "use it alone: it takes light on both sides")
    # where both sides are one and the same, Mitsuba names it once
    return _reflector(parameters, "brdf_0.reflectance.value", two_sided=True)


def _reflector(parameters, reflectance: str, *, two_sided: bool) -> dict | None:
    """One grey diffuse reflector; None where the parameters are those of something else."""
    if [name for name in parameters if "value" in name] != [reflectance]:
        return None
    values = np.ravel(np.array(parameters[reflectance], dtype=np.float64))
    if np.ptp(values) > 1e-6:
        problem = f"a reflectance has a colour ({', '.join(f'{v:g}' for v in values)})"
        mend = 'light is monochromatic: write <spectrum name="reflectance" value="0.97"/>'
        raise InputError(problem, mend)
    grey = float(values[0])
    if (wrong := judge("reflectance", grey)) is not None:
        raise InputError(f"its reflectance is {grey:g}: {wrong[1]}", wrong[2])
    return {"kind": DIFFUSE, "reflectance": grey, "two_sided": two_sided}


#: What reads a BSDF, by the name of its class: of `plugins.bsdfs`, and of Mitsuba.
_READERS: dict[str, Callable[[Any], dict | None]] = {
    "Aperture": _of_aperture,
    "Photodetector": _of_photodetector,
    "Polish": _of_polish,
    "SmoothDielectric": _of_dielectric,
    "SmoothDiffuse": lambda bsdf: _reflector(
        parameters_of(bsdf), "reflectance.value", two_sided=False
    ),
    "TwoSidedBRDF": _of_two_sided,
}


def _followed(shape, interior: int, exterior: int) -> dict:
    """`surface_properties` of a shape; raises InputError where light cannot be followed there."""
    # An instance's surfaces and volumes are those of its group, which has no place of its own.
    if shape.class_name() == "Instance":
        problem = "the transport does not follow instances of a shapegroup"
        raise InputError(problem, "write the shape itself, once for each place")
    properties = surface_properties(shape.bsdf())
    if any(getattr(shape, name, False) for name in ("is_paint", "contact", "specular")):
        if properties["kind"] != DIFFUSE:
            problem = "paint, contact and specular are of a wrapping that reflects diffusely else"
            raise InputError(problem, 'let it wear <bsdf type="diffuse">')
        properties["mirror_part"] = shape.specular
    if "aperture_radius_mm" in properties:
        width, depth, height = (float(shape.bbox().extents()[i]) for i in range(3))
        if height > 1e-4 * max(width, depth):
            mend = "turn the bench so that the masked face is perpendicular to z"
            raise InputError("an aperture lies on a face that is not horizontal", mend)
    black_back = properties["kind"] == DIFFUSE and not properties["two_sided"]
    if properties["kind"] == OTHER:
        black_back = not mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.BackSide)
    if black_back and interior != OUTSIDE:
        problem = "its reflector is black on the back, and light inside the volume meets the back"
        raise InputError(problem, 'wrap it in <bsdf type="twosided">, or turn the face round')
    if properties.get("plugin") == "ThinDielectric" and interior != exterior:
        problem = "a thindielectric does not refract, but parts two different volumes"
        raise InputError(problem, 'use <bsdf type="dielectric">')
    return properties


def _first(value) -> float:
    """First component of a scalar, Dr.Jit array or spectrum (transport is monochromatic)."""
    values = np.ravel(np.array(value, dtype=np.float64))
    if np.ptp(values) > 1e-6 * abs(values[0]):
        raise InputError("a medium has a colour", "light is monochromatic: give single numbers")
    return float(values[0])


def _flat_faces(shape, number: int) -> list[FlatFace] | None:
    """The flat faces of a shape, the triangles of a mesh, or ``None`` if it is curved."""
    if shape.shape_type() == int(mi.ShapeType.Rectangle):
        matrix = _matrix(shape)
        centre, half_u, half_v = matrix[:3, 3], matrix[:3, 0], matrix[:3, 1]
        if shape.has_flipped_normals():
            half_u, half_v = half_v, half_u
        return [_face(centre - half_u - half_v, 2 * half_u, 2 * half_v, False, number)]
    if shape.shape_type() == int(mi.ShapeType.Disk):
        return _disk_face(shape, number)
    if getattr(shape, "round_faces", ()):
        return [
            replace(_face(corner, along, across, False, number), circle=circle)
            for corner, along, across, circle in shape.round_faces
        ]
    if shape.is_mesh() and _wall(shape) is None:
        return _mesh_faces(shape, number)
    return None


#: How far, in parts of its size, a round shape's directions may be off the scene's axes: rounding.
_ASKEW = 1e-6


def _matrix(shape) -> np.ndarray:
    """A shape's ``to_world``, float64, shape (4, 4)."""
    matrix = parameters_of(shape, nested=False)["to_world"].matrix
    # one number after the other: as a whole it would go through a kernel
    return np.array([[number[0] for number in row] for row in matrix], dtype=np.float64)


def _circle(u: np.ndarray, v: np.ndarray, along: np.ndarray, centre: np.ndarray) -> Circle | None:
    """A shape's circle of these radii, if it is one about an axis of the scene, and not sheared."""
    size = np.linalg.norm([u, v], axis=1)
    if abs(size[0] - size[1]) > _ASKEW * size[0] or abs(u @ v) > _ASKEW * size[0] ** 2:
        return None
    axis = int(np.argmax(np.abs(along)))
    off = np.delete(np.abs(along), axis).max() > _ASKEW * abs(along[axis])
    if off or max(abs(u[axis]), abs(v[axis])) > _ASKEW * size[0]:
        return None
    x, y = np.delete(centre, axis).tolist()
    return Circle((x, y), float(np.linalg.norm(u)), axis=axis)


def _disk_face(shape, number: int) -> list[FlatFace] | None:
    """A round face across an axis of Mitsuba's ``disk``; ``None`` of any other."""
    half_u, half_v, front, centre = _matrix(shape)[:3].T
    circle = _circle(half_u, half_v, cross(half_u, half_v), centre)
    if circle is None:
        return None
    # the square around it with its edges along axes, as light is tested soonest
    u, v = (np.eye(3)[i] * circle.radius_mm for i in circle.across)
    if cross(u, v) @ front < 0.0:
        u, v = v, u
    face = _face(centre - u - v, 2.0 * u, 2.0 * v, False, number)
    return [replace(face, circle=circle)]


def _wall(shape) -> RoundWall | None:
    """The round wall that a shape is: one of ours, or Mitsuba's ``cylinder`` along an axis."""
    plugins_wall = getattr(shape, "wall", None)
    if plugins_wall is not None or shape.shape_type() != int(mi.ShapeType.Cylinder):
        return plugins_wall
    u, v, along, foot = _matrix(shape)[:3].T
    circle = _circle(u, v, along, foot)
    if circle is None:
        return None
    low, high = sorted((float(foot[circle.axis]), float((foot + along)[circle.axis])))
    mirrored = cross(u, v) @ along < 0.0
    return RoundWall(circle, low, high, -1, outwards=shape.has_flipped_normals() == bool(mirrored))


def _face(corner, edge_u, edge_v, triangle: bool, number: int) -> FlatFace:
    normal = cross(edge_u, edge_v)
    area = np.linalg.norm(normal)
    if not area > 0.0:
        raise InputError("a face has no area", "look for a scale of 0 in its transform")
    return FlatFace(corner, edge_u, edge_v, normal / area, triangle, number)


def _mesh_faces(shape, number: int) -> list[FlatFace] | None:
    if shape.face_count() > MOST_TRIANGLES:
        return None
    parameters = parameters_of(shape, nested=False)
    vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    indices = np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3)
    if shape.has_flipped_normals():
        indices = indices[:, [0, 2, 1]]
    corners = vertices[indices]
    return [replace(face, surface=number) for face in _merged_faces(corners.tobytes())]


@functools.lru_cache(maxsize=_MESHES)
def _merged_faces(corners: bytes) -> tuple[FlatFace, ...]:
    """The faces of triangles: (triangles, 3, 3) float64 in mm, as bytes."""
    triangles = [
        _face(a, b - a, c - a, True, -1) for a, b, c in np.frombuffer(corners).reshape(-1, 3, 3)
    ]
    # neighbouring triangles that form a parallelogram are one face
    merged, i = [], 0
    while i < len(triangles):
        joined = _parallelogram(*triangles[i : i + 2]) if i + 1 < len(triangles) else None
        merged.append(joined or triangles[i])
        i += 2 if joined else 1
    return tuple(merged)


def _parallelogram(first: FlatFace, second: FlatFace) -> FlatFace | None:
    """What two triangles are together, if that is a parallelogram."""
    scale = np.abs([first.edge_u, first.edge_v]).max()
    if np.abs(first.normal - second.normal).max() > 1e-6:
        return None
    a, b = first.corners, second.corners

    def same(p, q) -> bool:
        return np.abs(p - q).max() <= 1e-6 * scale

    shared = [i for i, p in enumerate(a) if any(same(p, q) for q in b)]
    if len(shared) != 2:
        return None
    (alone,) = set(range(3)) - set(shared)
    # from the corner that a quadrilateral begins with, so that births are as in a rectangle
    corner, u, far = a[alone - 1], a[alone], a[(alone + 1) % 3]
    v = next(q for q in b if not any(same(p, q) for p in a))
    if not same(u + v - corner, far):
        return None
    return _face(corner, u - corner, v - corner, False, first.surface)


def opaque(values, dtype=None):
    """A table (``mi.Float`` by default) of the loop that one compiled kernel can be reused with."""
    # From a list, because Dr.Jit would borrow a NumPy array's memory, whose alignment varies and
    # is part of the compiled code.
    table = (dtype or mi.Float)(np.asarray(values).tolist())
    dr.make_opaque(table)
    return table


def opaque_vector(values):
    """A Vector3f of three opaque numbers."""
    return mi.Vector3f(*(opaque([value]) for value in values))


def surface_numbers(model: SceneModel):
    """A function of (ShapePtr, mask) that gives the index among ``model.surfaces`` (UInt32)."""
    pointers = [mi.ShapePtr(shape) for shape in model.shapes]
    ids = [int(np.array(dr.reinterpret_array(mi.UInt32, pointer))[0]) for pointer in pointers]
    table = np.zeros(max(ids) + 1, dtype=np.uint32)
    table[ids] = range(len(ids))
    table = opaque(table, mi.UInt32)

    def number_of(pointer, active):
        return dr.gather(mi.UInt32, table, dr.reinterpret_array(mi.UInt32, pointer), active)

    return number_of
