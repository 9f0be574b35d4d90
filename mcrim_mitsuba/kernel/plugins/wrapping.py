"""Shape plugin ``wrapping``: five faces around a box that is open at the bottom."""

from __future__ import annotations

import mitsuba as mi

from mcrim_mitsuba.kernel.flat_mesh import set_polygons


class Wrapping(mi.Mesh):
    """A reflective wrapping around a box-shaped crystal, behind a film of air.

    Four walls and a lid whose normals point at the crystal; the box that they wrap stands on
    z = 0, centred on the z axis of its own coordinates. XML: ``<shape type="wrapping">`` with

    ``width``, ``height`` : float
        Of what is wrapped, in the scene's millimetres.
    ``film`` : float
        Thickness of the air between it and the wrapping.
    ``to_world`` : transform
        Where it stands in the scene.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        width, height, film = (float(props[name]) for name in ("width", "height", "film"))
        to_world = props.get("to_world", mi.ScalarTransform4f())
        if not min(width, height, film) > 0.0:
            raise ValueError("a wrapping's width, height and film must be positive")
        self.size = (width, height, film)
        a, top = width / 2 + film, height + film
        ring = [(-a, -a), (a, -a), (a, a), (-a, a)]
        # Seen from inside, corners run anticlockwise, so that normals point inwards.
        quads = [
            [(*ring[(i + 1) % 4], 0.0), (*ring[i], 0.0), (*ring[i], top), (*ring[(i + 1) % 4], top)]
            for i in range(4)
        ]
        quads.append([(x, y, top) for x, y in reversed(ring)])
        set_polygons(self, quads, to_world)

    def to_string(self) -> str:
        return "Wrapping[width = {}, height = {}, film = {}]".format(*self.size)


mi.register_shape("wrapping", Wrapping)
