"""The crystal of a bench in the beam of a spectrophotometer, derived from the bench's scene.

What a transmittance says, it says of the crystal that also stood on the bench: its faces with
their polish, its medium, whatever effects changed in them. So the scene of the beam is the bench's
without all that is not the crystal, and with beam and detector in place of scintillation and
photomultiplier. ``scenes/spectrophotometer.xml`` is the same for people to read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np
from lxml import etree

from mcrim_mitsuba.core.numbers import COUNTED, Value
from mcrim_mitsuba.scene.check_text import indices_of, is_filled
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.xml_tree import transform_matrix

BEAM_DIAMETER = "beam_diameter_mm"
BEAM_AXIS = "beam_axis"
ACCEPTANCE = "acceptance_deg"
#: Parameters of the scene that the bench does not have, with usual values.
BEAM_PARAMETERS: dict[str, Value] = {BEAM_DIAMETER: 3.0, BEAM_AXIS: "x", ACCEPTANCE: 5.0}
_MEANINGS = {
    BEAM_DIAMETER: "Diameter of the beam, mm",
    BEAM_AXIS: "Axis that the beam flies along: x, y or z",
    ACCEPTANCE: "Largest angle to the beam that the detector takes, degrees",
}
#: The bench's index beside the crystal's lower face: in the beam there is air.
GAP_INDEX = "n_gap"
_SIZES = ("crystal_width_mm", "crystal_height_mm")
_PARAMETER = re.compile(r"\$(\w+)")
_BEAM = f"""<emitter type="collimated_beam">
  <ref id="{{crystal}}"/>
  <float name="diameter" value="${BEAM_DIAMETER}"/>
  <string name="axis" value="${BEAM_AXIS}"/>
</emitter>"""
_DETECTOR = f"""<shape type="beam_detector" id="beam_detector">
  <float name="width" value="$crystal_width_mm"/>
  <float name="height" value="$crystal_height_mm"/>
  <string name="axis" value="${BEAM_AXIS}"/>
  <bsdf type="photodetector">
    <float name="acceptance_deg" value="${ACCEPTANCE}"/>
  </bsdf>
</shape>"""


def refused_of_beam(name: str, value: Value) -> tuple[str, str] | None:
    """What is wrong with a beam's parameter, and how to mend it; None where nothing is."""
    if name == BEAM_AXIS and value not in ("x", "y", "z"):
        return f"{name} = {value} is no axis", "give x, y or z"
    if name == ACCEPTANCE and not 0.0 < float(value) <= 90.0:
        return (
            f"{name} = {float(value):g} is no half angle",
            "give degrees: 1 to 7 in most instruments, 90 for an integrating sphere",
        )
    if name == BEAM_DIAMETER and not float(value) > 0.0:
        return f"{name} = {float(value):g} is not above 0", "give the beam's width in mm"
    return None


def too_wide(values: Mapping[str, Value]) -> tuple[str, str] | None:
    """What is wrong with a beam beside the crystal's sizes, as `refused_of_beam`."""
    diameter, width, height = (float(values[name]) for name in (BEAM_DIAMETER, *_SIZES))
    across = width if values[BEAM_AXIS] == "z" else min(width, height)
    if diameter < across:
        return None
    return (
        f"the beam is {diameter:g} mm wide, and the crystal across it {across:g} mm",
        f"give {BEAM_DIAMETER} in [beam] below that: what misses the crystal would count as "
        "transmitted",
    )


def spectrophotometer_of(bench: SceneFile) -> SceneFile:
    """The scene of a beam through a bench's crystal, in air.

    The crystal is a box on z = 0 with its sizes as parameters ``crystal_width_mm`` and
    ``crystal_height_mm``. The scene has the bench's parameters and those of `BEAM_PARAMETERS`; that
    of a bench which is a beam's scene already is itself.

    Raises InputError if the bench does not name the sizes, or if a face of the crystal would still
    touch a liquid.
    """
    editor = SceneEditor(bench, {})
    if editor.all("emitter", "collimated_beam"):
        return bench
    for name in _SIZES:
        if not isinstance(bench.parameters.get(name), float):
            mend = "a transmittance needs the crystal's sizes as parameters of its bench"
            raise editor.refusal(f"the scene has no parameter {name}", mend)
    crystal, faces = editor.crystal, editor.crystal_faces
    for face in faces:
        for side in ("interior", "exterior"):
            if editor.medium(face, side) not in (None, crystal):
                named = face.named(side)
                assert named is not None
                editor.remove(named)
    worn = (bsdf for face in faces for bsdf in editor.worn_by(face))
    kept = {crystal, editor.emitter, *faces, *worn}
    others = [node for node in editor.root.elements if node.tag in ("bsdf", "medium", "shape")]
    others = [node for node in others if node not in kept]
    # the beam has one detector
    others += [c for i in editor.root.iter("integrator") if (c := i.named(COUNTED)) is not None]
    gone = {inner for node in (*others, editor.emitter) for inner in node.iter()}
    remaining = (node for node in editor.root.iter(etree.Element) if node not in gone)
    words = (word for node in remaining for word in node.attrib.values())
    used = {*_SIZES, *(name for word in words for name in _PARAMETER.findall(word))}
    unused = [name for name in bench.defaults if name not in used]
    for node in (*others, *map(editor.default, unused)):
        editor.remove(node)
    editor.replace(editor.emitter, _BEAM.format(crystal=crystal.attrib["id"]))
    editor.insert_last(editor.root, _DETECTOR)
    for name, value in BEAM_PARAMETERS.items():
        assert not isinstance(value, bool)
        editor.declare(name, value, _MEANINGS[name])
    derived = bench.edited(editor.finished(), without=unused)
    if GAP_INDEX in derived.parameters:
        derived = derived.with_overrides({GAP_INDEX: 1.0})
    for shape in derived.parts.shapes:
        indices = indices_of(derived, shape)
        if indices is not None and is_filled(min(indices)):
            problem = f"{shape.get('id')} touches an index of {min(indices):g} in the beam, too"
            mend = f"name the liquid's index as a parameter {GAP_INDEX}, which is that of air there"
            raise editor.refusal(problem, mend)
    return derived


def polished_slab(scene: SceneFile) -> tuple[float, float] | None:
    """Index of a crystal and its length along the beam, mm, as its faces have them.

    None where `optics.slab_transmittance.measured_transmittance` does not hold: faces of no plain
    polish or of no box, several indices, a medium that scatters to some sides more than to others.
    """
    faces = [shape for shape in scene.parts.shapes if shape.get("type") != "beam_detector"]
    worn = [scene.parts.bsdf(face) for face in faces]
    indices = {max(indices_of(scene, face) or (math.nan,)) for face in faces}
    even = all(medium.find("phase") is None for medium in scene.root.iter("medium"))
    plain = all(bsdf is not None and bsdf.get("type") == "dielectric" for bsdf in worn)
    rectangles = all(face.get("type") == "rectangle" for face in faces)
    graded = any(e.get("name") == "scattering_gradient" for e in scene.root.iter("float"))
    if not (even and plain and rectangles) or graded or len(indices) != 1:
        return None
    (n,), axis = indices, "xyz".index(str(scene.parameters[BEAM_AXIS]))
    matrices = np.array([transform_matrix(face.named("to_world")) for face in faces])
    normals = np.abs(matrices[:, :3, 2])
    upright = normals.max(axis=1) > (1.0 - 1e-9) * np.linalg.norm(normals, axis=1)
    if math.isnan(n) or not upright.all():
        return None
    return n, float(np.ptp(matrices[normals.argmax(axis=1) == axis, axis, 3]))


def scattered_share(n: float, acceptance_deg: float) -> float:
    """Part of once scattered light that a detector behind a `polished_slab` of index n takes.

    By it the closed form of the transmittance, in which all scattered light is lost, is too low,
    for each mean free path in the crystal.
    """
    return 0.5 * (1.0 - math.sqrt(1.0 - (math.sin(math.radians(acceptance_deg)) / n) ** 2))
