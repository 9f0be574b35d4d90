"""What a campaign knows: of one parameter, its start, bounds and prior; of the light yield."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import partial

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.calibration import CommonErrors, read_common_errors
from mcrim_mitsuba.campaign.entries import SCALE, choice, number_within
from mcrim_mitsuba.campaign.measurements import Measurements
from mcrim_mitsuba.core.errors import InputError, did_you_mean, said_by
from mcrim_mitsuba.core.numbers import THIN, Value, judge, parse_number, unit_of, value_text
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.laboratory.light_yield import fired_cells
from mcrim_mitsuba.optics.fresnel import reflectance
from mcrim_mitsuba.optics.materials import material
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Origin of the error of photoelectrons per channel.
PHOTOELECTRON_SCALE = "photoelectron scale"
# Standard errors outside the bounds that chance may take a measured prior.
_FARTHEST_PRIOR = 3.0
#: The same of bounds that nobody gives, on both sides of a prior.
_USUAL_SIGMAS = 5.0
#: Part of a value below which an error is none.
_ROUNDING = 1e-9
#: How names of scattering coefficients begin.
_SCATTERING = "alpha_scat"


@dataclass(frozen=True)
class CampaignParameter:
    """One ``[parameters.NAME]``, in the unit of its name."""

    #: A scene parameter, one of an effect, ``scale``, or a sample's own.
    name: str
    #: Where a fit begins and its bounds; these may be infinite.
    start: float
    minimum: float
    maximum: float
    _: KW_ONLY
    #: Gaussian knowledge from elsewhere, added to the statistic; both or none.
    prior: float | None = None
    prior_sigma: float | None = None
    #: Held at `start`.
    fixed: bool = False

    @property
    def knowledge(self) -> tuple[float, float] | None:
        """Prior and its standard error, of a parameter that is fitted; None without one."""
        if self.fixed or self.prior is None or self.prior_sigma is None:
            return None
        return self.prior, self.prior_sigma

    @property
    def logarithmic(self) -> bool:
        """Whether fits search it in its logarithm: eta changes with scattering over decades."""
        return self.name.startswith(_SCATTERING) and self.minimum > 0.0


#: What the catalogue says of a parameter, in the scene's terms: where its fit begins, None where
#: its effect is not switched on (at the scene's value), and its bounds.
KnownRange = tuple[float | None, float, float]


def known_ranges(
    catalogue: Mapping[str, Effect], switched_on: Iterable[str], values: Mapping[str, Value]
) -> dict[str, KnownRange]:
    """Parameters of the effects that are switched on or in the scene, by name.

    `values` are the scene's parameters, and the beam's.
    Raises KeyError if an effect that is switched on needs a parameter that the scene lacks.
    """
    ranges = {}
    for effect in catalogue.values():
        on = effect.name in switched_on
        for parameter in effect.parameters:
            # an index is offset from the scene's only where its effect is asked for
            if on or (parameter.nominal is None and parameter.name in values):
                start, low, high = parameter.range_in(values)
                ranges[parameter.name] = start if on else None, low, high
    return ranges


def read_parameter(
    document: TomlDocument,
    name: str,
    scene: SceneFile,
    values: Mapping[str, Value],
    measurements: Measurements,
    ranges: Mapping[str, KnownRange],
    within: str = "parameters",
) -> CampaignParameter:
    """Read ``[parameters.NAME]``, or NAME `within` another table, and check it beside the rest.

    What the table leaves out, or all if there is none: start and bounds are the catalogue's for
    parameters of effects (`ranges`); else the start is the scene's value, the bounds are the
    usual ones of such a quantity. `values` are the scene's parameters, and the beam's.

    Raises InputError with the line in the campaign file, if anything in it cannot be used.
    """
    key = f"{within}.{name}"
    if name != SCALE and name not in values and name not in ranges:
        problem = f"{name} is not a parameter of {scene.path.name}, nor of an effect in effects"
        raise document.refusal(key, problem, did_you_mean(name, [*values, *ranges, SCALE]))
    if name in measurements.columns:
        named = name in document.table(within)
        problem = f"{name} is fitted here and a column of {measurements.path.name}"
        mend = f"remove [{key}] or the column" if named else "remove the effect or the column"
        raise document.refusal(key if named else "effects", problem, mend)
    # raw entries are numbers by now; here they only serve the hint about a slip
    table = document.table(key, (*schema.PARAMETER, *dict(schema.RAW_TABLES).get(key, ())))
    fixed = table.get("fixed", False)
    if not isinstance(fixed, bool):
        raise table.refusal("fixed", "fixed is not true or false", "write fixed = true")
    numbers = {entry: table.number(entry) for entry in schema.PARAMETER if entry != "fixed"}
    given = {entry: number for entry, number in numbers.items() if number is not None}
    if ("prior" in given) != ("prior_sigma" in given):
        problem = f"{name} has only one of prior and prior_sigma"
        raise table.refusal("", problem, "give both or none")
    if fixed and "prior" in given:
        mend = f"remove one of them; start = {given['prior']:g} holds it there"
        raise table.refusal("fixed", f"{name} is held, and its prior would do nothing", mend)
    number_within(table, "prior_sigma", schema.PARAMETER)
    in_scene = values.get(name)
    if isinstance(in_scene, (bool, str)):
        problem = f"{name} is {value_text(in_scene)} in the scene, not a number"
        raise table.refusal("", problem, f"remove [{key}]")
    start, known_range = given.get("start"), ranges.get(name)
    if start is None and known_range is not None and known_range[0] is not None:
        start = max(given.get("min", -math.inf), min(known_range[0], given.get("max", math.inf)))
    start = next((s for s in (start, in_scene, given.get("prior")) if s is not None), None)
    if start is None:
        raise table.refusal("", f"{name} has no start value", "add start = ...")
    if fixed or ("min" in given and "max" in given):
        usual: tuple[float, float] | None = (-math.inf, math.inf)
    elif known_range is not None:
        usual = known_range[1:]
    else:
        usual = _usual_range(name, in_scene, given)
    if usual is None:
        problem = f"no range of {name} is known"
        raise table.refusal("", problem, "give min and max, or fixed = true")
    bounds = given.get("min", usual[0]), given.get("max", usual[1])
    if fixed and known_range is not None and known_range[0] is not None:
        bounds = known_range[1:]  # beyond, an effect is not simulated
    prior, prior_sigma = given.get("prior"), given.get("prior_sigma")
    parameter = CampaignParameter(
        name, float(start), *bounds, prior=prior, prior_sigma=prior_sigma, fixed=fixed
    )
    _refuse_what_lies_outside(table, parameter)
    return parameter


def _refuse_what_lies_outside(table: TomlTable, parameter: CampaignParameter) -> None:
    """Refuse bounds in the wrong order, and a prior or a start outside of them."""
    name, low, high = parameter.name, parameter.minimum, parameter.maximum
    start, prior = parameter.start, parameter.prior
    for side, bound in (("min", low), ("max", high)):
        if side in table and bound and (wrong := judge(name, bound)) is not None:
            raise table.refusal(side, f"{side} = {bound:g} of {name}: {wrong[1]}", wrong[2])
    if low >= high:
        raise table.refusal("min", f"min = {low:g} is not below max = {high:g}", "give min < max")
    if prior is not None and parameter.prior_sigma is not None:
        if parameter.prior_sigma < _ROUNDING * max(abs(prior), abs(start)):
            problem = f"prior_sigma = {parameter.prior_sigma:g} of {name} is lost in rounding"
            raise table.refusal("prior_sigma", problem, "write fixed = true to hold it")
        if max(low - prior, prior - high) / parameter.prior_sigma > _FARTHEST_PRIOR:
            away = f"{prior:g} ± {parameter.prior_sigma:g}, is far outside {low:g}..{high:g}"
            problem = f"the prior of {name}, {away}"
            mend = "check its sign and unit, or give other min and max"
            raise table.refusal("prior", problem, mend)
    if not low <= start <= high:
        # the prior may come from raw data, and its place with it
        what, mend = (
            (f"the prior of {name} is {prior:g},", "check what it comes from, or give")
            if prior == start
            else (f"start = {start:g} of {name} is", "move start, or give")
        )
        problem, mend = f"{what} outside {low:g}..{high:g}", f"{mend} other min and max"
        raise table.refusal("start", problem, "move start" if parameter.fixed else mend)
    if name == SCALE and parameter.fixed and start <= 0:
        problem = f"the scale is held at {start:g}: no signal would be above 0"
        raise table.refusal("start", problem, "give a number above 0, or fit it")


def _usual_range(
    name: str, in_scene: float | None, given: Mapping[str, float]
) -> tuple[float, float] | None:
    """Range of a free parameter for which the campaign gives none; None if nothing is known.

    A length that cannot vanish keeps near to its prior, or to the scene's: a bench that is none
    cannot be simulated.
    """
    if name == SCALE:
        return 0.0, math.inf
    if name.startswith(_SCATTERING) and unit_of(name) == "1/cm":
        # without any scattering the trapped light never comes out
        return 1e-3, 20.0
    if name.startswith("alpha_abs") and unit_of(name) == "1/cm":
        return 0.0, 1.0
    if name.startswith("n_"):
        return 1.0, 3.0
    if unit_of(name) == "mm" and in_scene:
        if judge(name, 0.0) is None:
            return 0.0, 10.0 * in_scene
        if "prior" in given:
            away = _USUAL_SIGMAS * given["prior_sigma"]
            return max(given["prior"] - away, 0.1 * in_scene), given["prior"] + away
        # how thick a film is nobody knows well
        most = 10.0 if any(word in name for word in THIN) else 2.0
        return in_scene / most, in_scene * most
    return None


@dataclass(frozen=True)
class LightYieldInput:
    """What turns the fitted scale into photons per keV."""

    #: Energy deposited per event.
    energy_keV: float
    #: Emission-weighted efficiency for light inside the window, a fraction, and its standard error;
    #: what is lost of its photoelectrons, or fires besides, included.
    detector_efficiency: float
    detector_efficiency_sigma: float
    #: That error by its origins, which add up in quadrature; empty where the campaign gives
    #: the efficiency as a number.
    efficiency_parts: dict[str, float] = field(default_factory=dict)
    _: KW_ONLY
    #: What the crystal is made of, as the catalogue of materials names it; None: not said.
    material: str | None = None
    #: How that efficiency came of the one that the campaign gives.
    detector: DetectorTerms | None = field(default=None, compare=False)

    @property
    def per_scale(self) -> float:
        """Photons per keV that a unit of the scale stands for."""
        return 1.0 / (self.energy_keV * self.detector_efficiency)

    @property
    def relative_sigma(self) -> float:
        """Of the light yield, by the detector's efficiency."""
        return self.detector_efficiency_sigma / self.detector_efficiency


@dataclass(frozen=True)
class DetectorTerms:
    """What the efficiency of ``[light_yield]`` refers to, and what becomes of photoelectrons."""

    #: Part of head-on light that the window reflects (Fresnel); 0 without a window of one index.
    window_reflectance: float
    #: Whether the efficiency was measured in air, head-on, so that it contains that reflection;
    #: else it is a part of the light inside the window.
    in_air: bool
    #: Whether the campaign says so itself.
    explicit: bool
    #: Part of the photoelectrons that are collected at the first dynode and pass the threshold,
    #: None where the campaign does not say it: 1; and its standard error.
    collection: float | None
    _: KW_ONLY
    collection_sigma: float
    #: Cells of a silicon photomultiplier that fire for each photoelectron, with crosstalk and
    #: afterpulses, None where the campaign does not say it: 1; and the relative standard error.
    cells: float | None
    cells_sigma: float
    #: Relative error of the efficiency that all samples share; 0 where none is named.
    shared_sigma: float
    #: What all readings of light share by the calibration of channels.
    common: CommonErrors

    @property
    def relative_sigma(self) -> float:
        """Relative standard error of what becomes of photoelectrons."""
        return math.hypot(*self.parts.values())

    @property
    def parts(self) -> dict[str, float]:
        """`relative_sigma` by its origins, which add up in quadrature."""
        return {
            schema.COLLECTION: self.collection_sigma / (self.collection or 1.0),
            schema.CROSSTALK: self.cells_sigma,
            PHOTOELECTRON_SCALE: self.common.scale_sigma,
        }

    @property
    def factor(self) -> float:
        """What is counted of light inside the window, over the efficiency that a campaign gives."""
        collection, cells = self.collection or 1.0, self.cells or 1.0
        return collection * cells / (1.0 - self.window_reflectance * self.in_air)

    @property
    def notes(self) -> Iterator[str]:
        """What the reader must know of the absolute light yield."""
        if self.window_reflectance and not self.explicit:
            percent = f"{100 * self.window_reflectance:.3g} %"
            yield (
                "the detector's efficiency counts as measured in air, head-on: it contains the "
                f"{percent} that the window reflects, and the light yield is lower by that"
                if self.in_air
                else "by the article's convention the detector's efficiency is that inside the "
                f"window; measured in air it contains the {percent} that the window reflects, and "
                "the light yield is too high by that"
            )
        if self.collection is None and self.cells is None:
            yield (
                f"{schema.COLLECTION} is not given and counts as 1: photoelectrons that are not "
                "counted (lost at a first dynode, below a threshold: 5 to 20 %) make the light "
                "yield higher, afterpulses and crosstalk lower"
            )


def read_light_yield(
    document: TomlDocument,
    detector: DetectorTerms,
    key: str = schema.YIELD_TABLE,
    entries: schema.Entries = schema.CAMPAIGN,
    *,
    own_scales: bool = True,
    parts: Mapping[str, float] | None = None,
) -> LightYieldInput | None:
    """``[light_yield]``, or the one of a sample, as its detector sees it; None without one.

    Where samples have `own_scales`, without the errors that they share. `entries` has those of the
    table, and `parts` the efficiency's errors by origin.

    Raises InputError with the line, if an entry is unknown, missing or impossible.
    """
    # raw entries are numbers by now; here they only serve the hint about a slip
    table = document.table(key, entries[schema.YIELD_TABLE]["properties"])
    if schema.YIELD_TABLE not in document.table(key.removesuffix(schema.YIELD_TABLE).rstrip(".")):
        return None
    energy, efficiency, sigma = map(table.number, schema.YIELD)
    if energy is None or efficiency is None:
        problem = f"[{key}] needs energy_keV and detector_efficiency"
        raise table.refusal("", problem, "add the missing one or remove the table")
    for name in schema.YIELD:
        number_within(table, name, schema.YIELD)
    crystal = None
    if "material" in table:
        with said_by(partial(table.refusal, "material")):
            crystal = material(str(table["material"])).name
    name, sigma = "detector_efficiency_sigma", sigma or 0.0
    if sigma > efficiency:
        problem = f"{name} = {sigma:g} is more than the efficiency {efficiency:g}"
        raise table.refusal(name, problem, "write both as parts of 1, not %")
    if shared := detector.shared_sigma:
        common = shared * efficiency
        if not own_scales:
            problem = "no sample has a scale of its own, and shares the efficiency's error"
            mend = "remove it: it is a part of detector_efficiency_sigma"
            raise table.refusal(schema.SHARED_SIGMA, problem, mend)
        if common > sigma:
            problem = f"{name} is less than the {100 * shared:g} % that samples share"
            mend = f"it is the whole error: give more than {common:.2g}"
            raise table.refusal(name, problem, mend)
        parts, sigma = None, math.sqrt(sigma**2 - common**2)
    efficiency, sigma = detector.factor * efficiency, detector.factor * sigma
    errors = {origin: detector.factor * part for origin, part in (parts or {}).items()}
    if detector.relative_sigma and not own_scales:
        errors = errors or {"detector_efficiency": sigma}
        parts = {name: part * efficiency for name, part in detector.parts.items() if part}
        errors |= parts
        sigma = math.hypot(sigma, *parts.values())
    return LightYieldInput(energy, efficiency, sigma, errors, material=crystal, detector=detector)


def read_detector(
    document: TomlDocument, scene: SceneFile, measurements: Measurements
) -> DetectorTerms:
    """What ``[light_yield]``, the scene of the window and ``[calibration]`` say of the detector.

    Raises InputError with the line.
    """
    table = document.table(schema.YIELD_TABLE)
    known: dict[str, tuple[float | None, float]] = {}
    for name in (schema.COLLECTION, schema.CROSSTALK, schema.AFTERPULSING):
        both = (name, f"{name}_sigma")
        value, sigma = (number_within(table, entry, schema.DETECTOR) for entry in both)
        if sigma is not None and value is None:
            problem = f"{name}_sigma without {name}"
            raise table.refusal(f"{name}_sigma", problem, f"add {name}, or remove it")
        known[name] = value, sigma or 0.0
    collection, sigma = known.pop(schema.COLLECTION)
    cells, cells_sigma = None, 0.0
    if any(value is not None for value, _ in known.values()):
        numbers = (number or 0.0 for pair in known.values() for number in pair)
        cells, cells_sigma = fired_cells(*numbers)
    of_article = document.content.get(schema.CONVENTION) == schema.ARTICLE
    given = choice(table, schema.EFFICIENCY_OF, schema.DETECTOR)
    usual = schema.IN_WINDOW if of_article else schema.IN_AIR
    return DetectorTerms(
        float(reflectance(1.0, 1.0, _window_index(document, scene, measurements))),
        (given or usual) == schema.IN_AIR,
        given is not None,
        collection,
        collection_sigma=sigma,
        cells=cells,
        cells_sigma=cells_sigma,
        shared_sigma=number_within(table, schema.SHARED_SIGMA, schema.SHARED) or 0.0,
        common=read_common_errors(document),
    )


def _window_index(document: TomlDocument, scene: SceneFile, measurements: Measurements) -> float:
    """Index before the detectors, as the campaign has it; 1 where that is no window, or several."""
    editor = SceneEditor(scene, {})
    try:
        name, *others = {editor.index_before(detector) for detector in editor.detectors}
        name = name.removeprefix("$")
        on_crystal = any(editor.crystal in editor.before(detector) for detector in editor.detectors)
        if others or on_crystal or name in measurements.columns:
            return 1.0
        start = document.table(f"parameters.{name}").number("start")
        value = scene.parameters.get(name, name) if start is None else start
        return max(parse_number(name, str(value)), 1.0)
    except InputError:  # there is air, or no detector; others say what is wrong with the scene
        return 1.0
