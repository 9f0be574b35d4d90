"""Light yields with our efficiencies, their error budget, and what the simulation leaves out."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from mcrim_mitsuba.article import arithmetic
from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.arithmetic import SIGNALS, absolute_yield, with_eta_error
from mcrim_mitsuba.article.efficiency_rows import largest_eta_deviation, wrapped_spread
from mcrim_mitsuba.article.published import AGREEMENT_SIGMAS, ArticleRow, compare, from_printed
from mcrim_mitsuba.article.simulated import (
    DEFAULT_PHOTONS,
    DEFAULT_WRAP_REFLECTANCE,
    Simulated,
    article_campaign,
)
from mcrim_mitsuba.campaign.known_physics import KnownCrystal
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.corrections import Neglected, NeglectWork
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.laboratory.error_budget import Uncertain, quotient
from mcrim_mitsuba.optics.fresnel import reflectance


@dataclass(frozen=True)
class LightYields:
    """The article's light yields, found again."""

    #: From Eqs. 1 and 2 at our own alpha_scat, ph/keV. Both couplings give it.
    fitted: Uncertain
    #: Y1 (air) and Y2 (gel) with our efficiencies at the article's (0.039, 0.54) /cm.
    at_article_point: tuple[Uncertain, Uncertain]
    #: From Eq. 7 with our efficiencies of both crystals.
    relative: Uncertain
    #: Relative error of the efficiencies, from the transmittances of Table 1.
    eta_error: float


def light_yields(simulated: Simulated) -> LightYields:
    """All light yields with efficiencies that follow polarisation."""
    eta_error = largest_eta_deviation([line for line in simulated.lines if line.polarised])
    nominal = article_campaign(p.NOMINAL.alpha_abs_per_cm.value)
    fitted = simulated.couplings[True].fit(nominal).parameters[LIGHT_YIELD]
    parts = fitted.contributions
    point = simulated.nominal.at(p.ALPHA_SCAT.value)
    air, gel = (
        Uncertain(eta, {"monte_carlo": sigma}, {"eta": eta * eta_error})
        for eta, sigma in zip(point.values[:2], point.sigmas[:2], strict=True)
    )
    cawo4 = simulated.cawo4
    signal_air, signal_gel = SIGNALS
    return LightYields(
        fitted=Uncertain(
            fitted.value,
            {"counts": parts["statistical"], "monte_carlo": parts["monte_carlo"]},
            {"eta": fitted.value * eta_error, "detector_efficiency": parts["detector_efficiency"]},
        ),
        at_article_point=(absolute_yield(signal_air, air), absolute_yield(signal_gel, gel)),
        relative=arithmetic.relative_yield(
            air,
            # the article has no transmittances of CaWO4: its own ±12 % is kept
            replace(with_eta_error(cawo4.eta), statistical={"monte_carlo": cawo4.eta_sigma}),
        ),
        eta_error=eta_error,
    )


def agreement(name: str, first: Uncertain, second: Uncertain, shared: str) -> str:
    """A sentence on how far two yields are apart, in their statistical errors only."""
    difference = first.value - second.value
    sigma = math.hypot(first.statistical_sigma, second.statistical_sigma)
    distance = abs(difference) / sigma
    word = "agree" if distance <= AGREEMENT_SIGMAS else "DISAGREE"
    return (
        f"{name}: {first.value:.2f} and {second.value:.2f} ph/keV {word}, difference "
        f"{difference:+.2f} ± {sigma:.2f} = {distance:.1f} standard errors ({shared})"
    )


def agreement_sentences(yields: LightYields) -> tuple[str, ...]:
    """Whether the two couplings and the two methods agree."""
    pairs = zip(SIGNALS, p.NOMINAL.etas_percent, strict=True)
    in_air, in_gel = (absolute_yield(signal, Uncertain(eta.value / 100)) for signal, eta in pairs)
    counts = "counting errors; those of eta and of the detector efficiency are shared"
    at_article_point = "Y1 and Y2 with our eta at the article's (0.039, 0.54) /cm"
    absolute, relative = yields.fitted, yields.relative
    distance = relative.value - absolute.value
    # shared by both methods: N_air, its detector efficiency and eta of CaMoO4
    above = [("efficiency", arithmetic.efficiency(p.CAWO4_EFFICIENCY))]
    above += [("eta", with_eta_error(1.0)), ("yield", arithmetic.CAWO4_YIELD)]
    of_cawo4 = quotient(above=above, below=[("signal", arithmetic.CAWO4_SIGNAL)])
    sigma = relative.value * of_cawo4.sigma / of_cawo4.value
    return (
        agreement("Y1 (air) and Y2 (gel) with the article's eta", in_air, in_gel, counts),
        agreement(at_article_point, *yields.at_article_point, counts),
        "With our eta at our own alpha_scat Y1 and Y2 are equal by construction: that is what "
        "alpha_scat is fitted for.",
        f"Eq. 7 with our eta against Eqs. 1-2: {relative.value:.1f} and {absolute.value:.1f} "
        f"ph/keV, difference {distance:+.1f} ± {sigma:.1f} = {abs(distance) / sigma:.1f} standard "
        "errors (those of the CaWO4 side; the rest is shared)",
    )


def yield_rows(yields: LightYields) -> Iterator[ArticleRow]:
    """Eqs. 1 and 2 with our efficiencies."""
    fitted = yields.fitted
    counts = fitted.statistical_sigma / fitted.value
    reflected = float(reflectance(1.0, 1.0, p.N_WINDOW.value))
    names, printed = ("Y1 (air)", "Y2 (gel)"), (p.YIELD_AIR, p.YIELD_GEL)
    pairs = zip(names, yields.at_article_point, printed, p.NOMINAL.etas_percent, strict=True)
    for name, ours, paper, eta in pairs:
        # the article's Y has the rounding of its own eta
        what, rounding = f"{name}, our eta at (0.039, 0.54) /cm", eta.rounding / eta.value
        yield compare(what, paper, ours, difference_sigma=0.0, rounding=ours.value * rounding)
    of_eta, of_all = 100 * yields.eta_error, 100 * fitted.sigma / fitted.value
    errors = "first error counting and Monte Carlo, second eta and detector efficiency"
    remark = f"air and gel alike; {errors}"
    yield compare("Y, our eta at our alpha_scat", p.LIGHT_YIELD, fitted, remark=remark)
    what = "the same, detector efficiency measured in air"
    in_air = replace(fitted, value=fitted.value * (1.0 - reflected))
    twice = f"{100 * reflected:.2f} % that the window reflects is in the efficiency, and in eta"
    remark = f"tubes are measured in air, head-on: {twice}; no collection efficiency"
    yield compare(what, None, in_air, unit=p.LIGHT_YIELD.unit, remark=remark)
    what = "error of eta: spread of our Table 1"
    remark = "the article calls its 12 % conservative"
    yield compare(what, p.ETA_ERROR, of_eta, judged=False, remark=remark)
    parts = f"{of_eta:.1f} % eta, 10 % detector efficiency, {100 * counts:.1f} % counts"
    what, remark = "total error with our eta", f"{parts}: ±{fitted.sigma:.2f} ph/keV"
    yield compare(what, p.TOTAL_ERROR, of_all, judged=False, remark=remark)


def relative_yield_row(yields: LightYields) -> ArticleRow:
    """Eq. 7 with our efficiencies."""
    remark = "air gap; 12 % on the eta of CaWO4, for which Table 1 has no counterpart"
    paper, ours = p.RELATIVE_YIELD, yields.relative
    return compare("Y, our eta for both crystals", paper, ours, remark=remark)


def wrapped_yield_row(simulated: Simulated) -> ArticleRow:
    """Reference [13] corrected with our efficiency of the wrapped cube."""
    wrapped = simulated.wrapped[DEFAULT_WRAP_REFLECTANCE]
    ours = from_printed(lambda y, e: y / (wrapped.eta * e / 100), p.KIM_MEASURED, p.KIM_EFFICIENCY)
    spread = ours.value * (wrapped_spread(simulated) / wrapped.eta)
    return compare(
        "[13] with our wrapped eta",
        p.KIM_CORRECTED,
        ours,
        sigma=ours.value * wrapped.eta_sigma / wrapped.eta,
        systematic=spread,
        difference_sigma=spread,
        remark=f"3.5/({wrapped.eta:.3f} x 0.80); the second error is the wrapping's reflectance",
    )


# The error budget of Sec. 6.3 by the campaign's fit: one likelihood for all its parts.


def budget_rows(simulated: Simulated) -> Iterator[ArticleRow]:
    """What makes up the error of the light yield, if Table 1's transmittances are its range."""
    absorptions = [line.alpha_abs_per_cm.value for line in p.TABLE_1]
    sigma = (max(absorptions) - min(absorptions)) / 2
    campaign = article_campaign(p.NOMINAL.alpha_abs_per_cm.value, sigma)
    light_yield = simulated.couplings[True].fit(campaign).parameters[LIGHT_YIELD]
    value, parts = light_yield.value, light_yield.contributions
    eta = math.hypot(*(100 * parts[name] / value for name in ("prior", "monte_carlo")))
    counts, total = 100 * parts["statistical"] / value, 100 * light_yield.sigma / value
    remark = f"campaign fit, alpha_abs ± {sigma:.3f} /cm (half of Table 1's range)"
    yield compare("error budget: eta", p.ETA_ERROR, eta, judged=False, remark=remark)
    remark = "with alpha_scat fitted: not the two counts' 1.6 % itself"
    yield compare("error budget: counts", None, counts, unit="%", remark=remark)
    remark = "eta, counts and detector efficiency, one covariance"
    yield compare("error budget: total", p.TOTAL_ERROR, total, judged=False, remark=remark)


_MATERIAL = "CaMoO4"
#: Photons of a simulation with another index, as a share of a surface's.
_SHARE = 1 / 32


def left_out(run: Run) -> tuple[Neglected, ...]:
    """Pieces of physics put into the article's bench one by one, polarisation followed."""
    campaign = article_campaign(p.NOMINAL.alpha_abs_per_cm.value)
    scene = campaign.scene.with_overrides({"polarization": True})
    crystal = KnownCrystal.of(campaign, _MATERIAL)
    of_share = replace(run, photons=max(1, round(_SHARE * run.photons_or(DEFAULT_PHOTONS))))
    return NeglectWork(replace(campaign, scene=scene), crystal, of_share).neglected()


def neglected_rows(pieces: tuple[Neglected, ...]) -> Iterator[ArticleRow]:
    """Shifts by what can be corrected, and sizes of what one index cannot describe.

    Efficiencies at the fitted coefficients, alpha_scat and the light yield fitted again.
    """
    for piece in pieces:
        kind = "shift" if piece.correction else "error"
        moves = {f"eta_{name}": piece.at_fixed[f"eta {name}"] for name in ("air", "gel")}
        moves["alpha_scat"] = piece.refitted[ALPHA_SCAT]
        if piece.correction:
            moves["Y"] = piece.refitted[LIGHT_YIELD]
        units = {"alpha_scat": "1/cm", "Y": "ph/keV"} if piece.correction else {}
        for quantity, moved in moves.items():
            per = 1.0 if quantity in units else 100 / moved.before
            yield compare(
                f"{kind} of {quantity} by {piece.title}",
                None,
                per * (moved.shift if piece.correction else moved.as_error),
                sigma=per * moved.monte_carlo_sigma,
                systematic=(piece.correction and per * moved.size_sigma) or None,
                unit=units.get(quantity, "%"),
                remark=piece.put_in if quantity == list(moves)[-1] else "",
            )
