"""Tables of the light collection efficiency over the coefficients and the coupling."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.limits import judge
from mcrim_mitsuba.files.scene_xml import SceneFile, read_scene
from mcrim_mitsuba.files.writing import write_text

COLUMNS = ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm", "eta", "eta_sigma")
DEFAULT_PHOTONS = 2_000_000
#: With a wanted precision: photons of the first look, and the most that will be spent.
PILOT_PHOTONS, MOST_PHOTONS = 500_000, 200_000_000


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
    """A table of eta.

    Attributes
    ----------
    rows : tuple of TableRow
        By n_gap, then alpha_abs, then alpha_scat, in the order asked for.
    photons : int
        Photons spent.
    seed : int
    notes : tuple of str
        What the reader must know before using the numbers.
    """

    rows: tuple[TableRow, ...]
    photons: int
    seed: int
    notes: tuple[str, ...] = ()

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
    overrides: Mapping[str, object] | None = None,
    photons: int | None = None,
    precision: float | None = None,
    seed: int = 0,
    variant: str = "llvm_ad_rgb",
    threads: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> EtaTable:
    """Eta at every combination of coefficients and couplings, from one simulation per coupling.

    Points that its photons say too little about are simulated on their own.

    Parameters
    ----------
    scene : str, Path or SceneFile
    alpha_scat_per_cm, alpha_abs_per_cm, n_gap : float or sequence of float
    overrides : mapping, optional
        Scene parameters that differ from the file's.
    photons : int, optional
        Per coupling; with `precision`, at most.
    precision : float, optional
        Wanted relative standard error of every point.
    seed : int
        The same for all couplings.
    progress : callable, optional
        ``progress(what, done, total)``.

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
    scats, absorptions = varied["alpha_scat_per_cm"], varied["alpha_abs_per_cm"]
    rows, spent, notes = [], 0, []
    for index in varied["n_gap"]:
        report = _reporter(progress, f"n_gap = {index:g}")
        bench = file.with_overrides({"n_gap": index})
        found, photons_used, said = _coupling(
            bench, index, scats, absorptions, photons, precision, seed, variant, threads, report
        )
        notes += said
        rows += found
        spent += photons_used
    worst = max((row.eta_sigma / row.eta for row in rows if row.eta > 0), default=0.0)
    if precision and worst > 1.2 * precision:
        notes.append(
            f"the wanted precision of {100 * precision:g} % was not reached: errors go up to "
            f"{100 * worst:.2g} %"
        )
    return EtaTable(tuple(rows), spent, seed, tuple(notes))


def _coupling(bench, index, scats, absorptions, photons, precision, seed, variant, threads,
              report) -> tuple[list[TableRow], int, list[str]]:  # fmt: skip
    """Rows of one coupling, the photons they took, and notes."""
    from mcrim_mitsuba.kernel.records import PATIENCE, collect_surface
    from mcrim_mitsuba.kernel.simulation import Simulation

    simulation = Simulation(bench, variant=variant, threads=threads)
    points = [(scat, absorption) for absorption in absorptions for scat in scats]

    def collect(count: int):
        return collect_surface(
            simulation,
            photons=count,
            seed=seed,
            alpha_scat_range_per_cm=(min(scattering), max(scattering)),
            lowest_alpha_abs_per_cm=min(absorptions),
            progress=report,
        )

    most = photons or (MOST_PHOTONS if precision else DEFAULT_PHOTONS)
    scattering = [scat for scat in scats if scat > 0.0]
    if not scattering:
        surface, spent, found = None, 0, [None] * len(points)
    else:
        spent = min(PILOT_PHOTONS, most) if precision else most
        surface = collect(spent)
        found = [_by_weights(surface, *point) for point in points]
        worst = max((p.sigma / p.eta for p in found if p is not None), default=0.0)
        if precision and worst > precision and spent < most:
            # 10 % more, for the error of the error
            spent = min(most, int(spent * 1.1 * (worst / precision) ** 2))
            surface = collect(spent)
            found = [_by_weights(surface, *point) for point in points]
    rows, notes = [], []
    # Where light scatters it gets out in the end: nothing may be cut off.
    patience = PATIENCE * simulation.integrator.max_depth
    for (scat, absorption), point in zip(points, found, strict=True):
        if point is None:
            own = {"alpha_scat_per_cm": scat, "alpha_abs_per_cm": absorption}
            # the coupling has been checked, and coefficients are no part of its geometry
            own_bench = Simulation(bench, own, variant=variant, threads=threads, check=False)
            point = own_bench.collect(
                most, precision=precision, seed=seed, progress=report,
                max_depth=patience if scat > 0.0 else None,
            )  # fmt: skip
            spent += point.photons
            place = f"n_gap = {index:g}, alpha_scat = {scat:g} /cm, alpha_abs = {absorption:g} /cm"
            notes += [f"{place}: {note}" for note in point.notes]
            rows.append(TableRow(index, absorption, scat, point.eta, point.eta_sigma))
        else:
            rows.append(TableRow(index, absorption, scat, point.eta, point.sigma))
    return rows, spent, notes


def _by_weights(surface, scat: float, absorption: float):
    """The surface's value, or ``None`` where its photons say too little."""
    try:
        return surface.evaluate(scat, absorption)
    except InputError:
        return None


def _reporter(progress, what):
    if progress is None:
        return None
    return lambda done, total, *_: progress(what, done, total)


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
