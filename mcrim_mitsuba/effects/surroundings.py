"""Effects of what stands around crystal and detector: mask, housing, a spectrophotometer's beam."""

from __future__ import annotations

from functools import partial

import numpy as np

from mcrim_mitsuba.effects.detector import sends_back_no_more
from mcrim_mitsuba.effects.effect import (
    Columns,
    Effect,
    Parameters,
    Values,
    one_parameter,
    reflections,
)
from mcrim_mitsuba.effects.scene_edits import HEIGHT, crystal_box, element, set_masks, set_part
from mcrim_mitsuba.scene.editor import INTERFACES, Node, SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.spectrophotometer import ACCEPTANCE


def edit_top_reflector(editor: SceneEditor) -> None:
    """Lay a white reflector on the top face, behind a film of air."""
    for shape in editor.all("shape", "wrapping"):
        if "top" not in _bare(editor.resolved()[shape]):
            problem = f"{shape.label} covers the top already"
            raise editor.refusal(problem, "change its reflectance instead", shape)
    editor.refuse_id("top_reflector")
    box = crystal_box(editor)
    last = max((face for faces in box.values() for face in faces), key=editor.shapes.index)
    height_mm = float(editor.scene.parameters[HEIGHT])
    # above 5 cm a thinner one is none in single precision
    film_mm = f"{max(0.01, 2e-4 * height_mm):.2g}"
    editor.insert_shape(
        f"""<!-- A white reflector exactly over the top face, behind {film_mm} mm of air -->
<shape type="rectangle" id="top_reflector">
  <transform name="to_world">
    <scale x="$crystal_width_mm" y="$crystal_width_mm"/>
    <rotate x="1" angle="180"/>
    <scale value="0.5"/>
    <translate z="$crystal_height_mm"/>
    <translate z="{film_mm}"/>
  </transform>
  <bsdf type="diffuse">
    <spectrum name="reflectance" value="$top_reflectance"/>
  </bsdf>
</shape>""",
        after=last,
    )


def alone_in(scene: SceneFile) -> bool:
    """Whether nothing else reflects as it does: records count all reflections together."""
    clear = (*INTERFACES, "roughdielectric", "aperture", "photodetector")
    others = (shape for shape in scene.parts.shapes if shape.get("id") != "top_reflector")
    worn = (bsdf for shape in others for bsdf in scene.parts.worn_by(shape))
    return all(bsdf.type in clear for bsdf in worn)


TOP_REFLECTOR = Effect(
    name="top_reflector",
    title="reflector on the top face",
    family="housing",
    look="Put black paper on the crystal: the readings fall if something sent light back.",
    physics=(
        "Source holders, tape, paper or a white table behind the top face send light that left "
        "there back into the crystal, diffusely (Lambertian), through a thin film of air. Teflon "
        "tape in several layers reflects up to 99 %, paper and aluminium less."
    ),
    source="M. Janecek and W. W. Moses, IEEE Transactions on Nuclear Science 55 (2008) 2432",
    parameters=one_parameter(
        name="top_reflectance",
        meaning="Fraction of the light that the reflector on the top reflects",
        maximum=0.99,
        start=0.5,
        plausible=(0.0, 0.98),
        nodes=(0.2, 0.4, 0.6, 0.75, 0.9, 0.99),
    ),
    edit=edit_top_reflector,
    weighs_in=alone_in,
    **reflections("top_reflectance", "reflector_hits", simulated_at=0.99),
)


def _bare(wrapping: Node) -> set[str]:
    """What a wrapping leaves out, in its words."""
    words = wrapping.named("without")
    return set() if words is None else set(words.get("value", "").replace(",", " ").split())


def without_wrapping(scene: SceneFile) -> tuple[str, str] | None:
    """What to say of a scene whose crystal is bare."""
    if any(not _bare(shape) >= {"top", "sides"} for shape in scene.parts.all("shape", "wrapping")):
        return None
    return "a wrapping, and the scene has none", 'add <shape type="wrapping"> around the crystal'


def without_film(scene: SceneFile) -> tuple[str, str] | None:
    """What to say of a scene whose crystal is bare, or painted."""
    films = [wrapping.named("film") for wrapping in scene.parts.all("shape", "wrapping")]
    if films and not any(film is None or float(film.get("value", "")) for film in films):
        return "a film of air, and paint has none", "give the wrapping a film above 0"
    return without_wrapping(scene)


def without_wrapped_sides(scene: SceneFile) -> tuple[str, str] | None:
    """What to say of a scene whose crystal has bare sides."""
    wrappings = scene.parts.all("shape", "wrapping")
    if wrappings and all("sides" in _bare(wrapping) for wrapping in wrappings):
        return "wrapped sides, and the scene has none", "take sides out of the wrapping's without"
    return without_wrapping(scene)


def edit_wrapping(editor: SceneEditor, name: str, value: str) -> None:
    """Give every wrapping one more number."""
    wrappings = editor.all("shape", "wrapping")
    set_part(editor, wrappings, name, f'<float name="{name}" value="{value}"/>')


WRAP_CONTACT = Effect(
    name="wrap_contact",
    title="wrapping in contact with the crystal",
    family="housing",
    look=(
        "Look through a bare face at the wrapped ones: where a film of air is behind a face it "
        "mirrors, where the wrapping touches it is white. Wrap anew, looser, and measure again."
    ),
    physics=(
        "A wrapping lies on the crystal with a film of air between, but for places where it is "
        "pressed or glued on, or where grease has crept in. Each time light from inside meets a "
        "wrapped face it finds no film with this probability: there is no total reflection, and "
        "it meets the reflector at once, which sends its part back into the crystal or takes the "
        "rest. Reflection by a reflector that is coupled so differs from that through a film. "
        "Trapped light is freed, and light meets the reflector more often. Light that is in the "
        "film meets the crystal where there is one."
    ),
    source=(
        "M. Janecek and W. W. Moses, IEEE Transactions on Nuclear Science 57 (2010) 964 (crystals "
        "with reflectors behind air, and glued on)"
    ),
    parameters=one_parameter(
        name="wrap_contact",
        meaning="Probability that light from inside finds no film of air before the wrapping",
        maximum=1.0,
        start=0.1,
        plausible=(0.02, 0.5),
        # a few contacts free the light that a clear crystal traps
        nodes=(0.005, 0.02, 0.08, 0.25, 0.6, 1.0),
        coordinate="logarithmic",
        scale=0.01,
    ),
    lacks=without_film,
    edit=partial(edit_wrapping, name="contact", value="$wrap_contact"),
)


WRAP_SPECULAR = Effect(
    name="wrap_specular",
    title="wrapping that mirrors",
    family="housing",
    look="Look at the wrapping under a lamp: a foil shows the lamp, Teflon a white glow.",
    physics=(
        "Teflon, paper and paint reflect diffusely, by Lambert's law, foils of metal or of many "
        "polymer layers (ESR) as mirrors, and some reflectors, such as Tyvek, in part. This part "
        "of what the wrapping reflects keeps its angle to the face. A mirror behind a film of air "
        "returns light to where it came from: light that leaves a box so is not trapped, but "
        "may go round until it scatters."
    ),
    source="M. Janecek and W. W. Moses, IEEE Transactions on Nuclear Science 55 (2008) 2432",
    parameters=one_parameter(
        name="wrap_specular",
        meaning="Part of what the wrapping reflects that goes as from a mirror",
        maximum=1.0,
        start=0.2,
        plausible=(0.0, 1.0),
        nodes=(0.3, 0.65, 1.0),
    ),
    lacks=without_wrapping,
    edit=partial(edit_wrapping, name="specular", value="$wrap_specular"),
)


WRAP_MISSING = Effect(
    name="wrap_missing",
    title="wrapping that ends above the window",
    family="housing",
    look=(
        "Look at the foot of the crystal from the side: does tape, foil or paint go down to the "
        "window all around? Close the strip with tape and measure again."
    ),
    physics=(
        "Tape is cut short, slips up or is folded back where the crystal stands on its window, and "
        "paint is kept off the joint. This share of the side area, a strip around the foot, is "
        "bare: light leaves there into what is around the wrapping, and is lost unless it falls on "
        "a window that is wider than the crystal. In a cavity that reflects well a bare share f "
        "acts like a port of an integrating sphere: each time round a part 1 - R (1 - f) is lost "
        "in place of 1 - R, so that a few per cent are as bad as a much darker wrapping. A clear, "
        "polished crystal keeps some of it by total reflection."
    ),
    source="D. G. Goebel, Applied Optics 6 (1967) 125 (ports of integrating spheres)",
    parameters=one_parameter(
        name="wrap_missing",
        meaning="Part of the sides' area, from the bottom edge upwards, that is not wrapped",
        maximum=0.3,
        start=0.03,
        plausible=(0.01, 0.2),
        nodes=(0.01, 0.03, 0.07, 0.12, 0.2, 0.3),
        coordinate="logarithmic",
        scale=0.05,
    ),
    lacks=without_wrapped_sides,
    edit=partial(edit_wrapping, name="missing", value="$wrap_missing"),
)


_BEHIND = "The entrance face of the window is polished glass: the mask lies on the detector"


def edit_mask_on_detector(editor: SceneEditor) -> None:
    """Take the mask off the window's entrance face and lay it on the detector."""
    detectors, masks = editor.detectors, editor.masks
    for detector in detectors:
        if detector.getparent() in masks:
            raise editor.refusal("the mask lies on the detector", "nothing to add", detector)
    if not masks:
        raise editor.refusal("the scene has no mask", "let the window wear an aperture")
    # the properties of the hole; the interface in it is no property
    holes = [[part for part in mask.elements if "name" in part.attrib] for mask in masks]
    texts = [[editor.source(part) for part in hole] for hole in holes]
    for mask, text in zip(masks, texts, strict=True):
        if text != texts[0]:
            problem = "the masks have different holes"
            raise editor.refusal(problem, "only one hole can be moved", mask)
        inner = mask.find("bsdf")
        if inner is None or len(editor.targets(mask, "bsdf")) != 1:
            problem = f"{mask.label} does not hold its interface"
            raise editor.refusal(problem, "nest the <bsdf> in it", mask)
        # of an aperture the interface in its hole is left, under the aperture's id
        parts = [editor.source(part) for part in inner.elements]
        editor.replace(mask, element(f'bsdf type="{inner.type}"{_id_of(mask)}', parts))
        editor.set_comment(mask, _BEHIND)
    for part in holes[0]:
        for word in part.attrib.values():
            if word.startswith("$"):
                declared = editor.default(word[1:])
                editor.reword(declared, "on the window's entrance face", "on the detector")
    for detector in detectors:
        # around what it is, under its id
        name = _id_of(detector)
        bare = editor.source(detector).replace(name, "", 1)
        xml = element(f'bsdf type="aperture"{name}', [*texts[0], bare])
        editor.replace(detector, f"<!-- the mask, with its round hole -->\n{xml}")


def _id_of(node: Node) -> str:
    return f' id="{node.attrib["id"]}"' if "id" in node.attrib else ""


def weight_mask_on_detector(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """Whether a photon met the detector inside the hole, of a run without any mask."""
    radius_mm = float(parameters["aperture_radius_mm"])
    return (columns["arrival_radius_mm"] <= radius_mm).astype(np.float64)


def there_mask_on_detector(scene: SceneFile) -> bool:
    """Whether a scene has it."""
    masks = (bsdf for bsdf in scene.root.iter("bsdf") if bsdf.get("type") == "aperture")
    return any(mask.find("bsdf[@type='photodetector']") is not None for mask in masks)


APERTURE_AT_DETECTOR = Effect(
    name="aperture_at_detector",
    title="mask on the detector",
    family="alignment",
    look=(
        "Look where the mask lies: on the face of the window under the crystal, or behind "
        "the glass."
    ),
    physics=(
        "A mask behind the window, or the edge of the photocathode itself, stops other light "
        "than one on the entrance face: light spreads in the window before it meets the mask, "
        "and no black surface touches the glass beside the crystal. Descriptions of benches "
        "often leave open where the mask is."
    ),
    source="V. Alenkov et al., JINST 8 (2013) P06002, section 5 (the bench)",
    there=there_mask_on_detector,
    edit=edit_mask_on_detector,
    columns=("arrival_radius_mm",),
    weight=weight_mask_on_detector,
    # what the detector sends back may have met it where the mask is
    weighs_in=partial(sends_back_no_more, others=("reflectance", "specular", "cathode_nm")),
    mask_column="arrival_radius_mm",
)


MASK_OFFSET = Effect(
    name="mask_offset",
    title="mask off the crystal's axis",
    family="alignment",
    look=(
        "Look down on the bench, or photograph it: is the ring of the mask around the crystal "
        "equally wide on all sides? Shift the crystal by a millimetre and measure again."
    ),
    physics=(
        "A crystal is set on the window by hand, and its middle may be some millimetres off the "
        "middle of the mask's hole and of the detector. The mask then covers more of what leaves "
        "the crystal on one side than it uncovers on the other, and a small hole may end under "
        "the crystal. Mask and detector axis are shifted along x; crystal, gap and window stay."
    ),
    source="V. Alenkov et al., JINST 8 (2013) P06002, section 5 (the bench)",
    parameters=one_parameter(
        name="mask_offset_mm",
        meaning="Shift of mask and detector axis along x against the crystal",
        maximum=6.0,
        start=1.0,
        plausible=(0.0, 3.0),
        nodes=(0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0),
        # where the hole begins to cut the crystal's foot
        kinked=True,
    ),
    # the hole of the mask, and the axis of the detector's sensitivity
    edit=partial(
        set_masks,
        name="centre",
        xml='<point name="centre" x="$mask_offset_mm" y="0" z="0"/>',
        detectors=True,
    ),
)


HOUSING_REFLECTION = Effect(
    name="housing_reflection",
    title="mask that is not black",
    family="housing",
    look=(
        "Lay black velvet, or black paper with a hole, over mask and holder around the crystal: "
        "the readings fall if these reflected."
    ),
    physics=(
        "Black paint, anodised aluminium and black tape reflect 2 to 10 % of the light, diffusely. "
        "Light that misses the hole is so sent back up: out of the bench, or into the crystal "
        "once more. Of the mask's upper side it is this part (Lambertian, depolarised), under the "
        "crystal too where the hole is smaller than that; its lower side is black."
    ),
    source="J. L. Marshall et al., Proc. SPIE 9147 (2014) 91474F (reflectance of black materials)",
    parameters=one_parameter(
        name="housing_reflectance",
        meaning="Fraction of the light that the mask's upper side reflects diffusely",
        maximum=0.2,
        start=0.05,
        plausible=(0.0, 0.1),
        nodes=(0.03, 0.07, 0.13, 0.2),
    ),
    edit=partial(
        set_masks,
        name="reflectance",
        xml='<float name="reflectance" value="$housing_reflectance"/>',
    ),
    **reflections("housing_reflectance", "mask_hits", simulated_at=0.2),
)


#: Smallest and largest half angle that is looked at, degrees.
_LEAST_DEG = 0.5
_MOST_DEG = 89.0


def limits_forward_beam(parameters: Parameters) -> tuple[float, float]:
    """Offsets that leave an angle between nothing and a half space."""
    nominal = float(parameters[ACCEPTANCE])
    return min(_LEAST_DEG - nominal, -0.1 * nominal), max(_MOST_DEG - nominal, 0.1)


def weight_forward_beam(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """1 within the acceptance's half angle about the beam, 0 beyond."""
    return (columns["arrival_angle_deg"] <= values[ACCEPTANCE]).astype(np.float64)


FORWARD_BEAM = Effect(
    name="forward_beam",
    title="wrong spectrophotometer acceptance",
    family="beam",
    look=(
        "Close an iris in front of the spectrophotometer's detector, or move the sample away from "
        "it: what changes with the distance was scattered by a small angle."
    ),
    physics=(
        "Light that leaves a crystal at a small angle to the beam, scattered forward or by the "
        "faces, counts as transmitted where the detector still takes it. Most instruments take a "
        "half angle of 1 to 7 degrees, one with an integrating sphere nearly 90, and few papers "
        "say. It changes transmittances only, and none of a polished crystal that scatters evenly."
    ),
    source="ASTM D1003: haze is what leaves at more than 2.5 degrees to the beam",
    parameters=one_parameter(
        name=ACCEPTANCE,
        meaning="Largest angle to the beam that the detector takes, as an offset from [beam]",
        minimum=-89.0,
        maximum=89.0,
        start=1.0,
        plausible=(-4.0, 10.0),
        nodes=(-4.5, -3.5, -2.0, 3.0, 8.0, 15.0, 25.0),
        nominal=ACCEPTANCE,
        coordinate="logarithmic",
        scale=6.0,
        limits=limits_forward_beam,
    ),
    columns=("arrival_angle_deg",),
    weight=weight_forward_beam,
    of_beam=True,
)
