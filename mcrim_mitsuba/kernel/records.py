"""Photon records of one configuration, as a surface of eta over both coefficients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.fit import EtaSurface, PhotonRecords
from mcrim_mitsuba.kernel.simulation import Simulation
from mcrim_mitsuba.units import MM_PER_CM

#: Ratio of neighbouring proposals where light scatters a few times; it shrinks where light
#: scatters often, because the number of scatterings then tells proposals apart.
LARGEST_RATIO = 3.2
#: Scattering coefficient (1/cm) around which that begins on benches of a centimetre.
MANY_SCATTERINGS_PER_CM = 2.0
#: A proposal below this wastes photons on light that stays trapped; weights reach down from it.
LOWEST_PROPOSAL_PER_CM = 0.04
#: Below this, light that total reflection traps hardly ever scatters within the depth limit.
SMALLEST_PER_CM = 1e-3

#: The depth limit of a surface, in units of the scene's own.
PATIENCE = 100
#: Light that may be cut off at that limit: less than any error that is asked for.
MOST_TRUNCATED = 1e-5


def choose_proposals(
    lowest_per_cm: float, highest_per_cm: float, lowest_alpha_abs_per_cm: float
) -> np.ndarray:
    """Scattering coefficients to simulate so that a range is covered.

    Parameters
    ----------
    lowest_per_cm, highest_per_cm : float
        Range of alpha_scat that will be asked for.
    lowest_alpha_abs_per_cm : float
        Least absorption that will be asked for, which is also simulated.

    Returns
    -------
    ndarray of float64
        Geometric steps in 1/cm, two at least.
    """
    # Weights of trapped light keep a finite variance only where
    # 2 (alpha_scat + alpha_abs) >= proposed alpha_scat + proposed alpha_abs.
    reachable = 0.9 * (2.0 * lowest_per_cm + lowest_alpha_abs_per_cm)
    low = max(min(max(lowest_per_cm, LOWEST_PROPOSAL_PER_CM), reachable), SMALLEST_PER_CM)
    high = max(highest_per_cm / 1.1, 2.0 * low)
    proposals = [low]
    while proposals[-1] < high:
        last = proposals[-1]
        step = np.log(LARGEST_RATIO) / (1.0 + last / MANY_SCATTERINGS_PER_CM)
        proposals.append(last * np.exp(step))
    # the last step is shortened, and with it all the others, so that they end at the top
    stretch = np.log(high / low) / np.log(proposals[-1] / low)
    return low * (np.array(proposals) / low) ** stretch


def collect_surface(
    simulation: Simulation,
    *,
    photons: int,
    seed: int,
    alpha_scat_range_per_cm: tuple[float, float],
    lowest_alpha_abs_per_cm: float,
    progress: Callable[[int, int, float, float], None] | None = None,
) -> EtaSurface:
    """Simulate one configuration once, for every alpha_scat and alpha_abs.

    Parameters
    ----------
    simulation : Simulation
        Its own coefficients do not matter.
    photons : int
    seed : int
    alpha_scat_range_per_cm : tuple of float
        What will be asked for: lowest and highest.
    lowest_alpha_abs_per_cm : float
        The least absorption that will be asked for.
    progress : callable, optional
        See `Simulation.collect`.

    Raises
    ------
    InputError
        If the scene leaks.
    KeyboardInterrupt
        If the user interrupts: half a surface is of no use.
    """
    proposals = choose_proposals(*alpha_scat_range_per_cm, lowest_alpha_abs_per_cm)
    found = simulation.integrator.collect(
        simulation.model,
        simulation.crystal,
        photons=photons,
        seed=seed,
        progress=progress,
        # Scattered light gets out in the end; what is cut off would be missing at every alpha.
        max_depth=PATIENCE * simulation.integrator.max_depth,
        keep_records=True,
        alpha_scat_per_mm=proposals / MM_PER_CM,
        alpha_abs_per_mm=lowest_alpha_abs_per_cm / MM_PER_CM,
    )
    if found.interrupted:
        raise KeyboardInterrupt
    truncated = found.tally.fraction("truncated")
    if truncated > MOST_TRUNCATED:
        raise InputError(
            f"{100 * truncated:.2g} % of the light was still under way after "
            f"{PATIENCE * simulation.integrator.max_depth:,} flights",
            "ask for more scattering or absorption, or raise max_depth of the integrator",
            path=simulation.file.path,
        )
    return EtaSurface(
        PhotonRecords(
            k=found.records["k"],
            path_cm=found.records["path_cm"],
            w=found.records["w"],
            proposal=found.records["proposal"],
            photons_per_proposal=found.photons_per_proposal,
            alpha_scat_proposals_per_cm=proposals,
            alpha_abs_proposal_per_cm=lowest_alpha_abs_per_cm,
        )
    )
