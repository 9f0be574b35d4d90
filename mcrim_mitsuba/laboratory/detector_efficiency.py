"""How much of a scintillator's light a detector detects: Eq. 3 of the article."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.optics.spectrum import Spectrum, WeightedMean, cut_off_note, weighted_mean

#: Relative error of a tube's quantum efficiency, common to all wavelengths (article, Sec. 4).
TUBE_SCALE_SIGMA = 0.05
SCALE, CURVE, EMISSION = "tube scale", "quantum efficiency curve", "emission spectrum"
#: Relative: what errors that the points share would have to add before it is said.
_WORTH_SAYING = 0.01


@dataclass(frozen=True, eq=False)
class DetectorEfficiency:
    """Emission-weighted detector efficiency."""

    #: A fraction.
    value: float
    #: Standard errors of the value by origin: ``tube scale``, and where the points of a table
    #: have errors ``quantum efficiency curve`` and ``emission spectrum``.
    contributions: dict[str, float]
    #: All of them in quadrature.
    sigma: float
    #: Standard deviation of the quantum efficiency over the emission; no error of the mean.
    spread: float
    #: With the derivatives by every point.
    mean: WeightedMean
    #: What the reader must know before using the number.
    notes: tuple[str, ...]


def detector_efficiency(
    emission: Spectrum, quantum_efficiency: Spectrum, scale_sigma: float = TUBE_SCALE_SIGMA
) -> DetectorEfficiency:
    """Quantum efficiency, weighted with the emission spectrum (Eq. 3).

    Parameters
    ----------
    emission : Spectrum
        Photons (or counts corrected for the spectrometer) per nm, in any unit.
    quantum_efficiency : Spectrum
        Fractions.
    scale_sigma : float
        Relative standard error that all points of the quantum efficiency share: tubes of one
        type differ, and so do calibrations.

    Raises
    ------
    InputError
        If the curve does not cover the emission, the emission has no area, or the error is no
        fraction.
    """
    if not 0 <= scale_sigma < 1:
        raise InputError(
            f"the tube's scale error is {scale_sigma:g}", "give a relative error: 0.05 for 5 %"
        )
    mean = weighted_mean(emission, quantum_efficiency, "the quantum efficiency")
    if not mean.value > 0:
        raise quantum_efficiency.refusal(
            "the quantum efficiency is 0 wherever the crystal emits", "check both tables"
        )
    contributions = {SCALE: scale_sigma * mean.value}
    if mean.quantity_sigma is not None:
        contributions[CURVE] = mean.quantity_sigma
    if mean.emission_sigma is not None:
        contributions[EMISSION] = mean.emission_sigma
    return DetectorEfficiency(
        value=mean.value,
        contributions=contributions,
        sigma=math.hypot(*contributions.values()),
        spread=mean.spread,
        mean=mean,
        notes=(*mean.notes, *_notes(emission, quantum_efficiency, mean)),
    )


def _notes(emission: Spectrum, quantum_efficiency: Spectrum, mean: WeightedMean) -> list[str]:
    cut_off = cut_off_note(emission)
    notes = [] if cut_off is None else [cut_off]
    if emission.sigmas is None or mean.emission_sigma is None:
        notes.append("the emission spectrum comes without errors: none is counted")
    else:
        # what all points share cancels, so the worst is an error that changes sign in the middle
        tilted = float(np.abs(mean.emission_derivatives) @ emission.sigmas)
        if tilted - mean.emission_sigma > _WORTH_SAYING * mean.value:
            notes.append(
                "errors of the emission's points are taken as independent, "
                f"{100 * mean.emission_sigma / mean.value:.2g} % together; if they are those of a "
                f"correction that runs over the band they are worth up to "
                f"{100 * tilted / mean.value:.2g} %: then add these to the tube's scale in "
                "quadrature"
            )
    if quantum_efficiency.sigmas is None or mean.quantity_sigma is None:
        notes.append("the quantum efficiency comes without errors of its points: none is counted "
                     "besides the tube's scale")  # fmt: skip
    else:
        shared = float(np.abs(mean.quantity_derivatives) @ quantum_efficiency.sigmas)
        if shared - mean.quantity_sigma > _WORTH_SAYING * mean.value:
            notes.append(
                "errors of the quantum efficiency's points are taken as independent, "
                f"{100 * mean.quantity_sigma / mean.value:.2g} % together; if all points share "
                f"them they are worth {100 * shared / mean.value:.2g} %: then count them in the "
                "tube's scale instead"
            )
    return notes
