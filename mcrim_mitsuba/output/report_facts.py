"""Facts of a report: the ratio of two signals, what is quoted with its errors, files, the bench."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.reduction import LIMIT_MB
from mcrim_mitsuba.core.files import read_bytes
from mcrim_mitsuba.core.numbers import ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.estimates import ParameterEstimate
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.output import photographer
from mcrim_mitsuba.scene.check_text import Interface
from mcrim_mitsuba.scene.scene_file import SceneFile

_COUPLING = "n_gap"
_POINTS = 120
#: How far from the solution curves are drawn, as a factor.
_REACH = 30.0


@dataclass(frozen=True, eq=False)
class RatioOfSignals:
    """Two configurations that differ in their coupling only, against scattering."""

    #: The one of lower index first.
    labels: tuple[str, str]
    #: (points,) float64
    alpha_scat_per_cm: NDArray[np.float64]
    #: (points, 2) float64: All other parameters at the solution.
    eta: NDArray[np.float64]
    #: (points,) float64: Second signal over first.
    ratio: NDArray[np.float64]
    measured: float
    measured_sigma: float
    #: Fitted alpha_scat.
    solution_per_cm: float


def ratio_curve(model: ResponseModel, calibration: Calibration) -> RatioOfSignals | None:
    """The curve of a fit; None where alpha_scat is not fitted or only one coupling was measured."""
    pair = _pair(model.campaign)
    if pair is None or ALPHA_SCAT not in calibration.names:
        return None
    readings = model.campaign.measurements.readings
    rows = [readings.index(reading) for reading in pair]
    index = calibration.names.index(ALPHA_SCAT)
    theta = np.array([calibration.parameters[name].value for name in calibration.names])
    solution, known = float(theta[index]), model.free[index]
    low, high = max(solution / _REACH, known.minimum), min(solution * _REACH, known.maximum)
    if not 0 < low < high:
        return None
    alphas, eta, signals = np.geomspace(low, high, _POINTS), [], []
    for alpha in alphas:
        theta[index] = alpha
        prediction = model.predict(theta)
        eta.append(prediction.eta[rows])
        signals.append(prediction.signal[rows])
    first, second = pair
    measured = second.signal / first.signal
    return RatioOfSignals(
        labels=(first.label, second.label),
        alpha_scat_per_cm=alphas,
        eta=np.array(eta),
        ratio=np.array([s[1] / s[0] for s in signals]),
        measured=measured,
        measured_sigma=measured
        * math.hypot(first.sigma / first.signal, second.sigma / second.signal),
        solution_per_cm=solution,
    )


def _pair(campaign: Campaign) -> tuple[Reading, Reading] | None:
    """The readings of lowest and highest index in the gap among those that differ in it only."""
    nominal = campaign.scene.parameters

    def elsewhere(reading: Reading) -> dict:
        return {n: v for n, v in {**nominal, **reading.parameters}.items() if n != _COUPLING}

    if _COUPLING not in nominal:
        return None
    best, widest = None, 0.0
    for pair in itertools.combinations(campaign.measurements.in_use, 2):
        first, second = sorted(
            pair, key=lambda r: float(r.parameters.get(_COUPLING, nominal[_COUPLING]))
        )
        low, high = (
            float(r.parameters.get(_COUPLING, nominal[_COUPLING])) for r in (first, second)
        )
        if high - low > widest and elsewhere(first) == elsewhere(second):
            best, widest = (first, second), high - low
    return best


# What is quoted, its errors apart, and the efficiency of every reading.

#: What repeating lowers, of the measurement or of the simulation; all else is systematic.
STATISTICAL = ("statistical", "monte_carlo")


@dataclass(frozen=True)
class Quantity:
    """A fitted parameter with its errors apart, in the unit of its name."""

    name: str
    value: float
    #: Of the readings and of the simulation: repeating them lowers it.
    statistical: float
    #: Of what is known beforehand, and of the detector's efficiency.
    systematic: float
    #: Both in quadrature.
    total: float
    #: Ends of the 68.3 % interval by profile likelihood.
    lower: float | None
    upper: float | None
    #: ``min`` or ``max`` where the fit ended there: the errors are none then.
    at_bound: str | None
    #: By origin.
    contributions: dict[str, float]


@dataclass(frozen=True)
class Efficiency:
    """The light collection efficiency of one reading's configuration."""

    label: str
    #: What differs from reading to reading.
    parameters: dict[str, Value]
    #: Fraction of the light that is detected; the error is that of the fit and of the simulation.
    eta: float
    sigma: float


def quantities(calibration: Calibration) -> dict[str, Quantity]:
    """All fitted parameters and the light yield."""
    return {name: _quantity(name, known) for name, known in calibration.parameters.items()}


def _quantity(name: str, known: ParameterEstimate) -> Quantity:
    origins = known.contributions
    return Quantity(
        name=name,
        value=known.value,
        statistical=math.hypot(*(origins.get(origin, 0.0) for origin in STATISTICAL)),
        systematic=math.hypot(*(s for o, s in origins.items() if o not in STATISTICAL)),
        total=known.sigma,
        lower=known.lower,
        upper=known.upper,
        at_bound=known.at_bound,
        contributions=dict(origins),
    )


def efficiencies(model: ResponseModel, calibration: Calibration) -> tuple[Efficiency, ...]:
    """The efficiency of every reading, its error propagated from the fit."""
    theta = np.array([calibration.parameters[name].value for name in calibration.names])
    slopes = model.predict(theta).eta_slopes
    fitted = np.einsum("ri,ij,rj->r", slopes, calibration.covariance, slopes)
    return tuple(
        Efficiency(
            row.label,
            dict(reading.parameters),
            row.eta,
            math.sqrt(max(variance, 0.0) + row.eta_sigma**2),
        )
        for row, reading, variance in zip(calibration.rows, model.readings, fitted, strict=True)
    )


def to_json(found: Mapping[str, Quantity], of_readings: tuple[Efficiency, ...]) -> dict[str, Any]:
    """The same for JSON."""
    return {
        "result": found,
        "efficiencies": of_readings,
    }


# Files that a report shows in full, as they were read.

#: Characters of all files together that a report shows: it must stay easy to mail.
MOST_CHARACTERS = 250_000
#: Of one file with raw data: a list of events would fill hundreds of printed pages.
MOST_OF_RAW_DATA = 4_000
_LIMIT_MB = 10


@dataclass(frozen=True)
class SourceFile:
    """One file."""

    #: What it is for the campaign.
    role: str
    path: Path
    #: Of its bytes, hexadecimal.
    sha256: str
    #: What it holds, or its beginning.
    text: str
    #: Characters that are not in `text`.
    left_out: int


def sources_of(campaign: Campaign) -> tuple[SourceFile, ...]:
    """The campaign, its measurements, its scene with what that includes, own effects, raw data.

    Raises
    ------
    InputError
        If a file cannot be read any more.
    """
    scene, folder = campaign.scene, campaign.effects_folder
    found = [
        ("campaign", campaign.path, read_bytes(campaign.path, _LIMIT_MB)),
        (
            "measurements",
            campaign.measurements.path,
            read_bytes(campaign.measurements.path, _LIMIT_MB),
        ),
        ("scene", scene.path, scene.source(scene.path)),
        *(("included by the scene", path, scene.source(path)) for path in scene.included),
    ]
    if folder is not None:
        own = sorted(folder.glob("*.py"))
        found += [("own effect", path, read_bytes(path, _LIMIT_MB)) for path in own]
    sources, room = [], MOST_CHARACTERS
    for role, path, data in found:
        sources.append(source_of(role, path, data, room))
        room -= len(sources[-1].text)
    for file in () if campaign.raw is None else campaign.raw.files:
        data = read_bytes(file.path, LIMIT_MB)
        sources.append(source_of(file.role, file.path, data, min(room, MOST_OF_RAW_DATA)))
        room -= len(sources[-1].text)
    return tuple(sources)


def source_of(role: str, path: Path, data: bytes, room: int = MOST_CHARACTERS) -> SourceFile:
    """One file from its bytes, its text cut to so many characters."""
    text = data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    left_out = max(len(text) - max(room, 0), 0)
    return SourceFile(
        role, path, hashlib.sha256(data).hexdigest(), text[: len(text) - left_out], left_out
    )


# The bench: what it is made of, its parameters, its cross-section and picture.

#: Size of the picture over that of `mcrim render`: enough for a printed page.
PICTURE_SCALE = 0.8


@dataclass(frozen=True)
class BenchParameter:
    """One parameter of the scene."""

    name: str
    #: As fitted, where it was.
    value: Value
    unit: str | None
    #: The comment in the file, or empty.
    meaning: str
    #: ``fitted``, ``held``, ``differs from reading to reading`` or empty: the scene's value.
    role: str


@dataclass(frozen=True, eq=False)
class BenchDescription:
    """The bench that the result belongs to."""

    #: What the scene means.
    sentences: tuple[str, ...]
    faces: tuple[Interface, ...]
    parameters: tuple[BenchParameter, ...]
    cross_section: Figure
    #: Label of the reading whose configuration is drawn.
    reading: str
    #: Of this configuration.
    photograph: photographer.Photograph


def describe(campaign: Campaign, scene: SceneFile, reading: Reading, run: Run) -> BenchDescription:
    """Look at a scene.

    Parameters
    ----------
    campaign : Campaign
        With the effects that the result has.
    scene : SceneFile
        With these effects in it, at the fitted values.
    reading : Reading
        Whose configuration is drawn.
    run : Run

    Raises
    ------
    InputError
        If the scene is not sound.
    """
    from mcrim_mitsuba.output.cross_section import cross_section_figure
    from mcrim_mitsuba.transport.check import check_simulation
    from mcrim_mitsuba.transport.simulation import Simulation

    drawn = scene.with_overrides(reading.parameters)
    simulation = Simulation(drawn, variant=run.variant, threads=run.threads, check=False)
    report = check_simulation(simulation, light=False)
    if report.problems:
        raise report.problems[0].error()
    # drawn in another process while what follows is made
    photograph = photographer.photograph(drawn, run, PICTURE_SCALE)
    return BenchDescription(
        sentences=report.words,
        faces=report.interfaces,
        parameters=tuple(_parameter(campaign, scene, name) for name in scene.parameters),
        cross_section=cross_section_figure(simulation, report.interfaces),
        reading=reading.label,
        photograph=photograph,
    )


def _parameter(campaign: Campaign, scene: SceneFile, name: str) -> BenchParameter:
    role = ""
    if name in campaign.parameters:
        role = "held" if campaign.parameters[name].fixed else "fitted"
    elif name in campaign.measurements.columns:
        role = "differs from reading to reading"
    written = scene.defaults[name]
    return BenchParameter(name, scene.parameters[name], written.unit, written.comment, role)
