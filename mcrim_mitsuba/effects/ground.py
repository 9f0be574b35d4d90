"""Effect ``ground``: all faces of the crystal are ground, not polished."""

from __future__ import annotations

from functools import partial

from mcrim_mitsuba.effects._bench import FACETS, facets_of, polish_crystal
from mcrim_mitsuba.effects.effect import Effect

EFFECT = Effect(
    name="ground",
    title="ground faces",
    family="surface",
    look=(
        "Look at the faces with a loupe: a ground face is dull, and shows no reflection of a "
        "lamp. Ask the maker which faces were polished."
    ),
    physics=(
        "A face that was cut or ground and never polished consists of facets that are tilted by "
        "tens of degrees (GGX, width alpha); light goes from one to the other until it leaves, to "
        "the front or to the back. Of trapped light such a face lets out a part each time. Facets "
        "of alpha 0.1 to 0.6 are ground; less is a poor polish: see surface_roughness."
    ),
    source=FACETS,
    parameters=(facets_of("ground_alpha", "faces", ground=True),),
    excludes=(
        *("surface_roughness", "top_roughness", "side_roughness", "bottom_roughness"),
        *("ground_top", "ground_side", "ground_bottom"),
    ),
    edit=partial(polish_crystal, name="roughness_alpha", value="$ground_alpha"),
)
