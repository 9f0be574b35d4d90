"""Effect ``sample_scale``: the other crystals have another light yield."""

import numpy as np

from mcrim_mitsuba.effects.effect import Effect, EffectParameter, Rows


def reading(
    signals: np.ndarray, value: float, rows: Rows
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """reading = signal (1 + this) where the crystal is another one."""
    share = 1.0 + value * rows.other_sample
    return signals * share, np.broadcast_to(share, signals.shape), signals * rows.other_sample


EFFECT = Effect(
    name="sample_scale",
    title="yield difference between crystals",
    family="readings",
    look=(
        "Measure all pieces wrapped in the same reflector, where the yield decides and size hardly "
        "does; ask from which part of the boule each was cut."
    ),
    physics=(
        "Crystals of other sizes are other pieces, and doping, stoichiometry and annealing change "
        "along a boule: their light yield is not quite that of the crystal of the scene. Readings "
        "of every crystal whose width or height differs from the scene's are multiplied by one "
        "plus this, before the readout saturates. Transmittances know no light yield."
    ),
    source="V. Alenkov et al., JINST 8 (2013) P06002, section 1 (samples of other thickness)",
    parameters=(
        EffectParameter(
            name="sample_scale",
            unit="",
            meaning="Relative excess of the yield of crystals of other sizes than the scene's",
            minimum=-0.2,
            maximum=0.2,
            start=0.05,
            absent=0.0,
            plausible=(-0.1, 0.1),
            nodes=(-0.2, -0.08, 0.08, 0.2),
        ),
    ),
    reading=reading,
    order=-1,
)
