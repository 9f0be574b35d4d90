"""``[light_yield]`` of a campaign: what turns the fitted scale into photons per keV."""

from __future__ import annotations

from dataclasses import dataclass, field

from mcrim_mitsuba.files.raw_entries import RAW_TABLES
from mcrim_mitsuba.files.toml_document import TomlDocument

_ENTRIES = ("energy_keV", "detector_efficiency", "detector_efficiency_sigma")


@dataclass(frozen=True)
class LightYieldInput:
    """What turns the fitted scale into photons per keV.

    Attributes
    ----------
    energy_keV : float
        Energy deposited per event.
    detector_efficiency, detector_efficiency_sigma : float
        Emission-weighted efficiency, a fraction, and its standard error.
    efficiency_parts : dict of str to float
        That error by its origins, which add up in quadrature; empty where the campaign gives
        the efficiency as a number.
    """

    energy_keV: float
    detector_efficiency: float
    detector_efficiency_sigma: float
    efficiency_parts: dict[str, float] = field(default_factory=dict)


def read_light_yield(document: TomlDocument) -> LightYieldInput | None:
    """``[light_yield]``, or None without one.

    Raises
    ------
    InputError
        With the line, if an entry is unknown, missing or impossible.
    """
    key = "light_yield"
    if key not in document.content:
        return None
    # raw entries are numbers by now; here they only serve the hint about a slip
    document.table(key, (*_ENTRIES, *dict(RAW_TABLES)[key]))
    energy, efficiency, sigma = (document.number(key, name) for name in _ENTRIES)
    if energy is None or efficiency is None:
        raise document.refusal(
            key,
            "[light_yield] needs energy_keV and detector_efficiency",
            "add the missing one or remove the table",
        )
    if energy <= 0:
        raise document.refusal(
            f"{key}.energy_keV", f"energy_keV = {energy:g} is not above 0", "give keV per event"
        )
    if not 0 < efficiency <= 1:
        raise document.refusal(
            f"{key}.detector_efficiency",
            f"detector_efficiency = {efficiency:g} is not above 0 and at most 1",
            "give a fraction: 0.127 for 12.7 %",
        )
    if sigma is not None and sigma < 0:
        raise document.refusal(
            f"{key}.detector_efficiency_sigma",
            f"detector_efficiency_sigma = {sigma:g} is negative",
            "give the standard error of detector_efficiency",
        )
    return LightYieldInput(energy, efficiency, sigma or 0.0)
