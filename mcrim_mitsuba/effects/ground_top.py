"""Effect ``ground_top``: the crystal's top face is ground, not polished."""

from mcrim_mitsuba.effects._bench import one_side

EFFECT = one_side(
    "top",
    "top face",
    ground=True,
    look=(
        "Look at the top face with a loupe: if it is ground it is dull. Put a drop of oil on it: "
        "the readings change."
    ),
    physics=(
        "The face opposite the detector is often left as it was cut, since nobody looks through "
        "it: facets that are tilted by tens of degrees (GGX, width alpha), as in ground, on this "
        "face alone."
    ),
)
