"""A scene's text as a bench of faces: its surfaces, volumes and where its light is born, read anew.

Shares no code with the transport, which reads the loaded scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.reference.faces import BenchSurface, FacedBench
from mcrim_mitsuba.reference.scene_shapes import Properties, WrappedSolid, faces_of, to_world
from mcrim_mitsuba.reference.walk import DETECTOR, DIELECTRIC, METAL, REFLECTS
from mcrim_mitsuba.scene.check_text import indices_of
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.xml_tree import SIDES

#: Distance from the axis, mm, at which the radial falloff is what is lacking.
FALLOFF_RADIUS_MM = 14.0
#: Usual wavelength and width of the light's band, nm.
_WAVELENGTH_NM = 540.0
_BANDWIDTH_NM = 150.0
# The photocathode K-Cs-Sb: wavelengths in nm, and n and k of its index n + ik. D. Motta and
# S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217, as tabulated in WCSim
# (data/CathodeParameters_KCsCb.txt); 420 and 540 nm are this project's.
_CATHODE_NM = np.array(sorted([*range(380, 681, 15), 420, 540]), dtype=float)
_CATHODE_N = """
    1.92 2.18 2.38 2.57 2.61 2.70 2.87 3.00 3.00 3.00 3.09 3.26
    3.22 3.20 3.12 3.06 3.01 2.98 2.96 2.95 2.95 2.95 2.96
"""
_CATHODE_K = """
    1.69 1.69 1.71 1.57 1.53 1.50 1.44 1.34 1.11 1.06 1.05 0.86
    0.7055 0.63 0.53 0.46 0.42 0.38 0.37 0.35 0.34 0.34 0.33
"""
Optics = dict[str, complex]


def cathode_index(wavelength_nm: float) -> complex:
    """Index n + ik of the photocathode, on straight lines between the tabulated wavelengths."""
    tables = (np.array(table.split(), float) for table in (_CATHODE_N, _CATHODE_K))
    n, k = (np.interp(wavelength_nm, _CATHODE_NM, table) for table in tables)
    return complex(n, k)


def read_bench(file: SceneFile) -> FacedBench:
    """The bench that a sound scene describes.

    Raises InputError, which names the part, if the tracer does not know what the scene has.
    """
    surfaces, wrappings = list[BenchSurface](), dict[str, WrappedSolid]()
    for number, node in enumerate(file.parts.shapes):
        shape, name = Properties(file, node), node.get("id") or f"shape {number}"
        sides = {side: file.parts.medium(node, side) for side in SIDES}
        bsdf = file.parts.bsdf(node)
        if bsdf is None:
            raise shape.refusal("what this shape wears")
        optics = _optics(Properties(file, bsdf))
        if (indices := indices_of(file, node)) is not None:
            optics |= dict(zip(("n_interior", "n_exterior"), indices, strict=True))
        if node.type == "wrapping":
            wrapping = wrappings[name] = WrappedSolid(shape, to_world(shape))
            contact = shape.number("contact", 0.0) if wrapping.film else 1.0
            optics |= {"specular": shape.number("specular", 0.0), "contact": contact}
            optics |= {"contact_z": wrapping.begin, "paint": wrapping.film == 0.0}
        faces = faces_of(shape)
        if faces or node.type == "wrapping":
            beside = {side: part.get("id", "") for side, part in sides.items() if part is not None}
            surfaces.append(BenchSurface(name=name, faces=faces, optics=optics, **beside))
    borders = {side for s in surfaces for side in (s.interior, s.exterior)}
    media = {node.get("id", ""): Properties(file, node) for node in file.root.iter("medium")}
    tags = "integrator", "emitter"
    integrator, emitter = (Properties(file, next(file.root.iter(tag))) for tag in tags)
    depth, detector = integrator.text("max_depth"), integrator.text("detector")
    (crystal,) = file.parts.targets(emitter.node, "medium")
    half, slab_mm = emitter.number("source_width_mm", math.inf) / 2.0, None
    if math.isfinite(half):
        middle = emitter.number("source_z_mm")
        slab_mm = middle - half, middle + half
    return FacedBench(
        surfaces=[_touched(surface, surfaces, wrappings) for surface in surfaces],
        volumes={name: _volume(medium) for name, medium in media.items() if name in borders},
        birth=_birth(emitter),
        crystal=crystal.get("id", ""),
        slab_mm=slab_mm,
        across_mm=emitter.number("source_across_mm", math.inf),
        read="" if detector == "all" else detector,
        polarised=integrator.flag("polarization"),
        most_flights=int(depth) if depth else None,
    )


def _touched(
    surface: BenchSurface, surfaces: list[BenchSurface], wrappings: Mapping[str, WrappedSolid]
) -> BenchSurface:
    """A dielectric with its faces told which wrapping touches them."""
    for other in surfaces if surface.optics["kind"] == DIELECTRIC else ():
        wrapping = wrappings.get(other.name)
        if wrapping is None or not other.optics["contact"] or surface.exterior != other.exterior:
            continue
        faces = [
            replace(face, wrapping=other.name) if wrapping.touches(face) else face
            for face in surface.faces
        ]
        surface = replace(surface, faces=faces)
    return surface


def _optics(bsdf: Properties) -> Optics:
    """What light meets at a surface that wears a bsdf, but for indices."""
    kind = bsdf.node.type
    if kind in ("aperture", "twosided"):
        inner = bsdf.file.parts.targets(bsdf.node, "bsdf")
        if len(inner) != 1:
            raise bsdf.refusal(f"a bsdf of type {kind} around {len(inner)} others")
        optics = _optics(Properties(bsdf.file, inner[0]))
        return optics | ({"two_sided": 1} if kind == "twosided" else _mask(bsdf))
    if kind == "photodetector":
        return _detector(bsdf)
    names = [part.get("name", "") for part in bsdf.node.elements]
    tinted = any(name.startswith("specular_") for name in names)
    if kind == "polish" or (kind == "dielectric" and not tinted):
        wavelength = bsdf.number("wavelength_nm", _WAVELENGTH_NM)
        return {
            "kind": DIELECTRIC,
            "roughness": bsdf.number("roughness_alpha", 0.0),
            "beckmann": bsdf.text("distribution") == "beckmann",
            "surface_loss": bsdf.number("surface_loss", 0.0),
            "ground_loss": bsdf.number("ground_loss", 0.0),
            "heights": bsdf.number("rms_roughness_nm", 0.0) / wavelength,
        }
    if kind == "diffuse" and bsdf.node.find("texture") is None:
        return {"kind": REFLECTS, "reflectance": bsdf.number("reflectance", 0.5)}
    if kind == "conductor" and bsdf.text("material") == "none":
        part = bsdf.number("specular_reflectance", 1.0)
        return {"kind": METAL, "reflectance": part, "specular": 1.0}
    raise bsdf.refusal(f"what wears a bsdf of type {kind}, or not as here")


def _mask(bsdf: Properties) -> Optics:
    x, y, _ = bsdf.point("centre")
    optics: Optics = {"mask_radius": bsdf.number("radius"), "axis_x": x, "axis_y": y}
    return optics | {"mask_reflectance": bsdf.number("reflectance", 0.0)}


def _detector(bsdf: Properties) -> Optics:
    x, y, _ = bsdf.point("centre")
    names = "reflectance", "specular", "angular_falloff"
    optics: Optics = {name: bsdf.number(name, 0.0) for name in names}
    optics |= {
        "kind": DETECTOR,
        "axis_x": x,
        "axis_y": y,
        "radial_falloff": bsdf.number("radial_falloff", 0.0) / FALLOFF_RADIUS_MM**2,
        "least_cosine": math.cos(math.radians(bsdf.number("acceptance_deg", 90.0))),
    }
    if thickness_nm := bsdf.number("cathode_nm", 0.0):
        wavelength = bsdf.number("wavelength_nm", _WAVELENGTH_NM)
        n, k = bsdf.number("cathode_n", 0.0), bsdf.number("cathode_k", 0.0)
        if not n and not _CATHODE_NM[0] <= wavelength <= _CATHODE_NM[-1]:
            raise bsdf.refusal(f"the photocathode's index at {wavelength:g} nm")
        index = complex(n, k) if n else cathode_index(wavelength)
        optics |= {"film_index": index, "film_wavelengths": thickness_nm / wavelength}
        optics["n_interior"] = bsdf.number("window_index", 1.0)
    return optics


def _volume(medium: Properties) -> dict[str, float]:
    """A medium in the words of `walk.VOLUME_FIELDS`."""
    phase = medium.node.find("phase")
    kind = "isotropic" if phase is None else phase.get("type", "")
    if kind not in ("isotropic", "hg", "rayleigh"):
        raise medium.refusal(f"the phase function {kind}")
    g = 0.0 if phase is None or kind != "hg" else Properties(medium.file, phase).number("g", 0.8)
    values: dict[str, float] = {"rayleigh": kind == "rayleigh", "g": g}
    if medium.node.type == "homogeneous":
        extinction = medium.number("sigma_t", 1.0) * medium.number("scale", 1.0)
        albedo = medium.number("albedo", 0.75)
        return values | {"scattering": albedo * extinction, "absorption": (1 - albedo) * extinction}
    if medium.node.type != "bulk":
        raise medium.refusal(f"a medium of type {medium.node.type}")
    wavelength, is_there = medium.number("wavelength_nm", _WAVELENGTH_NM), medium.is_filled()
    return values | {
        "scattering": is_there * medium.number("alpha_scat_per_cm", 0.0) / MM_PER_CM,
        "absorption": is_there * medium.number("alpha_abs_per_cm", 0.0) / MM_PER_CM,
        "gradient": medium.number("scattering_gradient", 0.0),
        "exponent": medium.number("scattering_exponent", 0.0),
        "bandwidth": medium.number("bandwidth_nm", _BANDWIDTH_NM) / wavelength,
        "endless": medium.flag("endless"),
    }


def _birth(emitter: Properties) -> dict[str, float]:
    """Where light is born, in the words of `walk.BIRTH_FIELDS`."""
    if emitter.node.type == "collimated_beam":
        axis = "xyz".index(emitter.text("axis", "x"))
        return {"axis": axis, "beam_radius": emitter.number("diameter") / 2.0}
    if emitter.node.type != "scintillation":
        raise emitter.refusal(f"an emitter of type {emitter.node.type}")
    if "side_depth_mm" in emitter:
        return {"axis": 0, "depth": emitter.number("side_depth_mm")}
    return {"axis": 2, "from_high": True, "depth": emitter.number("source_depth_mm", math.inf)}
