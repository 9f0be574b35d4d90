"""What light does where two dielectrics meet: at a face that is smooth, rough or hazy.

Formulas: M. Born and E. Wolf, Principles of Optics, section 1.5. The field of a
polarised photon is a complex vector perpendicular to its direction, of unit
length, kept as two real vectors; so no reference frame has to be carried along.

A rough face is a random field of heights without memory (B. G. Smith, IEEE Trans. Antennas
Propag. 15 (1967) 668). A photon walks in it from facet to facet until it leaves, to the front or
to the back (E. Heitz et al., ACM Trans. Graph. 35 (2016) 58): nothing is lost, and isotropic light
in equilibrium stays isotropic. Slopes are GGX's or Beckmann's (B. Walter et al., EGSR 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

#: Facets that one photon meets in a rough face; after that the face is smooth for once.
MOST_FACETS = 64
#: Cosine to the normal of a photon that leaves a rough face; below it rounding might turn it back.
_LEAVING = 1e-6
#: Smith's Lambda of what goes straight up or down.
_LEAST_SHADOW = 1e-12
#: Cotangent of that, over the facets' alpha.
_STEEPEST = 1e6
#: Directions that a hazy face tries for what it scatters; if none is taken, it does not scatter.
_MOST_DIRECTIONS = 1000
#: Rounds of the cipher that gives hazy faces their random numbers.
_HAZE_ROUNDS = 6


@dataclass
class Field:
    """Complex field of a polarised photon: real and imaginary part, Vector3f each."""

    re: Any
    im: Any


def unpolarised_field(direction, angle):
    """A linear polarisation around the direction; even angles (Float, radian) unpolarise."""
    frame = mi.Frame3f(direction)
    sine, cosine = dr.sincos(angle)
    return Field(frame.s * cosine + frame.t * sine, mi.Vector3f(0.0))


def split(direction, field, facing, ratio, cos_i, choice):
    """Reflection or refraction at a plane: new direction and field, whether light was reflected.

    `facing` is the unit normal on the side that light comes from, `ratio` the index there over that
    on the other side, `cos_i` that of the angle of incidence.
    """
    matched = ratio == 1.0
    # Written so that it is exact where the indices agree, and accurate at grazing incidence.
    cos_t2 = dr.fma(dr.square(ratio), dr.square(cos_i), 1.0 - dr.square(ratio))
    total = cos_t2 <= 0.0
    cos_t = dr.safe_sqrt(cos_t2)

    if field is not None:
        part, waves = _polarised_split(direction, field, facing, ratio, cos_i, cos_t, cos_t2)
    else:
        part = reflectance(ratio, cos_i, cos_t)
    part = dr.select(total, 1.0, dr.select(matched, 0.0, part))

    reflected = choice < part
    mirrored = dr.fma(facing, 2.0 * cos_i, direction)
    bent = dr.fma(direction, ratio, facing * (ratio * cos_i - cos_t))
    new_direction = dr.normalize(dr.select(reflected, mirrored, bent))
    new_field = None
    if field is not None:
        s, *both = waves
        amplitudes = (dr.select(reflected, r, t) for r, t in zip(*both, strict=True))
        new_field = dr.select(matched, field, field_of(amplitudes, s, new_direction))
    return new_direction, new_field, reflected


def reflectance(ratio, cos_i, cos_t):
    """Of unpolarised light, from its cosines to the normal on either side; `ratio` as in `split`.

    Not at equal indices, nor in total reflection.
    """
    r_s = (ratio * cos_i - cos_t) / dr.fma(ratio, cos_i, cos_t)
    r_p = (ratio * cos_t - cos_i) / dr.fma(ratio, cos_t, cos_i)
    return 0.5 * (dr.square(r_s) + dr.square(r_p))


def components(direction, field, facing):
    """The direction across the plane of incidence, and the field's s and p components."""
    s = dr.cross(direction, facing)
    length2 = dr.squared_norm(s)
    # At normal incidence every direction across is as good as another.
    s = dr.select(length2 > 1e-12, s * dr.rsqrt(length2), mi.Frame3f(direction).s)
    p = dr.cross(direction, s)
    e_s = mi.Complex2f(dr.dot(field.re, s), dr.dot(field.im, s))
    e_p = mi.Complex2f(dr.dot(field.re, p), dr.dot(field.im, p))
    return s, e_s, e_p


def _polarised_split(direction, field, facing, ratio, cos_i, cos_t, cos_t2):
    """Reflectance of this photon, and its reflected and transmitted amplitudes."""
    s, e_s, e_p = components(direction, field, facing)
    # Under total reflection cos_t is i * sqrt(-cos_t2) and both amplitudes have modulus 1.
    c_t = mi.Complex2f(cos_t, dr.safe_sqrt(-cos_t2))
    den_s, den_p = ratio * cos_i + c_t, ratio * c_t + cos_i
    r_s, r_p = (ratio * cos_i - c_t) / den_s, (cos_i - ratio * c_t) / den_p
    t_s, t_p = 2.0 * ratio * cos_i / den_s, 2.0 * ratio * cos_i / den_p
    reflectance = dr.squared_norm(r_s * e_s) + dr.squared_norm(r_p * e_p)
    return reflectance, (s, (r_s * e_s, r_p * e_p), (t_s * e_s, t_p * e_p))


def field_of(amplitudes, s, direction):
    """The field of s and p amplitudes, normalised to one photon."""
    e_s, e_p = amplitudes
    p = dr.cross(direction, s)
    re = s * e_s.real + p * e_p.real
    im = s * e_s.imag + p * e_p.imag
    scale = dr.rsqrt(dr.squared_norm(re) + dr.squared_norm(im))
    return Field(re * scale, im * scale)


def walk_facets(smooth, rough, direction, field, facing, ratio, alpha, haze, rng, *, beckmann):
    """What the facets of rough faces do in place of smooth ones, in the form of `split`.

    A height counts as the share of the face that lies below it, so that its distribution does not
    matter. What goes through a facet walks on in the same field of heights, upside down.

    `smooth` is what `split` gave; it stays where faces are not `rough` (Mask), or a walk has no
    end. `alpha` (Float) is the facets' roughness, above 0 of GGX and below 0 of Beckmann's
    distribution, which the scene may have at all if `beckmann`; `haze` (Float or None) is theirs
    as of `scatter_by_haze`, and `rng` (``mitsuba.PCG32``) is advanced in place.
    """
    frame = mi.Frame3f(facing)
    walk = _FacetWalk(
        ratio=ratio, alpha=alpha, steep=dr.abs(alpha), haze=haze, rng=rng, beckmann=beckmann
    )
    towards = frame.to_local(direction)
    turned = None if field is None else Field(frame.to_local(field.re), frame.to_local(field.im))
    height = walk.flown(mi.Float(1.0), towards, rng.next_float32(rough))
    begun = mi.Bool(rough)
    _, _, rng.state, towards, turned, crossed, height = dr.while_loop(
        state=(begun, mi.UInt32(0), mi.UInt64(rng.state), towards, turned, mi.Bool(False), height),
        cond=lambda walking, *_: walking,
        body=walk.meet,
        labels=("walking", "met", "state", "towards", "turned", "crossed", "height"),
        label="facets",
    )
    back = mi.Vector3f(1.0, 1.0, dr.select(crossed, -1.0, 1.0))
    left = rough & (height >= 1.0) & (towards.z >= _LEAVING)
    if field is not None:
        turned = Field(frame.to_world(turned.re * back), frame.to_world(turned.im * back))
    return dr.select(left, (frame.to_world(towards * back), turned, ~crossed), smooth)


@dataclass(frozen=True, kw_only=True)
class _FacetWalk:
    """Steps of `walk_facets`, in the face's frame; ``towards`` are directions of flight there."""

    ratio: Any
    alpha: Any
    #: ``alpha`` without its sign; not in the loop, where it would be worked out at every facet.
    steep: Any
    haze: Any
    rng: Any
    beckmann: bool

    def flown(self, height, towards, uniform):
        """Height of the next facet in a direction; 1 or more where there is none."""
        lowering = dr.sqrt(dr.lerp(dr.square(towards.z), 1.0, dr.square(self.steep)))
        shadow = 0.5 * (lowering / towards.z - 1.0)
        if self.beckmann:
            cot = towards.z * dr.rsqrt(dr.fma(-towards.z, towards.z, 1.0)) / self.steep
            cot = dr.clip(cot, -_STEEPEST, _STEEPEST)
            tail = dr.exp(-dr.square(cot)) / (cot * (2.0 * dr.sqrt(dr.pi)))
            shadow = dr.select(self.alpha > 0.0, shadow, dr.fma(0.5, dr.erf(cot) - 1.0, tail))
        shadow = dr.select(towards.z > 0.0, dr.maximum(shadow, _LEAST_SHADOW), shadow)
        return height * dr.exp(-dr.log(1.0 - uniform) / shadow)

    def meet(self, walking, met, state, towards, turned, crossed, height):
        """Meet one facet, and fly on: the body of the loop."""
        numbers = resumed(self.rng.inc, state)
        u, v, choice, uniform = (numbers.next_float32() for _ in range(4))
        facet, taken = self._facet(-towards, u, v, numbers)
        cosine = dr.clip(-dr.dot(towards, facet), 0.0, 1.0)
        indices = dr.select(crossed, dr.rcp(self.ratio), self.ratio)
        way = split(towards, turned, facet, indices, cosine, choice)
        if self.haze is not None:
            haze = dr.select(crossed, self.haze / self.ratio, self.haze)
            hazy = self.haze > 0.0
            way = scatter_by_haze(way, haze, hazy, turned, facet, indices, cosine, numbers)
        new, new_field, reflected = way
        through = mi.Vector3f(1.0, 1.0, dr.select(reflected, 1.0, -1.0))
        new *= through
        new_height = self.flown(dr.select(reflected, height, 1.0 - height), new, uniform)
        towards, height = dr.select(taken, new, towards), dr.select(taken, new_height, height)
        crossed ^= taken & ~reflected
        if turned is not None:
            new_field = Field(new_field.re * through, new_field.im * through)
            turned = dr.select(taken, new_field, turned)
        met += 1
        inside = (height < 1.0) | (towards.z < _LEAVING)
        walking = walking & inside & (met < MOST_FACETS)
        return walking, met, numbers.state, towards, turned, crossed, height

    def _facet(self, view, u, v, numbers):
        """Unit normal of a facet that is seen, and whether it is to be taken."""
        facet, taken = _visible_of_ggx(view, self.steep, u, v), mi.Bool(True)
        if self.beckmann:
            further = [numbers.next_float32() for _ in range(3)]
            other, taken = _visible_of_beckmann(view, self.steep, (u, v, *further))
            facet, taken = dr.select(self.alpha > 0.0, facet, other), taken | (self.alpha > 0.0)
        return facet, taken


def _visible_of_ggx(view, alpha, u, v):
    """Unit normal of a facet that is seen from `view`, which may come from below.

    J. Dupuy and A. Benyoub, Comput. Graph. Forum 42 (2023) e14867: facets of a unit sphere, each
    as likely as its area is seen, stretched.
    """
    seen_from = dr.normalize(mi.Vector3f(alpha * view.x, alpha * view.y, view.z))
    z = dr.fma(1.0 - u, 1.0 + seen_from.z, -seen_from.z)
    sine, cosine = dr.sincos(dr.two_pi * v)
    across = dr.safe_sqrt(dr.fma(-z, z, 1.0))
    unit = mi.Vector3f(across * cosine, across * sine, z) + seen_from
    return dr.normalize(mi.Vector3f(alpha * unit.x, alpha * unit.y, unit.z))


def _visible_of_beckmann(view, alpha, uniforms):
    """Unit normal of one of Beckmann's facets, and whether it is to be taken: else draw again.

    Slopes s are Gaussian. Along the view, with t = sqrt(2) s / alpha and a = sqrt(2) cot / alpha of
    the view's angle, what is seen has the density (a - t) phi(t) below a. It is drawn as
    (a + abs(t)) phi(t), or where a < 0 as abs(t) phi(t) below a, and taken in part.
    """
    u, v, which, again, accept = uniforms
    upright = dr.abs(view.z) > 1.0 - 1e-6
    sine = dr.select(upright, 1e-3, dr.safe_sqrt(dr.fma(-view.z, view.z, 1.0)))
    a = dr.clip(dr.sqrt(2.0) * view.z / (alpha * sine), -_STEEPEST, _STEEPEST)
    length = dr.sqrt(-2.0 * dr.log(1.0 - u))
    side, gaussian = dr.sincos(dr.two_pi * v)
    far = dr.sqrt(dr.fma(-2.0, dr.log(1.0 - again), dr.square(dr.minimum(a, 0.0))))
    # the part of abs(t) phi(t), half of which lies on either side
    share = dr.sqrt(2.0 / dr.pi)
    share = dr.select(a > 0.0, share / (share + a), 1.0)
    t = dr.select(
        which < share, dr.select((which < 0.5 * share) & (a > 0.0), far, -far), length * gaussian
    )
    taken = accept * (dr.maximum(a, 0.0) + dr.abs(t)) < a - t
    along, across = (alpha * dr.sqrt(0.5) * slope for slope in (t, length * side))
    # seen from right above, all directions along the face are alike
    x, y = dr.select(upright, 1.0, view.x / sine), dr.select(upright, 0.0, view.y / sine)
    return dr.normalize(mi.Vector3f(across * y - along * x, -along * y - across * x, 1.0)), taken


def scatter_by_haze(way, haze, hazy, field, facing, ratio, cos_i, rng):
    """What fine roughness does to what a face reflects or refracts, in the form of `split`.

    Part of it is scattered, by H. E. Bennett and J. O. Porteus, J. Opt. Soc. Am. 51 (1961) 123:
    S = 1 - exp(-q^2), where q is the rms phase that heights give the wave. It goes to directions of
    the side that it leaves to, in proportion to the cosine, to S and to what Fresnel's formulas
    reflect, or refract, of light that comes back from there: every way is as likely as its reverse.

    `haze` (Float) is 2 pi n s / wavelength of heights s, with the index n where light comes from;
    `hazy` (Mask) tells where this happens at all.
    """
    direction, smooth_field, reflected = way
    # a photon's random numbers stay those that it would have at smooth faces
    low, high = mi.UInt32(rng.state), mi.UInt32(rng.state >> 32)
    first, second = mi.sample_tea_32(low, high, _HAZE_ROUNDS)
    _, part = _scattered_part(reflected, haze, ratio, cos_i, dr.dot(direction, facing))
    scatters = hazy & (mi.Float(first >> 8) * 2.0**-24 < part)
    frame = mi.Frame3f(dr.select(reflected, facing, -facing))
    back_ratio = dr.select(reflected, ratio, dr.rcp(ratio))
    back_haze = dr.select(reflected, haze, haze / ratio)
    # a refracted wave's phase, and with it S, is largest where one of the two cosines is 0
    largest = dr.safe_sqrt(dr.maximum(1.0 - dr.rcp(dr.square(back_ratio)), dr.square(ratio) - 1.0))
    _, most = _scattered_part(reflected, back_haze, back_ratio, largest, 0.0)

    def try_direction(searching, tries, state, scattered):
        numbers = resumed(rng.inc, state)
        u, v, choice, again = (numbers.next_float32() for _ in range(4))
        # reflected as the cosine's third power, which S follows at small phases, else as its first
        cosine = dr.sqrt(dr.select(reflected, dr.sqrt(u), u))
        sine, (up, along) = dr.safe_sqrt(1.0 - dr.square(cosine)), dr.sincos(dr.two_pi * v)
        scattered = mi.Vector3f(sine * along, sine * up, cosine)
        normal = mi.Vector3f(0.0, 0.0, 1.0)
        beyond, _, returned = split(-scattered, None, normal, back_ratio, cosine, choice)
        phase, part = _scattered_part(reflected, back_haze, back_ratio, cosine, beyond.z)
        # S <= phase^2, of which the third power has the cosine's square
        highest = dr.select(reflected, dr.square(phase), most)
        taken = (returned == reflected) & (again * highest < part)
        tries += 1
        return searching & ~taken & (tries < _MOST_DIRECTIONS), tries, numbers.state, scattered

    # of words anew: where little is scattered, `first` is known to be small
    high, low = mi.sample_tea_32(first, second, _HAZE_ROUNDS)
    state = (mi.UInt64(high) << 32) | mi.UInt64(low)
    _, tries, state, scattered = dr.while_loop(
        state=(scatters, mi.UInt32(0), state, mi.Vector3f(direction)),
        cond=lambda searching, *_: searching,
        body=try_direction,
        labels=("searching", "tries", "state", "scattered"),
        label="haze",
    )
    scattered = frame.to_world(scattered)
    scatters &= tries < _MOST_DIRECTIONS
    if field is not None:
        turn = dr.two_pi * resumed(rng.inc, state).next_float32()
        smooth_field = dr.select(scatters, unpolarised_field(scattered, turn), smooth_field)
    return dr.select(scatters, scattered, direction), smooth_field, reflected


def _scattered_part(reflected, haze, ratio, cosine, beyond):
    """Rms phase that fine roughness gives what is reflected, or else refracted; its S."""
    phase = haze * dr.select(reflected, 2.0 * cosine, cosine - dr.abs(beyond) / ratio)
    return phase, 1.0 - dr.exp(-dr.square(phase))


def resumed(stream, state):
    """A generator (PCG32) of a `stream`, as ``inc`` of PCG32 has it, at a state (both UInt64)."""
    numbers = mi.PCG32()
    numbers.state, numbers.inc = state, stream
    return numbers
