"""Effect ``gap_bubble_round``: a round bubble of air is in the middle of the filled gap."""

from mcrim_mitsuba.effects._bench import (
    GAP,
    GAP_INDEX,
    WIDTH,
    element,
    gap_sides,
    part_gap,
    worn_towards_air,
)
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor

_DISC = '<float name="disc" value="$bubble_area_fraction"/>'


def edit(editor: SceneEditor) -> None:
    """Part what borders the gap around the bubble, and put up its wall."""
    editor.refuse_id("bubble_wall")
    part_gap(editor, _DISC, liquid="outside", air="inside")
    sides = gap_sides(editor)
    offset = sides[0].named("thickness_offset")
    parts = [
        f'<float name="width" value="${WIDTH}"/>',
        f'<float name="thickness" value="${GAP}"/>',
        _DISC,
        GAP_INDEX,
        *([editor.source(offset)] if offset is not None else []),
        worn_towards_air(editor, sides, "the gap's sides"),
        f'<ref name="interior" id="{editor.gap.attributes["id"]}"/>',
    ]
    xml = element('shape type="round_wall" id="bubble_wall"', parts)
    editor.insert_shape(f"<!-- the wall of the bubble -->\n{xml}", after=sides[-1])


EFFECT = Effect(
    name="gap_bubble_round",
    title="round air bubble in the gap",
    family="gap",
    look=(
        "Look through the window from below: bubbles look silvery, and a round one in the middle "
        "is seen at once. Mount the crystal again and see whether the reading repeats."
    ),
    physics=(
        "Too small a drop of gel, or one that was put on as a ring, leaves a bubble of air in the "
        "middle of the gap: there crystal and window border air, and the light stays trapped as in "
        "the uncoupled crystal. In the middle no mask hides what is missing. Here the air takes a "
        "disc about the axis, of this part of the area of the crystal's bottom, in filled gaps."
    ),
    source=(
        "W. R. Leo, Techniques for Nuclear and Particle Physics Experiments, 2nd ed., Springer "
        "1994, chapter 9"
    ),
    parameters=(
        EffectParameter(
            name="bubble_area_fraction",
            unit="",
            meaning="Part of the crystal's bottom, a disc in its middle, under which there is air",
            minimum=0.0,
            maximum=0.6,
            start=0.15,
            absent=0.0,
            plausible=(0.0, 0.4),
            nodes=(0.08, 0.16, 0.24, 0.31, 0.37, 0.42, 0.46, 0.5, 0.55, 0.6),
            # where the disc covers the hole of a mask, little light is left, and then no less
            kinked=True,
        ),
    ),
    excludes=("gap_bubble", "edge_chamfer"),
    filled_only=True,
    edit=edit,
)
