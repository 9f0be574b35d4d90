"""Effect ``gel_creep``: gel stands up around the foot of the crystal."""

from mcrim_mitsuba.effects._bench import GAP_INDEX, crystal_box, element, make_panel
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import Node, SceneEditor

_LIQUID, _WET = "liquid", "crystal_to_liquid"
_LEVEL = '<float name="level" value="$collar_mm"/>\n<string name="keep" value="{}"/>\n{}'
_ROUGH = "roughness_alpha"


def edit(editor: SceneEditor) -> None:
    """Cut the sides of the crystal at the collar's height; what is below borders a liquid."""
    if "n_gap" not in editor.scene.parameters:
        raise editor.refusal("the scene has no parameter n_gap", "write the gap's index as one")
    wraps = [shape for shape in editor.shapes if shape.type == "wrapping"]
    if wraps:
        problem = "light that leaves into the liquid would pass through the wrapping"
        raise editor.refusal(problem, "gel_creep is for bare crystals", wraps[0])
    if editor.gap.elements:
        problem = "the gap's medium has properties, which the liquid beside it would not have"
        raise editor.refusal(problem, "gel_creep and gap_absorption exclude each other", editor.gap)
    editor.refuse_id(_LIQUID)
    box = crystal_box(editor)
    sides = [face for name in ("right", "left", "back", "front") for face in box[name]]
    wet = _interface(editor, box["bottom"][0], sides[0])
    editor.insert_after(
        editor.gap,
        "<!-- the liquid that has crept up the sides: light goes straight on in it -->\n"
        f'<medium type="bulk" id="{_LIQUID}">\n  <boolean name="endless" value="true"/>\n</medium>',
    )
    for face in sides:
        _split(editor, face, wet)


def _interface(editor: SceneEditor, bottom: Node, side: Node) -> str:
    """Id of a new interface of crystal and liquid: the bottom's, as rough as the sides."""
    below, beside = editor.bsdf(bottom), editor.bsdf(side)
    if below is None or beside is None or not {below, beside} <= set(editor.crystal_polish):
        problem = f"{bottom.label} or {side.label} does not wear a dielectric"
        raise editor.refusal(problem, "only faces of plain polish can be changed", bottom)
    name = _WET + "_side" * beside.attributes.get("id", "").endswith("_side")
    editor.refuse_id(name)
    kept = [part for part in below.elements if part.attributes.get("name") != _ROUGH]
    parts = [editor.source(part) for part in [*kept, beside.named(_ROUGH)] if part is not None]
    plugin = "polish" if len(parts) > 2 else "dielectric"
    editor.insert_after(below, element(f'bsdf type="{plugin}" id="{name}"', parts))
    return name


def _split(editor: SceneEditor, face: Node, wet: str) -> None:
    """Leave the wet part out of a side and make it a face of its own, towards the liquid."""
    name = f"{face.attributes['id']}_wet"
    editor.refuse_id(name)
    make_panel(editor, face, _LEVEL.format("above", GAP_INDEX))
    trim, transform = face.named("trim"), face.named("to_world")
    assert transform is not None  # `crystal_box` found its corners by it
    parts = [
        *([editor.source(trim)] if trim is not None else []),
        *_LEVEL.format("below", GAP_INDEX).split("\n"),
        editor.source(transform),
        f'<ref id="{wet}"/>',
        f'<ref name="interior" id="{editor.crystal.attributes["id"]}"/>',
        f'<ref name="exterior" id="{_LIQUID}"/>',
    ]
    editor.insert_after(face, element(f'shape type="panel" id="{name}"', parts))


EFFECT = Effect(
    name="gel_creep",
    title="gel around the crystal's foot",
    family="gap",
    look=(
        "Look along the window with a loupe: a meniscus stands around the foot of the crystal. "
        "Wipe it away and read again."
    ),
    physics=(
        "Gel that is squeezed out under the crystal, or oil that creeps, stands up around its "
        "foot. Light that total reflection would keep at the sides leaves there into the liquid "
        "and reaches the window beside the crystal. Here the four side faces border the liquid up "
        "to this height in filled configurations; light that leaves there goes straight on in the "
        "liquid, to the window's plane and through it, mask included, or away for ever. Light that "
        "comes from the air finds these faces dry: a thin film bends it no further."
    ),
    source=(
        "P.-G. de Gennes, F. Brochard-Wyart and D. Quéré, Capillarity and Wetting Phenomena, "
        "Springer 2004, chapter 2"
    ),
    parameters=(
        EffectParameter(
            name="collar_mm",
            unit="mm",
            meaning="Height up to which a filled gap's liquid wets the crystal's sides",
            minimum=0.0,
            maximum=3.0,
            start=0.5,
            absent=0.0,
            plausible=(0.0, 1.5),
            nodes=(0.25, 0.75, 1.5, 2.25, 3.0),
        ),
    ),
    excludes=("gap_absorption",),
    filled_only=True,
    edit=edit,
)
