"""Effect ``detector_angle``: oblique light is detected less often, or more often."""

import numpy as np

from mcrim_mitsuba.effects._bench import falloff, set_detector
from mcrim_mitsuba.effects.effect import Columns, Effect, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Let the detector refuse light by its angle."""
    set_detector(editor, "angular_falloff", "$angular_falloff")


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """1 - a (1 - cos theta), theta inside the window, to the normal: above 1 for a below 0."""
    cosine = columns["arrival_cosine"].astype(np.float64)
    return 1.0 - values["angular_falloff"] * (1.0 - cosine)


EFFECT = Effect(
    name="detector_angle",
    title="angle-dependent detection",
    family="detector accepts",
    look=(
        "Turn a narrow beam of light about the middle of the tube's window, and read the "
        "tube at each angle."
    ),
    physics=(
        "Reflection and absorption in a photocathode, a thin film on glass, depend on the angle "
        "of incidence. A gel lets more oblique light through than air does, so it is seen with "
        "another mean efficiency: 1 - a (1 - cos theta) of what arrives at the angle theta "
        "inside the window is detected, the rest absorbed. Negative a is a detector that sees "
        "slanted light better. Readings are relative to light head-on, with which tubes are "
        "calibrated, so that such light counts more than 1; the probabilities themselves, "
        "(1 - a (1 - cos theta)) / (1 - a), do not exceed 1."
    ),
    source="D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217",
    parameters=(
        falloff(
            "angular_falloff",
            "(1 - cos theta), theta inside the window",
            least=-1.0,
            nodes=(-1.0, -0.7, -0.35),
        ),
    ),
    excludes=("photocathode_film",),
    edit=edit,
    columns=("arrival_cosine",),
    weight=weight,
)
