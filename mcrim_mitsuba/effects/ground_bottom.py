"""Effect ``ground_bottom``: the crystal's bottom face is ground, not polished."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import FACETS, ground_of, roughen
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Grind the crystal's bottom face."""
    roughen(editor, "bottom", "ground_bottom_alpha")


EFFECT = Effect(
    name="ground_bottom",
    title="ground bottom face",
    family="surface",
    look=(
        "Take the crystal off and look at its bottom face with a loupe: a ground one is dull, "
        "and clear only while a liquid covers it."
    ),
    physics=(
        "The crystal may stand on a face that was cut and not polished: facets that are tilted by "
        "tens of degrees (GGX, width alpha), as in ground, on this face alone. A liquid nearly "
        "matches them, air does not: such a face changes the ratio of the readings most."
    ),
    source=FACETS,
    parameters=(ground_of("ground_bottom_alpha", "the crystal's bottom face"),),
    excludes=("surface_roughness", "bottom_roughness", "ground"),
    edit=edit,
)
