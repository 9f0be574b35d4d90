"""Where a model fails: pulls, expected spread, suspect readings, trends, what was absorbed."""

from __future__ import annotations

import math
from collections.abc import Mapping

from mcrim_mitsuba.diagnosis import statistics
from mcrim_mitsuba.diagnosis.estimates import estimates, rows
from mcrim_mitsuba.diagnosis.result import Absorbed, Comparison
from mcrim_mitsuba.diagnosis.solver import Fit, Problem, fit_from_scratch
from mcrim_mitsuba.diagnosis.suspects import Alternative, find_suspects
from mcrim_mitsuba.diagnosis.trends import find_trends
from mcrim_mitsuba.files.campaign import LightYieldInput
from mcrim_mitsuba.fit.model import Model
from mcrim_mitsuba.fit.surface import ALPHA_SCAT

# A prior counts as pulled from here, in its standard errors.
_PULLED = 2.0

# Part of alpha_scat's range, in its logarithm, next to an end that is suspicious.
_EDGE = 0.05


def compare(
    model: Model,
    *,
    light_yield: LightYieldInput | None = None,
    plausible: Mapping[str, tuple[float, float]] | None = None,
) -> Comparison:
    """Fit a campaign and say where the model fails.

    Parameters
    ----------
    model : CampaignModel or ResponseModel
    light_yield : LightYieldInput, optional
        Turns the scale into photons per keV.
    plausible : mapping of str to (float, float), optional
        What a laboratory usually meets, of any free parameter.
    """
    fit = fit_from_scratch(Problem(model))
    return comparison_of(fit, find_suspects(fit), light_yield, plausible or {})


def comparison_of(
    fit: Fit,
    suspects: list[Alternative],
    light_yield: LightYieldInput | None,
    plausible: Mapping[str, tuple[float, float]],
) -> Comparison:
    """A fit laid out; its suspects are found already."""
    spread = math.sqrt(2.0 * max(fit.ndf, 0))
    _, pulls = statistics.left_out(fit)
    return Comparison(
        parameters=estimates(fit, light_yield),
        chi2=fit.chi2,
        ndf=fit.ndf,
        p_value=statistics.p_of_fit(fit),
        expected_chi2=(max(fit.ndf - spread, 0.0), fit.ndf + spread),
        rms_pull=statistics.rms_pull(fit),
        left_out_error=statistics.left_out_error(fit),
        rows=rows(fit),
        left_out_pulls=dict(zip(fit.problem.labels, pulls.tolist(), strict=True)),
        suspects=tuple(one.suspect for one in suspects),
        trends=find_trends(fit),
        absorbed=find_absorbed(fit, plausible),
    )


def find_absorbed(fit: Fit, plausible: Mapping[str, tuple[float, float]]) -> tuple[Absorbed, ...]:
    """Parameters with the marks of having taken up a misfit."""
    found = []
    for i, parameter in enumerate(fit.problem.free):
        name, value = parameter.name, float(fit.theta[i])
        if parameter.prior is not None and parameter.prior_sigma is not None:
            pull = (value - parameter.prior) / parameter.prior_sigma
            if abs(pull) > _PULLED:
                words = f"{name} = {value:.3g} is {pull:+.1f} sigma from its prior"
                found.append(Absorbed(name, "prior_pulled", value, words))
        side = fit.at_bound[i]
        if side is not None:
            found.append(
                Absorbed(name, "bound_reached", value, f"{name} ended at its {side} {value:.3g}")
            )
        elif name == ALPHA_SCAT:
            edge = (parameter.maximum / parameter.minimum) ** _EDGE
            if not parameter.minimum * edge < value < parameter.maximum / edge:
                words = f"{name} = {value:.3g} is close to an end of its range"
                found.append(Absorbed(name, "implausible", value, words))
        if name in plausible and not plausible[name][0] <= value <= plausible[name][1]:
            low, high = plausible[name]
            words = f"{name} = {value:.3g}, but usual is {low:g} to {high:g}"
            found.append(Absorbed(name, "implausible", value, words))
    return tuple(found)
