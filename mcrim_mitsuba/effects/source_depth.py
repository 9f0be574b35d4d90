"""Effect ``source_depth``: the radiation stops near the top face, not everywhere."""

import numpy as np

from mcrim_mitsuba.effects._bench import birth_weight
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Let the births fall with the depth below the top."""
    editor.insert_last(editor.emitter, '<float name="source_depth_mm" value="$source_depth_mm"/>')
    editor.reword(editor.emitter, "everywhere in the crystal", "near the top of the crystal")


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """Density exp(-t/d) / (d (1 - exp(-H/d))) at the depth t below the top, over 1/H."""
    height_mm, depth_mm = float(parameters["crystal_height_mm"]), values["source_depth_mm"]
    return birth_weight(columns["birth_depth_mm"], height_mm, depth_mm)


EFFECT = Effect(
    name="source_depth",
    title="source near the top face",
    family="source",
    look=(
        "Turn the crystal over, or put the source beside it: the readings change if light "
        "is born near one face."
    ),
    physics=(
        "Gammas that enter through the top are absorbed exponentially with depth: 59.5 keV "
        "gammas stop in the first millimetre or so of a molybdate or tungstate, and in the "
        "surface where it is an alpha source. The light is then born at a depth t below the top "
        "with a density proportional to exp(-t / depth), not everywhere alike."
    ),
    source="J. H. Hubbell and S. M. Seltzer, Tables of X-Ray Mass Attenuation Coefficients, "
    "NISTIR 5632 (1995)",
    parameters=(
        EffectParameter(
            name="source_depth_mm",
            unit="mm",
            meaning="Depth below the top in which the radiation is absorbed to 1/e",
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
    excludes=("side_source",),
    needs=("crystal_height_mm",),
    edit=edit,
    columns=("birth_depth_mm",),
    weight=weight,
)
