"""The tracer's functions of one photon, for arrays of them: vectors are (3, n)."""

from typing import NamedTuple

import numpy as np

from mcrim_mitsuba.reference import interface, walk
from mcrim_mitsuba.reference.compiling import compiled


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def state(rng):
    """A photon's generator, begun by one of NumPy's."""
    return rng.integers(2**63, size=1, dtype=np.uint64)


@compiled
def _vector(a, i):
    return a[0, i], a[1, i], a[2, i]


@compiled
def _put(a, i, vector):
    a[0, i], a[1, i], a[2, i] = vector


@compiled
def _directions(rng, kind, axis, cosine, out):
    for i in range(out.shape[1]):
        if kind == 0:
            _put(out, i, interface.isotropic(rng))
        elif kind == 1:
            _put(out, i, interface.lambertian(rng, _vector(axis, i)))
        else:
            _put(out, i, interface.about(rng, _vector(axis, i), cosine[i]))


def isotropic(rng, count):
    out = np.empty((3, count))
    _directions(state(rng), 0, out, out[0], out)
    return out


def lambertian(rng, axis):
    return about(rng, axis, np.empty(axis.shape[1]), 1)


def about(rng, axis, cosine, kind=2):
    out = np.empty(axis.shape)
    _directions(state(rng), kind, np.ascontiguousarray(axis), np.ascontiguousarray(cosine), out)
    return out


@compiled
def _cosines(rng, rayleigh, g, out):
    for i in range(len(out)):
        out[i] = interface.scattered_cosine(rng, rayleigh, g)


def scattered_cosines(rng, count, rayleigh, g):
    out = np.empty(count)
    _cosines(state(rng), rayleigh, g, out)
    return out


@compiled
def _polarisations(rng, direction, out):
    for i in range(out.shape[1]):
        _put(out, i, interface.random_polarisation(rng, _vector(direction, i)))


def random_polarisation(rng, direction):
    out = np.empty(direction.shape, complex)
    _polarisations(state(rng), np.ascontiguousarray(direction), out)
    return out


def basis(axis):
    pairs = [interface.basis(tuple(each)) for each in axis.T]
    return np.array([u for u, _ in pairs]).T, np.array([v for _, v in pairs]).T


class Amplitudes(NamedTuple):
    reflected_s: np.ndarray
    reflected_p: np.ndarray
    transmitted_s: np.ndarray
    transmitted_p: np.ndarray


def amplitudes(cos_in, n_in, n_out):
    found = [interface.amplitudes(float(cosine), n_in, n_out) for cosine in cos_in]
    return Amplitudes(*np.array(found, complex).T)


@compiled
def _reflectances(cosine, n_in, n_out, out):
    for i in range(len(out)):
        out[i] = interface.unpolarised_reflectance(cosine[i], n_in, n_out)


def unpolarised_reflectance(cosine, n_in, n_out):
    out = np.empty(len(cosine))
    _reflectances(np.ascontiguousarray(cosine, float), float(n_in), float(n_out), out)
    return out


@compiled
def _cross(rng, way, axis, n_in, n_out, field, heights, alpha, beckmann, through):
    for i in range(way.shape[1]):
        d, n, e = _vector(way, i), _vector(axis, i), _vector(field, i)
        d, through[i], e = interface.cross_rough(
            rng, d, n, n_in, n_out, e, heights, alpha, beckmann
        )
        _put(way, i, d)
        _put(field, i, e)


def cross(rng, direction, normal, n_in, n_out, field=None, heights=0.0, alpha=0.0, beckmann=False):
    """Directions behind or before an interface, which are transmitted, and fields or None."""
    way, through = np.array(direction, float, order="C"), np.empty(direction.shape[1], bool)
    fields = np.zeros(way.shape, complex) if field is None else np.array(field, complex, order="C")
    axis, indices = np.ascontiguousarray(normal), (float(n_in), float(n_out))
    light = fields, float(heights), float(alpha), beckmann
    _cross(state(rng), way, axis, *indices, *light, through)
    return way, through, None if field is None else fields


@compiled
def _facets(rng, view, axis, alpha, beckmann, out):
    for i in range(out.shape[1]):
        facet = interface._visible_normal(rng, _vector(view, i), _vector(axis, i), alpha, beckmann)
        _put(out, i, facet)


def visible_normals(rng, view, normal, alpha, beckmann):
    out = np.empty(normal.shape)
    view, normal = np.ascontiguousarray(view), np.ascontiguousarray(normal)
    _facets(state(rng), view, normal, alpha, beckmann, out)
    return out


@compiled
def _hazy(rng, axis, n_in, n_out, transmitted, heights, out):
    for i in range(out.shape[1]):
        way = interface.hazy_direction(rng, axis, n_in, n_out, transmitted, heights)
        _put(out, i, way)


def hazy_directions(rng, axis, n_in, n_out, transmitted, heights, count):
    out = np.empty((3, count))
    _hazy(state(rng), axis, n_in, n_out, transmitted, heights, out)
    return out


@compiled
def _births(tables, birth, rng, position, direction):
    for i in range(position.shape[1]):
        place, way = walk._birth(tables, birth[0], rng)
        _put(position, i, place)
        _put(direction, i, way)


def births(bench, rng, count):
    """Positions and directions, (3, n) each, of a bench of faces."""
    position, direction = np.empty((3, count)), np.empty((3, count))
    _births(*bench.tables(), state(rng), position, direction)
    return position, direction


@compiled
def _nearest(tables, volume, position, direction, distance, face):
    for i in range(len(face)):
        start, way = _vector(position, i), _vector(direction, i)
        distance[i], face[i] = walk._nearest(tables, volume, start, way, -1)


def nearest(bench, volume, position, direction):
    """Distances, mm, and numbers of the faces that light in a volume meets, or -1."""
    distance, face = np.empty(position.shape[1]), np.empty(position.shape[1], int)
    tables, number = bench.tables()[0], bench.number(volume)
    rays = np.ascontiguousarray(position), np.ascontiguousarray(direction)
    _nearest(tables, number, *rays, distance, face)
    return distance, face


@compiled
def _inside(tables, volume, position, out):
    for i in range(len(out)):
        out[i] = walk._encloses(tables, volume, _vector(position, i))


def inside(bench, volume, position):
    """Whether points lie in a volume."""
    out = np.empty(position.shape[1], bool)
    _inside(bench.tables()[0], bench.number(volume), np.ascontiguousarray(position), out)
    return out


@compiled
def _detections(rng, surface, direction, field, fates):
    for i in range(len(fates)):
        way, light = _vector(direction, i), _vector(field, i)
        fates[i], way, light = walk._detector(rng, surface[0], 0.0, way, (0.0, 0.0, 1.0), light)
        _put(direction, i, way)
        _put(field, i, light)


def detections(rng, bench, direction, field=None):
    """Fates (-1: sent back), directions and fields of light that flies down to a detector."""
    surface = bench.tables()[0].surfaces[[next(iter(bench.detectors))]]
    way, fates = np.array(direction, float, order="C"), np.empty(direction.shape[1], int)
    light = np.zeros(way.shape, complex) if field is None else np.array(field, complex, order="C")
    _detections(state(rng), surface, way, light, fates)
    return fates, way, light
