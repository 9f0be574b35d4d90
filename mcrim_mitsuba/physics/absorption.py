"""Absorption coefficient from the transmittance of a polished slab.

Eq. 4 of the article after the correction for the reflections of both faces (Kushnir, its
reference 21). A beam also loses the light that is scattered out of it: unless an integrating
sphere collected that, the coefficient holds some of the scattering.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.physics.attenuation import MM_PER_CM
from mcrim_mitsuba.physics.slab import (
    Index,
    Slab,
    index_of,
    slab_at,
    slab_of_number,
    slab_over,
)
from mcrim_mitsuba.physics.spectrum import Spectrum

TRANSMITTANCE, INDEX, THICKNESS = "transmittance", "index", "thickness"
ORIENTATIONS, EMISSION = "orientations", "emission spectrum"
#: In standard errors: readings further above the reading of a clear slab are refused.
_CLEARLY_ABOVE = 3.0
#: Of full transmission: no spectrophotometer is worse.
LARGEST_SIGMA = 0.1
#: Of the whole error: by how much it must grow if points share theirs before it is said.
_WORTH_SAYING = 0.1
#: Less of the light that crosses a sample is told.
_USUAL_INTERNAL = 0.5
# readings have few digits
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Absorption:
    """Absorption coefficient of a crystal, with its errors by origin.

    Attributes
    ----------
    alpha_abs_per_cm : float
        0 at least.
    sigma : float
        Standard error: all contributions in quadrature. Where the coefficient is 0 because the
        readings lie at their limit or above it, an error upwards only.
    contributions : dict of str to float
        In 1/cm, by origin: ``transmittance``, ``index``, ``thickness``, and where they are known
        ``orientations`` and ``emission spectrum``.
    apparent_per_cm : float
        The coefficient before it was held at 0.
    internal_transmittance, internal_transmittance_sigma : float
        exp(-alpha d) of the sample, and its standard error.
    each_per_cm : tuple of float
        Apparent coefficient of every orientation.
    spread_orientations_per_cm : float or None
        Standard deviation of `each_per_cm`; None for one. It enters the error as it is, not
        divided by the root of their number: they are no repeats of one measurement, light goes
        through the crystal in all directions, and its own mean over them is not ours.
    spread_band_per_cm : float or None
        Standard deviation of the coefficient over the emission, which one number leaves out; no
        part of the error. None where there is no emission spectrum.
    n : float
        Refractive index, averaged over the emission where it is a function.
    curves : tuple of Spectrum
        Apparent coefficient over wavelength, one per orientation; empty for single numbers.
    notes : tuple of str
        What the reader must know before using the number.
    """

    alpha_abs_per_cm: float
    sigma: float
    contributions: dict[str, float]
    apparent_per_cm: float
    internal_transmittance: float
    internal_transmittance_sigma: float
    each_per_cm: tuple[float, ...]
    spread_orientations_per_cm: float | None
    spread_band_per_cm: float | None
    n: float
    curves: tuple[Spectrum, ...]
    notes: tuple[str, ...]


def absorption_from_transmittance(
    transmittances: Sequence[float] | Sequence[Spectrum],
    n: Index,
    thickness_mm: float,
    *,
    transmittance_sigma: float = 0.0,
    n_sigma: float = 0.0,
    thickness_sigma_mm: float = 0.0,
    emission: Spectrum | None = None,
    wavelength_nm: float | None = None,
) -> Absorption:
    """Absorption coefficient, mean over orientations and over the emission.

    Parameters
    ----------
    transmittances : sequence of float or of Spectrum
        Measured on the slab in air at normal incidence, fractions; one per orientation.
    n : float or callable
        Index of the crystal, or a function from wavelengths in nm to it, which must serve all
        points of the spectra within the emission (without one, all points).
    thickness_mm : float
    transmittance_sigma : float
        Standard error that all readings share, absolute, below 0.1: the accuracy of the
        spectrophotometer. Errors of a spectrum's points are counted besides, independent.
    n_sigma, thickness_sigma_mm : float
        Standard errors.
    emission : Spectrum, optional
        What spectra, and an index that is a function, are averaged with.
    wavelength_nm : float, optional
        Where they are taken without an emission.

    Raises
    ------
    InputError
        If a value is impossible, a spectrum has neither emission nor wavelength or does not
        cover it, or the crystal transmits clearly more than one that absorbs nothing.
    """
    _refuse_numbers(transmittances, thickness_mm, transmittance_sigma, n_sigma, thickness_sigma_mm)
    if emission is not None and wavelength_nm is not None:
        raise InputError("both an emission and a wavelength are given", "leave one of them out")
    spectra = [one for one in transmittances if isinstance(one, Spectrum)]
    numbers = [float(one) for one in transmittances if not isinstance(one, Spectrum)]
    if emission is None and wavelength_nm is None and (spectra or callable(n)):
        raise InputError(
            f"{'a transmittance spectrum' if spectra else 'an index that is no number'} says "
            "nothing without a wavelength",
            "give an emission spectrum, or a wavelength in nm",
        )
    index = index_of(n, emission, wavelength_nm)
    slabs = [slab_of_number(one, index, thickness_mm) for one in numbers]
    if emission is not None:
        slabs += [slab_over(one, n, thickness_mm, emission) for one in spectra]
    elif wavelength_nm is not None:
        slabs += [slab_at(one, n, thickness_mm, wavelength_nm) for one in spectra]
    each = np.array([slab.alpha_per_cm for slab in slabs])
    contributions = {
        TRANSMITTANCE: _transmittance_sigma(slabs, transmittance_sigma),
        INDEX: n_sigma * abs(float(np.mean([slab.by_n for slab in slabs]))),
        THICKNESS: thickness_sigma_mm / thickness_mm * max(float(each.mean()), 0.0),
    }
    spread = None
    if len(slabs) > 1:
        contributions[ORIENTATIONS] = spread = float(each.std(ddof=1))
    means = [slab.mean for slab in slabs if slab.mean is not None]
    if means and emission is not None and emission.sigmas is not None:
        derivatives = np.mean([mean.emission_derivatives for mean in means], axis=0)
        contributions[EMISSION] = float(np.linalg.norm(derivatives * emission.sigmas))
    sigma = math.hypot(*contributions.values())
    alpha, notes = _held(slabs, sigma)
    internal = math.exp(-alpha * thickness_mm / MM_PER_CM)
    of_path = [sigma for origin, sigma in contributions.items() if origin != THICKNESS]
    return Absorption(
        alpha_abs_per_cm=alpha,
        sigma=sigma,
        contributions=contributions,
        apparent_per_cm=float(each.mean()),
        internal_transmittance=internal,
        internal_transmittance_sigma=internal * thickness_mm / MM_PER_CM * math.hypot(*of_path),
        each_per_cm=tuple(each.tolist()),
        spread_orientations_per_cm=spread,
        spread_band_per_cm=(
            math.sqrt(float(np.mean([mean.spread**2 for mean in means]))) if means else None
        ),
        n=index,
        curves=tuple(slab.curve for slab in slabs if slab.curve is not None),
        notes=(
            *dict.fromkeys(note for mean in means for note in mean.notes),
            *notes,
            *_notes_on_errors(slabs, transmittance_sigma, contributions[TRANSMITTANCE], sigma),
            *_notes_on_darkness(internal),
        ),
    )


def _notes_on_errors(
    slabs: Sequence[Slab], shared_sigma: float, own_per_cm: float, sigma_per_cm: float
) -> list[str]:
    """What the error of the transmittance does not hold."""
    if not own_per_cm > 0:
        return [
            "the transmittance comes without errors: none of it is counted; state the one that all "
            "readings share (transmittance_sigma, --sigma)"
        ]
    shared_per_cm = float(np.mean([slab.points_shared_per_cm for slab in slabs]))
    whole = math.sqrt(sigma_per_cm**2 + max(shared_per_cm**2 - own_per_cm**2, 0.0))
    if shared_sigma > 0 or whole < (1 + _WORTH_SAYING) * sigma_per_cm:
        return []
    return [
        "errors of the transmittance's points are taken as independent, "
        f"{own_per_cm:.2g} /cm together; if all points share them they are worth "
        f"{shared_per_cm:.2g} /cm: then state that as the error of all readings "
        "(transmittance_sigma, --sigma)"
    ]


def _notes_on_darkness(internal: float) -> list[str]:
    if internal >= _USUAL_INTERNAL:
        return []
    return [
        f"only {100 * internal:.2g} % of the light crosses the sample: make sure that the "
        "transmittance is no absorbance, and is of full transmission"
    ]


def _transmittance_sigma(slabs: Sequence[Slab], shared_sigma: float) -> float:
    """Error by what all readings share, and by what every point has of its own."""
    shared = shared_sigma * float(np.mean([slab.by_transmittance for slab in slabs]))
    return math.hypot(shared, math.hypot(*(s.points_sigma_per_cm for s in slabs)) / len(slabs))


def _held(slabs: Sequence[Slab], sigma: float) -> tuple[float, list[str]]:
    """The mean coefficient, 0 at least, and a note where it was held there."""
    alpha = float(np.mean([slab.alpha_per_cm for slab in slabs]))
    if alpha >= -_ROUNDING:
        return max(alpha, 0.0), []
    worst = min(slabs, key=lambda slab: slab.alpha_per_cm)
    if -alpha > _CLEARLY_ABOVE * sigma:
        raise InputError(
            worst.highest,
            "check the index and the 100 % line, or give the errors of reading and index",
            path=worst.name or None,
        )
    return 0.0, [
        f"{worst.highest}, within its error: the coefficient is held at 0, and its error is one "
        "upwards"
    ]


def _refuse_numbers(
    transmittances: Sequence[float] | Sequence[Spectrum],
    thickness_mm: float,
    sigma: float,
    n_sigma: float,
    thickness_sigma_mm: float,
) -> None:
    if not len(transmittances):
        raise InputError("there is no transmittance", "give one at least")
    for value in transmittances:
        if not isinstance(value, Spectrum) and not 0 < value <= 1:
            raise InputError(
                f"the transmittance {value:g} is not between 0 and 1",
                f"write {value / 100:g} for {value:g} %"
                if 1 < value <= 100
                else "give a fraction: 0.76 for 76 %",
            )
    if not (thickness_mm > 0 and math.isfinite(thickness_mm)):
        raise InputError(f"the thickness is {thickness_mm:g} mm", "give one above 0, in mm")
    for what, error, most in (
        ("transmittance", sigma, LARGEST_SIGMA), ("index", n_sigma, 1.0),
        ("thickness", thickness_sigma_mm, thickness_mm),
    ):  # fmt: skip
        if not 0 <= error < most:
            raise InputError(
                f"the error of the {what} is {error:g}",
                f"give 0 or more, below {most:g}"
                + (": 0.005 for 0.5 %" if what == "transmittance" else ""),
            )
    for value in transmittances:
        if not isinstance(value, Spectrum) and value <= sigma:
            raise InputError(
                f"the transmittance {value:g} is not above its error {sigma:g}",
                "measure a thinner sample",
            )
