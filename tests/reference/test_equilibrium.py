"""Light in equilibrium stays so at every kind of face of the NumPy tracer.

Isotropic light, of radiance n^2 on either side of a face, is in equilibrium: what the face sends
back and lets through is isotropic again, with the same radiance, and n^2 T(in -> out) is
T(out -> in). The second law asks that of every face without losses, whatever its heights are.

Seeds are fixed. Each comparison asks for |z| < 5.2, which a right face exceeds with probability
2e-7; the file makes about 2,000, so 4e-4 is the chance that new seeds fail a right face.
"""

import math

import numpy as np
import pytest
from comparisons import assert_compatible
from many import cross, dot, lambertian, random_polarisation, unpolarised_reflectance

CONTRASTS = [(2.01, 1.0), (1.46, 1.0), (2.01, 1.46), (1.82, 1.0003)]
ALPHAS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6)
WAVELENGTH_NM = 540.0
RINGS = 10
Z_MAX = 5.2


def _hazy(*arguments_and_rms):
    *arguments, rms_nm = arguments_and_rms
    return cross(*arguments, heights=rms_nm / WAVELENGTH_NM)[:2]


def _rough(*arguments_and_alpha, **options):
    *arguments, alpha = arguments_and_alpha
    return cross(*arguments, alpha=alpha, **options)[:2]


def _beckmann(*arguments):
    return _rough(*arguments, beckmann=True)


def _polarised(rng, direction, *arguments):
    return _rough(rng, direction, *arguments, field=random_polarisation(rng, direction))


def _rough_and_hazy(*arguments):
    return _rough(*arguments, heights=30.0 / WAVELENGTH_NM)


@pytest.mark.parametrize(
    ("face", "sizes"),
    [
        (_rough, ALPHAS),
        (_beckmann, ALPHAS),
        (_polarised, (0.4,)),
        (_rough_and_hazy, (0.3,)),
        (_hazy, (2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)),
    ],
)
def test_isotropic_light_in_equilibrium_stays_so(face, sizes):
    """Radiance by angle on both sides, and the exchange, of every case and over all of them."""
    rng, count = np.random.default_rng(1), 60_000
    normal = np.repeat([[0.0], [0.0], [1.0]], count, axis=1)
    cases = [(size, *indices) for size in sizes for indices in CONTRASTS]
    scores = []
    for size, *indices in cases:
        # shares of the photons that come from one side, by side and ring of equal flux that they
        # leave to
        shares = np.zeros((2, 2, RINGS))
        for side, (n_in, n_out) in enumerate((indices, indices[::-1])):
            outgoing, transmitted = face(rng, lambertian(rng, normal), normal, n_in, n_out, size)
            assert np.array_equal(outgoing[2] > 0.0, transmitted)
            ring = np.minimum(RINGS * outgoing[2] ** 2, RINGS - 1).astype(int)
            np.add.at(shares[side], (np.where(transmitted, 1 - side, side), ring), 1.0 / count)
        light = np.square(indices)[:, None, None]
        excess = np.sum(light * shares, axis=0) - light[:, 0] / RINGS
        error = np.sqrt(np.sum(light**2 * shares * (1.0 - shares), axis=0) / count)
        through = np.array([shares[0, 1].sum(), shares[1, 0].sum()])
        exchange = np.subtract(*light[:, 0, 0] * through)
        exchange /= math.sqrt(np.sum(light[:, 0, 0] ** 2 * through * (1.0 - through)) / count)
        scores.append([exchange, *(excess / error).ravel()])
    worst = cases[np.abs(scores).max(axis=1).argmax()]
    assert np.abs(scores).max() < Z_MAX, f"size and indices {worst}"
    together = np.sum(scores, axis=0) / math.sqrt(len(cases))
    assert np.abs(together).max() < Z_MAX


@pytest.mark.parametrize("beckmann", [False, True])
@pytest.mark.parametrize(("n_in", "n_out"), [(2.01, 1.0), (1.0, 2.01), (2.01, 1.46)])
def test_a_face_of_no_slope_is_the_smooth_interface(n_in, n_out, beckmann):
    rng, count = np.random.default_rng(2), 20_000
    normal = np.repeat([[0.0], [0.6], [0.8]], count, axis=1)
    direction = lambertian(rng, normal)
    cosine = dot(direction, normal)
    outgoing, transmitted = _rough(rng, direction, normal, n_in, n_out, 1e-9, beckmann=beckmann)
    cosine_out = np.sqrt(np.maximum(0.0, 1.0 - (n_in / n_out) ** 2 * (1.0 - cosine**2)))
    mirrored = direction - 2.0 * cosine * normal
    refracted = n_in / n_out * (direction - cosine * normal) + cosine_out * normal
    specular = np.where(transmitted, refracted, mirrored)
    # near grazing and critical angles a slope moves more than itself
    np.testing.assert_allclose(outgoing, specular, atol=1e-3)
    np.testing.assert_allclose(np.median(np.abs(outgoing - specular)), 0.0, atol=1e-8)
    through = 1.0 - unpolarised_reflectance(cosine, n_in, n_out)
    sigma = math.sqrt(np.sum(through * (1.0 - through))) / count
    assert_compatible(transmitted.mean(), sigma, through.mean(), z_max=Z_MAX)
