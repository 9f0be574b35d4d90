"""Photon records answered on a grid of coefficients: eta by batch, at every node.

With absorption applied as a weight, the number k of scatterings in the crystal and the path
L there are all of a photon's history that depends on the coefficients: its density is
a_s^k exp(-a_s L) times what the geometry makes of it, its weight exp(-a_a L). Photons drawn
from several proposals a_j, N_j from each, are used together by the balance heuristic
(E. Veach and L. J. Guibas, SIGGRAPH 95, 419): each counts with the target's density over
that of the mixture,

    c = w exp(-(a_a - a_a0) L) a_s^k exp(-a_s L) / sum_j (N_j / N) a_j^k exp(-a_j L),

and eta = sum(c) / N is unbiased wherever one proposal scatters. Every photon counts at every node,
so nothing is approximated but what lies between the nodes, where log(eta) is a polynomial.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import COEFFICIENTS, COUNTED, Value
from mcrim_mitsuba.core.run import one_thread
from mcrim_mitsuba.effects.effect import Effect, modules_of
from mcrim_mitsuba.efficiency.surface import Lagrange, chebyshev_nodes
from mcrim_mitsuba.runs.executors import Content
from mcrim_mitsuba.runs.scene_units import PortableScene, SceneUnit
from mcrim_mitsuba.scene.check_text import detectors_of
from mcrim_mitsuba.scene.emitted_light import Colours
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.xml_tree import Node
from mcrim_mitsuba.transport.launch_plan import PhotonRecords, ScatteringProposals

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation


#: Batches of a table; those of the records are joined. Their spread gives errors to 13 %.
BATCHES = 32
#: Smallest exponent, and the largest one with the other sign: what is below cannot be seen, and
#: subnormal numbers take long; what is above is no photon that was ever drawn.
_LEAST_LOG = np.float32(-80.0)
#: Nodes of a grid in alpha_scat and in alpha_abs: in any case, and per length of its logarithm.
_FINE_NODES = (3.0, 2.0), (3.0, 1.35)
_COARSE_NODES = (1.0, 1.3), (2.0, 0.85)
#: Stands for no scattering where a logarithm is taken.
_HARDLY_ANY_PER_CM = 1e-9
#: Largest and smallest offset of alpha_abs.
_OFFSET_PER_CM = 0.02
_LEAST_OFFSET_PER_CM = 0.001


@dataclass(frozen=True)
class Grid:
    """Nodes in alpha_scat and alpha_abs."""

    alpha_scat_range_per_cm: tuple[float, float]
    alpha_abs_range_per_cm: tuple[float, float]
    #: With fewer nodes, for what effects add.
    coarse: bool = False

    @cached_property
    def counts(self) -> tuple[int, int]:
        """Nodes in alpha_scat and in alpha_abs: what lies between them is right to 1e-4.

        Light that is trapped until it scatters is a_s / (a_s + a_a) of itself, which has poles pi
        beside the real axis of log(a_s): how fast polynomials converge is a matter of the range's
        length over pi.
        """
        axes = zip(_COARSE_NODES if self.coarse else _FINE_NODES, self._ends, strict=True)
        scattering, absorption = (
            math.ceil(least + per_length * (high - low)) if high > low else 1
            for (least, per_length), (low, high) in axes
        )
        return scattering, absorption

    @cached_property
    def _ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ends of the two axes."""
        low, high = self.place_of_scattering(np.array(self.alpha_scat_range_per_cm)).tolist()
        least, most = self.place_of_absorption(np.array(self.alpha_abs_range_per_cm)).tolist()
        return (low, high), (least, most)

    @cached_property
    def offset_per_cm(self) -> float:
        """Added to alpha_abs before its logarithm is taken.

        Light meets other losses besides, and scattering; where it scatters little, the poles of
        what is trapped, not far below an alpha_abs of 0, would come near the range.
        """
        half = self.alpha_scat_range_per_cm[0] / 2.0
        return min(max(half, _LEAST_OFFSET_PER_CM), _OFFSET_PER_CM)

    @cached_property
    def scattering(self) -> Lagrange:
        """In the logarithm of alpha_scat, over which eta changes evenly."""
        return Lagrange(chebyshev_nodes(*self._ends[0], self.counts[0]))

    @cached_property
    def absorption(self) -> Lagrange:
        """In log(alpha_abs + `offset_per_cm`)."""
        return Lagrange(chebyshev_nodes(*self._ends[1], self.counts[1]))

    def coefficients_per_cm(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """alpha_scat (nodes, 1) and alpha_abs (1, nodes)."""
        alpha_abs = np.exp(self.absorption.nodes) - self.offset_per_cm
        return np.exp(self.scattering.nodes)[:, None], alpha_abs[None, :]

    def place_of_scattering(self, alpha_scat_per_cm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where scatterings lie on the axis of `scattering`."""
        return np.asarray(np.log(np.maximum(alpha_scat_per_cm, _HARDLY_ANY_PER_CM)), np.float64)

    def place_of_absorption(self, alpha_abs_per_cm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where absorptions lie on the axis of `absorption`."""
        return np.asarray(np.log(alpha_abs_per_cm + self.offset_per_cm), np.float64)

    def weights_at(
        self, alpha_scat_per_cm: NDArray[np.float64], alpha_abs_per_cm: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(points, nodes) weights of a table's values, flattened, at (points,) coefficients.

        One coefficient may stand for all points.
        """
        scattering = self.scattering.weights_at(self.place_of_scattering(alpha_scat_per_cm))
        absorption = self.absorption.weights_at(self.place_of_absorption(alpha_abs_per_cm))
        both = scattering[:, :, None] * absorption[:, None, :]
        return both.reshape(len(both), -1)


@dataclass(frozen=True, eq=False)
class EtaGrid:
    """The light collection efficiency on a grid."""

    #: (scattering nodes, absorption nodes) float64
    log_eta: NDArray[np.float64]
    #: (batches, scattering nodes, absorption nodes) float32: Every batch's eta over that of all,
    #: minus one.
    deviations: NDArray[np.float32]

    @property
    def usual_error(self) -> float:
        """Relative standard error of eta in the middle of the grid."""
        _, rows, columns = self.deviations.shape
        return float(standard_error(self.deviations[:, rows // 2, columns // 2]))


def standard_error(batches: NDArray[np.floating]) -> NDArray[np.float64]:
    """Standard error of the mean of (batches, ...) values."""
    return np.asarray(batches.std(axis=0, ddof=1) / math.sqrt(len(batches)), np.float64)


def merged(tables: Sequence[EtaGrid], photons: Sequence[int]) -> EtaGrid:
    """The table of several launches, of so many photons each."""
    shares = np.array(photons) / sum(photons)
    etas = [share * np.exp(table.log_eta) for share, table in zip(shares, tables, strict=True)]
    eta = np.sum(etas, axis=0)
    of_batches = np.zeros(tables[0].deviations.shape)
    for part, table in zip(etas, tables, strict=True):
        # a launch that sees nothing has no deviations
        of_batches += part * np.nan_to_num(table.deviations)
    with np.errstate(divide="ignore", invalid="ignore"):
        return EtaGrid(np.log(eta), (of_batches / eta).astype(np.float32))


def averaged(table: EtaGrid, grid: Grid, colours: Colours) -> EtaGrid:
    """The table of light of several colours; beyond the grid coefficients are those at its end."""
    scattering, absorption = (each.ravel() for each in grid.coefficients_per_cm())
    ranges = grid.alpha_scat_range_per_cm, grid.alpha_abs_range_per_cm
    every = table.deviations.astype(np.float64)
    eta, of_batches = np.zeros_like(table.log_eta), np.zeros_like(every)
    for part, *factors in zip(colours.parts, colours.scattering, colours.absorption, strict=True):
        scatters = grid.place_of_scattering(np.clip(factors[0] * scattering, *ranges[0]))
        absorbs = grid.place_of_absorption(np.clip(factors[1] * absorption, *ranges[1]))
        along, across = grid.scattering.weights_at(scatters), grid.absorption.weights_at(absorbs)
        one = part * np.exp(along @ table.log_eta @ across.T)
        eta += one
        of_batches += one * (along @ every @ across.T)
    return EtaGrid(np.log(eta), (of_batches / eta).astype(np.float32))


def difference(changed: EtaGrid, plain: EtaGrid, known: EtaGrid) -> EtaGrid:
    """What an effect adds to log(eta), by photons `changed` by it and `plain`, of the same numbers.

    `known` is eta without the effect, of more photons or by a closed form. What photons without the
    effect are off by, those with it are mostly off by, too. It is taken away as far as the two go
    together in batches (a control variate: J. M. Hammersley and D. C. Handscomb, Monte Carlo
    Methods, Methuen 1964, chapter 5).
    """
    with_it = changed.deviations - known.deviations
    without = plain.deviations - known.deviations
    square = float((without.astype(float) ** 2).sum())
    common = float((with_it.astype(float) * without).sum()) / square if square > 0 else 0.0
    share = min(max(common, 0.0), 1.0)
    return EtaGrid(
        changed.log_eta - known.log_eta - share * (plain.log_eta - known.log_eta),
        with_it - np.float32(share) * without,
    )


class GridReweighter:
    """Records of one launch, prepared for being summed on a grid with several weights.

    Photons that are `kept`, (detected,) bool, count; all when it is not given. The records'
    batches are joined to so many.
    """

    def __init__(
        self,
        records: PhotonRecords,
        grid: Grid,
        kept: NDArray[np.bool_] | None = None,
        batches: int = BATCHES,
    ) -> None:
        self._batches = batches
        # small integers are sorted by their digits
        batch = records.batch if batches == records.batches else records.batch % np.uint8(batches)
        order = np.argsort(batch, kind="stable")
        if kept is not None:
            order = order[kept[order]]
        self.order = order
        self._ends = np.cumsum([0, *np.bincount(batch[order], minlength=batches)])
        self._photons = records.photons
        self._k = records.k[order].astype(np.float32)
        path = records.path_cm[order]
        flown = records.further.get("scattering_path_cm")
        self._scattering_path = path if flown is None else flown[order].astype(np.float32)
        shares = records.photons_per_proposal / records.photons
        self._log_mixture = _log_mixture(
            self._k, self._scattering_path, shares, records.alpha_scat_proposals_per_cm
        )
        self._alpha_scat_per_cm = np.exp(grid.scattering.nodes)
        self._scattering = np.empty((grid.counts[0], len(order)), dtype=np.float32)
        self._fill_densities(self._scattering, 1.0)
        self._absorption = np.empty((grid.counts[1], len(order)), dtype=np.float32)
        w = records.w[order]
        _, alpha_abs_per_cm = grid.coefficients_per_cm()
        for row, alpha in zip(self._absorption, alpha_abs_per_cm[0], strict=True):
            np.multiply(path, np.float32(records.alpha_abs_proposal_per_cm - alpha), out=row)
            np.exp(np.maximum(row, _LEAST_LOG, out=row), out=row)
            row *= w

    def _fill_densities(self, densities: NDArray[np.float32], factor: float) -> None:
        """Write (nodes, kept) densities at so many times alpha_scat, over that of the proposals."""
        scattered = np.empty_like(self._scattering_path)
        for row, alpha in zip(densities, factor * self._alpha_scat_per_cm, strict=True):
            np.multiply(self._k, np.float32(np.log(alpha)), out=row)
            row -= np.multiply(self._scattering_path, np.float32(alpha), out=scattered)
            row -= self._log_mixture
            np.exp(np.clip(row, _LEAST_LOG, -_LEAST_LOG, out=row), out=row)

    def table(
        self,
        weight: NDArray | None = None,
        colours: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    ) -> EtaGrid:
        """Eta on the grid.

        Every photon's weight is times `weight`, (kept,) in the order `order`. Of `colours`, parts
        of the light and factors on its alpha_scat, the mean is taken.
        """
        scattering, absorption = self._scattering, self._absorption
        if colours is not None:
            # memory that is new takes longer to come by than what is written to it
            scattering, of_colour = np.zeros((2, *self._scattering.shape), dtype=np.float32)
            for part, factor in zip(*colours, strict=True):
                self._fill_densities(of_colour, factor)
                of_colour *= np.float32(part)
                scattering += of_colour
        by_batch = np.empty((self._batches, len(scattering), len(absorption)))
        if weight is not None:
            absorption = absorption * weight.astype(np.float32)
        for batch, (first, last) in enumerate(zip(self._ends, self._ends[1:], strict=False)):
            by_batch[batch] = scattering[:, first:last] @ absorption[:, first:last].T
        total = by_batch.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            deviations = by_batch * self._batches / total - 1.0
            log_eta = np.log(total / self._photons)
        return EtaGrid(log_eta, deviations.astype(np.float32))


def _log_mixture(
    k: NDArray[np.float32],
    path_cm: NDArray[np.float32],
    shares: Iterable[float],
    proposals_per_cm: Iterable[float],
) -> NDArray[np.float32]:
    """Logarithm of sum_j share_j a_j^k exp(-a_j L), shaped like `k`."""
    drawn = [(share, a) for share, a in zip(shares, proposals_per_cm, strict=True) if share > 0]
    terms, scattered = np.empty((len(drawn), len(k)), dtype=np.float32), np.empty_like(path_cm)
    for row, (share, proposal) in zip(terms, drawn, strict=True):
        np.multiply(k, np.float32(np.log(proposal)), out=row)
        row -= np.multiply(path_cm, np.float32(proposal), out=scattered)
        row += np.float32(np.log(share))
    # one exponential each is a tenth of the time of logaddexp
    largest = terms.max(axis=0)
    terms -= largest
    np.exp(np.maximum(terms, _LEAST_LOG, out=terms), out=terms)
    return largest + np.log(terms.sum(axis=0))


# A mask that may be cut out of the records of a bench on which it covers nothing.

#: Scene parameter that is the radius of the hole in a mask, and a radius (in window widths) that
#: leaves all of a square window open.
APERTURE, WINDOW, _OPEN_WIDTHS = "aperture_radius_mm", "window_width_mm", 2.0


def open_aperture(parameters: Mapping[str, Value]) -> dict[str, float]:
    """The parameter that opens the mask of a scene with these ones, as `has_open_mask` wants it."""
    return {APERTURE: _OPEN_WIDTHS * float(parameters[WINDOW])}


@functools.lru_cache(maxsize=64)
def has_open_mask(scene: SceneFile) -> bool:
    """Whether the scene's aperture parameter is the radius of masks on a square window, only.

    Of black ones: light that others reflect goes on. Records with an open mask answer all others.
    """
    if APERTURE not in scene.parameters or WINDOW not in scene.parameters:
        return False
    masks = (bsdf for bsdf in scene.root.iter("bsdf") if bsdf.get("type") == "aperture")
    if any(part.get("name") == "reflectance" for mask in masks for part in mask):
        return False
    return _changes_only("radius", "aperture", scene, open_aperture(scene.parameters))


@functools.lru_cache(maxsize=64)
def tells_detectors(scene: SceneFile) -> bool:
    """Whether a parameter says whose light is eta, only: records of all then answer for each."""
    detectors = detectors_of(scene)
    if COUNTED not in scene.parameters or len(detectors) < 2:
        return False
    other = next(name for name in detectors if name != scene.parameters[COUNTED])
    return _changes_only(COUNTED, "light_collection", scene, {COUNTED: other})


def _changes_only(name: str, plugin: str, scene: SceneFile, overrides: Mapping[str, Value]) -> bool:
    """Whether overrides change what is called `name` of all of a plugin's elements, no more."""
    elements = (e for e in scene.root.iter(etree.Element) if e.type == plugin)
    return _changed(scene, overrides) == [element.named(name) for element in elements]


def _changed(scene: SceneFile, overrides: Mapping[str, Value]) -> list[Node]:
    """Elements of a scene that overrides change."""
    pairs = zip(scene.root.iter(), scene.with_overrides(overrides).root.iter(), strict=True)
    return [before for before, after in pairs if before.attrib != after.attrib]


@functools.lru_cache(maxsize=128)
def refuse_shared_coefficients(scene: SceneFile) -> None:
    """Refuse (InputError) a scene whose coefficients are not the crystal's alone.

    Records answer for the crystal: all else would keep its own.
    """
    crystals = [m for e in scene.root.iter("emitter") for m in scene.parts.targets(e, "medium")]
    for name in COEFFICIENTS:
        changed = _changed(scene, {name: 0.25 if scene.parameters[name] == 0.5 else 0.5})
        for other in changed:
            if (medium := other.getparent()) in crystals or medium is None:
                continue
            problem = f"{name} is not the crystal's alone, as fits and tables need it: "
            mend = "give that a parameter of its own, and the crystal this one"
            path, line = scene.place_of(other)
            raise InputError(f"{problem}{medium.label} has it", mend, path=path, line=line)


def counted(
    records: PhotonRecords,
    mask: str | None,
    radius_mm: float | None,
    detector: str | None,
    detectors: list[str],
) -> NDArray[np.bool_] | None:
    """(detected,) photons that a mask lets through and that a detector took; None for all.

    `mask` is the column that holds the radius which it must have, `detectors` their names.
    """
    kept = None if mask is None else records.further[mask] <= radius_mm
    if detector is None:
        return kept
    taken = records.further[DETECTOR_HIT] == detectors.index(detector)
    return taken if kept is None else taken & kept


# One simulation with the tables of eta that are made of its photons: a unit of diagnoses.

MASK, ANGLE = "mask_radius_mm", "arrival_angle_deg"
#: Column of the detector's number.
DETECTOR_HIT = "detector"
#: Tables that are made at once.
_AT_ONCE = 2


@dataclass(frozen=True)
class TableRequest:
    """A table that is wanted of a simulation's photons."""

    #: Of its chunk.
    number: int
    #: Which of the two grids.
    coarse: bool
    #: Of a mask, to be cut out of the records; None: photons count as they are.
    radius_mm: float | None
    #: Whose light counts; None: that of the scene's.
    detector: str | None
    #: That weights the photons.
    effect: Effect | None
    #: Of the effect's parameters.
    values: Mapping[str, float]
    #: Of the configuration.
    parameters: Mapping[str, Value]
    #: Whether the simulation is of a spectrophotometer, whose detector takes angles (degrees)
    #: up to `radius_mm`.
    of_beam: bool

    @property
    def mask(self) -> str:
        """Column that holds the radius which a mask must have to let the photon through."""
        if self.of_beam:
            return ANGLE
        return MASK if self.effect is None else self.effect.mask_column

    @property
    def columns(self) -> tuple[str, ...]:
        """Of the records, that it is made of."""
        own = () if self.effect is None else (*self.effect.columns, self.mask)
        own += () if self.detector is None else (DETECTOR_HIT,)
        return own if self.radius_mm is None else (ANGLE if self.of_beam else MASK, *own)


@dataclass(frozen=True)
class TableUnit(SceneUnit):
    """One simulation with the tables that are made of it."""

    proposals: ScatteringProposals
    photons: int
    #: The fine one and the coarse one.
    grids: tuple[Grid, Grid]
    requests: tuple[TableRequest, ...]

    @property
    def numbers(self) -> tuple[int, ...]:
        return tuple(request.number for request in self.requests)

    @property
    def modules(self) -> set[str]:
        effects = (request.effect for request in self.requests if request.effect is not None)
        return super().modules | modules_of(effects)

    def make(self, threads: int | None) -> dict[int, Content]:
        columns = [name for request in self.requests for name in request.columns]
        simulation = self.loaded(threads)  # chooses an LLVM before Dr.Jit is imported
        from mcrim_mitsuba.transport.collection import Recorder

        records = Recorder(simulation).record(
            self.proposals,
            self.photons,
            seed=self.seed,
            number=0,
            columns=tuple(dict.fromkeys(columns)),
            batches=BATCHES,
        )
        groups: dict[tuple[bool, str, float | None, str | None], list[TableRequest]] = {}
        for request in self.requests:
            # beams are cut at their angles photon by photon: one preparation serves all
            radius_mm = None if request.of_beam else request.radius_mm
            key = request.coarse, request.mask, radius_mm, request.detector
            groups.setdefault(key, []).append(request)
        at_once = min(threads or _AT_ONCE, _AT_ONCE)
        with one_thread(), ThreadPoolExecutor(at_once) as pool:
            for_each = map if at_once == 1 else pool.map
            detectors = simulation.model.detectors
            made = for_each(lambda of: self._tables(records, of, detectors), groups.values())
            return {number: content for tables in made for number, content in tables}

    def loaded(self, threads: int | None, *, check: bool = False) -> Simulation:
        """See `SceneUnit.loaded`."""
        try:
            return super().loaded(threads, check=check)
        except InputError as error:
            if isinstance(self.scene, PortableScene) or self.own_scene.unwritten_text is None:
                raise
            # its lines are those of a text that nobody has seen
            raise InputError(
                f"with an effect in it (as mcrim add writes it) the scene is refused: "
                f"{error.problem}",
                error.mend,
                path=self.scene.path,
            ) from None

    def _tables(
        self, records: PhotonRecords, group: list[TableRequest], detectors: list[str]
    ) -> list[tuple[int, Content]]:
        """Tables on one grid behind one mask, of one of the `detectors` or of all."""
        first = group[0]
        mask = None if first.radius_mm is None or first.of_beam else first.mask
        kept = counted(records, mask, first.radius_mm, first.detector, detectors)
        gathering = GridReweighter(records, self.grids[first.coarse], kept)
        columns = {name: column[gathering.order] for name, column in records.further.items()}
        made: list[tuple[int, Content]] = []
        for request in group:
            weight = colours = None
            if (effect := request.effect) is not None:
                if effect.colours is not None:
                    colours = effect.colours(request.values, request.parameters)
                if effect.weight is not None:
                    weight = effect.weight(columns, request.values, request.parameters)
            if request.of_beam and request.radius_mm is not None:
                within = columns[ANGLE] <= request.radius_mm
                weight = within if weight is None else within * weight
            made.append((request.number, content_of(gathering.table(weight, colours))))
        return made


def content_of(table: EtaGrid) -> Content:
    """What a chunk holds of a table."""
    return {"log_eta": table.log_eta.ravel(), "deviations": table.deviations.ravel()}, {}


def table_of(arrays: Mapping[str, NDArray], *shape: int) -> EtaGrid:
    """The table that a chunk holds, of nodes in this shape."""
    return EtaGrid(arrays["log_eta"].reshape(shape), arrays["deviations"].reshape(-1, *shape))
