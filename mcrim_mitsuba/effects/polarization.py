"""Effect ``polarization``: Fresnel reflection follows each photon's polarisation."""

from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile


def edit(editor: SceneEditor) -> None:
    """Set the ``<default>`` polarization to true."""
    if not isinstance(editor.scene.parameters.get("polarization"), bool):
        mend = 'add <default name="polarization" value="false"/> and use it in the integrator'
        raise editor.refusal("the scene has no parameter polarization", mend)
    if editor.scene.parameters["polarization"]:
        raise editor.refusal("polarization is true already", "there is nothing to add")
    editor.set_default("polarization", True)


def there(scene: SceneFile) -> bool:
    """Whether a scene has it."""
    return scene.parameters.get("polarization") is True


EFFECT = Effect(
    name="polarization",
    title="polarisation of the light",
    family="light",
    look="It is always there: switch it on; nothing needs to be looked for.",
    physics=(
        "A face reflects the two polarisations of a photon differently, and total internal "
        "reflection shifts their phases against each other: light that was reflected once is "
        "polarised and meets the next face with other odds than unpolarised light. Emission is "
        "unpolarised, and each scattering in the bulk and each diffuse reflection depolarises."
    ),
    source="M. Born and E. Wolf, Principles of Optics, 7th ed., Cambridge 1999, section 1.5",
    there=there,
    edit=edit,
)
