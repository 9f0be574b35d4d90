"""Effect ``bottom_roughness``: only the crystal's bottom face is rough."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import FACETS, roughen, roughness_of
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Make the crystal's bottom face rough."""
    roughen(editor, "bottom", "bottom_roughness_alpha")


EFFECT = Effect(
    name="bottom_roughness",
    title="roughness of the bottom face",
    family="surface",
    look=(
        "Take the crystal off and look at the reflection of a lamp in its bottom face: "
        "mounting scratches it. Turn the crystal over and measure again."
    ),
    physics=(
        "The face before the detector is scratched when crystals are mounted, turned "
        "and wiped; where a gel covers it, its roughness is nearly matched. It is one "
        "of facets with tilted normals (GGX, width alpha), as in surface_roughness, and "
        "the other faces are polished."
    ),
    source=FACETS,
    parameters=(roughness_of("bottom", "bottom face"),),
    excludes=("surface_roughness", "ground", "ground_bottom"),
    edit=edit,
)
