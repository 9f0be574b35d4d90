"""The whole error budget of a campaign: what its own errors do, and what its model leaves out."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.campaign.known_physics import DEPTH_MM, KnownCrystal
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import ALPHA_ABS
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.inference.corrections import Neglected, NeglectWork, Quantities, Refit, fitted
from mcrim_mitsuba.inference.deposit_shift import Places, places_of
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.settings import BUDGETING
from mcrim_mitsuba.inference.simulations import CampaignSimulations, spent_together
from mcrim_mitsuba.laboratory.error_budget import ErrorBudget, contribution
from mcrim_mitsuba.optics.gammas import AttenuationLength

_DETECTOR = "detector_efficiency"
#: Priors that have advice of their own.
_PRIORS = {ALPHA_ABS: "absorption", DEPTH_MM: "source depth"}


def _parts_of(fit: Calibration, quantities: Quantities) -> tuple[dict[str, Array], Array, Array]:
    """(quantities,) parts of errors by origin, (numbers, quantities) those of tolerances, and all.

    All are together (quantities,), but for the light yield's part by its detector.
    """
    minimum = fit.minimum
    # (quantities, used readings): how a reading moves a quantity
    pulled = quantities.slopes @ minimum.response
    parts = {"counts": np.sqrt(minimum.weights.errors.statistical_variances(pulled))}
    for i, parameter in enumerate(fit.model.free):
        roots = {f"bounds, {parameter.name}": math.sqrt(minimum.bounds_weight[i])}
        if parameter.prior_sigma is not None:
            origin = _PRIORS.get(parameter.name, f"prior, {parameter.name}")
            roots[origin] = 1.0 / parameter.prior_sigma
        moved = np.abs(quantities.slopes @ fit.covariance[:, i])
        parts |= {origin: moved * root for origin, root in roots.items() if root}
    moved = pulled @ minimum.weights.errors.pedestal
    parts["pedestal"] = np.sqrt(np.square(moved).sum(axis=1))
    parts["monte_carlo"] = quantities.sigmas
    of_numbers = np.abs(quantities.by_tolerances)
    return parts, of_numbers, np.sqrt(np.square([*parts.values(), *of_numbers]).sum(axis=0))


def errors_of(fit: Calibration, quantities: Quantities) -> Array:
    """(quantities,) errors of all origins together, but for the light yield's by its detector."""
    return _parts_of(fit, quantities)[2]


def contributions_to(fit: Calibration, quantities: Quantities) -> dict[str, ErrorBudget]:
    """The budget of every quantity, the detector's part of the light yield's included."""
    if any(fitted.at_bound is not None for fitted in fit.parameters.values()):
        return {}
    parts, of_numbers, whole = _parts_of(fit, quantities)
    others = np.zeros(len(quantities.names))
    for number, part in zip(fit.offsets, of_numbers, strict=True):
        if (part > BUDGETING.matters * whole).any():
            parts[f"tolerance, {number.tolerance.number.words}"] = part
        else:
            others = np.hypot(others, part)
    parts["tolerance, others"] = others
    budgets = {}
    values = quantities.values.tolist()
    for i, (name, value) in enumerate(zip(quantities.names, values, strict=True)):
        errors = {origin: float(part[i]) for origin, part in parts.items()}
        if name in fit.parameters and _DETECTOR in fit.parameters[name].contributions:
            light_yield = fit.parameters[name]
            undivided = {_DETECTOR: light_yield.contributions[_DETECTOR]}
            errors |= light_yield.efficiency_contributions or undivided
        if value:
            least = BUDGETING.rounding * max(errors.values())
            budgets[name] = ErrorBudget(
                tuple(contribution(o, e / abs(value)) for o, e in errors.items() if e > least)
            )
    return budgets


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


def totals(
    own: Quantities,
    contributions: Mapping[str, ErrorBudget],
    neglected: tuple[Neglected, ...],
    corrected: Refit | None,
    together: Neglected | None,
) -> dict[str, Total]:
    """Every quantity with all its errors, as it is and corrected."""
    budgets: dict[str, ErrorBudget] = {}
    if corrected is not None:
        budgets = contributions_to(corrected.fit, corrected.refitted)
    totals = {}
    for name, value in zip(own.names, own.values.tolist(), strict=True):
        if name not in contributions:
            continue
        sigma = contributions[name].total * abs(value)
        lasting = math.hypot(*(p.refitted[name].as_error for p in neglected if not p.correction))
        total = Total(value, sigma, lasting)
        if together is not None and name in budgets:
            after = value + together.refitted[name].shift
            sizes = (p.refitted[name].size_sigma for p in neglected if p.correction)
            parts = (budgets[name].total * abs(after), lasting, *sizes)
            total = replace(total, corrected=after, corrected_sigma=math.hypot(*parts))
        totals[name] = total
    return totals


@dataclass(frozen=True)
class YieldCorrection:
    """What an absolute light yield is to be multiplied with, besides what simulations tell."""

    #: In a few words.
    name: str
    #: Less 1.
    relative: float
    #: Whether the campaign's light yield has it.
    applied: bool


def yield_corrections(
    campaign: Campaign, depth: AttenuationLength | None
) -> tuple[YieldCorrection, ...]:
    """Corrections of a campaign's light yield whose sizes are known; `depth` where gammas stop."""
    known = campaign.light_yield
    if known is None or known.detector is None:
        return ()
    detector = known.detector
    corrections = [("window's reflection", -detector.window_reflectance, detector.in_air)]
    if detector.collection is not None:
        corrections.append(("collection and threshold", 1.0 / detector.collection - 1.0, True))
    if depth is not None:
        reduced = campaign.raw.readings.values() if campaign.raw else ()
        # of peaks to which escape lines were fitted
        fitted = any(m.peak.lines for r in reduced for m in r.mountings if m.peak)
        corrections.append(("K X-rays that escape", 1.0 / (1.0 - depth.escape_loss) - 1.0, fitted))
    return tuple(YieldCorrection(*one) for one in corrections if one[1])


# ---- the whole ----


@dataclass(frozen=True, eq=False)
class Budget:
    """Where the errors of a campaign's results come from.

    Quantities have the names of `inference.corrections.Quantities`: the light yield (the scale
    without one), fitted parameters, efficiencies, and the ratio of two of them.
    """

    #: The campaign's own fit.
    fit: Calibration
    #: Quantities that tables and figures show: the first two efficiencies, parameters without a
    #: prior, the light yield last.
    main: tuple[str, ...]
    #: By quantity; none where a parameter ended at its bound.
    contributions: dict[str, ErrorBudget]
    #: Pieces of physics that the model leaves out, corrections first.
    neglected: tuple[Neglected, ...]
    #: All corrections at once; None where there is none.
    together: Neglected | None
    #: By quantity.
    totals: dict[str, Total]
    #: Pieces that were not put in, and why.
    not_estimated: dict[str, str]
    provenance: Provenance
    #: What it does to the readings where gammas stop, by a map; None without one.
    places: Places | None = None
    #: Of the absolute light yield, besides `neglected`.
    corrections: tuple[YieldCorrection, ...] = ()

    @property
    def pieces(self) -> tuple[Neglected, ...]:
        """`neglected`, and `together` last where there are several corrections."""
        if self.together is None or sum(piece.correction for piece in self.neglected) < 2:
            return self.neglected
        return (*self.neglected, self.together)

    def numbers(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts; `provenance` apart."""
        return {
            "calibration": self.fit.numbers(),
            "contributions": {
                name: {"total": each.total, "contributions": list(map(vars, each.contributions))}
                for name, each in self.contributions.items()
            },
            "neglected": [_plain(piece) for piece in self.neglected],
            "together": self.together and _plain(self.together),
            "totals": {
                name: vars(total) | {"sigma_with_neglected": total.sigma_with_neglected}
                for name, total in self.totals.items()
            },
            "not_estimated": self.not_estimated,
            "yield_corrections": list(map(vars, self.corrections)),
            **({} if self.places is None else {"places": self.places.to_json()}),
        }


def _plain(piece: Neglected) -> dict[str, Any]:
    """A piece with its shifts spelled out."""
    plain = dataclasses.asdict(piece)
    for kind in ("at_fixed", "refitted"):
        for name, moved in getattr(piece, kind).items():
            plain[kind][name] |= {"shift": moved.shift, "relative": moved.relative}
    return plain


def budget(
    campaign: str | Path | Campaign,
    *,
    material: str | None = None,
    emission: str | Path | None = None,
    wavelength_nm: float | None = None,
    eta_map: str | Path | None = None,
    depth_mm: float | None = None,
    deposits: str | Path | None = None,
    run: Run = Run(),
) -> Budget:
    """Fit a campaign, and fit it again with every piece of physics that it leaves out.

    The pieces: where the source's gammas stop, polarisation, the crystal's index at its emission,
    the spread of the index over the band, and birefringence. A campaign that has one of them
    already is not given it again.

    Parameters as of the public function `budget`, places of gammas as of `deposit_shift.places_of`.
    The photons of the run are those of every configuration's simulation with another index; those
    with the scene's own get four times as many. Its seed is the same for all of them: what they
    have in common cancels in the shifts.

    Raises InputError if a file is wrong, a scene is not sound, the readings do not determine the
    parameters, or the material or its band is not known.
    """
    start = time.perf_counter()
    campaign = as_campaign(campaign)
    known = KnownCrystal.of(campaign, material, emission, wavelength_nm)
    places = None
    if eta_map is not None:
        depth = known.depth.length_mm if known.depth is not None else BUDGETING.usual_depth_mm
        places = places_of(campaign, eta_map, depth if depth_mm is None else depth_mm, deposits)
    configurations = {tuple(r.parameters.items()) for r in campaign.measurements.readings}
    each = run.photons_or(max(BUDGETING.photons // len(configurations), BUDGETING.fewest_photons))
    work = NeglectWork(campaign, known, replace(run, photons=each))
    simulations = CampaignSimulations(campaign, run)
    fit = simulations.fit()
    own = fitted(fit)
    contributions = contributions_to(fit, own)
    neglected = work.neglected()
    together = work.together(neglected)
    provenance = spent_together([simulations.provenance(), work.provenance()])
    return Budget(
        fit=fit,
        main=own.main(tuple(campaign.priors)),
        contributions=contributions,
        neglected=neglected,
        together=together,
        totals=totals(own, contributions, neglected, work.corrected, together),
        not_estimated=work.refused,
        provenance=replace(provenance, seconds=time.perf_counter() - start),
        places=places,
        corrections=yield_corrections(campaign, known.depth),
    )
