"""Effect ``mask_offset``: the crystal does not stand on the axis of mask and detector."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import masks_of, set_part
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor

_CENTRE = '<point name="centre" x="$mask_offset_mm" y="0" z="0"/>'


def edit(editor: SceneEditor) -> None:
    """Shift the hole of the mask, and the axis of the detector's sensitivity, along x."""
    set_part(editor, [*masks_of(editor), *editor.detectors], "centre", _CENTRE)


EFFECT = Effect(
    name="mask_offset",
    title="mask off the crystal's axis",
    family="alignment",
    look=(
        "Look down on the bench, or photograph it: is the ring of the mask around the crystal "
        "equally wide on all sides? Shift the crystal by a millimetre and measure again."
    ),
    physics=(
        "A crystal is set on the window by hand, and its middle may be some millimetres off the "
        "middle of the mask's hole and of the tube. The mask then covers more of what leaves "
        "the crystal on one side than it uncovers on the other, and a small hole may end under "
        "the crystal. Mask and detector axis are shifted along x; crystal, gap and window stay."
    ),
    source="V. Alenkov et al., JINST 8 (2013) P06002, section 5 (the bench)",
    parameters=(
        EffectParameter(
            name="mask_offset_mm",
            unit="mm",
            meaning="Shift of mask and detector axis along x against the crystal",
            minimum=0.0,
            maximum=6.0,
            start=1.0,
            absent=0.0,
            plausible=(0.0, 3.0),
            nodes=(0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0),
            # where the hole begins to cut the crystal's foot
            kinked=True,
        ),
    ),
    edit=edit,
)
