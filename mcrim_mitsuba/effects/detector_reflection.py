"""Effect ``detector_reflection``: the detector sends part of the light back."""

import numpy as np

from mcrim_mitsuba.effects._bench import hits_weight, sends_back, set_detector
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor

_SIMULATED_AT = 0.5


def edit(editor: SceneEditor) -> None:
    """Let the detector send light back into the window."""
    set_detector(editor, "reflectance", "$detector_reflectance")
    sends_back(editor)


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """(1 - rho) rho^m over the same at 0.5: m reflections off it, then detection."""
    return hits_weight(columns["detector_hits"], values["detector_reflectance"], _SIMULATED_AT)


EFFECT = Effect(
    name="detector_reflection",
    title="diffusely reflecting detector",
    family="detector reflects",
    look=(
        "Measure with another tube. Put a black ring around the crystal on the window: the "
        "readings fall if light went to and fro."
    ),
    physics=(
        "A photocathode absorbs a third to a half of the light, transmits some, and reflects the "
        "rest; what is behind it, and a silicon detector's surface, reflect too. Light "
        "that comes back into the window (Lambertian, depolarised) may re-enter the crystal and "
        "return. It is reflected before anything else is decided about it."
    ),
    source="D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217",
    parameters=(
        EffectParameter(
            name="detector_reflectance",
            unit="",
            meaning="Fraction of the light that the detector sends back into the window",
            minimum=0.0,
            maximum=0.5,
            start=0.1,
            absent=0.0,
            plausible=(0.0, 0.3),
            nodes=(0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
        ),
    ),
    excludes=("photocathode_film",),
    edit=edit,
    columns=("detector_hits",),
    weight=weight,
    proposal={"detector_reflectance": _SIMULATED_AT},
)
