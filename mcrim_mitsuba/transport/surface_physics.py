"""What light does at a surface: interfaces, masks, Lambertian reflectors, detectors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.optics.thin_film import ThinFilm
from mcrim_mitsuba.transport import dielectric
from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.scene_model import DETECTOR, DIELECTRIC, DIFFUSE, Surface

# Fates of a photon at a surface or in flight; absorption in volumes is counted apart.
ALIVE, DETECTED, APERTURE, REFLECTOR, SURFACE, ESCAPED, TRUNCATED, LOST, VOLUME = range(9)

#: Cosine of an angle of acceptance that is as good as all.
STRAIGHT_ACROSS = 1e-6
#: Radius of the hole, in mm, where there is no mask.
NO_MASK = 1e18


#: Columns of the tables that are there where a surface has such a number.
_PLAIN = "contact painted surface_loss ground_loss haze specular mask_reflectance detector"
#: Optional columns of the tables: of which surfaces they matter, and what `SurfaceRow` calls them.
_COLUMNS: tuple[tuple[Callable[[Surface], Any], Mapping[str, Callable[[Surface], Any]]], ...] = (
    (
        lambda s: s.aperture_radius_mm < math.inf,
        {"radius": lambda s: min(s.aperture_radius_mm, NO_MASK)},
    ),
    (lambda s: s.axis_mm != (0.0, 0.0), {"x": lambda s: s.axis_mm[0], "y": lambda s: s.axis_mm[1]}),
    (
        lambda s: s.kind == DIFFUSE or (s.kind == DETECTOR and s.reflectance) or s.contact,
        {
            "reflectance": lambda s: (s.wrapping or s).reflectance,
            "two_sided": lambda s: s.two_sided or s.kind == DETECTOR or s.wrapping is not None,
        },
    ),
    (
        lambda s: (s.wrapping or s).mirror_part,
        {"mirror_part": lambda s: (s.wrapping or s).mirror_part},
    ),
    (
        lambda s: s.contact_above_mm > -math.inf,
        {"contact_above_mm": lambda s: max(s.contact_above_mm, -NO_MASK)},
    ),
    (
        lambda s: s.angular_falloff or s.radial_falloff_per_mm2,
        {
            "angular_falloff": lambda s: s.angular_falloff,
            "radial_falloff": lambda s: s.radial_falloff_per_mm2,
        },
    ),
    *((attrgetter(name), {name: attrgetter(name)}) for name in _PLAIN.split()),
    (lambda s: s.least_cosine > STRAIGHT_ACROSS, {"least_cosine": lambda s: s.least_cosine}),
    (lambda s: s.roughness, {"roughness": lambda s: -s.roughness if s.beckmann else s.roughness}),
)


class SurfaceTables:
    """Properties of the surfaces, one row per face or shape, gathered in the loop.

    Four numbers are gathered at once: that takes a quarter of the time, and gathers are
    what a step of the loop spends most on. Of each surface there is a normal, shape (3,), which
    matters for flat faces alone.
    """

    def __init__(self, surfaces: Sequence[Surface], normals: Sequence[np.ndarray]) -> None:
        columns = {
            name: value
            for matters, values in _COLUMNS
            if any(map(matters, surfaces))
            for name, value in values.items()
        }
        self._names = tuple(columns)
        self._beckmann = any(s.roughness and s.beckmann for s in surfaces)
        # all detectors are alike
        self._film = next((FilmTerms.of(s.film) for s in surfaces if s.film is not None), None)
        losses = {"surface_loss", "ground_loss", "angular_falloff", "least_cosine"}
        #: Whether a surface can take light that is counted neither as mask nor as reflector.
        self.may_absorb = self._film is not None or not losses.isdisjoint(columns)
        #: Whether a surface takes a choice and a random direction.
        self.may_scatter = "reflectance" in columns or "mask_reflectance" in columns
        # small integers are exact in single precision
        numbers = [
            (*normal, s.eta, s.kind, *s.sides, *(value(s) for value in columns.values()))
            for normal, s in zip(normals, surfaces, strict=True)
        ]
        rows = np.array(numbers, dtype=float)
        rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4)))
        self._tables = [opaque(table.ravel()) for table in np.split(rows, rows.shape[1] // 4, 1)]

    def at(self, number, active) -> SurfaceRow:
        """Properties at the gathered rows."""
        x, y, z, eta, kind, interior, exterior, *values = (
            value
            for table in self._tables
            for value in dr.gather(mi.Vector4f, table, number, active)
        )
        row = SurfaceRow(
            kind=mi.UInt32(kind),
            eta=eta,
            interior=mi.UInt32(interior),
            exterior=mi.UInt32(exterior),
            normal=mi.Vector3f(x, y, z),
            film=self._film,
            beckmann=self._beckmann,
            **dict(zip(self._names, values, strict=False)),
        )
        if row.two_sided is not None:
            row.two_sided = row.two_sided > 0.5
        return row


@dataclass(kw_only=True)
class SurfaceRow:
    """Gathered properties, Dr.Jit arrays; ``None`` where no surface of the scene has them."""

    kind: Any
    eta: Any
    interior: Any
    exterior: Any
    normal: Any
    reflectance: Any = None
    two_sided: Any = None
    mirror_part: Any = None
    contact: Any = None
    painted: Any = None
    contact_above_mm: Any = None
    #: Of the hole of a mask. The axis of the mask, or of a detector, goes through x and y.
    radius: Any = None
    x: Any = 0.0
    y: Any = 0.0
    #: Alpha of facets, negative of Beckmann's distribution, and whether any surface has these.
    roughness: Any = None
    beckmann: bool = False
    surface_loss: Any = None
    ground_loss: Any = None
    angular_falloff: Any = None
    radial_falloff: Any = None
    haze: Any = None
    least_cosine: Any = None
    specular: Any = None
    mask_reflectance: Any = None
    #: Number of the detector; ``None`` where there is one only.
    detector: Any = None
    #: `FilmTerms` of the detectors, the same for all rows.
    film: Any = None


@dataclass(kw_only=True)
class Outcome:
    """What a photon does at a surface."""

    #: Vector3f: New unit direction.
    direction: Any
    #: New polarisation.
    field: Any
    #: UInt32: `ALIVE`, or why it ended.
    fate: Any
    #: Whether it went through the surface.
    crossed: Any
    #: Whether it met the interface of two dielectrics.
    polished: Any
    #: Of the angle of arrival to the normal.
    cosine: Any
    #: Point3f: Where it goes on from, mm.
    position: Any
    #: Square of the distance from the axis of a mask or a detector.
    from_axis2_mm2: Any
    #: Factor on the weight, below 1 only at surfaces that lose energy. Of photons that end it is 1,
    #: but for what a photocathode detects.
    weight: Any = 1.0
    #: Whether it came from inside onto a rough interface; ``None`` where no face is rough.
    met_rough: Any = None
    #: UInt32: Volume it is in afterwards.
    volume: Any = None
    #: UInt32: Face it is on afterwards, and Float: its way in the film before a wrapping, mm;
    #: ``None`` where none goes through such a film in this step (`transport.film`).
    face: Any = None
    in_film: Any = None
    #: Whether a reflector (or UInt32: how often one), or a detector sent it back; ``None`` where
    #: none ever does.
    from_reflector: Any = None
    from_detector: Any = None
    #: Whether the upper side of a mask did; ``None`` where none ever does.
    from_mask: Any = None
    #: UInt32: Number of the detector that the surface is; ``None`` where there is one only.
    detector: Any = None
    #: ``from_axis2_mm2`` of the mask that the face wears; 0 if it wears none, ``None`` if no face
    #: of the scene does.
    mask_radius2_mm2: Any = None

    def send(self, back, light: Encounter, direction, field) -> None:
        """Give photons that are sent `back` (Mask) a new direction and field."""
        self.direction = dr.select(back, direction, self.direction)
        self.crossed &= ~back
        if light.field is not None:
            self.field = dr.select(back, field, self.field)


@dataclass(kw_only=True)
class Encounter:
    """Photons that meet a surface."""

    row: SurfaceRow
    direction: Any
    field: Any
    #: A number that decides, two for a diffuse direction, one for its polarisation.
    choice: Any
    u: Any
    v: Any
    turn: Any
    #: Whether they come from behind the face.
    leaving: Any
    #: Cosine of the angle of incidence, and the unit normal on their side of the face.
    cosine: Any
    facing: Any
    #: Whether they meet a wrapping in contact with the face; ``None`` where none ever do.
    touching: Any = None
    #: Part of the choices that a detector has taken to send light back, and what it detects of
    #: light that it has not; ``None`` for all.
    returned_part: Any = None
    detected_part: Any = None

    def diffuse_about(self, normal):
        """A direction by Lambert's law about a unit normal."""
        # a point of the unit sphere that touches the surface
        return dr.normalize(normal + mi.warp.square_to_uniform_sphere(mi.Point2f(self.u, self.v)))

    def lambertian(self):
        """A direction by Lambert's law, and unpolarised light along it."""
        direction = self.diffuse_about(self.facing)
        if self.field is None:
            return direction, None
        return direction, dielectric.unpolarised_field(direction, dr.two_pi * self.turn)

    def mirrored(self):
        """The direction that a mirror gives, and the field that a perfect metal's does."""
        direction = dr.normalize(dr.fma(self.facing, 2.0 * self.cosine, self.direction))
        if self.field is None:
            return direction, None
        parts = self.field.re, self.field.im
        turned = (dr.fma(self.facing, 2.0 * dr.dot(self.facing, e), -e) for e in parts)
        return direction, dielectric.Field(*turned)


def interact(
    row, position, direction, field, uniforms, rng=None, active=True, beyond=None, drawn=None
) -> Outcome:
    """Decide a photon's way at a surface, stage by stage.

    It is met at a `position` (Point3f, mm) in a unit `direction` of flight (Vector3f); the normal
    of its `row` (SurfaceRow) points to the exterior. A `field` (Field) is there where polarisation
    is followed. Of the `uniforms` (Float) the first is a choice, two are for a diffuse direction
    (and one more when polarised); `rng` (``mitsuba.PCG32``) gives further numbers for the facets of
    rough faces, and is advanced in place. Photons that are at a surface at all are `active` (Mask).
    What happens `beyond` it in the same step is a function of Encounter and Outcome. Where contact
    is `drawn` (Mask) before, light at an angle of total reflection is there for that only.
    """
    choice, u, v, *turn = uniforms
    cos_signed = dr.dot(direction, row.normal)
    leaving = cos_signed > 0
    touching = None
    if row.contact is not None:
        # the rest of the choice is even again
        meets = leaving if row.painted is None else leaving | (row.painted > 0.5)
        if row.contact_above_mm is not None:
            meets = meets & (position.z > row.contact_above_mm)  # &= would change `leaving`
        contact = row.contact
        if drawn is not None:
            total = dr.square(row.eta) * dr.fma(-cos_signed, cos_signed, 1.0) >= 1.0
            contact = dr.select(drawn & total, 1.0, contact)
        touching = meets & (choice < contact)
        apart = dr.select(meets, (choice - contact) / (1.0 - contact), choice)
        choice = dr.select(touching, choice / contact, apart)
    light = Encounter(
        row=row,
        direction=direction,
        field=field,
        choice=choice,
        u=u,
        v=v,
        turn=turn[0] if turn else None,
        leaving=leaving,
        cosine=dr.minimum(dr.abs(cos_signed), 1.0),
        facing=dr.select(leaving, -row.normal, row.normal),
        touching=touching,
    )
    new_direction, new_field, reflected = _at_interface(light, rng, active)
    outcome = Outcome(
        direction=new_direction,
        field=new_field,
        fate=dr.select(row.kind == DETECTOR, mi.UInt32(DETECTED), mi.UInt32(ALIVE)),
        crossed=~reflected,
        polished=row.kind == DIELECTRIC,
        cosine=light.cosine,
        position=position,
        from_axis2_mm2=dr.square(position.x - row.x) + dr.square(position.y - row.y),
        detector=None if row.detector is None else mi.UInt32(row.detector),
    )
    for stage in (_reflect, _reflect_off_detector, _refuse, _mask):
        stage(light, outcome)
    outcome.weight = mi.Float(1.0)
    if light.detected_part is not None:
        # what a photocathode absorbs
        outcome.weight = dr.select(outcome.fate == DETECTED, light.detected_part, 1.0)
    if row.surface_loss is not None:
        inwards = outcome.polished & reflected & leaving & (outcome.fate == ALIVE)
        outcome.weight = dr.select(inwards, 1.0 - row.surface_loss, outcome.weight)
    if row.roughness is not None:
        outcome.met_rough = (row.kind == DIELECTRIC) & (row.roughness != 0.0) & leaving
    if row.ground_loss is not None:
        # before it finds the interface, or a wrapping in contact
        passing = outcome.met_rough & ((outcome.fate == ALIVE) | (outcome.fate == REFLECTOR))
        outcome.weight *= dr.select(passing, 1.0 - row.ground_loss, 1.0)
    outcome.volume = volume_after(row, outcome.crossed, leaving)
    if beyond is not None:
        beyond(light, outcome)
    return outcome


def _at_interface(light: Encounter, rng, active):
    """What two dielectrics do, smooth, rough or hazy, in the form of `dielectric.split`."""
    row, facing, cosine = light.row, light.facing, light.cosine
    # n_i / n_t along the direction of travel
    ratio = dr.select(light.leaving, row.eta, dr.rcp(row.eta))
    flight = light.direction, light.field, facing, ratio
    way = dielectric.split(*flight, cosine, light.choice)
    hazy = active & (row.kind == DIELECTRIC)
    haze = None if row.haze is None else row.haze * dr.select(light.leaving, 1.0, dr.rcp(row.eta))
    if row.roughness is not None:
        rough = hazy & (row.roughness != 0.0)
        way = dielectric.walk_facets(
            way, rough, *flight, row.roughness, haze, rng, beckmann=row.beckmann
        )
        hazy &= ~rough
    if haze is not None:
        way = dielectric.scatter_by_haze(way, haze, hazy, light.field, facing, ratio, cosine, rng)
    return way


# Stages: each does what one property of surfaces does, where any surface has it.


def _reflect(light: Encounter, outcome: Outcome) -> None:
    """Send part of the light back: a reflector, on its own or on a face, or a detector."""
    row = light.row
    if row.reflectance is None:
        return
    diffuse, detector = row.kind == DIFFUSE, row.kind == DETECTOR
    if light.touching is not None:
        diffuse |= light.touching
        outcome.polished &= ~light.touching
    kept = (light.choice < row.reflectance) & (row.two_sided | ~light.leaving)
    outcome.from_reflector, outcome.from_detector = diffuse & kept, detector & kept
    fate = dr.select(diffuse & ~kept, mi.UInt32(REFLECTOR), outcome.fate)
    outcome.fate = dr.select(outcome.from_detector, mi.UInt32(ALIVE), fate)
    outcome.send(diffuse | outcome.from_detector, light, *light.lambertian())
    if row.mirror_part is not None:
        mirrored = diffuse & (light.choice < row.reflectance * row.mirror_part)
        outcome.send(mirrored, light, *light.mirrored())
    light.returned_part = row.reflectance


def _reflect_off_detector(light: Encounter, outcome: Outcome) -> None:
    """Reflect part of the light that a detector has not sent back as a mirror does."""
    row = light.row
    if row.film is None and row.specular is None:
        return
    reflectance, light.detected_part, (across, waves) = _mirror_of(light)
    returned = 0.0 if light.returned_part is None else light.returned_part
    light.returned_part = dr.lerp(returned, 1.0, reflectance)
    mirrored = (outcome.fate == DETECTED) & (light.choice < light.returned_part)
    outcome.fate = dr.select(mirrored, mi.UInt32(ALIVE), outcome.fate)
    if outcome.from_detector is None:
        outcome.from_reflector, outcome.from_detector = mi.Mask(False), mirrored
    else:
        outcome.from_detector = outcome.from_detector | mirrored
    direction, field = light.mirrored()
    if light.field is not None:
        field = dielectric.field_of(waves, across, direction)
    outcome.send(mirrored, light, direction, field)


def _refuse(light: Encounter, outcome: Outcome) -> None:
    """Let a detector take less of the light that is slanted, or far from its axis."""
    row = light.row
    if row.angular_falloff is not None:
        # negative: over the largest that it may be
        accepted = dr.clip(dr.fma(-row.angular_falloff, 1.0 - light.cosine, 1.0), 0.0, 2.0)
        accepted /= 1.0 - dr.minimum(row.angular_falloff, 0.0)
        accepted *= dr.clip(dr.fma(-row.radial_falloff, outcome.from_axis2_mm2, 1.0), 0.0, 1.0)
        if light.returned_part is not None:
            # of the choices that are left when some have sent light back
            accepted = dr.lerp(light.returned_part, 1.0, accepted)
        refused = (outcome.fate == DETECTED) & (light.choice >= accepted)
        outcome.fate = dr.select(refused, mi.UInt32(SURFACE), outcome.fate)
    if row.least_cosine is not None:
        slanted = (outcome.fate == DETECTED) & (light.cosine < row.least_cosine)
        outcome.fate = dr.select(slanted, mi.UInt32(SURFACE), outcome.fate)


def _mask(light: Encounter, outcome: Outcome) -> None:
    """Let the mask on a face take what is outside of its hole, and send part of it up again."""
    radius, reflectance = light.row.radius, light.row.mask_reflectance
    if radius is None:
        return
    masked = outcome.from_axis2_mm2 > dr.square(radius)
    outcome.fate = dr.select(masked, mi.UInt32(APERTURE), outcome.fate)
    outcome.mask_radius2_mm2 = dr.select(radius < NO_MASK, outcome.from_axis2_mm2, 0.0)
    if reflectance is None:
        return
    # of the side that light comes down to
    back = masked & (light.direction.z < 0.0) & (light.choice < reflectance)
    outcome.from_mask = back
    outcome.fate = dr.select(back, mi.UInt32(ALIVE), outcome.fate)
    outcome.send(back, light, *light.lambertian())
    outcome.polished &= ~back
    if outcome.from_reflector is not None:
        outcome.from_reflector = outcome.from_reflector & ~back
        outcome.from_detector = outcome.from_detector & ~back


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


def _mirror_of(light: Encounter):
    """The photocathode, or the mirror that a detector is with some probability.

    That of reflection; what is detected of light that is not reflected, ``None`` for all; and of
    fields the vector across the plane of incidence with the reflected amplitudes.
    """
    row, field = light.row, light.field
    s: Any = None
    if field is not None:
        s, e_s, e_p = dielectric.components(light.direction, field, light.facing)
    if row.film is None:
        # a perfect metal
        return row.specular, None, (s, None if field is None else (-e_s, e_p))
    (r_s, r_p), (through_s, through_p) = row.film.amplitudes(light.cosine)
    waves = None
    if field is None:
        reflected = 0.5 * (dr.squared_norm(r_s) + dr.squared_norm(r_p))
        through = 0.5 * (through_s + through_p)
    else:
        waves = r_s * e_s, r_p * e_p
        reflected = dr.squared_norm(waves[0]) + dr.squared_norm(waves[1])
        through = through_s * dr.squared_norm(e_s) + through_p * dr.squared_norm(e_p)
    left = dr.maximum(1.0 - reflected, 1e-6)
    return reflected, dr.clip(1.0 - through / left, 0.0, 1.0), (s, waves)
