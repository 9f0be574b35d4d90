"""Fast path: the scene's few flat faces are intersected in vector registers.

A bench has about twenty flat faces; testing each of them without a tree, without
virtual calls and with the loop's state in registers is several times faster
than `scene.ray_intersect`. Plane equations are exact, so there is no epsilon
by which a ray is moved off a face, and thin gaps do not leak.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel import surface_physics
from mcrim_mitsuba.kernel.scene_model import OTHER, SceneModel, opaque

#: More faces than this and a tree is faster.
MOST_FACES = 64
#: The number of no face.
NO_FACE = 0xFFFFFFFF
#: Beyond which component of a unit normal a face counts as perpendicular to an axis.
AXIS_ALIGNED = 1.0 - 1e-7


def suits(model: SceneModel) -> bool:
    """Whether the fast path can follow light through this scene."""
    return (
        model.faces is not None
        and len(model.faces) <= MOST_FACES
        and all(surface.kind != OTHER for surface in model.surfaces)
    )


@dataclass(frozen=True)
class _Rectangle:
    """A face perpendicular to an axis; numbers are opaque, the rest is literal in the kernel."""

    axis: int
    positive: bool
    plane: object
    middle: dict[int, object]
    half: dict[int, object]


@dataclass(frozen=True)
class _Oblique:
    """A face at any angle: coordinates along its edges by the dual basis, in mm."""

    triangle: bool
    normal: object
    corner: object
    dual: list
    extent: list

    def inside(self, point, slack):
        """Whether a point of the plane (from the corner) lies on the face."""
        u, v = (dr.dot(point, row) for row in self.dual)
        inside = (u >= -slack) & (v >= -slack)
        if self.triangle:
            share = u / self.extent[0] + v / self.extent[1]
            return inside & (share <= 1.0 + slack / self.extent[0])
        return inside & (u <= self.extent[0] + slack) & (v <= self.extent[1] + slack)


@dataclass(frozen=True)
class _Test:
    """One face, or two opposite faces of a box, to be tested against a ray.

    Attributes
    ----------
    faces : tuple of int
        Numbers of the faces; of two, the one whose normal points along the axis comes first.
    sides : tuple of int
        Interior and exterior volume.
    shape : _Rectangle or _Oblique
        Of the first face.
    below : Float or None
        Plane of the second face.
    """

    faces: tuple[int, ...]
    sides: tuple[int, int]
    shape: _Rectangle | _Oblique
    below: object = None

    def faces_back(self, other: _Test) -> bool:
        """Whether the two are opposite faces of one box."""
        one, two = self.shape, other.shape
        if self.below is not None or not (
            isinstance(one, _Rectangle) and isinstance(two, _Rectangle)
        ):
            return False
        return (
            self.sides == other.sides
            and self.sides[0] != self.sides[1]
            and one.axis == two.axis
            and one.positive != two.positive
            # the same number is the same object, see `FlatPath._number`
            and {i: id(x) for i, x in one.half.items()} == {i: id(x) for i, x in two.half.items()}
            and {i: id(x) for i, x in one.middle.items()}
            == {i: id(x) for i, x in two.middle.items()}
        )


class FlatPath:
    """Intersection and interaction with a scene of flat faces.

    Parameters
    ----------
    model : SceneModel
        A scene for which `suits` is true.
    polarization : bool
        Whether photons carry a field, see `surface_physics`.
    """

    name = "flat faces in registers"
    #: Whether a surface can take light that is counted neither as mask nor as reflector.
    surfaces_may_absorb = False

    def __init__(self, model: SceneModel, polarization: bool) -> None:
        self.model = model
        self.polarization = polarization
        faces = model.faces
        # Slack where faces meet: rounding of positions of the scene's size in single
        # precision, so that no ray slips out between two faces.
        self._slack_mm = 4e-7 * model.size_mm
        self._numbers: dict[float, mi.Float] = {}
        self._tests = self._pair([self._register(i, face) for i, face in enumerate(faces)])
        surfaces = [model.surfaces[face.surface] for face in faces]
        self._tables = surface_physics.SurfaceTables(surfaces, [face.normal for face in faces])

    def _number(self, value: float):
        """A number of the kernel; faces that share it also share what is computed from it."""
        key = float(np.float32(value))
        if key not in self._numbers:
            self._numbers[key] = opaque([key])
        return self._numbers[key]

    def _register(self, number: int, face) -> _Test:
        """Numbers of one face as opaque arrays, with what is literal in the kernel."""
        surface = self.model.surfaces[face.surface]
        sides = (surface.interior, surface.exterior)
        axis = int(np.argmax(np.abs(face.normal)))
        edges = (face.edge_u, face.edge_v)
        aligned = not face.triangle and all(
            np.abs(v).max() > AXIS_ALIGNED * np.linalg.norm(v) for v in (face.normal, *edges)
        )
        if not aligned:
            return _Test((number,), sides, self._oblique(face))
        far = face.corner + face.edge_u + face.edge_v
        middle, half = (face.corner + far) / 2, np.abs(far - face.corner) / 2
        others = [other for other in range(3) if other != axis]
        rectangle = _Rectangle(
            axis=axis,
            positive=bool(face.normal[axis] > 0),
            plane=self._number(face.corner[axis]),
            # most faces of a bench are centred on an axis: nothing to subtract there
            middle={i: self._number(middle[i]) for i in others if abs(middle[i]) > self._slack_mm},
            half={i: self._number(half[i] + self._slack_mm) for i in others},
        )
        return _Test((number,), sides, rectangle)

    def _oblique(self, face) -> _Oblique:
        """A face at any angle."""
        # Rows of the dual basis give the coordinates along the edges; they are divided
        # so that a slack in mm can be compared with them.
        basis = np.column_stack([face.edge_u, face.edge_v, face.normal])
        dual = np.linalg.inv(basis)[:2]
        extent = 1.0 / np.linalg.norm(dual, axis=1)
        return _Oblique(
            triangle=face.triangle,
            normal=opaque_vector(face.normal),
            corner=opaque_vector(face.corner),
            dual=[opaque_vector(row * length) for row, length in zip(dual, extent, strict=True)],
            extent=[opaque([length]) for length in extent],
        )

    @staticmethod
    def _pair(tests: list[_Test]) -> list[_Test]:
        """Join opposite faces of a box: a photon can meet only one of the two ahead."""
        joined: list[_Test] = []
        for test in tests:
            partner = next((t for t in joined if t.faces_back(test)), None)
            if partner is None:
                joined.append(test)
            else:
                joined.remove(partner)
                up, down = (test, partner) if test.shape.positive else (partner, test)
                joined.append(
                    _Test(up.faces + down.faces, up.sides, up.shape, below=down.shape.plane)
                )
        return joined

    def intersect(self, ray_o, ray_d, last_face, volume):
        """Nearest face ahead.

        A face is met only from the volume that it borders, and never the face
        that the photon is on; so a point that rounding has put just behind a face
        near an edge still meets that face, at a distance of (nearly) zero.

        Returns
        -------
        distance : Float
            In mm; infinite where nothing is ahead.
        face : UInt32
        """
        reciprocal = dr.rcp(ray_d)
        offset = ray_o * reciprocal
        best, which = mi.Float(dr.inf), mi.UInt32(NO_FACE)
        slack, behind = self._number(self._slack_mm), self._number(-100.0 * self._slack_mm)
        here = [volume == number for number in range(len(self.model.volumes))]
        for test in self._tests:
            interior, exterior = test.sides
            number, shape = mi.UInt32(test.faces[0]), test.shape
            if isinstance(shape, _Rectangle):
                upwards = ray_d[shape.axis] > 0
                plane = shape.plane
                if test.below is not None:
                    # from inside the face that looks along the flight, from outside the other
                    upper = upwards == here[interior]
                    plane = dr.select(upper, plane, test.below)
                    number = dr.select(upper, number, mi.UInt32(test.faces[1]))
                t = dr.fma(plane, reciprocal[shape.axis], -offset[shape.axis])
                inside = mi.Mask(True)
                for i, half in shape.half.items():
                    along = dr.fma(t, ray_d[i], ray_o[i])
                    if i in shape.middle:
                        along -= shape.middle[i]
                    inside &= dr.abs(along) <= half
                leaving = upwards if shape.positive else ~upwards
            else:
                towards = dr.dot(ray_d, shape.normal)
                from_corner = ray_o - shape.corner
                t = -dr.dot(from_corner, shape.normal) / towards
                inside = shape.inside(dr.fma(ray_d, t, from_corner), slack)
                leaving = towards > 0
            if test.below is not None:
                ahead = (t > behind) & (here[interior] | here[exterior])
            elif interior != exterior:
                bordering = (leaving & here[interior]) | (~leaving & here[exterior])
                ahead = (t > behind) & bordering
            else:
                ahead = t > 0.0
            hit = ahead & inside & (t < best) & (last_face != number)
            best = dr.select(hit, t, best)
            which = dr.select(hit, number, which)
        return dr.maximum(best, 0.0), which

    @staticmethod
    def face_of(face):
        """Number (UInt32) of the face that `intersect` found."""
        return face

    def interact(self, position, direction, field, face, uniforms, active):
        """What happens at the face: see `surface_physics.interact`."""
        row = self._tables.at(face, active)
        outcome = surface_physics.interact(
            row, position, direction, field, row.normal, uniforms, self.polarization
        )
        leaving = dr.dot(direction, row.normal) > 0
        # it ends up behind the face if it left from there and was turned back, or came through
        outcome.volume = dr.select(outcome.crossed ^ leaving, row.interior, row.exterior)
        outcome.position = position
        return outcome


def opaque_vector(values):
    """A Vector3f of three opaque numbers."""
    return mi.Vector3f(*(opaque([value]) for value in values))
