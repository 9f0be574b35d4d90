"""Scenes solved without photons, where the bench is one that `polished_box` knows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.polished_box import solve_box
from mcrim_mitsuba.efficiency.scene_bench import bench_of
from mcrim_mitsuba.efficiency.table import EtaTable, TableGrid
from mcrim_mitsuba.runs.cache import record_versions
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.transport.simulation import SimulationResult, calibration_notes

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation

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
    """Refuse a method that there is not, and photons for one that follows none.

    Raises
    ------
    InputError
    """
    if method not in METHODS:
        raise InputError(f"there is no method {method}", f"take {' or '.join(METHODS)}")
    if method == "modes" and run.photons is not None:
        problem = "the method modes follows no photons, and photons was given"
        raise InputError(problem, "leave photons out, or take the method photons")


def solve_simulation(simulation: Simulation, run: Run = Run()) -> SimulationResult:
    """Light collection efficiency and fates of a loaded scene, of 0 photons.

    Where a relative error of eta is enough, as the run's precision says, it takes less time.

    Raises
    ------
    InputError
        If the bench is not one that the solver knows.
    """
    start = time.perf_counter()
    file = simulation.file
    run.tell(_WHAT, 0, 1)
    with placed(path=file.path):
        found = solve_box(bench_of(simulation), precision=run.precision)
    run.tell(_WHAT, 1, 1)
    notes = _notes(found.eta, found.error, run.precision)
    notes += calibration_notes(simulation.model.head_on)
    fates = {name: float(part) for name, part in found.fates.items() if part}
    eta, error = float(found.eta), float(found.error)
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
    """As `efficiency.table.eta_table`, without photons.

    Raises
    ------
    InputError
        If the scene is not sound or lacks one of the parameters, a value is out of range, or a
        bench is not one that the solver knows.
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

    Raises
    ------
    InputError
        If a scene is not sound, or a bench is not one that the solver knows.
    """
    from mcrim_mitsuba.transport.simulation import Simulation

    found = []
    for number, file in enumerate(benches):
        run.tell(_WHAT, number, len(benches))
        simulation = Simulation(file, variant=run.variant, threads=run.threads, check=run.check)
        with placed(path=file.path):
            solved = solve_box(
                bench_of(simulation), alpha_scat_per_cm, alpha_abs_per_cm, precision=run.precision
            )
        found.append((solved.eta, solved.error))
    run.tell(_WHAT, len(benches), len(benches))
    return found


def _notes(eta: ArrayLike, error: ArrayLike, precision: float | None) -> tuple[str, ...]:
    """What is to be said of errors, and where they are larger than was asked for."""
    largest = float(np.max(np.divide(error, eta)))
    if precision is None or largest <= precision:
        return (NOTE,)
    return NOTE, (
        f"the precision asked for is {100 * precision:g} %; this method comes to "
        f"{100 * largest:.2g} % here"
    )
