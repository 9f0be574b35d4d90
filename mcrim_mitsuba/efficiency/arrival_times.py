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

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.numbers import MM_PER_CM, Value, as_attributes, parse_number
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency import time_distribution as distribution
from mcrim_mitsuba.efficiency.lighting import bin_of
from mcrim_mitsuba.optics.materials import is_known
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.scene.values import SEPARATOR, MaterialIndex, read_index

if TYPE_CHECKING:
    import xarray

    from mcrim_mitsuba.scene.scene_file import SceneFile
    from mcrim_mitsuba.transport.simulation import Simulation

#: Photons unless asked otherwise, and the most: they tell the mean to a few parts in ten thousand.
DEFAULT_PHOTONS, MOST_PHOTONS = 2_000_000, 40_000_000
#: Detected photons of an event unless asked otherwise, and how many of the first are told of.
DETECTED, _FIRST = 1000, 10
MM_PER_PS = 0.299792458
_PS_PER_NS = 1000.0
#: Depths at which light is born that are told apart; cells across the crystal that weigh them.
_SLICES, _ACROSS = 20, 8
#: Bins of the histogram, and the part of the light that they reach to.
_BINS, _SHOWN = 100, 0.995
#: Detected photons of a first launch, below which there is no distribution; and simulated ones
#: per one of an event, below which a note says so.
_FEWEST = 10
_RISE = np.array([0.1, 0.9])
#: What cells add to the error of a time, in their width and in the time: they grow with it.
_OF_CELL, _OF_TIME = 0.02, 1e-6


@dataclass(frozen=True)
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


@dataclass(frozen=True, eq=False)
class FirstPhotons:
    """When the first, second, ... photon of an event is detected; arrays are (photons,) float64."""

    #: Where the light of an event is born, in words.
    born: str
    mean_ps: Array
    mean_ps_sigma: Array
    rms_ps: Array
    rms_ps_sigma: Array


@dataclass(frozen=True, eq=False)
class ArrivalTimes:
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
    first: tuple[FirstPhotons, ...]
    parts: tuple[Part, ...]
    photons: int
    seed: int
    #: Of the scene.
    parameters: Mapping[str, Value]
    scene_hash: str
    notes: tuple[str, ...]

    @property
    def time_ps(self) -> Array:
        """Middles of the bins."""
        return 0.5 * (self.edges_ps[1:] + self.edges_ps[:-1])

    @property
    def rows(self) -> list[tuple[float, float, float]]:
        """Of the histogram: time_ps, part, part_sigma."""
        return list(
            zip(*(x.tolist() for x in (self.time_ps, self.part, self.part_sigma)), strict=True)
        )

    def to_xarray(self) -> xarray.Dataset:
        """The histogram over time_ps, and the first photons over their number and births."""
        import xarray

        names = "mean_ps", "mean_ps_sigma", "rms_ps", "rms_ps_sigma"
        first = {
            f"first_{name}": (
                ("born", "photon"),
                np.array([getattr(one, name) for one in self.first]),
            )
            for name in names
        }
        one_number = (*names, "begin_ps", "begin_ps_sigma", "rise_ps", "rise_ps_sigma")
        attributes = {name: getattr(self, name) for name in one_number}
        attributes |= {"decay_ns": self.decay_ns or 0.0, "detected": self.detected}
        attributes |= {f"group_index_{one.name}": one.group_index for one in self.parts}
        attributes |= {"photons": self.photons, "seed": self.seed, "scene_hash": self.scene_hash}
        made = xarray.Dataset(
            {"part": ("time_ps", self.part), "part_sigma": ("time_ps", self.part_sigma), **first},
            {
                "time_ps": self.time_ps,
                "born": [one.born for one in self.first],
                "photon": np.arange(1, len(self.first[0].mean_ps) + 1),
            },
            attributes | as_attributes(self.parameters),
        )
        made.part.attrs["long_name"] = "part of the detected light"
        made.time_ps.attrs["units"] = "ps"
        return made


def follow_times(
    simulation: Simulation,
    *,
    group_index: Mapping[str, float | str] | None = None,
    decay_ns: float | None = None,
    detected: int = DETECTED,
    run: Run = Run(),
) -> ArrivalTimes:
    """Follow photons and their times.

    Parameters
    ----------
    simulation : Simulation
        Checked.
    group_index : mapping of str to (float or str), optional
        Group indices by medium, in place of what the scene's materials say: numbers, or materials
        (``CaMoO4@540nm``).
    decay_ns : float, optional
        Decay time of the scintillation; without it all light is emitted at once.
    detected : int
        Photons of an event that are detected.
    run : Run
        Of `DEFAULT_PHOTONS` where it says nothing, and `MOST_PHOTONS` at most. Its precision does
        not matter, its variant and threads are the simulation's.

    Raises
    ------
    InputError
        If the scene leaks or no light is detected, or a group index is not known or wrong.
    """
    from mcrim_mitsuba.transport import arrivals

    known = group_indices(simulation, group_index or {})
    photons = min(run.photons_or(DEFAULT_PHOTONS), MOST_PHOTONS)
    decay_ps = (decay_ns or 0.0) * _PS_PER_NS
    crystal, names = simulation.crystal, list(known)
    own = simulation.model.volume_names[crystal.volume]
    paths = ["path_cm" if name == own else f"path_{name}_cm" for name in names]
    # a beam's light is born outside the crystal, at one height
    by_depth = crystal.birth_volume == crystal.volume
    heights = np.linspace(crystal.lower[2], crystal.upper[2], (_SLICES if by_depth else 1) + 1)
    columns = [path for path in paths if path != "path_cm"] + ["birth_from_top_mm"] * by_depth
    cells: distribution.TimeCells | None = None
    spent, followed = np.zeros((distribution.GROUPS, len(names))), 0
    for launch, tally in arrivals.launches(simulation, photons, run.seed, columns):
        records, followed = launch.records, followed + len(launch.records["w"])
        weight, group = records["w"].astype(float), records["batch"] % np.int64(distribution.GROUPS)
        times = np.array(
            [
                records[path].astype(float) * (MM_PER_CM * known[name][0] / MM_PER_PS)
                for name, path in zip(names, paths, strict=True)
            ]
        )
        total, kind = times.sum(axis=0), np.zeros(len(weight), np.int64)
        if by_depth:
            kind = bin_of(heights[-1] - records["birth_from_top_mm"].astype(float), heights)
        if cells is None:
            if len(weight) < _FEWEST:
                problem = f"{len(weight)} of {tally.photons:,} photons are detected"
                raise InputError(problem, "follow more, or mend it", path=simulation.file.path)
            ends = float(total.min()), float(np.quantile(total, _SHOWN))
            edges = distribution.cell_edges(*ends, decay_ps)
            cells = distribution.TimeCells(edges, len(heights) - 1)
        cells.add(total, weight, group, kind)
        for place, time_ps in enumerate(times):
            spent[:, place] += np.bincount(group, weight * time_ps, distribution.GROUPS)
        run.tell("following times", min(tally.photons, photons), photons)
    assert cells is not None  # a run has one photon at least
    in_parts = distribution.jackknife(
        lambda sums: sums[1:] / sums[0], np.column_stack([cells.moments[:, 0], spent])
    )
    found = (
        Part(name, *known[name], float(mean), float(sigma))
        for name, mean, sigma in zip(names, *in_parts, strict=True)
    )
    # where light is born first, what lies around all of it last
    parts = tuple(sorted(found, key=lambda one: (one.name != own, one.name == names[0])))
    notes = _notes(parts, detected, followed / (len(heights) - 1))
    if (truncated := tally.fraction("truncated")) > 0.0:
        notes.append(
            f"{100 * truncated:.3g} % of the light was still under way after "
            f"{simulation.depth_limit:,} flights: the latest arrivals are missing"
        )
    births = _births(simulation, heights) if by_depth else np.ones(1)
    return ArrivalTimes(
        **_numbers(cells, decay_ps),
        decay_ns=decay_ns,
        detected=detected,
        first=_first(cells, decay_ps, detected, births),
        parts=parts,
        photons=tally.photons,
        seed=run.seed,
        parameters=dict(simulation.file.parameters),
        scene_hash=simulation.file.content_hash,
        notes=tuple(notes),
    )


def _numbers(cells: distribution.TimeCells, decay_ps: float) -> dict[str, Any]:
    """The histogram, and what is said of all light."""
    (mean, rms), (mean_sigma, rms_sigma) = distribution.jackknife(
        distribution.mean_and_rms, cells.moments
    )
    if decay_ps:
        # variances add, and that of the decay is known
        both = math.hypot(rms, decay_ps)
        mean, rms, rms_sigma = mean + decay_ps, both, rms_sigma * rms / both
    light = _emitted(cells, decay_ps, cells.light.sum(axis=1))
    latest = float(distribution.quantiles(cells.edges_ps, light.sum(axis=0), np.array(_SHOWN)))
    edges = _round_edges(latest)

    def all_at_once(light: Array) -> Array:
        begin, end = distribution.quantiles(cells.edges_ps, light, _RISE)
        part = np.diff(distribution.arrived_at(cells.edges_ps, light, edges))
        return np.array([begin, end - begin, *part])

    (begin, rise, *part), (begin_sigma, rise_sigma, *part_sigma) = distribution.jackknife(
        all_at_once, light
    )
    values = np.array([mean, rms, begin, rise])
    sigmas = _rounded(cells, values, np.array([mean_sigma, rms_sigma, begin_sigma, rise_sigma]))
    found: dict[str, Any] = {
        "edges_ps": edges,
        "part": np.array(part),
        "part_sigma": np.array(part_sigma),
    }
    for name, value, sigma in zip(("mean", "rms", "begin", "rise"), values, sigmas, strict=True):
        found |= {f"{name}_ps": float(value), f"{name}_ps_sigma": float(sigma)}
    return found


def _rounded(cells: distribution.TimeCells, values: Array, sigmas: Array) -> Array:
    """Errors of times, ps, with what the cells add."""
    return np.sqrt(sigmas**2 + (_OF_CELL * cells.width_ps) ** 2 + (_OF_TIME * values) ** 2)


def _round_edges(latest_ps: float) -> Array:
    """Borders of some `_BINS` bins of a round width, from 0 on."""
    step = latest_ps / _BINS
    power = 10.0 ** math.floor(math.log10(step))
    step = next(n * power for n in (1.0, 2.0, 5.0, 10.0) if n * power >= step * (1.0 - 1e-9))
    return np.asarray(step * np.arange(math.ceil(latest_ps / step * (1.0 - 1e-9)) + 1), float)


def _emitted(cells: distribution.TimeCells, decay_ps: float, light: Array) -> Array:
    """Light, (..., cells), with the decay of its emission."""
    if not decay_ps:
        return light
    return distribution.decayed(cells.edges_ps, cells.times_ps, light, decay_ps)


def _first(
    cells: distribution.TimeCells, decay_ps: float, detected: int, births: Array
) -> tuple[FirstPhotons, ...]:
    """The first photons of an event, born everywhere, and at one depth of (slices,) `births`."""
    light, times = _emitted(cells, decay_ps, cells.light), cells.times_ps
    if decay_ps:
        edges = cells.edges_ps
        times = np.append(0.5 * (edges[1:-1] + edges[:-2]), edges[-2])
    most = min(_FIRST, detected)

    def everywhere(light: Array) -> Array:
        return distribution.first_photons(times, light.sum(axis=0), detected, most)

    def by_depth(light: Array) -> Array:
        # where no light is detected there is no event of so many photons
        seen = (births > 0.0) & (light.sum(axis=1) > 0.0)
        share = births[seen] / births[seen].sum()
        found = [distribution.first_photons(times, one, detected, most) for one in light[seen]]
        means, rms = np.moveaxis(np.array(found), 1, 0)
        mean = share @ means
        return np.array([mean, np.sqrt(share @ (rms**2 + (means - mean) ** 2))])

    chosen = {"everywhere": everywhere} | ({"at one depth": by_depth} if len(births) > 1 else {})
    first = []
    for born, number in chosen.items():
        values, sigmas = distribution.jackknife(number, light)
        (mean, rms), (mean_sigma, rms_sigma) = values, _rounded(cells, values, sigmas)
        first.append(FirstPhotons(born, mean, mean_sigma, rms, rms_sigma))
    return tuple(first)


def _births(simulation: Simulation, heights: Array) -> Array:
    """Part of the births in each slice, (slices,)."""
    crystal = simulation.crystal
    across = [np.linspace(crystal.lower[axis], crystal.upper[axis], _ACROSS + 1) for axis in (0, 1)]
    edges = (*across, heights)
    born = crystal.part_inside(edges) * crystal.birth_density(edges)
    return np.asarray(born.sum(axis=(0, 1)) / born.sum(), float)


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
    said, text = f"the group index of {name}, {value},", str(value)
    wavelength = file.parameters.get("wavelength_nm")
    if is_known(text) and wavelength is not None:
        text = f"{text}{SEPARATOR}{wavelength:g}nm"
    if SEPARATOR in text or is_known(text):
        return _of_material(read_index(said, text, file.path.parent))
    number = parse_number(f"the group index of {name}", text)
    if not number >= 1.0:
        raise InputError(f"{said} is below 1", "give n - lambda dn/dlambda")
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
    known = (
        [file.materials[usual]]
        if usual in file.materials
        else [one for one in file.materials.values() if usual not in file.parameters]
    )
    material = next((one for one in known if abs(one.value - index) < 1e-6), None)
    return (index, _PLAIN) if material is None else _of_material(material)


def _of_material(known: MaterialIndex) -> tuple[float, str]:
    if not known.material.is_dispersive:
        return known.group_index, _PLAIN
    where = f"{known.wavelength_nm:g} nm" if known.emission is None else known.emission.name
    return known.group_index, f"{known.material.name}, {where}"


_PLAIN = "its index"


def _notes(parts: Sequence[Part], detected: int, followed: float) -> list[str]:
    """What must be known; `followed` photons are the detected ones of a depth."""
    notes = []
    plain = [one for one in parts if one.origin == _PLAIN and is_filled(one.group_index)]
    if plain:
        told = ", ".join(f"{one.name} ({one.group_index:g})" for one in plain)
        notes.append(
            f"of {told} the index is a number without dispersion, and stands for the group index: "
            f"light is slower by some per cent; give --group-index {plain[0].name}=... or a "
            "material, such as -D n_crystal=CaMoO4@540nm"
        )
    if detected * _FEWEST > followed:
        notes.append(
            f"{detected:,} photons of an event are many beside the {followed:,.0f} simulated ones "
            "that were detected of a depth: the first ones may be earlier than it says; follow more"
        )
    return notes
