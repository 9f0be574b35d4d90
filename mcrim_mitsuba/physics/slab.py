"""What one measurement of a polished slab's transmittance says of its absorption.

A coefficient stays apparent here: noise may lift a reading above that of a clear slab, and only
the mean over all readings may be held at 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.physics.attenuation import (
    absorption_derivatives,
    apparent_absorption,
    clear_limit,
)
from mcrim_mitsuba.physics.spectrum import Spectrum, WeightedMean, average_over, weighted_mean

#: Refractive index: a number, or a function of wavelengths in nm.
Index = float | Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Slab:
    """Absorption of a slab, measured once: in one orientation.

    Attributes
    ----------
    alpha_per_cm : float
        Apparent coefficient.
    by_transmittance, by_n : float
        Its change with a shift of all readings, and with the index, in 1/cm.
    points_sigma_per_cm : float
        Its error by the errors of the spectrum's points, each independent.
    points_shared_per_cm : float
        What these errors would be worth if all points shared them.
    highest : str
        The reading that is highest above, or nearest to, that of a clear slab, in words.
    name : str
        Where it comes from.
    mean : WeightedMean or None
        Over the emission, if there is one.
    curve : Spectrum or None
        Apparent coefficient over wavelength, if a spectrum was measured.
    """

    alpha_per_cm: float
    by_transmittance: float
    by_n: float
    points_sigma_per_cm: float
    points_shared_per_cm: float
    highest: str
    name: str = ""
    mean: WeightedMean | None = None
    curve: Spectrum | None = None


def index_of(n: Index, emission: Spectrum | None, wavelength_nm: float | None) -> float:
    """One index: the number, or the function over the emission or at the wavelength."""
    if not callable(n):
        return float(n)
    if emission is not None:
        return average_over(emission, n)[0]
    return float(n(np.array([wavelength_nm]))[0])


def slab_of_number(transmittance: float, n: float, thickness_mm: float) -> Slab:
    """From one measured number.

    Raises
    ------
    InputError
        If a value is impossible.
    """
    by_transmittance, by_n = absorption_derivatives(transmittance, n, thickness_mm)
    return Slab(
        float(apparent_absorption(transmittance, n, thickness_mm)), float(by_transmittance),
        float(by_n), 0.0, 0.0, _beside_clear(transmittance, n),
    )  # fmt: skip


def slab_at(transmittance: Spectrum, n: Index, thickness_mm: float, wavelength_nm: float) -> Slab:
    """From a spectrum, at one wavelength.

    Raises
    ------
    InputError
        If the spectrum does not go there, or no light gets through.
    """
    measured = float(transmittance.at(wavelength_nm))
    curve = _curve(transmittance, n, thickness_mm, wavelength_nm)[0]
    index = index_of(n, None, wavelength_nm)
    by_transmittance, by_n = absorption_derivatives(measured, index, thickness_mm)
    sigma, shared = 0.0, 0.0
    own = transmittance.sigma_at(wavelength_nm)
    if own is not None and transmittance.sigmas is not None:
        change = abs(float(by_transmittance))
        sigma = change * own
        shared = change * float(
            np.interp(wavelength_nm, transmittance.wavelength_nm, transmittance.sigmas)
        )
    return Slab(
        alpha_per_cm=float(apparent_absorption(measured, index, thickness_mm)),
        by_transmittance=float(by_transmittance),
        by_n=float(by_n),
        points_sigma_per_cm=sigma,
        points_shared_per_cm=shared,
        highest=f"at {wavelength_nm:g} nm, {_beside_clear(measured, index)}",
        name=transmittance.name,
        curve=curve,
    )


def slab_over(transmittance: Spectrum, n: Index, thickness_mm: float, emission: Spectrum) -> Slab:
    """From a spectrum, mean over the emission.

    Raises
    ------
    InputError
        If the crystal emits where the spectrum does not go or no light gets through.
    """
    peak_nm = float(emission.wavelength_nm[np.argmax(emission.values)])
    curve, measured, indices = _curve(transmittance, n, thickness_mm, peak_nm, emission)
    mean = weighted_mean(emission, curve, "the transmittance")
    by_transmittance, by_n = absorption_derivatives(measured, indices, thickness_mm)
    weights = mean.quantity_derivatives
    above = np.where(weights > 0, measured - clear_limit(indices), -np.inf)
    i = int(np.argmax(above))
    beside = _beside_clear(float(measured[i]), float(indices[i]))
    return Slab(
        alpha_per_cm=mean.value,
        by_transmittance=float(weights @ by_transmittance),
        by_n=float(weights @ by_n),
        points_sigma_per_cm=mean.quantity_sigma or 0.0,
        points_shared_per_cm=0.0 if curve.sigmas is None else float(np.abs(weights) @ curve.sigmas),
        highest=f"at {curve.wavelength_nm[i]:g} nm, {beside}",
        name=transmittance.name,
        mean=mean,
        curve=curve,
    )


def _beside_clear(measured: float, n: float) -> str:
    return (
        f"{100 * measured:.4g} % transmitted is more than the {100 * float(clear_limit(n)):.4g} % "
        f"of a slab with n = {n:.4g} that absorbs nothing"
    )


def _curve(
    transmittance: Spectrum,
    n: Index,
    thickness_mm: float,
    inside_nm: float,
    emission: Spectrum | None = None,
) -> tuple[Spectrum, NDArray[np.float64], NDArray[np.float64]]:
    """Apparent coefficient over wavelength, with the readings and indices there.

    Around `inside_nm` as far as light gets through, and no further than the emission: beyond it
    the index may be unknown.
    """  # fmt: skip
    places, readings = transmittance.wavelength_nm, transmittance.values
    if not transmittance.at(inside_nm) > 0:
        raise _opaque(transmittance, inside_nm)
    first, last = 0, places.size - 1
    if emission is not None:
        first = max(first, int(np.searchsorted(places, emission.first_nm, side="right")) - 1)
        last = min(last, int(np.searchsorted(places, emission.last_nm)))
    dark = np.flatnonzero(readings <= 0)
    below, above = dark[places[dark] < inside_nm], dark[places[dark] > inside_nm]
    first = max(first, int(below[-1]) + 1 if below.size else first)
    last = min(last, int(above[0]) - 1 if above.size else last)
    if last <= first:
        raise _opaque(transmittance, inside_nm)
    part = slice(first, last + 1)
    places, measured = places[part], readings[part]
    indices = np.asarray(n(places), float) if callable(n) else np.full(places.shape, float(n))
    alpha = apparent_absorption(measured, indices, thickness_mm)
    sigmas = None
    if transmittance.sigmas is not None:
        by_transmittance, _ = absorption_derivatives(measured, indices, thickness_mm)
        sigmas = np.abs(by_transmittance) * transmittance.sigmas[part]
    return Spectrum(places, alpha, sigmas, transmittance.name), measured, indices


def _opaque(transmittance: Spectrum, wavelength_nm: float) -> InputError:
    return transmittance.refusal(
        f"no light gets through the sample at {wavelength_nm:g} nm",
        "measure a thinner sample, or subtract the right dark signal",
    )
