"""Effect ``ground_bottom``: the crystal's bottom face is ground, not polished."""

from mcrim_mitsuba.effects._bench import one_side

EFFECT = one_side(
    "bottom",
    "bottom face",
    ground=True,
    look=(
        "Take the crystal off and look at its bottom face with a loupe: a ground one is dull, "
        "and clear only while a liquid covers it."
    ),
    physics=(
        "The crystal may stand on a face that was cut and not polished: facets that are tilted by "
        "tens of degrees (GGX, width alpha), as in ground, on this face alone. A liquid nearly "
        "matches them, air does not: such a face changes the ratio of the readings most."
    ),
)
