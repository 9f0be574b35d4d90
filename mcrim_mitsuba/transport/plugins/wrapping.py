"""The shape plugin wrapping: a reflector around a crystal, behind a film of air or painted on."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.core.errors import did_you_mean
from mcrim_mitsuba.transport.plugins import number, shapes
from mcrim_mitsuba.transport.scene_model import AROUND, Circle, RoundWall

#: What ``without`` may name besides the sides of four.
TOP = "top"
SIDES = "sides"
#: That nothing is left out.
NONE = "none"
#: The plane on which what is wrapped stands.
FOOT = "foot"
#: Of four sides, in the order of `regular_polygon`.
FOUR = ("right", "back", "left", "front")
#: How far a wrapping may be off the upright, in parts of its size: rounding.
_ASKEW = 1e-6


class Wrapping(shapes.Polygons):
    """A reflector around an upright box, cylinder or prism: walls and a lid, which face it.

    What it wraps stands on z = 0, about the z axis of its own coordinates. XML:
    ``<shape type="wrapping">`` with

    ``width`` or ``diameter`` : float
        Of what is wrapped, in the scene's millimetres: across flats, or of a cylinder.
    ``sides`` : integer, default 4
        Of what has a ``width``; one is across the x axis.
    ``height`` : float
        Of what is wrapped.
    ``film`` : float
        Thickness of the air between it and the reflector. 0 is paint: the reflector is on the faces
        themselves, and light meets it at once, from inside and from outside.
    ``without`` : string, optional
        What is left out: ``top``, ``sides``, and of four sides ``right``, ``left`` (of x),
        ``back``, ``front`` (of y), with blanks between; or ``none``.
    ``missing`` : float, default 0
        Part of the sides, from their foot upwards, that is bare; below 1.
    ``contact`` : float, default 0
        Probability that light from inside finds no film before the reflector, each time it meets a
        face of what is wrapped. With paint it never finds one.
    ``specular`` : float, default 0
        Part of what its ``diffuse`` bsdf reflects that goes as from a mirror instead; pictures do
        not show it.
    ``to_world`` : transform, optional
        It may move it, and turn it about z.
    """

    def polygons(self, props, to_world):
        turn = to_world[:3, :3]
        upright = np.abs(turn[2] - (0.0, 0.0, 1.0)).max() <= _ASKEW
        if not upright or np.abs(turn @ turn.T - np.eye(3)).max() > _ASKEW:
            raise ValueError(
                "a wrapping stands upright: its to_world may move it and turn it about z; around "
                "a cylinder that lies write a cylinder and two disks that reflect"
            )
        if ("width" in props) == ("diameter" in props):
            raise ValueError("a wrapping has a width, or the diameter of a cylinder")
        self.round = "diameter" in props
        if self.round and "sides" in props:
            raise ValueError("a wrapping has a diameter, or a width and sides")
        self.width = float(props["diameter" if self.round else "width"])
        self.height, self.film = (float(props[name]) for name in ("height", "film"))
        if not min(self.width, self.height) > 0.0 or not self.film >= 0.0:
            raise ValueError("a wrapping's width and height must be positive, its film 0 or more")
        self.contact, self.specular = (number(props, n, 0.0) for n in ("contact", "specular"))
        self.bare = self.height * number(props, "missing", 0.0, high=0.99)
        count = AROUND if self.round else shapes.sides_of(props)
        sides = FOUR if count == 4 else (SIDES,) * count
        words = str(props.get("without", NONE)).replace(",", " ").split()
        self.without = [] if words == [NONE] else words
        for word in self.without:
            if word not in (known := (TOP, *dict.fromkeys((SIDES, *sides)))):
                mend = did_you_mean(word, (*known, NONE))
                mend = f"{NONE} stands alone; leave it out" if word == NONE else mend
                raise ValueError(f"a wrapping's without is {word!r}: {mend}")
        names = (TOP, FOOT, *sides)
        #: What bounds what is wrapped: whether it is left out, normals outwards, shape (n, 3), and
        #: how far from the scene's origin along these, mm. The top is the first, the foot next.
        missing = [n in self.without or (n in sides and SIDES in self.without) for n in names]
        self.open = np.array(missing)
        angles = 2.0 * np.pi / count * np.arange(count)
        normals = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
        self.normals = np.vstack([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), normals]) @ turn.T
        self.offsets = np.array([self.height, 0.0, *[self.width / 2.0] * count])
        self.offsets += self.normals @ to_world[:3, 3]
        return [] if self.is_paint else self._reflector(to_world)

    @property
    def is_paint(self) -> bool:
        """Whether it is on the faces themselves, and has none of its own."""
        return self.film == 0.0

    @property
    def words(self) -> str:
        """What it does, as a sentence goes on after its id."""
        across = f"{self.width:g} mm {'in diameter' if self.round else 'wide'}"
        text = f"what is {across} and {self.height:g} mm high"
        if self.is_paint:
            text = f"is painted on {text}"
        else:
            text = f"wraps {text}, behind {self.film:g} mm of air"
        bare = [*self.without, *([f"the lowest {self.bare:g} mm"] if self.bare else [])]
        return f"{text}; bare: {', '.join(bare)}" if bare else text

    def _reflector(self, to_world: np.ndarray) -> list[np.ndarray]:
        """The polygons of walls and lid, and if it is round what these are drawn for."""
        count, wide = len(self.open) - 2, self.width + 2.0 * self.film
        lid, walls = not self.open[0], ~self.open[2:]
        top = self.height + (self.film if lid else 0.0)
        low, high = np.array([(0.0, 0.0, self.bare), (0.0, 0.0, top)])
        ring = shapes.regular_polygon(count, wide)
        # seen from inside, corners run anticlockwise, so that normals point inwards
        polygons = [
            np.array([start + low, end + low, end + high, start + high])
            for end, start, wall in zip(ring, np.roll(ring, -1, axis=0), walls, strict=True)
            if wall
        ]
        if lid:
            whole = [ring] if self.round else shapes.polygon_faces(count, wide)
            polygons += [face[::-1] + high for face in whole]
        if self.round:
            x, y, z = to_world[:3, 3].tolist()
            circle = Circle((x, y), wide / 2.0)
            if walls.any():
                self.wall = RoundWall(circle, z + self.bare, z + top, -1)
            if lid:
                across, deep = np.array([(wide, 0.0, 0.0), (0.0, wide, 0.0)])
                corner = np.array([x, y, z + top]) - (across + deep) / 2.0
                self.round_faces = ((corner, deep, across, circle),)
        return polygons

    def beyond(self, points: np.ndarray) -> np.ndarray:
        """How far points, shape (n, 3), lie beyond each bound, shape (bounds, n), mm."""
        return self.normals @ points.T - self.offsets[:, None]


mi.register_shape("wrapping", Wrapping)
