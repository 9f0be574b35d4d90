"""The catalogue of physical effects, and how one is put into a scene."""

from mcrim_mitsuba.effects.add import add, effect_of
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Effect, EffectParameter, filled

__all__ = ["Effect", "EffectParameter", "add", "catalogue", "effect_of", "filled"]
