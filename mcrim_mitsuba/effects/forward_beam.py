"""Effect ``forward_beam``: a spectrophotometer takes light from farther off its axis, or nearer."""

from collections.abc import Mapping

import numpy as np

from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.effects.effect import Columns, Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.scene.spectrophotometer import ACCEPTANCE

#: Smallest and largest half angle that is looked at, degrees.
_LEAST_DEG, _MOST_DEG = 0.5, 89.0


def limits(parameters: Mapping[str, Value]) -> tuple[float, float]:
    """Offsets that leave an angle between nothing and a half space."""
    nominal = float(parameters[ACCEPTANCE])
    return min(_LEAST_DEG - nominal, -0.1 * nominal), max(_MOST_DEG - nominal, 0.1)


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """1 within the acceptance's half angle about the beam, 0 beyond."""
    return (columns["arrival_angle_deg"] <= values[ACCEPTANCE]).astype(np.float64)


EFFECT = Effect(
    name="forward_beam",
    title="wrong spectrophotometer acceptance",
    family="beam",
    look=(
        "Close an iris in front of the spectrophotometer's detector, or move the sample away from "
        "it: what changes with the distance was scattered by a small angle."
    ),
    physics=(
        "Light that leaves a crystal at a small angle to the beam, scattered forward or by the "
        "faces, counts as transmitted where the detector still takes it. Most instruments take a "
        "half angle of 1 to 7 degrees, one with an integrating sphere nearly 90, and few papers "
        "say. It changes transmittances only, and none of a polished crystal that scatters "
        "evenly."
    ),
    source="ASTM D1003: haze is what leaves at more than 2.5 degrees to the beam",
    parameters=(
        EffectParameter(
            name=ACCEPTANCE,
            unit="degrees",
            meaning="Largest angle to the beam that the detector takes, as an offset from [beam]",
            minimum=-89.0,
            maximum=89.0,
            start=1.0,
            absent=0.0,
            plausible=(-4.0, 10.0),
            nodes=(-4.5, -3.5, -2.0, 3.0, 8.0, 15.0, 25.0),
            nominal=ACCEPTANCE,
            coordinate="logarithmic",
            scale=6.0,
            limits=limits,
        ),
    ),
    columns=("arrival_angle_deg",),
    weight=weight,
    of_beam=True,
)
