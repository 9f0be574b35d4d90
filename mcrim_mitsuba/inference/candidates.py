"""Every effect as a candidate: what it gains, whether that is chance, what it could be instead."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mcrim_mitsuba.inference.displacement import Curve
from mcrim_mitsuba.inference.drivers import Minimum, newton
from mcrim_mitsuba.inference.estimates import (
    LIGHT_YIELD,
    ParameterEstimate,
    aicc,
    error_of_difference,
    estimates,
    left_out_error,
    light_yields,
)
from mcrim_mitsuba.inference.evidence import Evidence
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.profiles import ProfileWalk
from mcrim_mitsuba.inference.settings import (
    CANDIDATES,
    EXPLAINING,
    ONE_SIDED_95,
    RISE_95,
    TO_LIMITS,
)


@dataclass(frozen=True)
class Candidate:
    """The campaign fitted with one effect added, or with several."""

    #: Its name; of several all, joined by ``+``.
    effect: str
    effects: tuple[str, ...]
    #: Of the fit with it.
    chi2: float
    ndf: int
    p_value: float | None
    #: What chi2 falls by, and the simulation's error of that.
    delta_chi2: float
    delta_chi2_sigma: float
    #: Probability of this gain by chance, were this effect the only one tried; None for several.
    p_gain: float | None
    #: Of the best of all effects gaining as much; None for several.
    p_global: float | None
    #: Relative to the baseline: negative is better; None where there are too few readings.
    aicc: float | None
    #: Logarithm of the likelihood averaged over plausible sizes, over that without any effect;
    #: and how far that is behind the best, twice: candidates are ranked by it.
    log_evidence: float
    behind: float
    left_out_error: float
    #: All free ones.
    parameters: dict[str, ParameterEstimate]
    #: Those that the effect brings.
    effect_parameters: tuple[str, ...]
    #: ``value``, ``sigma``, ``change`` (from the baseline, relative); None where the campaign
    #: does not say how to get it.
    light_yield_ph_per_keV: dict[str, float] | None
    #: Whether the effect has a size that a laboratory meets.
    plausible: bool
    #: Whether one of its parameters ended at its bound.
    at_bound: bool
    #: Part (0..1) of what the effect does to the readings that the other parameters follow.
    collinearity: float
    #: Effects that it could be mistaken for.
    mimics: tuple[str, ...]
    #: What it is a relative of; of several families all, joined by ``+``.
    family: str = ""
    #: How to look for it without any fit.
    look: str = ""
    #: By how many of its tolerances a number of the bench is off; None where no number is wrong.
    tolerances_off: float | None = None

    @property
    def sizes(self) -> dict[str, ParameterEstimate]:
        """The fitted ones among `effect_parameters`, by name."""
        return {n: self.parameters[n] for n in self.effect_parameters if n in self.parameters}


class CandidateMaker:
    """Turns the fits with effects that a judgement rests on into candidates."""

    def __init__(self, judgement: Judgement) -> None:
        self._judgement = judgement
        self._explanations, self._null = judgement.explanations, judgement.null
        self._baseline_estimates = estimates(judgement.baseline)

    def singles(self) -> tuple[Candidate, ...]:
        """All effects alone, the best first."""
        candidates = []
        for effects in self._judgement.singles:
            candidate, (effect,) = self._candidate(effects), effects
            candidates.append(
                replace(
                    candidate,
                    p_gain=self._null.p_gain(effect, candidate.delta_chi2),
                    p_global=self._null.p_global(candidate.delta_chi2),
                    mimics=self._mimics(effect, exact=candidate.behind < CANDIDATES.within_reach),
                )
            )
        return tuple(candidates)

    def larger_sets(self) -> tuple[Candidate, ...]:
        """Sets of two effects and three, the best first."""
        return tuple(map(self._candidate, self._judgement.larger_sets))

    def _candidate(self, effects: tuple[str, ...]) -> Candidate:
        """Effects as a candidate, by what their own fit says; mimics are found later."""
        fit, baseline = self._explanations.fit(effects), self._explanations.baseline
        own = [n for e in effects for n in self._explanations.free_parameters(effects, e)]
        evidence = self._explanations.evidence(effects)
        parameters = determined_estimates(fit, evidence)
        gained = aicc(fit) - aicc(baseline)
        sigmas = {t.number.offset_name: t.sigma for t in fit.statistic.model.campaign.tolerances}
        offs = (abs(parameters[n].value) / sigmas[n] for n in own if n in sigmas)
        of_light = None
        if LIGHT_YIELD in parameters:
            now, before = parameters[LIGHT_YIELD], self._baseline_estimates[LIGHT_YIELD].value
            change = now.value / before - 1.0 if before else math.nan
            of_light = {"value": now.value, "sigma": now.sigma, "change": change}
        return Candidate(
            effect=" + ".join(effects),
            effects=effects,
            chi2=fit.chi2,
            ndf=fit.ndf,
            p_value=fit.p_value,
            delta_chi2=baseline.chi2 - fit.chi2,
            delta_chi2_sigma=error_of_difference(fit, baseline),
            p_gain=None,
            p_global=None,
            aicc=gained if math.isfinite(gained) else None,
            log_evidence=evidence.log - self._explanations.evidence(()).log,
            behind=self._judgement.behind(effects),
            left_out_error=left_out_error(fit),
            parameters=parameters,
            effect_parameters=tuple(own),
            light_yield_ph_per_keV=of_light,
            plausible=self._explanations.is_plausible(effects),
            at_bound=any(fit.at_bound[fit.statistic.index(n)] is not None for n in own),
            collinearity=self._collinearity(fit, own),
            mimics=(),
            family=self._explanations.family(effects),
            look=" ".join(self._explanations.effects[name].look for name in effects),
            tolerances_off=next(offs, None),
        )

    def _collinearity(self, fit: Minimum, own: list[str]) -> float:
        """Part of the effect's signature that the other parameters follow (R^2); the largest."""
        baseline = self._explanations.baseline
        weights, weight = fit.weights, fit.statistic.prior_weight
        rows = np.diag(np.sqrt(weight))[weight > 0]
        slopes = np.vstack([weights.whiten(fit.slopes.T).T, rows])
        places = [fit.statistic.index(name) for name in own]
        others = np.delete(slopes, places, axis=1)
        directions = [slopes[:, place] for place in places]
        if not directions:
            start = fit.statistic.theta(baseline.values)
            moved = fit.statistic.model.predict(start).signal - baseline.signal
            whitened = weights.whiten(moved[fit.statistic.used])
            directions = [np.concatenate([whitened, np.zeros(len(rows))])]
        collinearities = []
        for direction in directions:
            left = direction - others @ np.linalg.lstsq(others, direction, rcond=None)[0]
            length = float(direction @ direction)
            collinearities.append(1.0 - float(left @ left) / length if length > 0 else 1.0)
        return max(collinearities)

    def _mimics(self, effect: str, *, exact: bool) -> tuple[str, ...]:
        """Other effects that would fit this one's prediction about as well, the likeliest first.

        By the chi2 with which the other would fit it: to first order, or where it is `exact` by a
        fit. An effect that is too small to be told from anything has those that act like it.
        """
        fit = self._explanations.fit((effect,))
        point = self._null.frame.displacement(fit.statistic, fit.theta)
        too_small = float(point @ point) < EXPLAINING.leading
        mimics = []
        for other, curve in self._null.curves.items():
            if other == effect:
                continue
            if too_small:
                likeness = _likeness(self._null.curves[effect], curve)
                if likeness > CANDIDATES.alike:
                    mimics.append((1.0 - likeness, other))
                continue
            separation = curve.separation(point)
            if exact and separation < CANDIDATES.worth_a_fit:
                separation = self._separation(fit, other)
            if separation < EXPLAINING.leading:
                mimics.append((separation, other))
        return tuple(other for _, other in sorted(mimics))

    def _separation(self, fit: Minimum, other: str) -> float:
        """chi2 of another effect fitted to this one's prediction."""
        theirs = self._explanations.fit((other,))
        statistic = theirs.statistic
        ideal = statistic.against(fit.signal[fit.statistic.used], statistic.theta(fit.values))
        profile = self._explanations.profile((other,), other, fit, statistic=ideal, steps=2)
        starts = (theirs.theta, min(profile, key=lambda item: item[0])[1])
        return min(newton(ideal, start, fit.weights, precision=0.02).height for start in starts)


def determined_estimates(fit: Minimum, evidence: Evidence) -> dict[str, ParameterEstimate]:
    """Parameters of a fit; what readings do not determine has the error that evidence leaves."""
    parameters = estimates(fit)
    # where bounds had to say something, evidence, which keeps them, says more
    most = 1.0 if fit.bounds_weight.any() else CANDIDATES.undetermined
    for name in fit.names:
        own, sigma = parameters[name], evidence.sigma[name]
        if own.sigma > most * sigma:
            low, high = own.value - sigma, own.value + sigma
            parameters[name] = replace(
                own, sigma=sigma, lower=low, upper=high, contributions={"plausible": sigma}
            )
    return parameters | light_yields(parameters, fit.statistic.model.campaign)


def _likeness(one: Curve, other: Curve) -> float:
    """Largest cosine between what two effects do to the readings, whatever their sizes."""

    def directions(curve: Curve) -> np.ndarray:
        lengths = np.linalg.norm(curve.points, axis=1)
        return curve.points[lengths > 0] / lengths[lengths > 0, None]

    return float((directions(one) @ directions(other).T).max(initial=-1.0))


# ---- how large an effect may be where the data are adequate without it ----


@dataclass(frozen=True)
class Limit:
    """What adequate data say about an effect's size, at 95 % confidence."""

    #: None where the effect is on or off.
    parameter: str | None
    #: Value at which it is not there.
    absent: float | None
    #: Ends of what is allowed; None on the side of a boundary at which the effect is absent.
    #: Infinite where the data allow everything up to the end of the range.
    lower: float | None
    upper: float | None
    #: Fall of chi2 with the effect; negative where it makes the fit worse.
    delta_chi2: float
    #: Of an effect that is on or off, or cannot be absent: whether the data refuse it at any size.
    excluded: bool


def upper_limits(explanations: Explanations) -> dict[str, Limit]:
    """Limits on every effect by profile likelihood, all other parameters fitted along the way.

    They are by effect; of an effect with several parameters by ``effect.parameter``.
    """
    baseline, limits = explanations.baseline, {}
    for effect, fit in explanations.singles().items():
        names = explanations.free_parameters((effect,), effect)
        if not names:
            gain = baseline.chi2 - fit.chi2
            limits[effect] = Limit(None, None, None, None, gain, bool(-gain > RISE_95))
        for name in names:
            key = effect if len(names) == 1 else f"{effect}.{name}"
            limits[key] = _limit(explanations, effect, name)
    return limits


def _limit(explanations: Explanations, effect: str, name: str) -> Limit:
    """What the profile of one parameter of an effect says of its size.

    The limit is where the profile is 95 % above the model without the effect, which is its value
    where the effect is absent: at an end of the range (then the limit has one side), inside of it
    (two), or beyond an end (then models are not nested, and the whole effect may be excluded).
    """
    fit, baseline = explanations.fit((effect,)), explanations.baseline
    absences = explanations.absent(effect)
    absent, bounds = absences[name], fit.statistic.parameter(name)
    may_be_less, may_be_more = absent > bounds.minimum, absent < bounds.maximum
    nested = bounds.minimum <= absent <= bounds.maximum
    # the fit is the best of its deviance, in which larger errors of the simulation cost something;
    # with weights that stay as they are chi2 may be lower where the effect is absent
    best = newton(fit.statistic, fit.theta, fit.weights, steps=0)._replace(height=fit.chi2)
    free = {p.name: p for p in fit.statistic.free}
    if all(n not in free or free[n].minimum <= v <= free[n].maximum for n, v in absences.items()):
        start = fit.statistic.theta({**baseline.values, **absences})
        at_absence = newton(fit.statistic, start, fit.weights, precision=0.01)
        best = min(best, at_absence, key=lambda end: end.height)
    rise = RISE_95 if may_be_less and may_be_more else ONE_SIDED_95
    if not nested:
        rise += min(baseline.chi2 - best.height, 0.0)
    never_absent = all(p.absent is None for p in explanations.effects[effect].parameters)
    excluded = never_absent and rise <= 0.0
    lower: float | None
    upper: float | None
    lower = upper = float(best.point[fit.statistic.index(name)])
    if rise > 0.0:  # else even the best value is refused
        walk = ProfileWalk(fit.statistic, fit.weights, best, name, TO_LIMITS)
        lower, upper = walk.crossings(rise)
    return Limit(
        parameter=name,
        absent=absent,
        lower=None if excluded or not may_be_less else -math.inf if lower is None else lower,
        upper=None if excluded or not may_be_more else math.inf if upper is None else upper,
        delta_chi2=baseline.chi2 - fit.chi2,
        excluded=excluded,
    )
