"""Tables of the light collection efficiency over the coefficients and the coupling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import write_text
from mcrim_mitsuba.core.numbers import Value, judge
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.recording import (
    MOST_PHOTONS,
    Point,
    RecordRun,
    SurfaceWish,
    record_surfaces,
    surfaces_answer,
)
from mcrim_mitsuba.efficiency.reweighting import EtaSurface
from mcrim_mitsuba.efficiency.simulate import collect
from mcrim_mitsuba.efficiency.surface import EtaPoint
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

COLUMNS = ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm", "eta", "eta_sigma")
DEFAULT_PHOTONS = 2_000_000


@dataclass(frozen=True)
class TableRow:
    """One point: the columns of the CSV."""

    n_gap: float
    alpha_abs_per_cm: float
    alpha_scat_per_cm: float
    eta: float
    eta_sigma: float


@dataclass(frozen=True)
class EtaTable:
    """A table of eta."""

    #: By n_gap, then alpha_abs, then alpha_scat, in the order asked for.
    rows: tuple[TableRow, ...]
    #: Photons that the rows rest on, and how many of them the cache had.
    photons: int
    cached_photons: int
    seed: int
    #: Points that were simulated on their own, and how many of the photons that took.
    own_points: int = 0
    own_photons: int = 0
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...] = ()

    def joined(self, other: EtaTable) -> EtaTable:
        """Both tables' rows, one after the other."""
        return EtaTable(
            self.rows + other.rows,
            self.photons + other.photons,
            self.cached_photons + other.cached_photons,
            self.seed,
            self.own_points + other.own_points,
            self.own_photons + other.own_photons,
            # what goes wrong with the cache goes wrong every time
            tuple(dict.fromkeys(self.notes + other.notes)),
        )

    def write(self, path: str | Path) -> None:
        """Write the table as CSV.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        lines = [",".join(COLUMNS)]
        lines += [",".join(f"{getattr(row, name):.8g}" for name in COLUMNS) for row in self.rows]
        write_text(path, "\n".join(lines) + "\n")


def eta_table(
    scene: str | Path | SceneFile,
    alpha_scat_per_cm: float | Sequence[float],
    alpha_abs_per_cm: float | Sequence[float],
    n_gap: float | Sequence[float],
    *,
    overrides: Mapping[str, Value] | None = None,
    run: Run = Run(),
) -> EtaTable:
    """Eta at every combination of coefficients and couplings, from one simulation per coupling.

    Points that its photons say too little about are simulated on their own. What is asked for
    twice is simulated once.

    Parameters
    ----------
    scene : str, Path or SceneFile
    alpha_scat_per_cm, alpha_abs_per_cm, n_gap : float or sequence of float
    overrides : mapping, optional
        Scene parameters that differ from the file's.
    run : Run
        Its photons (2 million, with a precision as many as it takes) are those of a coupling, and
        again of each point that is simulated on its own. Photon records round them up to a
        multiple of `transport.launch_plan.LANES`. Its precision is that of every point.

    Raises
    ------
    InputError
        If the scene is not sound or lacks one of the parameters, or a value is out of range.
    """
    file = scene if isinstance(scene, SceneFile) else read_scene(scene)
    file = file.with_overrides(overrides or {})
    varied = {
        "alpha_scat_per_cm": np.atleast_1d(alpha_scat_per_cm).tolist(),
        "alpha_abs_per_cm": np.atleast_1d(alpha_abs_per_cm).tolist(),
        "n_gap": np.atleast_1d(n_gap).tolist(),
    }
    _refuse(file, varied)
    points = [(a_s, a_a) for a_a in varied["alpha_abs_per_cm"] for a_s in varied[
        "alpha_scat_per_cm"]]  # fmt: skip
    distinct = list(dict.fromkeys(points))
    indices = list(dict.fromkeys(varied["n_gap"]))
    benches = {index: file.with_overrides({"n_gap": index}) for index in indices}
    precision = run.precision
    run = replace(run, photons=run.photons_or(MOST_PHOTONS if precision else DEFAULT_PHOTONS))
    scattering = [point for point in distinct if point[0] > 0.0]
    wishes = {
        index: SurfaceWish(_name(index), bench, scattering, run)
        for index, bench in benches.items()
        if scattering and surfaces_answer(bench)
    }
    surfaces = dict(zip(wishes, record_surfaces(list(wishes.values())), strict=True))
    made = EtaTable((), 0, 0, run.seed)
    for index, bench in benches.items():
        made = made.joined(_coupling(bench, index, run, distinct, surfaces.get(index)))
    known = {(row.n_gap, row.alpha_scat_per_cm, row.alpha_abs_per_cm): row for row in made.rows}
    rows = tuple(known[index, *point] for index in varied["n_gap"] for point in points)
    notes = list(made.notes)
    if made.own_points:
        notes.append(
            f"{made.own_points} of {len(made.rows)} points, about which photon records say too "
            f"little, were simulated on their own: {made.own_photons:,} of {made.photons:,} photons"
        )
    worst = max((row.eta_sigma / row.eta for row in rows if row.eta > 0), default=0.0)
    if precision and worst > 1.2 * precision:
        notes.append(
            f"the wanted precision of {100 * precision:g} % was not reached: errors go up to "
            f"{100 * worst:.2g} %"
        )
    return replace(made, rows=rows, notes=tuple(notes))


def _coupling(
    bench: SceneFile,
    index: float,
    run: Run,
    points: list[Point],
    known: tuple[EtaSurface, RecordRun] | None,
) -> EtaTable:
    """The rows of one coupling, from its surface where that knows enough."""
    from mcrim_mitsuba.transport.simulation import Simulation

    own_points = own_photons = 0
    found: list[EtaPoint | None] = [None] * len(points)
    notes: list[str] = []
    spent = cached = 0
    if known is not None:
        surface, records = known
        spent, cached = records.photons, records.cached_photons
        found = surface.evaluate_all(points)
        notes += records.notes
    rows = []
    for (a_s, a_a), point in zip(points, found, strict=True):
        if point is not None:
            rows.append(TableRow(index, a_a, a_s, point.eta, point.sigma))
            continue
        coefficients = {"alpha_scat_per_cm": a_s, "alpha_abs_per_cm": a_a}
        simulation = Simulation(bench, coefficients, variant=run.variant, threads=run.threads)
        own = collect(simulation, run=run, what=_name(index))
        if own.interrupted:
            raise KeyboardInterrupt  # one point cut short is no table
        own_points, own_photons = own_points + 1, own_photons + own.photons
        cached += own.cached_photons
        place = f"{_name(index)}, alpha_scat = {a_s:g} /cm, alpha_abs = {a_a:g} /cm"
        notes += [f"{place}: {note}" for note in own.notes]
        rows.append(TableRow(index, a_a, a_s, own.eta, own.eta_sigma))
    return EtaTable(
        rows=tuple(rows),
        photons=spent + own_photons,
        cached_photons=cached,
        seed=run.seed,
        own_points=own_points,
        own_photons=own_photons,
        notes=tuple(notes),
    )


def _name(index: float) -> str:
    return f"n_gap = {index:g}"


def _refuse(file: SceneFile, varied: dict[str, list[float]]) -> None:
    for name, values in varied.items():
        if name not in file.parameters:
            raise InputError(
                f"the scene has no parameter {name}",
                "a table varies n_gap, alpha_abs_per_cm and alpha_scat_per_cm: declare it",
                path=file.path,
            )
        if name in file.overrides:
            raise InputError(
                f"{name} is both varied by the table and given a value", "leave one of them out"
            )
        if not values:
            raise InputError(f"there is no value of {name}", "give one at least")
        for value in values:
            wrong = judge(name, value)
            if wrong is not None:
                raise InputError(f"{name} = {value:g}: {wrong[1]}", wrong[2])
