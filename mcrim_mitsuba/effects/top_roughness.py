"""Effect ``top_roughness``: only the crystal's top face is rough."""

from mcrim_mitsuba.effects._bench import one_side

EFFECT = one_side(
    "top",
    "top face",
    ground=False,
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
)
