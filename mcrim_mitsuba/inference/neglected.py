"""The pieces of physics that one index and an even source leave out, each put in by itself.

All simulations of a campaign draw the same random numbers, so that a part of their errors cancels
in the shifts. What the index does is found from simulations 0.1 to both sides of the scene's and a
polynomial through them: an index that is 0.005 away moves eta by about a fortieth of their
difference, with a fortieth of its error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.efficiency.responses import EffectResponse, Responses, mixture
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, spread
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.optics.dispersion import indices_of_light, orientation_sigma
from mcrim_mitsuba.optics.emission_band import BandIndices
from mcrim_mitsuba.optics.gammas import AttenuationLength

_ETA, _OVER = "eta ", " / "
_SHOWN_EFFICIENCIES = 2


@dataclass(frozen=True, eq=False)
class Quantities:
    """Numbers that depend on the simulation, by name."""

    #: ``eta LABEL`` of every reading, ``eta LABEL / eta LABEL`` of two readings in use, and
    #: parameters by their own names.
    names: tuple[str, ...]
    #: (quantities,) float64: In the units of their names.
    values: NDArray[np.float64]
    #: (batches, quantities) float64: How far every batch of photons alone would be from `values`,
    #: to first order.
    batches: NDArray[np.float64]
    #: (quantities, free parameters) float64: d quantity / d free parameter of the fit.
    slopes: NDArray[np.float64]

    def main(self, priors: Sequence[str]) -> tuple[str, ...]:
        """What to show: two efficiencies, parameters not among `priors`, the light yield last."""
        efficiencies = [n for n in self.names if n.startswith(_ETA) and _OVER not in n]
        parameters = [n for n in self.names if not n.startswith(_ETA) and n not in priors]
        parameters.sort(key=lambda name: name in (LIGHT_YIELD, SCALE))
        return (*efficiencies[:_SHOWN_EFFICIENCIES], *parameters)

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """(quantities,) Monte Carlo standard errors."""
        return spread(self.batches)


def at(model: ResponseModel, values: Mapping[str, float]) -> Quantities:
    """Efficiencies and their ratio where the free parameters have given values.

    Parameters
    ----------
    model : ResponseModel
    values : mapping of str to float
        At least of the model's free parameters.
    """
    theta = np.array([values[parameter.name] for parameter in model.free])
    prediction = model.predict(theta)
    batches = prediction.eta * model.eta_batches(theta)
    return _of_eta(model, prediction.eta, batches, prediction.eta_slopes)


def fitted(model: ResponseModel, found: Calibration) -> Quantities:
    """Efficiencies, their ratio and parameters where a fit ended.

    Where a batch alone would give other efficiencies, the fit would end elsewhere: by the
    response of the estimate to the readings, to first order.
    """
    theta = np.array([found.parameters[name].value for name in found.names])
    prediction = model.predict(theta)
    own = prediction.eta * model.eta_batches(theta)
    # a model that predicts more acts as a reading that is lower
    moved = -(own * prediction.signal_per_eta) @ found.response.T
    slopes = prediction.eta_slopes
    etas = _of_eta(model, prediction.eta, own + moved @ slopes.T, slopes)
    names, parameters = list(found.names), np.eye(len(theta))
    known = model.campaign.light_yield
    if known is not None and SCALE in names:
        place = names.index(SCALE)
        names[place], parameters[place, place] = LIGHT_YIELD, known.per_scale
    return Quantities(
        (*names, *etas.names),
        np.concatenate([parameters @ theta, etas.values]),
        np.hstack([moved @ parameters.T, etas.batches]),
        np.vstack([parameters, etas.slopes]),
    )


def _of_eta(
    model: ResponseModel,
    eta: NDArray[np.float64],
    batches: NDArray[np.float64],
    slopes: NDArray[np.float64],
) -> Quantities:
    """Efficiencies, and the ratio of the two where two readings are in use."""
    names = [f"{_ETA}{reading.label}" for reading in model.readings]
    used = [i for i, reading in enumerate(model.readings) if reading.use]
    if len(used) == 2:
        one, two = used
        names.append(f"{names[one]}{_OVER}{names[two]}")
        ratio = eta[one] / eta[two]

        def relative(of_eta: NDArray[np.float64]) -> NDArray[np.float64]:
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
    """Shifts of all quantities that both have.

    Parameters
    ----------
    before, after : Quantities
        Of simulations with the same seed.
    size_sigmas : mapping of str to float, optional
        `Shift.size_sigma` by quantity.
    """
    common = [name for name in before.names if name in after.names]
    first, second = ([side.names.index(name) for name in common] for side in (before, after))
    sigmas = spread(after.batches[:, second] - before.batches[:, first])
    return {
        name: Shift(
            float(before.values[i]), float(after.values[j]), float(sigma),
            (size_sigmas or {}).get(name, 0.0),
        )
        for name, i, j, sigma in zip(common, first, second, sigmas, strict=True)
    }  # fmt: skip


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


@dataclass(frozen=True)
class Total:
    """A number with its errors, without and with what the model leaves out."""

    #: As the campaign's own fit has it.
    value: float
    sigma: float
    #: Systematic errors of what cannot be corrected, in quadrature.
    neglected_sigma: float
    #: After all corrections at once, with the error of the fit that has them and
    #: `neglected_sigma`; None where there is nothing to correct.
    corrected: float | None = None
    corrected_sigma: float | None = None

    @property
    def sigma_with_neglected(self) -> float:
        """`sigma` and `neglected_sigma` in quadrature."""
        return math.hypot(self.sigma, self.neglected_sigma)


# ---- fits with pieces put in ----

SOURCE_DEPTH, POLARIZATION, CRYSTAL_INDEX = "source_depth", "polarization", "crystal_index"
DEPTH_MM, INDEX = "source_depth_mm", "n_crystal"


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit with the quantities that come of it."""

    model: ResponseModel
    calibration: Calibration
    #: At the coefficients of the campaign's own fit.
    at_fixed: Quantities
    refitted: Quantities


class Refitter:
    """Fits a campaign with pieces of physics put into its model.

    Parameters
    ----------
    campaign : Campaign
    responses : Responses
        Of its readings, to all effects that will be asked for.
    fixed : mapping of str to float, optional
        Coefficients for `Refit.at_fixed`; those of the campaign's own fit without.
    """

    def __init__(
        self, campaign: Campaign, responses: Responses, fixed: Mapping[str, float] | None = None
    ) -> None:
        self.campaign = campaign
        self.responses = responses
        self.fixed = dict(fixed or {})
        self.own = self.fit()
        found = self.own.calibration
        self.fixed = {n: found.parameters[n].value for n in found.names} | self.fixed

    def fit(
        self,
        switched_on: Mapping[str, CampaignParameter] | None = None,
        mixed: Mapping[str, EffectResponse] | None = None,
    ) -> Refit:
        """The fit with more pieces in the model.

        Parameters
        ----------
        switched_on : mapping of str to CampaignParameter, optional
            Parameters of effects to be switched on, by the effect.
        mixed : mapping of str to EffectResponse, optional
            Responses of light with many indices, by a name.
        """
        held, mixed = switched_on or {}, mixed or {}
        campaign = self.campaign.with_effects(tuple(held))
        parameters = campaign.parameters | {each.name: each for each in held.values()}
        campaign = replace(campaign, parameters=parameters)
        # responses that are to no effect of the catalogue
        stand_ins = [Effect(name, name, "", "", edit=lambda editor: None) for name in mixed]
        responses = replace(self.responses, effects={**self.responses.effects, **mixed})
        model = ResponseModel(campaign, responses, campaign.switched_on + stand_ins)
        found = fit_model(model, profile=False)
        values = {name: found.parameters[name].value for name in found.names} | self.fixed
        return Refit(model, found, at(model, values), fitted(model, found))


def compared(
    before: Refit,
    after: Refit,
    fixed_sigmas: Mapping[str, float] | None = None,
    refitted_sigmas: Mapping[str, float] | None = None,
) -> dict[str, dict[str, Shift]]:
    """``at_fixed`` and ``refitted`` of a `Neglected`."""
    return {
        "at_fixed": shifts(before.at_fixed, after.at_fixed, fixed_sigmas),
        "refitted": shifts(before.refitted, after.refitted, refitted_sigmas),
    }


def _half_differences(
    refitter: Refitter, effect: str, parameter: str, value: float, sigma: float
) -> list[dict[str, float]]:
    """What an effect's error does to all quantities: at fixed coefficients, and refitted."""
    low, high = (refitter.fit({effect: held(parameter, value + sign * sigma)}) for sign in (-1, 1))
    return [
        {name: abs(moved.shift) / 2 for name, moved in found.items()}
        for found in compared(low, high).values()
    ]


def held(name: str, value: float) -> CampaignParameter:
    """A parameter held at a value."""
    return CampaignParameter(name, value, value, value, None, None, fixed=True)


# ---- what scenes can have ----


def source_depth(refitter: Refitter, with_it: Refit, length: AttenuationLength) -> Neglected:
    """Light is born where the gammas stop below the top, not everywhere alike.

    Parameters
    ----------
    refitter : Refitter
        With responses to the depth: they tell what its error does.
    with_it : Refit
        Of a simulation with that depth.
    length : AttenuationLength
    """
    depth, sigma = length.length_mm, length.sigma_mm
    return Neglected(
        SOURCE_DEPTH,
        "source depth",
        correction=True,
        put_in=f"births exp(-t/d) below the top, d = {pdg(depth, sigma)} mm ({length.energy_keV:g} "
        f"keV gammas in {length.formula} of {length.density_g_per_cm3:g} g/cm3, through the top)",
        mend=f'write effects = ["{SOURCE_DEPTH}"] and [parameters.{DEPTH_MM}] with '
        f"prior = {depth:.3f}, prior_sigma = {sigma:.3f}",
        **compared(
            refitter.own, with_it,
            *_half_differences(refitter, SOURCE_DEPTH, DEPTH_MM, depth, sigma),
        ),
    )  # fmt: skip


def polarization(refitter: Refitter, with_it: Refit) -> Neglected:
    """Every photon keeps its polarisation from one face to the next."""
    return Neglected(
        POLARIZATION,
        "polarisation",
        correction=True,
        put_in="each photon's polarisation followed",
        mend="set polarization to true in the scene, as `mcrim add polarization` does",
        **compared(refitter.own, with_it),
    )


# ---- indices ----


def refuse_far(campaign: Campaign, band: BandIndices) -> None:
    """Refuse indices too far from the scene's to be told from simulations about it.

    Raises
    ------
    InputError
    """
    nominal = float(campaign.scene.parameters[INDEX])
    effect = campaign.catalogue[CRYSTAL_INDEX].parameters[0]
    mean = band.over.mean
    farthest = max(abs(mean - nominal) + 2 * band.over.sigma, *np.abs(band.indices - mean))
    if farthest > effect.maximum:
        raise InputError(
            f"the scene's {INDEX} = {nominal:g} is too far from {mean:.4g}, that of "
            f"{band.material.name}",
            f"set {INDEX} to about {mean:.4g}", path=campaign.scene.path,
        )  # fmt: skip


def crystal_index(refitter: Refitter, band: BandIndices) -> Neglected:
    """The crystal has its material's index, the mean over the light that is detected."""
    nominal = float(refitter.campaign.scene.parameters[INDEX])
    mean, sigma = band.over.mean, band.over.sigma
    with_it = refitter.fit({CRYSTAL_INDEX: held(INDEX, mean)})
    return Neglected(
        CRYSTAL_INDEX,
        "crystal's index",
        correction=True,
        put_in=f"n = {pdg(mean, sigma)} in the place of {nominal:g} ({band.material.name} over "
        f"{band.origin})",
        mend=f"set {INDEX} to {mean:.4f} in the scene",
        **compared(
            refitter.own, with_it, *_half_differences(refitter, CRYSTAL_INDEX, INDEX, mean, sigma)
        ),
    )


def index_spread(refitter: Refitter, band: BandIndices) -> Neglected:
    """Every wavelength of the band has its own index; their mean stays the scene's."""
    nominal = float(refitter.campaign.scene.parameters[INDEX])
    response = refitter.responses.effects[CRYSTAL_INDEX]
    mixed = mixture(response, nominal + band.indices - band.parts @ band.indices, band.parts)
    return Neglected(
        "index_spread",
        "index spread",
        correction=False,
        put_in=f"indices of {band.material.name} over {band.origin}: ± {band.over.spread:.4f} "
        "about their mean",
        mend="nothing: one index stands for a band",
        **compared(refitter.own, refitter.fit(mixed={"index_spread": mixed})),
    )


def birefringence(refitter: Refitter, band: BandIndices) -> Neglected:
    """Half of the light is ordinary, half extraordinary; see `optics.dispersion`.

    The shift is that of light that keeps its wave all the way; `Shift.size_sigma` is the doubt
    where the optic axis points.
    """
    nominal = float(refitter.campaign.scene.parameters[INDEX])
    ordinary, extraordinary = band.over.ordinary_mean, band.over.extraordinary_mean
    assert extraordinary is not None
    indices, parts = indices_of_light(ordinary, extraordinary)
    response = refitter.responses.effects[CRYSTAL_INDEX]
    mixed = mixture(response, nominal + indices - parts @ indices, parts)
    sigma = orientation_sigma(ordinary, extraordinary)
    return Neglected(
        "birefringence",
        "birefringence",
        correction=False,
        put_in=f"n_o = {ordinary:.4f} and n_e = {extraordinary:.4f}; the optic axis of unknown "
        f"direction makes the index uncertain by {sigma:.4f}",
        mend="the crystal's cut: with the optic axis at the angle b to the window's normal the "
        f"index is {ordinary:.4f} {extraordinary - ordinary:+.4f} sin^2(b) / 2",
        **compared(
            refitter.own, refitter.fit(mixed={"birefringence": mixed}),
            *_half_differences(refitter, CRYSTAL_INDEX, INDEX, nominal, sigma),
        ),
    )  # fmt: skip
