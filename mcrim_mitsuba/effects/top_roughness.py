"""Effect ``top_roughness``: only the crystal's top face is rough."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import FACETS, roughen, roughness_of
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Make the crystal's top face rough."""
    roughen(editor, "top", "top_roughness_alpha")


EFFECT = Effect(
    name="top_roughness",
    title="roughness of the top face",
    family="surface",
    look=(
        "Look at the reflection of a lamp in the top face. Put a drop of oil on it: the readings "
        "change if it is rough."
    ),
    physics=(
        "The face opposite the detector is often polished last and least, since nobody looks "
        "through it. A polished face has alpha of 0.05 at most: see ground_top. It is one of "
        "facets with tilted normals (GGX, width alpha), as in surface_roughness, and the other "
        "faces are polished."
    ),
    source=FACETS,
    parameters=(roughness_of("top", "top face"),),
    excludes=("surface_roughness", "ground", "ground_top"),
    edit=edit,
)
