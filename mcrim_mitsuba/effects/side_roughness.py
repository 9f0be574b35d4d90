"""Effect ``side_roughness``: only the crystal's four side faces are rough."""

from mcrim_mitsuba.effects._bench import one_side

EFFECT = one_side(
    "side",
    "side faces",
    ground=False,
    look=(
        "Look at the reflection of a lamp in the sides, and measure the transmittance through "
        "them: roughness costs the beam most."
    ),
    physics=(
        "The four sides of a crystal are often polished less than the faces through which light "
        "is meant to leave; beyond 0.05 they are ground: see ground_side. It is one of facets "
        "with tilted normals (GGX, width alpha), as in surface_roughness, and the other faces are "
        "polished."
    ),
)
