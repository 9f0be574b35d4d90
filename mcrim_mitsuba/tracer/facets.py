"""Rough faces made of microfacets: each photon meets one facet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.tracer.directions import basis
from mcrim_mitsuba.tracer.geometry import dot
from mcrim_mitsuba.tracer.interface import cross


def cross_rough(
    rng: np.random.Generator,
    direction: NDArray[np.float64],
    normal: NDArray[np.float64],
    n_in: float,
    n_out: NDArray[np.float64],
    roughness: float,
    field: NDArray[np.complex128] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.complex128] | None]:
    """Send photons through a rough interface, each as one whole quantum.

    A facet is drawn among those that the photon sees, and Fresnel's formulae at the facet decide
    between reflection and refraction. Where light would then be on the wrong side of the face
    itself, facet and decision are drawn again, so nothing is lost.

    Parameters and what is returned are those of `interface.cross`, and ``roughness``: the GGX
    parameter alpha, above 0.
    """
    count = direction.shape[1]
    outgoing, transmitted = np.empty_like(direction), np.empty(count, dtype=bool)
    out = None if field is None else np.empty_like(field)
    who = np.arange(count)
    while who.size:
        ahead = normal[:, who]
        facet = visible_normals(rng, -direction[:, who], -ahead, roughness)
        towards, through, states = cross(
            rng,
            direction[:, who],
            -facet,
            n_in,
            n_out[who],
            None if field is None else field[:, who],
        )
        along = dot(towards, ahead)
        right = np.where(through, along > 0.0, along < 0.0)
        settled = who[right]
        outgoing[:, settled], transmitted[settled] = towards[:, right], through[right]
        if out is not None and states is not None:
            out[:, settled] = states[:, right]
        who = who[~right]
    return outgoing, transmitted, out


def visible_normals(
    rng: np.random.Generator,
    view: NDArray[np.float64],
    normal: NDArray[np.float64],
    roughness: float,
) -> NDArray[np.float64]:
    """Normals of GGX facets, in proportion to the area that is seen along ``view``.

    E. Heitz, Sampling the GGX distribution of visible normals, Journal of
    Computer Graphics Techniques 7(4), 2018. The distribution of slopes is that of
    B. Walter et al., Eurographics Symposium on Rendering 2007.

    Parameters
    ----------
    rng : numpy.random.Generator
    view : (3, n) float64
        Unit vectors from the face towards where the light comes from.
    normal : (3, n) float64
        Unit normals of the face on that side: ``view . normal`` is positive.
    roughness : float
        GGX's alpha.

    Returns
    -------
    (3, n) float64
        Unit vectors, with positive ``view . facet``.
    """
    # the face's own frame, with the plane of incidence as x-z plane: view = (sine, 0, cosine)
    cosine = dot(view, normal)
    x = view - cosine * normal
    sine = np.sqrt(dot(x, x))
    perpendicular = sine == 0.0
    x = np.where(perpendicular, basis(normal)[0], x / np.where(perpendicular, 1.0, sine))
    y = np.stack(
        (
            normal[1] * x[2] - normal[2] * x[1],
            normal[2] * x[0] - normal[0] * x[2],
            normal[0] * x[1] - normal[1] * x[0],
        )
    )
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
    facet_y = roughness * across
    facet_z = np.maximum(0.0, towards * cosine + upwards * sine)
    facet = facet_x * x + facet_y * y + facet_z * normal
    return facet / np.sqrt(dot(facet, facet))
