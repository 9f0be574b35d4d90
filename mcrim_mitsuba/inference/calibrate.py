"""Calibrate a campaign: simulate its configurations, then fit its readings."""

from __future__ import annotations

from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.model import refuse_unnamed_coefficients
from mcrim_mitsuba.inference.simulations import CampaignSimulations


def calibrate(simulations: CampaignSimulations) -> Calibration:
    """Fit a campaign's readings, and with them the light yield.

    The precision of its run is that of eta in every configuration, where the fit ends; a note of
    the simulations tells where it was not reached.

    Raises InputError if a configuration's scene is not sound, or the readings do not determine the
    parameters.
    """
    campaign, run = simulations.campaign, simulations.run
    refuse_unnamed_coefficients(campaign, "declare it as a <default> of the crystal")
    simulations.simulate()
    run.tell(f"fitting {len(campaign.measurements.in_use)} readings", 1, 1)
    fit = simulations.fit()
    worst = max(row.eta_sigma / row.eta for row in fit.rows)
    if run.precision is not None and worst > run.precision:
        simulations.notes.append(
            f"eta is known to {100 * worst:.2g} % only in one of the configurations"
        )
    return fit
