"""Random numbers, directions, and what becomes of one photon at an interface, compiled.

Vectors are tuples of three; a photon's polarisation is its complex electric field, a unit vector
across its direction of flight, or 0 where it is not followed. `rng` is the state of a photon's own
generator, one uint64.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from mcrim_mitsuba.reference.compiling import compiled

# Random numbers: a generator for each photon, so that its numbers depend on nobody else.

_STEP = np.uint64(0x9E3779B97F4A7C15)
_STRIDE = np.uint64(0xD1342543DE82EF95)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


@compiled
def mixed(word):
    """A word whose every bit depends on all bits of another: splitmix64's output function.

    G. L. Steele, D. Lea and C. H. Flood, OOPSLA 2014.
    """
    word = (word ^ (word >> np.uint64(30))) * _FIRST
    word = (word ^ (word >> np.uint64(27))) * _SECOND
    return word ^ (word >> np.uint64(31))


@compiled
def seed_photon(rng, seed, number):
    """Set a generator to where that of a run's photon begins; both are uint64."""
    rng[0] = mixed(seed + number * _STRIDE)


@compiled
def uniform(rng):
    """A number in [0, 1)."""
    rng[0] += _STEP
    return float(mixed(rng[0]) >> np.uint64(11)) * 2.0**-53


@compiled
def exponential(rng):
    """A number with density exp(-x)."""
    return -math.log1p(-uniform(rng))


@compiled
def normal(rng):
    """A number with density exp(-x^2 / 2) / sqrt(2 pi)."""
    return math.sqrt(2.0 * exponential(rng)) * math.cos(2.0 * math.pi * uniform(rng))


# Vectors.


@compiled
def dot(a, b):
    """Scalar product; of a field with a real vector complex."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def plus(a, length, b):
    """a + length b."""
    return a[0] + length * b[0], a[1] + length * b[1], a[2] + length * b[2]


@compiled
def times(length, a):
    """length a."""
    return length * a[0], length * a[1], length * a[2]


@compiled
def unit(a):
    """A vector over its length: rounding would add up over thousands of events."""
    return times(1.0 / math.sqrt(dot(a, a)), a)


@compiled
def vector_product(a, b):
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def square(z):
    """abs(z)^2."""
    return z.real * z.real + z.imag * z.imag


@compiled
def basis(axis):
    """Two unit vectors that form a frame with a unit axis.

    T. Duff et al., Building an orthonormal basis, revisited, Journal of Computer Graphics
    Techniques 6(1), 2017.
    """
    x, y, z = axis
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


@compiled
def about(rng, axis, cosine):
    """A unit vector at an angle of this cosine to a unit axis, at a random azimuth."""
    sine, azimuth = math.sqrt(max(0.0, 1.0 - cosine * cosine)), 2.0 * math.pi * uniform(rng)
    u, v = basis(axis)
    across = plus(times(sine * math.cos(azimuth), u), sine * math.sin(azimuth), v)
    return unit(plus(across, cosine, axis))


@compiled
def isotropic(rng):
    """A unit vector, uniform over the sphere."""
    z, azimuth = 1.0 - 2.0 * uniform(rng), 2.0 * math.pi * uniform(rng)
    radius = math.sqrt(1.0 - z * z)
    return radius * math.cos(azimuth), radius * math.sin(azimuth), z


@compiled
def lambertian(rng, axis):
    """A unit vector with density cos(theta)/pi about a unit normal."""
    return about(rng, axis, math.sqrt(1.0 - uniform(rng)))


@compiled
def random_polarisation(rng, direction):
    """A field of unpolarised light: linear at a random angle.

    Every mixture of pure states with the same mean density matrix gives the same detection
    statistics, so circular and elliptic states need no share.
    """
    u, v = basis(direction)
    angle = 2.0 * math.pi * uniform(rng)
    return plus(times(complex(math.cos(angle)), u), math.sin(angle), v)


@compiled
def followed(field):
    """Whether a photon's polarisation is followed."""
    return field[0] != 0.0 or field[1] != 0.0 or field[2] != 0.0


@compiled
def depolarised(rng, field, direction):
    """The field of a photon that has a new direction and nothing left of its old field."""
    return random_polarisation(rng, direction) if followed(field) else field


@compiled
def scattered_cosine(rng, rayleigh, g):
    """Cosine of the angle of a scattering, by Rayleigh's phase function or one of mean cosine g.

    Rayleigh: J. R. Frisvad, Journal of the Optical Society of America A 28 (2011) 2436. Others:
    L. G. Henyey and J. L. Greenstein, Astrophysical Journal 93 (1941) 70; the inverse of the
    distribution function as in A. N. Witt, ApJ Suppl. 35 (1977) 1.
    """
    if rayleigh:
        draw = 2.0 * (2.0 * uniform(rng) - 1.0)
        root = (draw + math.sqrt(draw * draw + 1.0)) ** (1.0 / 3.0)
        return min(1.0, max(-1.0, root - 1.0 / root))
    if g == 0.0:
        return 1.0 - 2.0 * uniform(rng)
    ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * uniform(rng))
    return min(1.0, max(-1.0, (1.0 + g * g - ratio * ratio) / (2.0 * g)))


# Fresnel's formulae for plane, lossless interfaces.
#
# Sources: M. Born and E. Wolf, Principles of Optics, 7th ed., sec. 1.5.2 (amplitudes), 1.5.3
# (reflectivity) and 1.5.4 (total reflection). ``cos_in`` is the cosine of the angle of incidence,
# ``n_in`` and ``n_out`` the indices before and behind the interface.


@compiled
def cosine_squared_out(cos_in, n_in, n_out):
    """Squared cosine of the angle of refraction; not positive under total reflection.

    Snell's law, so arranged that equal indices give back ``cos_in`` squared exactly.
    """
    ratio_squared = (n_in / n_out) ** 2
    return (1.0 - ratio_squared) + ratio_squared * cos_in * cos_in


@compiled
def unpolarised_reflectance(cos_in, n_in, n_out):
    """Mean of the s and p reflectivities; exactly 1 under total reflection."""
    cos_out = math.sqrt(max(0.0, cosine_squared_out(cos_in, n_in, n_out)))
    s = (n_in * cos_in - n_out * cos_out) / (n_in * cos_in + n_out * cos_out)
    p = (n_out * cos_in - n_in * cos_out) / (n_out * cos_in + n_in * cos_out)
    return 0.5 * (s * s + p * p)


@compiled
def amplitudes(cos_in, n_in, n_out):
    """Amplitudes of s and p reflected, s and p transmitted, with the phases of total reflection.

    In frames where s x (propagation direction) is p for every wave, as in Born and Wolf's figure
    1.10. Beyond the critical angle the cosine of refraction is +i sqrt(sin^2/n^2 - 1), for the
    time dependence exp(-i omega t).
    """
    cos_out = cmath.sqrt(complex(cosine_squared_out(cos_in, n_in, n_out)))
    s_in, s_out = n_in * cos_in, n_out * cos_out
    p_in, p_out = n_out * cos_in, n_in * cos_out
    s, p = s_in + s_out, p_in + p_out
    return (s_in - s_out) / s, (p_in - p_out) / p, 2.0 * s_in / s, 2.0 * s_in / p


@compiled
def across_incidence(direction, axis):
    """A unit vector across the plane of incidence; any across the direction at normal incidence."""
    s = vector_product(direction, axis)
    length = math.sqrt(dot(s, s))
    # s and p differ by the square of the sine
    return times(1.0 / length, s) if length > 1e-8 else basis(direction)[0]


@compiled
def field_of(field_s, field_p, s, direction):
    """The unit field of s and p components, by the unit vector across the plane of incidence."""
    length = math.sqrt(square(field_s) + square(field_p))
    return plus(times(field_s / length, s), field_p / length, vector_product(s, direction))


# One photon meets one interface, as one whole quantum.


@compiled
def cross(rng, direction, axis, n_in, n_out, field, heights):
    """Send a photon through an interface: its direction, whether it is transmitted, its field.

    It flies along a unit vector, and the unit normal `axis` points ahead; indices are those before
    and behind the interface. Heights, an rms over the wavelength, scatter by `hazy_direction`.
    """
    cos_in = min(1.0, dot(direction, axis))
    cos_out = math.sqrt(max(0.0, cosine_squared_out(cos_in, n_in, n_out)))
    s, polarised = axis, followed(field)
    field_s, field_p, through_s, through_p = 0j, 0j, 0j, 0j
    if polarised:
        s = across_incidence(direction, axis)
        r_s, r_p, t_s, t_p = amplitudes(cos_in, n_in, n_out)
        e_s, e_p = dot(field, s), dot(field, vector_product(s, direction))
        field_s, field_p, through_s, through_p = r_s * e_s, r_p * e_p, t_s * e_s, t_p * e_p
        reflectance = square(field_s) + square(field_p)
    else:
        reflectance = unpolarised_reflectance(cos_in, n_in, n_out)
    # the second condition is for rounding: |r| of a total reflection may be 1 - 1e-16
    transmitted = uniform(rng) >= reflectance and cos_out > 0.0
    if transmitted:
        ratio = n_in / n_out
        way = unit(plus(times(ratio, direction), cos_out - ratio * cos_in, axis))
        field_s, field_p = through_s, through_p
    else:
        way = unit(plus(direction, -2.0 * cos_in, axis))
    if polarised:
        field = field_of(field_s, field_p, s, way)
    if heights > 0.0 and uniform(rng) < haze(cos_in, n_in, n_out, transmitted, heights)[1]:
        way = hazy_direction(rng, axis, n_in, n_out, transmitted, heights)
        field = depolarised(rng, field, way)
    return way, transmitted, field


@compiled
def haze(cos_in, n_in, n_out, transmitted, heights):
    """What of unpolarised light a face reflects, or transmits, and what of this it scatters.

    A wave that meets heights of an rms keeps the part exp(-q^2) of its power in the specular
    direction, q being the rms of its phase: H. E. Bennett and J. O. Porteus, Journal of the Optical
    Society of America 51 (1961) 123, for reflection; in refraction the heights change the path by
    the difference of n cos(theta) on the two sides.
    """
    part, path = unpolarised_reflectance(cos_in, n_in, n_out), 2.0 * n_in * cos_in
    if transmitted:
        cos_out = math.sqrt(max(0.0, cosine_squared_out(cos_in, n_in, n_out)))
        part, path = 1.0 - part, abs(n_in * cos_in - n_out * cos_out)
    return part, -math.expm1(-((2.0 * math.pi * heights * path) ** 2))


@compiled
def hazy_direction(rng, axis, n_in, n_out, transmitted, heights):
    """Where heights scatter a photon that a face has reflected or transmitted.

    It stays on its side, and leaves by Lambert's law times what light that comes back on its way
    would have reflected or refracted, and scattered: isotropic light in equilibrium stays so.
    """
    near, far = (n_out, n_in) if transmitted else (n_in, n_out)
    # no path is longer: in refraction that at the critical angle, or at grazing incidence
    longest2 = abs(near * near - far * far) if transmitted else 4.0 * near * near
    highest = -math.expm1(-((2.0 * math.pi * heights) ** 2) * longest2)
    while True:
        cosine = math.sqrt(1.0 - uniform(rng))
        part, share = haze(cosine, near, far, transmitted, heights)
        if uniform(rng) * highest < part * share:
            return about(rng, axis if transmitted else times(-1.0, axis), cosine)


# Rough faces made of microfacets: a photon walks among them until it leaves.

_GAUSS_PEAK = 1.0 / math.sqrt(2.0 * math.pi)
#: What is divided by is not smaller: squares and logarithms of the quotients are numbers.
_TINY = 1e-100


@compiled
def cross_rough(rng, direction, axis, n_in, n_out, field, heights, alpha, beckmann):
    """Send a photon through an interface that may be rough; the rest is as of `cross`.

    The random walk of E. Heitz et al., ACM Transactions on Graphics 35 (2016) 58, in Smith's field
    of heights: a photon meets a facet, drawn by the area that it sees, Fresnel's formulae decide
    there, and it flies on, until it is above or below all. Behind the interface it walks in the
    heights turned upside down. Nothing is lost, and isotropic light in equilibrium stays so.
    ``alpha`` is that of GGX slopes or, with ``beckmann``, of Beckmann's.
    """
    if alpha == 0.0:
        return cross(rng, direction, axis, n_in, n_out, field, heights)
    up, transmitted = times(-1.0, axis), False
    # logarithm of the share of the face that is lower than the photon; it comes from above
    level = 0.0
    while True:
        cosine = -dot(direction, up)
        # Heitz's free paths: this share's power of Smith's Lambda is a uniform number
        level -= exponential(rng) * cosine / _visible_area(cosine, alpha, beckmann)
        if level >= 0.0:
            return direction, transmitted, field
        facet = _visible_normal(rng, times(-1.0, direction), up, alpha, beckmann)
        ahead = times(-1.0, facet)
        direction, through, field = cross(rng, direction, ahead, n_in, n_out, field, heights)
        if through:
            transmitted, up = not transmitted, times(-1.0, up)
            # a share of 0 would be a bottom that nothing leaves
            level = math.log(-math.expm1(min(level, -_TINY)))
            n_in, n_out = n_out, n_in


@compiled
def _visible_area(cosine, alpha, beckmann):
    """Area of facets, over the face's, that is seen at an angle whose cosine may be negative.

    From above it is cosine (1 + Lambda), from below -cosine Lambda, with Smith's Lambda.
    """
    across = alpha * math.sqrt(max(0.0, 1.0 - cosine * cosine))
    if beckmann:
        across = max(across, _TINY) / math.sqrt(2.0)
        farthest = cosine / across
        below = 0.5 * math.erfc(-farthest / math.sqrt(2.0))
        area = cosine * below + across * _GAUSS_PEAK * math.exp(-0.5 * farthest * farthest)
    else:
        area = 0.5 * (cosine + math.hypot(across, cosine))
    return max(area, _TINY)


@compiled
def _visible_normal(rng, view, axis, alpha, beckmann):
    """Normal of a facet, in proportion to the area that is seen along ``view``.

    GGX slopes are those of B. Walter et al., Eurographics Symposium on Rendering 2007, Beckmann's
    are Gaussian with a variance of alpha^2 / 2. Views are unit vectors towards where the light
    comes from, also from below the face, whose normal points up; ``view . facet`` is positive.
    """
    # the face's own frame, with the plane of incidence as x-z plane: view = (sine, 0, cosine)
    cosine = dot(view, axis)
    x = plus(view, -cosine, axis)
    sine = math.sqrt(dot(x, x))
    x = times(1.0 / sine, x) if sine > 0.0 else basis(axis)[0]
    if beckmann:
        facets = _beckmann_facet(rng, sine, cosine, alpha)
    else:
        facets = _ggx_facet(rng, sine, cosine, alpha)
    along = plus(times(facets[0], x), facets[1], vector_product(axis, x))
    return unit(plus(along, facets[2], axis))


@compiled
def _ggx_facet(rng, sine, cosine, alpha):
    """A vector along a facet's normal, in the frame of the plane of incidence.

    E. Heitz, Journal of Computer Graphics Techniques 7(4), 2018; from below the half ellipse cuts a
    crescent out of the half disc.
    """
    # the view from a hemisphere that stretching makes of the ellipsoid
    stretched = math.hypot(alpha * sine, cosine)
    sine, cosine = alpha * sine / stretched, cosine / stretched
    # a point of the projected hemisphere: of a half disc and a half ellipse
    radius, azimuth = math.sqrt(uniform(rng)), 2.0 * math.pi * uniform(rng)
    across, upwards = radius * math.cos(azimuth), radius * math.sin(azimuth)
    share = 0.5 * (1.0 + cosine)
    upwards = (1.0 - share) * math.sqrt(1.0 - across * across) + share * upwards
    towards = math.sqrt(max(0.0, 1.0 - across * across - upwards * upwards))
    # back to the face's frame, and unstretched; T1 = y, T2 = view x T1 = (-cosine, 0, sine)
    along = alpha * (towards * sine - upwards * cosine)
    return along, alpha * across, max(0.0, towards * cosine + upwards * sine)


@compiled
def _beckmann_facet(rng, sine, cosine, alpha):
    """A vector along the normal of a facet of Gaussian slopes, in the plane of incidence's frame.

    Slopes along the view, t sigma, are drawn by (a - t)_+ exp(-t^2 / 2).
    With a = cosine / (sigma sine), by rejection: from above from Gaussian and Rayleigh numbers, the
    parts of (a + (-t)_+) exp(-t^2 / 2), from below from Rayleigh numbers a - t.
    """
    sigma = alpha / math.sqrt(2.0)
    a = cosine / max(sigma * sine, _TINY)
    while True:
        t = -math.sqrt(2.0 * exponential(rng))
        if a < 0.0:
            taken, t = uniform(rng) < math.exp(min(-a * t, 0.0)), a + t
        else:
            if uniform(rng) * (a + _GAUSS_PEAK) < a:
                t = normal(rng)
            taken = uniform(rng) * a < a - t
        if taken:
            return -sigma * t, sigma * normal(rng), 1.0


# A film thinner than a wavelength that absorbs, between glass and vacuum.


@compiled
def film_waves(film_index, n_window, wavelengths, cos_in):
    """Reflected amplitudes (as of `amplitudes`) and transmittances: s, p, s and p.

    The characteristic matrix of its layer: F. Abelès, Annales de Physique 12 (1950) 596; in the
    form of H. A. Macleod, Thin-Film Optical Filters, chapter 2: with the admittance eta of a
    medium, which is n cos(theta) for s and n / cos(theta) for p polarised light, the film's phase
    delta = 2 pi n cos(theta) d / lambda and vacuum behind it, B = cos(delta) + eta_v / eta_f
    (-i sin(delta)) and C = -i eta_f sin(delta) + eta_v cos(delta), for the time dependence
    exp(-i omega t). `wavelengths` is the thickness over the wavelength in vacuum.
    """
    sine = n_window * math.sqrt(1.0 - cos_in * cos_in)
    in_film = cmath.sqrt(1.0 - (sine / film_index) ** 2)
    in_vacuum = cmath.sqrt(complex(1.0 - sine * sine))
    delta = 2.0 * math.pi * wavelengths * film_index * in_film
    r_s, t_s = _film_wave(n_window * cos_in, film_index * in_film, in_vacuum, delta)
    r_p, t_p = _film_wave(n_window / cos_in, film_index / in_film, 1.0 / in_vacuum, delta)
    # tangential components of p polarised light turn round in reflection
    return r_s, -r_p, t_s, t_p


@compiled
def _film_wave(of_glass, of_film, of_vacuum, delta):
    b = cmath.cos(delta) - 1j * cmath.sin(delta) * of_vacuum / of_film
    c = of_vacuum * cmath.cos(delta) - 1j * cmath.sin(delta) * of_film
    transmitted = 4.0 * of_glass * of_vacuum.real / square(of_glass * b + c)
    return (of_glass * b - c) / (of_glass * b + c), transmitted
