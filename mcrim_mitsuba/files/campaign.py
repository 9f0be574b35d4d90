"""Reads a campaign: a scene, its measurements and what is known beforehand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign_parameter import SCALE, CampaignParameter, read_parameter
from mcrim_mitsuba.files.limits import judge
from mcrim_mitsuba.files.measurements import Measurements, read_measurements
from mcrim_mitsuba.files.scene_xml import SceneFile, read_scene
from mcrim_mitsuba.files.toml_document import TomlDocument, read_toml

_ENTRIES = (
    "scene",
    "measurements",
    "effects",
    "effects_folder",
    "parameters",
    "light_yield",
    "next_measurements",
)
_LIGHT_YIELD_ENTRIES = ("energy_keV", "detector_efficiency", "detector_efficiency_sigma")


@dataclass(frozen=True)
class LightYieldInput:
    """What turns the fitted scale into photons per keV.

    Attributes
    ----------
    energy_keV : float
        Energy deposited per event.
    detector_efficiency, detector_efficiency_sigma : float
        Emission-weighted efficiency, a fraction, and its standard error.
    """

    energy_keV: float
    detector_efficiency: float
    detector_efficiency_sigma: float


@dataclass(frozen=True)
class Campaign:
    """A campaign file with the files it names, all checked against each other.

    Attributes
    ----------
    path : Path
        The file.
    scene : SceneFile
        At the scene's own values.
    measurements : Measurements
        The readings.
    parameters : dict of str to CampaignParameter
        Scene parameters that the campaign names, `scale` not among them.
    scale : CampaignParameter or None
        The common scale; None where the campaign says nothing: free, without a prior.
    effects : tuple of str
        Effects switched on.
    effects_folder : Path or None
        Folder of the user's own effects.
    light_yield : LightYieldInput or None
        None: the scale is not turned into a light yield.
    next_measurements : dict
        What may be proposed next, as in the file.
    """

    path: Path
    scene: SceneFile
    measurements: Measurements
    parameters: dict[str, CampaignParameter]
    scale: CampaignParameter | None
    effects: tuple[str, ...]
    effects_folder: Path | None
    light_yield: LightYieldInput | None
    next_measurements: dict[str, Any]

    @property
    def free(self) -> tuple[str, ...]:
        """Names that the fit varies, ``scale`` last."""
        free = tuple(name for name, known in self.parameters.items() if not known.fixed)
        return free if self.scale is not None and self.scale.fixed else (*free, SCALE)

    @property
    def priors(self) -> tuple[str, ...]:
        """Names of the free parameters that have a prior."""
        named = {**self.parameters, SCALE: self.scale}
        return tuple(n for n in self.free if named[n] is not None and named[n].prior is not None)

    @property
    def ndf(self) -> int:
        """Degrees of freedom: readings in use + priors - free parameters."""
        return len(self.measurements.in_use) + len(self.priors) - len(self.free)


def read_campaign(path: str | Path) -> Campaign:
    """Read a campaign file, its scene and its measurements, and check them together.

    Raises
    ------
    InputError
        If one of the files cannot be used, if an entry is unknown or impossible, or if there
        are more free parameters than readings in use and priors.
    """
    _refuse_scene(Path(path))
    document = read_toml(Path(path))
    content = document.table("", _ENTRIES)
    _refuse_effects(document, content)
    scene = read_scene(_sibling(document, "scene"))
    measurements = read_measurements(_sibling(document, "measurements"), scene.parameters)
    _refuse_rows_the_scene_cannot_take(scene, measurements)
    parameters = {
        name: read_parameter(document, name, scene, measurements)
        for name in document.table("parameters")
    }
    scale = parameters.pop(SCALE, None)
    campaign = Campaign(
        path=document.path,
        scene=scene,
        measurements=measurements,
        parameters=parameters,
        scale=scale,
        effects=(),
        effects_folder=_folder(document),
        light_yield=_read_light_yield(document),
        next_measurements=dict(document.table("next_measurements")),
    )
    _refuse_too_few_readings(campaign)
    return campaign


def _refuse_scene(path: Path) -> None:
    """A scene alone cannot be fitted: the readings are missing."""
    if path.suffix.lower() == ".xml" and path.is_file():
        raise InputError(
            "this is a scene, not a campaign",
            f'name a campaign (.toml) with scene = "{path.name}" and its measurements',
            path=path,
        )


def _path_entry(document: TomlDocument, name: str) -> Path:
    """Path in an entry, relative to the campaign file."""
    given = document.content[name]
    if not isinstance(given, str) or not given:
        raise document.refusal(name, f"{name} is not a path", f'write {name} = "..."')
    return document.path.parent / given


def _sibling(document: TomlDocument, name: str) -> Path:
    """Path of the scene or the measurements, which must exist."""
    if name not in document.content:
        raise document.refusal(
            "", f"the campaign names no {name}", f'add {name} = "..." at the top'
        )
    path = _path_entry(document, name)
    if not path.exists():
        raise document.refusal(
            name, f"{path} does not exist", "paths are relative to the campaign file"
        )
    return path


def _folder(document: TomlDocument) -> Path | None:
    """The folder of the user's own effects."""
    if "effects_folder" not in document.content:
        return None
    path = _path_entry(document, "effects_folder")
    if not path.is_dir():
        raise document.refusal(
            "effects_folder", f"{path} is not a folder", "paths are relative to the campaign file"
        )
    return path


def _refuse_effects(document: TomlDocument, content: dict[str, Any]) -> None:
    """Effects need the catalogue, which this version does not have."""
    effects = content.get("effects", [])
    if not isinstance(effects, list) or not all(isinstance(effect, str) for effect in effects):
        raise document.refusal("effects", "effects is not a list of names", "write effects = []")
    if effects:
        raise document.refusal(
            "effects",
            f"effects names {', '.join(effects)}, but the catalogue of effects is not part of "
            "this version",
            "write effects = []",
        )


def _refuse_rows_the_scene_cannot_take(scene: SceneFile, measurements: Measurements) -> None:
    """Put every row's parameters into the scene once; a refusal names the row, not the scene."""
    for reading in measurements.readings:
        for name, value in reading.parameters.items():
            if isinstance(value, (bool, str)) or (wrong := judge(name, value)) is None:
                continue
            raise InputError(
                f"{name} = {value:g}: {wrong[1]}", wrong[2],
                path=measurements.path, line=reading.line, column=name,
            )  # fmt: skip
        try:
            scene.with_overrides(reading.parameters)
        except InputError as error:
            raise InputError(
                error.problem, error.mend, path=measurements.path, line=reading.line
            ) from None


def _read_light_yield(document: TomlDocument) -> LightYieldInput | None:
    """``[light_yield]``, or None without one."""
    key = "light_yield"
    if key not in document.content:
        return None
    document.table(key, _LIGHT_YIELD_ENTRIES)
    energy, efficiency, sigma = (document.number(key, name) for name in _LIGHT_YIELD_ENTRIES)
    if energy is None or efficiency is None:
        raise document.refusal(
            key,
            "[light_yield] needs energy_keV and detector_efficiency",
            "add the missing one or remove the table",
        )
    if energy <= 0:
        raise document.refusal(
            f"{key}.energy_keV", f"energy_keV = {energy:g} is not above 0", "give keV per event"
        )
    if not 0 < efficiency <= 1:
        raise document.refusal(
            f"{key}.detector_efficiency",
            f"detector_efficiency = {efficiency:g} is not above 0 and at most 1",
            "give a fraction: 0.127 for 12.7 %",
        )
    if sigma is not None and sigma < 0:
        raise document.refusal(
            f"{key}.detector_efficiency_sigma",
            f"detector_efficiency_sigma = {sigma:g} is negative",
            "give the standard error of detector_efficiency",
        )
    return LightYieldInput(energy, efficiency, sigma or 0.0)


def _refuse_too_few_readings(campaign: Campaign) -> None:
    """A fit with more unknowns than facts has no answer."""
    if campaign.ndf >= 0:
        return
    free = _counted(len(campaign.free), "free parameter")
    readings = _counted(len(campaign.measurements.in_use), "reading")
    raise InputError(
        f"{free} ({', '.join(campaign.free)}) but {readings} in use and "
        f"{_counted(len(campaign.priors), 'prior')}",
        "add readings or priors, or hold a parameter with fixed = true",
        path=campaign.path,
    )


def _counted(number: int, what: str) -> str:
    """``1 reading``, ``2 readings``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
