"""Reads a campaign: a scene, its measurements and what is known beforehand."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.calibration import CommonErrors
from mcrim_mitsuba.campaign.entries import choice, number_within
from mcrim_mitsuba.campaign.known_physics import with_known_physics
from mcrim_mitsuba.campaign.measurements import Measurements, Reading, read_table
from mcrim_mitsuba.campaign.parameter import (
    SCALE,
    CampaignParameter,
    LightYieldInput,
    known_ranges,
    read_detector,
    read_light_yield,
    read_parameter,
)
from mcrim_mitsuba.campaign.raw_data import file_in
from mcrim_mitsuba.campaign.reduction import RawData, reduce_raw_data
from mcrim_mitsuba.campaign.samples import EFFICIENCY_FACTOR, Sample, own_name, read_samples
from mcrim_mitsuba.campaign.tolerances import Tolerance, read_tolerances, wrong_numbers
from mcrim_mitsuba.campaign.treatments import switchable, taken_off, with_treatments
from mcrim_mitsuba.core.errors import InputError, did_you_mean, said_by, visible
from mcrim_mitsuba.core.files import READS, collected, is_there, path_of
from mcrim_mitsuba.core.numbers import (
    ALPHA_ABS,
    ALPHA_SCAT,
    COEFFICIENTS,
    COUNTED,
    Value,
    judge,
    value_text,
    without_unit,
)
from mcrim_mitsuba.core.rounding import counted
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable, is_plain_number, read_toml
from mcrim_mitsuba.effects.catalogue import catalogue, effect_of, exclude_each_other
from mcrim_mitsuba.effects.effect import Effect, with_new_names
from mcrim_mitsuba.effects.trust import refuse_untrusted, trust, whose
from mcrim_mitsuba.scene.check_text import problems_of_counted
from mcrim_mitsuba.scene.emitted_light import EmittedLight, read_light
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.spectrophotometer import (
    BEAM_AXIS,
    BEAM_DIAMETER,
    BEAM_PARAMETERS,
    GAP_INDEX,
    refused_of_beam,
    spectrophotometer_of,
    too_wide,
)

#: Of the factor on all efficiencies.
_FACTOR_RANGE = 0.1, 10.0
#: Relative difference of coefficients that no reading tells apart.
_SAME = 0.01


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """A campaign file with the files it names, all checked against each other."""

    #: The file.
    path: Path
    #: What it said when it was read: it may be edited while a long run or a page goes on.
    text: str
    #: At the scene's own values.
    scene: SceneFile
    #: The readings.
    measurements: Measurements
    #: Scene parameters that the campaign names, and all of the effects that are switched on, and
    #: what samples have of their own; `scale` is not among them.
    parameters: dict[str, CampaignParameter] = field(default_factory=dict)
    #: The common scale; None where the campaign says nothing: free, without a prior.
    scale: CampaignParameter | None = None
    #: Effects switched on, in the file's order.
    effects: tuple[str, ...] = ()
    #: Effects that are in its scene, switched from row to row or of a shared size; their sizes are
    #: parameters of the scene, which rows without them have at the value that takes them out.
    treatments: tuple[str, ...] = ()
    #: Parameters of the scene that have the value of another one, by name.
    ties: dict[str, str] = field(default_factory=dict)
    #: Folder of the user's own effects.
    effects_folder: Path | None = None
    #: None: the scale is not turned into a light yield.
    light_yield: LightYieldInput | None = None
    #: Values of scene parameters (lists of float) among which further measurements may be
    #: chosen, and perhaps ``sigma_relative``, the relative error that they would have (float).
    #: Empty: no restriction.
    next_measurements: dict[str, Any] = field(default_factory=dict)
    #: All effects there are, the user's own included.
    catalogue: dict[str, Effect] = field(default_factory=catalogue)
    #: What all readings of light share, by the calibration of channels.
    common_errors: CommonErrors = field(default_factory=CommonErrors)
    #: What readings, priors and efficiency were made of; None where the files give them as
    #: numbers.
    raw: RawData | None = None
    #: Parameters of the spectrophotometer; none where no reading is a transmittance.
    beam: dict[str, Value] = field(default_factory=dict)
    #: Light over wavelengths, over which eta is averaged; None: it has one wavelength.
    spectrum: EmittedLight | None = None
    #: Whose Python was executed to read it.
    executed: tuple[str, ...] = ()
    #: What it is called: as its file says, else by the file's name.
    title: str = ""
    #: Unit of the signals of light; empty where the file does not say it.
    unit: str = ""
    #: What its file wants to be repeated wherever it is fitted.
    remark: str = ""
    #: The light yield over all that the readings allow, in words; empty: that of a fit.
    yield_to_quote: str = ""
    #: Crystals among the readings besides the campaign's own.
    samples: dict[str, Sample] = field(default_factory=dict)
    #: How exactly the scene's numbers are known; what is not named is exact.
    tolerances: tuple[Tolerance, ...] = ()
    #: ``article``: conventions and physics are those of the article; None: of this package.
    convention: str | None = None
    #: Effects that are in its scene because material and energy are named, and a note of them.
    known_physics: tuple[str, ...] = ()
    physics_note: str = ""
    #: All that were read for it, each once: its own, scene, readings, raw data, effects' sources.
    files: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        readings = counted(len(self.measurements.readings), "reading")
        return f"<Campaign {self.title!r}: {readings}, scene {self.scene.path.name}>"

    def parameter_of(self, reading: Reading, name: str) -> str:
        """The parameter that is alpha_scat_per_cm, alpha_abs_per_cm or the scale of a reading."""
        sample = self.samples.get(reading.sample)
        return name if sample is None else sample.named(name)

    def stands_for(self, name: str) -> str:
        """The parameter of the campaign's own crystal that one of a sample is in place of."""
        shared = (of for s in self.samples.values() for of in s.own if s.named(of) == name)
        return next(shared, name)

    @property
    def light_yields(self) -> dict[str, tuple[str, LightYieldInput]]:
        """Scales that turn into light yields: these by name, and by what they do so."""
        yields = {} if self.light_yield is None else {SCALE: (schema.KNOWN_YIELD, self.light_yield)}
        for sample in self.samples.values():
            if sample.light_yield is not None:
                name = own_name(schema.KNOWN_YIELD, sample.name)
                yields[sample.named(SCALE)] = name, sample.light_yield
        return yields

    @property
    def energies_keV(self) -> dict[str, float]:
        """Of the lines that scales refer to, where the file says it."""
        own = {} if self.light_yield is None else {SCALE: self.light_yield.energy_keV}
        return own | {s.named(SCALE): s.energy_keV for s in self.samples.values() if s.energy_keV}

    @property
    def varied(self) -> tuple[str, ...]:
        """Scene parameters that differ from reading to reading, by row or by sample."""
        of_samples = (name for sample in self.samples.values() for name in sample.scene)
        return tuple(dict.fromkeys([*self.measurements.columns, *of_samples]))

    def cells(self, reading: Reading) -> dict[str, Value | None]:
        """What differs from reading to reading, as one has it.

        That is the parameters `varied`, None where it has none of that name, and of all that
        columns switch whether it has it, 1 or 0.
        """
        parts = {name: float(name not in reading.without) for name in self.measurements.switches}
        return {**{name: reading.parameters.get(name) for name in self.varied}, **parts}

    @property
    def values(self) -> dict[str, Value]:
        """Parameters of the scene and of the beam, at their own values."""
        return {**self.scene.parameters, **self.beam}

    @property
    def free(self) -> tuple[str, ...]:
        """Names that the fit varies, ``scale`` last."""
        named = {**self.parameters, SCALE: self.scale}
        return tuple(name for name, of in named.items() if of is None or not of.fixed)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader must know of scene, effects and raw data before using the numbers."""
        notes = [*self.remarks, *self.scene.notes, *self.executed]
        if self.raw is not None:
            notes += self.raw.notes
        if self.spectrum is not None:
            notes.append(_averaged(self.spectrum))
        if self.physics_note:
            notes.append(self.physics_note)
        if SCALE in self.free and self.light_yield is not None and self.light_yield.detector:
            notes += self.light_yield.detector.notes
            if not (self.light_yield.relative_sigma or self.light_yield.detector.shared_sigma):
                notes.append("detector_efficiency has no error: the light yield's lacks it")
        return tuple(notes)

    @property
    def ndf(self) -> int:
        """Degrees of freedom: readings in use + priors - free parameters."""
        return len(self.measurements.in_use) + len(self.priors) - len(self.free)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What every verb repeats of the campaign file."""
        quote = self.yield_to_quote
        over_all = "the light yield to quote is that over all that the readings allow"
        return tuple(filter(None, (self.remark, quote and f"{over_all}, {quote}")))

    def with_starts(self, values: Mapping[str, float]) -> Campaign:
        """The campaign with other starts of its fit, drawn into the bounds; others stay."""
        parameters = dict(self.parameters)
        for name, parameter in parameters.items():
            if name in values and not parameter.fixed:
                start = min(max(values[name], parameter.minimum), parameter.maximum)
                parameters[name] = replace(parameter, start=start)
        return replace(self, parameters=parameters)

    @property
    def priors(self) -> dict[str, tuple[float, float]]:
        """Gaussian knowledge of free parameters from elsewhere: value and standard error."""
        named = {**self.parameters, SCALE: self.scale}
        return {name: of.knowledge for name, of in named.items() if of and of.knowledge}

    def with_priors(self, priors: Mapping[str, tuple[float, float]]) -> Campaign:
        """The campaign with other `priors` of some parameters."""
        parameters = dict(self.parameters)
        for name, (prior, sigma) in priors.items():
            parameters[name] = replace(parameters[name], prior=prior, prior_sigma=sigma)
        return replace(self, parameters=parameters)

    @property
    def switched_on(self) -> list[Effect]:
        """`effects`, as the catalogue has them."""
        return [self.catalogue[name] for name in self.effects]

    def with_only(self, effects: Iterable[str]) -> Campaign:
        """The campaign with these of its effects alone, and without what the others bring."""
        left = tuple(name for name in self.effects if name in effects)
        kept = {p.name for name in left for p in self.catalogue[name].parameters}
        gone = {p.name for effect in self.switched_on for p in effect.parameters} - kept
        parameters = {name: of for name, of in self.parameters.items() if name not in gone}
        return replace(self, effects=left, parameters=parameters)

    def with_effects(self, names: Sequence[str]) -> Campaign:
        """The campaign with more effects switched on, their parameters as the catalogue has them.

        More parameters than readings are not refused here: `ndf` tells.

        Raises InputError if there is no such effect, if it is switched on already, if it excludes
        another one, if it needs a parameter that the scene lacks, or if one of its parameters is in
        the campaign, or a column, already.
        """
        names = with_new_names(names)
        effects = [*self.effects, *names]
        _refuse_effects(effects, self)
        ranges = known_ranges(self.catalogue, names, self.values)
        added = {}
        for name in (p.name for effect in names for p in self.catalogue[effect].parameters):
            if name in self.parameters or name in self.varied:
                place = "the campaign" if name in self.parameters else "the measurements"
                raise InputError(f"{name} is in {place} already", "remove it there", path=self.path)
            start, low, high = ranges[name]
            assert start is not None  # it was switched on just now
            added[name] = CampaignParameter(name, start, low, high)
        return replace(self, effects=tuple(effects), parameters={**self.parameters, **added})


def as_campaign(campaign: str | Path | Campaign) -> Campaign:
    """The campaign that is given, or that a file holds; see `read_campaign`."""
    return campaign if isinstance(campaign, Campaign) else read_campaign(campaign)


def read_campaign(path: str | Path, *, trust_effects: bool = False) -> Campaign:
    """Read a campaign file, its scene and its measurements, and check them together.

    Raw data that it names (histograms, spectra) are reduced to readings, priors and efficiency.
    If the campaign names an ``effects_folder``, the Python files in it are executed, if the user
    allows it (`trust_effects`) or allowed these very files before (`effects.trust`).

    Raises InputError if one of the files cannot be used, if an entry is unknown or impossible, or
    if there are more free parameters than readings in use and priors.
    """
    path = path_of("the campaign", path)
    others = {
        ".xml": ("a scene", f'scene = "{path.name}" and its measurements'),
        ".csv": ("a table", f'measurements = "{path.name}" and their scene'),
    }
    if path.suffix.lower() in others and is_there(path) and path.is_file():
        kind, entries_of_it = others[path.suffix.lower()]
        mend = f"name a campaign (.toml) with {entries_of_it}"
        raise InputError(f"this is {kind}, not a campaign", mend, path=path)
    document = read_toml(path)
    # parameters of effects as they are named today
    content = {**document.content, "parameters": with_new_names(document.table("parameters"))}
    lines = {".".join(with_new_names(n.split("."))): line for n, line in document.lines.items()}
    document = replace(document, content=content, lines=lines | document.lines)
    folder = _folder(document.table("", schema.CAMPAIGN), trust_effects)
    with collected(READS) as files:
        campaign = _campaign_of(document, folder)
    sources = () if folder is None else sorted(folder.glob("*.py"))
    files = [path, *campaign.scene.files, *files, *sources]
    return replace(campaign, files=tuple(dict.fromkeys(files)))


def _campaign_of(document: TomlDocument, folder: Path | None) -> Campaign:
    """The campaign of a document and of the user's own effects."""
    entries = document.table("", schema.CAMPAIGN)
    effects = catalogue(folder)
    scene = read_scene(_sibling(entries, "scene"))
    of_rows = switchable(effects, scene, document)
    table = read_table(_sibling(entries, "measurements"), scene.parameters, of_rows)
    document, measurements, raw = reduce_raw_data(document, table, scene)
    of_effects = {p.name for effect in effects.values() for p in effect.parameters}
    taken = of_effects | {*scene.parameters, EFFICIENCY_FACTOR}
    samples, measurements = read_samples(document, scene, measurements, taken)
    _refuse_rows_the_scene_cannot_take(scene, measurements)
    sizes = {p.name for of in effects.values() for p in of.parameters if p.nominal is None}
    light = [row.signal for row in measurements.in_use if not row.of_beam]
    effects = {name: effect.beside(np.array(light)) for name, effect in effects.items()}
    tolerances = read_tolerances(document, scene, measurements, sizes)
    campaign = Campaign(
        path=document.path,
        text=document.text,
        scene=scene,
        measurements=measurements,
        effects_folder=folder,
        catalogue={**effects, **wrong_numbers(tolerances)},
        tolerances=tolerances,
        raw=raw,
        beam=_read_beam(document, scene, measurements),
        executed=() if folder is None else (whose(folder),),
        samples=samples,
    )
    names = with_new_names(entries.get("effects", []))
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise entries.refusal("effects", "effects is not a list of names", "write effects = []")
    with said_by(partial(entries.refusal, "effects")):
        _refuse_effects(names, campaign)
    campaign = with_treatments(replace(campaign, effects=tuple(names)), document)
    campaign = _with_parameters(campaign, document)
    campaign = replace(
        campaign,
        next_measurements=_read_next(document.table(schema.NEXT), campaign),
        spectrum=_read_spectrum(entries, campaign),
        title=_words(entries, "title") or document.path.stem,
        unit=_words(entries, "unit"),
        remark=_words(entries, "remark", schema.LONGEST_REMARK),
        yield_to_quote=_words(entries, schema.TO_QUOTE, schema.LONGEST_REMARK),
        convention=choice(entries, schema.CONVENTION, schema.CAMPAIGN),
    )
    _refuse_contradictions(document, campaign)
    return with_known_physics(campaign)


def _with_parameters(campaign: Campaign, document: TomlDocument) -> Campaign:
    """The campaign with all of its parameters, and what turns the scale into a light yield."""
    values, measurements = campaign.values, campaign.measurements
    effects = campaign.catalogue.values()
    owners = {p.name: effect.name for effect in effects for p in effect.parameters}
    for name in document.table("parameters"):
        owner = owners.get(name)
        if owner and owner not in campaign.effects and name not in values:
            problem = f"{name} belongs to {owner}, which is neither switched on nor in the scene"
            raise document.refusal(f"parameters.{name}", problem, f'write "{owner}" into effects')
    named = (*campaign.treatments, *campaign.effects)
    ranges = known_ranges(campaign.catalogue, named, values)
    brought = [p.name for name in named for p in campaign.catalogue[name].parameters]
    parameters = {
        name: read_parameter(document, name, campaign.scene, values, measurements, ranges)
        for name in dict.fromkeys([*document.table("parameters"), *brought])
        if name not in campaign.ties
    }
    # values that no spectrophotometer has
    for name in filter(BEAM_PARAMETERS.__contains__, parameters):
        table = document.table(f"parameters.{name}")
        for entry in ("start", "min", "max"):
            if (value := table.number(entry)) is not None:
                of_beam = refused_of_beam(name, value) or too_wide({**values, name: value})
                if of_beam is not None:
                    raise table.refusal(entry, *of_beam)
    scale = parameters.pop(SCALE, None)
    for sample in campaign.samples.values():
        parameters |= {parameter.name: parameter for parameter in sample.own.values()}
    detector = read_detector(document, campaign.scene, measurements)
    own_scales = any(SCALE in sample.own for sample in campaign.samples.values())
    raw = campaign.raw.efficiency if campaign.raw else None
    parts = raw.contributions if raw else None
    # of all efficiencies that this detector has in common
    sigma = math.hypot(detector.relative_sigma, detector.shared_sigma)
    if own_scales and sigma:
        parameters[EFFICIENCY_FACTOR] = CampaignParameter(
            EFFICIENCY_FACTOR, 1.0, *_FACTOR_RANGE, prior=1.0, prior_sigma=sigma
        )
    return replace(
        campaign,
        parameters=parameters,
        scale=scale,
        light_yield=read_light_yield(document, detector, own_scales=own_scales, parts=parts),
        common_errors=detector.common,
    )


def _refuse_contradictions(document: TomlDocument, campaign: Campaign) -> None:
    """Refuse what no fit could determine, and a spectrum of several crystals."""
    campaign.measurements.refuse_other_units(campaign.energies_keV.values())
    # fitted scales of which no reading in use says anything
    used = campaign.measurements.in_use
    read = {campaign.parameter_of(r, SCALE) for r in used if not r.of_beam}
    if SCALE in campaign.free and not read:
        problem = "all readings in use are transmittances, which say nothing of the scale"
        mend = "add a reading of light, or hold it: [parameters.scale] with start = 1, fixed = true"
        raise InputError(problem, mend, path=campaign.path)
    for name in (SCALE, *(sample.named(SCALE) for sample in campaign.samples.values())):
        if name in campaign.free and name not in read and name not in campaign.priors:
            problem = f"no reading of light in use says anything of {name}"
            whose = "samples have their own: " if name == SCALE else ""
            mend = f"{whose}let one share it, or hold it with fixed = true"
            raise InputError(problem, mend, path=campaign.path)
    if campaign.spectrum is not None:
        for sample in campaign.samples.values():
            if coefficients := sample.own.keys() & set(COEFFICIENTS):
                what = f"{schema.SPECTRUM} is of one crystal, and {sample.name} has its own"
                key, mend = f"{schema.SAMPLES}.{sample.name}", f"remove {schema.SPECTRUM}"
                raise document.refusal(key, f"{what} {min(coefficients)}", mend)
    if campaign.ndf < 0:
        free = f"{counted(len(campaign.free), 'free parameter')} ({', '.join(campaign.free)})"
        readings, priors = counted(len(used), "reading"), counted(len(campaign.priors), "prior")
        mend = "add readings or priors, or hold a parameter with fixed = true"
        problem = f"{free} but {readings} in use and {priors}"
        raise InputError(problem, mend, path=campaign.path)


def _read_beam(
    document: TomlDocument, scene: SceneFile, measurements: Measurements
) -> dict[str, Value]:
    """``[beam]``, completed by what is usual; empty where no reading is a transmittance."""
    table = document.table(schema.BEAM_TABLE, schema.BEAM)
    given: dict[str, Value] = {}
    for name in table:
        given[name] = str(table[name]) if name == BEAM_AXIS else table.known_number(name)
        if (wrong := refused_of_beam(name, given[name])) is not None:
            raise table.refusal(name, *wrong)
    beam = {**BEAM_PARAMETERS, **given}
    transmittances = [reading for reading in measurements.readings if reading.of_beam]
    if not transmittances:
        if given:
            problem = f"no reading of {measurements.path.name} is a transmittance"
            mend = "add a column kind with transmittance in its row, or remove [beam]"
            raise table.refusal("", problem, mend)
        return {}
    in_beam = spectrophotometer_of(scene).parameters
    for reading in transmittances:
        for name, value in reading.parameters.items():
            # a row may say that there is air
            if name not in in_beam or (name == GAP_INDEX and value != 1.0):
                what = f"{name} = {value_text(value)} of a transmittance"
                problem = f"{what}, which is measured in air without the bench"
                raise measurements.refusal(reading, name, problem, "empty the cell")
        if (wrong := too_wide({**scene.parameters, **beam, **reading.parameters})) is None:
            continue
        if BEAM_DIAMETER in given and not reading.parameters:
            raise table.refusal(BEAM_DIAMETER, *wrong)
        raise measurements.refusal(reading, None, *wrong)
    return beam


def _sibling(entries: TomlTable, name: str) -> Path:
    """Path of the scene or the measurements, which must exist."""
    if name not in entries:
        raise entries.refusal("", f"the campaign names no {name}", f'add {name} = "..." at the top')
    return file_in(entries, name, entries[name])


def _read_spectrum(entries: TomlTable, campaign: Campaign) -> EmittedLight | None:
    """Light over wavelengths; None where the campaign names none.

    Where the table has no efficiency of the detector, that of ``[light_yield]`` stands in.
    """
    if schema.SPECTRUM not in entries:
        return None
    light = read_light(file_in(entries, schema.SPECTRUM, entries[schema.SPECTRUM]), campaign.scene)
    raw = campaign.raw
    if raw is not None and raw.efficiency is not None and not light.detected:
        light = light.seen_by(raw.efficiency.quantum_efficiency)
    coefficients = {n: values for n, values in light.parameters.items() if n in COEFFICIENTS}
    if not any(np.ptp(values) > 0.0 for values in coefficients.values()):
        problem = f"neither {ALPHA_SCAT} nor {ALPHA_ABS} varies in {light.path.name}"
        mend = f"add a column, or remove {schema.SPECTRUM}: one wavelength says the same"
        raise entries.refusal(schema.SPECTRUM, problem, mend)
    # readings are told by its shape: the size is the campaign's
    for name in coefficients.keys() - {*campaign.parameters, *campaign.varied}:
        value, there = light.at(light.mean_nm)[name], float(campaign.scene.parameters[name])
        if abs(value - there) > _SAME * value:
            problem = f"{name} is {value:.4g} at {light.mean_nm:.0f} nm, the mean wavelength of "
            problem += f"{light.path.name}, and {there:g} in the scene"
            mend = f"write [parameters.{name}] with start = {value:.4g}, fixed = true or a prior"
            raise entries.refusal(schema.SPECTRUM, problem, mend)
    return light


def _averaged(light: EmittedLight) -> str:
    """What is done with light over wavelengths."""
    named = [without_unit(name) for name in COEFFICIENTS if name in light.parameters]
    indices = [name for name in light.parameters if name not in COEFFICIENTS]
    words = (
        f"eta is averaged over the light of {light.path.name}, by its {' and '.join(named)}: those "
        f"that are fitted are at {light.mean_nm:.0f} nm, the mean wavelength"
    )
    return words + (f"; {', '.join(indices)} stay at the scene's value" if indices else "")


def _words(entries: TomlTable, name: str, longest: int = schema.LONGEST_WORDS) -> str:
    """A short text; empty where it is not there."""
    if name not in entries:
        return ""
    given = entries[name]
    if not isinstance(given, str):
        raise entries.refusal(name, f"{name} is not a text", f'write {name} = "..."')
    words = visible(" ".join(given.split()))
    if not words:
        raise entries.refusal(name, f"{name} is empty", "write some words, or remove it")
    if len(words) > longest:
        raise entries.refusal(name, f"{name} has {len(words)} characters", f"{longest} are enough")
    return words


def _folder(entries: TomlTable, trusted: bool) -> Path | None:
    """The folder of the user's own effects, which may be executed."""
    name = "effects_folder"
    if name not in entries:
        return None
    path = entries.path_of(name, entries[name])
    mend = "paths are relative to the campaign file"
    refusal = entries.refusal(name, f"{path} is not a folder", mend)
    if not (is_there(path) and path.is_dir()):
        raise refusal
    if trusted:
        trust(path)
    refuse_untrusted(path, refusal.path, refusal.line)
    return path


def _refuse_effects(names: Sequence[str], campaign: Campaign) -> None:
    """Refuse effects that cannot be switched on, or not together."""
    for position, name in enumerate(names):
        effect = effect_of(name, campaign.catalogue)
        if name in names[:position]:
            raise InputError(f"{name} is named twice", "name it once")
        effect.refuse_without_part(campaign.scene)
        if effect.of_beam and not campaign.beam:
            problem = f"{name} acts on transmittances, and no reading is one"
            raise InputError(problem, f"do without {name}")
        if missing := effect.missing(campaign.values):
            problem = f"{name} needs {missing}, which is no parameter of {campaign.scene.path.name}"
            mend = f"let the scene's number of this meaning have this name, or do without {name}"
            raise InputError(problem, mend)
    if pair := exclude_each_other([campaign.catalogue[name] for name in names]):
        raise InputError(f"{pair[0]} and {pair[1]} exclude each other", "remove one of the two")


def _read_next(table: TomlTable, campaign: Campaign) -> dict[str, Any]:
    """``[next_measurements]``: lists of values by scene parameter, their error, their minutes."""
    entries: dict[str, Any] = {}
    for name, values in table.items():
        if name == schema.NEXT_SIGMA:
            entries[name] = number_within(table, name, schema.NEXT_ENTRIES)
        elif name == schema.NEXT_MINUTES:
            if not isinstance(values, dict):
                mend = f"write {name} = {{ n_gap = 20 }}"
                raise table.refusal(name, f"{name} is not a table", mend)
            for of, minutes in values.items():
                if of not in {*campaign.scene.parameters, *campaign.measurements.switches}:
                    problem = f"{name}: {of} is not a parameter of {campaign.scene.path.name}"
                    raise table.refusal(name, problem, did_you_mean(of, campaign.scene.parameters))
                if not is_plain_number(minutes) or not 0.0 <= minutes < math.inf:
                    problem = f"{name}: {of} = {minutes} is not a number of minutes"
                    raise table.refusal(name, problem, f"write {of} = 20")
            entries[name] = {of: float(minutes) for of, minutes in values.items()}
        elif (wrong := _wrong_next(name, values, campaign)) is not None:
            raise table.refusal(name, *wrong)
        else:
            number = str if name == COUNTED else float
            entries[name] = list(dict.fromkeys(map(number, values)))
    return entries


def _wrong_next(name: str, values: Any, campaign: Campaign) -> tuple[str, str] | None:
    """What is wrong with the values of one scene parameter, and how to mend it."""
    scene, parameters = campaign.scene, campaign.parameters
    present = {**BEAM_PARAMETERS, **scene.parameters}
    if name in campaign.measurements.switches:
        if not taken_off(campaign, [name]):
            mend = f"remove {name}, or name it in effects, which puts it into the bench"
            return f"{name} switches an effect that is not in the bench", mend
        if not isinstance(values, list) or not values or any(v not in (0, 1) for v in values):
            return f"{name} is not a list of 0 and 1", f"write {name} = [0, 1]: without it, with it"
        return None
    if name not in present:
        numbers = [n for n, value in scene.parameters.items() if not isinstance(value, bool | str)]
        possible = [*numbers, COUNTED, schema.NEXT_SIGMA, schema.NEXT_MINUTES]
        return f"{name} is not a parameter of {scene.path.name}", did_you_mean(name, possible)
    if name == COUNTED and isinstance(values, list) and values:
        for value in values:
            for wrong_name in problems_of_counted(scene.with_overrides({COUNTED: str(value)})):
                return wrong_name.text, wrong_name.mend
        return None
    if isinstance(present[name], (bool, str)):
        return f"{name} is not a number", f"remove {name}"
    if name in parameters and not parameters[name].fixed:
        return f"{name} is fitted: a measurement cannot set it", f"remove {name} here"
    if not isinstance(values, list) or not values or not all(map(is_plain_number, values)):
        return f"{name} is not a list of numbers", f"write {name} = [1.0, 2.0]"
    for value in values:
        if (wrong := judge(name, float(value))) is not None:
            return f"{name} = {value:g}: {wrong[1]}", wrong[2]
        if not math.isfinite(value):
            return f"{name} = {value:g}: not a finite number", "remove it"
        if (of_beam := refused_of_beam(name, value)) is not None:
            return of_beam
    return None


def _refuse_rows_the_scene_cannot_take(scene: SceneFile, measurements: Measurements) -> None:
    """Refuse rows whose parameters the scene refuses; it is said of the row, not of the scene."""
    taken: set[tuple[tuple[str, Value], ...]] = set()
    for reading in measurements.readings:
        for name, value in reading.parameters.items():
            if not isinstance(value, (bool, str)) and (wrong := judge(name, value)) is not None:
                problem = f"{name} = {value:g}: {wrong[1]}"
                raise measurements.refusal(reading, name, problem, wrong[2])
        of_bench = {n: v for n, v in reading.parameters.items() if n not in BEAM_PARAMETERS}
        if (key := tuple(of_bench.items())) not in taken:
            with said_by(partial(measurements.refusal, reading, None)):
                as_measured = scene.with_overrides(of_bench)
            for wrong_name in problems_of_counted(as_measured):
                raise measurements.refusal(reading, COUNTED, wrong_name.text, wrong_name.mend)
            taken.add(key)
