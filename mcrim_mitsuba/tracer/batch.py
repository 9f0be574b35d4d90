"""A batch of photons in flight: the analog random walk itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.tracer.bench import Bench
from mcrim_mitsuba.tracer.directions import isotropic, lambertian
from mcrim_mitsuba.tracer.geometry import BOTTOM
from mcrim_mitsuba.tracer.interface import cross, random_polarisation
from mcrim_mitsuba.tracer.layout import FIRST_FATE, Layout, Place

_ABSORBED_IN = {
    Place.CRYSTAL: Place.ABSORBED_CRYSTAL,
    Place.GAP: Place.ABSORBED_GAP,
    Place.WINDOW: Place.ABSORBED_WINDOW,
}


class Batch:
    """Photons that fly together, one straight flight each per call of `fly`.

    They are born unpolarised and isotropic, uniformly in the crystal.

    Attributes
    ----------
    position : (3, n) float64, mm
    direction : (3, n) float64
        Unit vectors.
    field : (3, n) complex128 or None
        Polarisation states (see `interface`), None when they are not tracked.
    place : (n,) int8
        `Place` codes: the region a photon is in, or its fate.
    touched : (n,) int8
        The body whose surface a photon in air is on; without meaning elsewhere.
    scatterings : (n,) int32
        Bulk scatterings so far.
    path : (n,) float64, mm
        Path in the crystal so far.
    """

    def __init__(self, bench: Bench, layout: Layout, count: int, rng: np.random.Generator) -> None:
        self._layout = layout
        self._wrap_reflectance = bench.wrap_reflectance
        self._rng = rng
        width, height = bench.crystal_width_mm, bench.crystal_height_mm
        self.position = rng.random((3, count))
        self.position[:2] = (self.position[:2] - 0.5) * width
        self.position[2] *= height
        self.direction = isotropic(rng, count)
        self.field = random_polarisation(rng, self.direction) if bench.polarization else None
        self.place = np.full(count, Place.CRYSTAL, dtype=np.int8)
        self.touched = np.full(count, Place.CRYSTAL, dtype=np.int8)
        self.scatterings = np.zeros(count, dtype=np.int32)
        self.path = np.zeros(count)

    def __len__(self) -> int:
        return self.place.size

    def fly(self) -> None:
        """Let every photon fly to its next event: a face, a scattering, or its end."""
        groups = [(region, np.flatnonzero(self.place == region)) for region in _REGIONS]
        for region, who in groups:
            if not who.size:
                continue
            if region == Place.OUTSIDE:
                self._fly_outside(who)
            elif region == Place.FILM:
                self._fly_in_film(who)
            else:
                self._fly_in_body(who, region)

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Drop all photons but those marked: (n,) bool."""
        who = np.flatnonzero(kept)
        self.position = self.position[:, who]
        self.direction = self.direction[:, who]
        if self.field is not None:
            self.field = self.field[:, who]
        self.place = self.place[who]
        self.touched = self.touched[who]
        self.scatterings = self.scatterings[who]
        self.path = self.path[who]

    def _fly_in_body(self, who: NDArray[np.intp], region: Place) -> None:
        """Flights in crystal, gap or window: to a face, or to a scattering or absorption."""
        layout, body = self._layout, self._layout.bodies[region]
        position, direction = self.position[:, who], self.direction[:, who]
        distance, face, strayed = body.exit(position, direction)
        arrives = ~strayed
        self.place[who[strayed]] = Place.LOST

        extinction = layout.absorption[region] + layout.scattering[region]
        if extinction > 0.0:
            free_path = self._rng.standard_exponential(who.size) / extinction
            collides = arrives & (free_path < distance)
            arrives &= ~collides
            np.minimum(distance, free_path, out=distance)
        position += distance * direction
        if region == Place.CRYSTAL:
            self.path[who] += distance
        if extinction > 0.0:
            collided = np.flatnonzero(collides)
            self._collide(who[collided], region, position[:, collided])

        at_face = np.flatnonzero(arrives)
        face = face[at_face]
        position, normal = body.snap(position[:, at_face], face)
        self._meet(
            who[at_face], region, region, position, normal, layout.behind(region, face, position)
        )

    def _collide(self, who: NDArray[np.intp], region: Place, position: NDArray[np.float64]) -> None:
        """Absorb or scatter at ``position``; the two exponential laws share one free path."""
        self.position[:, who] = position
        absorption, scattering = self._layout.absorption[region], self._layout.scattering[region]
        absorbed = self._rng.random(who.size) * (absorption + scattering) < absorption
        self.place[who[absorbed]] = _ABSORBED_IN[region]
        scattered = who[~absorbed]
        self._launch(scattered, isotropic(self._rng, scattered.size))
        self.scatterings[scattered] += 1

    def _fly_outside(self, who: NDArray[np.intp]) -> None:
        """Flights in the open air: to the nearest body, or away."""
        position, direction = self.position[:, who], self.direction[:, who]
        distance, target, face, strayed = self._nearest_body(who, Place.OUTSIDE)
        self.place[who] = np.where(strayed, Place.LOST, Place.ESCAPED)
        for body in self._layout.seen_from[Place.OUTSIDE]:
            met = np.flatnonzero((target == body) & ~strayed)
            if met.size:
                arrival = position[:, met] + distance[met] * direction[:, met]
                self._meet_from_air(who[met], Place.OUTSIDE, body, arrival, face[met])

    def _fly_in_film(self, who: NDArray[np.intp]) -> None:
        """Flights between crystal and wrap: to the crystal, to the wrap, or out by the rim."""
        film = self._layout.bodies[Place.FILM]
        position, direction = self.position[:, who], self.direction[:, who]
        distance, _, crystal_face, strayed = self._nearest_body(who, Place.FILM)
        wall_distance, wall, outside_film = film.exit(position, direction)
        strayed |= outside_film
        self.place[who[strayed]] = Place.LOST
        to_crystal = distance < wall_distance
        position += np.minimum(distance, wall_distance) * direction

        met = np.flatnonzero(to_crystal & ~strayed)
        self._meet_from_air(
            who[met], Place.FILM, Place.CRYSTAL, position[:, met], crystal_face[met]
        )
        met = np.flatnonzero(~to_crystal & ~strayed)
        arrival, normal = film.snap(position[:, met], wall[met])
        self.position[:, who[met]] = arrival
        self.touched[who[met]] = Place.FILM
        at_rim = wall[met] == BOTTOM
        self.place[who[met[at_rim]]] = Place.OUTSIDE
        absorbed = ~at_rim & (self._rng.random(met.size) >= self._wrap_reflectance)
        self.place[who[met[absorbed]]] = Place.ABSORBED_REFLECTOR
        reflected = ~at_rim & ~absorbed
        self._launch(who[met[reflected]], lambertian(self._rng, -normal[:, reflected]))

    def _nearest_body(
        self, who: NDArray[np.intp], region: Place
    ) -> tuple[NDArray[np.float64], NDArray[np.int8], NDArray[np.intp], NDArray[np.bool_]]:
        """The first body that photons in air meet.

        Returns
        -------
        distance : (n,) float64, mm
            Infinity where there is none.
        target : (n,) int8
            The body's `Place` code, or -1.
        face : (n,) intp
        strayed : (n,) bool
            True where a photon turns out to be inside a body.
        """
        position, direction = self.position[:, who], self.direction[:, who]
        touched = self.touched[who]
        distance = np.full(who.size, np.inf)
        target = np.full(who.size, -1, dtype=np.int8)
        face = np.zeros(who.size, dtype=np.intp)
        strayed = np.zeros(who.size, dtype=bool)
        for body in self._layout.seen_from[region]:
            to_body, body_face, inside = self._layout.bodies[body].entry(position, direction)
            strayed |= inside
            # light that has just left a convex body, or been reflected off it, moves
            # away from it; asking again would leave the answer to rounding
            closer = (to_body < distance) & (touched != body)
            np.copyto(distance, to_body, where=closer)
            np.copyto(target, body, where=closer)
            np.copyto(face, body_face, where=closer)
        return distance, target, face, strayed

    def _meet_from_air(
        self,
        who: NDArray[np.intp],
        region: Place,
        body: Place,
        arrival: NDArray[np.float64],
        face: NDArray[np.intp],
    ) -> None:
        """Let photons in air, outside or in the film, meet a body's face."""
        position, normal = self._layout.bodies[body].snap(arrival, face)
        place = self._layout.within(body, face, position)
        self._meet(who, region, body, position, -normal, place)

    def _meet(
        self,
        who: NDArray[np.intp],
        region: Place,
        body: Place,
        position: NDArray[np.float64],
        normal: NDArray[np.float64],
        ahead: NDArray[np.int8],
    ) -> None:
        """End photons at a face, or reflect or refract them there.

        Parameters
        ----------
        who : (n,) intp
            Indices in the batch.
        region : Place
            The region that the photons are in.
        body : Place
            The body whose surface this is.
        position : (3, n) float64, mm
        normal : (3, n) float64
            Unit normals that point ahead.
        ahead : (n,) int8
            `Place` codes of what lies ahead.
        """
        self.position[:, who] = position
        self.touched[who] = body
        self.place[who] = region
        ends = ahead >= FIRST_FATE
        self.place[who[ends]] = ahead[ends]
        optical = np.flatnonzero(~ends)
        who, ahead = who[optical], ahead[optical]
        field = None if self.field is None else self.field[:, who]
        direction, transmitted, field = cross(
            self._rng,
            self.direction[:, who],
            normal[:, optical],
            self._layout.index[region],
            self._layout.index[ahead],
            field,
        )
        self.direction[:, who] = direction
        if self.field is not None:
            self.field[:, who] = field
        self.place[who[transmitted]] = ahead[transmitted]

    def _launch(self, who: NDArray[np.intp], direction: NDArray[np.float64]) -> None:
        """Give photons new directions, (3, n), and with them a new, random polarisation."""
        self.direction[:, who] = direction
        if self.field is not None:
            self.field[:, who] = random_polarisation(self._rng, direction)


_REGIONS = tuple(place for place in Place if place < FIRST_FATE)
