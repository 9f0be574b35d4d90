"""Effect ``surface_roughness``: the crystal's faces are not perfectly flat."""

from functools import partial

from mcrim_mitsuba.effects._bench import FACETS, POLISHED, polish_crystal
from mcrim_mitsuba.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    name="surface_roughness",
    title="roughness of all crystal faces",
    family="surface",
    look=(
        "Look at the reflection of a lamp in each face: it is blurred if the face is rough. "
        "Measure the transmittance within 1 and within 30 degrees."
    ),
    physics=(
        "A face that was ground but poorly polished is made of small facets with tilted normals; "
        "light meets one of them and is reflected or refracted there by Fresnel's formulas. The "
        "tilts (GGX distribution, width alpha, the tangent of a typical tilt) let trapped light "
        "out after some reflections. It goes from facet to facet until it leaves the face, to the "
        "front or to the back (Smith's field of heights): nothing is lost there. A polished face "
        "has alpha of 0.05 at most: see ground."
    ),
    source=FACETS,
    parameters=(
        EffectParameter(
            name="roughness_alpha",
            unit="",
            meaning="Roughness of the crystal's faces (GGX), the tangent of a typical tilt",
            minimum=0.0,
            maximum=0.3,
            start=0.05,
            absent=0.0,
            plausible=(0.0, POLISHED),
            nodes=(0.012, 0.035, 0.08, 0.16, 0.3),
            # trapped light meets many facets: it is freed by small slopes already
            coordinate="logarithmic",
            scale=0.03,
        ),
    ),
    excludes=(
        *("top_roughness", "side_roughness", "bottom_roughness"),
        *("ground", "ground_top", "ground_side", "ground_bottom"),
    ),
    edit=partial(polish_crystal, name="roughness_alpha", value="$roughness_alpha"),
)
