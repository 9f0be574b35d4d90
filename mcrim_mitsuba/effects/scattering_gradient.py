"""Effect ``scattering_gradient``: one end of the crystal scatters more than the other."""

from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Let the crystal's scattering change along its height."""
    editor.insert_last(
        editor.crystal, '<float name="scattering_gradient" value="$scattering_gradient"/>'
    )


EFFECT = Effect(
    name="scattering_gradient",
    title="scattering gradient in the crystal",
    family="bulk",
    look=("Turn the crystal over and measure again: the readings change if one end scatters more."),
    physics=(
        "Impurities and inclusions are distributed along a boule as it grows from the melt, so "
        "one end of a crystal cut from it can scatter more than the other: alpha_scat(z) = "
        "alpha_scat (1 + q (2 z / H - 1)), with its mean kept."
    ),
    source="J. A. Burton, R. C. Prim and W. P. Slichter, J. Chem. Phys. 21 (1953) 1987",
    parameters=(
        EffectParameter(
            name="scattering_gradient",
            unit="",
            meaning="Relative change of alpha_scat from the middle to the top of the crystal",
            minimum=-1.0,
            maximum=1.0,
            start=0.3,
            absent=0.0,
            plausible=(-0.5, 0.5),
            nodes=(-1.0, -0.5, 0.5, 1.0),
        ),
    ),
    edit=edit,
    # the path on which a photon can be scattered is not its length here
    columns=("scattering_path_cm",),
)
