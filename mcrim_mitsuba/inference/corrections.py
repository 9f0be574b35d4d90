"""The pieces of physics that one index and an even source leave out, each put in by itself.

All simulations of a campaign draw the same random numbers, so that a part of their errors cancels
in the shifts. What the index does is found from simulations 0.1 to both sides of the scene's and a
polynomial through them: an index that is 0.005 away moves eta by about a fortieth of their
difference, with a fortieth of its error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.known_physics import (
    CRYSTAL_INDEX,
    DEPTH_MM,
    INDEX,
    POLARIZATION,
    SOURCE_DEPTH,
    KnownCrystal,
)
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.efficiency.responses import held_at
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, spread
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.inference.simulations import CampaignSimulations, spent_together
from mcrim_mitsuba.optics.dispersion import indices_of_light, orientation_sigma
from mcrim_mitsuba.optics.emission_band import BandIndices
from mcrim_mitsuba.optics.gammas import AttenuationLength

_ETA, _OVER = "eta ", " / "
_SHOWN_EFFICIENCIES = 2


# ---- numbers and their shifts ----


@dataclass(frozen=True, eq=False)
class Quantities:
    """Numbers that depend on the simulation, by name."""

    #: ``eta LABEL`` of every reading, ``eta LABEL / eta LABEL`` of two readings in use, and
    #: parameters by their own names.
    names: tuple[str, ...]
    #: (quantities,) float64: In the units of their names.
    values: Array
    #: (batches, quantities) float64: How far every batch of photons alone would be from `values`,
    #: to first order.
    batches: Array
    #: (tolerances, quantities) float64: How far a number of the bench that is off by its standard
    #: uncertainty moves them.
    by_tolerances: Array
    #: (quantities, free parameters) float64: d quantity / d free parameter of the fit.
    slopes: Array

    def main(self, priors: Sequence[str]) -> tuple[str, ...]:
        """What to show: two efficiencies, parameters not among `priors`, the light yield last."""
        efficiencies = [n for n in self.names if n.startswith(_ETA) and _OVER not in n]
        parameters = [n for n in self.names if not n.startswith(_ETA) and n not in priors]
        parameters.sort(key=lambda name: name in (LIGHT_YIELD, SCALE))
        return (*efficiencies[:_SHOWN_EFFICIENCIES], *parameters)

    @property
    def sigmas(self) -> Array:
        """(quantities,) Monte Carlo standard errors."""
        return spread(self.batches)


def at(model: ResponseModel, values: Mapping[str, float]) -> Quantities:
    """Efficiencies where the free parameters, at least, have given values.

    And their ratio, where two readings of light are in use.
    """
    theta = np.array([values[parameter.name] for parameter in model.free])
    prediction = model.predict(theta, covariance=True)
    eta, slopes = prediction.eta, prediction.eta_slopes
    batches = eta * model.eta_batches(theta)
    assert prediction.eta_of_tolerances is not None  # with the covariance
    by_tolerances = prediction.eta_of_tolerances.T
    names = [f"{_ETA}{reading.label}" for reading in model.readings]
    used = [i for i, reading in enumerate(model.readings) if reading.use and not reading.of_beam]
    if len(used) == 2:
        one, two = used
        names.append(f"{names[one]}{_OVER}{names[two]}")
        ratio = eta[one] / eta[two]

        def relative(of_eta: Array) -> Array:
            return of_eta[..., one, None] / eta[one] - of_eta[..., two, None] / eta[two]

        batches = np.hstack([batches, ratio * relative(batches)])
        by_tolerances = np.hstack([by_tolerances, ratio * relative(by_tolerances)])
        slopes = np.vstack([slopes, ratio * relative(slopes.T).T])
        eta = np.append(eta, ratio)
    return Quantities(tuple(names), eta, batches, by_tolerances, slopes)


def fitted(fit: Calibration) -> Quantities:
    """Efficiencies, their ratio and parameters where a fit ended, of the bench as readings have it.

    Where a batch alone would give other efficiencies, or a number of the bench is off, the fit
    would end elsewhere: by the response of the estimate to the readings, to first order.
    """
    model, theta = fit.model, fit.theta
    assert isinstance(model, ResponseModel)  # with batches
    there, per_eta = at(model, fit.values), model.predict(theta).signal_per_eta

    def moved(of_eta: Array) -> Array:
        """(..., free) a model that predicts more acts as a reading that is lower."""
        return -(of_eta[:, : len(per_eta)] * per_eta) @ fit.response.T

    def all_moved(directly: Array) -> Array:
        by_fit = moved(directly)
        return np.hstack([by_fit @ parameters.T, directly + by_fit @ there.slopes.T])

    offsets = [number.offset / number.tolerance.sigma for number in fit.offsets]
    names, parameters = list(fit.names), np.eye(len(theta))
    for scale, (name, known) in model.campaign.light_yields.items():
        if scale in names:
            place = names.index(scale)
            names[place], parameters[place, place] = name, known.per_scale
    return Quantities(
        (*names, *there.names),
        np.concatenate([parameters @ theta, there.values + offsets @ there.by_tolerances]),
        all_moved(there.batches),
        all_moved(there.by_tolerances),
        np.vstack([parameters, there.slopes]),
    )


@dataclass(frozen=True)
class Shift:
    """How a number moves when a piece of physics is put into the model."""

    #: Without it and with it, in the unit of the number.
    before: float
    after: float
    #: Standard error of the difference from the simulation.
    monte_carlo_sigma: float
    #: Standard error of the difference because the size of the piece is known to its own error
    #: only; 0 where it has none.
    size_sigma: float = 0.0

    @property
    def shift(self) -> float:
        """after - before."""
        return self.after - self.before

    @property
    def relative(self) -> float:
        """`shift` over `before`; NaN where that is 0."""
        return self.shift / self.before if self.before else math.nan

    @property
    def as_error(self) -> float:
        """Size of the shift, its own error in quadrature: for what is not corrected."""
        return math.hypot(self.shift, self.size_sigma)


def shifts(
    before: Quantities, after: Quantities, size_sigmas: Mapping[str, float] | None = None
) -> dict[str, Shift]:
    """Shifts of all quantities that both have, of simulations with the same seed.

    `size_sigmas` are `Shift.size_sigma` by quantity.
    """
    common = [name for name in before.names if name in after.names]
    first, second = ([side.names.index(name) for name in common] for side in (before, after))
    sigmas = spread(after.batches[:, second] - before.batches[:, first])
    ends = before.values[first].tolist(), after.values[second].tolist()
    numbers = zip(common, *ends, sigmas.tolist(), strict=True)
    sizes = size_sigmas or {}
    return {n: Shift(old, new, sigma, sizes.get(n, 0.0)) for n, old, new, sigma in numbers}


@dataclass(frozen=True, kw_only=True)
class Neglected:
    """A piece of physics, put into the campaign's model."""

    #: Its id, an effect's where it is one.
    name: str
    #: A few words for tables.
    title: str
    #: True: its size is known and the model can take it, so that it has to be put in. False: the
    #: model has no place for it, and it counts as a systematic error.
    correction: bool
    #: What was put in, with its numbers.
    put_in: str
    #: How it is corrected, or what would make the error smaller.
    mend: str
    #: Efficiencies and their ratio at the coefficients that the campaign's own fit found.
    at_fixed: dict[str, Shift]
    #: The same, and all parameters, where the fit with the piece ends.
    refitted: dict[str, Shift]


def too_far(campaign: Campaign, band: BandIndices) -> str | None:
    """Why indices are not told from simulations about the scene's own; None where they are."""
    nominal = float(campaign.scene.parameters[INDEX])
    effect = campaign.catalogue[CRYSTAL_INDEX].parameters[0]
    mean = band.over.mean
    farthest = max(abs(mean - nominal) + 2 * band.over.sigma, *np.abs(band.indices - mean))
    if farthest <= effect.maximum:
        return None
    of_band = f"that of {band.material.name} over {band.origin}"
    return f"the scene's {INDEX} = {nominal:g} is too far from {mean:.4g}, {of_band}"


# ---- fits with pieces put in ----


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit with the quantities that come of it."""

    fit: Calibration
    #: At the coefficients of the campaign's own fit.
    at_fixed: Quantities
    refitted: Quantities


class NeglectWork:
    """A campaign's benches, as they are and with what can be put into a scene, and their fits.

    All benches draw the same random numbers; the photons of `run` are those of every simulation
    with another index.
    """

    def __init__(self, campaign: Campaign, known: KnownCrystal, run: Run) -> None:
        self._known = known.left_out_of(campaign)
        #: Pieces that were not put in, and why.
        self.refused = self._known.refused
        self._campaign, self._run = campaign, run
        self._band = known.band
        if CRYSTAL_INDEX not in (*self._known.effects, *campaign.known_physics):
            self._band = None
        elif self._band is not None and (reason := too_far(campaign, self._band)) is not None:
            self.refused[CRYSTAL_INDEX], self._band = reason, None
        self._benches: list[CampaignSimulations] = []
        self._index = (CRYSTAL_INDEX,) * (self._band is not None)
        # births can be weighted too: that tells what the depth's error does
        depth = (SOURCE_DEPTH,) * (SOURCE_DEPTH in self._known.effects)
        #: Of the campaign as it is.
        self.bench = self._bench(effects=(*self._index, *depth))
        self._fixed: dict[str, float] = {}
        self._own = self._refit(self.bench)
        self._fixed = self._own.fit.values

    def _bench(self, *put_in: str, effects: tuple[str, ...] = ()) -> CampaignSimulations:
        """A bench with known physics put into its scene, simulated with more effects besides."""
        scene = self._known.put_into(self._campaign.scene, *put_in)
        bench = CampaignSimulations(replace(self._campaign, scene=scene), self._run)
        bench.simulate(effects)
        self._benches.append(bench)
        return bench

    def _refit(
        self,
        bench: CampaignSimulations,
        effect: str = "",
        values: Sequence[float] | Array = (),
        parts: Sequence[float] | Array = (1.0,),
    ) -> Refit:
        """The fit on a bench, with an effect held at a value, or at one for each part of light."""
        campaign, responses = bench.campaign, bench.models.responses
        effects = campaign.switched_on
        if effect:
            held = held_at(responses.effects[effect], values, parts)
            responses = replace(responses, effects={**responses.effects, effect: held})
            # none of its parameters is left
            effects = [*effects, replace(campaign.catalogue[effect], parameters=())]
        model = ResponseModel(campaign, responses, effects)
        fit = fit_model(model, profile=False)
        return Refit(fit, at(model, fit.values | self._fixed), fitted(fit))

    def _moved(
        self, after: Refit, doubt: tuple[str, float, float] | None = None
    ) -> dict[str, dict[str, Shift]]:
        """What a piece moves by the fit with it: `Neglected.at_fixed` and `Neglected.refitted`.

        The doubt is an effect, a value of its parameter, and the error of that.
        """
        ends = []
        if doubt is not None:
            effect, value, sigma = doubt
            ends = [self._refit(self.bench, effect, [value + sign * sigma]) for sign in (-1, 1)]
        moved = {}
        for kind in ("at_fixed", "refitted"):
            before, then = getattr(self._own, kind), getattr(after, kind)
            between = shifts(*(getattr(end, kind) for end in ends)) if ends else {}
            sizes = {name: abs(shift.shift) / 2 for name, shift in between.items()}
            moved[kind] = shifts(before, then, sizes)
        return moved

    def neglected(self) -> tuple[Neglected, ...]:
        """Every piece by itself, corrections first."""
        known, pieces = self._known, []
        if known.depth is not None and SOURCE_DEPTH in known.effects:
            pieces.append(self._source_depth(known.depth))
        if POLARIZATION in known.effects:
            pieces.append(self._polarization())
        if self._band is not None:
            if CRYSTAL_INDEX in known.effects:
                pieces.append(self._crystal_index(self._band))
            pieces.append(self._index_spread(self._band))
            if self._band.material.extraordinary is not None:
                pieces.append(self._birefringence(self._band))
        return tuple(pieces)

    def _source_depth(self, length: AttenuationLength) -> Neglected:
        """Light is born where the gammas stop below the top, not everywhere alike."""
        depth, sigma = length.length_mm, length.sigma_mm
        return Neglected(
            name=SOURCE_DEPTH,
            title="source depth",
            correction=True,
            put_in=f"births exp(-t/d) below the top, d = {pdg(depth, sigma)} mm "
            f"({length.energy_keV:g} keV gammas in {length.formula} of "
            f"{length.density_g_per_cm3:g} g/cm3, through the top)",
            mend=f'write effects = ["{SOURCE_DEPTH}"] and [parameters.{DEPTH_MM}] with '
            f"prior = {depth:.3f}, prior_sigma = {sigma:.3f}",
            **self._moved(self._refit(self._bench(SOURCE_DEPTH)), (SOURCE_DEPTH, depth, sigma)),
        )

    def _polarization(self) -> Neglected:
        """Every photon keeps its polarisation from one face to the next."""
        return Neglected(
            name=POLARIZATION,
            title="polarisation",
            correction=True,
            put_in="each photon's polarisation followed",
            mend="set polarization to true in the scene, as `mcrim add polarization` does",
            **self._moved(self._refit(self._bench(POLARIZATION))),
        )

    def _crystal_index(self, band: BandIndices) -> Neglected:
        """The crystal has its material's index, the mean over the light that is detected."""
        mean, sigma = band.over.mean, band.over.sigma
        doubt = CRYSTAL_INDEX, mean, sigma
        return Neglected(
            name=CRYSTAL_INDEX,
            title="crystal's index",
            correction=True,
            put_in=f"n = {pdg(mean, sigma)} in the place of {self._nominal:g} "
            f"({band.material.name} over {band.origin})",
            mend=f"set {INDEX} to {mean:.4f} in the scene",
            **self._moved(self._refit(self.bench, CRYSTAL_INDEX, [mean]), doubt),
        )

    def _index_spread(self, band: BandIndices) -> Neglected:
        """Every wavelength of the band has its own index; their mean stays the scene's."""
        return Neglected(
            name="index_spread",
            title="index spread",
            correction=False,
            put_in=f"indices of {band.material.name} over {band.origin}: ± "
            f"{band.over.spread:.4f} about their mean",
            mend="nothing: one index stands for a band",
            **self._moved(self._spread_over(band.indices, band.parts)),
        )

    def _birefringence(self, band: BandIndices) -> Neglected:
        """Half of the light is ordinary, half extraordinary; see `optics.dispersion`.

        The shift is that of light that keeps its wave all the way; `Shift.size_sigma` is the doubt
        where the optic axis points.
        """
        ordinary, extraordinary = band.over.ordinary_mean, band.over.extraordinary_mean
        assert extraordinary is not None
        sigma = orientation_sigma(ordinary, extraordinary)
        doubt = CRYSTAL_INDEX, self._nominal, sigma
        return Neglected(
            name="birefringence",
            title="birefringence",
            correction=False,
            put_in=f"n_o = {ordinary:.4f} and n_e = {extraordinary:.4f}; the optic axis of unknown "
            f"direction makes the index uncertain by {sigma:.4f}",
            mend="the crystal's cut: with the optic axis at the angle b to the window's normal the "
            f"index is {ordinary:.4f} {extraordinary - ordinary:+.4f} sin^2(b) / 2",
            **self._moved(self._spread_over(*indices_of_light(ordinary, extraordinary)), doubt),
        )

    @property
    def _nominal(self) -> float:
        """The scene's index of the crystal."""
        return float(self._campaign.scene.parameters[INDEX])

    def _spread_over(self, indices: Array, parts: Array) -> Refit:
        """The fit where parts of the light have indices of their own, with the scene's as mean."""
        about_nominal = self._nominal + indices - parts @ indices
        return self._refit(self.bench, CRYSTAL_INDEX, about_nominal, parts)

    def together(self, neglected: tuple[Neglected, ...]) -> Neglected | None:
        """All corrections in one fit."""
        if self.corrected is None:
            return None
        return Neglected(
            name="together",
            title="all corrections",
            correction=True,
            put_in=", ".join(piece.title for piece in neglected if piece.correction),
            mend="as each of them",
            **self._moved(self.corrected),
        )

    @cached_property
    def corrected(self) -> Refit | None:
        """The fit with all corrections; None where there is none."""
        # an index is found from its response, other effects are simulated
        simulated = [name for name in self._known.effects if name != CRYSTAL_INDEX]
        bench = self._bench(*simulated, effects=self._index) if simulated else self.bench
        if self._band is not None and CRYSTAL_INDEX in self._known.effects:
            return self._refit(bench, CRYSTAL_INDEX, [self._band.over.mean])
        return self._refit(bench) if simulated else None

    def provenance(self) -> Provenance:
        """Of all benches together."""
        return spent_together([bench.provenance() for bench in self._benches])
