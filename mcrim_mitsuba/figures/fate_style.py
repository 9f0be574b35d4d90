"""How figures name and draw the fates of light: in one order, colour, hatch and marker each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from mcrim_mitsuba.figures.style import DARK, WARM


@dataclass(frozen=True)
class FateStyle:
    """One fate's look; hatches, markers and lines tell fates apart where colours do not.

    Attributes
    ----------
    words : str
        Such as ``absorbed at the mask``.
    line, fill, edge, text : str
        Colours of its paths, dark; of its bars, of their edge and hatches, and of words on them.
    hatch, marker : str
        Of its bars, and of the ends of its paths.
    dashes : str or tuple
        Line style of its paths.
    """

    words: str
    line: str
    fill: str
    hatch: str
    marker: str
    dashes: str | tuple
    edge: str = "#222222"
    text: str = "black"


_KNOWN = {
    "detected": FateStyle("detected", DARK, DARK, "", "o", "-", text="white"),
    "absorbed_crystal": FateStyle(
        "absorbed in the crystal", "#7a1f5c", "#c9a0bd", "//", "X", (0, (6, 1.5))
    ),
    "absorbed_gap": FateStyle(
        "absorbed in the gap", "#00625a", "#8fd0c8", "\\\\", "P", (0, (4, 1.2, 1, 1.2))
    ),
    "absorbed_window": FateStyle(
        "absorbed in the window", "#31572c", "#b5d0a4", "..", "p", (0, (4, 1.2, 1, 1.2))
    ),
    "absorbed_aperture": FateStyle(
        "absorbed by the mask", "#111111", "#555555", "xx", "s", (0, (1.2, 1.2)), "black", "white"
    ),
    "absorbed_reflector": FateStyle(
        "absorbed by the reflector", "#6b4a00", "#d8b365", "++", "D", (0, (1.2, 1.2))
    ),
    "absorbed_surface": FateStyle(
        "lost at a surface", "#37474f", "#a9bcc6", "oo", "h", (0, (4, 1.2, 1, 1.2))
    ),
    "escaped": FateStyle("escaped", WARM, "#f6dccd", "", "^", (0, (3, 1.3))),
    "truncated": FateStyle("under way at the depth limit", "#3d3d3d", "#9a9a9a", "--", "*", ":"),
    "lost": FateStyle("lost by rounding", "#3d3d3d", "white", "**", "v", ":"),
}


def fate_style(fate: str) -> FateStyle:
    """That of a fate as in `results.SimulationResult.budget`; of any medium's absorption too."""
    if fate in _KNOWN:
        return _KNOWN[fate]
    medium = fate.removeprefix("absorbed_")
    return FateStyle(f"absorbed in {medium}", "#004a7c", "#9cc7e0", "||", "d", (0, (6, 1.5)))


def ordered(fates: Iterable[str]) -> list[str]:
    """Fates in the order of all figures: what is wanted first, what is wrong last."""
    known = list(_KNOWN)
    others = known.index("absorbed_aperture")

    def place(fate: str) -> tuple[float, str]:
        return (known.index(fate), "") if fate in _KNOWN else (others - 0.5, fate)

    return sorted(set(fates), key=place)
