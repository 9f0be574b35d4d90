"""Mitsuba against the independent NumPy tracer, on one scene, fate by fate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.reference.bench import Bench
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.scene.spectrophotometer import BEAM_PARAMETERS, spectrophotometer_of

if TYPE_CHECKING:
    from mcrim_mitsuba.reference.tracer import TracerResult
    from mcrim_mitsuba.transport.scene_model import SceneModel
    from mcrim_mitsuba.transport.simulation import Simulation, SimulationResult

#: A fate that fewer photons of the tracer met than this has no normal distribution yet.
FEWEST_COUNTS = 25
#: Effects without a parameter, which the tracer switches on by name.
_SWITCHES = ("rayleigh_scattering", "aperture_at_detector")
#: False-alarm level of the test of all rows together.
FAMILY_LEVEL = 0.01


@dataclass(frozen=True)
class CrosscheckRow:
    """One quantity from both programs."""

    #: ``eta`` or a fate; fractions of the emitted energy.
    quantity: str
    mitsuba: float
    mitsuba_sigma: float
    numpy: float
    numpy_sigma: float
    #: Difference over its standard error; ``None`` where too few photons met the fate.
    z: float | None


@dataclass(frozen=True)
class Crosscheck:
    """Result of `crosscheck`."""

    rows: tuple[CrosscheckRow, ...]
    #: Probability that the largest abs(z) of as many normal rows is at least this large
    #: (Bonferroni's bound, valid although the fates are correlated).
    family_p_value: float
    mitsuba_photons: int
    numpy_photons: int

    @property
    def agrees(self) -> bool:
        """Whether all comparisons together are as chance would have them."""
        return self.family_p_value >= FAMILY_LEVEL


def crosscheck(
    scene: str | Path | SceneFile,
    overrides: Mapping[str, Value] | None = None,
    *,
    mitsuba_photons: int | None = None,
    general: bool = False,
    run: Run = Run(),
) -> Crosscheck:
    """Run a scene in Mitsuba and in the NumPy tracer and compare every fate.

    Parameters
    ----------
    overrides : mapping, optional
        Scene parameters that differ from the file's.
    mitsuba_photons : int, optional
        Four times the NumPy tracer's when not given: they are cheap.
    general : bool
        Compare Mitsuba's general path even where the fast one would do.
    run : Run
        Its photons are the NumPy tracer's, a million if nothing is said; the two programs draw
        unrelated numbers from its seed. Its precision does not matter.

    Raises
    ------
    InputError
        If the scene cannot be read or is not sound, has parameters that the tracer does not know,
        or is another bench than these parameters describe.
    """
    from mcrim_mitsuba.transport.simulation import Simulation

    simulation = Simulation(scene, overrides, variant=run.variant, threads=run.threads)
    with placed(path=simulation.file.path):
        effects = [e.name for e in catalogue().values() if e.is_in(simulation.file)]
        switches = {name: True for name in effects if name in _SWITCHES}
        beam = BEAM_PARAMETERS if _beam_axis(simulation) is not None else {}
        bench = Bench.from_parameters({**beam, **simulation.file.parameters, **switches})
    _refuse_other_benches(simulation, effects)
    photons = run.photons_or(1_000_000)
    ours = simulation.collect(
        mitsuba_photons or 4 * photons, seed=run.seed, general=general,
        progress=lambda done, total, *_: run.tell("Mitsuba", done, total),
    )  # fmt: skip
    reference = trace(
        bench, photons, run.seed, max_depth=simulation.depth_limit,
        progress=lambda done: run.tell("NumPy", done, photons),
    )  # fmt: skip
    rows = [_row("eta", "detected", ours, reference)]
    for name in {**ours.budget, **reference.budget}:
        if name != "detected" and (ours.budget.get(name, 0.0) or reference.counts.get(name, 0)):
            rows.append(_row(name, name, ours, reference))
    scores = [abs(row.z) for row in rows if row.z is not None]
    return Crosscheck(
        rows=tuple(rows),
        family_p_value=min(1.0, len(scores) * 2.0 * float(ndtr(-max(scores)))),
        mitsuba_photons=ours.photons,
        numpy_photons=reference.photons,
    )


def _refuse_other_benches(simulation: Simulation, effects: list[str]) -> None:
    """Refuse a scene that is not the bench which the tracer builds from its parameters.

    The shipped scenes, with effects as `add` puts them there, are what the parameters mean;
    comparing another scene with the tracer would look like an error of one of the two.
    """
    from mcrim_mitsuba.transport.simulation import Simulation

    parameters = simulation.file.parameters
    name = "camoo4_wrapped.xml" if "wrap_reflectance" in parameters else "camoo4.xml"
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
            f"the NumPy tracer knows the bench of {name} only, and this scene differs from it at "
            f"{where}", "cross-check a bench of that form", path=path, line=line,
        )  # fmt: skip


def _emission(simulation: Simulation) -> tuple:
    """Where light is born: its depth below the top, or the axis and the width of a beam."""
    crystal = simulation.crystal
    return crystal.source_depth_mm, _beam_axis(simulation), getattr(crystal, "diameter_mm", None)


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


def _described(model: SceneModel) -> dict[str, list[tuple]]:
    """Faces of every surface: what they are, and their numbers."""
    from mcrim_mitsuba.transport.scene_model import DETECTOR

    found: dict[str, list[tuple]] = {}
    for face in model.flat_faces:
        surface = model.surfaces[face.surface]
        sides = [model.volumes[i] for i in (surface.interior, surface.exterior)]
        words = (surface.kind, surface.two_sided, *(v.phase for v in sides))
        numbers = [
            *face.corner, *face.edge_u, *face.edge_v, surface.eta, surface.reflectance,
            min(surface.aperture_radius_mm, 1e6), *surface.aperture_centre_mm,
            surface.roughness, surface.surface_loss, surface.haze,
            surface.acceptance_deg,
            surface.angular_falloff, surface.radial_falloff_per_mm2,
            *(v.alpha_scat_per_mm for v in sides), *(v.alpha_abs_per_mm for v in sides),
            *(v.scattering_g for v in sides), *(v.scattering_gradient for v in sides),
        ]  # fmt: skip
        # there is one, whatever it is called
        name = "detector" if surface.kind == DETECTOR else surface.name
        found.setdefault(name, []).append((words, numbers))
    return found


def _row(
    quantity: str, fate: str, ours: SimulationResult, reference: TracerResult
) -> CrosscheckRow:
    a, sigma_a = ours.budget.get(fate, 0.0), ours.budget_sigma.get(fate, 1.0 / ours.photons)
    b, sigma_b = reference.budget.get(fate, 0.0), reference.budget_sigma.get(fate, 0.0)
    few = max(a * reference.photons, reference.counts.get(fate, 0)) < FEWEST_COUNTS
    z = None if few else (a - b) / math.hypot(sigma_a, sigma_b)
    return CrosscheckRow(quantity, a, sigma_a, b, sigma_b, z)
