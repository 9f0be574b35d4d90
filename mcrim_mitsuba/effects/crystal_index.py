"""Effect ``crystal_index``: the crystal's refractive index is not the nominal one."""

from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Change the ``<default>`` of the crystal's index."""
    editor.set_default("n_crystal", editor.values["n_crystal"])


EFFECT = Effect(
    name="crystal_index",
    title="wrong index of the crystal",
    family="bulk",
    look=(
        "Measure the deviation of a laser in a prism of the same boule, or take the index "
        "from tables at the wavelength of the emission."
    ),
    physics=(
        "Tabulated indices hold for one wavelength, one polarisation and one sample; molybdates "
        "and tungstates are birefringent (uniaxial), and dispersion is steep near their emission. "
        "The index decides how much light is trapped and how much a gel frees."
    ),
    source="W. L. Bond, J. Appl. Phys. 36 (1965) 1674",
    parameters=(
        EffectParameter(
            name="n_crystal",
            unit="",
            meaning="Refractive index of the crystal, as an offset from the scene's",
            minimum=-0.1,
            maximum=0.1,
            start=0.03,
            absent=0.0,
            plausible=(-0.05, 0.05),
            nodes=(-0.1, 0.1),
            nominal="n_crystal",
        ),
    ),
    edit=edit,
)
