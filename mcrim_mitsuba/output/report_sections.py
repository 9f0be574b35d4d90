"""What a report tells: everything measured, fitted and drawn, before it becomes a page."""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, SAMPLE, Reading
from mcrim_mitsuba.campaign.reduction import LIMIT_MB, RawFile
from mcrim_mitsuba.core.files import attributes, json_text, read_bytes, sha256
from mcrim_mitsuba.core.numbers import ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.effect import modules_of
from mcrim_mitsuba.efficiency.lighting import Light, follow_light
from mcrim_mitsuba.inference import repair
from mcrim_mitsuba.inference.budget import errors_of
from mcrim_mitsuba.inference.corrections import fitted
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.next_measurements import READING, NextMeasurement
from mcrim_mitsuba.inference.profiles import Profile
from mcrim_mitsuba.output import photograph
from mcrim_mitsuba.output.cross_section import cross_section_figure
from mcrim_mitsuba.output.registry import encoded, fields_of
from mcrim_mitsuba.output.sentences import errors_apart, headline, leading_candidates
from mcrim_mitsuba.runs.cache import RecordCache, code_hash, record_versions
from mcrim_mitsuba.runs.cache_files import Chunk
from mcrim_mitsuba.scene.check_text import CheckReport
from mcrim_mitsuba.scene.scene_file import DefaultParameter, SceneFile
from mcrim_mitsuba.transport.check import check_simulation, interfaces_of
from mcrim_mitsuba.transport.simulation import Simulation

#: Configurations whose light is followed.
MOST_LIGHTS = 4
#: Photons of each.
LIGHT_PHOTONS = 400_000
_COUPLING = "n_gap"

Stage = Callable[[str], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Sections(repair.Repaired):
    """A campaign from its readings to its result: what was found, and what was done about it."""

    #: Of every reading's configuration.
    efficiencies: tuple[Efficiency, ...]
    profiles: tuple[Profile, ...]
    ratio: RatioOfSignals | None
    #: With the effects that were added.
    bench: BenchDescription
    #: The first of the measurements that are proposed for which something is built, and its bench;
    #: None where nothing is, or where it was drawn before.
    to_build: NextMeasurement | None
    next_bench: Figure | None
    #: Where the pictures are kept, and these where they were drawn before: then no light is
    #: followed, and no cross-section and no photograph is made.
    album: RecordCache
    drawn: Chunk | None
    #: Of the couplings, by the label of a reading.
    lights: tuple[tuple[str, Light], ...]
    #: The files, as they were read.
    sources: tuple[SourceFile, ...]
    #: Campaign and scene with the effects that were added; none where none was.
    mended: tuple[SourceFile, ...]
    #: What makes this report again.
    command: str
    #: In UTC.
    made: datetime
    #: Whether the effects are the user's choice.
    chosen_by_hand: bool

    @property
    def campaign(self) -> Campaign:
        """As it came."""
        return self.simulations.campaign

    @property
    def headline(self) -> str:
        """The verdict in a sentence."""
        leading = leading_candidates(self.diagnosis)
        is_first = bool(leading) and leading[0].effects == self.effects
        return headline(self.diagnosis, self.fit if is_first else None)

    def numbers(self) -> dict[str, Any]:
        """The result for JSON."""
        result = {}
        for name, estimate in self.fit.parameters.items():
            errors = zip(("statistical", "systematic"), errors_apart(estimate), strict=True)
            whole = attributes(estimate, "total=sigma lower upper at_bound contributions")
            result[name] = {"name": name, "value": estimate.value, **dict(errors), **whole}
        return {
            "result": result,
            "efficiencies": self.efficiencies,
            "effects": list(self.effects),
            "calibration": self.fit.numbers(),
            "files": {str(source.path): source.sha256 for source in self.sources},
            "command": self.command,
            "made": self.made.isoformat(timespec="seconds"),
        }


def gather(
    repaired: repair.Repaired, *, command: str, made: datetime, chosen_by_hand: bool, stage: Stage
) -> Sections:
    """Gather what a report tells of a mended campaign; ``stage(what)`` is called on the way.

    Raises InputError if a file cannot be read any more, or the scene with the effects is not sound.
    """
    calibration = repaired.fit
    campaign, run = repaired.simulations.campaign, repaired.simulations.run
    # at the fitted values, with all effects in it that are not of the readings
    catalogue = campaign.catalogue
    lacking = [name for name in campaign.effects if not catalogue[name].is_in(campaign.scene)]
    values = {name: estimate.value for name, estimate in calibration.parameters.items()}
    values = {**calibration.fixed, **values}
    scene = repair.mended_scene(campaign, (*lacking, *repaired.effects), values)
    stage("profile likelihoods")
    profiles = calibration.profiles
    stage("picture of the bench")
    couplings = _couplings(campaign)
    sources = sources_of(campaign)
    album = RecordCache(_behind_pictures(repaired, sources, chosen_by_hand))
    drawn = album.read(0)
    with_effects = campaign.with_effects(repaired.effects)
    # in the coupling of the highest index: a filled gap shows what may be in it
    bench = describe(with_effects, scene, couplings[-1], run, draw=drawn is None)
    of_light = (
        new
        for new in repaired.diagnosis.next_measurements
        if new.kind.split(" + ")[0] == READING and new.parameters.get(KIND, LIGHT) == LIGHT
    )
    to_build = next(of_light, None)
    next_bench = None
    if to_build and drawn is None:  # nobody builds what is suspected
        next_bench = _drawn(repair.mended_scene(campaign, lacking, values), to_build, run)
    return Sections(
        **fields_of(repaired),
        efficiencies=efficiencies(calibration),
        profiles=profiles,
        ratio=ratio_curve(calibration),
        bench=bench,
        to_build=to_build,
        next_bench=next_bench,
        album=album,
        drawn=drawn,
        lights=_lights(couplings, scene, run, stage) if drawn is None else (),
        sources=sources,
        mended=_mended(campaign, repaired),
        command=command,
        made=made,
        chosen_by_hand=chosen_by_hand,
    )


def _behind_pictures(
    repaired: repair.Repaired, sources: Sequence[SourceFile], chosen_by_hand: bool
) -> dict[str, object]:
    """All that the pictures depend on, as a cache's key."""
    run = repaired.simulations.run
    numbers = {
        # how long it took is in no picture
        "diagnosis": encoded(replace(repaired.diagnosis, seconds=0.0)),
        "calibration": repaired.fit.numbers(),
    }
    return {
        "what": "pictures of a report",
        "files": [[source.role, source.path.name, source.sha256] for source in sources],
        "told": sha256(json_text(numbers).encode()),
        "effects": [*repaired.effects, chosen_by_hand],
        "light_photons": LIGHT_PHOTONS,
        "seed": run.seed,
        # of the module that draws them, and of the figures that it imports
        "versions": record_versions(run.variant, f"{__package__}.report"),
        "code": code_hash(modules_of(repaired.simulations.campaign.catalogue.values())),
    }


def _drawn(scene: SceneFile, proposal: NextMeasurement, run: Run) -> Figure:
    """The bench of a proposed reading."""
    simulation = Simulation(scene, proposal.parameters, variant=run.variant, threads=run.threads)
    interfaces = interfaces_of(simulation.file, simulation.model)
    return cross_section_figure(simulation, interfaces, brief=True)


def _lights(
    couplings: Sequence[Reading], scene: SceneFile, run: Run, stage: Stage
) -> tuple[tuple[str, Light], ...]:
    """Where the light of each coupling goes, by the label of a reading."""
    lights, run = [], replace(run, photons=LIGHT_PHOTONS, progress=None)
    for reading in couplings:
        stage("where the light goes")
        simulation = Simulation(scene, reading.parameters, variant=run.variant, threads=run.threads)
        lights.append((reading.label, follow_light(simulation, run=run)))
    return tuple(lights)


def _couplings(campaign: Campaign) -> list[Reading]:
    """First readings of couplings from the lowest index to the highest, at most `MOST_LIGHTS`."""
    nominal, in_use = campaign.scene.parameters.get(_COUPLING), campaign.measurements.in_use
    first: dict[object, Reading] = {}
    for reading in [reading for reading in in_use if not reading.of_beam] or in_use:
        first.setdefault(reading.parameters.get(_COUPLING, nominal), reading)
    # the index is None in scenes that do not have it as a parameter
    ordered = [first[index] for index in sorted(first, key=lambda i: (i is None, i))]
    # both ends and what lies evenly between
    places = np.linspace(0, len(ordered) - 1, min(MOST_LIGHTS, len(ordered)))
    return [ordered[place] for place in places.round().astype(int)]


def _mended(campaign: Campaign, repaired: repair.Repaired) -> tuple[SourceFile, ...]:
    """Campaign and scene with the effects that were added, as changes of the files; or none."""
    if not repaired.effects:
        return ()
    target = campaign.path.with_name(f"{campaign.path.stem}_mended.toml")
    remarks = repair.remarks_on(repaired.diagnosis, repaired.effects)
    scene, text = repair.mended_files(campaign, repaired.fit, target, remarks)
    old, name = campaign.scene, target.with_suffix(".xml").name
    bench = changed("scene", old.path.name, repair.scene_text(old), name, repair.scene_text(scene))
    return changed("campaign", campaign.path.name, campaign.text, target.name, text), bench


# The ratio of two signals, and the efficiency of every reading.

_POINTS = 120
#: How far from the solution curves are drawn, as a factor.
_REACH = 30.0


@dataclass(frozen=True, eq=False, kw_only=True)
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


def ratio_curve(fit: Calibration) -> RatioOfSignals | None:
    """The curve of a fit; None where alpha_scat is not fitted or only one coupling was measured."""
    model = fit.model
    pair = _pair(model.campaign)
    if pair is None or ALPHA_SCAT not in fit.names:
        return None
    first, second = pair
    rows = [model.campaign.measurements.readings.index(reading) for reading in pair]
    index = fit.names.index(ALPHA_SCAT)
    theta = fit.theta.copy()
    solution, bounds = float(theta[index]), model.free[index]
    low, high = max(solution / _REACH, bounds.minimum), min(solution * _REACH, bounds.maximum)
    if not 0 < low < high:  # the fit ended at 0
        return None
    alphas, predictions = np.geomspace(low, high, _POINTS), []
    for alpha in alphas:
        theta[index] = alpha
        predictions.append(model.predict(theta))
    signals = np.array([prediction.signal[rows] for prediction in predictions])
    measured = second.signal / first.signal
    relative_sigma = math.hypot(first.sigma / first.signal, second.sigma / second.signal)
    return RatioOfSignals(
        labels=(first.label, second.label),
        alpha_scat_per_cm=alphas,
        eta=np.array([prediction.eta[rows] for prediction in predictions]),
        ratio=signals[:, 1] / signals[:, 0],
        measured=measured,
        measured_sigma=measured * relative_sigma,
        solution_per_cm=solution,
    )


def _pair(campaign: Campaign) -> tuple[Reading, Reading] | None:
    """The readings of lowest and highest index in the gap among those that differ in it only."""
    nominal = campaign.scene.parameters
    if _COUPLING not in nominal:
        return None

    def index(reading: Reading) -> float:
        return float(reading.parameters.get(_COUPLING, nominal[_COUPLING]))

    def all_else(reading: Reading) -> dict:
        return {**nominal, **reading.parameters, _COUPLING: None, SAMPLE: reading.sample}

    light = [
        reading
        for reading in campaign.measurements.in_use
        if not reading.of_beam and campaign.parameter_of(reading, ALPHA_SCAT) == ALPHA_SCAT
    ]
    pairs = (sorted(p, key=index) for p in itertools.combinations(light, 2))
    alike = [(a, b) for a, b in pairs if index(b) > index(a) and all_else(a) == all_else(b)]
    return max(alike, key=lambda pair: index(pair[1]) - index(pair[0]), default=None)


@dataclass(frozen=True)
class Efficiency:
    """The light collection efficiency of one reading's configuration."""

    label: str
    #: What differs from reading to reading, by column.
    parameters: dict[str, Value]
    #: Fraction of the light that is detected, with the error of all origins.
    eta: float
    sigma: float


def efficiencies(fit: Calibration) -> tuple[Efficiency, ...]:
    """The efficiency of every reading, its error that of `budget`."""
    # parameters are before, and the ratio of two readings after those of readings
    sigmas = errors_of(fit, fitted(fit))[len(fit.names) :][: len(fit.rows)].tolist()
    pairs = zip(fit.rows, sigmas, strict=True)
    return tuple(Efficiency(row.label, row.parameters, row.eta, sigma) for row, sigma in pairs)


# Files that a report has inside, as they were read.

#: Bytes of all files together that a report has inside: it must stay easy to mail.
MOST_BYTES = 1_000_000
#: Characters that are shown of a file.
MOST_CHARACTERS = 100_000
#: Characters that are shown of one with raw data, such as a list of events.
MOST_OF_RAW_DATA = 4_000
#: Lines around a change that are shown with it.
_AROUND = 1
_LIMIT_MB = 10


@dataclass(frozen=True, kw_only=True)
class SourceFile(RawFile):
    """A file that a report has inside."""

    #: None where the report has no room for them.
    data: bytes | None
    #: What is shown: what it holds, its beginning, or what was changed in it.
    text: str
    #: Characters that are not in `text`.
    left_out: int = 0


def sources_of(campaign: Campaign) -> tuple[SourceFile, ...]:
    """The campaign, its measurements, its scene with what that includes, own effects, raw data.

    Of raw data the beginning alone is shown. Files for which there is no more room have no data.

    Raises InputError if a file cannot be read any more.
    """
    scene, folder = campaign.scene, campaign.effects_folder
    files = [("campaign", campaign.path), ("measurements", campaign.measurements.path)]
    files.append(("scene", scene.path))
    files += [("included by the scene", path) for path in scene.included]
    if campaign.spectrum is not None:
        files.append(("light over wavelengths", campaign.spectrum.path))
    files += [("own effect", path) for path in (sorted(folder.glob("*.py")) if folder else ())]
    raw = () if campaign.raw is None else campaign.raw.files
    limits = [(MOST_CHARACTERS, _LIMIT_MB)] * len(files) + [(MOST_OF_RAW_DATA, LIMIT_MB)] * len(raw)
    files += [(file.role, file.path) for file in raw]
    sources, room = [], MOST_BYTES
    for (role, path), (most, limit_mb) in zip(files, limits, strict=True):
        data = scene.source(path) if path in scene.included else read_bytes(path, limit_mb)
        text = data.decode("utf-8-sig", errors="replace")
        text = text.replace("\r\n", "\n").replace("\r", "\n")
        kept = data if len(data) <= room else None
        room -= len(kept or b"")
        shown: dict[str, Any] = {"text": text[:most], "left_out": max(len(text) - most, 0)}
        sources.append(SourceFile(role=role, path=path, sha256=sha256(data), data=kept, **shown))
    return tuple(sources)


def changed(role: str, name: str, before: str, new_name: str, after: str) -> SourceFile:
    """A mended file, of whose text is shown what tells it from the one before."""
    texts = before.splitlines(), after.splitlines()
    lines = difflib.unified_diff(*texts, name, new_name, n=_AROUND, lineterm="")
    data, path, text = after.encode(), Path(new_name), "\n".join(lines)
    return SourceFile(role=f"mended {role}", path=path, sha256=sha256(data), data=data, text=text)


# The bench: what it is made of, its parameters, its cross-section and picture.

#: Size of the picture over that of `mcrim render`: enough for a printed page.
PICTURE_SCALE = 0.8


@dataclass(frozen=True, eq=False, kw_only=True)
class BenchDescription:
    """The bench that the result belongs to."""

    #: What the scene means.
    report: CheckReport
    #: Of every scene parameter its name, value (as fitted, where it was), default as it is
    #: written, and role: ``fitted``, ``held``, ``differs from reading to reading`` or none.
    parameters: tuple[tuple[str, Value, DefaultParameter, str], ...]
    #: Label of the reading whose configuration is drawn.
    reading: str
    #: Of this configuration; None where they were drawn before.
    cross_section: Figure | None
    photograph: photograph.Photograph | None


def describe(
    campaign: Campaign, scene: SceneFile, reading: Reading, run: Run, *, draw: bool
) -> BenchDescription:
    """What a scene means, its parameters, and if `draw` its cross-section and photograph.

    The campaign has the effects that the result has, and so has the scene, at the fitted values;
    the configuration of the reading is drawn.

    Raises InputError if the scene is not sound.
    """
    drawn = scene.with_overrides(reading.parameters)
    simulation = Simulation(drawn, variant=run.variant, threads=run.threads, check=False)
    report = check_simulation(simulation, light=False)
    if report.problems:
        raise report.problems[0].error()
    roles = dict.fromkeys(campaign.varied, "differs from reading to reading") | {
        name: "held" if parameter.fixed else "fitted"
        for name, parameter in campaign.parameters.items()
    }
    roles |= {name: f"as {leader}" for name, leader in campaign.ties.items()}
    # drawn in another process while what follows is made
    picture = photograph.begin_photograph(drawn, run, PICTURE_SCALE) if draw else None
    return BenchDescription(
        report=report,
        parameters=tuple(
            (name, value, scene.defaults[name], roles.get(name, ""))
            for name, value in scene.parameters.items()
        ),
        reading=reading.label,
        cross_section=cross_section_figure(simulation, report.interfaces) if draw else None,
        photograph=picture,
    )
