"""Photon histories of the independent tracer on what a laboratory can mount, with effects.

Every mounting (liquid, crystal, gap) of a case is traced once, with a mask that leaves the whole
plate free and at a few scattering coefficients; the histories are then weighted to any coefficients
and cut to any aperture, so that campaigns of many designs share them. They are kept in files.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench_scene import FILLED_ONLY, bench_scene, unlike
from numpy.typing import NDArray
from shared import TRACER_CODE, source_hash

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.files import make_folder, write_bytes
from mcrim_mitsuba.reference.scene_bench import read_bench
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.check_text import is_filled
from trials.executor import TrialExecutor

#: Columns of a design, in the order of a row.
COLUMNS = ("n_gap", "aperture_radius_mm", "crystal_height_mm", "gap_mm")
#: A campaign's configurations, a row each.
Design = tuple[tuple[float, float, float, float], ...]
#: The standard campaign of shared/effects.md.
STANDARD: Design = (
    *((n, aperture, 10.0, 0.05) for n in (1.0, 1.333, 1.46, 1.515) for aperture in (14.0, 7.0)),
    *((n, 14.0, height, 0.05) for height in (5.0, 2.0) for n in (1.0, 1.46)),
    *((n, 14.0, 10.0, 0.5) for n in (1.0, 1.46)),
    *((n, 4.0, 10.0, 0.05) for n in (1.0, 1.46)),
)
#: Masks that end at the crystal's edge under a thick gap: much of the light passes beside it.
EDGE: Design = tuple((n, 5.0, 10.0, 0.5) for n in (1.0, 1.46))
#: Rows that designs are drawn from: liquids behind masks, other crystals and other gaps.
POOL: Design = (
    *(
        (n, radius, 10.0, 0.05)
        for n in (1.0, 1.333, 1.4, 1.46, 1.515, 1.6)
        for radius in (14.0, 10.0, 7.0)
    ),
    *((n, radius, 10.0, 0.05) for n in (1.0, 1.46) for radius in (5.0, 4.0)),
    *(
        (n, radius, height, 0.05)
        for height in (2.0, 5.0, 20.0)
        for n in (1.0, 1.46)
        for radius in (14.0, 7.0)
    ),
    *((n, radius, 10.0, gap) for gap in (0.2, 0.5) for n in (1.0, 1.46) for radius in (14.0, 7.0)),
    *EDGE,
)
#: Readings of a design.
_FEWEST, _MOST = 10, 16
#: Scattering coefficients that are traced, each with the same number of photons, 1/cm.
PROPOSALS_PER_CM = (0.2, 0.5, 1.1)
#: More of them for the plain bench, whose fits go astray where an effect is hidden.
PLAIN_PROPOSALS_PER_CM = (0.07, 0.2, 0.5, 1.1, 3.0)
#: Absorption that is traced; histories are weighted to others, 1/cm.
ABSORPTION_PER_CM = 0.027
#: Photons per proposal of a mounting whose smallest aperture is 7 mm; those with smaller ones get
#: more, by `_SHARE`. The error at full aperture is 0.2 % to 0.4 %.
PHOTONS = 80_000
_SHARE = {4.0: 2}
#: Factor on the photons of the plain bench, which many trials share.
PLAIN_FACTOR = 6
#: Radius that leaves the whole plate free, mm, wherever the mask is shifted to.
_OPEN_MM = 25.0
_APERTURES = tuple(sorted({row[1] for row in POOL}))

#: What is hidden: changes of the bench, by parameter, or by one of the values of a column:
#: ``gap_mm=0.05``.
Changes = Mapping[str, float | bool]


class Mounting(NamedTuple):
    """One traced configuration: readings that differ in the aperture alone share it."""

    n_gap: float
    crystal_height_mm: float
    gap_mm: float


def mounting_of(row: Sequence[float]) -> Mounting:
    """The mounting of a row of a design."""
    return Mounting(row[0], *row[2:])


MOUNTINGS = tuple(dict.fromkeys(mounting_of(row) for row in POOL))


def draw_design(rng: np.random.Generator, among: Design = ()) -> Design:
    """Rows of `POOL` in any order; with air and a liquid, both with the largest aperture.

    Rows of `EDGE` are in it if they are `among` those that must be.
    """
    filled = rng.choice([row[0] for row in POOL[3:18:3]])
    sure = [(1.0, 14.0, 10.0, 0.05), (float(filled), 14.0, 10.0, 0.05), *among]
    others = [row for row in POOL if row not in (*sure, *EDGE)]
    number = int(rng.integers(_FEWEST, _MOST, endpoint=True)) - len(sure)
    drawn = [*sure, *(others[i] for i in rng.choice(len(others), number, replace=False))]
    return tuple(drawn[i] for i in rng.permutation(len(drawn)))


@dataclass(frozen=True)
class Run:
    """A simulation: what its histories depend on, and nothing else.

    The bench's parameters are those that are not the article's, sorted; neither the aperture nor
    the coefficients are among them. Photons are per proposal.
    """

    bench: tuple[tuple[str, float | bool], ...]
    proposals_per_cm: tuple[float, ...]
    photons: int
    seed: int

    @property
    def parameters(self) -> dict[str, float | bool]:
        """Those of the scene."""
        return {name: value for name, value in self.bench if "=" not in name}

    @property
    def apertures_mm(self) -> list[float]:
        """All apertures of `POOL`, rising, as they are."""
        wrong = dict(self.bench)
        return [wrong.get(f"aperture_radius_mm={mm:g}", mm) for mm in _APERTURES]

    @property
    def key(self) -> str:
        """Digest of all this and of the tracer's source."""
        return _digest(asdict(self), ABSORPTION_PER_CM, _APERTURES, tracer_hash())

    def seeds(self) -> list[int]:
        """Of each proposal; another tracer is given the same, so that its campaigns are."""
        own = np.random.SeedSequence(int(_digest(asdict(self)), 16))
        return [int(x >> 1) for x in own.generate_state(len(self.proposals_per_cm), np.uint64)]


@dataclass(frozen=True, eq=False)
class Histories:
    """The detected photons of a run, those of each proposal after those of the one before.

    ``detected`` (proposals,) says how many these are; ``hole`` is the number of the smallest of
    all apertures that lets a photon through. The other arrays are (photons,).
    """

    run: Run
    detected: NDArray[np.int64]
    hole: NDArray[np.uint8]
    scatterings: NDArray[np.uint16]
    path_cm: NDArray[np.float32]
    scattering_path_cm: NDArray[np.float32]

    def eta(self, alpha_scat_per_cm: float, alpha_abs_per_cm: float) -> tuple[Array, Array]:
        """Light collection efficiency by aperture, and its standard error.

        The proposals together are one sample with the mean of their densities (the balance
        heuristic of E. Veach and L. J. Guibas, SIGGRAPH 1995); each is a stratum of its own.
        Both are (apertures,), in rising order of all apertures of `POOL`.
        """
        proposals, photons = self.run.proposals_per_cm, self.run.photons
        density = np.zeros(len(self.hole))
        for proposal in proposals:
            # a history that a proposal makes far too often gets the weight 0
            with np.errstate(over="ignore"):
                density += np.exp(
                    math.log(proposal / alpha_scat_per_cm) * self.scatterings
                    + (alpha_scat_per_cm - proposal) * self.scattering_path_cm
                )
        weight = np.exp((ABSORPTION_PER_CM - alpha_abs_per_cm) * self.path_cm) / density
        cells = self.hole + np.repeat(np.arange(len(proposals)) * len(_APERTURES), self.detected)
        shape = (len(proposals), len(_APERTURES))
        sums, squares = (
            np.cumsum(np.bincount(cells, w, math.prod(shape)).reshape(shape), axis=1)
            for w in (weight, weight * weight)
        )
        # density lacks the factor 1 / proposals: photons of one proposal stand for those of all
        eta = sums.sum(axis=0) / photons
        variance = (squares - sums**2 / photons).sum(axis=0) / photons**2
        return eta / self._head_on, np.sqrt(variance) / self._head_on

    @cached_property
    def _head_on(self) -> float:
        """What the detector sees of light that meets it head-on, where it is calibrated."""
        return read_bench(bench_scene(**self.run.parameters)).head_on


class HistoryStore:
    """Histories on disk, in a folder that is made when something is written.

    Every run has random numbers of its own, of the store's seed.
    """

    def __init__(self, folder: Path, photons: int = PHOTONS, seed: int = 1) -> None:
        self.folder, self._photons, self._seed = folder, photons, seed
        self._loaded: dict[str, Histories] = {}

    def runs(self, changes: Changes) -> list[Run]:
        """Runs of a case, in the order of `MOUNTINGS`; InputError if the bench cannot be built."""
        return [self._run(changes, mounting) for mounting in MOUNTINGS]

    def _run(self, changes: Changes, mounting: Mounting) -> Run:
        own = mounting._asdict()
        of_masks = {
            name: v for name, v in changes.items() if name.startswith("aperture_radius_mm=")
        }
        changes = {name: v for name, v in changes.items() if name not in of_masks}
        others = {f"{name}={value:g}": name for name, value in own.items()}
        changes = {
            others.get(name, name): v
            for name, v in changes.items()
            if "=" not in name or name in others
        }
        parameters = {**own, **changes}
        if not is_filled(mounting.n_gap):
            parameters = {n: v for n, v in parameters.items() if n not in FILLED_ONLY}
        # a mask is cut out of the histories
        bench = unlike(parameters) + tuple(of_masks.items())
        is_plain = all(own.get(name) == value for name, value in bench)
        smallest = min(row[1] for row in POOL if mounting_of(row) == mounting)
        share = _SHARE.get(smallest, 1) * (PLAIN_FACTOR if is_plain else 1)
        proposals = PLAIN_PROPOSALS_PER_CM if is_plain else PROPOSALS_PER_CM
        return Run(bench, proposals, self._photons * share, self._seed)

    def missing(self, cases: Iterable[Changes]) -> list[Run]:
        """Runs that have no file yet, each once."""
        wanted = dict.fromkeys(run for changes in cases for run in self.runs(changes))
        return [run for run in wanted if not self._file(run).is_file()]

    def produce(
        self, cases: Iterable[Changes], report: Callable[..., None], executor: TrialExecutor
    ) -> None:
        """Trace what is missing, by whoever does the trials, or that part of it.

        Tells ``report("histories", done, total)``, in photons; RuntimeError if one cannot be
        traced.
        """
        missing = executor.share(self.missing(cases))
        if not missing:
            return
        make_folder(self.folder)
        done, total = 0, sum(run.photons * len(run.proposals_per_cm) for run in missing)
        report("histories", 0, total)
        work = {run: (self._file(run), run) for run in missing}
        with contextlib.closing(executor.outcomes(trace_to_file, work)) as outcomes:
            for run, photons, failure in outcomes:
                if failure is not None:
                    raise RuntimeError(f"the histories of {run.key}: {failure}")
                done += photons
                report("histories", done, total)

    def etas(
        self,
        changes: Changes,
        alpha_scat_per_cm: float,
        alpha_abs_per_cm: float,
        design: Design,
    ) -> tuple[Array, Array]:
        """Efficiencies of a design's rows, and their relative standard errors: (rows,)."""
        eta, error = np.empty(len(design)), np.empty(len(design))
        for mounting in dict.fromkeys(map(mounting_of, design)):
            run = self._run(changes, mounting)
            found, sigma = self.histories(run).eta(alpha_scat_per_cm, alpha_abs_per_cm)
            for number, row in enumerate(design):
                if mounting_of(row) == mounting:
                    hole = _APERTURES.index(row[1])
                    eta[number], error[number] = found[hole], sigma[hole] / found[hole]
        return eta, error

    def log_eta_table(
        self, changes: Changes, alpha_scat_per_cm: NDArray, alpha_abs_per_cm: NDArray
    ) -> Array:
        """(rows, alpha_scat, alpha_abs) logarithms of `POOL`'s efficiencies; kept in a file too."""
        axes = [axis.tolist() for axis in (alpha_scat_per_cm, alpha_abs_per_cm)]
        named = _digest([run.key for run in self.runs(changes)], POOL, *axes)
        file = self.folder / f"table-{named}.npz"
        kept = _read(file, ("log_eta",))
        if kept is not None:
            return kept["log_eta"]
        at = [[self.etas(changes, a_s, a_a, POOL)[0] for a_a in axes[1]] for a_s in axes[0]]
        log_eta = np.moveaxis(np.log(at), 2, 0)
        _write(file, {"log_eta": log_eta})
        return log_eta

    def histories(self, run: Run) -> Histories:
        """Histories of a run, traced here and now if its file is missing or damaged."""
        if run.key not in self._loaded:
            if len(self._loaded) >= 3 * len(MOUNTINGS):
                del self._loaded[next(iter(self._loaded))]
            arrays = _read(self._file(run), _ARRAYS)
            if arrays is None:
                make_folder(self.folder)
                trace_to_file(self._file(run), run)
                arrays = _read(self._file(run), _ARRAYS)
            arrays = {"scattering_path_cm": arrays["path_cm"]} | arrays
            self._loaded[run.key] = Histories(run, **arrays)
        return self._loaded[run.key]

    def _file(self, run: Run) -> Path:
        return self.folder / f"run-{run.key}.npz"


_ARRAYS = ("detected", "hole", "scatterings", "path_cm")


def trace_to_file(file: Path, run: Run) -> int:
    """Trace a run and write its file; returns the photons traced."""
    columns: dict[str, list[NDArray]] = {}
    for proposal, seed in zip(run.proposals_per_cm, run.seeds(), strict=True):
        scene = bench_scene(
            aperture_radius_mm=_OPEN_MM,
            alpha_scat_per_cm=proposal,
            alpha_abs_per_cm=ABSORPTION_PER_CM,
            **run.parameters,
        )
        found = trace(scene, run.photons, seed, histories=True, threads=1).histories
        hole = np.searchsorted(run.apertures_mm, found.mask_radius_mm).astype(np.uint8)
        kept = hole < len(_APERTURES)
        for name, part in {
            "detected": np.array([kept.sum()], np.int64),
            "hole": hole[kept],
            "scatterings": found.scatterings[kept].astype(np.uint16),
            "path_cm": found.path_cm[kept].astype(np.float32),
            "scattering_path_cm": found.scattering_path_cm[kept].astype(np.float32),
        }.items():
            columns.setdefault(name, []).append(part)
    arrays = {name: np.concatenate(parts) for name, parts in columns.items()}
    if np.array_equal(arrays["path_cm"], arrays["scattering_path_cm"]):
        del arrays["scattering_path_cm"]
    _write(file, arrays)
    return run.photons * len(run.proposals_per_cm)


def _write(file: Path, arrays: Mapping[str, NDArray]) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_bytes(file, content.getvalue())


def _read(file: Path, needed: Sequence[str]) -> dict[str, NDArray] | None:
    """Arrays of a file; None where it is missing or damaged."""
    try:
        with np.load(file) as stored:
            arrays = dict(stored)
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None
    return arrays if set(needed) <= set(arrays) else None


def _digest(*named: object) -> str:
    return hashlib.sha256(json.dumps(named).encode()).hexdigest()[:24]


@cache
def tracer_hash() -> str:
    """SHA-256 of the tracer's code; comments, docstrings and layout do not count."""
    return source_hash(TRACER_CODE)
