"""Effect ``detector_radius``: the detector is less sensitive towards its edge."""

import numpy as np

from mcrim_mitsuba.effects._bench import falloff, set_detector
from mcrim_mitsuba.effects.effect import Columns, Effect, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor

_RADIUS_MM = 14.0


def edit(editor: SceneEditor) -> None:
    """Let the detector refuse light by its distance from the axis."""
    set_detector(editor, "radial_falloff", "$radial_falloff")


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """1 - b (r / 14 mm)^2, at least 0."""
    part = columns["arrival_radius_mm"].astype(np.float64) / _RADIUS_MM
    return np.clip(1.0 - values["radial_falloff"] * part**2, 0.0, 1.0)


EFFECT = Effect(
    name="detector_radius",
    title="position-dependent detection",
    family="detector accepts",
    look=("Move a narrow beam of light across the tube's window, and read the tube at each place."),
    physics=(
        "The collection of photoelectrons, and the photocathode itself, get worse towards the "
        "edge of a photomultiplier. Of the light that arrives at the radius r the part "
        "1 - b (r / 14 mm)^2 is detected, the rest absorbed; 14 mm whatever the mask."
    ),
    source="Hamamatsu Photonics, Photomultiplier Tubes: Basics and Applications, chapter 4",
    parameters=(falloff("radial_falloff", "(r / 14 mm)^2 from the axis outwards"),),
    edit=edit,
    columns=("arrival_radius_mm",),
    weight=weight,
)
