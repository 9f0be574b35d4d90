"""Effect ``gap_bubble``: part of the filled gap is air."""

from mcrim_mitsuba.effects._bench import (
    add_numbers,
    change_gap_sides,
    crystal_box,
    element,
    make_panel,
    rough_copy,
    window_under_gap,
    worn_towards_air,
)
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import Node, SceneEditor

_CUT = '<float name="cut" value="$bubble_fraction"/>'
_INDEX = '<float name="index" value="$n_gap"/>'


def edit(editor: SceneEditor) -> None:
    """Cut the gap where the air begins, with what borders it."""
    if "n_gap" not in editor.scene.parameters:
        raise editor.refusal("the scene has no parameter n_gap", "write the gap's index as one")
    box = crystal_box(editor)
    (bottom,) = box["bottom"]
    under = window_under_gap(editor)
    sides = [face for name, faces in box.items() if name != "bottom" for face in faces]
    to_air = worn_towards_air(editor, sides, "the crystal's other faces")
    own = editor.bsdf(bottom)
    if own is not None and own.attributes.get("id", "").endswith("_bottom"):
        # what is rough under the liquid is rough under the bubble
        smooth = editor.by_id[to_air.split('"')[1]]
        to_air = f'<ref id="{rough_copy(editor, smooth, "bottom")}"/>'
    beside = [s for s in editor.shapes if s.type == "frame" and editor.window in editor.media(s)]
    window_to_air = worn_towards_air(editor, beside, "the window's entrance face")
    _split(editor, bottom, "crystal_bottom_bubble", to_air, editor.crystal)
    _split(editor, under, "window_under_bubble", window_to_air, editor.window)
    change_gap_sides(editor, f"{_CUT}\n{_INDEX}")
    for rim in editor.shapes:
        if rim.type == "frame" and editor.media(rim) == (editor.gap, None):
            add_numbers(editor, rim, f"{_CUT}\n{_INDEX}")


def _split(editor: SceneEditor, face: Node, new_id: str, bsdf: str, interior: Node) -> None:
    """Leave the bubble's part out of a face and make it a face of its own, towards air."""
    editor.refuse_id(new_id)
    make_panel(editor, face, "\n".join([_CUT, '<string name="keep" value="beyond"/>', _INDEX]))
    trim, transform = face.named("trim"), face.named("to_world")
    assert transform is not None  # `crystal_box` and `window_under_gap` found its corners by it
    parts = [
        *([editor.source(trim)] if trim is not None else []),
        _CUT,
        '<string name="keep" value="before"/>',
        _INDEX,
        editor.source(transform),
        bsdf,
        f'<ref name="interior" id="{interior.attributes["id"]}"/>',
    ]
    xml = element(f'shape type="panel" id="{new_id}"', parts)
    editor.insert_after(face, f"<!-- the part of it that lies on the air bubble -->\n{xml}")


EFFECT = Effect(
    name="gap_bubble",
    title="Air bubble in the gap",
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
    filled_only=True,
    edit=edit,
)
