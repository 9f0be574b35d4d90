"""Effect ``side_roughness``: only the crystal's four side faces are rough."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import roughen
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Make the crystal's four side faces rough."""
    roughen(editor, "side")


EFFECT = Effect(
    name="side_roughness",
    title="Rough side faces",
    family="surface",
    look=(
        "Look at the reflection of a lamp in the sides, and measure the transmittance "
        "through them: roughness costs the beam most."
    ),
    physics=(
        "The four sides of a crystal are often polished less than the faces through "
        "which light is meant to leave, or ground on purpose, so that light comes out "
        "more evenly. It is one of facets with tilted normals (GGX, width alpha), as in "
        "surface_roughness, and the other faces are polished."
    ),
    source=(
        "B. Walter, S. R. Marschner, H. Li and K. E. Torrance, Eurographics Symposium on "
        "Rendering 2007, 195"
    ),
    parameters=(
        EffectParameter(
            name="side_roughness_alpha",
            unit="",
            meaning="Roughness of the crystal's side faces (GGX), the tangent of a typical tilt",
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
