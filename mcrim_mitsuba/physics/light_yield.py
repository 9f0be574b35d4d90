"""Absolute light yield from a signal and a light collection efficiency.

Equations of Alenkov et al., JINST 8 P06002. Every argument is a plain number or a
`Measured`; the result's errors are the arguments', propagated as independent.
"""

from __future__ import annotations

from mcrim_mitsuba.physics.measured import Measured, quotient


def light_yield_ph_per_keV(
    signal: Measured | float,
    eta: Measured | float,
    detector_efficiency: Measured | float,
    energy_keV: Measured | float,
) -> Measured:
    """Eqs. 1 and 2 solved for the yield: Y = N / (epsilon eta E).

    Parameters
    ----------
    signal : Measured or float
        Photoelectrons (counted photons) per event, N.
    eta : Measured or float
        Light collection efficiency, a fraction.
    detector_efficiency : Measured or float
        Emission-weighted detector efficiency epsilon, a fraction.
    energy_keV : Measured or float
        Energy deposited per event, in keV.

    Returns
    -------
    Measured
        Photons per keV.

    Raises
    ------
    InputError
        If an argument is not above 0.
    """
    return quotient(
        above=[("signal", signal)],
        below=[
            ("detector efficiency", detector_efficiency),
            ("light collection efficiency", eta),
            ("energy", energy_keV),
        ],
    )


def light_yield_by_reference(
    signal: Measured | float,
    eta: Measured | float,
    detector_efficiency: Measured | float,
    reference_signal: Measured | float,
    reference_eta: Measured | float,
    reference_efficiency: Measured | float,
    reference_yield: Measured | float,
) -> Measured:
    """Eq. 7, the relative method: a sample against a scintillator of known yield.

    Both are measured at the same energy. Arguments are those of
    `light_yield_ph_per_keV`, first of the sample and then of the reference.

    Returns
    -------
    Measured
        Yield of the sample, in the unit of `reference_yield`.

    Raises
    ------
    InputError
        If an argument is not above 0.
    """
    return quotient(
        above=[
            ("signal", signal),
            ("reference's detector efficiency", reference_efficiency),
            ("reference's light collection efficiency", reference_eta),
            ("reference's light yield", reference_yield),
        ],
        below=[
            ("reference's signal", reference_signal),
            ("detector efficiency", detector_efficiency),
            ("light collection efficiency", eta),
        ],
    )
