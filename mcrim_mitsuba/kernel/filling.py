"""What counts as filled: effects of a liquid do nothing in a gap of air."""

from __future__ import annotations

#: Index of refraction above which a volume holds a liquid or a solid.
FILLED_ABOVE = 1.0005


def is_filled(index: float) -> bool:
    """Whether a volume of this nominal index holds more than a gas."""
    return index > FILLED_ABOVE
