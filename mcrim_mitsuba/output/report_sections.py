"""What a report tells: everything measured, fitted and drawn, before it becomes a page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.lighting import Light, follow_light
from mcrim_mitsuba.inference.diagnose import Diagnosis
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.profiles import Profile, profiles_of
from mcrim_mitsuba.inference.repair import Repaired, mended_files, mended_scene, scene_text
from mcrim_mitsuba.output.findings import plain_headline
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
class Sections:
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
        return plain_headline(self.diagnosis, self.effects)

    def numbers(self) -> dict[str, Any]:
        """The result for JSON."""
        return to_json(self.quantities, self.efficiencies) | {
            "effects": list(self.effects),
            "calibration": self.calibration.to_json(),
            "files": {str(source.path): source.sha256 for source in self.sources},
            "command": self.command,
            "made": self.made.isoformat(timespec="seconds"),
        }


def gather(
    repaired: Repaired, *, command: str, made: datetime, chosen_by_hand: bool, stage: Stage
) -> Sections:
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
    return Sections(
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
    from mcrim_mitsuba.transport.simulation import Simulation

    lights = []
    for reading in couplings:
        stage("where the light goes")
        simulation = Simulation(scene, reading.parameters, variant=run.variant, threads=run.threads)
        own = replace(run, photons=LIGHT_PHOTONS, progress=None)
        light = follow_light(simulation, run=own)
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
