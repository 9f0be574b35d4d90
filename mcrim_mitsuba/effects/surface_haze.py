"""Effect ``surface_haze``: polish that is fine but not perfect scatters at every face."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import WAVELENGTH, polish_crystal, wavelength_of
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Give all faces of the crystal a fine roughness."""
    wavelength = wavelength_of(editor)
    polish_crystal(editor, "rms_roughness_nm", "$rms_roughness_nm")
    for bsdf in editor.crystal_polish:
        editor.insert_last(bsdf, f'<float name="{WAVELENGTH}" value="{wavelength}"/>')


EFFECT = Effect(
    name="surface_haze",
    title="haze of the crystal's faces",
    family="surface",
    look=(
        "Shine a laser pointer at a face in the dark: on a hazy face the spot is seen from all "
        "sides. Polish again and measure again."
    ),
    physics=(
        "A polished face keeps heights of some nanometres. They are too fine for slopes to "
        "matter, but shift the phase of the wave: the part S = 1 - exp(-q^2) of what Fresnel "
        "reflects or refracts is scattered, with q = 4 pi s n cos(theta) / lambda in reflection "
        "and 2 pi s |n cos(theta) - n' cos(theta')| / lambda in refraction. It goes to other "
        "directions of the same side, in proportion to the cosine, to S and to what would be "
        "reflected, or refracted, of light from there: each way is as likely as its reverse. So "
        "scatter heights that have no memory beyond a wavelength. Longer ones scatter close to "
        "the reflected ray, and free nothing; light scattered under total reflection may also "
        "leave at once, which it does not here: the height that is fitted is one 'as if'. lambda "
        "is the scene's wavelength_nm, 540 nm unless another is given."
    ),
    source="H. E. Bennett and J. O. Porteus, J. Opt. Soc. Am. 51 (1961) 123",
    parameters=(
        EffectParameter(
            name="rms_roughness_nm",
            unit="nm",
            meaning="Rms height of the fine roughness of the crystal's faces",
            minimum=0.0,
            maximum=30.0,
            start=5.0,
            absent=0.0,
            plausible=(0.0, 20.0),
            nodes=(2.0, 5.0, 9.0, 15.0, 22.0, 30.0),
            coordinate="logarithmic",
            scale=5.0,
        ),
    ),
    edit=edit,
)
