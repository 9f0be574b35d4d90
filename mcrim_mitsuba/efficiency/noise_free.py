"""Scenes for programs that know none: the bench that a scene is, and eta of it without photons."""

from __future__ import annotations

import cmath
import time
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.efficiency.polished_box import solve_box
from mcrim_mitsuba.efficiency.table import EtaTable, TableGrid
from mcrim_mitsuba.runs.cache import record_versions
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.transport.scene_model import DETECTOR, FlatFace, RoundWall, SceneModel
from mcrim_mitsuba.transport.simulation import Simulation, SimulationResult, calibration_notes

#: Ways to eta.
METHODS = ("photons", "modes")
#: Its name in progress.
_WHAT = "solving without photons"
#: What the reader must know of eta by modes.
NOTE = (
    "no photons were followed: there is no statistical noise, and errors are the method's own "
    "estimates, from fewer modes and nodes"
)


def refuse_method(method: str, run: Run) -> None:
    """Refuse (InputError) a method that there is not, and photons for one that follows none."""
    if method not in METHODS:
        raise InputError(f"there is no method {method}", f"take {' or '.join(METHODS)}")
    if method == "modes" and run.photons is not None:
        problem = "the method modes follows no photons, and photons was given"
        raise InputError(problem, "leave photons out, or take the method photons")


def solve_simulation(simulation: Simulation, run: Run = Run()) -> SimulationResult:
    """Light collection efficiency and fates of a loaded scene, of 0 photons.

    Where a relative error of eta is enough, as the run's precision says, it takes less time.

    Raises InputError if the bench is not one that the solver knows.
    """
    start = time.perf_counter()
    file = simulation.file
    run.tell(_WHAT, 0, 1)
    with placed(path=file.path):
        solved = solve_box(bench_of(simulation), precision=run.precision)
    run.tell(_WHAT, 1, 1)
    notes = _notes(solved.eta, solved.error, run.precision)
    notes += calibration_notes(simulation.model.head_on)
    fates = {name: float(part) for name, part in solved.fates.items() if part}
    eta, error = float(solved.eta), float(solved.error)
    return SimulationResult(
        seed=0,
        photons=0,
        cached_photons=0,
        scene_hash=file.content_hash,
        versions=record_versions(simulation.variant, __name__),
        seconds=time.perf_counter() - start,
        notes=notes,
        requested=0,
        interrupted=False,
        eta=eta,
        eta_sigma=error,
        budget=fates,
        budget_sigma=dict.fromkeys(fates, error),
        parameters=dict(file.parameters),
        polarization=False,
        transport="cosine modes",
    )


def noise_free_table(
    scene: str | Path | SceneFile, axes: Mapping[str, Sequence[Value]], *, run: Run = Run()
) -> EtaTable:
    """Table of eta over the axes of `efficiency.table.eta_table`, without photons.

    Raises InputError if the scene is not sound or lacks one of the parameters, a value is out of
    range, or a bench is not one that the solver knows.
    """
    file = read_scene(scene)
    grid = TableGrid.of(file, axes)
    absorption, scattering = (np.array(grid.inner[name], float) for name in (ALPHA_ABS, ALPHA_SCAT))
    benches = [
        file.with_overrides(dict(zip(grid.outer, values, strict=True)))
        for values in grid.configurations
    ]
    solved = solve_benches(benches, scattering, absorption[:, None], run)
    eta, error = (np.array(part).reshape(grid.shape) for part in zip(*solved, strict=True))
    return EtaTable(
        axes=grid.axes,
        eta=eta,
        eta_sigma=error,
        photons=0,
        cached_photons=0,
        seed=0,
        parameters=dict(file.parameters),
        scene_hash=file.content_hash,
        notes=_notes(eta, error, run.precision),
    )


def solve_benches(
    benches: Sequence[SceneFile],
    alpha_scat_per_cm: ArrayLike,
    alpha_abs_per_cm: ArrayLike,
    run: Run,
) -> list[tuple[Array, Array]]:
    """Efficiency and its error at the same coefficients, which broadcast, of several benches.

    Raises InputError if a scene is not sound, or a bench is not one that the solver knows.
    """
    etas = []
    for number, file in enumerate(benches):
        run.tell(_WHAT, number, len(benches))
        simulation = Simulation(file, variant=run.variant, threads=run.threads, check=run.check)
        with placed(path=file.path):
            bench = bench_of(simulation)
            solved = solve_box(bench, alpha_scat_per_cm, alpha_abs_per_cm, precision=run.precision)
        etas.append((solved.eta, solved.error))
    run.tell(_WHAT, len(benches), len(benches))
    return etas


def _notes(eta: ArrayLike, error: ArrayLike, precision: float | None) -> tuple[str, ...]:
    """What is to be said of errors, and where they are larger than was asked for."""
    largest = float(np.max(np.divide(error, eta)))
    if precision is None or largest <= precision:
        return (NOTE,)
    return NOTE, (
        f"the precision asked for is {100 * precision:g} %; this method comes to "
        f"{100 * largest:.2g} % here"
    )


# The bench that a loaded scene is, told by its parameters.


def bench_of(simulation: Simulation) -> Bench:
    """The bench that a loaded scene is.

    Raises InputError if the scene has parameters that `Bench` does not know, or is another bench
    than they describe.
    """
    with placed(path=simulation.file.path):
        bench = Bench.from_parameters(simulation.file.parameters)
    # the shipped scene, with effects as `add` puts them there, is what the parameters mean
    parameters = simulation.file.parameters
    name = "camoo4.xml"
    scene = read_scene(scene_path(name))
    for effect in catalogue().values():
        if effect.parameters and effect.is_in(simulation.file) and not effect.is_in(scene):
            scene = scene.edited(add(effect.name, scene))
    overrides = {key: value for key, value in parameters.items() if key in scene.parameters}
    meant = Simulation(scene, overrides, variant=simulation.variant, check=False)
    file, path, line = simulation.file, simulation.file.path, None
    where = _first_difference(simulation.model, meant.model)
    if where in [surface.name for surface in simulation.model.surfaces]:
        path, line = file.place_of_id(where)
    elif where is None and not _alike(_emission(simulation), _emission(meant)):
        where = "its emitter"
        path, line = file.place_of(next(file.root.iter("emitter")))
    elif where is None and simulation.polarization != meant.polarization:
        where = "its polarization"
    elif where is None and simulation.integrator.max_depth != meant.integrator.max_depth:
        where = "its max_depth"
    if where is not None:
        problem = f"the solver without photons knows the bench of {name} only"
        problem += f", and this scene differs from it at {where}"
        mend = "take a bench of that form, or simulate photons"
        raise InputError(problem, mend, path=path, line=line)
    return bench


def _emission(simulation: Simulation) -> tuple:
    """Where light is born: in which volume, its depth below a face, or the axis of a beam."""
    crystal = simulation.crystal
    box, axis = (crystal.lower, crystal.upper), getattr(crystal, "axis", None)
    return *box, crystal.source_depth_mm, crystal.side_depth_mm, crystal.in_part, axis


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


#: Numbers and names that are a scene's own.
_NOT_COMPARED = ("name", "surface", "interior", "exterior")


def _alike(ours: Any, theirs: Any) -> bool:
    """Whether two parts of scenes are the same, but for rounding."""
    if is_dataclass(ours) and type(ours) is type(theirs):
        names = [field.name for field in fields(ours) if field.name not in _NOT_COMPARED]
        return all(_alike(getattr(ours, name), getattr(theirs, name)) for name in names)
    if isinstance(ours, (list, tuple, np.ndarray)):
        return len(ours) == len(theirs) and all(map(_alike, ours, theirs))
    if ours is None or theirs is None or isinstance(ours, str):
        return ours == theirs
    return cmath.isclose(ours, theirs, rel_tol=1e-5, abs_tol=1e-4)
