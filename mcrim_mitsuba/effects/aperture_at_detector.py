"""Effect ``aperture_at_detector``: the mask lies on the detector, not on the entrance face."""

import numpy as np

from mcrim_mitsuba.effects._bench import element
from mcrim_mitsuba.effects.effect import Columns, Effect, Parameters, Values
from mcrim_mitsuba.scene.editor import Node, SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile

_BEHIND = "The entrance face of the window is polished glass: the mask lies on the detector"


def edit(editor: SceneEditor) -> None:
    """Take the mask off the window's entrance face and lay it on the detector."""
    detectors, masks = editor.detectors, editor.masks
    for detector in detectors:
        if detector.parent in masks:
            raise editor.refusal("the mask lies on the detector", "nothing to add", detector)
    if not masks:
        raise editor.refusal("the scene has no mask", "let the window wear an aperture")
    # the properties of the hole; the interface in it is no property
    holes = [[part for part in mask.elements if "name" in part.attributes] for mask in masks]
    texts = [[editor.source(part) for part in hole] for hole in holes]
    for mask, text in zip(masks, texts, strict=True):
        if text != texts[0]:
            problem = "the masks have different holes"
            raise editor.refusal(problem, "only one hole can be moved", mask)
        inner = mask.child("bsdf")
        if inner is None or len(editor.targets(mask, "bsdf")) != 1:
            problem = f"{mask.label} does not hold its interface"
            raise editor.refusal(problem, "nest the <bsdf> in it", mask)
        _take_off(editor, mask, inner)
    for part in holes[0]:
        for word in part.attributes.values():
            if word.startswith("$"):
                declared = editor.default(word[1:])
                editor.reword(declared, "on the window's entrance face", "on the detector")
    for detector in detectors:
        _put_on(editor, detector, texts[0])


def _take_off(editor: SceneEditor, mask: Node, inner: Node) -> None:
    """Leave of an aperture the interface in its hole, under the aperture's id."""
    parts = [editor.source(part) for part in inner.elements]
    editor.replace(mask, element(f'bsdf type="{inner.type}"{_id_of(mask)}', parts))
    editor.set_comment(mask, _BEHIND)


def _put_on(editor: SceneEditor, detector: Node, hole: list[str]) -> None:
    """Put an aperture around what a detector wears, under its id."""
    name = _id_of(detector)
    own = editor.source(detector).replace(name, "", 1)
    mask = element(f'bsdf type="aperture"{name}', [*hole, own])
    editor.replace(detector, f"<!-- the mask, with its round hole -->\n{mask}")


def _id_of(node: Node) -> str:
    return f' id="{node.attributes["id"]}"' if "id" in node.attributes else ""


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """Whether a photon met the detector inside the hole, of a run without any mask."""
    radius_mm = float(parameters["aperture_radius_mm"])
    return (columns["arrival_radius_mm"] <= radius_mm).astype(np.float64)


def there(scene: SceneFile) -> bool:
    """Whether a scene has it."""
    return any(
        bsdf.get("type") == "aperture" and bsdf.find("bsdf[@type='photodetector']") is not None
        for bsdf in scene.root.iter("bsdf")
    )


EFFECT = Effect(
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
    there=there,
    edit=edit,
    columns=("arrival_radius_mm",),
    weight=weight,
    mask_column="arrival_radius_mm",
)
