"""The pieces of physics that one index and an even source leave out, each put in by itself.

All simulations of a campaign draw the same random numbers, so that a part of their errors cancels
in the shifts. What the index does is found from simulations 0.1 to both sides of the scene's and a
polynomial through them: an index that is 0.005 away moves eta by about a fortieth of their
difference, with a fortieth of its error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mcrim_mitsuba.effects import Effect
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.campaign_parameter import CampaignParameter
from mcrim_mitsuba.fit.calibration import calibrate_model
from mcrim_mitsuba.fit.mixture import mixture
from mcrim_mitsuba.fit.response import EffectResponse, Responses
from mcrim_mitsuba.fit.response_model import ResponseModel
from mcrim_mitsuba.fit.result import Calibration
from mcrim_mitsuba.neglect.band import BandIndices
from mcrim_mitsuba.neglect.quantities import Quantities, Shift, at, fitted, shifts
from mcrim_mitsuba.neglect.result import Neglected
from mcrim_mitsuba.physics.birefringence import indices_of_light, orientation_sigma
from mcrim_mitsuba.physics.gammas import AttenuationLength
from mcrim_mitsuba.physics.rounding import pdg

SOURCE_DEPTH, POLARIZATION, CRYSTAL_INDEX = "source_depth", "polarization", "crystal_index"
DEPTH_MM, INDEX = "source_depth_mm", "n_crystal"


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit with the quantities that come of it.

    Attributes
    ----------
    model : ResponseModel
    calibration : Calibration
    at_fixed : Quantities
        At the coefficients of the campaign's own fit.
    refitted : Quantities
    """

    model: ResponseModel
    calibration: Calibration
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
        held: Mapping[str, CampaignParameter] | None = None,
        mixed: Mapping[str, EffectResponse] | None = None,
    ) -> Refit:
        """The fit with more pieces in the model.

        Parameters
        ----------
        held : mapping of str to CampaignParameter, optional
            Parameters of effects to be switched on, by the effect.
        mixed : mapping of str to EffectResponse, optional
            Responses of light with many indices, by a name.
        """
        held, mixed = held or {}, mixed or {}
        campaign = self.campaign.with_effects(tuple(held))
        parameters = campaign.parameters | {each.name: each for each in held.values()}
        campaign = replace(campaign, parameters=parameters)
        effects = [campaign.catalogue[name] for name in campaign.effects]
        effects += [_stand_in(name) for name in mixed]
        responses = replace(self.responses, effects={**self.responses.effects, **mixed})
        model = ResponseModel(campaign, responses, effects)
        found = calibrate_model(model, profile=False)
        values = {name: found.parameters[name].value for name in found.names} | self.fixed
        return Refit(model, found, at(model, values), fitted(model, found))


def _stand_in(name: str) -> Effect:
    """What switches a response on that is no effect of the catalogue."""
    return Effect(name, name, "", "", edit=lambda editor: None)


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
    low, high = (refitter.fit({effect: _held(parameter, value + sign * sigma)}) for sign in (-1, 1))
    return [
        {name: abs(moved.shift) / 2 for name, moved in found.items()}
        for found in compared(low, high).values()
    ]


def _held(name: str, value: float) -> CampaignParameter:
    """A parameter held at a value."""
    return CampaignParameter(name, value, value, value, None, None, fixed=True)


# ---- what scenes can have ---------------------------------------------------------------------


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


# ---- indices ----------------------------------------------------------------------------------


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


def index_held(value: float) -> CampaignParameter:
    """The crystal's index, held at a value."""
    return _held(INDEX, value)


def crystal_index(refitter: Refitter, band: BandIndices) -> Neglected:
    """The crystal has its material's index, the mean over the light that is detected."""
    nominal = float(refitter.campaign.scene.parameters[INDEX])
    mean, sigma = band.over.mean, band.over.sigma
    with_it = refitter.fit({CRYSTAL_INDEX: index_held(mean)})
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
    """Half of the light is ordinary, half extraordinary; see `physics.birefringence`.

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
