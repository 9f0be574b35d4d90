"""Effect ``ground_side``: the crystal's four side faces are ground, not polished."""

from mcrim_mitsuba.effects._bench import one_side

EFFECT = one_side(
    "side",
    "side faces",
    ground=True,
    look=(
        "Look at the sides with a loupe: if they are ground they are dull, and nothing is seen "
        "through them."
    ),
    physics=(
        "The four sides are often ground, on purpose or to save work, while the faces at the ends "
        "are polished: facets that are tilted by tens of degrees (GGX, width alpha), as in ground, "
        "on the sides alone."
    ),
)
