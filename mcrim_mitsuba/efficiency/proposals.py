"""Which scattering coefficients to simulate so that a range of them can be answered."""

from __future__ import annotations

import math

import numpy as np

from mcrim_mitsuba.transport.launch_plan import SHARE_STEPS, ScatteringProposals

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
