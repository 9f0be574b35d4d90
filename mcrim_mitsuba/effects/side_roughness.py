"""Effect ``side_roughness``: only the crystal's four side faces are rough."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import FACETS, roughen, roughness_of
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Make the crystal's four side faces rough."""
    roughen(editor, "side", "side_roughness_alpha")


EFFECT = Effect(
    name="side_roughness",
    title="roughness of the side faces",
    family="surface",
    look=(
        "Look at the reflection of a lamp in the sides, and measure the transmittance through "
        "them: roughness costs the beam most."
    ),
    physics=(
        "The four sides of a crystal are often polished less than the faces through which light "
        "is meant to leave; beyond 0.05 they are ground: see ground_sides. It is one of facets "
        "with tilted normals (GGX, width alpha), as in surface_roughness, and the other faces are "
        "polished."
    ),
    source=FACETS,
    parameters=(roughness_of("side", "side faces"),),
    excludes=("surface_roughness", "ground", "ground_sides"),
    edit=edit,
)
