"""Effect ``ground_sides``: the crystal's four side faces are ground, not polished."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import FACETS, ground_of, roughen
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Grind the crystal's side faces."""
    roughen(editor, "side", "ground_sides_alpha")


EFFECT = Effect(
    name="ground_sides",
    title="ground side faces",
    family="surface",
    look=(
        "Look at the sides with a loupe: if they are ground they are dull, and nothing is seen "
        "through them."
    ),
    physics=(
        "The four sides are often ground, on purpose or to save work, while the faces at the ends "
        "are polished: facets that are tilted by tens of degrees (GGX, width alpha), as in ground, "
        "on the sides alone."
    ),
    source=FACETS,
    parameters=(ground_of("ground_sides_alpha", "the crystal's side faces"),),
    excludes=("surface_roughness", "side_roughness", "ground"),
    edit=edit,
)
