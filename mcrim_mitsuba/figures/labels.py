"""Fitted parameters as axes and titles name them, with their units."""

from __future__ import annotations

from mcrim_mitsuba.figures.style import shortened
from mcrim_mitsuba.files.campaign_parameter import SCALE
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT

_KNOWN = {
    LIGHT_YIELD: "light yield (photons per keV)",
    SCALE: "scale (signal per efficiency)",
    ALPHA_SCAT: r"$α_\mathrm{scat}$ (1/cm)",
    ALPHA_ABS: r"$α_\mathrm{abs}$ (1/cm)",
}


def parameter_title(name: str) -> str:
    """A parameter with its unit; its own name where it has no other, which ends in the unit."""
    return _KNOWN.get(name) or shortened(name, 44).replace("$", r"\$")
