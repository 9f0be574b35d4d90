"""Effect ``edge_chamfer``: the crystal's edges are bevelled."""

from collections.abc import Mapping

from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.effects._bench import crystal_box, gap_sides, make_panel, worn_towards_air
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor

#: Largest leg, as a part of the shortest edge.
_LARGEST_PART = 0.48
_TRIM = '<float name="trim" value="$chamfer_mm"/>'


def edit(editor: SceneEditor) -> None:
    """Cut the twelve edges of the crystal, with faces of their own."""
    for name in ("crystal_chamfers", "gap_top_rim"):
        editor.refuse_id(name)
    scene, leg_mm = editor.scene.parameters, editor.values["chamfer_mm"]
    box = crystal_box(editor)
    smallest_mm = min(float(scene["crystal_width_mm"]), float(scene["crystal_height_mm"]))
    if not 2 * leg_mm < smallest_mm:
        problem = f"a chamfer of {leg_mm:g} mm leaves nothing of a crystal of {smallest_mm:g} mm"
        raise editor.refusal(problem, "twice the leg must stay below width and height")
    faces = [face for faces in box.values() for face in faces]
    outer = [face for name, faces in box.items() if name != "bottom" for face in faces]
    crystal_to_air = worn_towards_air(editor, outer, "the crystal's other faces")
    sides = gap_sides(editor)
    gap_to_air = worn_towards_air(editor, sides, "the gap's sides")
    for face in faces:
        make_panel(editor, face, _TRIM)
    bubble = [part for name in ("cut", "index") if (part := sides[0].named(name)) is not None]
    rim = "".join(f"\n  {editor.source(part)}" for part in bubble)
    editor.insert_after(
        max(faces, key=lambda face: face.start),
        f"""<!-- The twelve bevelled edges -->
<shape type="chamfers" id="crystal_chamfers">
  <float name="width" value="$crystal_width_mm"/>
  <float name="height" value="$crystal_height_mm"/>
  <float name="leg" value="$chamfer_mm"/>
  {crystal_to_air}
  <ref name="interior" id="{editor.crystal.attributes["id"]}"/>
</shape>

<!-- The rim of the gap that the crystal no longer covers -->
<shape type="frame" id="gap_top_rim">
  <float name="outer_width" value="$crystal_width_mm"/>
  <float name="rim" value="$chamfer_mm"/>{rim}
  {gap_to_air}
  <ref name="interior" id="{editor.gap.attributes["id"]}"/>
</shape>""",
    )


def limits(parameters: Mapping[str, Value]) -> tuple[float, float]:
    """Twice the leg stays below width and height, and something of the faces is left."""
    sides = (float(parameters[f"crystal_{side}_mm"]) for side in ("width", "height"))
    return 0.0, _LARGEST_PART * min(sides)


EFFECT = Effect(
    name="edge_chamfer",
    title="bevel of the edges",
    family="surface",
    look=("Look at the edges with a loupe, and measure the bevel on a photograph with a scale."),
    physics=(
        "In a perfect box light beyond the critical angle of all faces is trapped for ever. "
        "Edges are bevelled against chipping: polished faces at 45 degrees turn such light into "
        "directions that leave, at the edges. The gap keeps its footprint, and its rim that the "
        "crystal no longer covers borders air."
    ),
    source="G. F. Knoll, Radiation Detection and Measurement, 4th ed., Wiley 2010, chapter 8",
    parameters=(
        EffectParameter(
            name="chamfer_mm",
            unit="mm",
            meaning="Leg of the chamfers at the crystal's edges",
            minimum=0.0,
            maximum=1.0,
            start=0.2,
            absent=0.0,
            plausible=(0.0, 0.5),
            nodes=(0.12, 0.3, 0.6, 1.0),
            limits=limits,
        ),
    ),
    excludes=("gap_bubble_round",),
    edit=edit,
)
