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
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.efficiency.responses import EffectResponse, mixture
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, spread
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.inference.simulations import CampaignSimulations, spent_together
from mcrim_mitsuba.optics.dispersion import indices_of_light, orientation_sigma
from mcrim_mitsuba.optics.emission_band import BandIndices
from mcrim_mitsuba.optics.gammas import AttenuationLength

_ETA, _OVER = "eta ", " / "
_SHOWN_EFFICIENCIES = 2
#: Name of what stands in for an effect where light has many indices.
_MIXED = "indices"


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
    """Efficiencies and their ratio where the free parameters, at least, have given values."""
    theta = np.array([values[parameter.name] for parameter in model.free])
    prediction = model.predict(theta)
    batches = prediction.eta * model.eta_batches(theta)
    return _of_eta(model, prediction.eta, batches, prediction.eta_slopes)


def fitted(fit: Calibration) -> Quantities:
    """Efficiencies, their ratio and parameters where a fit ended.

    Where a batch alone would give other efficiencies, the fit would end elsewhere: by the
    response of the estimate to the readings, to first order.
    """
    model, theta = fit.model, fit.theta
    assert isinstance(model, ResponseModel)  # with batches
    prediction = model.predict(theta)
    own = prediction.eta * model.eta_batches(theta)
    # a model that predicts more acts as a reading that is lower
    moved = -(own * prediction.signal_per_eta) @ fit.response.T
    slopes = prediction.eta_slopes
    etas = _of_eta(model, prediction.eta, own + moved @ slopes.T, slopes)
    names, parameters = list(fit.names), np.eye(len(theta))
    for scale, (name, known) in model.campaign.light_yields.items():
        if scale in names:
            place = names.index(scale)
            names[place], parameters[place, place] = name, known.per_scale
    return Quantities(
        (*names, *etas.names),
        np.concatenate([parameters @ theta, etas.values]),
        np.hstack([moved @ parameters.T, etas.batches]),
        np.vstack([parameters, etas.slopes]),
    )


def _of_eta(model: ResponseModel, eta: Array, batches: Array, slopes: Array) -> Quantities:
    """Efficiencies, and the ratio of the two where two readings of light are in use."""
    names = [f"{_ETA}{reading.label}" for reading in model.readings]
    used = [i for i, reading in enumerate(model.readings) if reading.use and not reading.of_beam]
    if len(used) == 2:
        one, two = used
        names.append(f"{names[one]}{_OVER}{names[two]}")
        ratio = eta[one] / eta[two]

        def relative(of_eta: Array) -> Array:
            return of_eta[..., one, None] / eta[one] - of_eta[..., two, None] / eta[two]

        batches = np.hstack([batches, ratio * relative(batches)])
        slopes = np.vstack([slopes, ratio * relative(slopes.T).T])
        eta = np.append(eta, ratio)
    return Quantities(tuple(names), eta, batches, slopes)


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
    return {
        name: Shift(
            float(before.values[i]),
            float(after.values[j]),
            float(sigma),
            (size_sigmas or {}).get(name, 0.0),
        )
        for name, i, j, sigma in zip(common, first, second, sigmas, strict=True)
    }


@dataclass(frozen=True)
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


def refuse_far(campaign: Campaign, band: BandIndices) -> None:
    """Refuse indices too far from the scene's to be told from simulations about it."""
    nominal = float(campaign.scene.parameters[INDEX])
    effect = campaign.catalogue[CRYSTAL_INDEX].parameters[0]
    mean = band.over.mean
    farthest = max(abs(mean - nominal) + 2 * band.over.sigma, *np.abs(band.indices - mean))
    if farthest > effect.maximum:
        raise InputError(
            f"the scene's {INDEX} = {nominal:g} is too far from {mean:.4g}, that of "
            f"{band.material.name}",
            f"set {INDEX} to about {mean:.4g}",
            path=campaign.scene.path,
        )


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
        elif self._band is not None:
            try:
                refuse_far(campaign, self._band)
            except InputError as error:
                self.refused[CRYSTAL_INDEX], self._band = error.problem, None
        self._benches: list[CampaignSimulations] = []
        self._index = (CRYSTAL_INDEX,) * (self._band is not None)
        # births can be weighted too: that tells what the depth's error does
        depth = (SOURCE_DEPTH,) * (SOURCE_DEPTH in self._known.effects)
        #: Of the campaign as it is.
        self.bench = self._bench(campaign, (*self._index, *depth))
        self._fixed: dict[str, float] = {}
        self._own = self._refit(self.bench)
        self._fixed = self._own.fit.values

    def _with(self, *effects: str) -> Campaign:
        """The campaign with effects of known size in its scene."""
        return replace(self._campaign, scene=self._known.put_into(self._campaign.scene, *effects))

    def _bench(self, campaign: Campaign, effects: tuple[str, ...] = ()) -> CampaignSimulations:
        bench = CampaignSimulations(campaign, self._run)
        bench.simulate(effects)
        self._benches.append(bench)
        return bench

    def _refit(
        self,
        bench: CampaignSimulations,
        switched_on: tuple[str, str, float] | None = None,
        mixed: EffectResponse | None = None,
    ) -> Refit:
        """The fit on a bench with one more piece in the model.

        An effect is switched on with its parameter held at a value; or light has many indices,
        whose response is `mixed`.
        """
        campaign, responses = bench.campaign, bench.models.responses
        stand_ins = []
        if switched_on is not None:
            effect, name, value = switched_on
            campaign = campaign.with_effects([effect])
            held = CampaignParameter(name, value, value, value, fixed=True)
            campaign = replace(campaign, parameters={**campaign.parameters, name: held})
        if mixed is not None:
            # a response that is to no effect of the catalogue
            stand_ins = [Effect(_MIXED, _MIXED, "", "", edit=lambda editor: None)]
            responses = replace(responses, effects={**responses.effects, _MIXED: mixed})
        model = ResponseModel(campaign, responses, campaign.switched_on + stand_ins)
        fit = fit_model(model, profile=False)
        return Refit(fit, at(model, fit.values | self._fixed), fitted(fit))

    def _piece(
        self,
        name: str,
        title: str,
        after: Refit,
        put_in: str,
        mend: str,
        *,
        correction: bool = True,
        doubt: tuple[str, str, float, float] | None = None,
    ) -> Neglected:
        """A piece by the fit with it.

        The doubt is an effect, its parameter, a value of that and its error: what the error does.
        """
        sizes: list[dict[str, float]] = [{}, {}]
        if doubt is not None:
            effect, parameter, value, sigma = doubt
            low, high = (
                self._refit(self.bench, (effect, parameter, value + sign * sigma))
                for sign in (-1, 1)
            )
            sizes = [
                {name: abs(moved.shift) / 2 for name, moved in refits.items()}
                for refits in (
                    shifts(low.at_fixed, high.at_fixed),
                    shifts(low.refitted, high.refitted),
                )
            ]
        return Neglected(
            name,
            title,
            correction,
            put_in,
            mend,
            shifts(self._own.at_fixed, after.at_fixed, sizes[0]),
            shifts(self._own.refitted, after.refitted, sizes[1]),
        )

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
        return self._piece(
            SOURCE_DEPTH,
            "source depth",
            self._refit(self._bench(self._with(SOURCE_DEPTH))),
            f"births exp(-t/d) below the top, d = {pdg(depth, sigma)} mm ({length.energy_keV:g} "
            f"keV gammas in {length.formula} of {length.density_g_per_cm3:g} g/cm3, through the "
            "top)",
            f'write effects = ["{SOURCE_DEPTH}"] and [parameters.{DEPTH_MM}] with '
            f"prior = {depth:.3f}, prior_sigma = {sigma:.3f}",
            doubt=(SOURCE_DEPTH, DEPTH_MM, depth, sigma),
        )

    def _polarization(self) -> Neglected:
        """Every photon keeps its polarisation from one face to the next."""
        return self._piece(
            POLARIZATION,
            "polarisation",
            self._refit(self._bench(self._with(POLARIZATION))),
            "each photon's polarisation followed",
            "set polarization to true in the scene, as `mcrim add polarization` does",
        )

    def _crystal_index(self, band: BandIndices) -> Neglected:
        """The crystal has its material's index, the mean over the light that is detected."""
        mean, sigma = band.over.mean, band.over.sigma
        return self._piece(
            CRYSTAL_INDEX,
            "crystal's index",
            self._refit(self.bench, (CRYSTAL_INDEX, INDEX, mean)),
            f"n = {pdg(mean, sigma)} in the place of {self._nominal:g} ({band.material.name} over "
            f"{band.origin})",
            f"set {INDEX} to {mean:.4f} in the scene",
            doubt=(CRYSTAL_INDEX, INDEX, mean, sigma),
        )

    def _index_spread(self, band: BandIndices) -> Neglected:
        """Every wavelength of the band has its own index; their mean stays the scene's."""
        return self._piece(
            "index_spread",
            "index spread",
            self._mixed(band.indices, band.parts),
            f"indices of {band.material.name} over {band.origin}: ± {band.over.spread:.4f} "
            "about their mean",
            "nothing: one index stands for a band",
            correction=False,
        )

    def _birefringence(self, band: BandIndices) -> Neglected:
        """Half of the light is ordinary, half extraordinary; see `optics.dispersion`.

        The shift is that of light that keeps its wave all the way; `Shift.size_sigma` is the doubt
        where the optic axis points.
        """
        ordinary, extraordinary = band.over.ordinary_mean, band.over.extraordinary_mean
        assert extraordinary is not None
        sigma = orientation_sigma(ordinary, extraordinary)
        return self._piece(
            "birefringence",
            "birefringence",
            self._mixed(*indices_of_light(ordinary, extraordinary)),
            f"n_o = {ordinary:.4f} and n_e = {extraordinary:.4f}; the optic axis of unknown "
            f"direction makes the index uncertain by {sigma:.4f}",
            "the crystal's cut: with the optic axis at the angle b to the window's normal the "
            f"index is {ordinary:.4f} {extraordinary - ordinary:+.4f} sin^2(b) / 2",
            correction=False,
            doubt=(CRYSTAL_INDEX, INDEX, self._nominal, sigma),
        )

    @property
    def _nominal(self) -> float:
        """The scene's index of the crystal."""
        return float(self._campaign.scene.parameters[INDEX])

    def _mixed(self, indices: Array, parts: Array) -> Refit:
        """The fit where parts of the light have indices of their own, with the scene's as mean."""
        response = self.bench.models.responses.effects[CRYSTAL_INDEX]
        mixed = mixture(response, self._nominal + indices - parts @ indices, parts)
        return self._refit(self.bench, mixed=mixed)

    def together(self, neglected: tuple[Neglected, ...]) -> Neglected | None:
        """All corrections in one fit."""
        if self.corrected is None:
            return None
        titles = ", ".join(piece.title for piece in neglected if piece.correction)
        return self._piece("together", "all corrections", self.corrected, titles, "as each of them")

    @cached_property
    def corrected(self) -> Refit | None:
        """The fit with all corrections; None where there is none."""
        # an index is found from its response, other effects are simulated
        simulated = [name for name in self._known.effects if name != CRYSTAL_INDEX]
        bench = self._bench(self._with(*simulated), self._index) if simulated else self.bench
        if self._band is not None and CRYSTAL_INDEX in self._known.effects:
            return self._refit(bench, (CRYSTAL_INDEX, INDEX, self._band.over.mean))
        return self._refit(bench) if simulated else None

    def provenance(self) -> Provenance:
        """Of all benches together."""
        return spent_together([bench.provenance() for bench in self._benches])
