"""The bench that a scene describes, for programs that know no scenes: by its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.scene.spectrophotometer import BEAM_PARAMETERS, spectrophotometer_of
from mcrim_mitsuba.transport.scene_model import DETECTOR, SceneModel

if TYPE_CHECKING:
    from mcrim_mitsuba.optics.thin_film import ThinFilm
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
    name = next((one for known, one in _BY_PARAMETER.items() if known in parameters), "camoo4.xml")
    known = read_scene(scene_path(name))
    for effect in effects:
        known = known.edited(add(effect, known))
    if _beam_axis(simulation) is not None:
        # an effect on the crystal acts on both
        name, known = "spectrophotometer.xml", spectrophotometer_of(known)
    own = {key: value for key, value in parameters.items() if key in known.parameters}
    meant = Simulation(known, own, variant=simulation.variant, check=False)
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
    own, expected = _described(model), _described(meant)
    for name in {**expected, **own}:
        ours, meant_to_be = own.get(name, []), expected.get(name, [])
        if len(ours) != len(meant_to_be) or any(
            a[0] != b[0] or not np.allclose(a[1], b[1], atol=1e-4)
            for a, b in zip(ours, meant_to_be, strict=True)
        ):
            return name
    return None


def _film_numbers(film: ThinFilm | None) -> tuple[float, ...]:
    if film is None:
        return (0.0,) * 4
    return film.index.real, film.index.imag, film.wavelengths, film.window_index


def _described(model: SceneModel) -> dict[str, list[tuple]]:
    """Faces of every surface: what they are, and their numbers."""
    found: dict[str, list[tuple]] = {}
    faces = [
        (
            face.surface,
            [
                *face.corner,
                *face.edge_u,
                *face.edge_v,
                0.0 if face.circle is None else face.circle.radius_mm,
            ],
        )
        for face in model.flat_faces
    ]
    faces += [
        (
            wall.surface,
            [
                *np.concatenate(wall.bounds()),
                wall.circle.radius_mm,
                wall.circle.axis,
                wall.outwards,
            ],
        )
        for wall in model.walls
    ]
    for number, place in faces:
        surface = model.surfaces[number]
        sides = [model.volumes[i] for i in (surface.interior, surface.exterior)]
        words = (surface.kind, surface.two_sided, *(v.phase for v in sides))
        numbers = [
            *place,
            surface.eta,
            surface.reflectance,
            min(surface.aperture_radius_mm, 1e6),
            *surface.axis_mm,
            surface.roughness,
            surface.surface_loss,
            surface.haze,
            surface.acceptance_deg,
            surface.specular,
            surface.angular_falloff,
            surface.radial_falloff_per_mm2,
            surface.mask_reflectance,
            *_film_numbers(surface.film),
            *(v.alpha_scat_per_mm for v in sides),
            *(v.alpha_abs_per_mm for v in sides),
            *(v.scattering_g for v in sides),
            *(v.scattering_gradient for v in sides),
            *(v.scattering_exponent for v in sides),
            *(v.relative_bandwidth for v in sides),
        ]
        # there is one, whatever it is called
        name = "detector" if surface.kind == DETECTOR else surface.name
        found.setdefault(name, []).append((words, numbers))
    return found
