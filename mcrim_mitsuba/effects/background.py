"""Effect ``background``: every reading holds a constant that is no light of the crystal."""

import math

import numpy as np

from mcrim_mitsuba.effects.effect import Effect, EffectParameter, Rows


def reading(
    signals: np.ndarray, value: float, rows: Rows
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """reading = signal + background."""
    ones = np.ones_like(signals)
    return signals + value, ones, ones


def plausible_beside(signals: np.ndarray) -> tuple[float, float]:
    """A tenth of the weakest signal: more would have been seen with the crystal out."""
    largest = 0.1 * float(signals.min())
    return -largest, largest


EFFECT = Effect(
    name="background",
    title="constant background",
    family="readings",
    look=("Take the crystal out, and then the source away: what is still read is background."),
    physics=(
        "A pedestal that was not quite subtracted, stray light, or light that is born in the "
        "window adds the same to every reading. It weighs most on the weakest reading, which is "
        "that of the air gap. It is added after saturation."
    ),
    source="E. H. Bellamy et al., Nucl. Instrum. Meth. A 339 (1994) 468",
    parameters=(
        EffectParameter(
            name="background",
            unit="",
            meaning="Added to every reading, in the unit of the readings",
            minimum=-math.inf,
            maximum=math.inf,
            start=0.0,
            absent=0.0,
            plausible=(-math.inf, math.inf),
            nodes=(),
            plausible_beside=plausible_beside,
        ),
    ),
    reading=reading,
    order=1,
)
