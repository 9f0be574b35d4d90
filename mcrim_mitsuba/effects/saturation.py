"""Effect ``saturation``: strong signals are read too low."""

import numpy as np

from mcrim_mitsuba.effects.effect import Effect, EffectParameter, Rows


def reading(
    signals: np.ndarray, value: float, rows: Rows
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """reading = signal / (1 + k signal)."""
    damped = 1.0 + value * signals
    return signals / damped, damped**-2.0, -((signals / damped) ** 2)


def plausible_beside(signals: np.ndarray) -> tuple[float, float]:
    """A tube that reads its strongest signal a tenth too low is not used."""
    return 0.0, 0.1 / float(signals.max())


EFFECT = Effect(
    name="saturation",
    title="saturation of the readout",
    family="readings",
    look=(
        "Put a grey filter of known transmittance before the tube: the signal must fall by "
        "just that part."
    ),
    physics=(
        "Space charge in a photomultiplier, the finite number of a silicon detector's cells, an "
        "amplifier near its limit or dead time read strong signals too low: reading = true / "
        "(1 + k true), the form of a non-paralyzable dead time. It acts before a background is "
        "added."
    ),
    source="G. F. Knoll, Radiation Detection and Measurement, 4th ed., Wiley 2010, chapter 4",
    parameters=(
        EffectParameter(
            name="saturation",
            unit="",
            meaning="k of reading = true / (1 + k true), per unit of the readings",
            minimum=0.0,
            maximum=0.05,
            start=0.002,
            absent=0.0,
            plausible=(0.0, 0.01),
            nodes=(),
            plausible_beside=plausible_beside,
        ),
    ),
    reading=reading,
)
