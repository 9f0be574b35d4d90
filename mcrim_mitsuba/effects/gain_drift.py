"""Effect ``gain_drift``: the readout's gain drifts while the rows are measured."""

import numpy as np

from mcrim_mitsuba.effects.effect import Effect, EffectParameter, Rows


def reading(
    signals: np.ndarray, value: float, rows: Rows
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """reading = signal (1 + drift position)."""
    gain = 1.0 + value * rows.position
    return signals * gain, np.broadcast_to(gain, signals.shape), signals * rows.position


EFFECT = Effect(
    name="gain_drift",
    title="drift of the gain",
    family="readings",
    look=(
        "Measure the first row again after the last one, or a light pulser between the rows; "
        "measure the rows in another order."
    ),
    physics=(
        "A photomultiplier's gain changes by per cents in hours, with temperature, high voltage "
        "and its own current, and after it has seen daylight. Rows that were measured one after "
        "the other are then read too high at one end and too low at the other: by this from first "
        "to last row of the file, linearly, and not at all in the middle. It acts on what is read "
        "in the end, a background included."
    ),
    source="G. F. Knoll, Radiation Detection and Measurement, 4th ed., Wiley 2010, chapter 9",
    parameters=(
        EffectParameter(
            name="gain_drift",
            unit="",
            meaning="Relative change of the readings from the first to the last row",
            minimum=-0.1,
            maximum=0.1,
            start=0.02,
            absent=0.0,
            plausible=(-0.03, 0.03),
            nodes=(-0.1, -0.04, 0.04, 0.1),
        ),
    ),
    reading=reading,
    order=2,
)
