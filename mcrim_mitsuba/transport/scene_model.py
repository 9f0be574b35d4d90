"""What a scene means to the transport: volumes, surfaces and faces as numbers.

They are read from the loaded scene by `transport.conversion`; Mitsuba is not needed here.
"""

from __future__ import annotations

import functools
import math
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.optics.thin_film import ThinFilm

#: Index of the volume outside everything: a face without a medium on a side touches it.
OUTSIDE = 0

#: Ids that no medium may have: the volume outside, and what else light is absorbed by.
RESERVED_NAMES = ("outside", "aperture", "reflector", "surface")

#: Points on the rim of what is round.
AROUND = 180

# Surface kinds, as stored in the tables of the loop.
DIELECTRIC, DETECTOR, DIFFUSE, OTHER = range(4)
KIND_NAMES = ("dielectric", "detector", "diffuse reflector", "other")


@dataclass(frozen=True)
class Volume:
    """A homogeneous volume."""

    #: The medium's id in the scene.
    name: str
    #: Scattering and absorption coefficients in 1/mm.
    alpha_scat_per_mm: float
    alpha_abs_per_mm: float
    #: How it scatters: ``isotropic``, ``hg`` (Henyey-Greenstein) or ``rayleigh``.
    phase: str = "isotropic"
    #: Mean cosine of the scattering angle, of ``hg``.
    scattering_g: float = 0.0
    #: q of the scattering coefficient alpha (1 + q u); u runs from -1 at the bottom of the
    #: volume to 1 at its top, of the shapes that border it.
    scattering_gradient: float = 0.0
    #: p of the coefficient's fall as wavelength^-p, and the band's full width at half maximum over
    #: the wavelength of its maximum.
    scattering_exponent: float = 0.0
    relative_bandwidth: float = 0.0
    #: Whether it is nowhere but for light that has entered it, which goes on as outside.
    endless: bool = False

    @property
    def uneven(self) -> bool:
        """Whether some places, or some of its light, scatter more than others."""
        return bool(self.scattering_gradient or self.scattering_exponent)


@dataclass(frozen=True)
class Surface:
    """A shape of the scene and what light meets there."""

    #: The shape's id in the scene.
    name: str
    #: Volumes behind the face and in front of it; `OUTSIDE` is 0.
    interior: int
    exterior: int
    #: `DIELECTRIC`, `DETECTOR`, `DIFFUSE` or `OTHER`.
    kind: int
    #: Index behind the face over index in front of it; 1 where there is no interface.
    eta: float = 1.0
    #: Of a diffuse reflector, or of a detector.
    reflectance: float = 0.0
    #: Part of what a diffuse reflector reflects that goes as from a mirror instead.
    mirror_part: float = 0.0
    #: Probability that light from the interior finds no film between a dielectric and the wrapping,
    #: and meets that at once.
    contact: float = 0.0
    wrapping: Surface | None = None
    #: The height from which on it does, where it does not everywhere.
    contact_above_mm: float = -np.inf
    #: Whether the reflector is on the face itself: light from the exterior meets it as well.
    painted: bool = False
    #: Whether a diffuse reflector reflects on its back as well.
    two_sided: bool = False
    #: The hole of a mask on the face; the radius is infinite where there is none.
    aperture_radius_mm: float = np.inf
    #: x and y of the axis of the mask, or of a detector.
    axis_mm: tuple[float, float] = (0.0, 0.0)
    #: Part that the mask's upper side reflects diffusely.
    mask_reflectance: float = 0.0
    #: Alpha of a dielectric's microfacets, and whether they are Beckmann's and not GGX's.
    roughness: float = 0.0
    beckmann: bool = False
    #: Part of the light reflected back into the interior that a dielectric's surface takes.
    surface_loss: float = 0.0
    #: Part of the light from the interior that a rough one takes before it reflects or refracts.
    ground_loss: float = 0.0
    #: 2 pi n s / wavelength of a dielectric's fine roughness s, n being the index behind the face.
    haze: float = 0.0
    #: Cosine of the largest angle to the normal that a detector accepts.
    least_cosine: float = 0.0
    #: Part of the light that a detector reflects specularly, or the photocathode that it is.
    specular: float = 0.0
    film: ThinFilm | None = None
    #: a and b of a detector's acceptance (1 - a (1 - cos)) (1 - b r^2), over 1 - a if a < 0.
    angular_falloff: float = 0.0
    radial_falloff_per_mm2: float = 0.0
    #: Number of a detector among the scene's, from 0.
    detector: int = 0
    #: Of a surface of kind `OTHER`: Mitsuba's name for its BSDF.
    plugin: str = ""

    @property
    def seen(self) -> Surface:
        """What is seen of it: the paint on it, or itself."""
        return self.wrapping if self.painted and self.wrapping is not None else self

    @property
    def kind_name(self) -> str:
        """What it is, in words: reflectors by what most of their light does."""
        if self.kind == DIFFUSE and self.reflectance == 0.0:
            return "black surface"
        if self.kind == DIFFUSE and self.mirror_part > 0.5:
            return "mirror"
        return self.plugin if self.kind == OTHER else KIND_NAMES[self.kind]

    @property
    def acceptance_deg(self) -> float:
        """Largest angle to the normal that a detector accepts; 90 where it accepts all."""
        return round(math.degrees(math.acos(self.least_cosine)), 6)

    @property
    def head_on(self) -> float:
        """Part that a detector detects of what arrives head-on on its axis and is not sent back.

        Of a photocathode, of all that arrives. It was calibrated so.
        """
        of_film = 1.0 if self.film is None else self.film.head_on
        return of_film / (1.0 - min(self.angular_falloff, 0.0))

    @property
    def hazy_part(self) -> float:
        """Part that fine roughness scatters of what is reflected inwards at normal incidence."""
        return -math.expm1(-4.0 * self.haze**2)

    @property
    def sides(self) -> tuple[int, int]:
        """The interior and the exterior volume."""
        return self.interior, self.exterior


@dataclass(frozen=True)
class Circle:
    """A circle about a line along one of the scene's axes, within a face across it."""

    #: Where that line is on the two other axes, in their order.
    centre_mm: tuple[float, float]
    radius_mm: float
    #: Whether the face is what lies inside; else that is missing of it.
    inside: bool = True
    #: 0, 1 or 2: the axis that the line is along.
    axis: int = 2

    @property
    def across(self) -> tuple[int, int]:
        """The two other axes."""
        first, second = (axis for axis in range(3) if axis != self.axis)
        return first, second

    @property
    def area(self) -> float:
        """In mm2."""
        return math.pi * self.radius_mm**2

    def points(self, level_mm: float) -> np.ndarray:
        """Points around it at a level on its axis, shape (`AROUND`, 3), mm."""
        angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
        points = np.full((AROUND, 3), level_mm)
        away = self.radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
        points[:, self.across] = away + self.centre_mm
        return points

    def margin(self, points: np.ndarray) -> np.ndarray:
        """How far on the face's side of it points, shape (n, 3), lie, in radii."""
        away = np.hypot(*(points[:, self.across] - self.centre_mm).T) / self.radius_mm
        return 1.0 - away if self.inside else away - 1.0


@dataclass(frozen=True)
class RoundWall:
    """A cylinder's mantle, without its ends."""

    circle: Circle
    #: Lower and upper end, along the circle's axis.
    low_mm: float
    high_mm: float
    surface: int
    #: Whether normals point away from the axis: its interior is what lies within. Else that is what
    #: lies around it.
    outwards: bool = False
    #: Of one that lies, the heights up to which, and from which on, it is there: else all around.
    below_mm: float = math.inf
    above_mm: float = -math.inf

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates: float64, shape (3,), mm."""
        low, high = np.empty(3), np.empty(3)
        circle = self.circle
        low[circle.axis], high[circle.axis] = self.low_mm, self.high_mm
        centre = np.array(circle.centre_mm)
        across = list(circle.across)
        low[across], high[across] = centre - circle.radius_mm, centre + circle.radius_mm
        low[2], high[2] = max(low[2], self.above_mm), min(high[2], self.below_mm)
        if circle.axis != 2:
            # a strip that does not reach as far up, or down, as the axis is narrower
            away = max(low[2] - centre[1], centre[1] - high[2], 0.0)
            half = math.sqrt(max(circle.radius_mm**2 - away**2, 0.0))
            low[across[0]], high[across[0]] = centre[0] - half, centre[0] + half
        return low, high

    def margin(self, points: np.ndarray) -> np.ndarray:
        """How far within its ends and heights points, shape (n, 3), lie, mm."""
        along, z = points[:, self.circle.axis], points[:, 2]
        within = np.minimum(along - self.low_mm, self.high_mm - along)
        return np.minimum(within, np.minimum(self.below_mm - z, z - self.above_mm))


@dataclass(frozen=True)
class FlatFace:
    """A parallelogram or triangle: ``corner + a * edge_u + b * edge_v``.

    With ``a, b`` in [0, 1], and ``a + b <= 1`` for a triangle. Arrays are float64, shape (3,), mm;
    `normal` is the unit vector pointing to the exterior.
    """

    corner: np.ndarray
    edge_u: np.ndarray
    edge_v: np.ndarray
    normal: np.ndarray
    triangle: bool
    surface: int
    #: What of it is left, where only a part is.
    circle: Circle | None = None

    @property
    def corners(self) -> np.ndarray:
        """In their order around the face, shape (3 or 4, 3), mm."""
        beside, opposite = self.corner + self.edge_u, self.corner + self.edge_v
        far = [] if self.triangle else [beside + self.edge_v]
        return np.array([self.corner, beside, *far, opposite])

    @property
    def rim(self) -> np.ndarray:
        """Points around what is left of it, shape (n, 3), mm; it may have a hole."""
        if self.circle is not None and self.circle.inside:
            return self.circle.points(float(self.corner[self.circle.axis]))
        return self.corners

    @property
    def area(self) -> float:
        """In mm2."""
        if self.circle is not None and self.circle.inside:
            return self.circle.area
        return self.filled_area - (self.circle.area if self.circle is not None else 0.0)

    @property
    def filled_area(self) -> float:
        """In mm2, without the hole in it."""
        return float(np.linalg.norm(cross(self.edge_u, self.edge_v))) / (1 + self.triangle)

    def margin(self, points: np.ndarray) -> np.ndarray:
        """How far inside points of its plane, shape (n, 3), lie, in parts of its edges."""
        a, b = self._dual @ (points - self.corner).T
        inside = self._inside(a, b)
        return inside if self.circle is None else np.minimum(inside, self.circle.margin(points))

    def meeting(self, starts: np.ndarray, ways: np.ndarray) -> tuple[np.ndarray, ...]:
        """How far along lines, shape (3, n), its plane is, mm; `margin` there; if met from inside.

        Within straight edges all are linear along a line, and no points are made in between.
        """
        axes = np.vstack([self._dual, self.normal])
        a, b, above = axes @ starts - (axes @ self.corner)[:, None]
        along_u, along_v, towards = axes @ ways
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -above / towards
            if self.circle is not None:
                return t, self.margin((starts + t * ways).T), towards > 0
            return t, self._inside(a + t * along_u, b + t * along_v), towards > 0

    @functools.cached_property
    def _dual(self) -> np.ndarray:
        """What, times a vector of its plane, gives its parts of the two edges, shape (2, 3)."""
        return np.linalg.inv(np.column_stack([self.edge_u, self.edge_v, self.normal]))[:2]

    def _inside(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.minimum(np.minimum(a, b), 1 - a - b if self.triangle else 1 - np.maximum(a, b))


@dataclass(frozen=True, eq=False)
class SceneModel:
    """A loaded scene as the transport sees it."""

    scene: Any
    #: Those of ``scene.shapes()`` that have a surface: a plugin's shape that is empty, such as
    #: a chamfer of no width, is left out.
    shapes: tuple[Any, ...]
    #: The first one is the outside.
    volumes: tuple[Volume, ...]
    #: In the order of `shapes`.
    surfaces: tuple[Surface, ...]
    #: Faces of all surfaces that are flat.
    flat_faces: tuple[FlatFace, ...]
    #: Indices of the surfaces that are not, and are no walls either.
    curved: tuple[int, ...]
    #: Largest distance of any point of the scene from the origin.
    size_mm: float
    #: Surfaces that are upright round walls.
    walls: tuple[RoundWall, ...] = ()
    #: Number of the detector whose light alone is eta; None: that of all is.
    counted: int | None = None
    #: What is possible, but seldom meant.
    notes: tuple[str, ...] = ()

    @functools.cached_property
    def geometry(self) -> Hashable:
        """Where its faces and walls are and what they part; equal for models that agree in it."""
        faces = tuple(
            (np.array([f.corner, f.edge_u, f.edge_v]).tobytes(), f.triangle, f.surface, f.circle)
            for f in self.flat_faces
        )
        sides = tuple(surface.sides for surface in self.surfaces)
        return faces, self.walls, sides, len(self.volumes), self.endless, self.size_mm

    @functools.cached_property
    def endless(self) -> int | None:
        """Index of the volume that is endless; ``None`` where there is none."""
        return next((i for i, volume in enumerate(self.volumes) if volume.endless), None)

    def open_to(self, surface: Surface) -> Surface:
        """A face as light meets it that is in the endless volume, or outside of a wetted face.

        Either is the other's neighbour then: its index and its number take the place of what the
        face names.
        """
        assert self.endless is not None
        other = {OUTSIDE: self.endless, self.endless: OUTSIDE}
        inner, outer = (other.get(side, side) for side in surface.sides)
        # an interface's eta is the index of its interior over that of its exterior
        power = {OUTSIDE: 1, self.endless: -1}
        of_inner, of_outer = (power.get(side, 0) for side in surface.sides)
        ratio = self._endless_index ** (of_inner - of_outer)
        eta = surface.eta * ratio if surface.kind == DIELECTRIC else surface.eta
        return replace(surface, interior=inner, exterior=outer, eta=eta)

    @functools.cached_property
    def _endless_index(self) -> float:
        """Index of the endless volume, that outside being 1: from faces of what borders both."""
        interfaces = [s for s in self.surfaces if s.kind == DIELECTRIC]
        wet = {s.interior: s.eta for s in interfaces if s.exterior == self.endless}
        dry = {s.interior: s.eta for s in interfaces if s.exterior == OUTSIDE}
        for volume in wet.keys() & dry.keys():
            return dry[volume] / wet[volume]
        name = self.volumes[self.endless or OUTSIDE].name
        problem = f"the index of {name!r} is not known: no volume borders both it and air"
        raise InputError(problem, "let one volume border both, or write ext_ior without the medium")

    @property
    def faces(self) -> tuple[FlatFace, ...] | None:
        """All faces of a scene of flat faces, round walls apart; ``None`` where one is curved."""
        return None if self.curved else self.flat_faces

    @property
    def head_on(self) -> float:
        """What its detectors, all alike, detect of light that arrives head-on."""
        return next((s.head_on for s in self.surfaces if s.kind == DETECTOR), 1.0)

    @property
    def detectors(self) -> list[str]:
        """Names of the detectors, by number."""
        return [surface.name for surface in self.surfaces if surface.kind == DETECTOR]

    def turned_from(self, point: np.ndarray) -> list[str]:
        """Names of reflectors of which a point, shape (3,), mm, sees the black back alone."""
        one_sided = {
            number: surface.name
            for number, surface in enumerate(self.surfaces)
            if surface.kind == DIFFUSE and surface.reflectance and not surface.two_sided
        }
        seen = {f.surface for f in self.flat_faces if f.normal @ (point - f.corner) > 0.0}
        flat = {face.surface for face in self.flat_faces}
        return [one_sided[number] for number in sorted(one_sided.keys() & flat - seen)]

    def bordering(self, volume: int) -> list[int]:
        """Indices of the surfaces that border a volume."""
        return [i for i, surface in enumerate(self.surfaces) if volume in surface.sides]

    def bounds(self, volume: int) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates of a volume: float64, shape (3,), mm."""
        walls = {wall.surface: wall.bounds() for wall in self.walls}
        boxes = [walls[i] if i in walls else box_of(self.shapes[i]) for i in self.bordering(volume)]
        return np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)

    def within(self, wall: RoundWall) -> int:
        """Index of the volume that lies within a round wall."""
        return self.surfaces[wall.surface].sides[not wall.outwards]

    def around(self, wall: RoundWall) -> int:
        """Index of the volume that lies around it."""
        return self.surfaces[wall.surface].sides[wall.outwards]

    def volume_index(self, medium) -> int:
        """Index of a Mitsuba medium among `volumes`; InputError if no face borders it."""
        if medium.id() not in self.volume_names:
            mend = 'name it on the faces around it: <ref name="interior" ...> or "exterior"'
            raise InputError(f"no face borders the medium {medium.id()!r}", mend)
        return self.volume_names.index(medium.id())

    @property
    def volume_names(self) -> list[str]:
        """Names of the volumes, in their order; air comes first."""
        return [volume.name for volume in self.volumes]


_Found = TypeVar("_Found")


class Kept(Generic[_Found]):
    """What was found of the last benches, so many of them: those that follow are often alike."""

    def __init__(self, most: int) -> None:
        self._most, self._found = most, dict[Hashable, _Found]()
        self._one_at_a_time = threading.Lock()

    def of(self, key: Hashable, find: Callable[[], _Found]) -> _Found:
        """What was found of a bench like this one, or is now; the oldest makes room."""
        with self._one_at_a_time:
            if key not in self._found:
                self._found[key] = find()
                if len(self._found) > self._most:
                    del self._found[next(iter(self._found))]
            return self._found[key]


def box_of(shape) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates of a shape: float64, shape (3,), mm."""
    box = shape.bbox()
    return np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of two vectors; numpy's own takes twenty times as long for so few."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
