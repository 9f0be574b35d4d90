"""What effects need of a bench to change it: phase, detectors, polish, faces of the box."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np

from mcrim_mitsuba.core.errors import said_by
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.scene.editor import INDICES, Node, SceneEditor
from mcrim_mitsuba.scene.xml_tree import transform_matrix

#: Of the light in vacuum.
WAVELENGTH = "wavelength_nm"
#: What an interface of the plugin ``polish`` may say besides its indices.
_FURTHER = (
    "int_offset",
    "ext_offset",
    "roughness_alpha",
    "distribution",
    "surface_loss",
    "ground_loss",
    "rms_roughness_nm",
    WAVELENGTH,
)
#: Scene parameters of the bench's sizes.
WIDTH = "crystal_width_mm"
HEIGHT = "crystal_height_mm"
GAP = "gap_mm"
#: Factors on them by which a face is seen to follow them.
_STRETCH = {WIDTH: 1.1, HEIGHT: 1.3, GAP: 1.7}
_TOLERANCE_MM = 1e-6
#: Tells a part of the gap whether it is filled.
INDEX_OF_PART = '<float name="index" value="$n_gap"/>'
_FLAT = ("rectangle", "panel")
_AXES = {
    "right": (0, 1),
    "left": (0, -1),
    "back": (1, 1),
    "front": (1, -1),
    "top": (2, 1),
    "bottom": (2, -1),
}
_FORM = "this effect is written for benches in the form of scenes/camoo4.xml"


def element(head: str, parts: Iterable[str]) -> str:
    """XML of an element: its tag with attributes, and what is in it, indented."""
    lines = [line for part in parts for line in part.split("\n")]
    return "\n  ".join([f"<{head}>", *lines]) + f"\n</{head.split()[0]}>"


def set_numbers(editor: SceneEditor, part: Node, *names: str) -> None:
    """Give a medium or an emitter the effect's parameters of these names."""
    for name in names:
        editor.insert_last(part, f'<float name="{name}" value="${name}"/>')


def set_phase(editor: SceneEditor, xml: str) -> None:
    """Put ``<phase>`` into the crystal's medium, or refuse one that has its own."""
    if (part := editor.crystal.find("phase")) is not None:
        problem = f"the crystal has the phase function {part.type} already"
        raise editor.refusal(problem, "there can be only one: remove it first", part)
    editor.insert_last(editor.crystal, xml)


def set_detector(editor: SceneEditor, name: str, value: str, *, sends_back: bool = False) -> None:
    """Put ``<float>`` into every ``photodetector``, or refuse one that has it.

    What the text calls a black detector is called so no longer where it `sends_back` light.
    """
    set_part(editor, editor.detectors, name, f'<float name="{name}" value="{value}"/>')
    for shape in editor.shapes if sends_back else ():
        if any(part in editor.detectors for part in shape.iter()):
            editor.reword(shape, "window, black", "window")


def set_masks(editor: SceneEditor, name: str, xml: str, *, detectors: bool = False) -> None:
    """Put a property into every mask, perhaps detectors too; refuse one that has it, or no mask."""
    if not editor.masks:
        raise editor.refusal("the scene has no mask", "let the window wear an aperture")
    set_part(editor, [*editor.masks, *(editor.detectors if detectors else ())], name, xml)


def set_part(editor: SceneEditor, bsdfs: Iterable[Node], name: str, xml: str) -> None:
    """Put a property of a name into detectors, masks or wrappings, or refuse one that has it."""
    for bsdf in bsdfs:
        part = bsdf.named(name)
        if part is not None:
            what = {"photodetector": "detector", "aperture": "mask"}.get(bsdf.type, bsdf.type)
            problem = f"the {what} has its {name} already"
            raise editor.refusal(problem, "change this number instead", part)
        numbers = [part for part in bsdf.elements if "name" in part.attrib]
        if numbers:
            editor.insert_after(numbers[-1], xml)
        else:
            editor.insert_first(bsdf, xml)


def wavelength_of(editor: SceneEditor) -> str:
    """The wavelength as the scene's parameter, which is declared if the scene has none."""
    if WAVELENGTH not in editor.scene.parameters:
        editor.declare(WAVELENGTH, 540.0, "Wavelength of the light in vacuum, nm")
    return f"${WAVELENGTH}"


def polish(editor: SceneEditor, bsdf: Node, name: str, value: str) -> None:
    """Give a ``dielectric``, or ``polish``, one more number; refuse what ``polish`` cannot say."""
    for index in INDICES:
        if bsdf.find(f"float[@name='{index}']") is None:
            problem = f"{bsdf.label} gives no number for {index}"
            raise editor.refusal(problem, f'write <float name="{index}" value="..."/>', bsdf)
    for part in bsdf.elements:
        if part.get("name") not in INDICES + _FURTHER:
            what = f"{bsdf.label} has {part.get('name', part.tag)}"
            problem = f"{what}, which an interface with real polish has not"
            raise editor.refusal(problem, "remove it", part)
    if bsdf.type == "dielectric":
        editor.set_attribute(bsdf, "type", "polish")
    editor.insert_last(bsdf, f'<float name="{name}" value="{value}"/>')


def polish_crystal(editor: SceneEditor, name: str, value: str) -> None:
    """Give all faces of the crystal one more number, as of `polish`."""
    for bsdf in editor.crystal_polish:
        polish(editor, bsdf, name, value)


def roughen(editor: SceneEditor, side: str, alpha: str) -> None:
    """Give the crystal's ``top``, ``bottom`` or ``side`` faces GGX facets of a scene's `alpha`."""
    if WIDTH in editor.scene.parameters:
        # which may stand in a beam, without a gap
        box = crystal_box(editor, (WIDTH, HEIGHT))
        names = [side] if side in box else ["right", "left", "back", "front"]
        faces = [face for name in names for face in box[name]]
    else:
        faces = _faces_of_any_form(editor, side)
    copies: dict[Node, str] = {}
    for face in faces:
        bsdf = editor.bsdf(face)
        if bsdf is None or bsdf not in editor.crystal_polish or "id" not in bsdf.attrib:
            problem = f"{face.label} does not wear a dielectric with an id"
            raise editor.refusal(problem, "only faces of plain polish can be changed", face)
        if bsdf not in copies:
            copies[bsdf] = rough_copy(editor, bsdf, side, f"${alpha}")
        for ref in face.elements:
            if ref.tag == "ref" and editor.by_id.get(ref.attrib["id"]) is bsdf:
                editor.set_attribute(ref, "id", copies[bsdf])
    for bsdf in copies:
        # what no face wears any more
        if all(shape in faces or editor.bsdf(shape) is not bsdf for shape in editor.shapes):
            editor.remove(bsdf)


def _faces_of_any_form(editor: SceneEditor, side: str) -> list[Node]:
    """Faces of a crystal that is no box: those at the gap, flat ones that look up, or the rest."""
    faces = []
    resolved = editor.resolved()
    for face in editor.crystal_faces:
        if editor.gap in editor.media(face):
            where = "bottom"
        else:
            matrix = _matrix(resolved[face])
            flat = face.type in (*_FLAT, "disk", "polygon") and matrix is not None
            up = np.cross(matrix[:3, 0], matrix[:3, 1]) if flat and matrix is not None else None
            looks_up = up is not None and up[2] > (1.0 - _TOLERANCE_MM) * np.linalg.norm(up)
            where = "top" if looks_up else "side"
        if where == side:
            faces.append(face)
    if not faces:
        problem = f"the crystal has no {side} face of its own"
        raise editor.refusal(problem, "use surface_roughness or ground: they are of all faces")
    return faces


def rough_copy(editor: SceneEditor, bsdf: Node, side: str, alpha: str) -> str:
    """Id of a copy of an interface, put beside it, with the facets of a side of the crystal."""
    name = f"{bsdf.attrib['id']}_{side}"
    editor.refuse_id(name)
    kept = (part for part in bsdf.elements if part.get("name") != "roughness_alpha")
    parts = [editor.source(part) for part in kept]
    parts.append(f'<float name="roughness_alpha" value="{alpha}"/>')
    editor.insert_after(bsdf, element(f'bsdf type="polish" id="{name}"', parts))
    return name


# The bench as a box on a plate: its faces, found by where they lie.
#
# Effects that change the geometry (bubbles, chamfers, another gap) are written for this form.
# That a face lies where it should is judged at two sets of parameters, so it also follows them.


def refuse_without_box(editor: SceneEditor, sizes: Iterable[str] = _STRETCH) -> None:
    """Refuse a scene that does not name the sizes of a box and of its gap."""
    for name in sizes:
        if not isinstance(editor.scene.parameters.get(name), float):
            raise editor.refusal(f"the scene has no parameter {name}", _FORM)


def crystal_box(editor: SceneEditor, sizes: Iterable[str] = _STRETCH) -> dict[str, list[Node]]:
    """The crystal's faces: ``top``, ``bottom``, ``right``, ``left``, ``back``, ``front``.

    Two of a face where one is a bubble's; chamfers are left out. A crystal that is not a box of
    rectangles on z = 0 is refused, and a scene that does not name these sizes.
    """
    refuse_without_box(editor, sizes)
    flat = [face for face in editor.crystal_faces if face.type != "chamfers"]
    faces = _sides(editor, flat, "crystal", lambda p: (0.0, float(p[HEIGHT])))
    for face in faces["bottom"]:
        if editor.media(face)[0] is not editor.crystal or not _own_x_is_right(editor, face):
            problem = f"{face.label} is turned around"
            raise editor.refusal(problem, "write it as in scenes/camoo4.xml", face)
    return faces


def gap_sides(editor: SceneEditor) -> list[Node]:
    """The four sides of the gap, which must be rectangles, or the one shape that is all four."""
    borders = [s for s in editor.shapes if editor.media(s) == (editor.gap, None)]
    borders = [shape for shape in borders if shape.type != "round_wall"]
    whole = [shape for shape in borders if shape.type == "gap_sides"]
    if whole:
        return whole
    refuse_without_box(editor)
    faces = _sides(
        editor,
        [shape for shape in borders if shape.type != "frame"],
        "gap",
        lambda p: (-float(p[GAP]), 0.0),
        ("right", "left", "back", "front"),
    )
    return [face for side in faces.values() for face in side]


def window_under_gap(editor: SceneEditor) -> Node:
    """The part of the window's entrance face that the gap touches: a rectangle, or refused."""
    borders = [s for s in editor.shapes if editor.media(s) == (editor.window, editor.gap)]
    if len(borders) != 1 or borders[0].type not in _FLAT:
        problem = f"{len(borders)} faces lie between window and gap"
        raise editor.refusal(problem, "write it as one rectangle", editor.gap)
    for parameters, resolved in _two_states(editor):
        corners = _corners(resolved[borders[0]])
        half = float(parameters[WIDTH]) / 2
        if corners is None or not (
            np.allclose(np.abs(corners[:, :2]), half, atol=_TOLERANCE_MM)
            and np.ptp(corners[:, 2]) < _TOLERANCE_MM
            and _own_x_is_right(editor, borders[0])
        ):
            problem = f"{borders[0].label} does not lie under the whole crystal"
            raise editor.refusal(problem, "write it as in scenes/camoo4.xml", borders[0])
    return borders[0]


def change_gap_sides(editor: SceneEditor, numbers: str) -> None:
    """Give the gap's sides further ``<float .../>``; four rectangles become one shape for that."""
    for wall in editor.all("shape", "round_wall"):
        add_numbers(editor, wall, numbers)
    first, *others = gap_sides(editor)
    if first.type == "gap_sides":
        add_numbers(editor, first, numbers)
        return
    if any(editor.bsdf(other) is not editor.bsdf(first) for other in others):
        raise editor.refusal("the gap's sides differ in their bsdf", "let all wear one", first)
    editor.refuse_id("gap_sides")
    parts = [
        f'<float name="width" value="${WIDTH}"/>',
        f'<float name="thickness" value="${GAP}"/>',
        numbers,
        worn_towards_air(editor, [first], "the gap's sides"),
        f'<ref name="interior" id="{editor.gap.attrib["id"]}"/>',
    ]
    editor.replace(first, element('shape type="gap_sides" id="gap_sides"', parts))
    for other in others:
        editor.remove(other)


def add_numbers(editor: SceneEditor, shape: Node, numbers: str) -> None:
    """Give a shape further numbers, behind those that it has."""
    properties = [part for part in shape.elements if part.tag in ("float", "string")]
    if properties:
        editor.insert_after(properties[-1], numbers)
    else:
        editor.insert_first(shape, numbers)


def make_panel(editor: SceneEditor, face: Node, numbers: str) -> None:
    """Make a rectangle a ``panel``, of which parts can be left out."""
    if face.type != "panel":
        editor.set_attribute(face, "type", "panel")
    add_numbers(editor, face, numbers)


def part_gap(editor: SceneEditor, cut: str, liquid: str, air: str) -> None:
    """Part the faces above and below the gap where a bubble of air is in it.

    `cut` is the number that tells a ``panel`` where, `liquid` and `air` which part each keeps.
    """
    box = crystal_box(editor)
    (bottom,) = box["bottom"]
    under = window_under_gap(editor)
    sides = [face for name, faces in box.items() if name != "bottom" for face in faces]
    to_air = worn_towards_air(editor, sides, "the crystal's other faces")
    other = editor.by_id[to_air.split('"')[1]]
    # what is rough under the liquid, or not, is so under the bubble, whatever the other faces are
    own, others = (
        "0"
        if bsdf is None or (alpha := bsdf.named("roughness_alpha")) is None
        else alpha.attrib["value"]
        for bsdf in (editor.bsdf(bottom), other)
    )
    if own != others:
        to_air = f'<ref id="{rough_copy(editor, other, "bottom", own)}"/>'
    beside = [s for s in editor.shapes if s.type == "frame" and editor.window in editor.media(s)]
    window_to_air = worn_towards_air(editor, beside, "the window's entrance face")
    for face, name, bsdf, interior in (
        (bottom, "crystal_bottom_bubble", to_air, editor.crystal),
        (under, "window_under_bubble", window_to_air, editor.window),
    ):
        numbers = f'{cut}\n<string name="keep" value="{{}}"/>\n{INDEX_OF_PART}'
        worn = bsdf, f'<ref name="interior" id="{interior.attrib["id"]}"/>'
        comment = "<!-- the part of it that lies on the air bubble -->\n"
        split_panel(editor, face, name, numbers, (liquid, air), worn, comment)


def split_panel(
    editor: SceneEditor,
    face: Node,
    name: str,
    numbers: str,
    kept: tuple[str, str],
    worn: Iterable[str],
    comment: str = "",
) -> None:
    """Leave a part out of a rectangle, and make it a face of its own after it.

    `numbers` of a ``panel`` tell where, with ``{}`` for which part each of the two keeps; the new
    one wears and borders what is `worn`.
    """
    editor.refuse_id(name)
    make_panel(editor, face, numbers.format(kept[0]))
    trim, transform = face.named("trim"), face.named("to_world")
    assert transform is not None  # the face was found by it
    parts = [numbers.format(kept[1]), editor.source(transform), *worn]
    parts = parts if trim is None else [editor.source(trim), *parts]
    editor.insert_after(face, comment + element(f'shape type="panel" id="{name}"', parts))


def worn_towards_air(editor: SceneEditor, shapes: list[Node], what: str) -> str:
    """``<ref>`` to the smoothest bsdf that faces with nothing in front of them wear, with an id."""
    worn = [editor.bsdf(s) for s in shapes if editor.medium(s, "exterior") is None]
    named = [b for b in worn if b is not None and "id" in b.attrib and b.getparent() is editor.root]
    if not named:
        problem = f"no bsdf with an id is worn by {what} towards air"
        raise editor.refusal(problem, "give it an id at the top level")
    # roughness of some faces is theirs alone
    chosen = min(named, key=lambda bsdf: bsdf.named("roughness_alpha") is not None)
    return f'<ref id="{chosen.attrib["id"]}"/>'


def _sides(
    editor: SceneEditor,
    shapes: list[Node],
    what: str,
    z_range: Callable[[Mapping[str, Value]], tuple[float, float]],
    names: Iterable[str] = tuple(_AXES),
) -> dict[str, list[Node]]:
    """Shapes by the side of a box that they cover."""
    states = [(z_range(parameters), parameters, at) for parameters, at in _two_states(editor)]
    sides: dict[str, list[Node]] = {name: [] for name in names}
    for shape in shapes:
        covered, stretched = (
            _covered(at[shape], names, float(parameters[WIDTH]) / 2, *z)
            for z, parameters, at in states
        )
        side = covered & stretched if shape.type in _FLAT else None
        if not side:
            problem = f"{shape.label} is no rectangular face of the {what}, {WIDTH} wide"
            raise editor.refusal(f"{problem}, that follows the parameters", _FORM, shape)
        sides[side.pop()].append(shape)
    for name, faces in sides.items():
        if not faces:
            raise editor.refusal(f"the {what} has no face on its {name}", _FORM)
    return sides


def _covered(shape: Node, names: Iterable[str], half: float, low: float, high: float) -> set[str]:
    """Which sides of the box a rectangle covers, its normal outwards: one, or none."""
    corners = _corners(shape)
    if corners is None:
        return set()
    covered = set()
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    for name in names:
        axis, sign = _AXES[name]
        ranges: list[tuple[float, ...]] = [(-half, half), (-half, half), (low, high)]
        ranges[axis] = (ranges[axis][(sign + 1) // 2],)
        wanted = np.array(list(itertools.product(*ranges)))
        nearest = np.abs(corners[:, None] - wanted[None]).max(axis=2).min(axis=0)
        if np.all(nearest < _TOLERANCE_MM) and normal[axis] * sign > 0:
            covered.add(name)
    return covered


def _two_states(editor: SceneEditor) -> Iterator[tuple[dict[str, Value], dict[Node, Node]]]:
    """Parameters and elements of the scene, and the same with everything stretched."""
    as_written = editor.scene.parameters
    stretched: dict[str, Value] = {
        name: float(as_written[name]) * factor
        for name, factor in _STRETCH.items()
        if name in as_written
    }
    with said_by(editor.refusal):
        yield as_written, editor.resolved({})
        yield {**as_written, **stretched}, editor.resolved(stretched)


def _own_x_is_right(editor: SceneEditor, node: Node) -> bool:
    """Whether a rectangle's own x axis is the bench's, and not turned away from it."""
    corners = _corners(editor.resolved()[node])
    if corners is None:
        return False
    along = corners[1] - corners[0]
    return bool(along[0] > 0.5 * np.linalg.norm(along))


def _corners(shape: Node) -> np.ndarray | None:
    """Corners (4, 3) of a rectangle, mm, against the clock seen from its front."""
    matrix = _matrix(shape)
    if matrix is None:
        return None
    corners = np.array([(-1, -1, 0, 1), (1, -1, 0, 1), (1, 1, 0, 1), (-1, 1, 0, 1)], dtype=float)
    return (corners @ matrix.T)[:, :3]


def _matrix(shape: Node) -> np.ndarray | None:
    """A shape's ``to_world``, (4, 4); None if that is of another kind, or not finite."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = transform_matrix(shape.named("to_world"))
    except ValueError:
        return None
    return matrix if np.isfinite(matrix).all() else None
