"""Every effect as a candidate: what it gains, whether that is chance, what it could be instead."""

from __future__ import annotations

import math

import numpy as np

from mcrim_mitsuba.diagnosis import statistics
from mcrim_mitsuba.diagnosis.estimates import estimates
from mcrim_mitsuba.diagnosis.explanations import Explanations
from mcrim_mitsuba.diagnosis.null import BaselineFrame, Curve, NullDistribution
from mcrim_mitsuba.diagnosis.ranking import LEADING, Ranking, error_of_difference
from mcrim_mitsuba.diagnosis.result import Candidate
from mcrim_mitsuba.diagnosis.solver import Array, Fit, descend
from mcrim_mitsuba.files.campaign import LightYieldInput
from mcrim_mitsuba.fit.result import LIGHT_YIELD, ParameterEstimate

# Candidates whose mimics are found by fits; the others' to first order.
_FITTED = 5

# First-order separation up to which a fit is worth its time.
_WORTH_A_FIT = 80.0

# Directions that are alike, for effects too small to be separated from anything.
_ALIKE = 0.9


class CandidateMaker:
    """Turns fits with effects into candidates.

    Parameters
    ----------
    explanations : Explanations
    frame : BaselineFrame
    curves : dict of str to Curve
    null : NullDistribution
    light_yield : LightYieldInput or None
    """

    def __init__(
        self,
        explanations: Explanations,
        frame: BaselineFrame,
        curves: dict[str, Curve],
        null: NullDistribution,
        light_yield: LightYieldInput | None,
    ) -> None:
        self._explanations, self._frame, self._curves = explanations, frame, curves
        self._null, self._light_yield = null, light_yield
        self._baseline_estimates = estimates(explanations.baseline, light_yield)

    def singles(self, ranking: Ranking) -> tuple[Candidate, ...]:
        """All effects alone, the best first."""
        made = []
        for place, effect in enumerate(ranking.order):
            fit = self._explanations.fit((effect,))
            gain = self._explanations.baseline.chi2 - fit.chi2
            made.append(
                self._candidate(
                    (effect,),
                    fit,
                    ranking.behind(effect),
                    p_gain=self._null.p_gain(effect, gain),
                    p_global=self._null.p_global(gain),
                    mimics=self._mimics(effect, fit, exact=place < _FITTED),
                )
            )
        return tuple(made)

    def pairs(self, ranking: Ranking) -> tuple[Candidate, ...]:
        """Pairs of effects, the best first."""
        return tuple(
            self._candidate(
                pair,
                self._explanations.fit(pair),
                ranking.behind(pair),
                p_gain=None,
                p_global=None,
                mimics=(),
            )
            for pair in ranking.order
        )

    def _candidate(
        self,
        effects: tuple[str, ...],
        fit: Fit,
        behind: float,
        *,
        p_gain: float | None,
        p_global: float | None,
        mimics: tuple[str, ...],
    ) -> Candidate:
        baseline = self._explanations.baseline
        own = [n for e in effects for n in self._explanations.free_parameters(effects, e)]
        parameters = estimates(fit, self._light_yield)
        aicc = statistics.aicc(fit) - statistics.aicc(baseline)
        return Candidate(
            effect=" + ".join(effects),
            effects=effects,
            chi2=fit.chi2,
            ndf=fit.ndf,
            p_value=statistics.p_of_fit(fit),
            delta_chi2=baseline.chi2 - fit.chi2,
            delta_chi2_sigma=error_of_difference(fit, baseline),
            p_gain=p_gain,
            p_global=p_global,
            aicc=aicc if math.isfinite(aicc) else None,
            behind=behind,
            left_out_error=statistics.left_out_error(fit),
            parameters=parameters,
            effect_parameters=tuple(own),
            light_yield_ph_per_keV=self._light_yield_of(parameters),
            plausible=all(self._is_plausible(e, fit) for e in effects),
            at_bound=any(fit.at_bound[fit.problem.index(n)] is not None for n in own),
            collinearity=self._collinearity(fit, own),
            mimics=mimics,
        )

    def _light_yield_of(self, found: dict[str, ParameterEstimate]) -> dict[str, float] | None:
        if LIGHT_YIELD not in found:
            return None
        value, before = found[LIGHT_YIELD], self._baseline_estimates[LIGHT_YIELD].value
        return {
            "value": value.value,
            "sigma": value.sigma,
            "change": value.value / before - 1.0 if before else math.nan,
        }

    def _is_plausible(self, effect: str, fit: Fit) -> bool:
        usual = self._explanations.plausible(effect)
        return all(
            low <= fit.values[name] <= high
            for name, (low, high) in usual.items()
            if name in fit.names
        )

    def _collinearity(self, fit: Fit, own: list[str]) -> float:
        """Part of the effect's signature that the other parameters follow (R^2); the largest."""
        baseline = self._explanations.baseline
        whitener, weight = fit.weights.whitener, fit.problem.prior_weight
        rows = np.diag(np.sqrt(weight))[weight > 0]
        slopes = np.vstack([whitener @ fit.slopes, rows])
        places = [fit.problem.index(name) for name in own]
        others = np.delete(slopes, places, axis=1)
        directions = [slopes[:, place] for place in places]
        if not directions:
            start = fit.problem.theta(baseline.values)
            moved = fit.problem.model.predict(start).signal - baseline.signal
            directions = [np.concatenate([whitener @ moved[fit.problem.used], np.zeros(len(rows))])]
        found = []
        for direction in directions:
            left = direction - others @ np.linalg.lstsq(others, direction, rcond=None)[0]
            length = float(direction @ direction)
            found.append(1.0 - float(left @ left) / length if length > 0 else 1.0)
        return max(found)

    def _mimics(self, effect: str, fit: Fit, *, exact: bool) -> tuple[str, ...]:
        """Other effects that would fit this one's prediction about as well, the likeliest first."""
        point = self._frame.displacement(fit.problem, fit.theta)
        found = []
        for other, curve in self._curves.items():
            if other == effect:
                continue
            if float(point @ point) < LEADING:
                # too small to be told from anything: say what is alike
                likeness = _likeness(self._curves[effect], curve)
                if likeness > _ALIKE:
                    found.append((1.0 - likeness, other))
                continue
            separation = curve.separation(point)
            if exact and separation < _WORTH_A_FIT:
                separation = self._separation(fit, other)
            if separation < LEADING:
                found.append((separation, other))
        return tuple(other for _, other in sorted(found))

    def _separation(self, fit: Fit, other: str) -> float:
        """chi2 of another effect fitted to this one's prediction."""
        theirs = self._explanations.fit((other,))
        problem = theirs.problem
        ideal = problem.against(fit.signal[fit.problem.used], problem.theta(fit.values))
        starts: list[Array] = [theirs.theta]
        profile = self._explanations.profile((other,), other, fit, problem=ideal, steps=2)
        starts.append(min(profile, key=lambda item: item[0])[1])
        return min(descend(ideal, start, fit.weights, precision=0.02)[1] for start in starts)


def _likeness(one: Curve, other: Curve) -> float:
    """Largest cosine between what two effects do to the readings, whatever their sizes."""

    def directions(curve: Curve) -> np.ndarray:
        lengths = np.linalg.norm(curve.points, axis=1)
        return curve.points[lengths > 0] / lengths[lengths > 0, None]

    return float((directions(one) @ directions(other).T).max(initial=-1.0))
