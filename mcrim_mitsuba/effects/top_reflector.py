"""Effect ``top_reflector``: something white lies on the top face."""

import numpy as np

from mcrim_mitsuba.effects._bench import crystal_box
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor

_SIMULATED_AT = 0.99


def edit(editor: SceneEditor) -> None:
    """Lay a white reflector on the top face, behind a film of air."""
    for shape in editor.shapes:
        if shape.type == "wrapping":
            problem = f"{shape.label} covers the top already"
            raise editor.refusal(problem, "change its reflectance instead", shape)
    editor.refuse_id("top_reflector")
    box = crystal_box(editor)
    last = max((face for faces in box.values() for face in faces), key=lambda face: face.start)
    editor.insert_shape(
        """<!-- A white reflector exactly over the top face, behind 0.01 mm of air -->
<shape type="rectangle" id="top_reflector">
  <transform name="to_world">
    <scale x="$crystal_width_mm" y="$crystal_width_mm"/>
    <rotate x="1" angle="180"/>
    <scale value="0.5"/>
    <translate z="$crystal_height_mm"/>
    <translate z="0.01"/>
  </transform>
  <bsdf type="diffuse">
    <spectrum name="reflectance" value="$top_reflectance"/>
  </bsdf>
</shape>""",
        after=last,
    )


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """(rho / 0.99) to the power of the reflections off the reflector."""
    hits = columns["reflector_hits"].astype(np.float64)
    return (values["top_reflectance"] / _SIMULATED_AT) ** hits


EFFECT = Effect(
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
    parameters=(
        EffectParameter(
            name="top_reflectance",
            unit="",
            meaning="Fraction of the light that the reflector on the top reflects",
            minimum=0.0,
            maximum=0.99,
            start=0.5,
            absent=0.0,
            plausible=(0.0, 0.98),
            nodes=(0.2, 0.4, 0.6, 0.75, 0.9, 0.99),
        ),
    ),
    edit=edit,
    columns=("reflector_hits",),
    weight=weight,
    proposal={"top_reflectance": _SIMULATED_AT},
)
