"""Fits a campaign: the crystal's coefficients and the light yield, with all their errors."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.editor import beam_notes
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import attributes, plain
from mcrim_mitsuba.core.numbers import ALPHA_SCAT, doubts
from mcrim_mitsuba.core.rounding import p_equals, short_text
from mcrim_mitsuba.inference.drivers import Minimum, find_minima
from mcrim_mitsuba.inference.estimates import (
    FittedRow,
    NumberOffset,
    ParameterEstimate,
    estimates,
    fitted_rows,
    offsets,
)
from mcrim_mitsuba.inference.model import Model, Prediction, held
from mcrim_mitsuba.inference.profiles import Profile, profiles_of
from mcrim_mitsuba.inference.settings import FIT_NOTES, ONE_SIGMA
from mcrim_mitsuba.inference.statistic import Statistic, is_misfit, undetermined


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """A fitted campaign."""

    #: The free ones, ``scale`` among them, and ``light_yield_ph_per_keV`` where the
    #: campaign says how to get it.
    parameters: dict[str, ParameterEstimate]
    #: Those that the campaign holds.
    fixed: dict[str, float]
    #: Readings in use and priors, with the covariance that the solution predicts.
    chi2: float
    #: Readings in use + priors - free parameters.
    ndf: int
    #: Probability of a larger chi2 if the model is right; None without degrees of freedom.
    #: Valid for Gaussian errors and parameters away from their bounds.
    p_value: float | None
    #: All readings, in the file's order.
    rows: tuple[FittedRow, ...]
    #: The free parameters, in the order of `covariance`.
    names: tuple[str, ...]
    #: (free, free) float64: Of the free parameters, in their units.
    covariance: Array
    #: (free, rows) float64: How much the estimate changes per unit of every reading, to first
    #: order.
    response: Array
    #: Whether the minimiser was content.
    converged: bool
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...]
    #: The minimum that all of this describes.
    minimum: Minimum = field(repr=False)

    @property
    def model(self) -> Model:
        """The one that was fitted."""
        return self.minimum.statistic.model

    @property
    def values(self) -> dict[str, float]:
        """The free parameters' values by name."""
        return self.minimum.values

    @property
    def theta(self) -> Array:
        """(free,) float64 values, in the order of `names`."""
        return self.minimum.theta

    @property
    def correlation(self) -> Array:
        """(free, free) correlation coefficients."""
        sigma = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(sigma, sigma)

    @property
    def profiles(self) -> tuple[Profile, ...]:
        """How chi2 rises along every free parameter and the light yield."""
        return profiles_of(self.minimum)

    @cached_property
    def offsets(self) -> tuple[NumberOffset, ...]:
        """How far the bench's numbers are off, of those that the campaign has tolerances of."""
        return offsets(self.minimum)

    def numbers(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts; what is not finite becomes None."""
        matrices = attributes(self, "covariance correlation")
        tolerances = {
            number.tolerance.number.name: {"tolerance": number.tolerance.sigma}
            | attributes(number, "offset sigma of_scale")
            for number in self.offsets
        }
        return plain(
            attributes(self, "parameters fixed chi2 ndf p_value rows")
            | {name: {"names": self.names, "matrix": matrix} for name, matrix in matrices.items()}
            | ({"tolerances": tolerances} if tolerances else {})
            | attributes(self, "converged notes")
        )


# The effect with which strong scattering leaves a beam as it was.
_FORWARD = "anisotropic_scattering"
# What may be wrong where readings ask for more than the bounds allow.
_SWAPPED = "check that no rows are swapped"


class TooLittleSimulatedError(InputError):
    """The fit ended where its surfaces say too little."""


class UndeterminedError(TooLittleSimulatedError):
    """Readings that do not determine all parameters, or not where the fit ended."""


def fit_model(model: Model, *, profile: bool = True) -> Calibration:
    """Fit a model's readings; see `statistic` for what is minimised.

    Intervals are found by profile likelihood; without `profile`, which is several times faster,
    `lower` and `upper` are None.

    Raises InputError if the readings cannot determine the parameters, or the photons that were
    simulated say too little at the solution.
    """
    return result_of(find_minima(Statistic(model)), profile=profile)


def result_of(minima: list[Minimum], *, profile: bool) -> Calibration:
    """What minima, the lowest first, say of a campaign; errors as `fit_model`."""
    minima, prediction = _trusted(minima)
    best = minima[0]
    statistic = best.statistic
    model, campaign = statistic.model, statistic.model.campaign
    of_rows = np.zeros((len(best.names), len(statistic.used)))
    of_rows[:, statistic.used] = best.response
    assert prediction.eta_sigma is not None  # checked
    if profile and best.names:
        parameters, notes_of_intervals = _with_intervals(best)
    else:
        known, notes_of_intervals = estimates(best).items(), []
        parameters = {n: replace(e, lower=None, upper=None) for n, e in known}
    shifted = prediction.where_off(best.weights.errors.tolerances, best.weighted_residuals)
    fit = Calibration(
        parameters=parameters,
        fixed=held(campaign),
        chi2=best.chi2,
        ndf=best.ndf,
        p_value=best.p_value,
        rows=fitted_rows(model, shifted, prediction.eta_sigma.tolist()),
        names=best.names,
        covariance=best.covariance,
        response=of_rows,
        converged=best.converged,
        notes=(),
        minimum=best,
    )
    yields = {n: known.value for n, known in fit.parameters.items() if n.endswith("_ph_per_keV")}
    notes = [
        *campaign.notes,
        *_notes_of_raw_data(campaign, fit),
        *_notes_of_search(minima),
        *(f"{name} {text}" for name, text in doubts(yields)),  # that are no crystal's
        *_notes_of_disagreement(fit, prediction),
        *notes_of_intervals,
        *_notes_of_simulation(fit.parameters),
        *_notes_of_interpolation(statistic, prediction),
        *_notes_of_likeness(model, prediction),
    ]
    if campaign.light_yield is not None and SCALE not in fit.parameters:
        notes.append("no light yield: the scale is held, not fitted")
    return replace(fit, notes=tuple(notes))


def _refuse_undetermined(minimum: Minimum) -> None:
    """Refuse readings that do not determine all parameters.

    At an end of alpha_scat's range readings often do not depend on it any more; then it is that
    end which is to be explained.
    """
    if without := undetermined(minimum.information, minimum.names):
        path = minimum.statistic.model.campaign.path
        if wish := _wish(minimum):
            raise UndeterminedError(wish, _SWAPPED, path=path)
        problem = f"the readings do not determine {' and '.join(without)}"
        mend = "add a reading in another configuration or a prior, or hold one with fixed = true"
        raise UndeterminedError(problem, mend, path=path)


def _trusted(minima: list[Minimum]) -> tuple[list[Minimum], Prediction]:
    """Minima from the lowest on of which the simulation can tell, and the prediction there.

    Where photons of others are weighted too far, eta is what chance makes of it, and may suit
    readings that the model does not describe. Errors are those of the lowest of all.
    """
    refusal: InputError | None = None
    for place, minimum in enumerate(minima):
        try:
            _refuse_undetermined(minimum)
            return minima[place:], _checked_prediction(minimum)
        except TooLittleSimulatedError as error:
            refusal = refusal or error
    assert refusal is not None
    raise refusal


def _checked_prediction(best: Minimum) -> Prediction:
    """The prediction at the solution, refused where the simulation says too little."""
    model = best.statistic.model
    try:
        return model.predict(best.theta, check=True, covariance=True)
    except InputError as error:
        problem = f"the fit ended where the simulation says too little: {error.problem}"
        mend = f"the readings do not fit this bench; mcrim compare {model.campaign.path} shows it"
        if wish := _wish(best):
            problem, mend = f"{wish}, and there {error.problem}", _SWAPPED
        mend = _lost_point(model, model.predict(best.theta)) or mend
        raise TooLittleSimulatedError(problem, mend, path=model.campaign.path) from None


def _with_intervals(best: Minimum) -> tuple[dict[str, ParameterEstimate], list[str]]:
    """Estimates with the intervals that their profiles tell, and notes on these.

    A note tells of an interval that a bound cuts off, or that ends where the simulation says too
    little.
    """
    parameters, notes = estimates(best), list[str]()
    model, bounds_of = best.statistic.model, {p.name: p for p in best.statistic.free}
    for profile in profiles_of(best):
        lower, upper = profile.crossings(ONE_SIGMA)
        if (bounds := bounds_of.get(profile.name)) is not None:
            for side, end in (("min", lower), ("max", upper)):
                if end is None:
                    limit = _bound(model, bounds, side)
                    notes.append(f"the interval of {profile.name} is cut off at the bound {limit}")
            lower = bounds.minimum if lower is None else lower
            upper = bounds.maximum if upper is None else upper
            for end in (lower, upper):
                theta = best.theta.copy()
                theta[best.statistic.index(profile.name)] = end
                try:
                    model.predict(theta, check=True)
                except InputError as error:
                    note = f"the interval of {profile.name} ends at {end:g}, but {error.problem}"
                    notes.append(note)
        parameters[profile.name] = replace(parameters[profile.name], lower=lower, upper=upper)
    return parameters, notes


def _wish(best: Minimum) -> str:
    """What the readings ask for, where they push alpha_scat to an end of its range."""
    statistic = best.statistic
    if ALPHA_SCAT not in best.names:
        return ""
    place = statistic.index(ALPHA_SCAT)
    value, side, bounds = best.theta[place], best.at_bound[place], statistic.free[place]
    edge = (bounds.maximum / bounds.minimum) ** FIT_NOTES.edge
    if side is None and bounds.minimum * edge <= value <= bounds.maximum / edge:
        return ""
    more = side == "max" or (side is None and value > bounds.maximum / edge)
    return f"the readings ask for {'more' if more else 'less'} scattering than the bounds allow"


def _notes_of_raw_data(campaign: Campaign, fit: Calibration) -> Iterable[str]:
    """What the fitted scattering says of the transmittance."""
    fitted = fit.parameters.get(ALPHA_SCAT)
    if fitted is None or campaign.raw is None or _FORWARD in campaign.effects:
        return ()
    return beam_notes(campaign.raw, fitted.value)


def _notes_of_search(minima: list[Minimum]) -> Iterator[str]:
    """What the reader must know of the minimum, and of its rivals."""
    best, *others = minima
    if not best.converged:
        yield "the minimiser did not converge: the numbers may be off"
    model = best.statistic.model
    for parameter, side in zip(model.free, best.at_bound, strict=True):
        if side is not None:
            wish = _wish(best) if parameter.name == ALPHA_SCAT else ""
            reason = f"; {wish}: {_SWAPPED}" if wish else ""
            yield f"{parameter.name} ended at its bound {_bound(model, parameter, side)}{reason}"
    for other in others:
        higher = other.deviance - best.deviance
        if higher < FIT_NOTES.rival:
            where = ", ".join(f"{name} = {value:.4g}" for name, value in other.values.items())
            yield f"a second solution, chi2 {higher:.2f} higher: {where}"


def _notes_of_disagreement(fit: Calibration, prediction: Prediction) -> Iterator[str]:
    """Whether the model describes the readings at all."""
    p, statistic = fit.p_value, fit.minimum.statistic
    # priors count as well as readings
    if is_misfit(fit.chi2, p):
        pulls = [(row.label, row.pull) for row in fit.rows if row.use]
        priors = zip(fit.names, statistic.prior_pulls(fit.theta), strict=True)
        pulls += [
            (f"the prior of {n}", pull) for n, pull in priors if abs(pull) > FIT_NOTES.largest_pull
        ]
        worst, pull = max(pulls, key=lambda item: abs(item[1]))
        chance = f"ndf = {statistic.ndf}" if p is None else p_equals(p)
        yield (
            f"the model does not describe the readings: chi2 = {fit.chi2:.3g}, {chance}; the "
            f"largest pull is that of {worst} ({pull:+.1f})"
        )
        if lost_point := _lost_point(statistic.model, prediction):
            yield lost_point


def _lost_point(model: Model, prediction: Prediction) -> str:
    """Which readings are many times off the others, as after a decimal point is lost."""
    light = [(i, r) for i, r in enumerate(model.readings) if r.use and not r.of_beam]
    if len(light) < 2:
        return ""
    scales = np.log([r.signal / prediction.signal[i] for i, r in light])
    # of two nobody knows which one it is
    off = abs(scales - np.median(scales)) > np.log(
        FIT_NOTES.far_off if len(light) > 2 else FIT_NOTES.two_apart
    )
    if not off.any() or (len(light) > 2 and 2 * off.sum() >= len(light)):
        return ""
    far = [reading for (_, reading), is_off in zip(light, off, strict=True) if is_off]
    labels = " and ".join(f"{r.label} (line {r.line}, {r.signal:g})" for r in far)
    are = "is" if len(far) == 1 else "are"
    how = f"{are} many times off what the others ask for"
    if len(light) == 2:
        how = "do not belong together on any bench like this"
    return f"{labels} {how}: is a decimal point or comma lost?"


def _bound(model: Model, parameter: CampaignParameter, side: str) -> str:
    """A bound in words: the campaign's own, or where the simulation ends before it."""
    attribute = {"min": "minimum", "max": "maximum"}[side]
    value = getattr(parameter, attribute)
    of_campaign = model.campaign.parameters.get(parameter.name, parameter)
    reason = "" if value == getattr(of_campaign, attribute) else ": eta is worked out no further"
    return f"{side} = {value:g}{reason}"


def _notes_of_simulation(parameters: dict[str, ParameterEstimate]) -> Iterator[str]:
    """Whether more photons would tell more."""
    parts = {
        name: estimate.contributions["monte_carlo"] / estimate.sigma
        for name, estimate in parameters.items()
        if estimate.sigma > 0
    }
    worst = max(parts, key=parts.__getitem__, default="")
    if worst and parts[worst] >= FIT_NOTES.monte_carlo:
        yield (
            f"the simulation's own error is {parts[worst]:.2g} of that of {worst}: with more "
            "photons it falls, and the intervals, some per cent too short by noise in the model, "
            "become right"
        )


def _notes_of_interpolation(statistic: Statistic, prediction: Prediction) -> Iterator[str]:
    """Interpolation errors that a reading would notice."""
    assert prediction.interpolation_error is not None  # checked
    sigmas = np.array([reading.sigma for reading in statistic.model.readings])
    errors = np.abs(prediction.signal_per_eta) * prediction.interpolation_error / sigmas
    worst = errors[statistic.used].max()
    if worst >= FIT_NOTES.interpolation:
        yield (
            f"interpolation between simulations may be off by {worst:.1f} of a reading's sigma: "
            "give narrower min and max"
        )


def _notes_of_likeness(model: Model, prediction: Prediction) -> Iterator[str]:
    """Which readings that differ in one column are predicted alike: it changes nothing there."""
    rows = sorted(zip(prediction.eta.tolist(), model.readings, strict=True), key=lambda row: row[0])
    for (eta, first), (other_eta, second) in itertools.pairwise(rows):
        of, of_other = ({**model.campaign.values, **row.parameters} for row in (first, second))
        columns = [n for n in model.campaign.measurements.columns if of.get(n) != of_other.get(n)]
        # other crystals may be alike by chance
        one_crystal = first.sample == second.sample
        if one_crystal and other_eta - eta <= FIT_NOTES.alike * other_eta and len(columns) == 1:
            values = (short_text(where.get(columns[0])) for where in (of, of_other))
            yield (
                f"{columns[0]} {' and '.join(values)} change nothing here: the model predicts the "
                f"same of {first.label} and {second.label}, to 1 in {1.0 / FIT_NOTES.alike:.0f}"
            )
