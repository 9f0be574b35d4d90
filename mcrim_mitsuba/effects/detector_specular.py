"""Effect ``detector_specular``: the detector reflects part of the light as a mirror does."""

import numpy as np

from mcrim_mitsuba.effects._bench import hits_weight, sends_back, set_detector
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor

_SIMULATED_AT = 0.5


def edit(editor: SceneEditor) -> None:
    """Let the detector be a mirror for part of the light."""
    set_detector(editor, "specular", "$detector_specular")
    sends_back(editor)


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """Of m reflections off it, and then detection."""
    return hits_weight(columns["detector_hits"], values["detector_specular"], _SIMULATED_AT)


EFFECT = Effect(
    name="detector_specular",
    title="mirror-like detector",
    family="detector reflects",
    look=(
        "Look at the reflection of a lamp in the tube's window: the image behind that of the "
        "glass is the photocathode's. Measure with another tube."
    ),
    physics=(
        "The face of a photocathode or of a silicon detector is smooth, and so is what is behind "
        "it: what it reflects leaves at the angle at which it came, and in total reflection "
        "goes on in the window. With this probability light is reflected so, whatever its angle "
        "(polarised light as by a metal), else it is detected. Diffuse reflection, if there is "
        "some too, is decided before."
    ),
    source="D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217",
    parameters=(
        EffectParameter(
            name="detector_specular",
            unit="",
            meaning="Fraction of the light that the detector reflects as a mirror does",
            minimum=0.0,
            maximum=0.5,
            start=0.1,
            absent=0.0,
            plausible=(0.0, 0.4),
            nodes=(0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
        ),
    ),
    excludes=("photocathode_film",),
    edit=edit,
    columns=("detector_hits",),
    weight=weight,
    proposal={"detector_specular": _SIMULATED_AT},
)
