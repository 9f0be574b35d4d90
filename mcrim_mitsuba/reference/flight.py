"""Photons in flight: how they are born, fly, scatter, meet faces and are detected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.reference.geometry import (
    BOTTOM,
    FIRST_FATE,
    TOP,
    Body,
    Codes,
    Complexes,
    Flags,
    Floats,
    Indices,
    Layout,
    Place,
    Plate,
    dot,
)
from mcrim_mitsuba.reference.interface import (
    AbsorbingFilm,
    about,
    cathode_index,
    cross,
    cross_rough,
    isotropic,
    lambertian,
    random_polarisation,
)


class Record(IntEnum):
    """Rows of `PhotonArrays.record`."""

    SCATTERINGS = 0
    PATH = 1
    SCATTERING_PATH = 2
    MASK_RADIUS = 3


@dataclass
class PhotonArrays:
    """Photons that are in the same region; the last axis of every array counts them."""

    #: (3, n) float64, mm
    position: Floats
    #: (3, n) float64: Unit vectors.
    direction: Floats
    #: (n,) int8: The body (a `Place`) whose surface a photon in air is on; without meaning
    #: elsewhere.
    touched: Codes
    #: (n,) int32: Straight flights so far.
    flights: NDArray[np.int32]
    #: (3, n) complex128 or None: Polarisation states (see `interface`), None when they are not
    #: tracked.
    field: Complexes | None
    #: (n,) float64 or None: Scattering in the crystal over that at the band's maximum, by the
    #: photon's wavelength; None where all scatter alike.
    strength: Floats | None
    #: (4, n) float64 or None: What `DetectedHistories` is made of, by `Record`, in mm; None when
    #: nobody asks for it.
    record: Floats | None

    def __len__(self) -> int:
        return self.touched.size

    @property
    def _arrays(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]

    def take(self, who: Indices) -> PhotonArrays:
        """Copies of the photons with these indices."""
        taken: list[Any] = [None if a is None else a.take(who, axis=-1) for a in self._arrays]
        return PhotonArrays(*taken)

    @staticmethod
    def join(groups: Sequence[PhotonArrays]) -> PhotonArrays:
        """All photons of several groups as one."""
        if len(groups) == 1:
            return groups[0]
        joined: list[Any] = [
            None if column[0] is None else np.concatenate(column, axis=-1)
            for column in zip(*(group._arrays for group in groups), strict=True)
        ]
        return PhotonArrays(*joined)


def birth_positions(bench: Bench, crystal: Body, rng: np.random.Generator, count: int) -> Floats:
    """Births in `crystal` by the bench's density: (3, count) float64, mm, drawn until within it."""
    position = _in_box(bench, rng, count)
    if not bench.chamfer_mm and bench.crystal_diameter_mm is None:
        return position
    outside = np.flatnonzero(~crystal.contains(position))
    while outside.size:
        position[:, outside] = _in_box(bench, rng, outside.size)
        outside = outside[~crystal.contains(position[:, outside])]
    return position


def _in_box(bench: Bench, rng: np.random.Generator, count: int) -> Floats:
    """(3, count) births in a crystal, mm: evenly, or near the top or a side."""
    width, height = bench.crystal_diameter_mm or bench.crystal_width_mm, bench.height_mm
    position = rng.random((3, count))
    if bench.side_depth_mm < math.inf:
        position[0] = _depths(position[0], bench.side_depth_mm, width) / width
    position[0] = (position[0] - 0.5) * (bench.crystal_length_mm or width)
    position[1] = (position[1] - 0.5) * width
    if math.isinf(bench.source_depth_mm):
        position[2] *= height
    else:
        position[2] = height - _depths(position[2], bench.source_depth_mm, height)
    return position


def _depths(uniform: Floats, depth_mm: float, length_mm: float) -> Floats:
    """Depths t with a density exp(-t/depth) on 0 < t < length, from uniforms: mm."""
    # the inverse of the distribution function
    below = -depth_mm * np.log1p(uniform * math.expm1(-length_mm / depth_mm))
    return np.clip(below, 0.0, length_mm)


def henyey_greenstein_cosine(rng: np.random.Generator, count: int, g: float) -> Floats:
    """Cosines of deflection with mean ``g``: (count,) float64.

    L. G. Henyey and J. L. Greenstein, Astrophysical Journal 93 (1941) 70; the
    inverse of the distribution function as in A. N. Witt, ApJ Suppl. 35 (1977) 1.
    ``g`` is between -1 and 1, and not 0.
    """
    ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * rng.random(count))
    return np.clip((1.0 + g * g - ratio * ratio) / (2.0 * g), -1.0, 1.0)


def rayleigh_cosine(rng: np.random.Generator, count: int) -> Floats:
    """Cosines with density 3/8 (1 + cos^2): (count,) float64.

    J. R. Frisvad, Importance sampling the Rayleigh phase function, Journal of
    the Optical Society of America A 28 (2011) 2436.
    """
    draw = 2.0 * (2.0 * rng.random(count) - 1.0)
    root = np.cbrt(draw + np.sqrt(draw * draw + 1.0))
    return np.clip(root - 1.0 / root, -1.0, 1.0)


#: Distance from the axis, in mm, at which the radial falloff is reached.
FALLOFF_RADIUS_MM = 14.0


def acceptance(bench: Bench, position: Floats, direction: Floats) -> Floats:
    """Probability that light in the plate, (3, n), is detected if not reflected: (n,) float64."""
    by_angle = 1.0 - bench.angular_falloff * (1.0 - np.abs(direction[2]))
    by_angle /= max(1.0, 1.0 - bench.angular_falloff)
    from_axis = position[0] - bench.mask_offset_mm
    reach = (from_axis**2 + position[1] ** 2) / FALLOFF_RADIUS_MM**2
    by_radius = 1.0 - bench.radial_falloff * reach
    return np.clip(by_angle, 0.0, 1.0) * np.clip(by_radius, 0.0, 1.0)


def photocathode_of(bench: Bench) -> AbsorbingFilm | None:
    """The film that the detector is; none where there is no thickness."""
    if not bench.cathode_nm:
        return None
    return AbsorbingFilm(
        cathode_index(bench.wavelength_nm), bench.n_window, bench.cathode_nm / bench.wavelength_nm
    )


def head_on(bench: Bench) -> float:
    """Part that the detector detects of head-on light, as calibrated, plain reflection aside."""
    film = photocathode_of(bench)
    if film is None:
        return 1.0 / max(1.0, 1.0 - bench.angular_falloff)
    reflected, transmitted = film.waves(np.ones(1))
    return float(1.0 - (np.abs(reflected) ** 2 + transmitted).mean())


def _frame(direction: Floats) -> tuple[Floats, Floats]:
    """Unit vectors across the planes of incidence on the detector, and in them: (3, n) each."""
    x, y, z = direction
    flat = np.hypot(x, y)
    head_on = flat == 0.0
    cosine, sine = (
        np.where(head_on, at, c / np.where(head_on, 1.0, flat)) for at, c in ((1.0, x), (0.0, y))
    )
    across = np.stack((-sine, cosine, np.zeros_like(x)))
    along = np.stack((z * cosine, z * sine, -flat))
    return across, along


# One straight flight of each photon: the analog random walk itself.

_ABSORBED_IN = {
    Place.CRYSTAL: Place.ABSORBED_CRYSTAL,
    Place.GAP: Place.ABSORBED_GAP,
    Place.WINDOW: Place.ABSORBED_WINDOW,
}


class Flock(NamedTuple):
    """Photons of one region during a flight."""

    #: The region that all of them start in.
    region: Place
    photons: PhotonArrays
    #: (n,) int8: Where each is after the flight.
    place: Codes


class Flights:
    """Births and flights of photons on a bench; `records` keeps `PhotonArrays.record`."""

    def __init__(self, bench: Bench, rng: np.random.Generator, records: bool) -> None:
        self._bench, self._rng, self._records = bench, rng, records
        self._layout = Layout(bench)
        self._film = photocathode_of(bench)
        #: Whether the detector does anything but detect.
        self._decides = self._film is not None or any(
            (
                bench.detector_reflectance,
                bench.detector_specular,
                bench.angular_falloff,
                bench.radial_falloff,
            )
        )

    def births(self, count: int) -> PhotonArrays:
        """Photons at their `birthplace`, unpolarised: isotropic in the crystal, or a beam."""
        if self._bench.beam_diameter_mm is None:
            position = birth_positions(
                self._bench, self._layout.bodies[Place.CRYSTAL], self._rng, count
            )
            direction = isotropic(self._rng, count)
        else:
            position, direction = self._beam(self._bench.beam_diameter_mm, count)
        return PhotonArrays(
            position=position,
            direction=direction,
            touched=np.full(count, self.birthplace, dtype=np.int8),
            flights=np.zeros(count, dtype=np.int32),
            field=random_polarisation(self._rng, direction) if self._bench.polarization else None,
            strength=self._strengths(count),
            record=np.zeros((len(Record), count)) if self._records else None,
        )

    def _strengths(self, count: int) -> Floats | None:
        """Of photons whose wavelengths are drawn from the band; that of a beam has one."""
        bench = self._bench
        if not bench.scattering_exponent or bench.beam_diameter_mm is not None:
            return None
        width = bench.bandwidth_nm / bench.wavelength_nm
        sigma, cut = width / math.sqrt(8.0 * math.log(2.0)), 1.5 * width
        away = sigma * self._rng.standard_normal(count)
        while (beyond := np.flatnonzero(np.abs(away) > cut)).size:
            away[beyond] = sigma * self._rng.standard_normal(beyond.size)
        return np.asarray((1.0 + away) ** -bench.scattering_exponent, float)

    @property
    def birthplace(self) -> Place:
        """The region where photons are born."""
        return Place.CRYSTAL if self._bench.beam_diameter_mm is None else Place.OUTSIDE

    def _beam(self, diameter_mm: float, count: int) -> tuple[Floats, Floats]:
        """Parallel light, even over a disc before the crystal: positions, mm, and directions."""
        axis = self._layout.detector_axis
        radius = diameter_mm / 2.0 * np.sqrt(self._rng.random(count))
        azimuth = 2.0 * np.pi * self._rng.random(count)
        position = np.repeat(self._layout.detector_centre, count, axis=1)
        # in any case outside
        position[axis] -= self._bench.crystal_width_mm + self._bench.crystal_height_mm
        position[axis - 2] += radius * np.cos(azimuth)
        position[axis - 1] += radius * np.sin(azimuth)
        direction = np.zeros((3, count))
        direction[axis] = 1.0
        return position, direction

    def arrivals(self, photons: PhotonArrays) -> Floats:
        """Cosine to the detector's normal and distance from its axis, mm: (2, n) float64."""
        axis = self._layout.detector_axis
        away = photons.position - self._layout.detector_centre
        radius = np.hypot(away[axis - 2], away[axis - 1])
        return np.vstack((np.abs(photons.direction[axis]), radius))

    def fly(self, region: Place, photons: PhotonArrays) -> Codes:
        """Let photons, all in one region, fly to their next event: a face, a scattering, their end.

        They are changed in place. Returned are `Place` codes, (n,) int8: the region where each
        photon is now, or its fate.
        """
        photons.flights += 1
        flock = Flock(region, photons, np.full(len(photons), region, dtype=np.int8))
        if region == Place.OUTSIDE:
            self._fly_outside(flock)
        elif region == Place.FILM:
            self._fly_in_film(flock)
        elif region == Place.LIQUID:
            self._fly_in_liquid(flock)
        else:
            self._fly_in_body(flock)
        return flock.place

    def _fly_in_body(self, flock: Flock) -> None:
        """Flights in crystal, gap, bubble or window: to a face, a scattering or absorption."""
        region, photons, place = flock
        body, medium = self._layout.bodies[region], self._layout.media[region]
        position, direction = photons.position, photons.direction
        distance, face, strayed = body.exit(position, direction)
        meets_other = None
        if region in self._layout.seen_from:
            # the liquid stands around the crystal or a bubble
            (other,) = self._layout.seen_from[region]
            to_other, _, other_face, inside = self._nearest_body(flock)
            meets_other = to_other < distance
            np.minimum(distance, to_other, out=distance)
            strayed |= inside
        if medium.extinction_per_mm > 0.0:
            strength = self._strength(flock)
            free_path = medium.free_path(self._rng, position, direction, strength)
            arrives = free_path >= distance
            np.minimum(distance, free_path, out=distance)
        else:
            arrives = np.ones(len(photons), dtype=bool)
        if photons.record is not None and region == Place.CRYSTAL:
            photons.record[Record.PATH] += distance
            weighted = medium.scattering_path(position, direction, distance)
            photons.record[Record.SCATTERING_PATH] += weighted * self._strength(flock)
        position += distance * direction

        self._collide(flock, np.flatnonzero(~arrives))
        if meets_other is not None:
            met = np.flatnonzero(arrives & meets_other)
            self._meet(flock, met, other, other_face[met], position[:, met])
            arrives &= ~meets_other
        at_face = np.flatnonzero(arrives)
        self._meet(flock, at_face, region, face[at_face], position.take(at_face, axis=1))
        place[strayed] = Place.LOST

    def _collide(self, flock: Flock, who: Indices) -> None:
        """Absorb or scatter photons inside a medium."""
        region, photons, place = flock
        if not who.size:
            return
        medium = self._layout.media[region]
        strength = self._strength(flock, who)
        scatters = medium.scatters(self._rng, photons.position[:, who], strength)
        place[who[~scatters]] = _ABSORBED_IN[region]
        who = who[scatters]
        self._launch(photons, who, self._scattered(photons.direction.take(who, axis=1)))
        if photons.record is not None:
            photons.record[Record.SCATTERINGS, who] += 1.0

    @staticmethod
    def _strength(flock: Flock, who: Indices | slice = slice(None)) -> float | Floats:
        """What the wavelengths of photons do to how strongly the medium scatters."""
        strength = flock.photons.strength
        return 1.0 if strength is None or flock.region != Place.CRYSTAL else strength[who]

    def _scattered(self, direction: Floats) -> Floats:
        """Directions in which the crystal scatters light that flies along (3, n)."""
        rng, count, g = self._rng, direction.shape[1], self._bench.scattering_g
        if self._bench.rayleigh_scattering:
            return about(rng, direction, rayleigh_cosine(rng, count))
        if g:
            return about(rng, direction, henyey_greenstein_cosine(rng, count, g))
        return isotropic(rng, count)

    def _fly_outside(self, flock: Flock) -> None:
        """Flights in the open air: to the nearest body or the sheet above it, or away."""
        _, photons, place = flock
        distance, target, face, strayed = self._nearest_body(flock)
        place[:] = Place.ESCAPED
        if self._layout.plate is not None:
            self._meet_plate(flock, self._layout.plate, distance, target)
        for body in self._layout.seen_from[Place.OUTSIDE]:
            met = np.flatnonzero(target == body)
            if met.size:
                arrival = photons.position[:, met] + distance[met] * photons.direction[:, met]
                self._meet(flock, met, body, face[met], arrival)
        place[strayed] = Place.LOST

    def _meet_plate(self, flock: Flock, plate: Plate, distance: Floats, target: Codes) -> None:
        """Let photons meet the plate in the beam, or the sheet above the crystal, before any body.

        One detects or absorbs them, the other reflects some. Nothing comes back onto either: light
        that has passed it flies on for ever.
        """
        photons, place = flock.photons, flock.place
        who, arrival = plate.reached(photons.position, photons.direction, distance)
        target[who] = -1
        photons.position[:, who] = arrival
        if self._bench.beam_diameter_mm is None:
            photons.touched[who] = Place.OUTSIDE
            down = np.repeat([[0.0], [0.0], [-1.0]], who.size, axis=1)
            self._reflect(flock, who, down, self._bench.top_reflectance)
            return
        least_cosine = math.cos(math.radians(self._bench.acceptance_deg))
        accepted = photons.direction[plate.axis, who] >= least_cosine
        place[who] = np.where(accepted, Place.DETECTED, Place.ABSORBED_SURFACE)

    def _fly_in_liquid(self, flock: Flock) -> None:
        """Flights in the liquid that has no end: to the window's plane, or away."""
        _, photons, place = flock
        place[:] = Place.ESCAPED
        who, arrival = self._layout.through_liquid(photons.position, photons.direction)
        top = np.full(who.size, TOP, dtype=np.intp)
        self._meet(flock, who, Place.WINDOW, top, arrival)

    def _fly_in_film(self, flock: Flock) -> None:
        """Flights between crystal and wrap: to the crystal, to the wrap, or out by the rim."""
        _, photons, place = flock
        film = self._layout.bodies[Place.FILM]
        distance, _, crystal_face, strayed = self._nearest_body(flock)
        wall_distance, wall, outside_film = film.exit(photons.position, photons.direction)
        to_crystal = distance < wall_distance
        photons.position += np.minimum(distance, wall_distance) * photons.direction

        met = np.flatnonzero(to_crystal)
        arrival = photons.position[:, met]
        self._meet(flock, met, Place.CRYSTAL, crystal_face[met], arrival)
        met = np.flatnonzero(~to_crystal)
        arrival, normal = film.snap(photons.position[:, met], wall[met])
        photons.position[:, met] = arrival
        photons.touched[met] = Place.FILM
        at_rim = wall[met] == BOTTOM
        place[met[at_rim]] = Place.OUTSIDE
        self._reflect(flock, met[~at_rim], -normal[:, ~at_rim], self._bench.wrap_reflectance)
        place[strayed | outside_film] = Place.LOST

    def _nearest_body(self, flock: Flock) -> tuple[Floats, Codes, Indices, Flags]:
        """The first body that photons in air meet.

        Its distance in mm, infinite where there is none; its `Place` code, or -1; the face; and
        whether the photon turns out to be inside a body.
        """
        region, photons, _ = flock
        count = len(photons)
        distance = np.full(count, np.inf)
        target = np.full(count, -1, dtype=np.int8)
        face = np.zeros(count, dtype=np.intp)
        strayed = np.zeros(count, dtype=bool)
        for body in self._layout.seen_from[region]:
            # light that has just left a convex body, or been reflected off it, moves
            # away from it; asking again would leave the answer to rounding
            who = np.flatnonzero(photons.touched != body)
            if not who.size:
                continue
            to_body, body_face, inside = self._layout.bodies[body].entry(
                photons.position.take(who, axis=1), photons.direction.take(who, axis=1)
            )
            strayed[who] |= inside
            closer = np.flatnonzero(to_body < distance[who])
            nearer = who[closer]
            distance[nearer], face[nearer] = to_body[closer], body_face[closer]
            target[nearer] = body
        return distance, target, face, strayed

    def _meet(
        self, flock: Flock, who: Indices, body: Place, face: Indices, arrival: Floats
    ) -> None:
        """Let photons meet a face of the body that they are in, or from outside that of another.

        `who` are the indices of the (m,) photons, `face` the faces, `arrival`, (3, m) in mm, where
        they get to them. They end there, or are reflected or refracted.
        """
        region, photons, place = flock
        position, normal = self._layout.bodies[body].snap(arrival, face)
        if body == region:
            ahead = self._layout.behind(body, face, position)
        else:
            ahead, normal = self._layout.within(body, face, position), -normal
        photons.position[:, who] = position
        photons.touched[who] = body
        if photons.record is not None:
            self._note_mask_radius(photons, who, body, face, position)
        place[who] = ahead
        if ahead.max(initial=0) >= FIRST_FATE:
            self._arrive(flock, who[ahead == Place.DETECTED])
            if self._bench.housing_reflectance:
                self._meet_mask(flock, who[ahead == Place.ABSORBED_APERTURE])
            optical = np.flatnonzero(ahead < FIRST_FATE)
            who, ahead, normal = who[optical], ahead[optical], normal[:, optical]
            face = face[optical]
        if region == Place.CRYSTAL and self._bench.ground_loss:
            rough = self._layout.roughness(body, face, ahead) > 0.0
            taken = rough & (self._rng.random(who.size) < self._bench.ground_loss)
            place[who[taken]] = Place.ABSORBED_SURFACE
            who, ahead, normal, face = who[~taken], ahead[~taken], normal[:, ~taken], face[~taken]
        if region == Place.CRYSTAL and self._bench.wrap_contact:
            touches = ahead == Place.FILM
            touches &= self._rng.random(who.size) < self._bench.wrap_contact
            of_wrap = self._bench.wrap_reflectance
            self._reflect(flock, who[touches], -normal[:, touches], of_wrap)
            apart = ~touches
            who, ahead, normal, face = who[apart], ahead[apart], normal[:, apart], face[apart]
        reflected = who[~self._cross(flock, who, body, face, normal, ahead)]
        place[reflected] = region
        if region == Place.CRYSTAL and self._bench.surface_loss:
            lost = self._rng.random(reflected.size) < self._bench.surface_loss
            place[reflected[lost]] = Place.ABSORBED_SURFACE

    def _cross(
        self, flock: Flock, who: Indices, body: Place, face: Indices, normal: Floats, ahead: Codes
    ) -> Flags:
        """Reflect or refract photons at faces, some rough or hazy; which are transmitted, (m,).

        `normal` are (3, m) unit vectors that point ahead, `ahead` `Place` codes of what lies there.
        """
        rng, layout, bench, photons = self._rng, self._layout, self._bench, flock.photons
        direction = photons.direction.take(who, axis=1)
        field = None if photons.field is None else photons.field.take(who, axis=1)
        n_in, n_out = layout.index[flock.region], layout.index.take(ahead)
        heights = np.zeros(ahead.size)
        if bench.rms_roughness_nm:
            crystal = layout.of_crystal(body, ahead)
            heights[crystal] = bench.rms_roughness_nm / bench.wavelength_nm
        roughness = layout.roughness(body, face, ahead) if layout.is_rough else None
        if roughness is None or not roughness.any():
            vectors = direction, normal
            direction, transmitted, field = cross(rng, *vectors, n_in, n_out, field, heights)
        else:
            transmitted = np.empty(ahead.size, dtype=bool)
            for rough in (True, False):
                some = np.flatnonzero((roughness > 0.0) == rough)
                arguments = direction[:, some], normal[:, some], n_in, n_out[some]
                states = None if field is None else field[:, some]
                options = states, heights[some]
                direction[:, some], transmitted[some], states = (
                    cross_rough(rng, *arguments, roughness[some], *options, beckmann=bench.beckmann)
                    if rough
                    else cross(rng, *arguments, *options)
                )
                if field is not None:
                    field[:, some] = states
        photons.direction[:, who] = direction
        if photons.field is not None:
            photons.field[:, who] = field
        return transmitted

    def _arrive(self, flock: Flock, who: Indices) -> None:
        """Let the detector send back, refuse or detect light that has reached it.

        It reflects diffusely before anything else is decided, then as a mirror, and refuses last.
        """
        bench, (_, photons, place) = self._bench, flock
        if not self._decides:
            return
        # drawn for all and first, although decided last
        accepted = acceptance(bench, photons.position[:, who], photons.direction[:, who])
        refused = self._rng.random(who.size) >= accepted
        diffuse = self._rng.random(who.size) < bench.detector_reflectance
        self._send_up(flock, who[diffuse])
        place[who[refused & ~diffuse]] = Place.ABSORBED_SURFACE
        if self._film is not None:
            self._meet_film(flock, who[~diffuse], self._film)
        elif bench.detector_specular:
            who = who[~diffuse]
            who = who[self._rng.random(who.size) < bench.detector_specular]
            # a metal turns the component across the plane of incidence round
            ones = np.ones(who.size, dtype=np.complex128)
            self._mirror(flock, who, -ones, ones)

    def _meet_film(self, flock: Flock, who: Indices, film: AbsorbingFilm) -> None:
        """Reflect photons off the photocathode, or lose them behind it; it absorbs the others."""
        photons, place = flock.photons, flock.place
        waves, transmitted = film.waves(np.abs(photons.direction[2, who]))
        if photons.field is None:
            shares = np.full((2, who.size), 0.5)
        else:
            across, along = _frame(photons.direction[:, who])
            field = photons.field[:, who]
            shares = np.abs(np.stack((dot(across, field), dot(along, field)))) ** 2
        chance = self._rng.random(who.size)
        below = (shares * np.abs(waves) ** 2).sum(axis=0)
        mirrored = chance < below
        through = ~mirrored & (chance < below + (shares * transmitted).sum(axis=0))
        self._mirror(flock, who[mirrored], *waves[:, mirrored])
        place[who[through]] = Place.ABSORBED_SURFACE

    def _mirror(
        self, flock: Flock, who: Indices, across_wave: Complexes, along_wave: Complexes
    ) -> None:
        """Send photons back up at the detector, with amplitudes of s and p polarised light."""
        photons = flock.photons
        before = photons.direction[:, who]
        photons.direction[2, who] *= -1.0
        flock.place[who] = Place.WINDOW
        if photons.field is not None:
            across, along = _frame(before)
            field = photons.field[:, who]
            after = across_wave * dot(across, field) * across
            # the p component turns with the ray
            turned = np.stack((-along[0], -along[1], along[2]))
            after = after + along_wave * dot(along, field) * turned
            photons.field[:, who] = after / np.sqrt(np.sum(np.abs(after) ** 2, axis=0))

    def _meet_mask(self, flock: Flock, who: Indices) -> None:
        """Send part of the photons that come down to the mask up again, by the cosine law."""
        above = flock.photons.direction[2, who] < 0.0
        who = who[above & (self._rng.random(who.size) < self._bench.housing_reflectance)]
        self._send_up(flock, who, flock.region)

    def _send_up(self, flock: Flock, who: Indices, region: Place = Place.WINDOW) -> None:
        """Launch photons diffusely upwards, in a region."""
        flock.place[who] = region
        up = np.repeat([[0.0], [0.0], [1.0]], who.size, axis=1)
        self._launch(flock.photons, who, lambertian(self._rng, up))

    def _note_mask_radius(
        self, photons: PhotonArrays, who: Indices, body: Place, face: Indices, position: Floats
    ) -> None:
        """Keep how far from the axis the photons have met the mask's plane."""
        there = np.flatnonzero(self._layout.on_mask_plane(body, face))
        axis = self._layout.detector_centre
        radius = np.hypot(position[0, there] - axis[0], position[1, there])
        assert photons.record is not None  # as `_meet` has seen
        row, who = photons.record[Record.MASK_RADIUS], who[there]
        row[who] = np.maximum(row[who], radius)

    def _reflect(
        self, flock: Flock, who: Indices, normal: Floats, reflectance: float | None
    ) -> None:
        """Reflect photons about ``normal``, (3, m), into their region, or absorb them.

        Diffusely, but for the wrap's part that goes as from a metal's mirror.
        """
        assert reflectance is not None  # a bench without a reflector has no light there
        reflected = self._rng.random(who.size) < reflectance
        flock.place[who[~reflected]] = Place.ABSORBED_REFLECTOR
        who = who[reflected]
        flock.place[who] = flock.region
        photons, normal = flock.photons, normal[:, reflected]
        mirrored = np.zeros(who.size, dtype=bool)
        if flock.region != Place.OUTSIDE and self._bench.wrap_specular:
            mirrored = self._rng.random(who.size) < self._bench.wrap_specular
            of, axis = who[mirrored], normal[:, mirrored]
            before = photons.direction[:, of]
            photons.direction[:, of] = before - 2.0 * dot(before, axis) * axis
            if photons.field is not None:
                field = photons.field[:, of]
                photons.field[:, of] = 2.0 * dot(field, axis) * axis - field
        self._launch(photons, who[~mirrored], lambertian(self._rng, normal[:, ~mirrored]))

    def _launch(self, photons: PhotonArrays, who: Indices, direction: Floats) -> None:
        """Give photons new directions, (3, m), and with them a new, random polarisation."""
        photons.direction[:, who] = direction
        if photons.field is not None:
            photons.field[:, who] = random_polarisation(self._rng, direction)
