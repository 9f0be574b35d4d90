"""Which coefficients to simulate so that a range of them can be answered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.efficiency.eta_grid import Grid
from mcrim_mitsuba.transport.launch_plan import SHARE_STEPS, ScatteringProposals

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.campaign import Campaign
    from mcrim_mitsuba.campaign.parameter import CampaignParameter

#: Ratio of neighbouring proposals where light scatters a few times; it shrinks where light
#: scatters often, because the number of scatterings then tells proposals apart.
_LARGEST_RATIO = 2.1
#: Scattering coefficient (1/cm) around which that begins on benches of a centimetre.
_MANY_SCATTERINGS_PER_CM = 2.0
#: How far above the highest proposal weights reach where light scatters a few times.
_REACH_ABOVE = 0.2
#: Share of the highest proposal, next to those of others: there is none above that would help it,
#: and errors are largest there (measured: 0.7 to 0.95 times those of equal shares).
_HIGHEST_SHARE = 2.5
#: Shares are in units of 1 / this at least.
_FEWEST_STEPS = 16
#: Below this, light that total reflection traps hardly ever scatters within the depth limit.
SMALLEST_PER_CM = 1e-3


def choose_proposals(
    lowest_per_cm: float, highest_per_cm: float, lowest_alpha_abs_per_cm: float
) -> ScatteringProposals:
    """Proposals that cover a range of alpha_scat.

    The least absorption that will be asked for is also simulated: so no weight at a coefficient of
    the range is above the number of proposals by much, and errors can be trusted.
    """
    low = max(lowest_per_cm, SMALLEST_PER_CM)
    # weights reach a little higher, and less so where the number of scatterings is sharper
    reach = _REACH_ABOVE / (1.0 + highest_per_cm / _MANY_SCATTERINGS_PER_CM)
    high = highest_per_cm / (1.0 + reach)
    proposals = [low]
    while proposals[-1] < high:
        last = proposals[-1]
        step = np.log(_LARGEST_RATIO) / (1.0 + last / _MANY_SCATTERINGS_PER_CM)
        proposals.append(last * np.exp(step))
    values = np.array(proposals)
    if len(values) > 1:
        # the last step is shortened, and with it all the others, so that they end at the top
        values = low * (values / low) ** (np.log(high / low) / np.log(values[-1] / low))
    weights = np.ones(len(values))
    weights[-1] = _HIGHEST_SHARE
    # few steps take fewer lanes, which wait less for each other
    steps = min(max(2 ** math.ceil(math.log2(2 * len(values))), _FEWEST_STEPS), SHARE_STEPS)
    ends = np.round(steps * np.cumsum(weights) / weights.sum()).astype(int)
    shares = np.diff(ends, prepend=0)
    return ScatteringProposals(
        tuple(values.tolist()), tuple(shares.tolist()), lowest_alpha_abs_per_cm
    )


# What the simulations of a campaign cover.

#: alpha_scat around which the usual proposals lie, 1/cm.
USUAL_ALPHA_SCAT_PER_CM = 0.5
#: Part of the usual range where a campaign's start may lie.
_STARTS_PER_CM = (0.15, 1.7)
#: How far below an absorption that is asked for the grid reaches, and its outermost ends, 1/cm.
_LEAST_REACH = 3.0
LEAST_ABSORPTION_PER_CM = 1e-3
_MOST_ABSORPTION_PER_CM = 2.0
#: Ends of the range where a fit goes beyond the usual one: as far as eta is ever worked out.
_WIDE_RANGE_PER_CM = (0.0005, 10.0)


#: Ranges that most campaigns share, of alpha_scat and alpha_abs, 1/cm, and proposals: nearly as
#: good as one of its own for 0.2 to 1 /cm, and a half as good over the whole range. Shares in 1/16,
#: not 1/64: a quarter of the lanes, which follow four times as many photons each, wait less for
#: each other, and a simulation takes a fifth to a third less time.
_USUAL = Grid((0.05, 5.0), (0.003, 0.15))
_USUAL_PROPOSALS = ScatteringProposals(
    (0.05, 0.12, 0.25, 0.45, 0.8, 1.4, 2.5, 4.5), (1, 2, 3, 3, 3, 2, 1, 1), 0.003
)
#: A transmittance may allow next to no losses, and the readings of light much scattering; crystals
#: may be as unlike.
_UNLIKE = Grid((0.002, 5.0), (LEAST_ABSORPTION_PER_CM, 0.15))
_UNLIKE_PROPOSALS = ScatteringProposals(
    (0.003, 0.012, 0.04, 0.12, 0.3, 0.6, 1.3, 3.5), (2, 2, 2, 2, 3, 2, 2, 1), 0.001
)


class Beyond(NamedTuple):
    """At which ends of the usual range of alpha_scat a fit goes beyond it, or below alpha_abs's."""

    low: bool = False
    high: bool = False
    clear: bool = False


WITHIN = Beyond()


@dataclass(frozen=True)
class Coverage:
    """Coefficients of which the simulations of a campaign tell."""

    #: Of the bench as it is, and of what effects add.
    fine: Grid
    coarse: Grid
    proposals: ScatteringProposals


def coverage_of(
    campaign: Campaign, beyond: Beyond = WITHIN, most_per_cm: float = math.inf
) -> Coverage:
    """What covers all that a campaign may ask for; the same for most, so that the cache serves all.

    A fit that goes `beyond` the usual range has it go on at that end, up to a scattering of
    `most_per_cm`, above which photons do not tell eta.
    """
    starts = [parameter.start for parameter in _of_samples_too(campaign, ALPHA_SCAT)]
    if ALPHA_SCAT not in campaign.parameters:
        starts.append(float(campaign.scene.parameters[ALPHA_SCAT]))
    is_usual = _STARTS_PER_CM[0] <= min(starts) <= max(starts) <= _STARTS_PER_CM[1]
    usual, proposals, factor = _USUAL, _USUAL_PROPOSALS, 1.0
    if campaign.beam or (len(starts) > 1 and not is_usual):
        usual, proposals = _UNLIKE, _UNLIKE_PROPOSALS
    elif not is_usual:
        factor = float(f"{starts[0] / USUAL_ALPHA_SCAT_PER_CM:.1g}")
    least, most = (factor * end for end in usual.alpha_scat_range_per_cm)
    absorption = _absorption_range(campaign, *usual.alpha_abs_range_per_cm)
    if beyond.clear:
        absorption = LEAST_ABSORPTION_PER_CM, absorption[1]
    drawn = tuple(factor * alpha for alpha in proposals.alpha_scat_per_cm)
    proposals = ScatteringProposals(drawn, proposals.units, absorption[0])
    scatters = beyond.low or beyond.high
    if scatters:
        # as far as the campaign lets it: each further proposal takes photons from all others
        allowed = max(parameter.maximum for parameter in _of_samples_too(campaign, ALPHA_SCAT))
        least = min(least, _WIDE_RANGE_PER_CM[0]) if beyond.low else least
        most = max(most, min(allowed, _WIDE_RANGE_PER_CM[1])) if beyond.high else most
    if scatters or most > most_per_cm:
        most = min(most, most_per_cm)
        proposals = choose_proposals(least, most, absorption[0])
    ranges = (least, most), absorption
    return Coverage(Grid(*ranges), Grid(*ranges, coarse=True), proposals)


def _absorption_range(campaign: Campaign, low: float, high: float) -> tuple[float, float]:
    """A usual range of alpha_abs (1/cm), as far as it must be longer for what is asked for."""
    parameters = _of_samples_too(campaign, ALPHA_ABS)
    asked = [parameter.start for parameter in parameters]
    if ALPHA_ABS not in campaign.parameters:
        asked.append(float(campaign.scene.parameters[ALPHA_ABS]))
    # a column of absorptions, one per crystal
    columns = (reading.parameters for reading in campaign.measurements.readings)
    asked += [float(values[ALPHA_ABS]) for values in columns if ALPHA_ABS in values]
    if min(asked) < _LEAST_REACH * low:
        low = max(float(f"{min(asked) / _LEAST_REACH:.1g}"), LEAST_ABSORPTION_PER_CM)
    for parameter in parameters:
        if not parameter.fixed:
            most = parameter.maximum
            if parameter.prior is not None and parameter.prior_sigma is not None:
                most = min(most, parameter.prior + 4 * parameter.prior_sigma)
            asked.append(most)
    while high < min(max(asked), _MOST_ABSORPTION_PER_CM):
        high *= 2.0
    return low, high


def _of_samples_too(campaign: Campaign, name: str) -> list[CampaignParameter]:
    """What a campaign says of a coefficient, and of those that samples have in its place."""
    samples = [sample.own[name] for sample in campaign.samples.values() if name in sample.own]
    names = [name, *(of_sample.name for of_sample in samples)]
    return [campaign.parameters[name] for name in names if name in campaign.parameters]
