"""Several crystals in one campaign: what each has of its own, beside what they share.

A row of the measurement file may name a sample. ``[samples.NAME]`` says in what that crystal is
unlike the campaign's own one: scene parameters, coefficients, and its scale, which turns into its
light yield or comes from a known one. What is not named there is shared.
"""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from functools import partial

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.entries import SCALE, number_within
from mcrim_mitsuba.campaign.measurements import SAMPLE as COLUMN
from mcrim_mitsuba.campaign.measurements import Measurements, Reading
from mcrim_mitsuba.campaign.parameter import (
    CampaignParameter,
    LightYieldInput,
    read_detector,
    read_light_yield,
    read_parameter,
)
from mcrim_mitsuba.core.errors import did_you_mean, said_by
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value, judge, value_text
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.spectrophotometer import GAP_INDEX, spectrophotometer_of
from mcrim_mitsuba.scene.values import parse_like

#: Factor on the efficiencies of all samples, which one detector read.
EFFICIENCY_FACTOR = "efficiency_factor"
#: What a sample may have of its own.
_OWN = (ALPHA_SCAT, ALPHA_ABS, SCALE)
_UNITS = "_ph_per_keV", "_per_cm"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Light collection efficiency with which a scale's start is guessed.
_USUAL_ETA = 0.25


@dataclass(frozen=True)
class Sample:
    """One ``[samples.NAME]``."""

    name: str
    #: Scene parameters of its readings.
    scene: dict[str, Value]
    #: Its own parameters by what they stand for: alpha_scat_per_cm, alpha_abs_per_cm, scale.
    own: dict[str, CampaignParameter]
    #: What turns its own scale into a light yield; None where nothing does, and of a reference,
    #: whose light yield is known.
    light_yield: LightYieldInput | None = None
    #: Of the line that its own scale refers to, a reference's too; None where nothing says it.
    energy_keV: float | None = None

    def named(self, name: str) -> str:
        """The parameter that stands for one of the campaign's own crystal: the same if shared."""
        return self.own[name].name if name in self.own else name


def own_name(name: str, sample: str) -> str:
    """A sample's own parameter, the unit last: ``alpha_abs_NAME_per_cm``."""
    ending = next((ending for ending in _UNITS if name.endswith(ending)), "")
    return f"{name.removesuffix(ending)}_{sample}{ending}"


def of_sample(name: str) -> tuple[str, str] | None:
    """What `own_name` makes a name of: the shared parameter and the sample; None of others."""
    for of in (*_OWN, schema.KNOWN_YIELD):
        before, after = own_name(of, "\0").split("\0")
        sample = name.removeprefix(before).removesuffix(after)
        if sample and name == own_name(of, sample):
            return of, sample
    return None


def read_samples(
    document: TomlDocument, scene: SceneFile, measurements: Measurements, taken: Container[str]
) -> tuple[dict[str, Sample], Measurements]:
    """``[samples]``, and the readings with the scene parameters of their samples.

    `taken` are names of parameters that samples cannot have.
    Raises InputError with the line, if an entry cannot be used, or if samples and readings do not
    belong together.
    """
    declared = document.table(schema.SAMPLES)
    used = dict.fromkeys(reading.sample for reading in measurements.readings if reading.sample)
    for name in declared:
        if not _NAME.fullmatch(name):
            problem = f"{name} is no name of a sample"
            raise declared.refusal(name, problem, "letters, digits and _, a letter first")
    for reading in measurements.readings:
        if reading.sample and reading.sample not in declared:
            problem = f"{reading.sample} is no sample of {document.path.name}"
            mend = f"declare it there: [{schema.SAMPLES}.{reading.sample}]"
            if declared:
                mend = f"{did_you_mean(reading.sample, declared)}; or {mend}"
            raise measurements.refusal(reading, COLUMN, problem, mend)
    for name in declared:
        if name not in used:
            problem = f"no reading of {measurements.path.name} is of the sample {name}"
            table = f"[{schema.SAMPLES}.{name}]"
            mend = f"write {name} into a column {COLUMN} of its rows, or remove {table}"
            raise declared.refusal(name, problem, mend)
    samples = {name: _read_sample(document, name, scene, measurements) for name in declared}
    # parameters must not be called as others, nor be fitted in the scene
    for sample in samples.values():
        key = f"{schema.SAMPLES}.{sample.name}"
        for parameter in sample.own.values():
            if parameter.name in taken:
                problem = f"{parameter.name}, its own parameter, is one of the campaign already"
                raise document.refusal(key, problem, "call the sample something else")
        for name in sample.scene:
            if name in document.table("parameters"):
                problem = f"{name} is fitted, and the sample {sample.name} has its own"
                mend = f"remove it here, or [parameters.{name}]"
                raise document.refusal(f"{key}.{schema.SAMPLE_SCENE}.{name}", problem, mend)
    readings = tuple(_completed(reading, samples, scene) for reading in measurements.readings)
    return samples, replace(measurements, readings=readings)


def _completed(reading: Reading, samples: Mapping[str, Sample], scene: SceneFile) -> Reading:
    """A reading with its sample's scene parameters, where its row has none of its own."""
    if not reading.sample:
        return reading
    parameters = samples[reading.sample].scene
    if parameters and reading.of_beam:  # only the crystal is in the beam
        seen = spectrophotometer_of(scene).parameters.keys() - {GAP_INDEX}
        parameters = {name: value for name, value in parameters.items() if name in seen}
    return replace(reading, parameters={**parameters, **reading.parameters})


def _read_sample(
    document: TomlDocument, name: str, scene: SceneFile, measurements: Measurements
) -> Sample:
    """One ``[samples.NAME]``: its scene parameters, its own parameters, its light yield."""
    key = f"{schema.SAMPLES}.{name}"
    document.table(key, schema.SAMPLE)
    parameters = document.table(f"{key}.parameters")
    values = {**scene.parameters, SCALE: _scale(name, measurements).start}
    own: dict[str, CampaignParameter] = {}
    for of in parameters:
        if of not in _OWN:
            problem = f"{of} cannot be a sample's own"
            raise parameters.refusal(of, problem, did_you_mean(of, _OWN))
        within = parameters.key
        parameter = read_parameter(document, of, scene, values, measurements, {}, within=within)
        own[of] = replace(parameter, name=own_name(of, name))
    table = document.table(f"{key}.{schema.YIELD_TABLE}")
    detector = read_detector(document, scene, measurements)
    light_yield, energy = read_light_yield(document, detector, table.key, schema.SAMPLE), None
    if light_yield is not None:
        own.setdefault(SCALE, _scale(name, measurements))
        energy = light_yield.energy_keV
        if (of_known := _known_scale(table, light_yield)) is not None:
            if own[SCALE].fixed or own[SCALE].prior is not None:
                problem = "its scale is known twice: by its light yield, and in parameters.scale"
                raise table.refusal(schema.KNOWN_YIELD, problem, "keep one of the two")
            at, sigma = of_known
            own[SCALE] = replace(own[SCALE], start=at, prior=at, prior_sigma=sigma)
            light_yield = None
    return Sample(name, _read_scene(document, key, scene), own, light_yield, energy)


def _scale(sample: str, measurements: Measurements) -> CampaignParameter:
    """A sample's own scale of which nothing is known."""
    signals = [r.signal for r in measurements.readings if r.sample == sample and not r.of_beam]
    start = sum(signals) / len(signals) / _USUAL_ETA if signals else 1.0
    return CampaignParameter(own_name(SCALE, sample), start, 0.0, math.inf)


def _known_scale(table: TomlTable, light_yield: LightYieldInput) -> tuple[float, float] | None:
    """The scale that a reference's light yield makes, and its standard error."""
    value, sigma = (number_within(table, name, schema.KNOWN) for name in schema.KNOWN)
    if value is None and sigma is None:
        return None
    if value is None or sigma is None:
        problem = f"only one of {schema.KNOWN_YIELD} and {schema.KNOWN_YIELD_SIGMA} is given"
        raise table.refusal("", problem, "give both or none")
    relative = math.hypot(sigma / value, light_yield.relative_sigma)
    return value / light_yield.per_scale, relative * value / light_yield.per_scale


def _read_scene(document: TomlDocument, key: str, scene: SceneFile) -> dict[str, Value]:
    """``[samples.NAME.scene]``."""
    table = document.table(f"{key}.{schema.SAMPLE_SCENE}")
    values: dict[str, Value] = {}
    for name, given in table.items():
        if name in (ALPHA_SCAT, ALPHA_ABS):
            mend = f"write [{key}.parameters.{name}] with start = {given}, fixed = true"
            raise table.refusal(name, f"{name} of a sample is one of its parameters", mend)
        if name not in scene.parameters:
            problem = f"{name} is not a parameter of {scene.path.name}"
            raise table.refusal(name, problem, did_you_mean(name, scene.parameters))
        if isinstance(given, (dict, list)):
            raise table.refusal(name, f"{name} is not one value", f"write {name} = 1.5")
        with said_by(partial(table.refusal, name)):
            value = parse_like(name, value_text(given), scene.parameters[name])
        values[name] = value
        if not isinstance(value, (bool, str)) and (wrong := judge(name, value)) is not None:
            raise table.refusal(name, f"{name} = {value:g}: {wrong[1]}", wrong[2])
    return values
