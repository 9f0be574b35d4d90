"""What a report tells: everything measured, fitted and drawn, before it becomes a page."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.plain import beam_notes
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, unit_of
from mcrim_mitsuba.core.rounding import number, p_text, pdg, pdg_parts
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.lighting import Light, light_of
from mcrim_mitsuba.inference.candidates import Candidate
from mcrim_mitsuba.inference.diagnose import Diagnosis
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.profiles import Profile, profiles_of
from mcrim_mitsuba.inference.repair import Repaired, mended_files, mended_scene, scene_text
from mcrim_mitsuba.inference.verdict import ADEQUATE, AMBIGUOUS, MISSING_EFFECT, TOO_FEW_READINGS
from mcrim_mitsuba.output.findings import ACCEPTABLE_P, leading_candidates, together
from mcrim_mitsuba.output.report_facts import (
    BenchDescription,
    Efficiency,
    Quantity,
    RatioOfSignals,
    SourceFile,
    describe,
    efficiencies,
    quantities,
    ratio_curve,
    source_of,
    sources_of,
    to_json,
)
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Configurations whose light is followed, and photons of each.
MOST_LIGHTS, LIGHT_PHOTONS = 4, 400_000
_COUPLING = "n_gap"

Stage = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Story:
    """A campaign from its readings to its result."""

    #: As it came.
    campaign: Campaign
    #: What was found and what was done about it.
    repaired: Repaired
    #: The result.
    quantities: dict[str, Quantity]
    #: Of every reading's configuration.
    efficiencies: tuple[Efficiency, ...]
    profiles: tuple[Profile, ...]
    ratio: RatioOfSignals | None
    #: With the effects that were added.
    bench: BenchDescription
    #: Of the couplings, by the label of a reading.
    lights: tuple[tuple[str, Light], ...]
    #: The files, as they were read.
    sources: tuple[SourceFile, ...]
    #: Campaign and scene with the effects that were added; empty where none was.
    mended: tuple[SourceFile, ...]
    #: What makes this report again.
    command: str
    #: In UTC.
    made: datetime
    variant: str
    #: Whether the effects are the user's choice.
    chosen_by_hand: bool

    @property
    def diagnosis(self) -> Diagnosis:
        """What explains the readings and what does not."""
        return self.repaired.diagnosed.diagnosis

    @property
    def calibration(self) -> Calibration:
        """The fit that is quoted."""
        return self.repaired.calibration

    @property
    def effects(self) -> tuple[str, ...]:
        """Those that were added."""
        return self.repaired.effects

    @property
    def headline(self) -> str:
        """The verdict in a sentence."""
        return headline(self.diagnosis, self.effects)

    def numbers(self) -> dict[str, Any]:
        """The result for JSON."""
        return to_json(self.quantities, self.efficiencies) | {
            "effects": list(self.effects),
            "calibration": self.calibration.to_json(),
            "files": {str(source.path): source.sha256 for source in self.sources},
            "command": self.command,
            "made": self.made.isoformat(timespec="seconds"),
        }


def tell(
    repaired: Repaired, *, command: str, made: datetime, chosen_by_hand: bool, stage: Stage
) -> Story:
    """Gather what a report tells of a mended campaign.

    Parameters
    ----------
    repaired : Repaired
    command : str
    made : datetime
    chosen_by_hand : bool
    stage : callable
        ``stage(what)``, called as the work goes on.

    Raises
    ------
    InputError
        If a file cannot be read any more, or the scene with the effects is not sound.
    """
    calibration = repaired.calibration
    campaign, run = repaired.bench.campaign, repaired.bench.run
    with_effects = campaign.with_effects(repaired.effects)
    scene = scene_of_the_result(campaign, repaired.effects, calibration)
    stage("profile likelihoods")
    profiles = profiles_of(repaired.model, calibration)
    stage("picture of the bench")
    couplings = _couplings(campaign)
    # a filled gap shows what may be in it
    bench = describe(with_effects, scene, couplings[-1], run)
    return Story(
        campaign=campaign,
        repaired=repaired,
        quantities=quantities(calibration),
        efficiencies=efficiencies(repaired.model, calibration),
        profiles=profiles,
        ratio=ratio_curve(repaired.model, calibration),
        bench=bench,
        lights=_lights(couplings, scene, run, stage),
        sources=sources_of(campaign),
        mended=_mended(campaign, repaired),
        command=command,
        made=made,
        variant=run.variant,
        chosen_by_hand=chosen_by_hand,
    )


def scene_of_the_result(
    campaign: Campaign, effects: tuple[str, ...], calibration: Calibration
) -> SceneFile:
    """The scene at the fitted values, with all effects in it that are not of the readings."""
    known = campaign.catalogue
    lacking = [name for name in campaign.effects if not known[name].is_in(campaign.scene)]
    values = {name: found.value for name, found in calibration.parameters.items()}
    return mended_scene(campaign, (*lacking, *effects), {**calibration.fixed, **values})


def _lights(
    couplings: Sequence[Reading], scene: SceneFile, run: Run, stage: Stage
) -> tuple[tuple[str, Light], ...]:
    lights = []
    for reading in couplings:
        stage("where the light goes")
        light = light_of(
            scene, reading.parameters, run=replace(run, photons=LIGHT_PHOTONS, progress=None)
        )
        lights.append((reading.label, light))
    return tuple(lights)


def _couplings(campaign: Campaign) -> list[Reading]:
    """The first reading of every coupling, from the lowest index to the highest."""
    nominal = campaign.scene.parameters.get(_COUPLING)
    first: dict[object, Reading] = {}
    for reading in campaign.measurements.in_use:
        first.setdefault(reading.parameters.get(_COUPLING, nominal), reading)
    ordered = [first[index] for index in sorted(first, key=lambda i: (i is None, i))]
    if len(ordered) <= MOST_LIGHTS:
        return ordered
    # both ends and what lies evenly between
    step = (len(ordered) - 1) / (MOST_LIGHTS - 1)
    return [ordered[round(i * step)] for i in range(MOST_LIGHTS)]


def _mended(campaign: Campaign, repaired: Repaired) -> tuple[SourceFile, ...]:
    if not repaired.effects:
        return ()
    target = campaign.path.with_name(f"{campaign.path.stem}_mended.toml")
    scene, text = mended_files(campaign, repaired.effects, repaired.calibration, target)
    return (
        source_of("mended campaign", Path(target.name), text.encode()),
        source_of(
            "mended scene", Path(target.with_suffix(".xml").name), scene_text(scene).encode()
        ),
    )


# Sentences of the report, for readers who did not do the measurement.

#: What the usual parameters are, and their units.
NAMES = {
    LIGHT_YIELD: ("light yield", "photons per keV"),
    SCALE: ("scale: signal per unit of efficiency", "unit of the readings"),
    ALPHA_SCAT: ("scattering coefficient of the crystal", "1/cm"),
    ALPHA_ABS: ("absorption coefficient of the crystal", "1/cm"),
}
#: Leading effects that are named in a sentence and explained; tables have all.
MOST_NAMED = 4
#: Part of an error that is not worth a digit.
_NOTHING = 1e-3
#: Gain in χ² that is only the solver's precision.
_NO_GAIN = 0.01


def parameter_words(campaign: Campaign, name: str) -> tuple[str, str]:
    """Meaning and unit of a fitted parameter."""
    if name in NAMES:
        return NAMES[name]
    for effect in campaign.catalogue.values():
        for parameter in effect.parameters:
            if parameter.name == name:
                return parameter.meaning, parameter.unit
    written = campaign.scene.defaults.get(name)
    return (written.comment if written else ""), unit_of(name) or ""


def value_with_errors(quantity: Quantity) -> str:
    """``7.8 ± 0.2 ± 0.8``: statistical first, systematic second; at a bound the value alone."""
    if quantity.at_bound is not None:
        return f"{quantity.value:.4g}, at the end of its range"
    if not math.isfinite(quantity.total):
        return pdg(quantity.value, None)
    parts = (quantity.statistical, quantity.systematic)
    # what does not count is none: 0.039 ± 0 ± 0.012
    return pdg_parts(quantity.value, *(s if s > _NOTHING * quantity.total else 0.0 for s in parts))


def interval(quantity: Quantity) -> str:
    """Ends of the interval, in as many digits as the error deserves."""
    if quantity.lower is None or quantity.upper is None:
        return "-"
    if not math.isfinite(quantity.total) or quantity.total <= 0:
        return f"{number(quantity.lower, 4)} to {number(quantity.upper, 4)}"
    ends = (pdg(end, quantity.total) for end in (quantity.lower, quantity.upper))
    return " to ".join(_value_of(text) for text in ends)


def _value_of(text: str) -> str:
    """The value of ``value ± sigma``, its power of ten kept."""
    value, _, rest = text.partition(" ± ")
    _, bracket, power = rest.partition(")")
    return f"{value.lstrip('(')}{power}" if bracket else value


def gain_text(candidate: Candidate) -> str:
    """Fall of χ² with an effect, and the simulation's error; what is not worth a digit is 0."""
    if max(abs(candidate.delta_chi2), candidate.delta_chi2_sigma) < _NO_GAIN:
        return "0"
    return pdg(candidate.delta_chi2, candidate.delta_chi2_sigma or None)


def change_text(change: float) -> str:
    """A relative change in per cent, with its sign: ``+10.5 %``."""
    text = f"{100 * change:+.1f} %"
    return "0 %" if text in ("+0.0 %", "-0.0 %") else text


def pull_text(pull: float) -> str:
    """``+1.23``; what vanishes has no sign."""
    text = f"{pull:+.2f}"
    return "0.00" if text in ("+0.00", "-0.00") else text


def headline(diagnosis: Diagnosis, effects: tuple[str, ...]) -> str:
    """The verdict for everybody."""
    plain = "The bench as described does not explain the readings"
    leading = [together(candidate.effects) for candidate in leading_candidates(diagnosis)]
    if diagnosis.verdict == TOO_FEW_READINGS:
        return (
            "The readings determine the result, but none is left over to test whether the bench "
            "is as described."
        )
    if diagnosis.verdict == ADEQUATE:
        return "The bench as described explains the readings: nothing is missing."
    if diagnosis.verdict == MISSING_EFFECT and leading:
        return f"{plain}; with {leading[0]} it does."
    if diagnosis.verdict == AMBIGUOUS and len(leading) > 1:
        named = leading
        if len(leading) > MOST_NAMED:
            more = len(leading) - MOST_NAMED
            named = [*leading[:MOST_NAMED], "another" if more == 1 else f"{more} others"]
        return f"{plain}; {together(named, 'or')} would, and the readings cannot tell which."
    if diagnosis.verdict == AMBIGUOUS and leading:
        return f"{plain}; {leading[0]} would, but it is not the only explanation."
    if effects:
        return f"{plain}; {together(effects)} makes it better, but what is missing is not clear."
    return f"{plain}, and nothing that was tried does."


def trust(diagnosis: Diagnosis, calibration: Calibration, effects: tuple[str, ...]) -> str:
    """How far the numbers can be believed, in plain words."""
    p_value = calibration.p_value
    fit = f"χ² = {number(calibration.chi2)} for {calibration.ndf} degrees of freedom"
    if p_value is None:
        return (
            "There are just as many facts as unknowns, so that the fit cannot fail. The errors "
            "hold if the bench is as described; only further readings can show whether it is."
        )
    if p_value < ACCEPTABLE_P:
        return (
            f"Do not quote these numbers. If the model were right, readings would disagree with "
            f"it this much with a probability of {p_text(p_value)} only ({fit}). The errors "
            "below know nothing of that."
        )
    told = (
        f"If the model is right, readings disagree with it this much or more in "
        f"{_of_hundred(p_value)} of 100 campaigns ({fit}, p = {p_text(p_value)}): nothing in them "
        "speaks against it."
    )
    if p_value > 1.0 - ACCEPTABLE_P / 10:
        told = (
            f"The readings agree better than their errors allow ({fit}, p = {p_text(p_value)}): "
            "these may be too large."
        )
    if diagnosis.verdict == AMBIGUOUS and effects:
        told += (
            f" But {together(effects)} is one explanation of several; the numbers hold only if it "
            "is the right one."
        )
    elif effects:
        told += f" This holds with {together(effects)} added to the bench."
    return told


def beam(campaign: Campaign, calibration: Calibration) -> str:
    """What speaks against the scattering that was found; empty where nothing does."""
    found = calibration.parameters.get(ALPHA_SCAT)
    if campaign.raw is None or found is None:
        return ""
    return " ".join(f"But {note}." for note in beam_notes(campaign.raw, found.value))


def _of_hundred(p_value: float) -> str:
    return f"{100 * p_value:.0f}" if p_value >= 0.015 else "1"


def value_of_others(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """What the result would be with each leading explanation: name, light yield, alpha_scat.

    Empty where the campaign fits neither.
    """
    rows = []
    for candidate in leading_candidates(diagnosis):
        light = candidate.light_yield_ph_per_keV
        scattering = candidate.parameters.get(ALPHA_SCAT)
        if light is None and scattering is None:
            continue
        rows.append(
            (
                together(candidate.effects),
                "-" if light is None else pdg(light["value"], light.get("sigma")),
                "-" if scattering is None else pdg(scattering.value, scattering.sigma),
            )
        )
    return rows
