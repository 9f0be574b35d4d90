"""Effect ``anisotropic_scattering``: light is scattered more forwards, or backwards."""

from mcrim_mitsuba.effects._bench import set_phase
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Give the crystal's medium the phase function of Henyey and Greenstein."""
    set_phase(editor, '<phase type="hg">\n  <float name="g" value="$scattering_g"/>\n</phase>')


EFFECT = Effect(
    name="anisotropic_scattering",
    title="anisotropic scattering",
    family="bulk",
    look=(
        "Look at a laser beam in the crystal from the side, and at its spot behind the "
        "crystal: inclusions scatter forwards and give the spot a halo."
    ),
    physics=(
        "Inclusions and bubbles as large as the wavelength or larger scatter mostly forwards, "
        "which turns the light less than isotropic scattering with the same coefficient. The "
        "phase function of Henyey and Greenstein, (1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^(3/2)), "
        "has the mean cosine g."
    ),
    source="L. G. Henyey and J. L. Greenstein, Astrophysical Journal 93 (1941) 70",
    parameters=(
        EffectParameter(
            name="scattering_g",
            unit="",
            meaning="Mean cosine of the scattering angle in the crystal, 0 if isotropic",
            minimum=-0.5,
            maximum=0.95,
            start=0.3,
            absent=0.0,
            plausible=(0.0, 0.9),
            nodes=(-0.5, 0.3, 0.6, 0.8, 0.9, 0.95),
            # light forgets its direction with alpha_scat (1 - g)
            coordinate="logarithmic",
            scale=-1.0,
        ),
    ),
    excludes=("rayleigh_scattering",),
    edit=edit,
)
