"""The catalogue of physical effects, a module for each part of the bench; how one enters a scene.

Others take what is named here. What an effect is: `effect`; which there are, those of a user's
folder and of other distributions among them, and how one gets into a scene: `catalogue`. Whose
code may be executed: `trust`. The effects themselves are in `crystal`, `crystal_faces`, `gap`,
`detector`, `surroundings` and `readings`, and what several need of a bench in `scene_edits`: the
room's own.
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
