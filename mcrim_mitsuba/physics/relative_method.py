"""The relative method (Eq. 7): what sample and reference have in common cancels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from mcrim_mitsuba.physics.contributions import Uncertain
from mcrim_mitsuba.physics.light_yield import light_yield_by_reference

#: Quantities that sample and reference both have, and the origin of their own errors.
QUANTITIES = {"signal": "counts", "eta": "eta", "detector_efficiency": "detector_efficiency"}

# Relative: a shared error that is typed as the whole one may differ from it by this.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class RelativeYield:
    """A light yield from a comparison with a reference crystal, photons per keV.

    Attributes
    ----------
    light_yield : Uncertain
        Origins are ``counts``, ``eta`` and ``detector_efficiency`` with whose they are
        (``sample``, ``reference``, or ``shared``: these cancel), and ``reference light yield``.
    uncorrelated : Uncertain
        The same value with the errors that follow if nothing is taken to be shared.
    equal_collection : float
        The yield if both light collection efficiencies were the same.
    signals_alone : float
        The yield if the detector efficiencies were the same as well.
    """

    light_yield: Uncertain
    uncorrelated: Uncertain
    equal_collection: float
    signals_alone: float


def relative_yield(
    sample: Mapping[str, tuple[float, float]],
    reference: Mapping[str, tuple[float, float]],
    reference_yield: tuple[float, float],
    shared: Mapping[str, float],
) -> RelativeYield:
    """Eq. 7 with the errors that both crystals share.

    A shared error moves both crystals' quantity by the same factor, and is part of the errors
    that the crystals have, not on top of them.

    Parameters
    ----------
    sample, reference : mapping of str to (float, float)
        Value and standard error of every one of `QUANTITIES`.
    reference_yield : (float, float)
        Photons per keV.
    shared : mapping of str to float
        Relative standard errors by quantity.

    Raises
    ------
    InputError
        If a value is not above 0.
    ValueError
        If a shared error is larger than that of a crystal.
    """

    def eq_7(common: Mapping[str, float]) -> Uncertain:
        crystals = [
            _known(crystal[name], origin, whose, name, common.get(name, 0.0))
            for crystal, whose in ((sample, "sample"), (reference, "reference"))
            for name, origin in QUANTITIES.items()
        ]
        value, sigma = reference_yield
        crystals.append(Uncertain(value, systematic={"reference light yield": sigma}))
        return light_yield_by_reference(*crystals)

    signals, efficiencies = (
        (sample[name][0], reference[name][0]) for name in ("signal", "detector_efficiency")
    )
    per_signal = reference_yield[0] * signals[0] / signals[1]
    return RelativeYield(
        light_yield=eq_7(shared),
        uncorrelated=eq_7({}),
        equal_collection=per_signal * efficiencies[1] / efficiencies[0],
        signals_alone=per_signal,
    )


def own_part(value: float, sigma: float, shared: float) -> float | None:
    """What is left of a standard error without its shared part; None if that is the larger one.

    Parameters
    ----------
    value, sigma : float
    shared : float
        Relative.
    """
    common = shared * value
    if common > sigma * (1 + _ROUNDING):
        return None
    return math.sqrt(max(sigma**2 - common**2, 0.0))


def _known(
    number: tuple[float, float], origin: str, whose: str, quantity: str, shared: float
) -> Uncertain:
    """A crystal's quantity with its own error and the one that the other crystal has too."""
    value, sigma = number
    own = own_part(value, sigma, shared)
    if own is None:
        raise ValueError(f"the shared error of {quantity} is larger than that of the {whose}")
    errors = {f"{origin}, {whose}": own} if own else {}
    common = {f"{quantity}, shared": shared * value} if shared else {}
    if quantity == "signal":
        return Uncertain(value, errors, common)
    return Uncertain(value, systematic=errors | common)
