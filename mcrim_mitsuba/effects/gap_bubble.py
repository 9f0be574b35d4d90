"""Effect ``gap_bubble``: part of the filled gap is air."""

from mcrim_mitsuba.effects._bench import (
    GAP_INDEX,
    add_numbers,
    change_gap_sides,
    part_gap,
)
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor

_CUT = '<float name="cut" value="$bubble_fraction"/>'


def edit(editor: SceneEditor) -> None:
    """Cut the gap where the air begins, with what borders it."""
    part_gap(editor, _CUT, liquid="beyond", air="before")
    change_gap_sides(editor, f"{_CUT}\n{GAP_INDEX}")
    for rim in editor.shapes:
        if rim.type == "frame" and editor.media(rim) == (editor.gap, None):
            add_numbers(editor, rim, f"{_CUT}\n{GAP_INDEX}")


EFFECT = Effect(
    name="gap_bubble",
    title="air bubble in the gap",
    family="gap",
    look=(
        "Look through the window from below: bubbles look silvery. Mount the crystal again "
        "and see whether the reading repeats."
    ),
    physics=(
        "Gel that does not wet the whole face, or has crept away from it, leaves air in part of "
        "the gap: there crystal and window border air, and the light stays trapped as in the "
        "uncoupled crystal. Here the air takes the strip x < -W/2 + f W of filled gaps."
    ),
    source=(
        "W. R. Leo, Techniques for Nuclear and Particle Physics Experiments, 2nd ed., Springer "
        "1994, chapter 9"
    ),
    parameters=(
        EffectParameter(
            name="bubble_fraction",
            unit="",
            meaning="Fraction of the filled gap that is air, from its left side on",
            minimum=0.0,
            maximum=0.6,
            start=0.15,
            absent=0.0,
            plausible=(0.0, 0.4),
            nodes=(0.05, 0.1, 0.15, 0.21, 0.28, 0.36, 0.47, 0.6),
            # where the strip reaches the hole of a mask, what it does begins
            kinked=True,
        ),
    ),
    excludes=("gap_bubble_round",),
    filled_only=True,
    edit=edit,
)
