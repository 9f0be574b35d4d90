"""Tables of the light collection efficiency over any parameters of a scene."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import write_text
from mcrim_mitsuba.core.numbers import (
    ALL_DETECTORS,
    ALPHA_ABS,
    ALPHA_SCAT,
    COEFFICIENTS,
    COUNTED,
    SOURCE_Z,
    Value,
    judge,
    number_of,
)
from mcrim_mitsuba.core.rounding import number
from mcrim_mitsuba.core.run import OverAxes, Run
from mcrim_mitsuba.efficiency.attenuation import Attenuation, attenuations
from mcrim_mitsuba.efficiency.eta_grid import (
    APERTURE,
    has_open_mask,
    open_aperture,
    tells_detectors,
)
from mcrim_mitsuba.efficiency.eta_surface import (
    MOST_PHOTONS,
    Cut,
    EtaRequest,
    EtaRun,
    EtaSurface,
    record_surfaces,
)
from mcrim_mitsuba.efficiency.proposals import SMALLEST_PER_CM
from mcrim_mitsuba.efficiency.simulate import collect_whole
from mcrim_mitsuba.efficiency.surface import Coefficients
from mcrim_mitsuba.scene.check_text import problems_of_counted
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.transport.simulation import SimulationResult

if TYPE_CHECKING:
    import xarray

#: Columns of the usual table, as ``mcrim table`` writes them.
COLUMNS = ("n_gap", ALPHA_ABS, ALPHA_SCAT, "eta", "eta_sigma")
DEFAULT_PHOTONS = 2_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class EtaTable(OverAxes):
    """Eta at every combination of some parameters' values."""

    #: Values by parameter: those that make configurations, then alpha_abs, then alpha_scat.
    axes: dict[str, tuple[Value, ...]]
    #: float64 over `axes`, and its Monte Carlo standard error.
    eta: NDArray[np.float64]
    eta_sigma: NDArray[np.float64]
    #: How many of the photons that the points rest on the cache had.
    cached_photons: int
    #: Fits over ``source_z_mm``, where that is an axis of three values or more.
    attenuation: tuple[Attenuation, ...] = ()
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the rows: the axes, ``eta`` and ``eta_sigma``."""
        return (*self.axes, "eta", "eta_sigma")

    @property
    def rows(self) -> tuple[dict[str, Value], ...]:
        """A point each, by column; the last axis runs fastest."""
        points = itertools.product(*self.axes.values())
        etas = zip(points, self.eta.ravel().tolist(), self.eta_sigma.ravel().tolist(), strict=True)
        return tuple(dict(zip(self.columns, (*p, *eta), strict=True)) for p, *eta in etas)

    @property
    def largest_relative_sigma(self) -> float:
        """The largest error of a point over its eta; 0 where no light arrives anywhere."""
        lit = self.eta > 0
        return float((self.eta_sigma[lit] / self.eta[lit]).max(initial=0.0))

    def to_xarray(self) -> xarray.Dataset:
        """Eta and eta_sigma over the axes, with units; attributes make it reproducible."""
        arrays = {name: (tuple(self.axes), getattr(self, name)) for name in ("eta", "eta_sigma")}
        dataset = self.dataset(arrays, {name: list(values) for name, values in self.axes.items()})
        dataset.eta.attrs["long_name"] = "light collection efficiency"
        for name in self.axes:
            dataset[name].attrs.setdefault("units", "1")
            dataset.attrs.pop(name, None)  # the scene's own value: the axis says otherwise
        return dataset

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

    Coefficients of the crystal are answered by reweighting, and masks of several radii by cutting
    them out of the records; points that the photons say too little about are simulated on their
    own. What is asked for twice is simulated once.

    Axes are values by parameter of the scene; all others keep the scene's. The run's photons (2
    million, with a precision as many as it takes) are those of a configuration, and again of each
    point that is simulated on its own. Photon records round them up to a multiple of
    `transport.launch_plan.LANES`. Its precision is that of every point.

    Raises InputError if the scene is not sound or lacks one of the parameters, or a value is out of
    range.
    """
    file = read_scene(scene)
    grid = TableGrid.of(file, axes)
    precision = run.precision
    run = replace(run, photons=run.photons_or(MOST_PHOTONS if precision else DEFAULT_PHOTONS))
    answers, work, notes = _answer_all(file, grid, run)
    in_order = [answers[key, p] for key in grid.configurations for p in grid.points]
    eta = np.array([answer.eta for answer in in_order]).reshape(grid.shape)
    table = EtaTable(
        axes=grid.axes,
        eta=eta,
        eta_sigma=np.array([answer.sigma for answer in in_order]).reshape(grid.shape),
        attenuation=_attenuations(grid, eta, in_order),
        photons=sum(part.photons for part in work),
        cached_photons=sum(part.cached_photons for part in work),
        seed=run.seed,
        parameters=dict(file.parameters),
        scene_hash=file.content_hash,
        # what goes wrong with the cache goes wrong every time
        notes=tuple(dict.fromkeys(notes)),
    )
    notes = []
    if alone := [part.photons for part in work if isinstance(part, SimulationResult)]:
        notes.append(
            f"{len(alone)} of {len(answers)} points, about which photon records say too little, "
            f"were simulated on their own: {sum(alone):,} of {table.photons:,} photons"
        )
    worst = table.largest_relative_sigma
    if precision and worst > 1.2 * precision:
        notes.append(
            f"the wanted precision of {100 * precision:g} % was not reached: errors go up to "
            f"{100 * worst:.2g} %"
        )
    notes += [
        f"the attenuation length of {fit.light} is not told: it is above {number(least)} mm (95 %)"
        for fit in table.attenuation
        if (least := fit.lower_limit_mm) < 0.5 * fit.length_mm
    ]
    return replace(table, notes=(*table.notes, *notes))


def _attenuations(
    grid: TableGrid, eta: NDArray[np.float64], answers: Sequence[_Answer]
) -> tuple[Attenuation, ...]:
    """Fits over the place of birth; none where a point was simulated on its own."""
    batches = [answer.batches for answer in answers if answer.batches is not None]
    if SOURCE_Z not in grid.axes or len(batches) < len(answers):
        return ()
    with np.errstate(divide="ignore", invalid="ignore"):
        log_eta = np.log(eta)
        of_batches = np.log(np.transpose(batches)).reshape(-1, *grid.shape) - log_eta
    return attenuations(grid.axes, log_eta, of_batches)


@dataclass(frozen=True)
class TableGrid:
    """The points of a table: configurations, and the crystal's coefficients in each of them."""

    #: Values by parameter: those that make configurations, and those of alpha_abs and alpha_scat,
    #: which are the scene's where no axis names them.
    outer: dict[str, tuple[Value, ...]]
    inner: dict[str, tuple[Value, ...]]
    #: Values by parameter of the axes that were asked for, configurations first.
    axes: dict[str, tuple[Value, ...]]

    @classmethod
    def of(cls, file: SceneFile, axes: Mapping[str, Sequence[Value]]) -> TableGrid:
        """The grid of axes over a scene; errors as `eta_table`."""
        for name, values in ({ALPHA_ABS: [0.0], ALPHA_SCAT: [0.0]} | dict(axes)).items():
            if name not in file.parameters:
                mend = "a table varies n_gap, alpha_abs_per_cm and alpha_scat_per_cm: declare it"
                mend = mend if name in COLUMNS else file.mend_of(name)
                raise InputError(f"the scene has no parameter {name}", mend, path=file.path)
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
        varied = {name: _values_as_in(file, name, values) for name, values in axes.items()}
        outer = {name: values for name, values in varied.items() if name not in COEFFICIENTS}
        inner = {
            name: varied.get(name) or _values_as_in(file, name, [file.parameters[name]])
            for name in (ALPHA_ABS, ALPHA_SCAT)
        }
        shown = {name: values for name, values in (outer | inner).items() if name in varied}
        return cls(outer, inner, shown)

    @property
    def configurations(self) -> list[tuple[Value, ...]]:
        """Values of the outer parameters; the last one runs fastest."""
        return list(itertools.product(*self.outer.values()))

    @property
    def points(self) -> list[Coefficients]:
        """Scattering and absorption, 1/cm, within a configuration; scattering runs fastest."""
        return [(float(a_s), float(a_a)) for a_a, a_s in itertools.product(*self.inner.values())]

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of values along the axes."""
        return tuple(map(len, self.axes.values()))


class _Configuration(NamedTuple):
    """A configuration, and the one whose photon records answer it."""

    name: str
    scene: SceneFile
    recorded_name: str
    recorded: SceneFile
    #: What of these counts.
    cut: Cut

    @classmethod
    def of(cls, file: SceneFile, given: dict[str, Value], *, cuts_masks: bool) -> _Configuration:
        """With these parameters; one bench without masks, which are cut out, serves them all.

        So does one of all detectors. Raises InputError if there is no such detector.
        """
        scene = recorded = file.with_overrides(given)
        for problem in problems_of_counted(scene):
            raise problem.error()
        name, mask_mm, detector = _words(given) or file.path.name, None, None
        if cuts_masks:
            mask_mm = float(given.pop(APERTURE))
            recorded = recorded.with_overrides(open_aperture(scene.parameters))
        if COUNTED in given and tells_detectors(scene):
            counted = str(given.pop(COUNTED))
            detector = None if counted == ALL_DETECTORS else counted
            recorded = recorded.with_overrides({COUNTED: ALL_DETECTORS})
        return cls(name, scene, _words(given) or file.path.name, recorded, Cut(mask_mm, detector))


def _words(values: Mapping[str, Value]) -> str:
    return ", ".join(
        f"{n} = {v:g}" if isinstance(v, float) else f"{n} = {v}" for n, v in values.items()
    )


class _Answer(NamedTuple):
    """Eta at a point, and its error."""

    eta: float
    sigma: float
    #: (batches,) eta by each; None of a point that was simulated on its own.
    batches: NDArray[np.float64] | None


#: Values of a configuration's parameters, and coefficients there.
_Place = tuple[tuple[Value, ...], Coefficients]


def _answer_all(
    file: SceneFile, grid: TableGrid, run: Run
) -> tuple[dict[_Place, _Answer], list[EtaRun | SimulationResult], list[str]]:
    """Eta and its error at all places, what was simulated for them, and notes.

    From photon records, of all configurations together, where these tell enough; else a point is
    simulated alone.
    """
    points = list(dict.fromkeys(grid.points))
    # no scattering at all is far from any other on a logarithmic scale
    groups = {
        "": [point for point in points if point[0] >= SMALLEST_PER_CM],
        ", without scattering": [point for point in points if point[0] == 0.0],
    }
    cuts_masks = len(set(grid.outer.get(APERTURE, ()))) > 1 and has_open_mask(file)
    benches = {
        key: _Configuration.of(file, dict(zip(grid.outer, key, strict=True)), cuts_masks=cuts_masks)
        for key in dict.fromkeys(grid.configurations)
    }
    answers: dict[_Place, _Answer] = {}
    work: list[EtaRun | SimulationResult] = []
    for words, group in groups.items():
        if group:
            surfaces, runs = _record(benches.values(), words, group, run)
            work += runs
            for (key, bench), point in itertools.product(benches.items(), group):
                surface = surfaces[bench.recorded.content_hash, bench.cut]
                if (answer := surface.answer(point)) is not None:
                    batches = surface.batches([point])[:, 0]
                    answers[key, point] = _Answer(answer.eta, answer.sigma, batches)
    notes = [note for behind in work for note in behind.notes]
    for (key, bench), point in itertools.product(benches.items(), points):
        if (key, point) not in answers:
            coefficients = dict(zip(COEFFICIENTS, point, strict=True))
            result = collect_whole(bench.scene, coefficients, bench.name, run)
            answers[key, point] = _Answer(result.eta, result.eta_sigma, None)
            work.append(result)
            a_s, a_a = point
            place = f"{bench.name}, alpha_scat = {a_s:g} /cm, alpha_abs = {a_a:g} /cm"
            notes += [f"{place}: {note}" for note in result.notes]
    return answers, work, notes


def _record(
    benches: Iterable[_Configuration], words: str, points: Sequence[Coefficients], run: Run
) -> tuple[dict[tuple[str, Cut], EtaSurface], list[EtaRun]]:
    """Surfaces by scene and cut, and what was simulated for them; `words` follow a bench's name.

    Masks and detectors that one scene is asked for are answered by the same photons.
    """
    scenes: dict[str, _Configuration] = {}
    cuts: dict[str, dict[Cut, None]] = {}
    for bench in benches:
        scenes.setdefault(bench.recorded.content_hash, bench)
        cuts.setdefault(bench.recorded.content_hash, {})[bench.cut] = None
    requests = []
    for scene, bench in scenes.items():
        name, its_cuts = f"{bench.recorded_name}{words}", tuple(cuts[scene])
        requests.append(EtaRequest(name, bench.recorded, points, run, cuts=its_cuts))
    recorded = record_surfaces(requests)
    runs = [behind for _, behind in recorded]
    surfaces = {
        (scene, cut): surface
        for scene, behind in zip(scenes, runs, strict=True)
        for cut, surface in zip(cuts[scene], behind.surfaces, strict=True)
    }
    return surfaces, runs


def _values_as_in(file: SceneFile, name: str, values: Sequence[Value]) -> tuple[Value, ...]:
    """Values of the kind that the scene has: 1 is 1.0, where it has a length."""
    if isinstance(file.parameters[name], float):
        return tuple(v if isinstance(v, str) else float(_value(name, v)) for v in values)
    return tuple(values)


def _value(name: str, value: object) -> float:
    return number_of(f"a value of {name}", value, "give a list of plain numbers")
