"""Effect ``bottom_roughness``: only the crystal's bottom face is rough."""

from mcrim_mitsuba.effects._bench import one_side

EFFECT = one_side(
    "bottom",
    "bottom face",
    ground=False,
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
)
