"""What a report tells: everything measured, fitted and drawn, before it becomes a page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from mcrim_mitsuba.diagnosis.result import Diagnosis
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.measurements import Reading
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.fit.profiles import Profile, profiles_of
from mcrim_mitsuba.fit.result import Calibration
from mcrim_mitsuba.lighting import Light, light_of
from mcrim_mitsuba.recording import RunOptions
from mcrim_mitsuba.repairing import Repaired, mended_files, mended_scene, scene_text
from mcrim_mitsuba.report.bench import Bench, describe
from mcrim_mitsuba.report.ratio import RatioCurve, ratio_curve
from mcrim_mitsuba.report.result import Efficiency, Quantity, efficiencies, quantities, to_json
from mcrim_mitsuba.report.sources import Source, source_of, sources_of
from mcrim_mitsuba.report.words import headline

#: Configurations whose light is followed, and photons of each.
MOST_LIGHTS, LIGHT_PHOTONS = 4, 400_000
_COUPLING = "n_gap"

Stage = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Story:
    """A campaign from its readings to its result.

    Attributes
    ----------
    campaign : Campaign
        As it came.
    repaired : Repaired
        What was found and what was done about it.
    quantities : dict of str to Quantity
        The result.
    efficiencies : tuple of Efficiency
        Of every reading's configuration.
    profiles : tuple of Profile
    ratio : RatioCurve or None
    bench : Bench
        With the effects that were added.
    lights : tuple of (str, Light)
        Of the couplings, by the label of a reading.
    sources : tuple of Source
        The files, as they were read.
    mended : tuple of Source
        Campaign and scene with the effects that were added; empty where none was.
    command : str
        What makes this report again.
    made : datetime
        In UTC.
    variant : str
    chosen_by_hand : bool
        Whether the effects are the user's choice.
    """

    campaign: Campaign
    repaired: Repaired
    quantities: dict[str, Quantity]
    efficiencies: tuple[Efficiency, ...]
    profiles: tuple[Profile, ...]
    ratio: RatioCurve | None
    bench: Bench
    lights: tuple[tuple[str, Light], ...]
    sources: tuple[Source, ...]
    mended: tuple[Source, ...]
    command: str
    made: datetime
    variant: str
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
    campaign, options = repaired.bench.campaign, repaired.bench.options
    with_effects = campaign.with_effects(repaired.effects)
    scene = scene_of_the_result(campaign, repaired.effects, calibration)
    stage("profile likelihoods")
    profiles = profiles_of(repaired.model, calibration)
    stage("picture of the bench")
    couplings = _couplings(campaign)
    # a filled gap shows what may be in it
    bench = describe(with_effects, scene, couplings[-1], options)
    return Story(
        campaign=campaign,
        repaired=repaired,
        quantities=quantities(calibration),
        efficiencies=efficiencies(repaired.model, calibration),
        profiles=profiles,
        ratio=ratio_curve(repaired.model, calibration),
        bench=bench,
        lights=_lights(couplings, scene, options, stage),
        sources=sources_of(campaign),
        mended=_mended(campaign, repaired),
        command=command,
        made=made,
        variant=options.variant,
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
    couplings: Sequence[Reading], scene: SceneFile, options: RunOptions, stage: Stage
) -> tuple[tuple[str, Light], ...]:
    lights = []
    for reading in couplings:
        stage("where the light goes")
        light = light_of(
            scene, reading.parameters, photons=LIGHT_PHOTONS, seed=options.seed,
            variant=options.variant, threads=options.threads,
        )  # fmt: skip
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


def _mended(campaign: Campaign, repaired: Repaired) -> tuple[Source, ...]:
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
