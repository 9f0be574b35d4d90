"""Effect ``side_source``: the radiation stops near a side face, not everywhere."""

import numpy as np

from mcrim_mitsuba.effects._bench import birth_weight
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Let the births fall with the distance from the left side."""
    editor.insert_last(editor.emitter, '<float name="side_depth_mm" value="$side_depth_mm"/>')
    editor.reword(editor.emitter, "everywhere in the crystal", "near the left side of the crystal")


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """Density exp(-t/d) / (d (1 - exp(-W/d))) at t = x + W/2, over 1/W."""
    width_mm, depth_mm = float(parameters["crystal_width_mm"]), values["side_depth_mm"]
    return birth_weight(columns["birth_side_mm"], width_mm, depth_mm)


EFFECT = Effect(
    name="side_source",
    title="source beside the crystal",
    family="source",
    look=(
        "See where the source stands. Turn the crystal by a right angle, or put the source above "
        "it: the readings change if light is born near one side."
    ),
    physics=(
        "Gammas that enter through a side are absorbed exponentially with the distance from it: "
        "59.5 keV gammas stop in the first millimetre or so of a molybdate or tungstate. The light "
        "is then born with a density proportional to exp(-(x + W/2) / depth), not everywhere "
        "alike, and nearer to one edge of a mask's hole than to the other."
    ),
    source="J. H. Hubbell and S. M. Seltzer, Tables of X-Ray Mass Attenuation Coefficients, "
    "NISTIR 5632 (1995)",
    parameters=(
        EffectParameter(
            name="side_depth_mm",
            unit="mm",
            meaning="Depth behind the left side in which the radiation is absorbed to 1/e",
            minimum=0.2,
            maximum=100.0,
            start=2.0,
            absent=float("inf"),
            plausible=(0.3, 20.0),
            nodes=(0.2, 0.6, 1.3, 2.5, 5.0, 12.0, 40.0),
            coordinate="reciprocal",
            scale=2.0,
        ),
    ),
    excludes=("source_depth",),
    needs=("crystal_width_mm",),
    edit=edit,
    columns=("birth_side_mm",),
    weight=weight,
)
