"""Effects of the gap between crystal and window, and of what fills it."""

from __future__ import annotations

import math

import numpy as np

from mcrim_mitsuba.effects import scene_edits
from mcrim_mitsuba.effects.effect import Columns, Effect, Parameters, Values, filled, one_parameter
from mcrim_mitsuba.scene.editor import INTERFACES, SceneEditor

_OFFSETS = {"int_ior": "int_offset", "ext_ior": "ext_offset"}


def edit_gap_index(editor: SceneEditor) -> None:
    """Add the offset to every face that has the gap's index."""
    borders = [
        (bsdf, offset)
        for bsdf in editor.root.iter("bsdf")
        for index, offset in _OFFSETS.items()
        if bsdf.type in INTERFACES
        and bsdf.find(f"float[@name='{index}'][@value='$n_gap']") is not None
    ]
    for bsdf, offset in borders:
        scene_edits.polish(editor, bsdf, offset, "$gap_index_offset")
    if not borders:
        raise editor.refusal("no interface has the index $n_gap", "write n_gap as a parameter")


GAP_INDEX = Effect(
    name="gap_index",
    title="wrong index of the liquid",
    family="gap",
    look=(
        "Put a drop of the liquid on a refractometer, at the temperature of the bench; "
        "measure with another liquid."
    ),
    physics=(
        "The index of a liquid or gel depends on temperature (about -0.0004 per kelvin for "
        "organic liquids), wavelength, mixture and age, by the Lorentz-Lorenz relation with its "
        "density. A wrong value moves every filled configuration, the empty ones not."
    ),
    source="M. Born and E. Wolf, Principles of Optics, 7th ed., Cambridge 1999, section 2.3",
    parameters=one_parameter(
        name="gap_index_offset",
        meaning="Added to the index of the gap wherever that is above 1.0005",
        minimum=-0.1,
        maximum=0.1,
        start=0.02,
        plausible=(-0.03, 0.03),
        nodes=(-0.1, -0.06, -0.025, 0.025, 0.06, 0.1),
        # where the index passes that of the window total reflection begins
        kinked=True,
    ),
    filled_only=True,
    edit=edit_gap_index,
)


#: Largest part of a gap that may be missing.
_LARGEST_LOSS = 0.8
# "-$gap_offset_mm" would be no number where the offset is negative
_DOWN = '<scale z="-1"/><translate z="$gap_offset_mm"/><scale z="-1"/>  <!-- downwards -->'


def edit_gap_thickness(editor: SceneEditor) -> None:
    """Lower the window and all that belongs to it, and lengthen the gap's sides."""
    scene_edits.refuse_without_box(editor)
    scene_edits.change_gap_sides(editor, '<float name="thickness_offset" value="$gap_offset_mm"/>')
    for shape in editor.shapes:
        if editor.window not in editor.media(shape):
            continue
        transform = shape.named("to_world")
        if transform is None:
            editor.insert_first(shape, scene_edits.element('transform name="to_world"', [_DOWN]))
        else:
            editor.insert_last(transform, _DOWN)


def limits_gap_thickness(parameters: Parameters) -> tuple[float, float]:
    """Something of the gap is left."""
    return -_LARGEST_LOSS * float(parameters["gap_mm"]), math.inf


GAP_THICKNESS = Effect(
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
    parameters=one_parameter(
        name="gap_offset_mm",
        meaning="Added to the thickness of the gap, whatever is in it",
        minimum=-0.04,
        maximum=0.5,
        start=0.05,
        plausible=(-0.04, 0.2),
        nodes=(-0.04, 0.2, 0.5),
        limits=limits_gap_thickness,
    ),
    edit=edit_gap_thickness,
)


def edit_gap_absorption(editor: SceneEditor) -> None:
    """Give the gap's medium an absorption that air does not have."""
    number = editor.gap.named("alpha_abs_per_cm")
    if number is not None:
        raise editor.refusal("the gap absorbs already", "change this number instead", number)
    editor.insert_last(
        editor.gap,
        '<float name="alpha_abs_per_cm" value="$gap_absorption_per_cm"/>\n'
        '<float name="index" value="$n_gap"/>  <!-- air does not absorb -->',
    )


def weight_gap_absorption(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """exp(-alpha path) in a filled gap."""
    path_cm = columns["path_gap_cm"].astype(np.float64)
    if not filled(parameters):
        return np.ones(len(path_cm))
    return np.exp(-values["gap_absorption_per_cm"] * path_cm)


GAP_ABSORPTION = Effect(
    name="gap_absorption",
    title="absorbing liquid in the gap",
    family="gap",
    look="Measure the transmittance of the liquid in a cuvette: old gel turns yellow.",
    physics=(
        "A gel that has yellowed, or a liquid that is not clear at the wavelength of emission, "
        "absorbs along the path in it (Beer-Lambert law). Light that crosses the gap obliquely, "
        "or is reflected to and fro in it, loses most; an empty gap loses nothing."
    ),
    source="J. D. Ingle and S. R. Crouch, Spectrochemical Analysis, Prentice Hall 1988",
    parameters=one_parameter(
        name="gap_absorption_per_cm",
        meaning="Absorption coefficient of what fills the gap",
        maximum=20.0,
        start=1.0,
        plausible=(0.0, 3.0),
        nodes=(0.5, 1.5, 3.5, 7.0, 11.0, 16.0, 20.0),
    ),
    excludes=("gel_creep",),
    filled_only=True,
    edit=edit_gap_absorption,
    columns=("path_gap_cm",),
    weight=weight_gap_absorption,
)


#: Of bubbles.
_LEO = (
    "W. R. Leo, Techniques for Nuclear and Particle Physics Experiments, 2nd ed., Springer 1994, "
    "chapter 9"
)
_CUT = '<float name="cut" value="$bubble_fraction"/>'


def edit_bubble_strip(editor: SceneEditor) -> None:
    """Let air take a strip of the gap: faces around it are parted where the air begins."""
    scene_edits.part_gap(editor, _CUT, liquid="beyond", air="before")
    scene_edits.change_gap_sides(editor, f"{_CUT}\n{scene_edits.INDEX_OF_PART}")
    for rim in editor.shapes:
        if rim.type == "frame" and editor.media(rim) == (editor.gap, None):
            scene_edits.add_numbers(editor, rim, f"{_CUT}\n{scene_edits.INDEX_OF_PART}")


GAP_BUBBLE = Effect(
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
    source=_LEO,
    parameters=one_parameter(
        name="bubble_fraction",
        meaning="Fraction of the filled gap that is air, from its left side on",
        maximum=0.6,
        start=0.15,
        plausible=(0.0, 0.4),
        nodes=(0.05, 0.1, 0.15, 0.21, 0.28, 0.36, 0.47, 0.6),
        # where the strip reaches the hole of a mask, what it does begins
        kinked=True,
    ),
    excludes=("gap_bubble_round",),
    filled_only=True,
    edit=edit_bubble_strip,
)


_DISC = '<float name="disc" value="$bubble_area_fraction"/>'


def edit_round_bubble(editor: SceneEditor) -> None:
    """Part what borders the gap around the bubble, and put up its wall."""
    editor.refuse_id("bubble_wall")
    scene_edits.part_gap(editor, _DISC, liquid="outside", air="inside")
    sides = scene_edits.gap_sides(editor)
    offset = sides[0].named("thickness_offset")
    parts = [
        f'<float name="width" value="${scene_edits.WIDTH}"/>',
        f'<float name="thickness" value="${scene_edits.GAP}"/>',
        _DISC,
        scene_edits.INDEX_OF_PART,
        *([editor.source(offset)] if offset is not None else []),
        scene_edits.worn_towards_air(editor, sides, "the gap's sides"),
        f'<ref name="interior" id="{editor.gap.attrib["id"]}"/>',
    ]
    xml = scene_edits.element('shape type="round_wall" id="bubble_wall"', parts)
    editor.insert_shape(f"<!-- the wall of the bubble -->\n{xml}", after=sides[-1])


GAP_BUBBLE_ROUND = Effect(
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
    source=_LEO,
    parameters=one_parameter(
        name="bubble_area_fraction",
        meaning="Part of the crystal's bottom, a disc in its middle, under which there is air",
        maximum=0.6,
        start=0.15,
        plausible=(0.0, 0.4),
        nodes=(0.08, 0.16, 0.24, 0.31, 0.37, 0.42, 0.46, 0.5, 0.55, 0.6),
        # where the disc covers the hole of a mask, little light is left, and then no less
        kinked=True,
    ),
    excludes=("gap_bubble", "edge_chamfer"),
    filled_only=True,
    edit=edit_round_bubble,
)


_LIQUID = "liquid"
_WET = "crystal_to_liquid"
_LEVEL = f"""<float name="level" value="$collar_mm"/>
<string name="keep" value="{{}}"/>
{scene_edits.INDEX_OF_PART}"""
_ROUGH = "roughness_alpha"


def edit_gel_creep(editor: SceneEditor) -> None:
    """Cut the sides of the crystal at the collar's height; what is below borders a liquid."""
    if wraps := editor.all("shape", "wrapping"):
        problem = "light that leaves into the liquid would pass through the wrapping"
        raise editor.refusal(problem, "gel_creep is for bare crystals", wraps[0])
    if editor.gap.elements:
        problem = "the gap's medium has properties, which the liquid beside it would not have"
        raise editor.refusal(problem, "gel_creep and gap_absorption exclude each other", editor.gap)
    editor.refuse_id(_LIQUID)
    box = scene_edits.crystal_box(editor)
    sides = [face for name in ("right", "left", "back", "front") for face in box[name]]
    # a new interface of crystal and liquid: the bottom's, as rough as the sides
    bottom, side = box["bottom"][0], sides[0]
    below, beside = editor.bsdf(bottom), editor.bsdf(side)
    if below is None or beside is None or not {below, beside} <= set(editor.crystal_polish):
        problem = f"{bottom.label} or {side.label} does not wear a dielectric"
        raise editor.refusal(problem, "only faces of plain polish can be changed", bottom)
    wet = _WET + "_side" * beside.get("id", "").endswith("_side")
    editor.refuse_id(wet)
    kept = [part for part in below.elements if part.get("name") != _ROUGH]
    parts = [editor.source(part) for part in [*kept, beside.named(_ROUGH)] if part is not None]
    plugin = "polish" if len(parts) > 2 else "dielectric"
    editor.insert_after(below, scene_edits.element(f'bsdf type="{plugin}" id="{wet}"', parts))
    editor.insert_after(
        editor.gap,
        "<!-- the liquid that has crept up the sides: light goes straight on in it -->\n"
        f'<medium type="bulk" id="{_LIQUID}">\n  <boolean name="endless" value="true"/>\n</medium>',
    )
    worn = (
        f'<ref id="{wet}"/>',
        f'<ref name="interior" id="{editor.crystal.attrib["id"]}"/>',
        f'<ref name="exterior" id="{_LIQUID}"/>',
    )
    for face in sides:
        name = f"{face.attrib['id']}_wet"
        scene_edits.split_panel(editor, face, name, _LEVEL, ("above", "below"), worn)


GEL_CREEP = Effect(
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
    parameters=one_parameter(
        name="collar_mm",
        meaning="Height up to which a filled gap's liquid wets the crystal's sides",
        maximum=3.0,
        start=0.5,
        plausible=(0.0, 1.5),
        nodes=(0.25, 0.75, 1.5, 2.25, 3.0),
    ),
    excludes=("gap_absorption",),
    filled_only=True,
    edit=edit_gel_creep,
)
