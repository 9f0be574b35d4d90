"""Checks a loaded scene, and says in sentences what it means.

Asked is, the most basic first and after the text (`scene.check_text`): do faces lie on each other;
do the volumes fit together (`volume_consistency`); does light reach the detector.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import LARGEST_PER_CM, LONGEST_PART_MM, MM_PER_CM, SHORTEST_PART_MM
from mcrim_mitsuba.core.run import signals_wait
from mcrim_mitsuba.scene import check_text
from mcrim_mitsuba.scene.check_text import CheckReport, Interface, SceneProblem
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.scene_model import DETECTOR, FlatFace, SceneModel, Surface, Volume
from mcrim_mitsuba.transport.volume_consistency import (
    claimed_indices,
    probe,
    problems_of_named_volumes,
    problems_of_volumes,
)

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.bulk import CrystalVolume
    from mcrim_mitsuba.transport.simulation import Simulation

#: Photons that look for the detector.
SCOUTS = 200_000
#: Mitsuba moves a new ray off its surface by this times (1 + largest coordinate); measured.
RAY_OFFSET = 8.94e-5
#: A gap must be this many offsets wide, or rays start beyond its other side.
OFFSETS_PER_GAP = 2.0


@signals_wait()
def check_simulation(simulation: Simulation, *, light: bool = True) -> CheckReport:
    """Check a loaded scene, whose text has been checked; see `check_scene`."""
    from mcrim_mitsuba.transport.collection import choose_path

    file, model = simulation.file, simulation.model
    faces = interfaces_of(file, model)
    problems = problems_of_scene(simulation, faces)
    if light and not problems:
        problems = _problems_of_detector(simulation)
    sentences = describe(simulation, faces, choose_path(model, simulation.polarization).name)
    notes = (*file.notes, *simulation.notes)
    return CheckReport(tuple(problems), dict(file.parameters), faces, tuple(sentences), notes)


def problems_of_scene(
    simulation: Simulation, interfaces: tuple[Interface, ...] | None = None
) -> list[SceneProblem]:
    """What is wrong with a loaded scene, whether light finds the detector or not."""
    file, model = simulation.file, simulation.model
    problems = problems_of_media(file, model.volumes) + problems_of_crystal(simulation)
    problems += problems_of_contacts(file, model)
    if problems:
        return problems
    faces = interfaces or interfaces_of(file, model)
    # Index claims come first where the geometry itself is sound: they name the faces best.
    contradictions = problems_of_volumes(file, model, faces, probe(model))
    return problems_of_named_volumes(faces) or contradictions


def interfaces_of(file: SceneFile, model: SceneModel) -> tuple[Interface, ...]:
    """Every face with the volumes and indices on its two sides, in the order of the surfaces."""
    elements = {e.get("id"): e for e in file.parts.shapes}
    faces = []
    for surface in model.surfaces:
        element = elements[surface.name]
        kind = surface.seen.kind_name
        inner, outer = (model.volumes[side].name for side in surface.sides)
        n_inner, n_outer = check_text.indices_of(file, element) or (None, None)
        place = file.place_of(element)
        faces.append(Interface(surface.name, kind, inner, outer, n_inner, n_outer, *place))
    return tuple(faces)


# ---- what can be wrong ----------------------------------------------------------------


def problems_of_media(file: SceneFile, volumes: Sequence[Volume]) -> list[SceneProblem]:
    """Coefficients that no medium has, an albedo above 1 among them."""
    problems = []
    for volume in volumes[1:]:
        element = next((e for e in file.root.iter("medium") if e.get("id") == volume.name), None)
        if element is None:
            continue
        place = file.place_of(element)
        scat, absorption = volume.alpha_scat_per_mm, volume.alpha_abs_per_mm
        if not (math.isfinite(scat) and math.isfinite(absorption)):
            text, mend = "has a coefficient that is not a finite number", "write a number"
        elif absorption < -1e-9 * abs(scat) and element.get("type") != "bulk":
            albedo = scat / (scat + absorption)
            text = f"has an albedo of {albedo:.4g}: it would make light"
            mend = "albedo is scattering / (scattering + absorption): give 0 to 1"
        elif scat < 0 or absorption < 0:
            text, mend = "has a negative coefficient", "give 0 or more, in 1/cm"
        elif (largest := max(scat, absorption) * MM_PER_CM) > LARGEST_PER_CM:
            text = f"has a coefficient of {largest:.4g} /cm; it looks like 1/m"
            mend = "write coefficients in 1/cm (sigma_t of a homogeneous medium: 1/mm)"
        else:
            continue
        problems.append(SceneProblem("coefficient", f"medium {volume.name!r} {text}", mend, *place))
    return problems


def problems_of_crystal(simulation: Simulation) -> list[SceneProblem]:
    """A crystal whose size looks like another unit, whatever the parameters are called."""
    crystal = simulation.crystal
    sizes = crystal.upper - crystal.lower
    place = simulation.file.place_of_id(simulation.model.volumes[crystal.volume].name)
    if not sizes.min() > 0.0:
        text = f"the crystal measures {' x '.join(f'{size:g}' for size in sizes)} mm: it is empty"
        return [SceneProblem("unit", text, "look for a size or a scale of 0", *place)]
    if sizes.max() < 5 * SHORTEST_PART_MM:
        unit, factor = "metres", 1000.0
    elif sizes.max() > LONGEST_PART_MM:
        unit, factor = "micrometres", 0.001
    else:
        return []
    measured, in_mm = (" x ".join(f"{size * by:g}" for size in sizes) for by in (1.0, factor))
    text = f"the crystal measures {measured} in scene units, which are mm; it looks like {unit}"
    return [SceneProblem("unit", text, f"write lengths in mm: {in_mm}", *place)]


def problems_of_contacts(file: SceneFile, model: SceneModel) -> list[SceneProblem]:
    """Parallel faces that overlap at no distance, or at one too small for Mitsuba's rays."""
    narrowest = OFFSETS_PER_GAP * RAY_OFFSET * (1.0 + model.size_mm)
    problems, seen = [], set()
    for first, second in itertools.combinations(model.faces or (), 2):
        pair = (first.surface, second.surface)
        if pair in seen or abs(first.normal @ second.normal) < 1 - 1e-6:
            continue
        distance = abs((second.corner - first.corner) @ first.normal)
        if distance >= narrowest or not _overlap(first, second):
            continue
        seen.add(pair)
        name, other_name = (model.surfaces[i].name for i in pair)
        kind, line = "overlap", file.place_of_id(name)[1]
        text = f"{name} (line {line}) and {other_name} "
        if distance < 1e-6 * model.size_mm:
            text += "lie on each other"
            mend = "an interface is ONE surface that names both indices: take one of them away"
        else:
            kind, apart = "thin_gap", f"are {distance:.3g} mm apart"
            text += f"{apart}, too thin for single precision in a scene of this size"
            power = 10.0 ** np.floor(np.log10(narrowest))  # of one significant digit, rounded up
            least = np.ceil(narrowest / power) * power
            mend = f"make the gap at least {least:g} mm, or one single face"
        problems.append(SceneProblem(kind, text, mend, *file.place_of_id(other_name)))
    return problems


def _overlap(first: FlatFace, second: FlatFace) -> bool:
    """Whether two parallel faces share area when projected along their normal."""
    grid = (np.arange(16) + 0.5) / 16
    a, b = (g.ravel()[:, None] for g in np.meshgrid(grid, grid))
    for face, opposite in ((first, second), (second, first)):
        u, v = (a * (1 - b), b) if face.triangle else (a, b)
        points = face.corner + u * face.edge_u + v * face.edge_v
        if (np.minimum(face.margin(points), opposite.margin(points)) > 1e-6).any():
            return True
    return False


def _problems_of_detector(simulation: Simulation) -> list[SceneProblem]:
    """A detector that no light reaches, or light that is lost on the way."""
    try:
        result = simulation.collect(SCOUTS)
    except InputError as error:
        return [SceneProblem("leak", error.problem, error.mend, simulation.file.path)]
    if result.budget["detected"] > 0:
        return []
    detector = next(s for s in simulation.model.surfaces if s.kind == DETECTOR)
    text = f"no light can reach the detector {detector.name}: none of {SCOUTS:,} photons did"
    mend = "look for something opaque before it, or for a detector in the wrong place"
    return [SceneProblem("detector", text, mend, *simulation.file.place_of_id(detector.name))]


# ---- what the scene means -------------------------------------------------------------


def describe(simulation: Simulation, interfaces: Sequence[Interface], transport: str) -> list[str]:
    """What light can do in a scene; `transport` names the path that `simulate` will take."""
    model = simulation.model
    indices = volume_indices(interfaces)
    numbers = range(1, len(model.volumes))
    sentences = [_volume_sentence(model, number, indices, simulation.crystal) for number in numbers]
    detectors = []
    for surface in model.surfaces:
        if surface.kind == DETECTOR:
            slanted = f" within {surface.acceptance_deg:.4g} degrees of its normal"
            detectors.append(surface.name + (slanted if surface.acceptance_deg < 90.0 else ""))
    sentences.append(f"detected is what reaches {' or '.join(detectors)}")
    if model.counted is not None:
        sentences.append(f"eta is that of {model.detectors[model.counted]} alone")
    for surface in model.surfaces:
        sentences += _surface_sentences(surface)
    shapes = model.scene.shapes()
    sentences += [f"{shape.id()} {shape.words}" for shape in shapes if hasattr(shape, "words")]
    imperfect: dict[str, list[str]] = {}
    for surface in model.surfaces:
        if surface.painted:
            paint = surface.seen
            says = f"painted, light from either side finds {paint.name}: {_reflects(paint)}"
            imperfect.setdefault(says, []).append(surface.name)
            continue
        for name, factor, says in _IMPERFECTIONS:
            if (value := factor * getattr(surface, name)) > 0:
                imperfect.setdefault(says.format(value), []).append(surface.name)
    sentences += [f"{what}: {', '.join(names)}" for what, names in imperfect.items()]
    sentences.append(
        "Fresnel reflection follows each photon's polarisation"
        if simulation.polarization
        else "Fresnel reflection is that of unpolarised light"
    )
    materials = simulation.file.materials.items()
    sentences += [f"{name} = {material.value}: {material.words}" for name, material in materials]
    return [*sentences, f"transport: {transport}"]


def _volume_sentence(
    model: SceneModel, number: int, indices: dict[str, float], crystal: CrystalVolume
) -> str:
    """Form, place, index and coefficients of a volume."""
    from mcrim_mitsuba.transport.solid_names import form_of

    volume, (lower, upper) = model.volumes[number], model.bounds(number)
    text = f"{volume.name}: {form_of(model, number)}"
    # without the rounding of single precision
    text += ", z from {:.5g} to {:.5g} mm".format(*(np.round((lower[2], upper[2]), 5) + 0.0))
    if volume.name in indices:
        text += f", index {indices[volume.name]:g}"
    if volume.alpha_scat_per_mm or volume.alpha_abs_per_mm:
        text += (
            f", scatters {MM_PER_CM * volume.alpha_scat_per_mm:.4g} /cm{_scattering(volume)} "
            f"and absorbs {MM_PER_CM * volume.alpha_abs_per_mm:.4g} /cm"
        )
    else:
        text += ", clear"
    if volume.endless:
        text += "; light that enters it goes straight on, to what it meets from outside"
    return text + (f"; {_emission(crystal)}" if number == crystal.volume else "")


def _surface_sentences(surface: Surface) -> list[str]:
    """What a surface does besides being an interface."""
    name, radius_mm, (x, y) = surface.name, surface.aperture_radius_mm, surface.axis_mm
    axis = f" about x = {x:g}, y = {y:g} mm" if x or y else ""
    reflected = f"reflects {100 * surface.mask_reflectance:g} % diffusely upwards"
    sentences_if = {
        f"{name} wears a black mask with a hole of radius {radius_mm:g} mm{axis}": radius_mm
        < np.inf,
        f"the mask of {name} {reflected}": surface.mask_reflectance > 0,
        f"{name} {_reflects(surface)}": surface.reflectance > 0,
        f"{name} does what Mitsuba's {surface.plugin} does": surface.plugin,
        f"{name} loses what its facets send on to others, which a polish with roughness_alpha "
        "follows": surface.plugin == "RoughDielectric",
    }
    sentences = [sentence for sentence, holds in sentences_if.items() if holds]
    if surface.film is not None:
        oblique = surface.film.absorptance(0.5) / surface.film.head_on
        sentences.append(
            f"{name} is a photocathode: it absorbs {100 * surface.film.head_on:.4g} % of light "
            f"head-on, which counts 1, and at 60 degrees {oblique:.3g} times as much"
        )
    return sentences


def _reflects(surface: Surface) -> str:
    """How much a reflector reflects, and how."""
    mirrors = f", {100 * surface.mirror_part:g} % of that as a mirror"
    how = mirrors if surface.mirror_part else " diffusely"
    return f"reflects {100 * surface.reflectance:g} %{how}"


def _emission(crystal: CrystalVolume) -> str:
    """Where the light comes from."""
    from mcrim_mitsuba.transport.bulk import CollimatedBeam

    if isinstance(crystal, CollimatedBeam):
        return (
            f"a beam {crystal.diameter_mm:g} mm wide enters it from outside, through its middle, "
            f"along +{'xyz'[crystal.axis]}"
        )
    where = "uniformly"
    if np.isfinite(crystal.source_depth_mm):
        where = f"falling to 1/e every {crystal.source_depth_mm:g} mm below its top"
    if np.isfinite(crystal.side_depth_mm):
        where = f"falling to 1/e every {crystal.side_depth_mm:g} mm from its side of the lowest x"
    extent = crystal.born_upper - crystal.born_lower
    whole = crystal.upper - crystal.lower
    if extent[2] < whole[2]:
        levels = (crystal.born_lower[2], crystal.born_upper[2]) - crystal.lower[2]
        where += ", from {:.5g} to {:.5g} mm above its bottom only".format(*levels)
    if extent[0] < whole[0]:
        where += f", within {extent[0]:.5g} mm about its axis only"
    return f"photons are born in it, {where} and in all directions"


def _scattering(volume: Volume) -> str:
    """How a volume scatters, where it is not evenly."""
    phases = {"hg": f"Henyey-Greenstein with g = {volume.scattering_g:g}", "rayleigh": "Rayleigh"}
    words = [phases[volume.phase]] if volume.phase in phases else []
    if volume.scattering_gradient:
        words.append(f"{100 * volume.scattering_gradient:+g} % of it at the top")
    if volume.scattering_exponent:
        power, band = volume.scattering_exponent, 100 * volume.relative_bandwidth
        words.append(f"of its own light as wavelength^-{power:g} over a band {band:.3g} % wide")
    return f" ({', '.join(words)})" if words else ""


#: What a surface does less well than an ideal one, by the attribute that tells how much.
_IMPERFECTIONS = (
    ("roughness", 1, "rough (alpha = {:g})"),
    ("hazy_part", 100, "hazy ({:.3g} % of what is reflected inwards head-on is scattered)"),
    ("surface_loss", 100, "{:g} % of what is reflected inwards is lost"),
    ("contact", 100, "{:g} % of what comes from inside meets the wrapping at once"),
    ("ground_loss", 100, "{:g} % of what comes from inside is lost before it is reflected"),
    ("specular", 100, "{:g} % is reflected as by a mirror"),
    ("angular_falloff", 100, "detection falls by {:g} % towards grazing incidence"),
    ("angular_falloff", -100, "detection rises by {:g} % towards grazing incidence"),
    ("radial_falloff_per_mm2", 100, "detection falls by {:.3g} % of (r / mm)^2 away from the axis"),
)


def volume_indices(interfaces: Iterable[Interface]) -> dict[str, float]:
    """Index of every named volume, from its faces."""
    return {volume: claims[0][0] for volume, claims in claimed_indices(interfaces).items()}
