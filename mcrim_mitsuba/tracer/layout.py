"""How the bench's bodies touch: what lies behind every face."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.tracer.bench import Bench
from mcrim_mitsuba.tracer.geometry import BOTTOM, TOP, ConvexBody, box

MM_PER_CM = 10.0


class Place(IntEnum):
    """Where a photon is: in a region, or at its end (its fate)."""

    CRYSTAL = 0
    GAP = 1
    WINDOW = 2
    FILM = 3  # the air between crystal and wrap
    OUTSIDE = 4
    DETECTED = 5
    ABSORBED_CRYSTAL = 6
    ABSORBED_GAP = 7
    ABSORBED_WINDOW = 8
    ABSORBED_APERTURE = 9
    ABSORBED_REFLECTOR = 10
    ESCAPED = 11
    TRUNCATED = 12
    LOST = 13  # numerically out of its region: must never happen


FIRST_FATE = Place.DETECTED
FATES = {place: place.name.lower() for place in Place if place >= FIRST_FATE}


class Layout:
    """The bench as convex bodies with media and neighbours.

    Attributes
    ----------
    bodies : dict of Place to ConvexBody
        Crystal, gap, window and, for a wrapped crystal, the film's box, which
        contains the crystal.
    seen_from : dict of Place to tuple of Place
        For the two regions of air, outside and film: the bodies that light can
        meet there.
    index : (5,) float64
        Refractive index by region.
    absorption, scattering : (5,) float64, 1/mm
        Coefficients by region.
    """

    def __init__(self, bench: Bench) -> None:
        half = bench.crystal_width_mm / 2.0
        entrance, back = -bench.gap_mm, -bench.gap_mm - bench.window_thickness_mm
        self.bodies: dict[Place, ConvexBody] = {
            Place.CRYSTAL: box(half, 0.0, bench.crystal_height_mm),
            Place.GAP: box(half, entrance, 0.0),
            Place.WINDOW: box(bench.window_width_mm / 2.0, back, entrance),
        }
        wrapped = bench.wrap_reflectance is not None
        around_crystal = Place.FILM if wrapped else Place.OUTSIDE
        self.seen_from = {Place.OUTSIDE: (Place.CRYSTAL, Place.GAP, Place.WINDOW)}
        if wrapped:
            film = bench.film_mm
            self.bodies[Place.FILM] = box(half + film, 0.0, bench.crystal_height_mm + film)
            self.seen_from[Place.OUTSIDE] = (Place.FILM, Place.GAP, Place.WINDOW)
            self.seen_from[Place.FILM] = (Place.CRYSTAL,)

        self.index = np.array([bench.n_crystal, bench.n_gap, bench.n_window, 1.0, 1.0])
        self.scattering = np.array([bench.alpha_scat_per_cm, 0.0, 0.0, 0.0, 0.0]) / MM_PER_CM
        self.absorption = (
            np.array(
                [
                    bench.alpha_abs_per_cm,
                    bench.gap_absorption_per_cm,
                    bench.window_absorption_per_cm,
                    0.0,
                    0.0,
                ]
            )
            / MM_PER_CM
        )

        self._half_footprint = half
        self._aperture_squared = bench.aperture_radius_mm**2
        # the neighbour through each face, where one neighbour is all there is
        self._neighbour = np.full((3, 6), Place.OUTSIDE, dtype=np.int8)
        self._neighbour[Place.CRYSTAL] = around_crystal
        self._neighbour[Place.CRYSTAL, BOTTOM] = Place.GAP
        self._neighbour[Place.GAP, TOP] = Place.CRYSTAL
        self._neighbour[Place.GAP, BOTTOM] = Place.WINDOW
        self._neighbour[Place.WINDOW, BOTTOM] = Place.DETECTED

    def behind(
        self, body: Place, face: NDArray[np.intp], position: NDArray[np.float64]
    ) -> NDArray[np.int8]:
        """What light from within crystal, gap or window finds behind a face.

        Parameters
        ----------
        body : Place
            The body that the light is in.
        face : (n,) intp
            The faces it arrives at.
        position : (3, n) float64, mm
            Points on those faces.

        Returns
        -------
        (n,) int8
            `Place` codes: a region, or the fate of light that ends there.
        """
        place = self._neighbour[body][face]
        if body == Place.WINDOW:
            under_gap = np.maximum(np.abs(position[0]), np.abs(position[1])) <= self._half_footprint
            place[(face == TOP) & under_gap] = Place.GAP
        place[self._on_mask(body, face, position)] = Place.ABSORBED_APERTURE
        return place

    def within(
        self, body: Place, face: NDArray[np.intp], position: NDArray[np.float64]
    ) -> NDArray[np.int8]:
        """What light from the air finds on a body's face: the body itself, or an end.

        Parameters
        ----------
        body : Place
            The body that the light meets.
        face : (n,) intp
        position : (3, n) float64, mm

        Returns
        -------
        (n,) int8
            `Place` codes, as in `behind`. The window's back face is never met:
            light goes up only after meeting the window, so never below it.
        """
        place = np.full(face.shape, body, dtype=np.int8)
        if body == Place.FILM:
            # light enters the film by its open rim only
            place[face != BOTTOM] = Place.ABSORBED_REFLECTOR
        elif body == Place.WINDOW:
            place[self._on_mask(body, face, position)] = Place.ABSORBED_APERTURE
        return place

    def _on_mask(
        self, body: Place, face: NDArray[np.intp], position: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """True where a face of gap or window carries the mask at this point."""
        masked_face = {Place.GAP: BOTTOM, Place.WINDOW: TOP}.get(body)
        if masked_face is None:
            return np.zeros(face.shape, dtype=bool)
        radius_squared = position[0] ** 2 + position[1] ** 2
        return (face == masked_face) & (radius_squared > self._aperture_squared)
