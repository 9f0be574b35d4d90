"""Absolute light yield from a signal and a light collection efficiency.

Equations of Alenkov et al., JINST 8 P06002. Every argument is a plain number or an
`Uncertain`; errors of one origin are shared by whatever has them, all others are independent.
"""

from __future__ import annotations

from mcrim_mitsuba.physics.contributions import Uncertain, quotient


def light_yield_ph_per_keV(
    signal: Uncertain | float,
    eta: Uncertain | float,
    detector_efficiency: Uncertain | float,
    energy_keV: Uncertain | float,
) -> Uncertain:
    """Eqs. 1 and 2 solved for the yield: Y = N / (epsilon eta E).

    Yields from several couplings that were given the same origins (`detector_efficiency`, what
    the efficiencies have in common) combine with `contributions.common_value`.

    Parameters
    ----------
    signal : Uncertain or float
        Photoelectrons (counted photons) per event, N.
    eta : Uncertain or float
        Light collection efficiency, a fraction.
    detector_efficiency : Uncertain or float
        Emission-weighted detector efficiency epsilon, a fraction.
    energy_keV : Uncertain or float
        Energy deposited per event, in keV.

    Returns
    -------
    Uncertain
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
    signal: Uncertain | float,
    eta: Uncertain | float,
    detector_efficiency: Uncertain | float,
    reference_signal: Uncertain | float,
    reference_eta: Uncertain | float,
    reference_efficiency: Uncertain | float,
    reference_yield: Uncertain | float,
) -> Uncertain:
    """Eq. 7, the relative method: a sample against a scintillator of known yield.

    Both are measured at the same energy, which cancels, and so do the errors that sample and
    reference have in common: the tube's scale in both detector efficiencies, the bench's
    geometry in both light collection efficiencies. Arguments are those of
    `light_yield_ph_per_keV`, first of the sample and then of the reference.

    Returns
    -------
    Uncertain
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
