"""Effect ``bottom_roughness``: only the crystal's bottom face is rough."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import roughen
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Make the crystal's bottom face rough."""
    roughen(editor, "bottom")


EFFECT = Effect(
    name="bottom_roughness",
    title="Rough bottom face",
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
    source=(
        "B. Walter, S. R. Marschner, H. Li and K. E. Torrance, Eurographics Symposium on "
        "Rendering 2007, 195"
    ),
    parameters=(
        EffectParameter(
            name="bottom_roughness_alpha",
            unit="",
            meaning="Roughness of the crystal's bottom face (GGX), the tangent of a typical tilt",
            minimum=0.0,
            maximum=0.5,
            start=0.1,
            absent=0.0,
            plausible=(0.0, 0.4),
            nodes=(0.012, 0.035, 0.08, 0.16, 0.3, 0.5),
            coordinate="logarithmic",
            scale=0.03,
        ),
    ),
    excludes=("surface_roughness",),
    edit=edit,
)
