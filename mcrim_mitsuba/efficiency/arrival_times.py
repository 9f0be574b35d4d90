"""When detected photons arrive: by their paths in every part of the bench and its group index.

Photon records hold the path of every detected photon in every medium. Light needs n_g / c for a
unit of path, n_g = n - lambda dn/dlambda being the group index; what its emission takes is folded
in afterwards, exactly, as an exponential.

The first photons of an event are born where the event's gamma stopped, all in one place, and this
place is another one in the next event. Both are told: photons of one event from everywhere, and
from one depth, whose spread over the events is then a part of the time's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.numbers import MM_PER_CM, parse_number
from mcrim_mitsuba.core.run import OverAxes, Run
from mcrim_mitsuba.efficiency import time_distribution as distribution
from mcrim_mitsuba.efficiency.lighting import bin_of
from mcrim_mitsuba.optics.materials import is_known
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.scene.values import SEPARATOR, MaterialIndex, read_index

if TYPE_CHECKING:
    import xarray

    from mcrim_mitsuba.scene.scene_file import SceneFile
    from mcrim_mitsuba.transport.launch_plan import FateTally
    from mcrim_mitsuba.transport.simulation import Simulation

#: Photons unless asked otherwise: they tell the mean to a few parts in ten thousand.
DEFAULT_PHOTONS = 2_000_000
MOST_PHOTONS = 40_000_000
#: Detected photons of an event unless asked otherwise.
DETECTED = 1000
MM_PER_PS = 0.299792458
_PS_PER_NS = 1000.0


@dataclass(frozen=True, kw_only=True)
class TimingSettings:
    """How times are counted and told."""

    #: Depths at which light is born that are told apart.
    slices: int = 20
    #: Cells along x and y of the crystal that weigh these depths.
    cells_across: int = 8
    #: Bins of the histogram, and the part of the light that they reach to.
    bins: int = 100
    shown_part: float = 0.995
    #: Parts of the light between whose arrivals the light rises.
    rise: tuple[float, float] = (0.1, 0.9)
    #: Detected photons of a first launch, below which there is no distribution; and simulated ones
    #: per one of an event, below which a note says so.
    fewest: int = 10


SETTINGS = TimingSettings()
#: Where the group index of a medium without dispersion is from.
_PLAIN = "its index"


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the bench that light crosses."""

    #: Of the medium; ``outside`` is what lies around all of them.
    name: str
    group_index: float
    #: Where that is from, in words.
    origin: str
    #: Mean time that detected light spends in it, and its error.
    mean_ps: float
    mean_ps_sigma: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrivalTimes(OverAxes):
    """Distribution of the times at which detected photons arrive, from the event on.

    Errors are Monte Carlo errors.
    """

    #: (bins + 1,) float64: Borders of the histogram's bins.
    edges_ps: Array
    #: (bins,) float64: Part of the detected light in each, and its error.
    part: Array
    part_sigma: Array
    #: Of all light, that beyond the histogram as well.
    mean_ps: float
    mean_ps_sigma: float
    #: Standard deviation.
    rms_ps: float
    rms_ps_sigma: float
    #: When 10 % of the light has arrived, and 90 % less 10 %.
    begin_ps: float
    begin_ps_sigma: float
    rise_ps: float
    rise_ps_sigma: float
    #: Time in which the emission falls to 1/e; None: all is emitted at once.
    decay_ns: float | None
    #: Detected photons of an event, for what follows.
    detected: int
    first: tuple[distribution.FirstPhotons, ...]
    parts: tuple[Part, ...]
    notes: tuple[str, ...]

    @property
    def time_ps(self) -> Array:
        """Middles of the bins."""
        return 0.5 * (self.edges_ps[1:] + self.edges_ps[:-1])

    @property
    def rows(self) -> list[tuple[float, float, float]]:
        """Rows of the histogram: time_ps, part, part_sigma."""
        columns = self.time_ps, self.part, self.part_sigma
        return list(zip(*(x.tolist() for x in columns), strict=True))

    def to_xarray(self) -> xarray.Dataset:
        """The histogram over time_ps, and the first photons over their number and births."""
        moments = "mean_ps mean_ps_sigma rms_ps rms_ps_sigma"
        numbers = attributes(self, f"{moments} begin_ps begin_ps_sigma rise_ps rise_ps_sigma")
        if self.decay_ns is not None:
            numbers["decay_ns"] = self.decay_ns
        numbers |= {f"group_index_{part.name}": part.group_index for part in self.parts}
        values: dict[str, tuple] = {
            "part": ("time_ps", self.part, {"long_name": "part of the detected light"}),
            "part_sigma": ("time_ps", self.part_sigma),
        }
        for name in moments.split():
            of_photons = [getattr(photons, name) for photons in self.first]
            values[f"first_{name}"] = ("born", "photon"), np.array(of_photons)
        born, number = [p.born for p in self.first], np.arange(1, len(self.first[0].mean_ps) + 1)
        axes = {"time_ps": self.time_ps, "born": born, "photon": number}
        return self.dataset(values, axes, **numbers, detected=self.detected)


def follow_times(
    simulation: Simulation,
    *,
    group_index: Mapping[str, float | str] | None = None,
    decay_ns: float | None = None,
    detected: int = DETECTED,
    run: Run = Run(),
) -> ArrivalTimes:
    """Follow photons of a checked simulation and their times.

    Group indices by medium, numbers or materials (``CaMoO4@540nm``), replace what the scene's
    materials say. Without a decay time, `decay_ns`, all light is emitted at once. `detected`
    photons of an event are detected. The run has `DEFAULT_PHOTONS` where it says nothing, and
    `MOST_PHOTONS` at most; its precision does not matter, its variant and threads are the
    simulation's.

    Raises InputError if the scene leaks or no light is detected, or a group index is not known or
    wrong.
    """
    bench = TimedBench.of(simulation, group_index or {})
    decay_ps = (decay_ns or 0.0) * _PS_PER_NS
    cells, tally = _follow(simulation, bench, decay_ps, run)
    parts = _parts(bench, cells)
    notes = _notes(parts, detected, cells.detected / len(bench.births))
    if (truncated := tally.fraction("truncated")) > 0.0:
        notes.append(
            f"{100 * truncated:.3g} % of the light was still under way after "
            f"{simulation.depth_limit:,} flights: the latest arrivals are missing"
        )
    return ArrivalTimes(
        **_numbers_of(cells, decay_ps),
        decay_ns=decay_ns,
        detected=detected,
        first=distribution.first_of_event(cells, decay_ps, detected, bench.births),
        parts=parts,
        photons=tally.photons,
        seed=run.seed,
        parameters=dict(simulation.file.parameters),
        scene_hash=simulation.file.content_hash,
        notes=tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class TimedBench:
    """A bench whose photon records are turned into times."""

    #: Group index by medium, and where it is from; what lies around all of them comes first.
    media: dict[str, tuple[float, str]]
    #: The medium in which light is born.
    crystal: str
    #: (slices + 1,) float64: Borders of the depths of birth, rising. A beam's light is born
    #: outside the crystal, at one height.
    heights_mm: Array
    #: (slices,) float64: Part of the light that is born between them.
    births: Array

    @classmethod
    def of(cls, simulation: Simulation, group_index: Mapping[str, float | str]) -> TimedBench:
        """A checked bench; errors as `follow_times`."""
        crystal = simulation.crystal
        of_beam = crystal.birth_volume != crystal.volume
        low, high = crystal.lower, crystal.upper
        heights = np.linspace(low[2], high[2], (1 if of_beam else SETTINGS.slices) + 1)
        births = np.ones(1)
        if not of_beam:
            across = (np.linspace(low[i], high[i], SETTINGS.cells_across + 1) for i in (0, 1))
            edges = (*across, heights)
            born = crystal.part_inside(edges) * crystal.birth_density(edges)
            births = np.asarray(born.sum(axis=(0, 1)) / born.sum(), float)
        media = group_indices(simulation, group_index)
        return cls(media, simulation.model.volume_names[crystal.volume], heights, births)

    @property
    def columns(self) -> list[str]:
        """What records must have besides ``path_cm``."""
        depth = [] if len(self.births) == 1 else ["birth_from_top_mm"]
        return [self._path(name) for name in self.media if name != self.crystal] + depth

    def _path(self, medium: str) -> str:
        return "path_cm" if medium == self.crystal else f"path_{medium}_cm"

    def times_ps(self, records: Mapping[str, Array]) -> Array:
        """(media, detected) times that photons spend in every medium."""
        per_cm = {self._path(n): MM_PER_CM * i / MM_PER_PS for n, (i, _) in self.media.items()}
        return np.array([records[path].astype(float) * ps for path, ps in per_cm.items()])

    def slices(self, records: Mapping[str, Array]) -> NDArray[np.int64]:
        """(detected,) numbers of the depths at which photons were born."""
        if len(self.births) == 1:
            return np.zeros(len(records["w"]), np.int64)
        from_top_mm = records["birth_from_top_mm"].astype(float)
        return bin_of(self.heights_mm[-1] - from_top_mm, self.heights_mm)


def _follow(
    simulation: Simulation, bench: TimedBench, decay_ps: float, run: Run
) -> tuple[distribution.TimeCells, FateTally]:
    """Detected photons in cells of time that the first launch sets, and the fates of all."""
    from mcrim_mitsuba.transport import arrivals

    photons = min(run.photons_or(DEFAULT_PHOTONS), MOST_PHOTONS)
    cells: distribution.TimeCells | None = None
    for launch, tally in arrivals.launches(simulation, photons, run.seed, bench.columns):
        records = launch.records
        weight, group = records["w"].astype(float), records["batch"] % np.int64(distribution.GROUPS)
        times = bench.times_ps(records)
        if cells is None:
            total = times.sum(axis=0)
            if len(weight) < SETTINGS.fewest:
                problem = f"{len(weight)} of {tally.photons:,} photons are detected"
                raise InputError(problem, "follow more, or mend it", path=simulation.file.path)
            ends = float(total.min()), float(np.quantile(total, SETTINGS.shown_part))
            edges = distribution.cell_edges(*ends, decay_ps)
            cells = distribution.TimeCells(edges, len(bench.births), len(times))
        cells.add(times, weight, group, bench.slices(records))
        run.tell("following times", min(tally.photons, photons), photons)
    assert cells is not None  # a run has one photon at least
    return cells, tally


def _parts(bench: TimedBench, cells: distribution.TimeCells) -> tuple[Part, ...]:
    """The media with the times in them: where light is born first, what lies around all last."""
    times = distribution.jackknife(
        lambda sums: sums[1:] / sums[0], np.column_stack([cells.moments[:, 0], cells.spent])
    )
    media = zip(bench.media.items(), *(numbers.tolist() for numbers in times), strict=True)
    parts = [
        Part(name=name, group_index=index, origin=origin, mean_ps=mean, mean_ps_sigma=sigma)
        for (name, (index, origin)), mean, sigma in media
    ]
    surroundings = parts[0]
    return tuple(sorted(parts, key=lambda part: (part.name != bench.crystal, part is surroundings)))


def _numbers_of(cells: distribution.TimeCells, decay_ps: float) -> dict[str, Any]:
    """The fields of `ArrivalTimes` on all light: mean, rms, begin and rise in ps, and a histogram.

    Errors are by the jackknife over groups of photons; what the cells' width adds is in them.
    """
    (mean, rms), (mean_sigma, rms_sigma) = distribution.jackknife(
        distribution.mean_and_rms, cells.moments
    )
    if decay_ps:
        # variances add, and that of the decay is known
        both = math.hypot(rms, decay_ps)
        mean, rms, rms_sigma = mean + decay_ps, both, rms_sigma * rms / both
    light = cells.emitted(cells.light.sum(axis=1), decay_ps)
    latest_ps = float(
        distribution.quantiles(cells.edges_ps, light.sum(axis=0), np.array(SETTINGS.shown_part))
    )
    # borders of some bins of a round width, from 0 on
    step = latest_ps / SETTINGS.bins
    power = 10.0 ** math.floor(math.log10(step))
    step = next(n * power for n in (1.0, 2.0, 5.0, 10.0) if n * power >= step * (1.0 - 1e-9))
    bins = math.ceil(latest_ps / step * (1.0 - 1e-9))
    edges = np.asarray(step * np.arange(bins + 1), float)

    def rise_and_histogram(light: Array) -> Array:
        begin, end = distribution.quantiles(cells.edges_ps, light, np.array(SETTINGS.rise))
        part = np.diff(distribution.arrived_at(cells.edges_ps, light, edges))
        return np.array([begin, end - begin, *part])

    (begin, rise, *part), (begin_sigma, rise_sigma, *part_sigma) = distribution.jackknife(
        rise_and_histogram, light
    )
    values = np.array([mean, rms, begin, rise])
    sigmas = np.array([mean_sigma, rms_sigma, begin_sigma, rise_sigma])
    numbers = {"edges_ps": edges, "part": np.array(part), "part_sigma": np.array(part_sigma)}
    moments = zip(values.tolist(), cells.with_cell_errors(values, sigmas).tolist(), strict=True)
    for name, (value, sigma) in zip(("mean", "rms", "begin", "rise"), moments, strict=True):
        numbers |= {f"{name}_ps": value, f"{name}_ps_sigma": sigma}
    return numbers


def group_indices(
    simulation: Simulation, given: Mapping[str, float | str]
) -> dict[str, tuple[float, str]]:
    """Group index of every volume, and where it is from; errors as `follow_times`."""
    from mcrim_mitsuba.transport.check import interfaces_of

    file, names = simulation.file, simulation.model.volume_names
    for name in given:
        if name not in names:
            problem = f"the scene has no medium {name!r} to give a group index of"
            raise InputError(problem, did_you_mean(name, names), path=file.path)
    indices = {names[0]: 1.0}
    for face in interfaces_of(file, simulation.model):
        sides = (face.interior, face.n_interior), (face.exterior, face.n_exterior)
        indices |= {name: n for name, n in sides if n is not None}
    return {
        name: _given_index(file, name, given[name])
        if name in given
        else _index_of(file, name, indices.get(name))
        for name in names
    }


def _given_index(file: SceneFile, name: str, value: float | str) -> tuple[float, str]:
    """What the user says: a number, or a material at a wavelength or over an emission."""
    what, text = f"the group index of {name}, {value},", str(value)
    wavelength = file.parameters.get("wavelength_nm")
    if is_known(text) and wavelength is not None:
        text = f"{text}{SEPARATOR}{wavelength:g}nm"
    if SEPARATOR in text or is_known(text):
        return _of_material(read_index(what, text, file.path.parent))
    number = parse_number(f"the group index of {name}", text)
    if not number >= 1.0:
        raise InputError(f"{what} is below 1", "give n - lambda dn/dlambda")
    return number, "given"


def _index_of(file: SceneFile, name: str, index: float | None) -> tuple[float, str]:
    """What the scene says: a material's, else the index itself."""
    # by the usual name, else what has this very index
    usual = f"n_{name}"
    if index is None and isinstance(number := file.parameters.get(usual), float):
        index = number
    if index is None:
        problem = f"no face tells the index of {name!r}, and with it the speed of light there"
        raise InputError(problem, "give its group index", path=file.path)
    materials = (
        [file.materials[usual]]
        if usual in file.materials
        else [m for m in file.materials.values() if usual not in file.parameters]
    )
    material = next((m for m in materials if abs(m.value - index) < 1e-6), None)
    return (index, _PLAIN) if material is None else _of_material(material)


def _of_material(index: MaterialIndex) -> tuple[float, str]:
    if not index.material.is_dispersive:
        return index.group_index, _PLAIN
    where = f"{index.wavelength_nm:g} nm" if index.emission is None else index.emission.name
    return index.group_index, f"{index.material.name}, {where}"


def _notes(parts: Sequence[Part], detected: int, followed: float) -> list[str]:
    """What must be known; `followed` photons are the detected ones of a depth."""
    notes = []
    plain = [part for part in parts if part.origin == _PLAIN and is_filled(part.group_index)]
    if plain:
        names = ", ".join(f"{part.name} ({part.group_index:g})" for part in plain)
        notes.append(
            f"of {names} the index is a number without dispersion, and stands for the group index: "
            f"light is slower by some per cent; give --group-index {plain[0].name}=... or a "
            "material, such as -D n_crystal=CaMoO4@540nm"
        )
    if detected * SETTINGS.fewest > followed:
        notes.append(
            f"{detected:,} photons of an event are many beside the {followed:,.0f} simulated ones "
            "that were detected of a depth: the first ones may be earlier than it says; follow more"
        )
    return notes
