"""Where photons are born: uniformly in the volume that the crystal's faces enclose."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel.scene_model import SceneModel, opaque, surface_numbers

#: Candidates per wanted birth after which a volume counts as empty.
MOST_ROUNDS = 1000


class CrystalVolume:
    """The volume inside the shapes that border a medium.

    A parallelepiped of flat faces is sampled directly; any other closed solid by rejection from its
    bounding box, a point being inside when the first face that it sees has the medium on
    the near side.

    Parameters
    ----------
    model : SceneModel
    volume : int
        Index of the medium among ``model.volumes``.

    Attributes
    ----------
    frame : tuple of ndarray or None
        Corner and three edge vectors (float64, mm) of a parallelepiped.
    lower, upper : ndarray
        Bounding box, float64, shape (3,), mm.
    """

    def __init__(self, model: SceneModel, volume: int) -> None:
        self.model = model
        self.volume = volume
        owned = [i for i, s in enumerate(model.surfaces) if volume in (s.interior, s.exterior)]
        if not owned:
            raise InputError(
                f"no shape has the emitting medium {model.volumes[volume].name!r} inside",
                'give the crystal\'s faces <ref name="interior" id="..."/> of that medium',
            )
        boxes = [model.scene.shapes()[i].bbox() for i in owned]
        self.lower = np.min([np.array(b.min, dtype=np.float64) for b in boxes], axis=0)
        self.upper = np.max([np.array(b.max, dtype=np.float64) for b in boxes], axis=0)
        self.frame = None
        if model.faces is not None:
            self.frame = _parallelepiped([f for f in model.faces if f.surface in owned])
        if self.frame is not None:
            self._corner = mi.Point3f(*(opaque([v]) for v in self.frame[0]))
            self._edges = [mi.Vector3f(*(opaque([v]) for v in e)) for e in self.frame[1:]]

    @property
    def scatters(self) -> bool:
        """Whether the medium scatters light."""
        return self.model.volumes[self.volume].alpha_scat_per_mm > 0

    @property
    def direct(self) -> bool:
        """Whether `from_uniforms` can be used."""
        return self.frame is not None

    def from_uniforms(self, a, b, c):
        """A uniform point (Point3f, mm) of a parallelepiped from three uniforms (Float)."""
        u, v, w = self._edges
        return self._corner + u * a + v * b + w * c

    def sample(self, rng, count: int):
        """`count` uniform points (Point3f, mm) of any closed solid, by rejection.

        Parameters
        ----------
        rng : mitsuba.PCG32
            Of width `count`; advanced in place.
        """
        lower = mi.Point3f(*(opaque([v]) for v in self.lower))
        extent = mi.Vector3f(*(opaque([v]) for v in self.upper - self.lower))
        interior = opaque([s.interior == self.volume for s in self.model.surfaces], mi.Bool)
        exterior = opaque([s.exterior == self.volume for s in self.model.surfaces], mi.Bool)
        number_of = surface_numbers(self.model)

        def inside(point):
            # an oblique direction, which no bench has a face along
            probe = mi.Ray3f(point, mi.Vector3f(0.2672612, 0.5345225, 0.8017837))
            si = self.model.scene.ray_intersect(probe, mi.RayFlags.Minimal, coherent=False)
            hit = si.is_valid()
            number = number_of(si.shape, hit)
            behind = dr.dot(probe.d, si.n) > 0
            own = dr.select(
                behind,
                dr.gather(mi.Bool, interior, number, hit),
                dr.gather(mi.Bool, exterior, number, hit),
            )
            return hit & own

        def body(point, searching, rng, rounds):
            candidate = mi.Point3f(
                dr.fma(extent.x, rng.next_float32(), lower.x),
                dr.fma(extent.y, rng.next_float32(), lower.y),
                dr.fma(extent.z, rng.next_float32(), lower.z),
            )
            point = dr.select(searching, candidate, point)
            rounds += 1
            searching = searching & ~inside(point) & (rounds < MOST_ROUNDS)
            return point, searching, rng, rounds

        point, _, rng, rounds = dr.while_loop(
            state=(dr.zeros(mi.Point3f, count), dr.full(mi.Bool, True, count), rng,
                   dr.zeros(mi.UInt32, count)),
            cond=lambda point, searching, rng, rounds: searching,
            body=body,
            labels=("point", "searching", "rng", "rounds"),
        )  # fmt: skip
        if int(dr.max(rounds)[0]) >= MOST_ROUNDS:
            raise InputError(
                f"the shapes around medium {self.model.volumes[self.volume].name!r} enclose no "
                "volume",
                "close the crystal: every face needs the medium on its inner side",
            )
        return point


def _parallelepiped(faces):
    """Corner and edges of the parallelepiped whose six faces are given, or ``None``."""
    if len(faces) != 6 or any(face.triangle for face in faces):
        return None
    corners = np.concatenate(
        [
            [f.corner, f.corner + f.edge_u, f.corner + f.edge_v, f.corner + f.edge_u + f.edge_v]
            for f in faces
        ]
    )
    size = np.ptp(corners, axis=0).max()
    corner, u, v = faces[0].corner, faces[0].edge_u, faces[0].edge_v
    # The third edge leads from the first face to the corner of the opposite one.
    for candidate in corners:
        w = candidate - corner
        if abs(w @ faces[0].normal) < 1e-5 * size:
            continue
        expected = corner + np.array(
            [a * u + b * v + c * w for a in (0, 1) for b in (0, 1) for c in (0, 1)]
        )
        gaps = np.abs(corners[:, None, :] - expected[None]).max(axis=2)
        if gaps.min(axis=1).max() < 1e-5 * size and gaps.min(axis=0).max() < 1e-5 * size:
            return corner, u, v, w
    return None
