"""Mend a campaign: diagnose it, add what is missing, write the campaign to go on from."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.campaign.editor import campaign_with_effects
from mcrim_mitsuba.campaign.entries import LONGEST_REMARK, TO_QUOTE
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import is_there, read_text, refuse_to_replace, write_text
from mcrim_mitsuba.core.rounding import probability
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.inference.diagnose import Diagnosis, RepairStep, diagnose
from mcrim_mitsuba.inference.fit import Calibration, UndeterminedError
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Digits of the values that are written into scene and campaign.
_DIGITS = 6
#: How a mended campaign begins.
_MENDED = "# Mended: "
_LIMIT_MB = 10


@dataclass(frozen=True, kw_only=True)
class Repaired:
    """A mended campaign."""

    diagnosis: Diagnosis
    #: Those that were added; none where the campaign was adequate or nothing explains it.
    effects: tuple[str, ...]
    #: Of the mended campaign, its effects simulated together where the fit ends.
    fit: Calibration
    #: What was written; None where nothing was added.
    campaign_path: Path | None
    scene_path: Path | None
    #: Of everything.
    provenance: Provenance
    #: On which it was done: makes further models.
    simulations: CampaignSimulations
    #: Why nothing was added although the verdict names an effect: what is not determined with it.
    undetermined: str = ""


def repair(
    campaign: str | Path | Campaign,
    output: str | Path | None = None,
    *,
    effect: Sequence[str] = (),
    run: Run = Run(),
    on_step: Callable[[RepairStep], None] | None = None,
) -> Repaired:
    """Add effects to a campaign one by one while the data justify it.

    Parameters as of the public function `repair`. Without `output` nothing is written, and files
    that hold anything else are not replaced.

    Raises InputError as for `diagnose`, or if the files cannot be written.
    """
    simulations = CampaignSimulations(as_campaign(campaign), run)
    if output is not None:  # before all work: its scene may lack parts in that folder
        text_for_folder(simulations.campaign.scene, Path(output).parent)
    diagnosis = diagnose(simulations, adding=effect)
    steps = diagnosis.repair
    for step in steps:
        if on_step is not None:
            on_step(step)
    effects = steps[-1].effects  # of the campaign as it came, if nothing was added
    fit, undetermined = simulations.fit(), ""
    if effects:
        starts = {name: estimate.value for name, estimate in steps[-1].parameters.items()}
        try:
            simulations.simulate(effects)  # at all sizes, as the mended campaign will be
            fit = simulations.settled_fit(effects, starts)
        except UndeterminedError as refusal:
            if effect:
                raise
            effects, undetermined = (), refusal.problem
    campaign_path = scene_path = None
    if effects and output is not None:
        campaign_path = Path(output)
        remarks = remarks_on(diagnosis, effects)
        scene_path = write_mended(simulations.campaign, fit, campaign_path, remarks)
    return Repaired(
        diagnosis=diagnosis,
        effects=effects,
        fit=fit,
        campaign_path=campaign_path,
        scene_path=scene_path,
        provenance=simulations.provenance(),
        simulations=simulations,
        undetermined=undetermined,
    )


def write_mended(
    campaign: Campaign, fit: Calibration, target: Path, remarks: Mapping[str, str] | None = None
) -> Path:
    """Write scene and campaign, with `remarks_on` a diagnosis; returns the scene's path."""
    scene_path = target.with_suffix(".xml")
    if scene_path.resolve() == campaign.scene.path.resolve():
        problem = f"the mended scene would replace {campaign.scene.path}"
        raise InputError(problem, "give -o another name", path=target)
    scene, text = mended_files(campaign, fit, target, remarks)
    # the campaign first: it tells that it was made here, if its scene is missing
    texts = {target: text, scene_path: text_for_folder(scene, target.parent)}
    refuse_to_replace(texts)
    for path, content in texts.items():
        write_text(path, content)
    return scene_path


def refuse_others_work(target: Path) -> None:
    """Refuse places that hold what no repair has written, before any work is done.

    What one has written may be there: `repair` goes on if it comes to the very same.

    Raises InputError if the campaign, or a scene without it, is there.
    """
    with contextlib.suppress(InputError):
        if read_text(target, _LIMIT_MB).startswith(_MENDED):
            return
    for path in (target, target.with_suffix(".xml")):
        if is_there(path):
            problem = "this file exists already"
            raise InputError(problem, "name another, or remove it first", path=path)


def mended_files(
    campaign: Campaign, fit: Calibration, target: Path, remarks: Mapping[str, str] | None = None
) -> tuple[SceneFile, str]:
    """The mended scene and the text of the mended campaign; nothing is written.

    The fit is of the campaign with more effects switched on, and its values are put into both, to
    six digits. The campaign is meant to go to `target`, its scene beside it under the same name;
    `remarks` are as of `remarks_on`.
    """
    mended = fit.model.campaign
    fitted = rounded({name: estimate.value for name, estimate in fit.parameters.items()})
    effects = mended.effects[len(campaign.effects) :]
    starts = {name: fitted[name] for name in fit.names if name in fitted}
    scene = target.with_suffix(".xml")
    text = campaign_with_effects(mended, target, scene, starts, remarks=remarks)
    added = f"{_MENDED}{' and '.join(effects)} added.\n"
    return mended_scene(campaign, effects, fitted), added + text


def remarks_on(diagnosis: Diagnosis, effects: Sequence[str]) -> dict[str, str]:
    """What a campaign that was mended so says of it, by key: other models are possible.

    The remark follows the campaign's own, and the light yield to quote is that of the first repair.
    """
    campaign = diagnosis.baseline.model.campaign
    averaged, words = diagnosis.light_yield_averaged, []
    if len(diagnosis.leading_sets) > 1:
        words.append(f"the first of {len(diagnosis.leading_sets)} explanations that lead")
    chance = diagnosis.probabilities.get(" + ".join(effects))
    if chance is not None:
        words.append(f"probability {probability(chance)}")
    names = " and ".join(diagnosis.titles.get(name, name) for name in effects)
    sentence = f"{names} {'were' if len(effects) > 1 else 'was'} added by repair"
    sentence += f" ({', '.join(words)})" if words else ""
    sentence += ": what a fit of this file gives holds for this one model"
    users = campaign.remark[: LONGEST_REMARK - len(sentence) - 2]
    remarks = {"remark": "; ".join(filter(None, (users, sentence)))}
    if averaged is not None and not campaign.yield_to_quote:
        remarks[TO_QUOTE] = str(averaged)
    return remarks


def mended_scene(
    campaign: Campaign, effects: Sequence[str], values: Mapping[str, float]
) -> SceneFile:
    """A campaign's scene with more effects in it than its own, and with other values.

    Effects of the readings are left out. Values are by scene parameter, those of the effects
    included; what is none is left out. Sizes that are tied follow.
    """
    scene = campaign.scene
    values = {**values, **{name: values[of] for name, of in campaign.ties.items() if of in values}}
    for name in effects:
        effect = campaign.catalogue[name]
        if effect.edit is not None:
            own = {p.name: values[p.name] for p in effect.parameters}
            scene = scene.edited(add(effect, scene, own))
    changed = {
        name: value
        for name, value in values.items()
        if name in campaign.scene.parameters and scene.parameters[name] != value
    }
    if not changed:
        return scene
    editor = SceneEditor(scene, {})
    for name, value in changed.items():
        editor.set_default(name, value)
    return scene.edited(editor.finished())


def rounded(values: Mapping[str, float]) -> dict[str, float]:
    """Values as they are written into scenes and campaigns."""
    return {name: float(f"{value:.{_DIGITS}g}") for name, value in values.items()}


def scene_text(scene: SceneFile) -> str:
    """The text of a scene, written or not."""
    return scene.unwritten_text or scene.source(scene.path).decode()


def text_for_folder(scene: SceneFile, folder: Path) -> str:
    """The text of a scene in a folder, from which the spectra of its indices are found.

    Raises InputError if parts or meshes that it names are not.
    """
    indices = scene.materials.items()
    spectra = {n: (of.material.name, of.emission) for n, of in indices if of.emission is not None}
    if folder.resolve() == scene.path.parent.resolve():
        return scene_text(scene)
    named = {str(e.get("filename") or e.get("value")) for e, _ in scene.naming()}
    named |= {file.name for file in scene.included} - {path.name for _, path in spectra.values()}
    if lost := sorted(name for name in named if not Path(name).is_absolute()):
        problem = f"the scene names {lost[0]}, which is not found from another folder"
        raise InputError(problem, f"write the new one into {scene.path.parent}", path=scene.path)
    editor = SceneEditor(scene, {})
    for name, (material, emission) in spectra.items():
        path = Path(os.path.relpath(emission, folder)).as_posix()
        editor.set_default(name, f"{material}@{path}")
    return editor.finished()
