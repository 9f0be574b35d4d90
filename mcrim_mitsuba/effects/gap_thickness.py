"""Effect ``gap_thickness``: every gap is thicker, or thinner, than thought."""

import math
from collections.abc import Mapping

from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.effects._bench import change_gap_sides, element, refuse_without_box
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor

#: Largest part of a gap that may be missing.
_LARGEST_PART = 0.8
# "-$gap_offset_mm" would be no number where the offset is negative
_DOWN = '<scale z="-1"/><translate z="$gap_offset_mm"/><scale z="-1"/>  <!-- downwards -->'


def edit(editor: SceneEditor) -> None:
    """Lower the window and all that belongs to it, and lengthen the gap's sides."""
    refuse_without_box(editor)
    change_gap_sides(editor, '<float name="thickness_offset" value="$gap_offset_mm"/>')
    for shape in editor.shapes:
        if editor.window not in editor.media(shape):
            continue
        transform = shape.named("to_world")
        if transform is None:
            editor.insert_first(shape, element('transform name="to_world"', [_DOWN]))
        else:
            editor.insert_last(transform, _DOWN)


def limits(parameters: Mapping[str, Value]) -> tuple[float, float]:
    """Something of the gap is left."""
    return -_LARGEST_PART * float(parameters["gap_mm"]), math.inf


EFFECT = Effect(
    name="gap_thickness",
    title="wrong thickness of the gap",
    family="gap",
    look=(
        "Measure the gap with a feeler gauge, or focus a microscope on both of its faces; "
        "put a weight on the crystal and measure again."
    ),
    physics=(
        "Spacers, dust and the meniscus of a gel set the distance between crystal and window; it "
        "is rarely measured. In a thicker gap light spreads further before it meets window and "
        "mask, and more of it leaves through the gap's sides. (Only gaps thinner than a "
        "wavelength would couple by frustrated total reflection, which is not meant here.)"
    ),
    source="S. Zhu, A. W. Yu, D. Hawley and R. Roy, American Journal of Physics 54 (1986) 601",
    parameters=(
        EffectParameter(
            name="gap_offset_mm",
            unit="mm",
            meaning="Added to the thickness of the gap, whatever is in it",
            minimum=-0.04,
            maximum=0.5,
            start=0.05,
            absent=0.0,
            plausible=(-0.04, 0.2),
            nodes=(-0.04, 0.2, 0.5),
            limits=limits,
        ),
    ),
    edit=edit,
)
