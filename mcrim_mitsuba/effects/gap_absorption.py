"""Effect ``gap_absorption``: the liquid or gel in the gap absorbs."""

import numpy as np

from mcrim_mitsuba.effects.effect import (
    Columns,
    Effect,
    EffectParameter,
    Parameters,
    Values,
    filled,
)
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Give the gap's medium an absorption that air does not have."""
    known = editor.gap.named("alpha_abs_per_cm")
    if known is not None:
        raise editor.refusal("the gap absorbs already", "change this number instead", known)
    if "n_gap" not in editor.scene.parameters:
        raise editor.refusal("the scene has no parameter n_gap", "write the gap's index as one")
    editor.insert_last(
        editor.gap,
        '<float name="alpha_abs_per_cm" value="$gap_absorption_per_cm"/>\n'
        '<float name="index" value="$n_gap"/>  <!-- air does not absorb -->',
    )


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """exp(-alpha path) in a filled gap."""
    path_cm = columns["path_gap_cm"].astype(np.float64)
    if not filled(parameters):
        return np.ones(len(path_cm))
    return np.exp(-values["gap_absorption_per_cm"] * path_cm)


EFFECT = Effect(
    name="gap_absorption",
    title="absorbing liquid in the gap",
    family="gap",
    look="Measure the transmittance of the liquid in a cuvette: old gel turns yellow.",
    physics=(
        "A gel that has yellowed, or a liquid that is not clear at the wavelength of emission, "
        "absorbs along the path in it (Beer-Lambert law). Light that crosses the gap obliquely, "
        "or is reflected to and fro in it, loses most; an empty gap loses nothing."
    ),
    source="J. D. Ingle and S. R. Crouch, Spectrochemical Analysis, Prentice Hall 1988",
    parameters=(
        EffectParameter(
            name="gap_absorption_per_cm",
            unit="1/cm",
            meaning="Absorption coefficient of what fills the gap",
            minimum=0.0,
            maximum=20.0,
            start=1.0,
            absent=0.0,
            plausible=(0.0, 3.0),
            nodes=(0.5, 1.5, 3.5, 7.0, 11.0, 16.0, 20.0),
        ),
    ),
    excludes=("gel_creep",),
    filled_only=True,
    edit=edit,
    columns=("path_gap_cm",),
    weight=weight,
)
