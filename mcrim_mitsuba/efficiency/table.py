"""Tables of the light collection efficiency over any parameters of a scene."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.files import write_text
from mcrim_mitsuba.core.numbers import (
    ALPHA_ABS,
    ALPHA_SCAT,
    Value,
    as_attributes,
    judge,
    number_of,
    unit_of,
)
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.recording import (
    MOST_PHOTONS,
    RecordRun,
    SurfaceWish,
    record_surfaces,
    surfaces_answer,
)
from mcrim_mitsuba.efficiency.reweighting import EtaSurface
from mcrim_mitsuba.efficiency.simulate import collect
from mcrim_mitsuba.efficiency.surface import Coefficients, EtaPoint
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.transport.simulation import SimulationResult

if TYPE_CHECKING:
    import xarray

#: Columns of the usual table, as ``mcrim table`` writes them.
COLUMNS = ("n_gap", ALPHA_ABS, ALPHA_SCAT, "eta", "eta_sigma")
DEFAULT_PHOTONS = 2_000_000


@dataclass(frozen=True, eq=False)
class EtaTable:
    """Eta at every combination of some parameters' values."""

    #: Values by parameter: those that make configurations, then alpha_abs, then alpha_scat.
    axes: dict[str, tuple[Value, ...]]
    #: float64 over `axes`, and its Monte Carlo standard error.
    eta: NDArray[np.float64]
    eta_sigma: NDArray[np.float64]
    #: Photons that the points rest on, and how many of them the cache had.
    photons: int
    cached_photons: int
    seed: int
    #: Of the scene, where no axis says otherwise.
    parameters: dict[str, Value]
    #: SHA-256 of the scene after substitution.
    scene_hash: str
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Of the rows: the axes, ``eta`` and ``eta_sigma``."""
        return (*self.axes, "eta", "eta_sigma")

    @property
    def rows(self) -> tuple[dict[str, Value], ...]:
        """A point each, by column; the last axis runs fastest."""
        points = itertools.product(*self.axes.values())
        found = zip(points, self.eta.ravel().tolist(), self.eta_sigma.ravel().tolist(), strict=True)
        return tuple(dict(zip(self.columns, (*p, *eta), strict=True)) for p, *eta in found)

    @property
    def largest_relative_sigma(self) -> float:
        """The largest error of a point over its eta; 0 where no light arrives anywhere."""
        lit = self.eta > 0
        return float((self.eta_sigma[lit] / self.eta[lit]).max(initial=0.0))

    def to_xarray(self) -> xarray.Dataset:
        """Eta and eta_sigma over the axes, with units; attributes make it reproducible."""
        import xarray

        made = xarray.Dataset(
            {name: (tuple(self.axes), getattr(self, name)) for name in ("eta", "eta_sigma")},
            {name: list(values) for name, values in self.axes.items()},
            {"photons": self.photons, "seed": self.seed, "scene_hash": self.scene_hash}
            | as_attributes({n: v for n, v in self.parameters.items() if n not in self.axes}),
        )
        made.eta.attrs["long_name"] = "light collection efficiency"
        for name in self.axes:
            made[name].attrs["units"] = unit_of(name) or "1"
        return made

    def write(self, path: str | Path) -> None:
        """Write the table as CSV.

        Raises InputError if the file cannot be written.
        """
        write_text(path, "\n".join(self.csv_lines()) + "\n")

    def csv_lines(self) -> list[str]:
        """The table as CSV, without ends of lines."""
        rows = (",".join(map(_cell, row.values())) for row in self.rows)
        return [",".join(self.columns), *rows]


def _cell(value: Value) -> str:
    return f"{value:.8g}" if isinstance(value, float) else str(value)


def eta_table(
    scene: str | Path | SceneFile, axes: Mapping[str, Sequence[Value]], *, run: Run = Run()
) -> EtaTable:
    """Eta at every combination of values, from one simulation per configuration.

    Coefficients of the crystal are answered by reweighting; points that the photons say too little
    about are simulated on their own. What is asked for twice is simulated once.

    Parameters
    ----------
    scene : str, Path or SceneFile
    axes : mapping of str to sequence of values
        By parameter of the scene; all others keep the scene's values.
    run : Run
        Its photons (2 million, with a precision as many as it takes) are those of a
        configuration, and again of each point that is simulated on its own. Photon records round
        them up to a multiple of `transport.launch_plan.LANES`. Its precision is that of every
        point.

    Raises
    ------
    InputError
        If the scene is not sound or lacks one of the parameters, or a value is out of range.
    """
    file = read_scene(scene)
    refuse_axes(file, axes)
    varied = {name: values_as_in(file, name, values) for name, values in axes.items()}
    coefficients = (ALPHA_ABS, ALPHA_SCAT)
    outer = {name: values for name, values in varied.items() if name not in coefficients}
    inner = {
        name: varied.get(name) or values_as_in(file, name, [file.parameters[name]])
        for name in coefficients
    }
    points: list[Coefficients] = [
        (float(a_s), float(a_a)) for a_a, a_s in itertools.product(*inner.values())
    ]
    configurations = list(itertools.product(*outer.values()))
    benches = {
        one: _Bench(file, dict(zip(outer, one, strict=True)))
        for one in dict.fromkeys(configurations)
    }
    precision = run.precision
    run = replace(run, photons=run.photons_or(MOST_PHOTONS if precision else DEFAULT_PHOTONS))
    distinct = list(dict.fromkeys(points))
    scattering = [point for point in distinct if point[0] > 0.0]
    wishes = {
        one: SurfaceWish(bench.name, bench.file, scattering, run)
        for one, bench in benches.items()
        if scattering and surfaces_answer(bench.file)
    }
    surfaces = dict(zip(wishes, record_surfaces(list(wishes.values())), strict=True))
    for one, bench in benches.items():
        bench.answer(distinct, surfaces.get(one), run)
    found = np.array([[benches[one].found[point] for point in points] for one in configurations])
    kept = {name: values for name, values in (*outer.items(), *inner.items()) if name in varied}
    shape = tuple(map(len, kept.values()))
    work = [each for bench in benches.values() for each in bench.work]
    spent = sum(each.photons for each in work)
    made = EtaTable(
        kept,
        found[..., 0].reshape(shape),
        found[..., 1].reshape(shape),
        spent,
        sum(each.cached_photons for each in work),
        run.seed,
        dict(file.parameters),
        file.content_hash,
        # what goes wrong with the cache goes wrong every time
        tuple(dict.fromkeys(note for bench in benches.values() for note in bench.notes)),
    )
    further = []
    if own := [each.photons for each in work if isinstance(each, SimulationResult)]:
        further.append(
            f"{len(own)} of {len(benches) * len(distinct)} points, about which photon records say "
            f"too little, were simulated on their own: {sum(own):,} of {spent:,} photons"
        )
    worst = made.largest_relative_sigma
    if precision and worst > 1.2 * precision:
        further.append(
            f"the wanted precision of {100 * precision:g} % was not reached: errors go up to "
            f"{100 * worst:.2g} %"
        )
    return replace(made, notes=(*made.notes, *further))


class _Bench:
    """A configuration with its answers: eta and its error by point."""

    def __init__(self, file: SceneFile, changed: Mapping[str, Value]) -> None:
        self.file = file.with_overrides(changed)
        shown = {n: f"{v:g}" if isinstance(v, float) else v for n, v in changed.items()}
        self.name = ", ".join(f"{n} = {v}" for n, v in shown.items()) or file.path.name
        self.found: dict[Coefficients, tuple[float, float]] = {}
        #: What was simulated.
        self.work: list[RecordRun | SimulationResult] = []
        self.notes: list[str] = []

    def answer(
        self, points: list[Coefficients], known: tuple[EtaSurface, RecordRun] | None, run: Run
    ) -> None:
        """From its surface where that knows enough, else from simulations of their own."""
        from mcrim_mitsuba.transport.simulation import Simulation

        found: list[EtaPoint | None] = [None] * len(points)
        if known is not None:
            surface, recorded = known
            found = surface.evaluate_all(points)
            self.work.append(recorded)
            self.notes += recorded.notes
        for point, answered in zip(points, found, strict=True):
            if answered is not None:
                self.found[point] = answered.eta, answered.sigma
                continue
            values = dict(zip((ALPHA_SCAT, ALPHA_ABS), point, strict=True))
            simulation = Simulation(self.file, values, variant=run.variant, threads=run.threads)
            own = collect(simulation, run=run, what=self.name)
            if own.interrupted:
                raise KeyboardInterrupt  # one point cut short is no table
            self.found[point] = own.eta, own.eta_sigma
            self.work.append(own)
            a_s, a_a = point
            place = f"{self.name}, alpha_scat = {a_s:g} /cm, alpha_abs = {a_a:g} /cm"
            self.notes += [f"{place}: {note}" for note in own.notes]


def values_as_in(file: SceneFile, name: str, values: Sequence[Value]) -> tuple[Value, ...]:
    """Values of the kind that the scene has: 1 is 1.0, where it has a length."""
    if isinstance(file.parameters[name], float):
        return tuple(v if isinstance(v, str) else float(_value(name, v)) for v in values)
    return tuple(values)


def _value(name: str, value: object) -> float:
    return number_of(f"a value of {name}", value, "give a list of plain numbers")


def refuse_axes(file: SceneFile, axes: Mapping[str, Sequence[Value]]) -> None:
    """Refuse axes that a scene has no parameters for, and values out of range.

    Raises
    ------
    InputError
    """
    for name, values in ({ALPHA_ABS: [0.0], ALPHA_SCAT: [0.0]} | dict(axes)).items():
        if name not in file.parameters:
            usual = name in COLUMNS
            raise InputError(
                f"the scene has no parameter {name}",
                "a table varies n_gap, alpha_abs_per_cm and alpha_scat_per_cm: declare it"
                if usual
                else did_you_mean(name, file.parameters),
                path=file.path,
            )
        if name in axes and name in file.overrides:
            problem = f"{name} is both varied by the table and given a value"
            raise InputError(problem, "leave one of them out")
        if not len(values):
            raise InputError(f"there is no value of {name}", "give one at least")
        for value in values:
            if isinstance(value, str | bool):
                continue
            number = _value(name, value)
            if (wrong := judge(name, number)) is not None:
                raise InputError(f"{name} = {number:g}: {wrong[1]}", wrong[2])
