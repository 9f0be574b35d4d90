"""Effect ``top_roughness``: only the crystal's top face is rough."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import roughen
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Make the crystal's top face rough."""
    roughen(editor, "top")


EFFECT = Effect(
    name="top_roughness",
    title="Rough top face",
    family="surface",
    look=(
        "Look at the reflection of a lamp in the top face. Put a drop of oil on it: the "
        "readings change if it is rough."
    ),
    physics=(
        "The face opposite the detector is often left as it was cut, or polished last "
        "and least, since nobody looks through it. It is one of facets with tilted "
        "normals (GGX, width alpha), as in surface_roughness, and the other faces are "
        "polished."
    ),
    source=(
        "B. Walter, S. R. Marschner, H. Li and K. E. Torrance, Eurographics Symposium on "
        "Rendering 2007, 195"
    ),
    parameters=(
        EffectParameter(
            name="top_roughness_alpha",
            unit="",
            meaning="Roughness of the crystal's top face (GGX), the tangent of a typical tilt",
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
