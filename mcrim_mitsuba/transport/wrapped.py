"""What a wrapping does to the faces within it: where it touches them, or is painted on them.

Faces stay the interfaces that they are; the transport decides at each encounter whether light finds
the film of air behind one, or the reflector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.transport.scene_model import (
    DIELECTRIC,
    OUTSIDE,
    FlatFace,
    RoundWall,
    Surface,
    Volume,
    box_of,
)

#: Of positions, in parts of the wrapping's size.
_ROUNDING = 1e-5
#: Distance of a wrapping from what it wraps, mm, that is told: more than of a loose sheet.
_LOOSE_MM = 0.5
#: Places of the plugin's ``top`` and ``foot`` among its bounds.
_TOP = 0
_FOOT = 1


def outlines(
    shapes: Sequence[Any], faces: Sequence[FlatFace], walls: Sequence[RoundWall]
) -> list[list[np.ndarray]]:
    """Points on the rim of every face of each shape, shape (n, 3), mm; of others, of their box."""
    rims: list[list[np.ndarray]] = [[] for _ in shapes]
    for face in faces:
        rims[face.surface].append(face.rim)
    for wall in walls:
        ends = [wall.circle.points(end) for end in (wall.low_mm, wall.high_mm)]
        rims[wall.surface].append(np.concatenate(ends))
    return [rim or [np.array(box_of(shape))] for rim, shape in zip(rims, shapes, strict=True)]


class WrappedFaces:
    """The faces around a wrapping, and how they lie to its bounds.

    `shape` is the plugin's, `wrapping` what its reflector is, and `rims` are the `outlines` of all
    surfaces.
    """

    def __init__(
        self,
        shape: Any,
        wrapping: Surface,
        surfaces: Sequence[Surface],
        rims: Sequence[Sequence[np.ndarray]],
    ) -> None:
        self.shape, self.wrapping, self.surfaces = shape, wrapping, surfaces
        self.rounding = _ROUNDING * float(np.abs(shape.offsets).max())  # in mm
        #: Of each surface, how far beyond each bound its faces lie at least and at most, mm:
        #: float64, shape (faces, 2, bounds).
        self.reaches = []
        for rim in rims:
            beyond = [shape.beyond(points) for points in rim]
            self.reaches.append(np.array([(b.min(axis=1), b.max(axis=1)) for b in beyond]))

    def volumes(self, volumes: Sequence[Volume]) -> set[int]:
        """Those that it is around; InputError for one that it cuts."""
        film = self.wrapping.exterior
        pairs = [s.sides for s in self.surfaces if s.kind == DIELECTRIC and film in s.sides]
        within = set()
        for volume in {side for pair in pairs for side in pair} - {OUTSIDE, film}:
            own = [r for r, s in zip(self.reaches, self.surfaces, strict=True) if volume in s.sides]
            reach = np.concatenate(own)
            low, high = reach[:, 0].min(axis=0), reach[:, 1].max(axis=0)
            if (low > -self.rounding).any():
                continue  # beside it, or below
            farthest, where = self._farthest(high)
            if farthest > self.rounding:
                beyond = f"{farthest:.3g} mm beyond the {where} of {self.wrapping.name}"
                mend = "give that the crystal's own sizes; it wraps what stands upright"
                raise InputError(f"{volumes[volume].name} reaches {beyond}", mend)
            within.add(volume)
        return within

    def looseness(self, within: set[int]) -> list[str]:
        """A note, if the faces of what it is around are all far from its top or its sides."""
        own = [r for r, s in zip(self.reaches, self.surfaces, strict=True) if within & {*s.sides}]
        if not own:
            return []
        away, where = self._farthest(-np.concatenate(own)[:, 1].max(axis=0))
        if away < _LOOSE_MM:
            return []
        mend = "if it lies on the crystal, give it the crystal's own sizes"
        return [f"the {where} of {self.wrapping.name}: {away:.3g} mm from what it wraps; {mend}"]

    def _farthest(self, distances: np.ndarray) -> tuple[float, str]:
        """The largest of (bounds,) distances from what is there of it, and where that is."""
        distances[self.shape.open] = distances[_FOOT] = -np.inf
        return float(distances.max()), "top" if distances.argmax() == _TOP else "sides"

    def touched(self, within: set[int]) -> dict[int, Surface]:
        """The surfaces that light from `within` may meet the reflector at, by their numbers."""
        changed, film = {}, self.wrapping.exterior
        for number, (surface, reach) in enumerate(zip(self.surfaces, self.reaches, strict=True)):
            borders = surface.kind == DIELECTRIC and film in surface.sides
            if not (borders and within & set(surface.sides)):
                continue
            lies_in = reach[:, 0] > -self.rounding  # (faces, bounds)
            bare = lies_in[:, self.shape.open].any(axis=1)
            if "sides" in self.shape.without:
                bare |= ~lies_in[:, _TOP]
            if bare.all() or lies_in[:, _FOOT].all():
                continue
            if bare.any():
                problem = (
                    f"{self.wrapping.name} covers a part of {surface.name}, which is one shape"
                )
                raise InputError(problem, "write the bare face as a shape of its own")
            if surface.interior == film:
                problem = f"{surface.name}: the film of a wrapping that touches is behind it"
                raise InputError(problem, "turn the face around: its normal points outwards")
            # a bare foot, or a face that is the crystal's bottom too
            ends = self.shape.bare > 0.0 or lies_in[:, _FOOT].any()
            level = self.shape.bare - self.shape.offsets[_FOOT] + self.rounding
            changed[number] = replace(
                surface,
                contact=1.0 if self.shape.is_paint else self.shape.contact,
                painted=self.shape.is_paint,
                wrapping=self.wrapping,
                contact_above_mm=level if ends else -np.inf,
            )
        wanted = ~self.shape.open
        wanted[_FOOT] = False
        highest = [self.reaches[number][:, 1].max(axis=0) for number in changed]
        missed = np.max([*highest, np.full(wanted.shape, -np.inf)], axis=0) < -self.rounding
        if self.shape.is_paint and (missed & wanted).any():
            problem = f"{self.wrapping.name} is paint, without a film, and no crystal fills it"
            raise InputError(problem, "give it the crystal's own sizes, or a film above 0")
        return changed
