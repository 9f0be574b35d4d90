"""The catalogue of physical effects, and how one is put into a scene."""

from mcrim_mitsuba.effects.catalogue import BrokenEffectError, add, catalogue, effect_of
from mcrim_mitsuba.effects.effect import Effect, EffectParameter, filled

__all__ = [
    "BrokenEffectError",
    "Effect",
    "EffectParameter",
    "add",
    "catalogue",
    "effect_of",
    "filled",
]
