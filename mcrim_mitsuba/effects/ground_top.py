"""Effect ``ground_top``: the crystal's top face is ground, not polished."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import FACETS, ground_of, roughen
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Grind the crystal's top face."""
    roughen(editor, "top", "ground_top_alpha")


EFFECT = Effect(
    name="ground_top",
    title="ground top face",
    family="surface",
    look=(
        "Look at the top face with a loupe: if it is ground it is dull. Put a drop of oil on it: "
        "the readings change."
    ),
    physics=(
        "The face opposite the detector is often left as it was cut, since nobody looks through "
        "it: facets that are tilted by tens of degrees (GGX, width alpha), as in ground, on this "
        "face alone."
    ),
    source=FACETS,
    parameters=(ground_of("ground_top_alpha", "the crystal's top face"),),
    excludes=("surface_roughness", "top_roughness", "ground"),
    edit=edit,
)
