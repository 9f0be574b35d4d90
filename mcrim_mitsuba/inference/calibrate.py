"""Calibrate a campaign: simulate its configurations, then fit its readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.model import refuse_unnamed_coefficients
from mcrim_mitsuba.inference.simulations import CampaignSimulations


@dataclass(frozen=True)
class CampaignResult:
    """A calibration with what it took."""

    fit: Calibration
    #: Of the simulations; the fit has notes of its own.
    provenance: Provenance


def calibrate(campaign: str | Path | Campaign, *, run: Run = Run()) -> CampaignResult:
    """Fit a campaign's readings, and with them the light yield.

    Raises InputError if a file is wrong, a configuration's scene is not sound, or the readings do
    not determine the parameters.

    Parameters
    ----------
    run : Run
        See `CampaignSimulations`. Its precision is that of eta in every configuration, where the
        fit ends.
    """
    campaign = as_campaign(campaign)
    refuse_unnamed_coefficients(campaign, "declare it as a <default> of the crystal")
    simulations = CampaignSimulations(campaign, run)
    simulations.simulate()
    run.tell(f"fitting {len(campaign.measurements.in_use)} readings", 1, 1)
    fit, provenance = simulations.fit(), simulations.provenance()
    worst = max(row.eta_sigma / row.eta for row in fit.rows)
    if run.precision is not None and worst > run.precision:
        note = f"eta is known to {100 * worst:.2g} % only in one of the configurations"
        provenance = replace(provenance, notes=(*provenance.notes, note))
    return CampaignResult(fit, provenance)
