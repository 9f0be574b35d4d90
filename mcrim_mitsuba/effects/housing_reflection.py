"""Effect ``housing_reflection``: the mask around the crystal is not quite black."""

import numpy as np

from mcrim_mitsuba.effects._bench import masks_of, set_part
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor

_SIMULATED_AT = 0.2


def edit(editor: SceneEditor) -> None:
    """Let the masks send light back upwards."""
    xml = '<float name="reflectance" value="$housing_reflectance"/>'
    set_part(editor, masks_of(editor), "reflectance", xml)


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """(rho / 0.2)^m of m reflections off it."""
    hits = columns["mask_hits"].astype(np.float64)
    return (values["housing_reflectance"] / _SIMULATED_AT) ** hits


EFFECT = Effect(
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
    parameters=(
        EffectParameter(
            name="housing_reflectance",
            unit="",
            meaning="Fraction of the light that the mask's upper side reflects diffusely",
            minimum=0.0,
            maximum=0.2,
            start=0.05,
            absent=0.0,
            plausible=(0.0, 0.1),
            nodes=(0.03, 0.07, 0.13, 0.2),
        ),
    ),
    edit=edit,
    columns=("mask_hits",),
    weight=weight,
    proposal={"housing_reflectance": _SIMULATED_AT},
)
