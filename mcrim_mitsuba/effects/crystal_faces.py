"""Effects of the crystal's faces and edges: rough, ground, hazy, absorbing, bevelled."""

from __future__ import annotations

from functools import partial

import numpy as np

from mcrim_mitsuba.effects import scene_edits
from mcrim_mitsuba.effects.effect import (
    Columns,
    Effect,
    EffectParameter,
    Parameters,
    Values,
    one_parameter,
)
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Of rough faces.
FACETS = (
    "E. Heitz, J. Hanika, E. d'Eon and C. Dachsbacher, ACM Trans. Graph. 35 (2016) 58; B. Walter, "
    "S. R. Marschner, H. Li and K. E. Torrance, Eurographics Symposium on Rendering 2007, 195"
)
#: Of what takes light.
_LEVIN = (
    "A. Levin and C. Moisan, IEEE Nuclear Science Symposium Conference Record 1996, vol. 2, 702"
)

#: Alpha up to which a face may still be called polished.
POLISHED = 0.05
#: Sides of the crystal, as of `roughen`, in words.
_SIDES = {"top": "top face", "side": "side faces", "bottom": "bottom face"}
_ROUGH = tuple(f"{side}_roughness" for side in _SIDES)
_GROUND = tuple(f"ground_{side}" for side in _SIDES)


def facets_of(
    name: str, what: str, *, ground: bool, start: float = 0.1, most: float = 0.5
) -> tuple[EffectParameter]:
    """Width of facets of faces, `what`: ground, or of a polish, fitted from `start` to `most`."""
    kind = ", ground and not polished" if ground else ""
    meaning = f"Roughness of the crystal's {what}{kind} (GGX), the tangent of a typical tilt"
    if ground:
        return one_parameter(
            name=name,
            meaning=meaning,
            minimum=0.1,
            maximum=0.6,
            start=0.25,
            # a face is ground or it is not
            absent=None,
            off=0.0,
            plausible=(0.1, 0.6),
            nodes=(0.1, 0.16, 0.25, 0.4, 0.6),
        )
    return one_parameter(
        name=name,
        meaning=meaning,
        maximum=most,
        start=start,
        plausible=(0.0, POLISHED),
        nodes=tuple(node for node in (0.012, 0.035, 0.08, 0.16, 0.3, 0.5) if node <= most),
        # trapped light meets many facets: it is freed by small slopes already
        coordinate="logarithmic",
        scale=0.03,
    )


def one_side(side: str, *, ground: bool, look: str, physics: str) -> Effect:
    """An effect: one of `_SIDES` of the crystal is rough, or ground."""
    rough, dull, what = f"{side}_roughness", f"ground_{side}", _SIDES[side]
    name, other = (dull, rough) if ground else (rough, dull)
    return Effect(
        name=name,
        title=f"ground {what}" if ground else f"roughness of the {what}",
        family="surface",
        look=look,
        physics=physics,
        source=FACETS,
        parameters=facets_of(f"{name}_alpha", what, ground=ground),
        excludes=("surface_roughness", "ground", other),
        edit=partial(scene_edits.roughen, side=side, alpha=f"{name}_alpha"),
    )


SURFACE_ROUGHNESS = Effect(
    name="surface_roughness",
    title="roughness of all crystal faces",
    family="surface",
    look=(
        "Look at the reflection of a lamp in each face: it is blurred if the face is rough. "
        "Measure the transmittance within 1 and within 30 degrees."
    ),
    physics=(
        "A face that was ground but poorly polished is made of small facets with tilted normals; "
        "light meets one of them and is reflected or refracted there by Fresnel's formulas. The "
        "tilts (GGX distribution, width alpha, the tangent of a typical tilt) let trapped light "
        "out after some reflections. It goes from facet to facet until it leaves the face, to the "
        "front or to the back (Smith's field of heights): nothing is lost there. A polished face "
        "has alpha of 0.05 at most: see ground."
    ),
    source=FACETS,
    parameters=facets_of("roughness_alpha", "faces", ground=False, start=0.05, most=0.3),
    excludes=(*_ROUGH, "ground", *_GROUND),
    edit=partial(scene_edits.polish_crystal, name="roughness_alpha", value="$roughness_alpha"),
)


def edit_surface_haze(editor: SceneEditor) -> None:
    """Give all faces of the crystal a fine roughness."""
    wavelength = scene_edits.wavelength_of(editor)
    scene_edits.polish_crystal(editor, "rms_roughness_nm", "$rms_roughness_nm")
    for bsdf in editor.crystal_polish:
        editor.insert_last(bsdf, f'<float name="{scene_edits.WAVELENGTH}" value="{wavelength}"/>')


SURFACE_HAZE = Effect(
    name="surface_haze",
    title="haze of the crystal's faces",
    family="surface",
    look=(
        "Shine a laser pointer at a face in the dark: on a hazy face the spot is seen from all "
        "sides. Polish again and measure again."
    ),
    physics=(
        "A polished face keeps heights of some nanometres. They are too fine for slopes to "
        "matter, but shift the phase of the wave: the part S = 1 - exp(-q^2) of what Fresnel "
        "reflects or refracts is scattered, with q = 4 pi s n cos(theta) / lambda in reflection "
        "and 2 pi s |n cos(theta) - n' cos(theta')| / lambda in refraction. It goes to other "
        "directions of the same side, in proportion to the cosine, to S and to what would be "
        "reflected, or refracted, of light from there: each way is as likely as its reverse. So "
        "scatter heights that have no memory beyond a wavelength. Longer ones scatter close to "
        "the reflected ray, and free nothing; light scattered under total reflection may also "
        "leave at once, which it does not here: the height that is fitted is one 'as if'. lambda "
        "is the scene's wavelength_nm, 540 nm unless another is given."
    ),
    source="H. E. Bennett and J. O. Porteus, J. Opt. Soc. Am. 51 (1961) 123",
    parameters=one_parameter(
        name="rms_roughness_nm",
        meaning="Rms height of the fine roughness of the crystal's faces",
        maximum=30.0,
        start=5.0,
        plausible=(0.0, 20.0),
        nodes=(2.0, 5.0, 9.0, 15.0, 22.0, 30.0),
        coordinate="logarithmic",
        scale=5.0,
    ),
    edit=edit_surface_haze,
)


TOP_ROUGHNESS = one_side(
    "top",
    ground=False,
    look=(
        "Look at the reflection of a lamp in the top face. Put a drop of oil on it: the readings "
        "change if it is rough."
    ),
    physics=(
        "The face opposite the detector is often polished last and least, since nobody looks "
        "through it. A polished face has alpha of 0.05 at most: see ground_top. It is one of "
        "facets with tilted normals (GGX, width alpha), as in surface_roughness, and the other "
        "faces are polished."
    ),
)


SIDE_ROUGHNESS = one_side(
    "side",
    ground=False,
    look=(
        "Look at the reflection of a lamp in the sides, and measure the transmittance through "
        "them: roughness costs the beam most."
    ),
    physics=(
        "The four sides of a crystal are often polished less than the faces through which light "
        "is meant to leave; beyond 0.05 they are ground: see ground_side. It is one of facets "
        "with tilted normals (GGX, width alpha), as in surface_roughness, and the other faces are "
        "polished."
    ),
)


BOTTOM_ROUGHNESS = one_side(
    "bottom",
    ground=False,
    look=(
        "Take the crystal off and look at the reflection of a lamp in its bottom face: "
        "mounting scratches it. Turn the crystal over and measure again."
    ),
    physics=(
        "The face before the detector is scratched when crystals are mounted, turned and wiped; "
        "where a gel covers it, its roughness is nearly matched. It is one of facets with tilted "
        "normals (GGX, width alpha), as in surface_roughness, and the other faces are polished."
    ),
)


GROUND = Effect(
    name="ground",
    title="ground faces",
    family="surface",
    look=(
        "Look at the faces with a loupe: a ground face is dull, and shows no reflection of a "
        "lamp. Ask the maker which faces were polished."
    ),
    physics=(
        "A face that was cut or ground and never polished consists of facets that are tilted by "
        "tens of degrees (GGX, width alpha); light goes from one to the other until it leaves, to "
        "the front or to the back. Of trapped light such a face lets out a part each time. Facets "
        "of alpha 0.1 to 0.6 are ground; less is a poor polish: see surface_roughness."
    ),
    source=FACETS,
    parameters=facets_of("ground_alpha", "faces", ground=True),
    excludes=("surface_roughness", *_ROUGH, *_GROUND),
    edit=partial(scene_edits.polish_crystal, name="roughness_alpha", value="$ground_alpha"),
)


GROUND_TOP = one_side(
    "top",
    ground=True,
    look=(
        "Look at the top face with a loupe: if it is ground it is dull. Put a drop of oil on it: "
        "the readings change."
    ),
    physics=(
        "The face opposite the detector is often left as it was cut, since nobody looks through "
        "it: facets that are tilted by tens of degrees (GGX, width alpha), as in ground, on this "
        "face alone."
    ),
)


GROUND_SIDE = one_side(
    "side",
    ground=True,
    look=(
        "Look at the sides with a loupe: if they are ground they are dull, and nothing is seen "
        "through them."
    ),
    physics=(
        "The four sides are often ground, on purpose or to save work, while the faces at the ends "
        "are polished: facets that are tilted by tens of degrees (GGX, width alpha), as in ground, "
        "on the sides alone."
    ),
)


GROUND_BOTTOM = one_side(
    "bottom",
    ground=True,
    look=(
        "Take the crystal off and look at its bottom face with a loupe: a ground one is dull, "
        "and clear only while a liquid covers it."
    ),
    physics=(
        "The crystal may stand on a face that was cut and not polished: facets that are tilted by "
        "tens of degrees (GGX, width alpha), as in ground, on this face alone. A liquid nearly "
        "matches them, air does not: such a face changes the ratio of the readings most."
    ),
)


def edit_loss(editor: SceneEditor, name: str) -> None:
    """Let all faces of the crystal lose light that comes from inside, or part of them of it."""
    for face in editor.crystal_faces:
        if editor.medium(face, "interior") is not editor.crystal:
            problem = f"the crystal is in front of {face.label}, not behind it"
            mend = "turn the face around: the loss acts on light that comes from behind"
            raise editor.refusal(problem, mend, face)
    scene_edits.polish_crystal(editor, name, f"${name}")


def weight_loss(
    columns: Columns, values: Values, parameters: Parameters, *, name: str, column: str
) -> np.ndarray:
    """(1 - loss) to the power of a column: how often light met what takes it."""
    return (1.0 - values[name]) ** columns[column].astype(np.float64)


SURFACE_ABSORPTION = Effect(
    name="surface_absorption",
    title="absorbing crystal surface",
    family="surface",
    look=(
        "Clean and polish the crystal again and measure again; under a microscope a damaged "
        "layer looks dull."
    ),
    physics=(
        "Polishing leaves a damaged, contaminated layer that absorbs: light is lost each time a "
        "face reflects it back into the crystal, partially or totally. Trapped light, which is "
        "reflected tens of times, suffers most. Simulations of scintillation counters have long "
        "described this by a reflection coefficient of the surface below 1."
    ),
    source=_LEVIN,
    parameters=one_parameter(
        name="surface_loss",
        meaning="Fraction lost at every internal reflection at a face of the crystal",
        maximum=0.05,
        start=0.005,
        plausible=(0.0, 0.03),
        nodes=(0.002, 0.005, 0.01, 0.02, 0.035, 0.05),
    ),
    edit=partial(edit_loss, name="surface_loss"),
    columns=("reflections",),
    weight=partial(weight_loss, name="surface_loss", column="reflections"),
)


def without_rough_faces(scene: SceneFile) -> tuple[str, str] | None:
    """What to say of a scene whose interfaces are all smooth."""
    numbers = (e for e in scene.root.iter("float") if e.get("name") == "roughness_alpha")
    if any(float(number.attrib["value"]) for number in numbers):
        return None
    return "rough faces, and the scene has none", "add ground, or ground_side or the like, to it"


GROUND_LOSS = Effect(
    name="ground_loss",
    title="loss at ground faces",
    family="surface",
    look=(
        "Polish one of the ground faces and measure again; etching takes the damaged layer off "
        "and leaves the face dull."
    ),
    physics=(
        "Grinding leaves cracks and grains below the facets of a face, which hold light and dirt. "
        "Light from inside loses this part each time it meets such a face, before the facets "
        "reflect or refract it; so a bench in Geant4 is told by the reflectivity of a ground "
        "surface. What is polished loses nothing: see surface_absorption. It is there where the "
        "scene has ground faces, whose facets do not take any light themselves."
    ),
    source=_LEVIN,
    parameters=one_parameter(
        name="ground_loss",
        meaning="Fraction lost each time light from inside meets a ground face of the crystal",
        maximum=0.5,
        start=0.05,
        plausible=(0.02, 0.2),
        nodes=(0.02, 0.05, 0.1, 0.2, 0.35, 0.5),
        coordinate="logarithmic",
        scale=0.1,
    ),
    excludes=("surface_roughness", *_ROUGH),
    lacks=without_rough_faces,
    # on smooth faces it does nothing, but these may be ground later
    edit=partial(edit_loss, name="ground_loss"),
    columns=("rough_hits",),
    weight=partial(weight_loss, name="ground_loss", column="rough_hits"),
)


#: Largest leg, as a part of the shortest edge.
_LARGEST_LEG = 0.48
_TRIM_EDGES = '<float name="trim" value="$chamfer_mm"/>'


def edit_edge_chamfer(editor: SceneEditor) -> None:
    """Cut the twelve edges of the crystal, with faces of their own."""
    for name in ("crystal_chamfers", "gap_top_rim"):
        editor.refuse_id(name)
    scene, leg_mm = editor.scene.parameters, editor.values["chamfer_mm"]
    box = scene_edits.crystal_box(editor)
    smallest_mm = min(float(scene["crystal_width_mm"]), float(scene["crystal_height_mm"]))
    if not 2 * leg_mm < smallest_mm:
        problem = f"a chamfer of {leg_mm:g} mm leaves nothing of a crystal of {smallest_mm:g} mm"
        raise editor.refusal(problem, "twice the leg must stay below width and height")
    faces = [face for faces in box.values() for face in faces]
    outer = [face for name, faces in box.items() if name != "bottom" for face in faces]
    crystal_to_air = scene_edits.worn_towards_air(editor, outer, "the crystal's other faces")
    sides = scene_edits.gap_sides(editor)
    gap_to_air = scene_edits.worn_towards_air(editor, sides, "the gap's sides")
    for face in faces:
        scene_edits.make_panel(editor, face, _TRIM_EDGES)
    bubble = [part for name in ("cut", "index") if (part := sides[0].named(name)) is not None]
    rim = "".join(f"\n  {editor.source(part)}" for part in bubble)
    editor.insert_after(
        max(faces, key=editor.shapes.index),
        f"""<!-- The twelve bevelled edges -->
<shape type="chamfers" id="crystal_chamfers">
  <float name="width" value="$crystal_width_mm"/>
  <float name="height" value="$crystal_height_mm"/>
  <float name="leg" value="$chamfer_mm"/>
  {crystal_to_air}
  <ref name="interior" id="{editor.crystal.attrib["id"]}"/>
</shape>

<!-- The rim of the gap that the crystal no longer covers -->
<shape type="frame" id="gap_top_rim">
  <float name="outer_width" value="$crystal_width_mm"/>
  <float name="rim" value="$chamfer_mm"/>{rim}
  {gap_to_air}
  <ref name="interior" id="{editor.gap.attrib["id"]}"/>
</shape>""",
    )


def limits_edge_chamfer(parameters: Parameters) -> tuple[float, float]:
    """Twice the leg stays below width and height, and something of the faces is left."""
    sides = (float(parameters[f"crystal_{side}_mm"]) for side in ("width", "height"))
    return 0.0, _LARGEST_LEG * min(sides)


EDGE_CHAMFER = Effect(
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
    parameters=one_parameter(
        name="chamfer_mm",
        meaning="Leg of the chamfers at the crystal's edges",
        maximum=1.0,
        start=0.2,
        plausible=(0.0, 0.5),
        nodes=(0.12, 0.3, 0.6, 1.0),
        limits=limits_edge_chamfer,
    ),
    excludes=("gap_bubble_round",),
    edit=edit_edge_chamfer,
)
