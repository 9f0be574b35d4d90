"""Absorption coefficient from the transmittance of a polished slab.

Eq. 4 of the article after the correction for the reflections of both faces (Kushnir, its
reference 21). A beam also loses the light that is scattered out of it: unless an integrating
sphere collected that, the coefficient holds some of the scattering."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.optics.slab_transmittance import (
    absorption_derivatives,
    apparent_absorption,
    clear_limit,
)
from mcrim_mitsuba.optics.spectrum import Spectrum, WeightedMean, average_over, weighted_mean

#: Refractive index: a number, or a function of wavelengths in nm.
Index = float | Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class _SlabReading:
    """Absorption of a slab, measured once: in one orientation."""

    #: Apparent coefficient.
    alpha_per_cm: float
    #: Its change with a shift of all readings, and with the index, in 1/cm.
    by_transmittance: float
    by_n: float
    #: The reading that is highest above, or nearest to, that of a clear slab, in words.
    highest: str
    _: KW_ONLY
    #: Where it comes from.
    name: str = ""
    #: Apparent coefficient over wavelength, if a spectrum was measured.
    curve: Spectrum | None = None
    #: Its error by the errors of the spectrum's points, each independent.
    points_sigma_per_cm: float = 0.0
    #: What these errors would be worth if all points shared them.
    points_shared_per_cm: float = 0.0
    #: Over the emission, if there is one.
    mean: WeightedMean | None = None


def _index_of(n: Index, emission: Spectrum | None, wavelength_nm: float | None) -> float:
    """One index: the number, or the function over the emission or at the wavelength."""
    if not callable(n):
        return float(n)
    if emission is not None:
        return average_over(emission, n)[0]
    return float(n(np.array([wavelength_nm]))[0])


def _slab_of_number(transmittance: float, n: float, thickness_mm: float) -> _SlabReading:
    """Absorption of a slab from one transmittance, without a wavelength."""
    by_transmittance, by_n = absorption_derivatives(transmittance, n, thickness_mm)
    alpha = apparent_absorption(transmittance, n, thickness_mm)
    beside = _beside_clear(transmittance, n)
    return _SlabReading(float(alpha), float(by_transmittance), float(by_n), beside)


def _slab_at(
    transmittance: Spectrum, n: Index, thickness_mm: float, wavelength_nm: float
) -> _SlabReading:
    """Absorption of a slab from a spectrum, at one wavelength."""
    measured = float(transmittance.at(wavelength_nm))
    curve, _, _ = _curve(transmittance, n, thickness_mm, wavelength_nm)
    slab = _slab_of_number(measured, _index_of(n, None, wavelength_nm), thickness_mm)
    highest = f"at {wavelength_nm:g} nm, {slab.highest}"
    slab = replace(slab, highest=highest, name=transmittance.name, curve=curve)
    sigma, sigmas = transmittance.sigma_at(wavelength_nm), transmittance.sigmas
    if sigma is None or sigmas is None:
        return slab
    slope = abs(slab.by_transmittance)
    shared = slope * float(np.interp(wavelength_nm, transmittance.wavelength_nm, sigmas))
    return replace(slab, points_sigma_per_cm=slope * sigma, points_shared_per_cm=shared)


def _slab_over(
    transmittance: Spectrum, n: Index, thickness_mm: float, emission: Spectrum
) -> _SlabReading:
    """Absorption of a slab from a spectrum, mean over the emission."""
    peak_nm = float(emission.wavelength_nm[np.argmax(emission.values)])
    curve, measured, indices = _curve(transmittance, n, thickness_mm, peak_nm, emission)
    mean = weighted_mean(emission, curve, "the transmittance")
    by_transmittance, by_n = absorption_derivatives(measured, indices, thickness_mm)
    weights = mean.quantity_derivatives
    # the worst of the readings that the mean rests on
    i = int(np.argmax(np.where(weights > 0, measured - clear_limit(indices), -np.inf)))
    beside = _beside_clear(float(measured[i]), float(indices[i]))
    return _SlabReading(
        alpha_per_cm=mean.value,
        by_transmittance=float(weights @ by_transmittance),
        by_n=float(weights @ by_n),
        highest=f"at {curve.wavelength_nm[i]:g} nm, {beside}",
        name=transmittance.name,
        curve=curve,
        points_sigma_per_cm=mean.quantity_sigma or 0.0,
        points_shared_per_cm=0.0 if curve.sigmas is None else float(np.abs(weights) @ curve.sigmas),
        mean=mean,
    )


def _beside_clear(measured: float, n: float) -> str:
    """A reading beside the highest that a slab can have, in words."""
    most = f"{100 * float(clear_limit(n)):.4g} % of a slab with n = {n:.4g} that absorbs nothing"
    return f"{100 * measured:.4g} % transmitted is more than the {most}"


def _curve(
    transmittance: Spectrum,
    n: Index,
    thickness_mm: float,
    inside_nm: float,
    emission: Spectrum | None = None,
) -> tuple[Spectrum, Array, Array]:
    """Apparent coefficient over wavelength, with the readings and indices there.

    Around `inside_nm` as far as light gets through, and no further than the emission: beyond it
    the index may be unknown.
    """
    nm, readings = transmittance.wavelength_nm, transmittance.values
    mend = "measure a thinner sample, or subtract the right dark signal"
    opaque = transmittance.refusal(f"no light gets through the sample at {inside_nm:g} nm", mend)
    if not transmittance.at(inside_nm) > 0:
        raise opaque
    # from the last point at or before the emission's beginning to the first at or behind its end
    first, last = 0, nm.size - 1
    if emission is not None:
        first = max(first, int(np.searchsorted(nm, emission.first_nm, side="right")) - 1)
        last = min(last, int(np.searchsorted(nm, emission.last_nm)))
    # between the nearest dark points on either side
    dark = np.flatnonzero(readings <= 0)
    below, above = dark[nm[dark] < inside_nm], dark[nm[dark] > inside_nm]
    first = max(first, int(below[-1]) + 1 if below.size else first)
    last = min(last, int(above[0]) - 1 if above.size else last)
    if last <= first:
        raise opaque
    part = slice(first, last + 1)
    nm, measured = nm[part], readings[part]
    indices = np.asarray(n(nm), float) if callable(n) else np.full(nm.shape, float(n))
    alpha = apparent_absorption(measured, indices, thickness_mm)
    sigmas = None
    if transmittance.sigmas is not None:
        by_transmittance, _ = absorption_derivatives(measured, indices, thickness_mm)
        sigmas = np.abs(by_transmittance) * transmittance.sigmas[part]
    return Spectrum(nm, alpha, sigmas, transmittance.name), measured, indices


TRANSMITTANCE = "transmittance"
INDEX = "index"
THICKNESS = "thickness"
ORIENTATIONS = "orientations"
EMISSION = "emission spectrum"
#: In standard errors: readings further above the reading of a clear slab are refused.
_CLEARLY_ABOVE = 3.0
#: Of full transmission: no spectrophotometer is worse.
LARGEST_SIGMA = 0.1
#: Of the whole error: by how much it must grow if points share theirs before it is said.
_WORTH_SAYING = 0.1
#: Less of the light that crosses a sample is told.
_USUAL_INTERNAL = 0.5
_DARK = (
    "only {:.2g} % of the light crosses the sample: make sure that the transmittance is no "
    "absorbance, and is of full transmission"
)
# Of a coefficient, 1/cm: readings have few digits.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Absorption:
    """Absorption coefficient of a crystal, with its errors by origin."""

    #: 0 at least.
    alpha_abs_per_cm: float
    #: Standard error: all contributions in quadrature. Where the coefficient is 0 because the
    #: readings lie at their limit or above it, an error upwards only.
    sigma: float
    #: In 1/cm, by origin: ``transmittance``, ``index``, ``thickness``, and where they are known
    #: ``orientations`` and ``emission spectrum``.
    contributions: dict[str, float]
    _: KW_ONLY
    #: exp(-alpha d) of the sample.
    internal_transmittance: float
    #: Apparent coefficient of every orientation.
    each_per_cm: tuple[float, ...]
    #: Standard deviation of the coefficient over the emission, which one number leaves out; no
    #: part of the error. None where there is no emission spectrum.
    spread_band_per_cm: float | None
    #: Refractive index, averaged over the emission where it is a function.
    n: float
    #: Apparent coefficient over wavelength, one per orientation; empty for single numbers.
    curves: tuple[Spectrum, ...]
    #: What it was made of: spectra or numbers, one per orientation, and the standard error that
    #: they share; the slab's thickness; the index, and the light that all is averaged over.
    spectra: tuple[Spectrum, ...]
    numbers: tuple[float, ...]
    transmittance_sigma: float
    thickness_mm: float
    index: Index
    emission: Spectrum | None
    #: What the reader must know before using the number.
    notes: tuple[str, ...]

    @property
    def apparent_per_cm(self) -> float:
        """The coefficient before it was held at 0."""
        return float(np.mean(self.each_per_cm))

    @property
    def internal_transmittance_sigma(self) -> float:
        """Standard error of `internal_transmittance`, at the thickness as it is."""
        of_path = [part for origin, part in self.contributions.items() if origin != THICKNESS]
        return self.internal_transmittance * self.thickness_mm / MM_PER_CM * math.hypot(*of_path)

    @property
    def spread_orientations_per_cm(self) -> float | None:
        """Standard deviation of `each_per_cm`; None for one.

        It enters the error as it is, not divided by the root of their number: they are no repeats
        of one measurement, light goes through the crystal in all directions, and its own mean over
        them is not ours.
        """
        return self.contributions.get(ORIENTATIONS)


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

    Transmittances, one per orientation, are fractions measured on the slab in air at normal
    incidence. The index `n` may be a function of wavelengths in nm, which must serve all points of
    the spectra within the emission (without one, all points). With the `emission` spectra, and such
    an index, are averaged; without it they are taken at `wavelength_nm`. `transmittance_sigma` is
    the absolute standard error that all readings share, below 0.1: the accuracy of the
    spectrophotometer. Errors of a spectrum's points are counted besides, independent.

    Raises InputError if a value is impossible, a spectrum has neither emission nor wavelength or
    does not cover it, or the crystal transmits clearly more than one that absorbs nothing.
    """
    if not len(transmittances):
        raise InputError("there is no transmittance", "give one at least")
    spectra = [t for t in transmittances if isinstance(t, Spectrum)]
    numbers = [float(t) for t in transmittances if not isinstance(t, Spectrum)]
    _refuse_numbers(numbers, thickness_mm, transmittance_sigma, n_sigma, thickness_sigma_mm)
    if emission is not None and wavelength_nm is not None:
        raise InputError("both an emission and a wavelength are given", "leave one of them out")
    if emission is None and wavelength_nm is None and (spectra or callable(n)):
        what = "a transmittance spectrum" if spectra else "an index that is no number"
        problem = f"{what} says nothing without a wavelength"
        raise InputError(problem, "give an emission spectrum, or a wavelength in nm")
    index = _index_of(n, emission, wavelength_nm)
    slabs = [_slab_of_number(number, index, thickness_mm) for number in numbers]
    if emission is not None:
        slabs += [_slab_over(spectrum, n, thickness_mm, emission) for spectrum in spectra]
    elif wavelength_nm is not None:
        slabs += [_slab_at(spectrum, n, thickness_mm, wavelength_nm) for spectrum in spectra]
    relative = thickness_sigma_mm / thickness_mm
    contributions = _contributions(slabs, emission, transmittance_sigma, n_sigma, relative)
    sigma = math.hypot(*contributions.values())
    alpha, notes = _held(slabs, sigma)
    internal = math.exp(-alpha * thickness_mm / MM_PER_CM)
    means = [slab.mean for slab in slabs if slab.mean is not None]
    variances = [mean.spread**2 for mean in means]
    return Absorption(
        alpha_abs_per_cm=alpha,
        sigma=sigma,
        contributions=contributions,
        internal_transmittance=internal,
        each_per_cm=tuple(slab.alpha_per_cm for slab in slabs),
        spread_band_per_cm=math.sqrt(np.mean(variances)) if means else None,
        n=index,
        curves=tuple(slab.curve for slab in slabs if slab.curve is not None),
        spectra=tuple(spectra),
        numbers=tuple(numbers),
        transmittance_sigma=transmittance_sigma,
        thickness_mm=thickness_mm,
        index=n,
        emission=emission,
        notes=(
            *(note for spectrum in spectra for note in spectrum.notes),
            *dict.fromkeys(note for mean in means for note in mean.notes),
            *notes,
            *_notes_on_errors(slabs, transmittance_sigma, contributions[TRANSMITTANCE], sigma),
            *([_DARK.format(100 * internal)] if internal < _USUAL_INTERNAL else []),
        ),
    )


def _contributions(
    slabs: Sequence[_SlabReading],
    emission: Spectrum | None,
    transmittance_sigma: float,
    n_sigma: float,
    relative_thickness_sigma: float,
) -> dict[str, float]:
    """Standard errors of the mean coefficient by origin, 1/cm."""
    alphas = np.array([slab.alpha_per_cm for slab in slabs])
    # what all readings share, and what every point has of its own
    shared = transmittance_sigma * float(np.mean([slab.by_transmittance for slab in slabs]))
    of_points = math.hypot(*(slab.points_sigma_per_cm for slab in slabs)) / len(slabs)
    contributions = {
        TRANSMITTANCE: math.hypot(shared, of_points),
        INDEX: n_sigma * abs(float(np.mean([slab.by_n for slab in slabs]))),
        THICKNESS: relative_thickness_sigma * max(float(alphas.mean()), 0.0),
    }
    if len(slabs) > 1:
        contributions[ORIENTATIONS] = float(alphas.std(ddof=1))
    means = [slab.mean for slab in slabs if slab.mean is not None]
    if means and emission is not None and emission.sigmas is not None:
        derivatives = np.mean([mean.emission_derivatives for mean in means], axis=0)
        contributions[EMISSION] = float(np.linalg.norm(derivatives * emission.sigmas))
    return contributions


def _notes_on_errors(
    slabs: Sequence[_SlabReading], readings_sigma: float, part_per_cm: float, sigma_per_cm: float
) -> list[str]:
    """What the error of the transmittance, `part_per_cm` of the coefficient's, does not hold."""
    if not part_per_cm > 0:
        return [
            "the transmittance comes without errors: none of it is counted; state the one that all "
            "readings share (transmittance_sigma, --sigma)"
        ]
    shared_per_cm = float(np.mean([slab.points_shared_per_cm for slab in slabs]))
    whole = math.sqrt(sigma_per_cm**2 + max(shared_per_cm**2 - part_per_cm**2, 0.0))
    if readings_sigma > 0 or whole < (1 + _WORTH_SAYING) * sigma_per_cm:
        return []
    return [
        f"errors of the transmittance's points are taken as independent, {part_per_cm:.2g} /cm "
        f"together; if all points share them they are worth {shared_per_cm:.2g} /cm: then state "
        "that as the error of all readings (transmittance_sigma, --sigma)"
    ]


def _held(slabs: Sequence[_SlabReading], sigma: float) -> tuple[float, list[str]]:
    """The mean coefficient, 0 at least, and a note if it was held there; refused far below 0."""
    alpha = float(np.mean([slab.alpha_per_cm for slab in slabs]))
    if alpha >= -_ROUNDING:
        return max(alpha, 0.0), []
    worst = min(slabs, key=lambda slab: slab.alpha_per_cm)
    if -alpha > _CLEARLY_ABOVE * sigma:
        mend = "check the index and the 100 % line, or give the errors of reading and index"
        raise InputError(worst.highest, mend, path=worst.name or None)
    return 0.0, [
        f"{worst.highest}, within its error: the coefficient is held at 0, and its error is one "
        "upwards"
    ]


def _refuse_numbers(
    numbers: Sequence[float],
    thickness_mm: float,
    sigma: float,
    n_sigma: float,
    thickness_sigma_mm: float,
) -> None:
    """Refuse transmittances, a thickness or errors that no measurement can have."""
    for value in numbers:
        if not 0 < value <= 1:
            percent, mend = 1 < value <= 100, f"write {value / 100:g} for {value:g} %"
            problem = f"the transmittance {value:g} is not between 0 and 1"
            raise InputError(problem, mend if percent else "give a fraction: 0.76 for 76 %")
    if not (thickness_mm > 0 and math.isfinite(thickness_mm)):
        raise InputError(f"the thickness is {thickness_mm:g} mm", "give one above 0, in mm")
    for what, error, most in (
        ("transmittance", sigma, LARGEST_SIGMA),
        ("index", n_sigma, 1.0),
        ("thickness", thickness_sigma_mm, thickness_mm),
    ):
        if not 0 <= error < most:
            example = ": 0.005 for 0.5 %" if what == "transmittance" else ""
            mend = f"give 0 or more, below {most:g}{example}"
            raise InputError(f"the error of the {what} is {error:g}", mend)
    for value in numbers:
        if value <= sigma:
            problem = f"the transmittance {value:g} is not above its error {sigma:g}"
            raise InputError(problem, "measure a thinner sample")
