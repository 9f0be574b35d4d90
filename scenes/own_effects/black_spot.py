"""An effect of one's own: a black square spot in the middle of the crystal's top face.

A campaign switches this folder on with   effects_folder = "own_effects".   All that an effect
needs is in this file: what it is, what its parameter means, and how the scene changes.
"""

from mcrim_mitsuba.effects.effect import Effect, EffectParameter


def edit(editor):
    """The top face becomes a frame around a spot that absorbs what reaches it from inside."""
    top = editor.by_id["crystal_top"]
    at_the_top = '<transform name="to_world"><translate z="$crystal_height_mm"/></transform>'
    editor.replace(
        top,
        f"""<shape type="frame" id="crystal_top">
  <float name="outer_width" value="$crystal_width_mm"/>
  <float name="inner_width" value="$spot_width_mm"/>
  {at_the_top}
  <ref id="crystal_to_air"/>
  <ref name="interior" id="crystal"/>
</shape>""",
    )
    editor.insert_after(
        top,
        """<!-- a spot of black paint on the top face -->
<shape type="rectangle" id="black_spot">
  <transform name="to_world">
    <scale x="$spot_width_mm" y="$spot_width_mm"/>
    <scale value="0.5"/>
    <translate z="$crystal_height_mm"/>
  </transform>
  <bsdf type="twosided">
    <bsdf type="diffuse">
      <spectrum name="reflectance" value="0"/>
    </bsdf>
  </bsdf>
  <ref name="interior" id="crystal"/>
</shape>""",
    )


EFFECT = Effect(
    name="black_spot",
    title="black spot on the top face",
    physics=(
        "A label, a drop of glue or a fingerprint in optical contact with the top face absorbs "
        "light that total reflection would have kept in the crystal."
    ),
    source="this file",
    parameters=(
        EffectParameter(
            name="spot_width_mm",
            unit="mm",
            meaning="Width of the square black spot in the middle of the top face",
            minimum=0.0,
            maximum=8.0,
            start=2.0,
            absent=0.0,
            plausible=(0.0, 5.0),
            # where it is simulated; in between a polynomial joins them
            nodes=(1.0, 2.0, 4.0, 6.0, 8.0),
        ),
    ),
    edit=edit,
)
