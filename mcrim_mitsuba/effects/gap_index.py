"""Effect ``gap_index``: the liquid in the gap has not its nominal index."""

from mcrim_mitsuba.effects._bench import polish
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import INTERFACES, SceneEditor

_SIDES = {"int_ior": "int_offset", "ext_ior": "ext_offset"}


def edit(editor: SceneEditor) -> None:
    """Add the offset to every face that has the gap's index."""
    found = False
    for bsdf in editor.root.walk():
        if bsdf.tag != "bsdf" or bsdf.type not in INTERFACES:
            continue
        for index, offset in _SIDES.items():
            if bsdf.child("float", name=index, value="$n_gap") is not None:
                polish(editor, bsdf, offset, "$gap_index_offset")
                found = True
    if not found:
        raise editor.refusal("no interface has the index $n_gap", "write n_gap as a parameter")


EFFECT = Effect(
    name="gap_index",
    title="wrong index of the liquid",
    family="gap",
    look=(
        "Put a drop of the liquid on a refractometer, at the temperature of the bench; "
        "measure with another liquid."
    ),
    physics=(
        "The index of a liquid or gel depends on temperature (about -0.0004 per kelvin for "
        "organic liquids), wavelength, mixture and age, by the Lorentz-Lorenz relation with its "
        "density. A wrong value moves every filled configuration, the empty ones not."
    ),
    source="M. Born and E. Wolf, Principles of Optics, 7th ed., Cambridge 1999, section 2.3",
    parameters=(
        EffectParameter(
            name="gap_index_offset",
            unit="",
            meaning="Added to the index of the gap wherever that is above 1.0005",
            minimum=-0.1,
            maximum=0.1,
            start=0.02,
            absent=0.0,
            plausible=(-0.03, 0.03),
            nodes=(-0.1, -0.06, -0.025, 0.025, 0.06, 0.1),
            # where the index passes that of the window total reflection begins
            kinked=True,
        ),
    ),
    filled_only=True,
    edit=edit,
)
