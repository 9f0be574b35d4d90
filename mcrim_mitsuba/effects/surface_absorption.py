"""Effect ``surface_absorption``: every reflection back into the crystal loses some light."""

import numpy as np

from mcrim_mitsuba.effects._bench import polish_crystal
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Let all faces of the crystal lose light that they reflect inwards."""
    for face in editor.crystal_faces:
        if editor.medium(face, "interior") is not editor.crystal:
            problem = f"the crystal is in front of {face.label}, not behind it"
            mend = "turn the face around: the loss acts on light that comes from behind"
            raise editor.refusal(problem, mend, face)
    polish_crystal(editor, "surface_loss", "$surface_loss")


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """(1 - loss) to the power of the reflections back into the crystal."""
    return (1.0 - values["surface_loss"]) ** columns["reflections"].astype(np.float64)


EFFECT = Effect(
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
    source=(
        "A. Levin and C. Moisan, IEEE Nuclear Science Symposium Conference Record 1996, vol. 2, 702"
    ),
    parameters=(
        EffectParameter(
            name="surface_loss",
            unit="",
            meaning="Fraction lost at every internal reflection at a face of the crystal",
            minimum=0.0,
            maximum=0.05,
            start=0.005,
            absent=0.0,
            plausible=(0.0, 0.03),
            nodes=(0.002, 0.005, 0.01, 0.02, 0.035, 0.05),
        ),
    ),
    edit=edit,
    columns=("reflections",),
    weight=weight,
)
