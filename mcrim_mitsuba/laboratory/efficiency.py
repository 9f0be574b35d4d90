"""The detector's efficiency from an emission spectrum and a quantum efficiency."""

from __future__ import annotations

from mcrim_mitsuba.files.raw_entries import EfficiencyEntry
from mcrim_mitsuba.files.spectrum import read_spectrum
from mcrim_mitsuba.laboratory.raw_data import ReducedEfficiency
from mcrim_mitsuba.physics.detector_efficiency import detector_efficiency


def reduce_efficiency(entry: EfficiencyEntry) -> ReducedEfficiency:
    """Eq. 3 of the article with the files of a campaign.

    Raises
    ------
    InputError
        If a spectrum cannot be used: with its line.
    """
    emission = read_spectrum(entry.emission, "emission")
    curve = read_spectrum(entry.quantum_efficiency, "quantum_efficiency")
    found = detector_efficiency(emission, curve, entry.scale_sigma)
    return ReducedEfficiency(entry, emission, curve, found)
