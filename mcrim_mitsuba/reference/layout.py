"""The bench's media and bodies: what happens inside them, and what lies behind every face."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from mcrim_mitsuba.reference.bench import COLLAR_WIDTH_MM, TOP_FILM_MM, Bench
from mcrim_mitsuba.reference.geometry import (
    BOTTOM,
    TOP,
    Box,
    Codes,
    Flags,
    Floats,
    HalfSpaceBody,
    Indices,
    box,
    chamfered_box,
)


@dataclass(frozen=True)
class Medium:
    """A transparent medium; its scattering may grow linearly from z = 0 to z = ``height_mm``.

    With u = 2 z / height - 1, the scattering coefficient at z is
    ``scattering_per_mm`` (1 + ``gradient`` u).
    """

    index: float
    absorption_per_mm: float = 0.0
    scattering_per_mm: float = 0.0
    #: From -1 to 1.
    gradient: float = 0.0
    #: Without meaning where there is no gradient.
    height_mm: float = 1.0

    @property
    def extinction_per_mm(self) -> float:
        """Absorption and scattering together, at middle height."""
        return self.absorption_per_mm + self.scattering_per_mm

    def free_path(self, rng: np.random.Generator, position: Floats, direction: Floats) -> Floats:
        """Draw the distances to the next absorption or scattering: (n,), mm.

        With a gradient the optical depth after s mm is A s + B s^2; the root of
        A s + B s^2 = depth is taken in the form that does not cancel. Where the parabola never
        gets so high, which is outside of 0 <= z <= height, the distance is infinite.

        Parameters
        ----------
        rng : numpy.random.Generator
        position, direction : (3, n) float64
        """
        depth: Floats = rng.standard_exponential((position.shape[1],))
        if not self.gradient:
            depth /= self.extinction_per_mm
            return depth
        at_start = self.absorption_per_mm + self.scattering_per_mm * self._strength(position)
        growth = self.scattering_per_mm * self._growth_per_mm(direction)
        discriminant = at_start**2 + 4.0 * growth * depth
        denominator = at_start + np.sqrt(np.maximum(discriminant, 0.0))
        never = (discriminant < 0.0) | (denominator == 0.0)
        return np.where(never, np.inf, 2.0 * depth / np.where(never, 1.0, denominator))

    def scatters(self, rng: np.random.Generator, position: Floats) -> Flags:
        """Draw for collisions at these points whether they scatter (or absorb): (n,) bool.

        The two exponential laws share one free path.
        """
        if not self.absorption_per_mm:
            return np.ones(position.shape[1], dtype=bool)
        scattering: float | Floats = self.scattering_per_mm
        if self.gradient:
            scattering = scattering * self._strength(position)
        draw: Floats = rng.random((position.shape[1],))
        return draw * (self.absorption_per_mm + scattering) >= self.absorption_per_mm

    def scattering_path(self, position: Floats, direction: Floats, distance: Floats) -> Floats:
        """Integral of 1 + gradient u along flights from ``position``: (n,) float64, mm."""
        if not self.gradient:
            return distance
        return distance * (self._strength(position) + self._growth_per_mm(direction) * distance)

    def _strength(self, position: Floats) -> Floats:
        """Scattering relative to that at middle height; rounding never makes it negative."""
        strength = 1.0 + self.gradient * (2.0 * position[2] / self.height_mm - 1.0)
        return np.maximum(strength, 0.0)

    def _growth_per_mm(self, direction: Floats) -> Floats:
        """Half of the relative strength's slope along the flight."""
        return self.gradient * direction[2] / self.height_mm


MM_PER_CM = 10.0


class Place(IntEnum):
    """Where a photon is: in a region, or at its end (its fate)."""

    CRYSTAL = 0
    GAP = 1
    WINDOW = 2
    FILM = 3  # the air between crystal and wrap
    OUTSIDE = 4  # the open air, an air bubble in the gap included
    DETECTED = 5
    ABSORBED_CRYSTAL = 6
    ABSORBED_GAP = 7
    ABSORBED_WINDOW = 8
    ABSORBED_APERTURE = 9
    ABSORBED_REFLECTOR = 10
    ABSORBED_SURFACE = 11  # of the crystal or of the detector
    ESCAPED = 12
    TRUNCATED = 13
    LOST = 14  # numerically out of its region: must never happen


FIRST_FATE = Place.DETECTED
REGIONS = tuple(place for place in Place if place < FIRST_FATE)
FATES = {place: place.name.lower() for place in Place if place >= FIRST_FATE}


class Layout:
    """The bench as convex bodies with media and neighbours.

    Attributes
    ----------
    bodies : dict of Place to ConvexBody
        Crystal, gap, window and, for a wrapped crystal, the film's box, which
        contains the crystal.
    seen_from : dict of Place to tuple of Place
        For the two regions of air, outside and film, and for a gap whose liquid stands
        around the crystal: the bodies that light can meet there.
    media : tuple of Medium
        By region.
    index : (5,) float64
        Refractive index by region.
    sheet_z_mm : float or None
        Height of the reflecting sheet above the crystal, None without one.
    half_footprint_mm : float
        Half of the crystal's width, which is also the sheet's.
    """

    def __init__(self, bench: Bench) -> None:
        half, height = bench.crystal_width_mm / 2.0, bench.crystal_height_mm
        entrance = -bench.gap_thickness_mm
        chamfer, collar = bench.chamfer_mm, bench.collar_height_mm
        self.bodies: dict[Place, HalfSpaceBody] = {
            Place.CRYSTAL: (
                chamfered_box(half, height, chamfer) if chamfer else box(half, 0.0, height)
            ),
            Place.GAP: (
                box(half + COLLAR_WIDTH_MM, entrance, collar)
                if collar
                else Box((bench.gap_left_mm, -half, entrance), (half, half, 0.0))
            ),
            Place.WINDOW: box(
                bench.window_width_mm / 2.0, entrance - bench.window_thickness_mm, entrance
            ),
        }
        wrapped = bench.wrap_reflectance is not None
        around_crystal = Place.FILM if wrapped else Place.OUTSIDE
        self.seen_from: dict[Place, tuple[Place, ...]] = {
            Place.OUTSIDE: (Place.CRYSTAL, Place.GAP, Place.WINDOW)
        }
        if wrapped:
            film = bench.film_mm
            self.bodies[Place.FILM] = box(half + film, 0.0, height + film)
            self.seen_from[Place.OUTSIDE] = (Place.FILM, Place.GAP, Place.WINDOW)
            self.seen_from[Place.FILM] = (Place.CRYSTAL,)
        if collar:
            self.seen_from[Place.GAP] = (Place.CRYSTAL,)

        air = Medium(1.0)
        gap_absorption = bench.gap_absorption_per_cm if bench.is_filled else 0.0
        self.media = (
            Medium(
                bench.n_crystal,
                bench.alpha_abs_per_cm / MM_PER_CM,
                bench.alpha_scat_per_cm / MM_PER_CM,
                bench.scattering_gradient,
                height,
            ),
            Medium(bench.gap_index, gap_absorption / MM_PER_CM),
            Medium(bench.n_window, bench.window_absorption_per_cm / MM_PER_CM),
            air,
            air,
        )
        self.index = np.array([medium.index for medium in self.media])
        self.sheet_z_mm = height + TOP_FILM_MM if bench.top_reflectance else None
        self.half_footprint_mm = half

        self._half_bottom = half - chamfer
        self._collar_mm, self._half_spot = collar, bench.black_spot_mm / 2.0
        self._half_gap = half + COLLAR_WIDTH_MM if collar else half
        self._gap_left = -self._half_gap if collar else bench.gap_left_mm
        self._has_bubble = self._gap_left > -half
        self._aperture_squared = bench.aperture_radius_mm**2
        if bench.aperture_at_detector:
            self._masked_face = {Place.WINDOW: BOTTOM}
        else:
            self._masked_face = {Place.GAP: BOTTOM, Place.WINDOW: TOP}
        # the neighbour through each face, where one neighbour is all there is
        faces = len(self.bodies[Place.CRYSTAL].offsets)
        self._neighbour = np.full((3, faces), Place.OUTSIDE, dtype=np.int8)
        self._neighbour[Place.CRYSTAL] = around_crystal
        self._neighbour[Place.CRYSTAL, BOTTOM] = Place.GAP
        # a collar's top is beside the crystal
        self._neighbour[Place.GAP, TOP] = Place.OUTSIDE if collar else Place.CRYSTAL
        self._neighbour[Place.GAP, BOTTOM] = Place.WINDOW
        self._neighbour[Place.WINDOW, BOTTOM] = Place.DETECTED

    def behind(self, body: Place, face: Indices, position: Floats) -> Codes:
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
        place = self._neighbour[body].take(face)
        if body == Place.CRYSTAL:
            if self._has_bubble:
                place[(face == BOTTOM) & (position[0] < self._gap_left)] = Place.OUTSIDE
            if self._collar_mm:
                place[(face != BOTTOM) & (position[2] < self._collar_mm)] = Place.GAP
            self._end_on_spot(place, face, position)
            return place
        if body == Place.WINDOW:
            under_gap = np.maximum(position[0], np.abs(position[1])) <= self._half_gap
            under_gap &= position[0] >= self._gap_left
            place[(face == TOP) & under_gap] = Place.GAP
        elif self._half_bottom < self.half_footprint_mm:
            on_rim = np.maximum(np.abs(position[0]), np.abs(position[1])) > self._half_bottom
            place[(face == TOP) & on_rim] = Place.OUTSIDE
        self._end_on_mask(place, body, face, position)
        return place

    def within(self, body: Place, face: Indices, position: Floats) -> Codes:
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
        else:
            self._end_on_mask(place, body, face, position)
            if body == Place.CRYSTAL:
                self._end_on_spot(place, face, position)
        return place

    def on_mask_plane(self, body: Place, face: Indices) -> Flags:
        """True where a face lies in the mask's plane: (n,) bool."""
        if body not in self._masked_face:
            return np.zeros(face.shape, dtype=bool)
        return face == self._masked_face[body]

    def _end_on_mask(self, place: Codes, body: Place, face: Indices, position: Floats) -> None:
        """Let light end where a face carries the mask at this point."""
        if body in self._masked_face:
            radius_squared = position[0] ** 2 + position[1] ** 2
            masked = self.on_mask_plane(body, face) & (radius_squared > self._aperture_squared)
            place[masked] = Place.ABSORBED_APERTURE

    def _end_on_spot(self, place: Codes, face: Indices, position: Floats) -> None:
        """Let light end where the crystal's top face is painted black."""
        if self._half_spot:
            in_square = np.maximum(np.abs(position[0]), np.abs(position[1])) <= self._half_spot
            place[(face == TOP) & in_square] = Place.ABSORBED_SURFACE
