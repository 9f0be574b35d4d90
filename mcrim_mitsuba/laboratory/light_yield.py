"""Detector efficiency (Eq. 3) and absolute light yield: by itself (Eq. 2) or a reference (Eq. 7).

Equations of Alenkov et al., JINST 8 P06002. Every argument is a plain number or an
`Uncertain`; errors of one origin are shared by whatever has them, all others are independent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import PER_KEV, YIELDS_PER_KEV
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable, read_toml
from mcrim_mitsuba.laboratory.error_budget import Uncertain, quotient
from mcrim_mitsuba.optics import spectrum
from mcrim_mitsuba.optics.spectrum import Spectrum, WeightedMean

#: Relative error of a tube's quantum efficiency, common to all wavelengths (article, Sec. 4).
TUBE_SCALE_SIGMA = 0.05
SCALE = "tube scale"
CURVE = "quantum efficiency curve"
EMISSION = "emission spectrum"
#: Relative: what errors that the points share would have to add before it is said.
_WORTH_SAYING = 0.01


# Said of a curve whose points have no errors, and if these are not independent.
_ON_POINTS = {
    "emission": (
        "the emission spectrum comes without errors: none is counted",
        "if they are those of a correction that runs over the band they are worth up to {}: then "
        "add these to the tube's scale in quadrature",
    ),
    "quantum efficiency": (
        "the quantum efficiency comes without errors of its points: none is counted besides the "
        "tube's scale",
        "if all points share them they are worth {}: then count them in the tube's scale instead",
    ),
}


@dataclass(frozen=True, eq=False)
class DetectorEfficiency:
    """Emission-weighted detector efficiency, and the curves that it was made of."""

    #: A fraction.
    value: float
    #: Standard errors of the value by origin: ``tube scale``, and where the points of a table
    #: have errors ``quantum efficiency curve`` and ``emission spectrum``.
    contributions: dict[str, float]
    #: All of them in quadrature.
    sigma: float
    #: Standard deviation of the quantum efficiency over the emission; no error of the mean.
    spread: float
    _: KW_ONLY
    emission: Spectrum
    quantum_efficiency: Spectrum
    #: With the derivatives by every point.
    mean: WeightedMean
    #: What the reader must know before using the number.
    notes: tuple[str, ...]

    @property
    def light(self) -> Spectrum:
        """The emission as the detector sees it."""
        return spectrum.detected_light(self.emission, self.quantum_efficiency)


def detector_efficiency(
    emission: Spectrum, quantum_efficiency: Spectrum, scale_sigma: float = TUBE_SCALE_SIGMA
) -> DetectorEfficiency:
    """Quantum efficiency, in fractions, weighted with the emission spectrum (Eq. 3).

    The emission is photons (or counts corrected for the spectrometer) per nm, in any unit;
    `scale_sigma` is the relative standard error that all points of the quantum efficiency share:
    tubes of one type differ, and so do calibrations.

    Raises InputError if the curve does not cover the emission, the emission has no area, or the
    error is no fraction.
    """
    if not 0 <= scale_sigma < 1:
        problem = f"the tube's scale error is {scale_sigma:g}"
        raise InputError(problem, "give a relative error: 0.05 for 5 %")
    mean = spectrum.weighted_mean(emission, quantum_efficiency, "the quantum efficiency")
    if not mean.value > 0:
        problem = "the quantum efficiency is 0 wherever the crystal emits"
        raise quantum_efficiency.refusal(problem, "check both tables")
    parts = {
        SCALE: scale_sigma * mean.value,
        CURVE: mean.quantity_sigma,
        EMISSION: mean.emission_sigma,
    }
    contributions = {origin: sigma for origin, sigma in parts.items() if sigma is not None}
    points = {
        "emission": (emission, mean.emission_sigma, mean.emission_derivatives),
        "quantum efficiency": (quantum_efficiency, mean.quantity_sigma, mean.quantity_derivatives),
    }
    cut_off = spectrum.cut_off_note(emission)
    notes = [*emission.notes, *quantum_efficiency.notes, *mean.notes, cut_off]
    notes += [_note_on_points(what, mean.value, *of_curve) for what, of_curve in points.items()]
    return DetectorEfficiency(
        value=mean.value,
        contributions=contributions,
        sigma=math.hypot(*contributions.values()),
        spread=mean.spread,
        emission=emission,
        quantum_efficiency=quantum_efficiency,
        mean=mean,
        notes=tuple(filter(None, notes)),
    )


def _note_on_points(
    what: str, value: float, curve: Spectrum, independent: float | None, derivatives: Array
) -> str | None:
    """What is not counted where the errors of a curve's points are unknown, or not independent."""
    no_errors, if_not_independent = _ON_POINTS[what]
    if curve.sigmas is None or independent is None:
        return no_errors
    # what all points of an emission share cancels: the worst there changes sign in the middle
    worst = float(np.abs(derivatives) @ curve.sigmas)
    if worst - independent <= _WORTH_SAYING * value:
        return None
    together, shared = (f"{100 * sigma / value:.2g} %" for sigma in (independent, worst))
    assumed = f"errors of the {what}'s points are taken as independent, {together} together"
    return f"{assumed}; {if_not_independent.format(shared)}"


def light_yield_ph_per_keV(
    signal: Uncertain | float,
    eta: Uncertain | float,
    detector_efficiency: Uncertain | float,
    energy_keV: Uncertain | float,
) -> Uncertain:
    """Eqs. 1 and 2 solved for the yield: Y = N / (epsilon eta E).

    Yields from several couplings that were given the same origins (`detector_efficiency`, what
    the efficiencies have in common) combine with `common_value`.

    The signal N is in photoelectrons (counted photons) per event, efficiencies are fractions.

    Raises InputError if an argument is not above 0.
    """
    below = [("detector efficiency", detector_efficiency), ("light collection efficiency", eta)]
    return quotient(above=[("signal", signal)], below=[*below, ("energy", energy_keV)])


def fired_cells(
    crosstalk: float, crosstalk_sigma: float, afterpulsing: float, afterpulsing_sigma: float
) -> tuple[float, float]:
    """Cells of a silicon photomultiplier that fire for each photoelectron, and the relative error.

    `crosstalk` is the probability p that a cell fires others at once, of dark counts those above
    1.5 over all above 0.5 photoelectrons. These fire others in turn: a branching Poisson process
    of 1/(1 - m) cells on average, m = -ln(1 - p) (S. Vinogradov, Nucl. Instrum. Meth. A 695 (2012)
    247). `afterpulsing` is the mean number of pulses that follow each, within the integration.
    """
    follow = -math.log1p(-crosstalk)
    of_crosstalk = crosstalk_sigma / ((1.0 - crosstalk) * (1.0 - follow))
    relative = math.hypot(of_crosstalk, afterpulsing_sigma / (1.0 + afterpulsing))
    return (1.0 + afterpulsing) / (1.0 - follow), relative


def light_yield_by_reference(
    signal: Uncertain | float,
    eta: Uncertain | float,
    detector_efficiency: Uncertain | float,
    reference_signal: Uncertain | float,
    reference_eta: Uncertain | float,
    reference_efficiency: Uncertain | float,
    reference_yield: Uncertain | float,
) -> Uncertain:
    """Eq. 7, the relative method: a sample against a scintillator of known yield.

    Both are measured at the same energy, which cancels, and so do the errors that sample and
    reference have in common: the tube's scale in both detector efficiencies, the bench's geometry
    in both light collection efficiencies. Arguments are those of `light_yield_ph_per_keV`, first of
    the sample and then of the reference; the yield has the unit of `reference_yield`.

    Raises InputError if an argument is not above 0.
    """
    return quotient(
        above=[
            ("signal", signal),
            ("reference's detector efficiency", reference_efficiency),
            ("reference's light collection efficiency", reference_eta),
            ("reference's light yield", reference_yield),
        ],
        below=[
            ("reference's signal", reference_signal),
            ("detector efficiency", detector_efficiency),
            ("light collection efficiency", eta),
        ],
    )


#: Quantities that sample and reference both have, and the origin of their own errors.
QUANTITIES = {"signal": "counts", "eta": "eta", "detector_efficiency": "detector_efficiency"}

# Relative: a shared error that is typed as the whole one may differ from it by this.
_ROUNDING = 1e-9


def _own_part(value: float, sigma: float, shared: float) -> float | None:
    """What is left of an error without its shared part, a relative one; None if that is larger."""
    common = shared * value
    return None if common > sigma * (1 + _ROUNDING) else math.sqrt(max(sigma**2 - common**2, 0.0))


def _known(
    number: tuple[float, float], origin: str, whose: str, quantity: str, shared: float
) -> Uncertain:
    """A crystal's quantity with its own error and the one that the other crystal has too."""
    value, sigma = number
    alone = _own_part(value, sigma, shared)
    if alone is None:
        raise ValueError(f"the shared error of {quantity} is larger than that of the {whose}")
    errors = {f"{origin}, {whose}": alone} if alone else {}
    common = {f"{quantity}, shared": shared * value} if shared else {}
    if quantity == "signal":
        return Uncertain(value, errors, common)
    return Uncertain(value, systematic=errors | common)


SAMPLE = "sample"
REFERENCE = "reference"
SHARED = "shared"
_YIELD = "light_yield_ph_per_keV"
_FRACTIONS = ("eta", "detector_efficiency")
_EXAMPLE = {"signal": "14.3", "eta": "0.25", "detector_efficiency": "0.127", _YIELD: "16.2"}


@dataclass(frozen=True)
class RelativeMeasurement:
    """Two crystals on one bench with one source, and the light yield of the sample by Eq. 7."""

    #: Value and standard error of every one of `QUANTITIES`: ``signal`` (photons per event),
    #: ``eta`` and ``detector_efficiency`` (fractions).
    sample: Mapping[str, tuple[float, float]]
    reference: Mapping[str, tuple[float, float]]
    #: Light yield of the reference and its standard error, photons per keV.
    reference_yield: tuple[float, float]
    #: Relative standard errors by quantity. They move both crystals' by the same factor, and are
    #: parts of the errors above, not on top of them.
    shared: Mapping[str, float]

    @property
    def light_yield(self) -> Uncertain:
        """Photons per keV.

        Origins are ``counts``, ``eta`` and ``detector_efficiency`` with whose they are (``sample``,
        ``reference``, or ``shared``: these cancel), and ``reference light yield``.

        Raises InputError if a value is not above 0; ValueError if a shared error is larger than
        that of a crystal.
        """
        crystals = [
            _known(crystal[name], origin, whose, name, self.shared.get(name, 0.0))
            for crystal, whose in ((self.sample, SAMPLE), (self.reference, REFERENCE))
            for name, origin in QUANTITIES.items()
        ]
        value, sigma = self.reference_yield
        crystals.append(Uncertain(value, systematic={"reference light yield": sigma}))
        return light_yield_by_reference(*crystals)

    @property
    def uncorrelated(self) -> Uncertain:
        """`light_yield` with the errors that follow if nothing is taken to be shared."""
        return replace(self, shared={}).light_yield

    @property
    def equal_collection(self) -> float:
        """The yield if both light collection efficiencies were the same."""
        efficiency = self.sample["detector_efficiency"][0]
        return self.signals_alone * self.reference["detector_efficiency"][0] / efficiency

    @property
    def signals_alone(self) -> float:
        """The yield if the detector efficiencies were the same as well."""
        return self.reference_yield[0] * self.sample["signal"][0] / self.reference["signal"][0]


def read_comparison(path: str | Path) -> RelativeMeasurement:
    """Read and check the file of a relative measurement.

    TOML with the tables ``[sample]`` and ``[reference]`` (``signal``, ``eta`` and
    ``detector_efficiency``, each with its ``_sigma``; the reference also
    ``light_yield_ph_per_keV``) and, if errors are shared, ``[shared]``.

    Raises InputError, with file and line, if anything is missing, unknown or impossible.
    """
    document = read_toml(Path(path), "a relative measurement")
    document.table("", (SAMPLE, REFERENCE, SHARED))
    sample = _crystal(document, SAMPLE, tuple(QUANTITIES))
    reference = _crystal(document, REFERENCE, (*QUANTITIES, _YIELD))
    reference_yield = reference.pop(_YIELD)
    shared = _shared(document, {SAMPLE: sample, REFERENCE: reference})
    return RelativeMeasurement(sample, reference, reference_yield, shared)


def _crystal(
    document: TomlDocument, key: str, names: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    """Value and standard error of every quantity of one table."""
    if key not in document.content:
        mend = f"write it, with {', '.join(names)}"
        raise document.refusal("", f"there is no table [{key}]", mend)
    table = document.table(key, (*names, *(f"{name}_sigma" for name in names)))
    return {name: _with_error(table, name) for name in names}


def _with_error(table: TomlTable, name: str) -> tuple[float, float]:
    """A quantity above 0 and its standard error, which must be there too."""
    sigma_name = f"{name}_sigma"
    value, sigma = table.number(name), table.number(sigma_name)
    if value is None:
        mend = f"write one, such as {name} = {_EXAMPLE[name]}"
        raise table.refusal("", f"[{table.key}] has no {name}", mend)
    given = f"{name} = {value:g}"
    if value <= 0:
        raise table.refusal(name, given, "give a number above 0")
    if name == _YIELD and value > YIELDS_PER_KEV[1]:
        raise table.refusal(name, given, PER_KEV)
    if name in _FRACTIONS and value > 1:
        raise table.refusal(name, f"{given} is above 1", "give a fraction: 0.25 for 25 %")
    if sigma is None:
        mend = f"write {sigma_name}, in the unit of {name}"
        raise table.refusal(name, f"{name} has no error", mend)
    if not 0 <= sigma < value:
        mend = "errors are propagated to first order: give one from 0 to well below the value"
        raise table.refusal(sigma_name, f"{sigma_name} = {sigma:g} at {given}", mend)
    return value, sigma


def _shared(
    document: TomlDocument, crystals: dict[str, dict[str, tuple[float, float]]]
) -> dict[str, float]:
    """Relative errors in common, none larger than what a crystal has."""
    shared = {}
    table = document.table(SHARED, tuple(QUANTITIES))
    for name in table:
        part = table.known_number(name)
        if part < 0:
            raise table.refusal(name, f"{name} = {part:g}", "give a relative error: 0.05 for 5 %")
        for whose, crystal in crystals.items():
            value, sigma = crystal[name]
            if _own_part(value, sigma, part) is None:
                whole = f"the {whose}'s own, {sigma / value:.3g} of its {name}"
                problem = f"the shared error {name} = {part:g} is larger than {whole}"
                mend = "shared errors are parts of those of both crystals, as fractions"
                raise table.refusal(name, problem, mend)
        shared[name] = part
    return shared
