"""What light does at a surface: interfaces, masks, Lambertian reflectors, detectors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.optics.thin_film import ThinFilm
from mcrim_mitsuba.transport import dielectric
from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.scene_model import DETECTOR, DIELECTRIC, DIFFUSE

# Fates of a photon at a surface or in flight; absorption in volumes is counted apart.
ALIVE, DETECTED, APERTURE, REFLECTOR, SURFACE, ESCAPED, TRUNCATED, LOST, VOLUME = range(9)

#: Cosine of an angle of acceptance that is as good as all.
STRAIGHT_ACROSS = 1e-6
#: Radius of the hole, in mm, where there is no mask.
NO_MASK = 1e18


class SurfaceTables:
    """Properties of the surfaces, one row per face or shape, gathered in the loop.

    Four numbers are gathered at once: that takes a quarter of the time, and gathers are
    what a step of the loop spends most on.

    Parameters
    ----------
    surfaces : sequence of `scene_model.Surface`
    normals : sequence of ndarray of shape (3,)
        One for each; they matter for flat faces alone.

    Attributes
    ----------
    may_absorb : bool
        Whether a surface can take light that is counted neither as mask nor as reflector.
    may_scatter : bool
        Whether a surface takes a choice and a random direction.
    """

    def __init__(self, surfaces, normals) -> None:
        self._has_masks = any(s.aperture_radius_mm < float("inf") for s in surfaces)
        self._off_axis = any(s.axis_mm != (0.0, 0.0) for s in surfaces)
        self._rough = any(s.roughness for s in surfaces)
        self._beckmann = any(s.roughness and s.beckmann for s in surfaces)
        self._lossy = any(s.surface_loss for s in surfaces)
        self._choosy = any(s.angular_falloff or s.radial_falloff_per_mm2 for s in surfaces)
        self._hazy = any(s.haze for s in surfaces)
        self._selective = any(s.least_cosine > STRAIGHT_ACROSS for s in surfaces)
        self._mirrors = any(s.specular for s in surfaces)
        self._masks_reflect = any(s.mask_reflectance for s in surfaces)
        # all detectors are alike
        self._film = next((FilmTerms.of(s.film) for s in surfaces if s.film is not None), None)
        self.may_absorb = self._lossy or self._choosy or self._selective or self._film is not None
        self._diffuse = any(
            s.kind == DIFFUSE or (s.kind == DETECTOR and s.reflectance) for s in surfaces
        )
        self.may_scatter = self._diffuse or self._masks_reflect
        # small integers are exact in single precision
        self._shape, self._sides, self._special, self._quality, self._further = (
            opaque([float(value) for row in rows for value in row])
            for rows in (
                [(*n, s.eta) for n, s in zip(normals, surfaces, strict=True)],
                [(s.kind, *s.sides, min(s.aperture_radius_mm, NO_MASK)) for s in surfaces],
                [(*s.axis_mm, s.reflectance, s.two_sided or s.kind == DETECTOR) for s in surfaces],
                [
                    (
                        -s.roughness if s.beckmann else s.roughness,
                        s.surface_loss,
                        s.angular_falloff,
                        s.radial_falloff_per_mm2,
                    )
                    for s in surfaces
                ],
                [(s.haze, s.least_cosine, s.specular, s.mask_reflectance) for s in surfaces],
            )
        )

    def at(self, row, active) -> SurfaceRow:
        """Properties at the gathered rows."""
        *normal, eta = dr.gather(mi.Vector4f, self._shape, row, active)
        kind, interior, exterior, radius = dr.gather(mi.Vector4f, self._sides, row, active)
        found = SurfaceRow(
            mi.UInt32(kind), eta, mi.UInt32(interior), mi.UInt32(exterior), mi.Vector3f(*normal)
        )
        if self._has_masks:
            found.radius = radius
        if self._diffuse or self._off_axis:
            found.x, found.y, *returns = dr.gather(mi.Vector4f, self._special, row, active)
            if self._diffuse:
                found.reflectance, found.two_sided = returns[0], returns[1] > 0.5
        if self._hazy or self._selective or self._mirrors or self._masks_reflect:
            further = dr.gather(mi.Vector4f, self._further, row, active)
            found.haze = further[0] if self._hazy else None
            found.least_cosine = further[1] if self._selective else None
            found.specular = further[2] if self._mirrors else None
            found.mask_reflectance = further[3] if self._masks_reflect else None
        found.film = self._film
        if self._rough or self._lossy or self._choosy:
            roughness, loss, *falloffs = dr.gather(mi.Vector4f, self._quality, row, active)
            found.roughness, found.beckmann = roughness if self._rough else None, self._beckmann
            found.surface_loss = loss if self._lossy else None
            if self._choosy:
                found.angular_falloff, found.radial_falloff = falloffs
        return found


@dataclass
class SurfaceRow:
    """Gathered properties, Dr.Jit arrays; ``None`` where no surface of the scene has them."""

    kind: Any
    eta: Any
    interior: Any
    exterior: Any
    normal: Any
    reflectance: Any = None
    two_sided: Any = None
    #: Of the hole of a mask. The axis of the mask, or of a detector, goes through x and y.
    radius: Any = None
    x: Any = 0.0
    y: Any = 0.0
    #: Alpha of facets, negative of Beckmann's distribution, and whether any surface has these.
    roughness: Any = None
    beckmann: bool = False
    surface_loss: Any = None
    angular_falloff: Any = None
    radial_falloff: Any = None
    haze: Any = None
    least_cosine: Any = None
    specular: Any = None
    mask_reflectance: Any = None
    #: `FilmTerms` of the detectors, the same for all rows.
    film: Any = None


@dataclass
class Outcome:
    """What a photon does at a surface."""

    #: Vector3f: New unit direction.
    direction: Any
    #: New polarisation.
    field: Any
    #: UInt32: `ALIVE`, or why it ended.
    fate: Any
    #: Factor on the weight, below 1 only at surfaces that lose energy. Of photons that end it is 1,
    #: but for what a photocathode detects.
    weight: Any
    #: Whether it went through the surface.
    crossed: Any
    #: Whether it met the interface of two dielectrics.
    polished: Any
    #: Of the angle of arrival to the normal.
    cosine: Any
    #: UInt32: Volume it is in afterwards.
    volume: Any
    #: Point3f: Where it goes on from, mm.
    position: Any
    #: Whether a diffuse reflector or a detector sent it back; ``None`` where none ever does.
    from_reflector: Any = None
    from_detector: Any = None
    #: Whether the upper side of a mask did; ``None`` where none ever does.
    from_mask: Any = None
    #: Square of the distance from the axis of the mask that the face wears; 0 if it wears none,
    #: ``None`` if no face of the scene does.
    mask_radius2_mm2: Any = None
    #: The same from the axis of a mask or a detector.
    from_axis2_mm2: Any = None


def interact(row, position, direction, field, uniforms, rng=None, active=True) -> Outcome:
    """Decide a photon's way at a surface.

    Parameters
    ----------
    row : SurfaceRow
        Its normal points to the exterior.
    position : Point3f
        Where the surface is met, mm.
    direction : Vector3f
        Unit direction of flight.
    field : Field or None
        Where polarisation is followed.
    uniforms : tuple of Float
        A choice, and two for a diffuse direction (and one more when polarised).
    rng : mitsuba.PCG32, optional
        Further numbers for the facets of rough faces; advanced in place.
    active : Mask
        Photons that are at a surface at all.
    """
    choice, u, v = uniforms[:3]
    cos_signed = dr.dot(direction, row.normal)
    leaving = cos_signed > 0
    cos_i = dr.minimum(dr.abs(cos_signed), 1.0)
    facing = dr.select(leaving, -row.normal, row.normal)
    # n_i / n_t along the direction of travel
    ratio = dr.select(leaving, row.eta, dr.rcp(row.eta))
    polished = row.kind == DIELECTRIC
    way = dielectric.split(direction, field, facing, ratio, cos_i, choice)
    hazy = active & polished
    haze = None if row.haze is None else row.haze * dr.select(leaving, 1.0, dr.rcp(row.eta))
    if row.roughness is not None:
        rough = hazy & (row.roughness != 0.0)
        way = dielectric.walk_facets(
            way,
            rough,
            direction,
            field,
            facing,
            ratio,
            row.roughness,
            haze,
            rng,
            beckmann=row.beckmann,
        )
        hazy &= ~rough
    if haze is not None:
        way = dielectric.scatter_by_haze(way, haze, hazy, field, facing, ratio, cos_i, rng)
    new_direction, new_field, reflected = way
    crossed = ~reflected

    detector = row.kind == DETECTOR
    fate = dr.select(detector, mi.UInt32(DETECTED), mi.UInt32(ALIVE))
    from_reflector = from_detector = None
    # part of the choices that a detector has taken to send light back
    returned_part: Any = 0.0
    if row.reflectance is not None:
        diffuse = row.kind == DIFFUSE
        kept = (choice < row.reflectance) & (row.two_sided | ~leaving)
        from_reflector, from_detector = diffuse & kept, detector & kept
        fate = dr.select(diffuse & ~kept, mi.UInt32(REFLECTOR), fate)
        fate = dr.select(from_detector, mi.UInt32(ALIVE), fate)
        # Lambert's law: a point of the unit sphere that touches the surface
        scattered = dr.normalize(facing + mi.warp.square_to_uniform_sphere(mi.Point2f(u, v)))
        returned = diffuse | from_detector
        new_direction = dr.select(returned, scattered, new_direction)
        crossed &= ~returned
        if field is not None:
            fresh = dielectric.unpolarised_field(scattered, dr.two_pi * uniforms[3])
            new_field = dr.select(returned, fresh, new_field)
        returned_part = row.reflectance
    detected_part = None
    if row.film is not None or row.specular is not None:
        mirror = _mirror_of(row, direction, field, facing, cos_i)
        mirrored_part = dr.lerp(returned_part, 1.0, mirror.reflectance)
        mirrored = (fate == DETECTED) & (choice < mirrored_part)
        fate = dr.select(mirrored, mi.UInt32(ALIVE), fate)
        from_detector = mirrored if from_detector is None else from_detector | mirrored
        from_reflector = mi.Mask(False) if from_reflector is None else from_reflector
        reflection = dr.fma(facing, 2.0 * cos_i, direction)
        new_direction = dr.select(mirrored, dr.normalize(reflection), new_direction)
        crossed &= ~mirrored
        if field is not None:
            after = dielectric.field_of(mirror.waves, mirror.across, new_direction)
            new_field = dr.select(mirrored, after, new_field)
        returned_part, detected_part = mirrored_part, mirror.detected_part
    from_axis = dr.square(position.x - row.x) + dr.square(position.y - row.y)
    if row.angular_falloff is not None:
        # negative: over the largest that it may be
        accepted = dr.clip(dr.fma(-row.angular_falloff, 1.0 - cos_i, 1.0), 0.0, 2.0)
        accepted /= 1.0 - dr.minimum(row.angular_falloff, 0.0)
        accepted *= dr.clip(dr.fma(-row.radial_falloff, from_axis, 1.0), 0.0, 1.0)
        if not isinstance(returned_part, float):
            # of the choices that are left when some have sent light back
            accepted = dr.lerp(returned_part, 1.0, accepted)
        refused = (fate == DETECTED) & (choice >= accepted)
        fate = dr.select(refused, mi.UInt32(SURFACE), fate)
    if row.least_cosine is not None:
        slanted = (fate == DETECTED) & (cos_i < row.least_cosine)
        fate = dr.select(slanted, mi.UInt32(SURFACE), fate)
    mask_radius2 = None
    if row.radius is not None:
        masked = from_axis > dr.square(row.radius)
        fate = dr.select(masked, mi.UInt32(APERTURE), fate)
        mask_radius2 = dr.select(row.radius < NO_MASK, from_axis, 0.0)
    from_mask = None
    if row.mask_reflectance is not None:
        # of the side that light comes down to
        from_mask = masked & (direction.z < 0.0) & (choice < row.mask_reflectance)
        fate = dr.select(from_mask, mi.UInt32(ALIVE), fate)
        upwards = dr.normalize(facing + mi.warp.square_to_uniform_sphere(mi.Point2f(u, v)))
        new_direction = dr.select(from_mask, upwards, new_direction)
        crossed &= ~from_mask
        polished &= ~from_mask
        if field is not None:
            fresh = dielectric.unpolarised_field(upwards, dr.two_pi * uniforms[3])
            new_field = dr.select(from_mask, fresh, new_field)
        if from_reflector is not None:
            from_reflector, from_detector = (
                each & ~from_mask for each in (from_reflector, from_detector)
            )
    weight = mi.Float(1.0)
    if detected_part is not None:
        weight = dr.select(fate == DETECTED, detected_part, 1.0)
    if row.surface_loss is not None:
        inwards = polished & reflected & leaving & (fate == ALIVE)
        weight = dr.select(inwards, 1.0 - row.surface_loss, weight)
    return Outcome(
        new_direction,
        new_field,
        fate,
        weight,
        crossed,
        polished,
        cos_i,
        volume_after(row, crossed, leaving),
        position,
        from_reflector,
        from_detector,
        from_mask,
        mask_radius2,
        from_axis,
    )


def volume_after(row, crossed, leaving):
    """Volume (UInt32) of what `crossed` a face or did not, and came from behind it if `leaving`."""
    return dr.select(crossed ^ leaving, row.interior, row.exterior)


# ---- detectors that reflect as mirrors do -------------------------------------------------------


@dataclass(frozen=True)
class FilmTerms:
    """Numbers of a photocathode (`optics.thin_film.ThinFilm`) in the kernel, opaque."""

    #: Complex2f: Square of the film's index over the window's.
    film: Any
    #: Float: Square of 1 over the window's index.
    vacuum: Any
    #: Float: 2 pi times the film's thickness, over the wavelength in the window.
    phase: Any

    @classmethod
    def of(cls, film: ThinFilm) -> FilmTerms:
        """Those of a film."""
        square = (film.index / film.window_index) ** 2
        return cls(
            mi.Complex2f(opaque([square.real]), opaque([square.imag])),
            opaque([film.window_index**-2]),
            opaque([2.0 * math.pi * film.wavelengths * film.window_index]),
        )

    def amplitudes(self, cosine):
        """Reflected amplitudes and transmittances of s and p polarised light, s first.

        At cosines of the angle of incidence in the window; formulas as in `optics.thin_film`.
        """
        # what is behind a face at grazing incidence does not matter, but must be no 0 / 0
        a = dr.maximum(cosine, 1e-6)
        sine2 = dr.fma(-a, a, 1.0)
        inside = dr.sqrt(self.film - sine2)
        left = self.vacuum - sine2
        beyond = mi.Complex2f(dr.safe_sqrt(left), dr.safe_sqrt(-left))
        across = dr.exp(mi.Complex2f(-inside.imag, inside.real) * self.phase)
        reflected, transmitted = [], []
        for b, c in ((inside, beyond), (inside / self.film, beyond / self.vacuum)):
            front, back = (a - b) / (a + b), (b - c) / (b + c)
            echo = back * across * across
            round_trip = 1.0 + front * echo
            reflected.append((front + echo) / round_trip)
            through = (1.0 + front) * (1.0 + back) * across / round_trip
            transmitted.append(c.real / a * dr.squared_norm(through))
        return reflected, transmitted


@dataclass
class Mirror:
    """What a mirror does to light that meets it."""

    #: Float: Probability of reflection.
    reflectance: Any
    #: Float: What is detected of light that is not reflected; ``None`` for all.
    detected_part: Any = None
    #: Vector3f across the plane of incidence and reflected amplitudes, where fields are followed.
    across: Any = None
    waves: Any = None


def _mirror_of(row, direction, field, facing, cos_i) -> Mirror:
    """The photocathode, or the mirror that a detector is with some probability."""
    share = mi.Float(0.0) if row.specular is None else row.specular
    if row.film is None:
        if field is None:
            return Mirror(share)
        # of a perfect metal
        s, e_s, e_p = dielectric.components(direction, field, facing)
        return Mirror(share, None, s, (-e_s, e_p))
    (r_s, r_p), (through_s, through_p) = row.film.amplitudes(cos_i)
    across = waves = None
    if field is None:
        reflected = 0.5 * (dr.squared_norm(r_s) + dr.squared_norm(r_p))
        through = 0.5 * (through_s + through_p)
    else:
        across, e_s, e_p = dielectric.components(direction, field, facing)
        waves = r_s * e_s, r_p * e_p
        reflected = dr.squared_norm(waves[0]) + dr.squared_norm(waves[1])
        through = through_s * dr.squared_norm(e_s) + through_p * dr.squared_norm(e_p)
    left = dr.maximum(1.0 - reflected, 1e-6)
    return Mirror(reflected, dr.clip(1.0 - through / left, 0.0, 1.0), across, waves)
