"""The bench that a scene describes, for programs that know no scenes: by its parameters."""

from __future__ import annotations

import cmath
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.scene.spectrophotometer import BEAM_PARAMETERS, spectrophotometer_of
from mcrim_mitsuba.transport.scene_model import DETECTOR, FlatFace, RoundWall, SceneModel

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation

#: Effects without a parameter, which the tracer switches on by name.
_SWITCHES = ("rayleigh_scattering", "aperture_at_detector")


#: Scenes that are known besides the plain bench, by a parameter that they alone have.
_BY_PARAMETER = {
    "wrap_reflectance": "camoo4_wrapped.xml",
    "crystal_length_mm": "camoo4_cylinder_lying.xml",
    "crystal_diameter_mm": "camoo4_cylinder.xml",
}


def bench_of(simulation: Simulation) -> Bench:
    """The bench that a loaded scene is.

    Raises
    ------
    InputError
        If the scene has parameters that `Bench` does not know, or is another bench than they
        describe.
    """
    from mcrim_mitsuba.transport.solid_names import named_form

    with placed(path=simulation.file.path):
        form = named_form(simulation.model, simulation.crystal.volume)
        if form is not None and not form.startswith(("cylinder", "disc")):
            problem = f"the independent programs know boxes and cylinders; this is a {form}"
            raise InputError(problem, "take a crystal of such a form")
        effects = [e.name for e in catalogue().values() if e.is_in(simulation.file)]
        switches = {name: True for name in effects if name in _SWITCHES}
        beam = BEAM_PARAMETERS if _beam_axis(simulation) is not None else {}
        slopes = {s.beckmann for s in simulation.model.surfaces if s.roughness}
        if len(slopes) > 1:
            problem = "the independent programs know one distribution of slopes for all rough faces"
            raise InputError(problem, "give each polish the same distribution")
        switches["beckmann"] = slopes == {True}
        bench = Bench.from_parameters({**beam, **simulation.file.parameters, **switches})
    _refuse_other_benches(simulation, effects)
    return bench


def _refuse_other_benches(simulation: Simulation, effects: list[str]) -> None:
    """Refuse a scene that is not the bench which the tracer builds from its parameters.

    The shipped scenes, with effects as `add` puts them there, are what the parameters mean;
    comparing another scene with the tracer would look like an error of one of the two.
    """
    from mcrim_mitsuba.transport.simulation import Simulation

    parameters = simulation.file.parameters
    name = next((file for key, file in _BY_PARAMETER.items() if key in parameters), "camoo4.xml")
    scene = read_scene(scene_path(name))
    for effect in effects:
        scene = scene.edited(add(effect, scene))
    if _beam_axis(simulation) is not None:
        # an effect on the crystal acts on both
        name, scene = "spectrophotometer.xml", spectrophotometer_of(scene)
    overrides = {key: value for key, value in parameters.items() if key in scene.parameters}
    meant = Simulation(scene, overrides, variant=simulation.variant, check=False)
    file, path, line = simulation.file, simulation.file.path, None
    where = _first_difference(simulation.model, meant.model)
    if where in [surface.name for surface in simulation.model.surfaces]:
        path, line = file.place_of_id(where)
    elif where is None and _emission(simulation) != _emission(meant):
        where = "its emitter"
        path, line = file.place_of(next(file.root.iter("emitter")))
    elif where is None and simulation.polarization != meant.polarization:
        where = "its polarization"
    if where is not None:
        raise InputError(
            f"the independent programs know the bench of {name} only, and this scene differs from "
            f"it at {where}",
            "take a bench of that form",
            path=path,
            line=line,
        )


def _emission(simulation: Simulation) -> tuple:
    """Where light is born: its depth below a face, or the axis and the width of a beam."""
    crystal = simulation.crystal
    beam = _beam_axis(simulation), getattr(crystal, "diameter_mm", None)
    return crystal.source_depth_mm, crystal.side_depth_mm, *beam


def _beam_axis(simulation: Simulation) -> int | None:
    """0, 1 or 2; ``None`` where light is born in the crystal."""
    return getattr(simulation.crystal, "axis", None)


def _first_difference(model: SceneModel, meant: SceneModel) -> str | None:
    """Name of a surface in which two scenes differ; ``None`` where they are alike."""
    if model.faces is None:
        return model.surfaces[model.curved[0]].name
    parts, meant_parts = _parts(model), _parts(meant)
    for name in {**meant_parts, **parts}:
        if not _alike(parts.get(name, []), meant_parts.get(name, [])):
            return name
    return None


def _parts(model: SceneModel) -> dict[str, list[tuple]]:
    """Faces and walls of every surface, with it and the volumes on its sides."""
    parts: dict[str, list[tuple]] = {}
    flat_and_round: list[FlatFace | RoundWall] = [*model.flat_faces, *model.walls]
    for part in flat_and_round:
        surface = model.surfaces[part.surface]
        # there is one, whatever it is called
        name = "detector" if surface.kind == DETECTOR else surface.name
        volumes = [model.volumes[side] for side in surface.sides]
        parts.setdefault(name, []).append((part, surface, surface.acceptance_deg, *volumes))
    return parts


#: Numbers and names that are a scene's own; `Bench.beckmann` is read from the scene itself.
_NOT_COMPARED = ("name", "surface", "interior", "exterior", "beckmann")


def _alike(one: Any, other: Any) -> bool:
    """Whether two parts of scenes are the same, but for rounding."""
    if is_dataclass(one) and type(one) is type(other):
        names = [field.name for field in fields(one) if field.name not in _NOT_COMPARED]
        return all(_alike(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, (list, tuple, np.ndarray)):
        return len(one) == len(other) and all(map(_alike, one, other))
    if one is None or other is None or isinstance(one, str):
        return one == other
    return cmath.isclose(one, other, rel_tol=1e-5, abs_tol=1e-4)
