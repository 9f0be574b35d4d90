"""What the page's controls move, and what its session holds: plain, frozen, replaced as a whole."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.campaign.samples import of_sample
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.numbers import COEFFICIENTS, Value, said, unit_of, without_unit
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.efficiency.responses import Anchor
from mcrim_mitsuba.inference.diagnose import Diagnosis
from mcrim_mitsuba.inference.estimates import FittedRow
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.model import UNKNOWN_SCALE
from mcrim_mitsuba.output.sentences import quantity

#: Smallest value of a slider that runs along a logarithm, as part of the largest.
_LEAST_PART = 1e-3
#: Changes that can be undone.
_MOST_UNDONE = 50
#: Seconds after which another move of the same control is undone by itself.
_PAUSE_S = 1.0

#: What a fit does with a parameter: varies it, holds it, or varies it with a prior.
FREE = "free"
HELD = "held"
PRIOR = "prior"


@dataclass(frozen=True)
class Known:
    """What a fit may take for granted of a parameter."""

    how: str = FREE
    #: Value and standard error; both or none.
    prior: float | None = None
    prior_sigma: float | None = None

    @property
    def gaussian(self) -> tuple[float, float] | None:
        """The prior, where it counts."""
        if self.how != PRIOR or self.prior is None or self.prior_sigma is None:
            return None
        return self.prior, self.prior_sigma

    def of(self, parameter: CampaignParameter, value: float) -> CampaignParameter:
        """The parameter so known; what is held stays at `value`."""
        prior, sigma = self.gaussian or (None, None)
        held = self.how == HELD
        start = value if held else parameter.start
        return replace(parameter, start=start, prior=prior, prior_sigma=sigma, fixed=held)


def known_of(parameter: CampaignParameter | None) -> Known:
    """What a campaign says of its parameter; None where it says nothing."""
    if parameter is None:
        return Known()
    how = HELD if parameter.fixed else FREE if parameter.prior is None else PRIOR
    return Known(how, parameter.prior, parameter.prior_sigma)


@dataclass(frozen=True, kw_only=True)
class Control:
    """A number with a slider."""

    #: The parameter's.
    name: str
    #: What it is called on the page.
    title: str
    unit: str
    minimum: float
    maximum: float
    start: float
    #: In what the slider is even: ``linear``, ``reciprocal`` (1 / (value + scale)) or
    #: ``logarithmic`` (log(1 + value / scale)).
    coordinate: str = "linear"
    scale: float = 1.0
    meaning: str = ""
    #: What the campaign says of it.
    known: Known = Known()


def parameter_control(
    parameter: CampaignParameter, meaning: str, covered: tuple[float, float] | None = None
) -> Control:
    """The control of a parameter that the campaign names, over what simulations have `covered`."""
    low, high = parameter.minimum, parameter.maximum
    if covered is not None:
        low, high = max(low, covered[0]), min(high, covered[1])
    start = min(max(parameter.start, low), high)
    if not math.isfinite(high):
        high = 10.0 * max(abs(start), 1.0)
    if not math.isfinite(low):
        low = -high
    name, coordinate, scale = parameter.name, "linear", 1.0
    if (of_sample(name) or (name,))[0] in COEFFICIENTS:
        # log(1 + value / scale) is as good as log(value) where the scale is small
        coordinate, scale = "logarithmic", max(low, _LEAST_PART * high)
    return Control(
        name=name,
        title=quantity(name),
        unit=unit_of(name) or "",
        minimum=low,
        maximum=high,
        start=start,
        coordinate=coordinate,
        scale=scale,
        meaning=meaning,
        known=known_of(parameter),
    )


def effect_control(
    parameter: EffectParameter,
    scene: Mapping[str, Value],
    configurations: Sequence[Mapping[str, Value]],
    largest_signal: float,
) -> Control:
    """The control of an effect's parameter.

    `scene` has the parameters of the scene, `configurations` those of every reading; the largest
    signal ends the slider of what has no range.
    """
    start, low, high = parameter.range_in(scene)
    if parameter.limits is not None:
        zero = start - parameter.start
        ends = [parameter.limits(values) for values in configurations]
        low, high = max(low, *(zero + e[0] for e in ends)), min(high, *(zero + e[1] for e in ends))
    low = low if math.isfinite(low) else start - largest_signal
    high = high if math.isfinite(high) else start + largest_signal
    coordinate = parameter.coordinate
    if coordinate == "logarithmic" and parameter.scale < 0:
        coordinate = "linear"
    return Control(
        name=parameter.name,
        title=without_unit(parameter.name),
        unit=parameter.unit,
        minimum=low,
        maximum=high,
        start=min(max(start, low), high),
        coordinate=coordinate,
        scale=parameter.scale,
        meaning=parameter.meaning,
    )


@dataclass(frozen=True)
class Settings:
    """What the page's controls say."""

    #: Switched on, besides the campaign's own.
    effects: tuple[str, ...] = ()
    #: By parameter; the scale is among them where it is not fitted.
    values: Mapping[str, float] = field(default_factory=dict)
    #: Whether the scale follows the readings.
    fit_scale: bool = True
    #: By parameter; what is not here is as its control has it.
    known: Mapping[str, Known] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """What `settings_of` reads."""
        return attributes(self, "effects values fit_scale known")

    def moved_from(self, other: Settings) -> frozenset[str]:
        """What was slid, typed or chosen since; not effects, nor a scale that follows."""
        moved = {n for n, value in self.values.items() if other.values.get(n, value) != value}
        moved -= {SCALE} if self.fit_scale else set()
        moved |= {f"how {n}" for n, how in self.known.items() if other.known.get(n, how) != how}
        return frozenset(moved | ({"fit_scale"} if self.fit_scale != other.fit_scale else set()))


@dataclass(frozen=True)
class Controls:
    """All that the page's controls move."""

    #: Of the campaign's own parameters; the scale comes last.
    parameters: tuple[Control, ...]
    #: Effects that can be switched on, with their controls.
    effects: Mapping[str, tuple[Effect, tuple[Control, ...]]]
    #: Why some effects cannot be switched on.
    refused: tuple[str, ...]

    @property
    def all(self) -> tuple[Control, ...]:
        """Controls of the campaign's own parameters and of all effects."""
        return self.with_effects(self.effects)

    def with_effects(self, names: Iterable[str]) -> tuple[Control, ...]:
        """Controls of the campaign's own parameters and of some effects."""
        return (*self.parameters, *(control for name in names for control in self.effects[name][1]))

    @property
    def starts(self) -> dict[str, float]:
        """Values at which they begin."""
        return {control.name: control.start for control in self.all}

    def known(self, settings: Settings) -> dict[str, Known]:
        """What is known of every parameter."""
        return {c.name: settings.known.get(c.name, c.known) for c in self.all}

    def changed(self, settings: Settings) -> list[str]:
        """Parameters of which something else is known than the campaign says."""
        return [c.name for c in self.all if settings.known.get(c.name, c.known) != c.known]

    def campaign_at(
        self, campaign: Campaign, settings: Settings
    ) -> tuple[Campaign, tuple[str, ...]]:
        """A campaign with what is known at some settings, and the effects that it lacks still.

        It has those effects whose parameters the user knows something of.
        """
        knowledge, changed = self.known(settings), self.changed(settings)
        effects = [
            name
            for name in settings.effects
            if any(control.name in changed for control in self.effects[name][1])
        ]
        campaign = campaign.with_effects(effects)
        named = {c.name for c in self.with_effects(effects)} - {SCALE}
        parameters = dict(campaign.parameters)
        for name in named & parameters.keys():
            parameters[name] = knowledge[name].of(parameters[name], settings.values[name])
        scale = campaign.scale
        if scale is not None or knowledge[SCALE] != Known():
            scale = knowledge[SCALE].of(scale or UNKNOWN_SCALE, settings.values[SCALE])
        rest = tuple(sorted(set(settings.effects) - set(effects)))
        return replace(campaign, parameters=parameters, scale=scale), rest


# What the session holds and shows.


#: What reading a document raises that has another form than it should.
MALFORMED = (LookupError, TypeError, ValueError, AttributeError, RecursionError)


def settings_of(
    asked: Mapping[str, Any], values: Mapping[str, float], possible: Container[str]
) -> Settings:
    """Settings that a page, or a file, asks for: a document as `Settings.to_json` makes it.

    `values` has every parameter's, which stays where it is not asked for; `possible` the effects.
    """

    def is_number(value: object) -> bool:
        return isinstance(value, (int, float)) and abs(value) <= sys.float_info.max

    moved = {n: float(v) for n, v in asked["values"].items() if n in values and is_number(v)}
    knowledge = {}
    for name, parts in asked["known"].items():
        pair = (parts["prior"], parts["prior_sigma"])
        if name in values and parts["how"] in (FREE, HELD, PRIOR):
            is_whole = all(map(is_number, pair)) and pair[1] > 0
            knowledge[name] = Known(parts["how"], *(pair if is_whole else (None, None)))
    effects = tuple(name for name in asked["effects"] if name in possible)
    return Settings(effects, {**values, **moved}, bool(asked["fit_scale"]), knowledge)


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What the page shows of the model at some settings."""

    rows: tuple[FittedRow, ...]
    #: Readings in use and priors.
    chi2: float
    #: Of a fit of all that is shown.
    ndf: int
    p_value: float | None
    #: Signal at an efficiency of 1.
    scale: float
    #: Photons per keV; None where the campaign does not say how to get it.
    light_yield: float | None
    #: Effects that are switched on but not simulated yet.
    pending: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class FitStep:
    """A fit that was made on the page."""

    #: Never used twice.
    number: int
    #: What the controls said when it was asked for, and where it ended.
    asked: Settings
    settings: Settings
    #: What was fitted.
    campaign: Campaign
    calibration: Calibration
    #: Gaussian knowledge that it used, by parameter.
    priors: Mapping[str, tuple[float, float]]
    #: How it differs from the campaign as it came, the effects apart: ``without air``.
    words: str = ""


@dataclass(frozen=True)
class State:
    """All that jobs and the user change, replaced as a whole; what undoing brings back."""

    #: With the readings as they are in the table.
    campaign: Campaign
    _: KW_ONLY
    steps: tuple[FitStep, ...] = ()
    #: Number of the step beside which the model is shown.
    compared: int = 0
    diagnosis: Diagnosis | None = None
    #: What the controls should say; pages take them over when `settings_number` rises.
    settings: Settings = field(default_factory=Settings)
    #: Name and content of what is to be downloaded.
    file: tuple[str, bytes] | None = None
    #: Joint simulations that correct the model, by `LiveModel.mark` and the effects they are of.
    anchors: Mapping[tuple[object, tuple[str, ...]], Anchor] = field(default_factory=dict)

    @property
    def beside(self) -> FitStep:
        """The fit beside which the model is shown; there must be one."""
        return next((step for step in self.steps if step.number == self.compared), self.steps[0])

    def step(self, number: int) -> FitStep:
        """The fit of a number; InputError if it was taken off the list."""
        step = next((step for step in self.steps if step.number == number), None)
        if step is None:
            raise InputError("this fit is not there any more", "choose another")
        return step


class History:
    """The state of a session: it changes as a whole, and can be brought back.

    Any thread may ask for it, or change it. Changes have numbers, by which pages see that they show
    an older state.
    """

    def __init__(self, state: State) -> None:
        #: How things are now.
        self.state = state
        #: Held by whoever asks for more than one thing that belongs together.
        self.lock = threading.RLock()
        #: Rises with every change.
        self.number = 0
        #: Rises with every change of the controls that pages take over.
        self.settings_number = 0
        #: Rises with every file to be downloaded.
        self.file_number = 0
        #: Whether the last one is a scene, a campaign, ...
        self.file_kind = ""
        #: Rises with everything for which pages are loaded anew.
        self.bench_number = 0
        self._kept: list[State] = []
        self._undone: list[State] = []
        # controls that are being moved, and when they were last
        self._moving, self._moved_s = frozenset[str](), 0.0

    def begin(self, state: State) -> None:
        """Go on with another campaign: nothing of the former one is brought back."""
        with self.lock:
            self.state = state
            self.bench_number += 1
            self.forget()
            self.set_controls(state.settings)

    def change(self, **changes: Any) -> None:
        """Replace fields of the state."""
        with self.lock:
            self.state = replace(self.state, **changes)
            self.number += 1

    def set_controls(self, settings: Settings, **changes: Any) -> None:
        """Let the pages take over other settings."""
        with self.lock:
            self.settings_number += 1
            self.change(settings=settings, **changes)

    def remember(self, settings: Settings, number: int, *, by_hand: bool = True) -> Settings:
        """Keep what a page's controls say, for the next page that opens; returns what holds.

        `number` is the `settings_number` that the page knows: if it is an older one, what it says
        is out of date. How it was before a control was moved `by_hand` is kept for `bring_back`.
        """
        with self.lock:
            if number == self.settings_number:
                moved, now = settings.moved_from(self.state.settings), time.monotonic()
                if moved and by_hand:
                    if moved != self._moving or now - self._moved_s > _PAUSE_S:
                        self.keep()
                    self._moving, self._moved_s = moved, now
                self.state = replace(self.state, settings=settings)
            return self.state.settings

    def keep(self, effects: tuple[str, ...] | None = None) -> None:
        """Remember how it is, for `bring_back`; with other `effects` switched on, if given."""
        with self.lock:
            settings, self._moving = self.state.settings, frozenset()
            if effects is not None:
                settings = replace(settings, effects=effects)
            kept = replace(self.state, settings=settings)
            self._kept, self._undone = [*self._kept[1 - _MOST_UNDONE :], kept], []

    def forget(self) -> None:
        """Let nothing be brought back any more."""
        self._kept, self._undone = [], []

    @property
    def can_undo(self) -> bool:
        """Whether something was kept."""
        return bool(self._kept)

    @property
    def can_redo(self) -> bool:
        """Whether something was undone, and nothing else done since."""
        return bool(self._undone)

    def bring_back(self, *, undone: bool = False) -> None:
        """Go back to what was kept, or `undone`, last; a diagnosis of the same readings stays."""
        source, other = (self._undone, self._kept) if undone else (self._kept, self._undone)
        now, before, self._moving = self.state, source.pop(), frozenset()
        other.append(now)
        kept = attributes(before, "campaign compared anchors")
        kept["diagnosis"] = (now if before.campaign is now.campaign else before).diagnosis
        # the campaign's own fit stays, once it is there
        self.set_controls(before.settings, steps=before.steps or self.state.steps[:1], **kept)


def difference(first: Campaign, campaign: Campaign, settings: Settings, controls: Controls) -> str:
    """What was changed besides effects, in words: ``without air, scattering held at 0.5``.

    Of a campaign since it was the `first`, and of what its `controls` said of parameters.
    """
    changes, knowledge = _changed_readings(first, campaign), controls.known(settings)
    for control in controls.with_effects(settings.effects):
        now, how = knowledge[control.name], "free"
        if now.how == HELD:
            how = f"held at {settings.values[control.name]:.4g}"
        elif now.how == PRIOR:
            how = f"known to be {now.prior} ± {now.prior_sigma}"
        changes += [f"{control.title} {how}"] if now != control.known else []
    return ", ".join(changes)


def _changed_readings(first: Campaign, campaign: Campaign) -> list[str]:
    """Readings that are used or not, or are others, since the campaign was the first, in words."""
    changes = []
    tables = first.measurements, campaign.measurements
    before, after = ({r.label: r for r in table.readings} for table in tables)
    for label in dict.fromkeys((*before, *after)):
        old, new = before.get(label), after.get(label)
        if new is None or not new.use:
            changes += [f"without {label}"] if old is not None and old.use else []
            continue
        changes += [f"with {label}"] if old is None or not old.use else []
        if old is None:
            continue
        changes += [f"{label} as {new.kind}"] if old.kind != new.kind else []
        if (old.signal, old.sigma) != (new.signal, new.sigma):
            changes.append(f"{label} {new.signal:g} ± {new.sigma:g}")
        both = new.parameters.keys() & old.parameters.keys()
        others = (name for name in both if new.parameters[name] != old.parameters[name])
        changes += [f"{label} at {said(name, new.parameters[name])}" for name in others]
    return changes
