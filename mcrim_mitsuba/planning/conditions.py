"""How measurements are done, and what counting statistics and mountings make of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.physics.peak import COUNTING, fit_peak
from mcrim_mitsuba.physics.photon_histogram import PhotonSpectrum

#: Of the article's four mountings: 0.2 of 14.3 photons is the error of their mean.
MOUNTING_SCATTER = 0.2 / 14.3 * math.sqrt(4)
#: Relative standard deviation of an event's light, besides the counting of its photons.
INTRINSIC_SPREAD = 0.10


@dataclass(frozen=True)
class Conditions:
    """How measurements are done.

    Attributes
    ----------
    events_per_second : float
        In the band, not in the pedestal.
    minutes_per_mounting : float
        To mount the crystal, besides the counting of events.
    mounting_scatter : float
        Relative standard deviation of the signal from one mounting to the next.
    intrinsic_spread : float
        Relative standard deviation of an event's light, besides the counting of its photons.
    """

    events_per_second: float = 30.0
    minutes_per_mounting: float = 30.0
    mounting_scatter: float = MOUNTING_SCATTER
    intrinsic_spread: float = INTRINSIC_SPREAD

    def hours(self, configurations: int, mountings: int, events: float) -> float:
        """Time that a plan takes."""
        each = self.minutes_per_mounting / 60 + events / self.events_per_second / 3600
        return configurations * mountings * each


def event_sigma(mean_photons: float, conditions: Conditions) -> float:
    """Error of a band's mean times the square root of its events, as the peak's fit has it.

    Without background and with all bins it would be the band's width, the square root of
    N + (spread N)^2. The fit is made of the expected counts themselves.

    Parameters
    ----------
    mean_photons : float
        N.
    conditions : Conditions

    Raises
    ------
    InputError
        If no peak stands out of the pedestal.
    """
    spectrum = PhotonSpectrum(mean_photons, intrinsic_spread=conditions.intrinsic_spread)
    photons = spectrum.photons()
    peak = fit_peak(photons, spectrum.expected(photons), shape=COUNTING)
    if peak is None or abs(peak.centroid - mean_photons) > 0.2 * mean_photons:
        raise InputError(
            f"a band of {mean_photons:.3g} photons per event does not stand out of the pedestal",
            "the campaign's signals must be detected photons per event; leave such couplings out",
        )
    return peak.centroid_sigma * math.sqrt(spectrum.peak_events)


def measured_conditions(campaign: Campaign) -> Conditions:
    """The usual conditions, with the scatter and the spread of the campaign's own histograms."""
    readings = () if campaign.raw is None else campaign.raw.readings.values()
    variances, degrees, spreads = 0.0, 0, []
    for reading in readings:
        used = [m.peak for m in reading.mountings if m.use and m.peak is not None]
        spreads += [p.intrinsic_spread for p in used if p.intrinsic_spread is not None]
        if len(used) > 1:
            relative = [peak.centroid / reading.combined.mean for peak in used]
            counted = [peak.centroid_sigma / reading.combined.mean for peak in used]
            own = np.var(relative, ddof=1) - np.mean(np.square(counted))
            variances += (len(used) - 1) * float(own)
            degrees += len(used) - 1
    known = Conditions()
    if degrees:
        known = replace(known, mounting_scatter=math.sqrt(max(variances / degrees, 0.0)))
    if spreads:
        known = replace(known, intrinsic_spread=float(np.median(spreads)))
    return known
