"""What light does at a surface: Fresnel, masks, Lambertian reflectors, detectors.

Formulas: M. Born and E. Wolf, Principles of Optics, section 1.5. The field of a
polarised photon is a complex vector perpendicular to its direction, of unit
length, kept as two real vectors; so no reference frame has to be carried along.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.kernel.scene_model import DETECTOR, DIELECTRIC, DIFFUSE, opaque

# Fates of a photon at a surface or in flight; absorption in volumes is counted apart.
ALIVE, DETECTED, APERTURE, REFLECTOR, SURFACE, ESCAPED, TRUNCATED, LOST, VOLUME = range(9)


class SurfaceTables:
    """Properties of the surfaces, one row per face or shape, gathered in the loop.

    Four numbers are gathered at once: that takes a quarter of the time, and gathers are
    what a step of the loop spends most on.

    Parameters
    ----------
    surfaces : sequence of `scene_model.Surface`
    normals : sequence of ndarray of shape (3,), optional
        Of flat faces, one per row.
    """

    def __init__(self, surfaces, normals=None) -> None:
        self._has_normals = normals is not None
        self._has_masks = any(s.aperture_radius_mm < float("inf") for s in surfaces)
        self._has_reflectors = any(s.kind == DIFFUSE for s in surfaces)
        self._off_axis = any(s.aperture_centre_mm != (0.0, 0.0) for s in surfaces)
        vectors = [(0.0, 0.0, 0.0)] * len(surfaces) if normals is None else normals
        self._shape = _packed([(*n, s.eta) for n, s in zip(vectors, surfaces, strict=True)])
        # small integers are exact in single precision
        self._sides = _packed(
            [(s.kind, s.interior, s.exterior, min(s.aperture_radius_mm, 1e18)) for s in surfaces]
        )
        self._special = _packed(
            [(*s.aperture_centre_mm, s.reflectance, s.two_sided) for s in surfaces]
        )

    def at(self, row, active) -> SurfaceRow:
        """Properties at the gathered rows."""
        shape = dr.gather(mi.Vector4f, self._shape, row, active)
        kind, interior, exterior, radius = dr.gather(mi.Vector4f, self._sides, row, active)
        x = y = mi.Float(0.0)
        reflectance = two_sided = None
        if self._has_reflectors or self._off_axis:
            x, y, reflectance, two_sided = dr.gather(mi.Vector4f, self._special, row, active)
        return SurfaceRow(
            kind=mi.UInt32(kind),
            eta=shape.w,
            normal=mi.Vector3f(shape.x, shape.y, shape.z) if self._has_normals else None,
            interior=mi.UInt32(interior),
            exterior=mi.UInt32(exterior),
            reflectance=reflectance if self._has_reflectors else None,
            two_sided=two_sided > 0.5 if self._has_reflectors else None,
            radius=radius if self._has_masks else None,
            x=x,
            y=y,
        )


def _packed(rows):
    """Rows of four numbers as one opaque table."""
    return opaque([float(value) for row in rows for value in row])


@dataclass
class SurfaceRow:
    """Gathered properties, Dr.Jit arrays; ``None`` where no surface of the scene has them."""

    kind: object
    eta: object
    normal: object
    interior: object
    exterior: object
    reflectance: object
    two_sided: object
    radius: object
    x: object
    y: object


@dataclass
class Outcome:
    """What a photon does at a surface.

    Attributes
    ----------
    direction : Vector3f
        New unit direction.
    field : Field or None
        New polarisation.
    fate : UInt32
        `ALIVE`, or why it ended.
    weight : Float
        Factor on the weight; below 1 only for BSDFs that lose energy.
    crossed : Mask
        Whether it went through the surface.
    polished : Mask
        Whether it met the interface of two dielectrics.
    cosine : Float
        Of the angle of arrival to the normal.
    volume : UInt32
        Volume it is in afterwards.
    position : Point3f
        Where it goes on from, mm.
    """

    direction: object
    field: object
    fate: object
    weight: object
    crossed: object
    polished: object
    cosine: object
    volume: object = None
    position: object = None


@dataclass
class Field:
    """Complex field of a polarised photon: real and imaginary part, Vector3f each."""

    re: object
    im: object


def unpolarised_field(direction, angle):
    """A linear polarisation at a random angle (Float, radian) around the direction.

    Uniform angles make the ensemble unpolarised.
    """
    frame = mi.Frame3f(direction)
    sine, cosine = dr.sincos(angle)
    return Field(frame.s * cosine + frame.t * sine, mi.Vector3f(0.0))


def interact(row, position, direction, field, normal, uniforms, polarization):
    """Decide a photon's way at a surface.

    Parameters
    ----------
    row : SurfaceRow
    position : Point3f
        Where the surface is met, mm.
    direction : Vector3f
        Unit direction of flight.
    field : Field or None
    normal : Vector3f
        Unit normal, pointing to the exterior.
    uniforms : tuple of Float
        A choice, and two for a diffuse direction (and one more when polarised).
    polarization : bool

    Returns
    -------
    Outcome
        Without `volume` and `position`, which the caller knows.
    """
    choice, u, v = uniforms[:3]
    cos_signed = dr.dot(direction, normal)
    leaving = cos_signed > 0
    cos_i = dr.minimum(dr.abs(cos_signed), 1.0)
    facing = dr.select(leaving, -normal, normal)
    # n_i / n_t along the direction of travel
    ratio = dr.select(leaving, row.eta, dr.rcp(row.eta))
    matched = ratio == 1.0
    # Written so that it is exact where the indices agree, and accurate at grazing incidence.
    cos_t2 = dr.fma(dr.square(ratio), dr.square(cos_i), 1.0 - dr.square(ratio))
    total = cos_t2 <= 0.0
    cos_t = dr.safe_sqrt(cos_t2)

    if polarization:
        reflectance, waves = _polarised_split(direction, field, facing, ratio, cos_i, cos_t, cos_t2)
    else:
        r_s = (ratio * cos_i - cos_t) / dr.fma(ratio, cos_i, cos_t)
        r_p = (ratio * cos_t - cos_i) / dr.fma(ratio, cos_t, cos_i)
        reflectance = 0.5 * (dr.square(r_s) + dr.square(r_p))
    reflectance = dr.select(total, 1.0, dr.select(matched, 0.0, reflectance))

    reflected = choice < reflectance
    mirrored = dr.fma(facing, 2.0 * cos_i, direction)
    bent = dr.fma(direction, ratio, facing * (ratio * cos_i - cos_t))
    new_direction = dr.normalize(dr.select(reflected, mirrored, bent))
    crossed = ~reflected
    new_field = None
    if polarization:
        new_field = _field_after(waves, reflected, matched, new_direction, field)

    detector = row.kind == DETECTOR
    fate = dr.select(detector, mi.UInt32(DETECTED), mi.UInt32(ALIVE))
    if row.reflectance is not None:
        diffuse = row.kind == DIFFUSE
        kept = (choice < row.reflectance) & (row.two_sided | ~leaving)
        fate = dr.select(diffuse & ~kept, mi.UInt32(REFLECTOR), fate)
        # Lambert's law: a point of the unit sphere that touches the surface
        scattered = dr.normalize(facing + mi.warp.square_to_uniform_sphere(mi.Point2f(u, v)))
        new_direction = dr.select(diffuse, scattered, new_direction)
        crossed &= ~diffuse
        if polarization:
            fresh = unpolarised_field(scattered, dr.two_pi * uniforms[3])
            new_field = Field(
                dr.select(diffuse, fresh.re, new_field.re),
                dr.select(diffuse, fresh.im, new_field.im),
            )
    if row.radius is not None:
        from_axis = dr.square(position.x - row.x) + dr.square(position.y - row.y)
        fate = dr.select(from_axis > dr.square(row.radius), mi.UInt32(APERTURE), fate)
    polished = row.kind == DIELECTRIC
    return Outcome(new_direction, new_field, fate, mi.Float(1.0), crossed, polished, cos_i)


def _polarised_split(direction, field, facing, ratio, cos_i, cos_t, cos_t2):
    """Reflectance of this photon, and its reflected and transmitted amplitudes."""
    s = dr.cross(direction, facing)
    length2 = dr.squared_norm(s)
    # At normal incidence every direction across is as good as another.
    s = dr.select(length2 > 1e-12, s * dr.rsqrt(length2), mi.Frame3f(direction).s)
    p = dr.cross(direction, s)
    e_s = mi.Complex2f(dr.dot(field.re, s), dr.dot(field.im, s))
    e_p = mi.Complex2f(dr.dot(field.re, p), dr.dot(field.im, p))
    # Under total reflection cos_t is i * sqrt(-cos_t2) and both amplitudes have modulus 1.
    below = dr.safe_sqrt(-cos_t2)
    total = cos_t2 <= 0.0
    c_t = mi.Complex2f(dr.select(total, 0.0, cos_t), dr.select(total, below, 0.0))
    den_s, den_p = ratio * cos_i + c_t, ratio * c_t + cos_i
    r_s, r_p = (ratio * cos_i - c_t) / den_s, (cos_i - ratio * c_t) / den_p
    t_s, t_p = 2.0 * ratio * cos_i / den_s, 2.0 * ratio * cos_i / den_p
    reflectance = dr.squared_norm(r_s * e_s) + dr.squared_norm(r_p * e_p)
    return reflectance, (s, (r_s * e_s, r_p * e_p), (t_s * e_s, t_p * e_p))


def _field_after(waves, reflected, matched, new_direction, old):
    """The field after reflection or refraction, normalised to one photon."""
    s, by_reflection, by_refraction = waves
    p = dr.cross(new_direction, s)
    e_s, e_p = (
        dr.select(reflected, r, t) for r, t in zip(by_reflection, by_refraction, strict=True)
    )
    re = s * e_s.real + p * e_p.real
    im = s * e_s.imag + p * e_p.imag
    scale = dr.rsqrt(dr.squared_norm(re) + dr.squared_norm(im))
    return Field(
        dr.select(matched, old.re, re * scale),
        dr.select(matched, old.im, im * scale),
    )
