"""Where light arrives and where it was born: a flat detector's plane, and photons one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.transport.launch_plan import FateTally
from mcrim_mitsuba.transport.loop import Launch
from mcrim_mitsuba.transport.record_store import ARRIVAL_PLACE, BIRTH_PLACE
from mcrim_mitsuba.transport.scene_model import DETECTOR, SceneModel
from mcrim_mitsuba.transport.simulation import Simulation

#: How far detecting faces may lie off one plane, over the scene's size.
_FLAT = 1e-4
#: Points around at which it is looked whether a ring lies on the detector.
_AROUND = 720
#: Radii per ring, or places along a cell, at which it is looked.
_RADII = 8


@dataclass(frozen=True, eq=False)
class DetectorPlane:
    """A flat detector in its own coordinates; arrays are float64."""

    #: ndarray, shape (3,): Middle of the rectangle around the detector, mm: the origin.
    centre: np.ndarray
    #: ndarray, shape (2, 3): Unit vectors of x and y in the plane. Those of the scene where the
    #: detector is horizontal.
    axes: np.ndarray
    #: ndarray, shape (3,): Unit vector.
    normal: np.ndarray
    #: tuple of ndarray, shape (3 or 4, 2): Corners of the detecting faces in the plane, mm, in
    #: order.
    faces: tuple[np.ndarray, ...]

    @property
    def half_mm(self) -> np.ndarray:
        """Half the widths along x and y of the rectangle around the detector, shape (2,)."""
        return np.abs(np.concatenate(self.faces)).max(axis=0)

    def coordinates(self, points) -> np.ndarray:
        """x and y in the plane (mm), shape (n, 2), of points of the scene, shape (n, 3)."""
        return (np.asarray(points) - self.centre) @ self.axes.T

    def on_detector(self, points) -> np.ndarray:
        """Whether points of the plane, shape (n, 2), lie on a detecting face."""
        hit = np.zeros(len(points), dtype=bool)
        for corners in self.faces:
            edges = np.roll(corners, -1, axis=0) - corners
            away = points[:, None] - corners
            turns = edges[:, 0] * away[..., 1] - edges[:, 1] * away[..., 0]
            hit |= (turns >= 0).all(axis=1) | (turns <= 0).all(axis=1)
        return hit

    def ring_areas(self, edges_mm) -> np.ndarray:
        """Area (mm2) on the detector of the rings between radii around the centre."""
        inner, outer = np.square(edges_mm[:-1]), np.square(edges_mm[1:])
        share = (np.arange(_RADII) + 0.5) / _RADII
        radius = np.sqrt(inner[:, None] + share * (outer - inner)[:, None])
        angle = 2.0 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
        points = radius[..., None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        hit = self.on_detector(points.reshape(-1, 2)).reshape(len(inner), -1)
        return np.pi * (outer - inner) * hit.mean(axis=1)

    def cell_areas(self, x_edges_mm, y_edges_mm) -> np.ndarray:
        """Area (mm2) on the detector of the cells of a grid, shape (y, x)."""
        share = (np.arange(_RADII) + 0.5) / _RADII
        both = x_edges_mm, y_edges_mm
        x, y = ((edges[:-1, None] + share * np.diff(edges)[:, None]).ravel() for edges in both)
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        hit = self.on_detector(points).reshape(len(y) // _RADII, _RADII, -1, _RADII)
        return np.diff(y_edges_mm)[:, None] * np.diff(x_edges_mm) * hit.mean(axis=(1, 3))


def detector_plane(model: SceneModel) -> DetectorPlane:
    """The plane of the faces that eta counts; InputError if they are curved or lie in several."""
    detectors = [(i, s.detector) for i, s in enumerate(model.surfaces) if s.kind == DETECTOR]
    numbers = [i for i, detector in detectors if model.counted in (None, detector)]
    faces = [face for face in model.flat_faces if face.surface in numbers]
    corners = [face.corners for face in faces]
    flat = bool(faces) and not set(numbers) & set(model.curved)
    if flat:
        normal = faces[0].normal * np.sign(faces[0].normal[np.abs(faces[0].normal).argmax()])
        heights = np.concatenate(corners) @ normal
        flat = np.ptp(heights) <= _FLAT * model.size_mm
    if not flat:
        problem = "the detector does not lie in one plane, so that no map shows where light arrives"
        mend = "make the detecting faces one flat face"
        if len(numbers) > 1:
            mend += f", or count the light of one: the integrator's detector = {model.detectors[0]}"
        raise InputError(problem, mend)
    # along the scene's x where the plane has it
    along = np.eye(3)[0 if abs(normal[0]) < 0.9 else 1]
    x_axis = along - (along @ normal) * normal
    x_axis /= np.linalg.norm(x_axis)
    axes = np.stack([x_axis, np.cross(normal, x_axis)])
    flat_corners = np.concatenate(corners) @ axes.T
    middle = (flat_corners.min(axis=0) + flat_corners.max(axis=0)) / 2
    centre = middle @ axes + heights.mean() * normal
    return DetectorPlane(centre, axes, normal, tuple((c - centre) @ axes.T for c in corners))


def outline_of(model: SceneModel, volume: int, plane: DetectorPlane) -> np.ndarray | None:
    """Outline of a volume along the detector's normal, closed, (n, 2), mm; None if it is curved."""
    owned = model.bordering(volume)
    if set(owned) & set(model.curved):
        return None
    rims = [face.rim for face in model.flat_faces if face.surface in owned]
    from scipy.spatial import ConvexHull  # slow, and most scenes need none

    points = plane.coordinates(np.concatenate(rims))
    hull = ConvexHull(points).vertices
    return points[np.append(hull, hull[0])]


def masks_of(model: SceneModel, plane: DetectorPlane) -> tuple[tuple[float, float, float], ...]:
    """Holes of masks over a horizontal detector: x, y of the centre and radius, mm; no others."""
    if abs(plane.normal[2]) < 1.0 - 1e-6:
        return ()
    masked, masks = [s for s in model.surfaces if np.isfinite(s.aperture_radius_mm)], []
    for x, y, radius in sorted({(*s.axis_mm, s.aperture_radius_mm) for s in masked}):
        across, up = plane.coordinates([[x, y, plane.centre[2]]])[0]
        masks.append((float(across), float(up), radius))
    return tuple(masks)


def largest_angle_deg(model: SceneModel, interfaces, plane: DetectorPlane) -> float | None:
    """Largest angle to the normal at which light comes through the faces opposite the detector.

    Refraction bends light from a medium of lower index towards the normal. ``None`` where a
    medium there has as high an index, or where nothing is opposite the detector. `interfaces` are
    those of the model's surfaces (`scene.check_text.Interface`).
    """
    glass = {side for s in model.surfaces if s.kind == DETECTOR for side in s.sides if side != 0}
    ratios = []
    for number in {f.surface for f in model.flat_faces if abs(f.normal @ plane.normal) > 1 - 1e-6}:
        surface, face = model.surfaces[number], interfaces[number]
        if face.n_interior is None or face.n_exterior is None:
            continue
        if surface.interior in glass and surface.exterior not in glass:
            ratios.append(face.n_exterior / face.n_interior)
        elif surface.exterior in glass and surface.interior not in glass:
            ratios.append(face.n_interior / face.n_exterior)
    largest = max(ratios, default=1.0)
    return None if largest >= 1.0 else float(np.degrees(np.arcsin(largest)))


def arrivals(
    simulation: Simulation, photons: int, *, seed: int = 0
) -> Iterator[tuple[Launch, FateTally, np.ndarray]]:
    """Follow the photons of `Simulation.collect`; launches that are not asked for are not made.

    Given are each launch, whose records have ``arrival_angle_deg`` (to the detector's normal, in
    the medium before it), the tally of all so far, and where the detected photons arrive: float64,
    shape (detected, 3), mm.
    """
    for launch, tally in launches(simulation, photons, seed, (*ARRIVAL_PLACE, "arrival_angle_deg")):
        yield launch, tally, _place(launch, ARRIVAL_PLACE)


def births(
    simulation: Simulation, photons: int, cells: Sequence[np.ndarray], *, seed: int = 0
) -> Iterator[tuple[Launch, FateTally, np.ndarray]]:
    """As `arrivals`, with where the detected ones were born: float64, shape (detected, 3), mm.

    Births are random, for those of a lattice are off by a pattern, and counted in the cells.
    """
    crystal = simulation.crystal
    corner = np.array([*crystal.lower[:2], crystal.upper[2]])
    for launch, tally in launches(simulation, photons, seed, BIRTH_PLACE, cells):
        yield launch, tally, corner + _place(launch, BIRTH_PLACE) * (1.0, 1.0, -1.0)


def launches(
    simulation: Simulation, photons: int, seed: int, columns: Sequence[str], cells: Sequence = ()
) -> Iterator[tuple[Launch, FateTally]]:
    """Launches with these columns of records, and births in cells; and the tally of all so far."""
    launcher, options = simulation.launcher(), {"max_depth": simulation.depth_limit, "seed": seed}
    for launch in launcher.launches(photons, columns=columns, birth_cells=cells, **options):
        yield launch, launcher.tally


def _place(launch: Launch, names: Sequence[str]) -> np.ndarray:
    return np.column_stack([launch.records[name] for name in names]).astype(np.float64)
