"""One parameter of a campaign: where its fit starts, its bounds and what is known of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mcrim_mitsuba.campaign.measurements import Measurements
from mcrim_mitsuba.campaign.raw_data import RAW_TABLES
from mcrim_mitsuba.core.errors import did_you_mean
from mcrim_mitsuba.core.numbers import Value, unit_of, value_text
from mcrim_mitsuba.core.toml_document import TomlDocument
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.scene_file import SceneFile

# signal of a reading / eta: light yield x energy x detector efficiency
SCALE = "scale"

_PARAMETER_ENTRIES = ("start", "min", "max", "prior", "prior_sigma", "fixed")


@dataclass(frozen=True)
class CampaignParameter:
    """One ``[parameters.NAME]``, in the unit of its name."""

    #: A scene parameter, one of an effect, or ``scale``.
    name: str
    #: Where a fit begins and its bounds; these may be infinite.
    start: float
    minimum: float
    maximum: float
    #: Gaussian knowledge from elsewhere, added to the statistic; both or none.
    prior: float | None
    prior_sigma: float | None
    #: Held at `start`.
    fixed: bool


@dataclass(frozen=True)
class KnownRange:
    """What the catalogue says of a parameter, in the scene's terms."""

    #: Where its fit begins; None where its effect is not switched on: at the scene's value.
    start: float | None
    minimum: float
    maximum: float


def known_ranges(
    catalogue: Mapping[str, Effect], switched_on: Iterable[str], scene: SceneFile
) -> dict[str, KnownRange]:
    """Parameters of the effects that are switched on or in the scene, by name.

    Raises
    ------
    KeyError
        If an effect that is switched on needs a parameter that the scene lacks.
    """
    found = {}
    for effect in catalogue.values():
        on = effect.name in switched_on
        for parameter in effect.parameters:
            # an index is offset from the scene's only where its effect is asked for
            if on or (parameter.nominal is None and parameter.name in scene.parameters):
                found[parameter.name] = _known_range(parameter, on, scene)
    return found


def _known_range(parameter: EffectParameter, on: bool, scene: SceneFile) -> KnownRange:
    # without the noise of binary sums: 2.01 + 0.03 is 2.04
    start, low, high = (round(value, 12) for value in parameter.range_in(scene.parameters))
    return KnownRange(start if on else None, low, high)


def read_parameter(
    document: TomlDocument,
    name: str,
    scene: SceneFile,
    measurements: Measurements,
    known: Mapping[str, KnownRange],
) -> CampaignParameter:
    """Read ``[parameters.NAME]`` and check it by itself and against scene and columns.

    What the table leaves out, or all if there is none: start and bounds are the catalogue's for
    parameters of effects (`known`); else the start is the scene's value, the bounds are the
    usual ones of such a quantity.

    Raises
    ------
    InputError
        With the line in the campaign file, if anything in it cannot be used.
    """
    key = f"parameters.{name}"
    own = known.get(name)
    if name != SCALE and name not in scene.parameters and own is None:
        raise document.refusal(
            key,
            f"{name} is not a parameter of {scene.path.name}, nor of an effect in effects",
            did_you_mean(name, [*scene.parameters, *known, SCALE]),
        )
    if name in measurements.columns:
        named = name in document.table("parameters")
        raise document.refusal(
            key if named else "effects",
            f"{name} is fitted here and a column of {measurements.path.name}",
            f"remove [{key}] or the column" if named else "remove the effect or the column",
        )
    # raw entries are numbers by now; here they only serve the hint about a slip
    table = document.table(key, (*_PARAMETER_ENTRIES, *dict(RAW_TABLES).get(key, ())))
    fixed = table.get("fixed", False)
    if not isinstance(fixed, bool):
        raise document.refusal(f"{key}.fixed", "fixed is not true or false", "write fixed = true")
    numbers = {entry: document.number(key, entry) for entry in _PARAMETER_ENTRIES[:-1]}
    prior, prior_sigma = numbers["prior"], numbers["prior_sigma"]
    if (prior is None) != (prior_sigma is None):
        raise document.refusal(
            key, f"{name} has only one of prior and prior_sigma", "give both or none"
        )
    if prior_sigma is not None and prior_sigma <= 0:
        raise document.refusal(
            f"{key}.prior_sigma",
            f"prior_sigma = {prior_sigma:g} is not above 0",
            "give the prior's standard error, or fixed = true to hold the parameter",
        )
    in_scene = scene.parameters.get(name)
    if own is not None and own.start is not None and numbers["start"] is None:
        numbers["start"] = _within(own.start, numbers["min"], numbers["max"])
    start = _start(document, key, numbers, in_scene)
    usual = _usual_range(name, in_scene) if own is None else (own.minimum, own.maximum)
    minimum, maximum = _bounds(document, key, numbers, (-math.inf, math.inf) if fixed else usual)
    if minimum >= maximum:
        raise document.refusal(
            f"{key}.min", f"min = {minimum:g} is not below max = {maximum:g}", "give min < max"
        )
    if prior == start and not minimum <= start <= maximum:
        # the prior may come from raw data, and its place with it
        raise document.refusal(
            f"{key}.start",
            f"the prior of {name} is {prior:g}, outside {minimum:g}..{maximum:g}",
            "check what it comes from, or give other min and max",
        )
    if not minimum <= start <= maximum:
        raise document.refusal(
            f"{key}.start",
            f"start = {start:g} of {name} is outside {minimum:g}..{maximum:g}",
            "move start, or give other min and max",
        )
    return CampaignParameter(name, start, minimum, maximum, prior, prior_sigma, fixed)


def _within(start: float, minimum: float | None, maximum: float | None) -> float:
    """The catalogue's start, moved into bounds of the campaign that leave it out."""
    low = -math.inf if minimum is None else minimum
    return max(low, min(start, math.inf if maximum is None else maximum))


def _start(
    document: TomlDocument, key: str, numbers: dict[str, float | None], in_scene: Value | None
) -> float:
    """Start value: the campaign's, else the scene's; the scale has none in the scene."""
    name = key.rpartition(".")[2]
    if isinstance(in_scene, (bool, str)):
        raise document.refusal(
            key, f"{name} is {value_text(in_scene)} in the scene, not a number", f"remove [{key}]"
        )
    if numbers["start"] is not None:
        return numbers["start"]
    start = in_scene if in_scene is not None else numbers["prior"]
    if start is None:
        raise document.refusal(key, f"{name} has no start value", "add start = ...")
    return float(start)


def _bounds(
    document: TomlDocument,
    key: str,
    numbers: dict[str, float | None],
    usual: tuple[float, float] | None,
) -> tuple[float, float]:
    """Bounds: the campaign's, each completed by the usual one."""
    name = key.rpartition(".")[2]
    lowest, highest = numbers["min"], numbers["max"]
    if lowest is not None and highest is not None:
        return lowest, highest
    if usual is None:
        raise document.refusal(
            key, f"no range of {name} is known", "give min and max, or fixed = true"
        )
    return lowest if lowest is not None else usual[0], highest if highest is not None else usual[1]


def _usual_range(name: str, in_scene: Value | None) -> tuple[float, float] | None:
    """Range of a free parameter for which the campaign gives none; None if nothing is known."""
    if name == SCALE:
        return 0.0, math.inf
    if name.startswith("alpha_scat") and unit_of(name) == "1/cm":
        # without any scattering the trapped light never comes out
        return 1e-3, 20.0
    if name.startswith("alpha_abs") and unit_of(name) == "1/cm":
        return 0.0, 1.0
    if name.startswith("n_"):
        return 1.0, 3.0
    if unit_of(name) == "mm" and in_scene:
        return 0.0, 10.0 * float(in_scene)
    return None


# ``[light_yield]`` of a campaign: what turns the fitted scale into photons per keV.

_YIELD_ENTRIES = ("energy_keV", "detector_efficiency", "detector_efficiency_sigma")


@dataclass(frozen=True)
class LightYieldInput:
    """What turns the fitted scale into photons per keV."""

    #: Energy deposited per event.
    energy_keV: float
    #: Emission-weighted efficiency, a fraction, and its standard error.
    detector_efficiency: float
    detector_efficiency_sigma: float
    #: That error by its origins, which add up in quadrature; empty where the campaign gives
    #: the efficiency as a number.
    efficiency_parts: dict[str, float] = field(default_factory=dict)

    @property
    def per_scale(self) -> float:
        """Photons per keV that a unit of the scale stands for."""
        return 1.0 / (self.energy_keV * self.detector_efficiency)


def read_light_yield(document: TomlDocument) -> LightYieldInput | None:
    """``[light_yield]``, or None without one.

    Raises
    ------
    InputError
        With the line, if an entry is unknown, missing or impossible.
    """
    key = "light_yield"
    if key not in document.content:
        return None
    # raw entries are numbers by now; here they only serve the hint about a slip
    document.table(key, (*_YIELD_ENTRIES, *dict(RAW_TABLES)[key]))
    energy, efficiency, sigma = (document.number(key, name) for name in _YIELD_ENTRIES)
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
