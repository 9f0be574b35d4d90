"""Directions, and what becomes of them at an interface: polished or rough, polarised or not."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from mcrim_mitsuba.reference.geometry import Complexes, Flags, Floats, Indices, dot


def isotropic(rng: np.random.Generator, count: int) -> Floats:
    """Unit vectors, uniform over the sphere: (3, count) float64."""
    z = 1.0 - 2.0 * rng.random(count)
    radius = np.sqrt(1.0 - z * z)
    azimuth = 2.0 * np.pi * rng.random(count)
    return np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), z))


def lambertian(rng: np.random.Generator, normal: Floats) -> Floats:
    """Unit vectors with density cos(theta)/pi, above zero, about (3, n) unit normals."""
    return about(rng, normal, np.sqrt(1.0 - rng.random(normal.shape[1])))


def about(rng: np.random.Generator, axis: Floats, cosine: Floats) -> Floats:
    """Unit vectors, (3, n), at angles of given cosines to unit axes, at random azimuths."""
    sine = np.sqrt(1.0 - cosine * cosine)
    azimuth = 2.0 * np.pi * rng.random(cosine.size)
    u, v = basis(axis)
    direction = sine * (np.cos(azimuth) * u + np.sin(azimuth) * v) + cosine * axis
    # over thousands of scatterings rounding would add up
    return direction / np.sqrt(np.sum(direction * direction, axis=0))


def basis(axis: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (3, n) each, with u x v = axis, that form a frame with unit axes.

    T. Duff et al., Building an orthonormal basis, revisited, Journal of
    Computer Graphics Techniques 6(1), 2017.
    """
    x, y, z = axis
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    u = np.stack((1.0 + sign * x * x * a, sign * b, -sign * x))
    v = np.stack((b, sign + y * y * a, -y))
    return u, v


# Fresnel's formulae for plane, lossless interfaces.
#
# Sources: M. Born and E. Wolf, Principles of Optics, 7th ed., sec. 1.5.2
# (amplitudes), 1.5.3 (reflectivity) and 1.5.4 (total reflection). ``cos_in`` is
# the cosine of the angle of incidence, ``n_in`` and ``n_out`` the indices before
# and behind the interface. All functions take arrays that broadcast together.


class Amplitudes(NamedTuple):
    """Complex amplitude coefficients, (n,) complex128 each."""

    reflected_s: Complexes
    reflected_p: Complexes
    transmitted_s: Complexes
    transmitted_p: Complexes


#: One number, or one for every photon.
_Number = float | Floats


def cosine_squared_out(cos_in: _Number, n_in: _Number, n_out: _Number) -> Floats:
    """Squared cosine of the angle of refraction; not positive under total reflection.

    Snell's law, arranged so that equal indices give back ``cos_in`` squared
    exactly, also at grazing incidence.
    """
    ratio_squared = np.square(np.divide(n_in, n_out))
    return (1.0 - ratio_squared) + ratio_squared * np.square(cos_in)


def unpolarised_reflectance(
    cos_in: _Number, n_in: _Number, n_out: _Number, cos_out: _Number
) -> Floats:
    """Mean of the s and p reflectivities: (n,) float64.

    ``cos_out`` is the cosine of the angle of refraction, 0 under total
    reflection, which makes the result 1 exactly.
    """
    cos_in, cos_out = np.asarray(cos_in), np.asarray(cos_out)
    s = (n_in * cos_in - n_out * cos_out) / (n_in * cos_in + n_out * cos_out)
    p = (n_out * cos_in - n_in * cos_out) / (n_out * cos_in + n_in * cos_out)
    return 0.5 * (s * s + p * p)


def amplitudes(cos_in: _Number, n_in: _Number, n_out: _Number) -> Amplitudes:
    """Amplitude coefficients with the phases of total reflection.

    In frames where s x (propagation direction) is p for every wave, as in Born
    and Wolf's figure 1.10. Beyond the critical angle the cosine of refraction
    is +i sqrt(sin^2/n^2 - 1), for the time dependence exp(-i omega t).
    """
    squared = cosine_squared_out(cos_in, n_in, n_out)
    cos_out: Complexes = np.sqrt(squared.astype(np.complex128))
    s_in, s_out = n_in * cos_in, n_out * cos_out
    p_in, p_out = n_out * cos_in, n_in * cos_out
    return Amplitudes(
        reflected_s=(s_in - s_out) / (s_in + s_out),
        reflected_p=(p_in - p_out) / (p_in + p_out),
        transmitted_s=2.0 * s_in / (s_in + s_out),
        transmitted_p=2.0 * s_in / (p_in + p_out),
    )


# One photon meets one interface: reflected or refracted, with or without polarisation.
#
# The polarisation state of a photon is its complex electric field, a unit vector
# in space perpendicular to the direction of flight.

_NORMAL_INCIDENCE_SINE = 1e-8
"""Below this sine of the angle of incidence any plane of incidence will do: s and p
differ by its square."""


def cross(
    rng: np.random.Generator,
    direction: Floats,
    normal: Floats,
    n_in: _Number,
    n_out: Floats,
    field: Complexes | None = None,
    rms_per_wavelength: _Number = 0.0,
) -> tuple[Floats, Flags, Complexes | None]:
    """Send photons through an interface, each as one whole quantum.

    They fly along unit vectors `direction`, (3, n); unit normals, (3, n), point ahead:
    ``direction . normal`` is positive. `n_in` and `n_out`, (n,), are the indices of the medium that
    they are in and of that behind the interface. Without polarisation states `field`, (3, n), they
    are taken as unpolarised. Heights of `rms_per_wavelength`, (n,), scatter by `scatter_by_haze`,
    which leaves no polarisation. Returned are directions, which are transmitted, (n,), and states.
    """
    cos_in = dot(direction, normal)
    cos_out = np.sqrt(np.maximum(cosine_squared_out(cos_in, n_in, n_out), 0.0))
    if field is None:
        reflectance = unpolarised_reflectance(cos_in, n_in, n_out, cos_out)
    else:
        s = _across_incidence(direction, normal)
        field_s, field_p = dot(field, s), dot(field, _cross_product(s, direction))
        coefficients = amplitudes(cos_in, n_in, n_out)
        reflected_s = coefficients.reflected_s * field_s
        reflected_p = coefficients.reflected_p * field_p
        reflectance = _square(reflected_s) + _square(reflected_p)
    # the second condition is for rounding: |r| of a total reflection may be 1 - 1e-16
    transmitted = (rng.random(cos_in.shape) >= reflectance) & (cos_out > 0.0)
    outgoing = direction - (2.0 * cos_in) * normal
    through = np.flatnonzero(transmitted)
    if through.size:
        vectors = direction[:, through], normal[:, through]
        numbers = cos_in[through], cos_out[through], (n_in / n_out)[through]
        outgoing[:, through] = _refracted(*vectors, *numbers)
    if field is not None:
        out_s = np.where(transmitted, coefficients.transmitted_s * field_s, reflected_s)
        out_p = np.where(transmitted, coefficients.transmitted_p * field_p, reflected_p)
        field = _field_of(out_s, out_p, s, outgoing)
    if np.any(rms_per_wavelength):
        who, scattered = scatter_by_haze(
            rng, normal, cos_in, n_in, n_out, transmitted, rms_per_wavelength
        )
        outgoing[:, who] = scattered
        if field is not None:
            field[:, who] = random_polarisation(rng, scattered)
    return outgoing, transmitted, field


def _field_of(field_s: Complexes, field_p: Complexes, s: Floats, direction: Floats) -> Complexes:
    """Unit fields of s and p components, by unit vectors across the planes of incidence."""
    field = field_s * s + field_p * _cross_product(s, direction)
    return field / np.sqrt(_square(field_s) + _square(field_p))


def _refracted(
    direction: Floats, normal: Floats, cos_in: Floats, cos_out: Floats, ratio: Floats
) -> Floats:
    """Unit vectors behind an interface, of a `ratio` of the index before it to that behind it."""
    refracted = ratio * (direction - cos_in * normal) + cos_out * normal
    return refracted / np.sqrt(dot(refracted, refracted))


def random_polarisation(rng: np.random.Generator, direction: Floats) -> Complexes:
    """Fields of unpolarised light: linear at a random angle, (3, n) complex128.

    Every mixture of pure states with the same mean density matrix gives the
    same detection statistics, so circular and elliptic states need no share.
    """
    u, v = basis(direction)
    angle = 2.0 * np.pi * rng.random(direction.shape[1])
    return (np.cos(angle) * u + np.sin(angle) * v).astype(np.complex128)


def _across_incidence(direction: Floats, normal: Floats) -> Floats:
    """Unit vectors perpendicular to the planes of incidence and to the directions: (3, n)."""
    s = _cross_product(direction, normal)
    length = np.sqrt(dot(s, s))
    undefined = np.flatnonzero(length < _NORMAL_INCIDENCE_SINE)
    if undefined.size:
        s[:, undefined] = basis(direction[:, undefined])[0]
        length[undefined] = 1.0
    return s / length


def _cross_product(a: Floats, b: Floats) -> Floats:
    # numpy.cross is several times slower on (3, n) arrays
    return np.stack(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )


def _square(z: Complexes) -> Floats:
    return z.real * z.real + z.imag * z.imag


# Rough faces made of microfacets: each photon walks among them until it leaves.

_GAUSS_PEAK = 1.0 / math.sqrt(2.0 * math.pi)
_TINY = 1e-100
"""What is divided by is not smaller: squares and logarithms of the quotients are numbers."""


def cross_rough(
    rng: np.random.Generator,
    direction: Floats,
    normal: Floats,
    n_in: float,
    n_out: Floats,
    roughness: Floats,
    field: Complexes | None = None,
    rms_per_wavelength: _Number = 0.0,
    *,
    beckmann: bool = False,
) -> tuple[Floats, Flags, Complexes | None]:
    """Send photons through a rough interface, each as one whole quantum.

    The random walk of E. Heitz et al., ACM Transactions on Graphics 35 (2016) 58, in Smith's field
    of heights: a photon meets a facet, drawn by the area that it sees, Fresnel's formulae decide
    there, and it flies on, until it is above or below all. Behind the interface it walks in the
    heights turned upside down. Nothing is lost, and isotropic light in equilibrium stays so.

    Parameters and what is returned are those of `interface.cross`, with heights of the facets, and
    ``roughness``: (n,) float64, the alpha, above 0, of GGX slopes or, with ``beckmann``, of
    Beckmann's.
    """
    direction, up, count = direction.copy(), -normal, normal.shape[1]
    field = None if field is None else field.copy()
    n_here, n_ahead = np.full(count, n_in), n_out.copy()
    heights = np.broadcast_to(rms_per_wavelength, count)
    transmitted = np.zeros(count, dtype=bool)
    # logarithm of the share of the face that is lower than the photon; it comes from above
    level = np.zeros(count)
    who = np.arange(count)
    while True:
        cosine = -dot(direction[:, who], up[:, who])
        area = _visible_area(cosine, roughness[who], beckmann)
        # Heitz's free paths: this share's power of Smith's Lambda is a uniform number
        level[who] -= rng.standard_exponential(who.size) * cosine / area
        who = who[level[who] < 0.0]
        if not who.size:
            return direction, transmitted, field
        facet = visible_normals(rng, -direction[:, who], up[:, who], roughness[who], beckmann)
        states = None if field is None else field[:, who]
        direction[:, who], through, states = cross(
            rng, direction[:, who], -facet, n_here[who], n_ahead[who], states, heights[who]
        )
        if field is not None:
            field[:, who] = states
        behind = who[through]
        transmitted[behind] ^= True
        up[:, behind] *= -1.0
        # a share of 0 would be a bottom that nothing leaves
        level[behind] = np.log(-np.expm1(np.minimum(level[behind], -_TINY)))
        n_here[behind], n_ahead[behind] = n_ahead[behind], n_here[behind]


def _visible_area(cosine: Floats, roughness: _Number, beckmann: bool) -> Floats:
    """Area of facets, over the face's, that is seen at an angle whose cosine may be negative.

    From above it is cosine (1 + Lambda), from below -cosine Lambda, with Smith's Lambda.
    """
    across = roughness * np.sqrt(np.maximum(0.0, 1.0 - cosine * cosine))
    if beckmann:
        across = np.maximum(across, _TINY) / math.sqrt(2.0)
        farthest = cosine / across
        area = cosine * ndtr(farthest) + across * _GAUSS_PEAK * np.exp(-0.5 * farthest * farthest)
    else:
        area = 0.5 * (cosine + np.hypot(across, cosine))
    return np.maximum(area, _TINY)


def visible_normals(
    rng: np.random.Generator, view: Floats, normal: Floats, roughness: _Number, beckmann: bool
) -> Floats:
    """Normals of facets, in proportion to the area that is seen along ``view``.

    GGX slopes are those of B. Walter et al., Eurographics Symposium on Rendering 2007, Beckmann's
    are Gaussian with a variance of alpha^2 / 2. Views are unit vectors towards where the light
    comes from, also from below the face, whose normals point up; ``view . facet`` is positive.
    """
    # the face's own frame, with the plane of incidence as x-z plane: view = (sine, 0, cosine)
    cosine = dot(view, normal)
    x = view - cosine * normal
    sine = np.sqrt(dot(x, x))
    perpendicular = sine == 0.0
    x = np.where(perpendicular, basis(normal)[0], x / np.where(perpendicular, 1.0, sine))
    y = _cross_product(normal, x)
    facets = _beckmann_facets if beckmann else _ggx_facets
    facet_x, facet_y, facet_z = facets(rng, sine, cosine, roughness)
    facet = facet_x * x + facet_y * y + facet_z * normal
    return facet / np.sqrt(dot(facet, facet))


def _ggx_facets(
    rng: np.random.Generator, sine: Floats, cosine: Floats, roughness: _Number
) -> tuple[Floats, Floats, Floats]:
    """Vectors along facets' normals, in the frame of the plane of incidence.

    E. Heitz, Journal of Computer Graphics Techniques 7(4), 2018; from below the half ellipse cuts a
    crescent out of the half disc.
    """
    # the view from a hemisphere that stretching makes of the ellipsoid
    stretched = np.hypot(roughness * sine, cosine)
    sine, cosine = roughness * sine / stretched, cosine / stretched
    # a point of the projected hemisphere: of a half disc and a half ellipse
    radius = np.sqrt(rng.random(cosine.size))
    azimuth = 2.0 * np.pi * rng.random(cosine.size)
    across, upwards = radius * np.cos(azimuth), radius * np.sin(azimuth)
    share = 0.5 * (1.0 + cosine)
    upwards = (1.0 - share) * np.sqrt(1.0 - across * across) + share * upwards
    towards = np.sqrt(np.maximum(0.0, 1.0 - across * across - upwards * upwards))
    # back to the face's frame, and unstretched; T1 = y, T2 = view x T1 = (-cosine, 0, sine)
    facet_x = roughness * (towards * sine - upwards * cosine)
    return facet_x, roughness * across, np.maximum(0.0, towards * cosine + upwards * sine)


def _beckmann_facets(
    rng: np.random.Generator, sine: Floats, cosine: Floats, roughness: _Number
) -> tuple[Floats, Floats, Floats]:
    """Vectors along facets' normals of Gaussian slopes, in the frame of the plane of incidence.

    Slopes along the view, t sigma, are drawn by (a - t)_+ exp(-t^2 / 2).
    With a = cosine / (sigma sine), by rejection: from above from Gaussian and Rayleigh numbers, the
    parts of (a + (-t)_+) exp(-t^2 / 2), from below from Rayleigh numbers a - t.
    """
    sigma = roughness / math.sqrt(2.0)
    farthest = cosine / np.maximum(sigma * sine, _TINY)
    slope, who = np.empty_like(cosine), np.arange(cosine.size)
    while who.size:
        a = farthest[who]
        t = -np.sqrt(2.0 * rng.standard_exponential(who.size))
        chance = rng.random(who.size)
        even = rng.random(who.size) * (a + _GAUSS_PEAK) < a
        t[even] = rng.standard_normal(np.count_nonzero(even))
        taken = np.where(a >= 0.0, chance * a < a - t, chance < np.exp(np.minimum(-a * t, 0.0)))
        t = np.where(a >= 0.0, t, a + t)
        slope[who[taken]] = t[taken]
        who = who[~taken]
    return -sigma * slope, sigma * rng.standard_normal(cosine.size), np.ones_like(cosine)


# Fine roughness: heights far below a wavelength, of no slope that would matter.


def scatter_by_haze(
    rng: np.random.Generator,
    normal: Floats,
    cos_in: Floats,
    n_in: _Number,
    n_out: Floats,
    transmitted: Flags,
    rms_per_wavelength: _Number,
) -> tuple[Indices, Floats]:
    """Which photons the heights of a face scatter, after it has reflected or refracted them.

    A wave that meets heights of an rms keeps the part exp(-q^2) of its power in the specular
    direction, q being the rms of its phase: H. E. Bennett and J. O. Porteus, Journal of the Optical
    Society of America 51 (1961) 123, for reflection; in refraction the heights change the path by
    the difference of n cos(theta) on the two sides. What is scattered stays on the side that the
    photon is on, and leaves by Lambert's law times what light that comes back on its way would have
    reflected or refracted, and scattered: so isotropic light in equilibrium stays so.

    Numbers are as of `cross`, with the cosine ``cos_in`` of the unit normals that point ahead to
    where photons came from, and whether each was `transmitted`. Returned are indices of the (m,)
    that are scattered, and their new directions, (3, m).
    """
    _, share = _haze(cos_in, n_in, n_out, transmitted, rms_per_wavelength)
    who = np.flatnonzero(rng.random(cos_in.shape) < share)
    transmitted = transmitted[who]
    before, behind, heights = (
        np.broadcast_to(number, share.shape)[who] for number in (n_in, n_out, rms_per_wavelength)
    )
    near, far = np.where(transmitted, (behind, before), (before, behind))
    # the way back of all photons that are alike in this
    ways = np.stack((near, far, transmitted, heights), axis=1)
    cosine = np.empty(who.size)
    for way in {*map(tuple, ways.tolist())}:
        critical = math.sqrt(max(1e-6, 1.0 - (way[1] / way[0]) ** 2))
        cosines = np.append(np.linspace(1e-3, 1.0, 1000), critical)
        highest = np.prod(_haze(cosines, *way), axis=0).max()
        pending = np.flatnonzero(np.all(ways == way, axis=1))
        while pending.size:
            drawn = np.sqrt(1.0 - rng.random(pending.size))
            taken = rng.random(pending.size) * highest < np.prod(_haze(drawn, *way), axis=0)
            cosine[pending[taken]] = drawn[taken]
            pending = pending[~taken]
    return who, about(rng, np.where(transmitted, 1.0, -1.0) * normal[:, who], cosine)


def _haze(
    cos_in: Floats, n_in: _Number, n_out: _Number, transmitted: Flags | float, heights: _Number
) -> tuple[Floats, Floats]:
    """What of unpolarised light a face reflects, or transmits, and what of this it scatters."""
    cos_out = np.sqrt(np.maximum(cosine_squared_out(cos_in, n_in, n_out), 0.0))
    reflectance = unpolarised_reflectance(cos_in, n_in, n_out, cos_out)
    path = np.where(transmitted, np.abs(n_in * cos_in - n_out * cos_out), 2.0 * n_in * cos_in)
    scattered = -np.expm1(-np.square(2.0 * np.pi * heights * path))
    return np.where(transmitted, 1.0 - reflectance, reflectance), scattered


# A film thinner than a wavelength that absorbs, between glass and vacuum.


class AbsorbingFilm(NamedTuple):
    """A photocathode, by the characteristic matrix of its layer.

    F. Abelès, Annales de Physique 12 (1950) 596; in the form of H. A. Macleod, Thin-Film Optical
    Filters, chapter 2: with the admittance eta of a medium, which is n cos(theta) for s and
    n / cos(theta) for p polarised light, the film's phase delta = 2 pi n cos(theta) d / lambda and
    vacuum behind it, B = cos(delta) + eta_v / eta_f (-i sin(delta)) and
    C = -i eta_f sin(delta) + eta_v cos(delta), for the time dependence exp(-i omega t).
    """

    #: n + ik
    film_index: complex
    #: Of the glass.
    n_window: float
    #: Thickness over the wavelength in vacuum.
    wavelengths: float

    def waves(self, cos_in: Floats) -> tuple[Complexes, Floats]:
        """Reflected amplitudes (as of `amplitudes`) and transmittances of s and p light, (2, n)."""
        sine = self.n_window * np.sqrt(1.0 - np.square(cos_in))
        cosines = [np.sqrt(1.0 - (sine / n) ** 2 + 0j) for n in (self.film_index, 1.0)]
        delta = 2.0 * np.pi * self.wavelengths * self.film_index * cosines[0]
        reflected, transmitted = [], []
        for power in (1, -1):
            of_glass = self.n_window * cos_in**power
            of_film, of_vacuum = (
                n * cosine**power for n, cosine in zip((self.film_index, 1.0), cosines, strict=True)
            )
            b = np.cos(delta) - 1j * np.sin(delta) * of_vacuum / of_film
            c = of_vacuum * np.cos(delta) - 1j * np.sin(delta) * of_film
            r = (of_glass * b - c) / (of_glass * b + c)
            # tangential components of p polarised light turn round in reflection
            reflected.append(r * power)
            entering = 4.0 * of_glass * of_vacuum.real / np.abs(of_glass * b + c) ** 2
            transmitted.append(entering)
        return np.array(reflected), np.array(transmitted)


# The photocathode K-Cs-Sb: wavelengths in nm, and n and k of its index n + ik. D. Motta and
# S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217, as tabulated in WCSim
# (data/CathodeParameters_KCsCb.txt); 420 and 540 nm are this project's.
_CATHODE_NM = np.array(sorted([*range(380, 681, 15), 420, 540]), dtype=float)
_CATHODE_N = """
    1.92 2.18 2.38 2.57 2.61 2.70 2.87 3.00 3.00 3.00 3.09 3.26
    3.22 3.20 3.12 3.06 3.01 2.98 2.96 2.95 2.95 2.95 2.96
"""
_CATHODE_K = """
    1.69 1.69 1.71 1.57 1.53 1.50 1.44 1.34 1.11 1.06 1.05 0.86
    0.7055 0.63 0.53 0.46 0.42 0.38 0.37 0.35 0.34 0.34 0.33
"""


def cathode_index(wavelength_nm: float) -> complex:
    """Index n + ik of the photocathode, on straight lines between the tabulated wavelengths."""
    tables = (np.array(table.split(), float) for table in (_CATHODE_N, _CATHODE_K))
    n, k = (np.interp(wavelength_nm, _CATHODE_NM, table) for table in tables)
    return complex(n, k)
