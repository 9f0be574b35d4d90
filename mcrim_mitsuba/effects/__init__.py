"""The catalogue of physical effects, one small module each, and how one is put into a scene.

Others take what is named here. What an effect is: `effect`; which there are, those of a user's
folder and of other distributions among them, and how one gets into a scene: `catalogue`. Whose code
may be executed: `trust`. What several effects need of a bench is in `_bench`, the room's own.
"""

from mcrim_mitsuba.effects.catalogue import BrokenEffectError, add, catalogue, effect_of
from mcrim_mitsuba.effects.effect import Effect, EffectParameter, Rows, filled

__all__ = [
    "BrokenEffectError",
    "Effect",
    "EffectParameter",
    "Rows",
    "add",
    "catalogue",
    "effect_of",
    "filled",
]
