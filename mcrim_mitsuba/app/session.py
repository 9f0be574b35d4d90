"""What the page works on: a campaign with what was simulated and found."""

from __future__ import annotations

import copy
import itertools
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.app import exchange
from mcrim_mitsuba.app.jobs import Job, Jobs
from mcrim_mitsuba.app.state import (
    HELD,
    PRIOR,
    Control,
    FitStep,
    Known,
    Settings,
    Shown,
    State,
    effect_control,
    known_of,
    parameter_control,
    settings_of,
)
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, without_unit
from mcrim_mitsuba.core.run import Run, one_thread
from mcrim_mitsuba.inference.diagnose import diagnose_on
from mcrim_mitsuba.inference.estimates import fitted_rows
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.likelihood import FrozenStatistic, Likelihood, p_value
from mcrim_mitsuba.inference.model import UNKNOWN_SCALE, ResponseModel
from mcrim_mitsuba.inference.workbench import Workbench
from mcrim_mitsuba.output.findings import parameter_words

#: Steps of the scale's fit: it is linear but for effects of the readings, which bend it a little.
_SCALE_STEPS = 4
#: Models that are kept ready, and changes that can be undone.
_MOST_MODELS, _MOST_UNDONE = 30, 50


class Session:
    """One user's work on one campaign, shared by all the pages that show it.

    Settings and predictions are asked for from any thread; what simulates runs in `jobs`. The
    campaign of its `state` is the one that it was opened with, or that with other readings.

    Parameters
    ----------
    campaign : Campaign
    run : Run
        See `inference.diagnose.Workbench`; its progress is shown on the page.
    folder : Path
        For uploads and for files to be downloaded.
    """

    def __init__(self, campaign: Campaign, run: Run, folder: Path) -> None:
        #: Rise with every change, with every one that pages take over, with every file to be
        #: downloaded, and with every other bench.
        self.number = self.settings_number = self.file_number = self.bench_number = 0
        self.jobs = Jobs(self._change)
        #: Held by whoever asks for more than one thing that belongs together.
        self.lock = threading.RLock()
        self._run, self._folder = replace(run, progress=self.jobs.report), folder
        self._first = campaign
        self._open(campaign)

    def _open(self, campaign: Campaign) -> None:
        self._bench = Workbench(campaign, self._run)
        self._models: dict[Any, tuple[Any, ResponseModel]] = {}
        self._shown_beside: tuple[Any, State, Shown | None] | None = None
        self._undone: list[State] = []
        self._numbers = itertools.count()
        #: What jobs have found so far.
        self.state = State(campaign)
        #: Of the campaign's own parameters; the scale comes last.
        self.controls = self._own_controls()
        readings, own = campaign.measurements.readings, self._bench.own_maker.configurations()
        # sliders are the bench's
        of_bench = [v for v, r in zip(own, readings, strict=True) if not r.of_beam]
        scene = campaign.scene.parameters
        known = (scene, of_bench or [scene], self._largest_signal)
        #: Scene parameters of every reading.
        self.configurations = own
        #: Effects that can be switched on, with their controls.
        self.effects = {
            name: (effect, tuple(effect_control(one, *known) for one in effect.parameters))
            for name, effect in self._bench.possible().items()
        }
        values = {c.name: c.start for c in self._all_controls()}
        follows = SCALE in campaign.free
        self.bench_number += 1
        self._set_controls(Settings(values=values, fit_scale=follows))
        self.jobs.start(Job("bench", "simulating the bench", self._make_ready))

    def _change(self, **changes: Any) -> None:
        with self.lock:
            self.state = replace(self.state, **changes)
            self.number += 1

    def _set_controls(self, settings: Settings, **changes: Any) -> None:
        """Let the pages take over other settings."""
        with self.lock:
            self.settings_number += 1
            self._change(settings=settings, **changes)

    def _keep(self) -> None:
        """Remember how it is, to be brought back by `undo`."""
        with self.lock:
            self._undone = [*self._undone[1 - _MOST_UNDONE :], self.state]

    def remember(self, settings: Settings, number: int) -> Settings:
        """Keep what a page's controls say, for the next page that opens; returns what holds.

        `number` is the `settings_number` that the page knows: if it is an older one, what it says
        is out of date.
        """
        with self.lock:
            if number == self.settings_number:
                self.state = replace(self.state, settings=settings)
            return self.state.settings

    # ---- what can be moved -------------------------------------------------------------------

    def _own_controls(self) -> tuple[Control, ...]:
        maker, campaign = self._bench.own_maker, self.state.campaign
        covered = {
            ALPHA_SCAT: maker.grid.alpha_scat_range_per_cm,
            ALPHA_ABS: maker.grid.alpha_abs_range_per_cm,
        }
        own = [
            parameter_control(known, parameter_words(campaign, name)[0], covered.get(name))
            for name, known in campaign.parameters.items()
            if not known.fixed or name in covered  # what else is held was not simulated
        ]
        # a quarter of the light is a usual part
        usual, scale = 4.0 * self._largest_signal, campaign.scale or UNKNOWN_SCALE
        start = usual if math.isnan(scale.start) else scale.start
        meaning, _ = parameter_words(campaign, SCALE)
        own.append(Control(
            SCALE, "scale", "signal at η = 1", 0.0, 3.0 * max(usual, start), start,
            meaning=meaning, known=known_of(campaign.scale),
        ))  # fmt: skip
        return tuple(own)

    @property
    def _largest_signal(self) -> float:
        return max(abs(reading.signal) for reading in self.state.campaign.measurements.readings)

    def _all_controls(self) -> list[Control]:
        return [*self.controls, *(c for _, own in self.effects.values() for c in own)]

    @property
    def refused(self) -> tuple[str, ...]:
        """Why some effects cannot be switched on."""
        return tuple(dict.fromkeys(self._bench.notes))

    def known(self, settings: Settings) -> dict[str, Known]:
        """What is known of every parameter."""
        return {c.name: settings.known.get(c.name, c.known) for c in self._all_controls()}

    def _fitted_campaign(self, settings: Settings) -> tuple[Campaign, tuple[str, ...]]:
        """The campaign with what is known at some settings, and the effects that it lacks still.

        It has those effects whose parameters the user knows something of.
        """
        campaign, known = self.state.campaign, self.known(settings)
        own = {
            name: [c.name for c in self.effects[name][1]]
            for name in settings.effects
            if any(known[c.name] != c.known for c in self.effects[name][1])
        }
        campaign = campaign.with_effects(tuple(own))
        names = {c.name for c in self.controls if c.name != SCALE}.union(*own.values())
        parameters = {
            name: known[name].of(parameter, settings.values[name]) if name in names else parameter
            for name, parameter in campaign.parameters.items()
        }
        scale = campaign.scale
        if scale is not None or known[SCALE] != Known():
            scale = known[SCALE].of(scale or UNKNOWN_SCALE, settings.values[SCALE])
        rest = tuple(sorted(name for name in settings.effects if name not in own))
        return replace(campaign, parameters=parameters, scale=scale), rest

    # ---- what the model says -----------------------------------------------------------------

    @one_thread()
    def show(self, settings: Settings) -> Shown | None:
        """Predictions at some settings; None before anything was simulated.

        Takes about a millisecond.
        """
        state = self.state
        if state.ready is None:
            return None
        effects = tuple(name for name in settings.effects if name in state.ready)
        known = self.known(settings)
        model = self._model(effects, known, state)
        likelihood = Likelihood(model)
        theta = np.array([
            min(max(settings.values.get(p.name, p.start), p.minimum), p.maximum)
            if p.name != SCALE
            else settings.values[SCALE]
            for p in model.free
        ])  # fmt: skip
        names, sigma = [parameter.name for parameter in model.free], 0.0
        if settings.fit_scale:
            sigma = _fit_scale(likelihood, theta, names.index(SCALE))
        statistic = FrozenStatistic(likelihood, likelihood.errors_at(theta))
        prediction = model.predict(theta, check=True)
        assert prediction.eta_sigma is not None  # checked
        assert prediction.interpolation_error is not None
        errors = list(map(math.hypot, prediction.eta_sigma, prediction.interpolation_error))
        held = sum(known[name].how == HELD for name in names if name in known)
        chi2, ndf = statistic.chi2(theta), likelihood.ndf + held
        return Shown(
            rows=fitted_rows(model.readings, prediction, errors), chi2=chi2, ndf=ndf,
            p_value=p_value(chi2, ndf), scale=prediction.scale,
            light_yield=self._light_yield(prediction.scale, sigma),
            pending=tuple(name for name in settings.effects if name not in effects),
        )  # fmt: skip

    def shown_beside(self) -> tuple[FitStep, Shown] | None:
        """The fit beside which the model is shown, and what it predicts for today's readings."""
        state = self.state
        if not state.steps:
            return None
        step = state.beside
        key = (step.number, state.ready, *map(id, (state.campaign, state.anchors)))
        if self._shown_beside is None or self._shown_beside[0] != key:
            # with what its key is the identity of
            self._shown_beside = (key, state, self.show(step.settings))
        shown = self._shown_beside[2]
        return None if shown is None else (step, shown)

    def _model(
        self, effects: tuple[str, ...], known: Mapping[str, Known], state: State
    ) -> ResponseModel:
        """What is held is free in it: it stands at its value, and moves when that is moved."""
        names = tuple(sorted(effects))
        priors = {n: k.gaussian for n, k in known.items() if k.gaussian is not None}
        anchor = state.anchors.get(names)
        # while nothing new was simulated a model stays what it is
        key = (names, tuple(priors.items()), id(state.campaign), state.ready, id(anchor))
        if key not in self._models:
            campaign = state.campaign.with_effects(names)

            def movable(name: str, parameter: CampaignParameter) -> CampaignParameter:
                return Known(PRIOR, *priors.get(name, (None, None))).of(parameter, math.nan)

            parameters = {
                name: movable(name, parameter) if name in known else parameter
                for name, parameter in campaign.parameters.items()
            }
            scale = movable(SCALE, campaign.scale or UNKNOWN_SCALE)
            campaign = replace(campaign, parameters=parameters, scale=scale)
            if len(self._models) >= _MOST_MODELS:
                self._models = {}
            model = ResponseModel(campaign, self._bench.responses, campaign.switched_on, anchor)
            # with what its key is the identity of
            self._models[key] = ((state.campaign, anchor), model)
        return self._models[key][1]

    def _light_yield(self, scale: float, sigma: float) -> tuple[float, float, float] | None:
        known = self.state.campaign.light_yield
        if known is None or SCALE not in self.state.campaign.free:
            return None
        relative = known.detector_efficiency_sigma / known.detector_efficiency
        return scale * known.per_scale, sigma * known.per_scale, scale * known.per_scale * relative

    # ---- what takes longer -------------------------------------------------------------------

    def _make_ready(self, effects: Sequence[str] = ()) -> None:
        """Simulate what is not simulated yet: the bench as it is, and effects."""
        bench, ready = self._bench, self.state.ready
        if ready is None:
            before = self.state.settings
            bench.simulate()
            self._change(ready=bench.simulated)
            model = bench.model()
            found = fit_model(model, profile=False)
            self._fitted(model, found, Settings(values=before.values), before, bench.campaign)
        ready = self.state.ready or frozenset()
        if any(name not in ready or name not in bench.precise for name in effects):
            bench.simulate(sorted({*ready, *effects}), look=ready - {*effects})
            self._change(ready=bench.simulated)

    def _start(
        self, key: str, words: str, work: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> None:
        self.jobs.start(Job(key, words, work, undo or (lambda: None)))

    def switch_on(self, effect: str) -> None:
        """Simulate an effect, if it was not simulated yet; its switch is off where that fails."""

        def undo() -> None:
            settings = self.state.settings
            kept = tuple(name for name in settings.effects if name != effect)
            self._set_controls(replace(settings, effects=kept))

        if self.state.ready is None or effect not in self.state.ready:
            self._start(
                f"effect {effect}", f"simulating {effect}", lambda: self._make_ready([effect]), undo
            )

    def switch_off(self, effect: str) -> None:
        """Do not simulate an effect any more."""
        self.jobs.stop(f"effect {effect}")

    def fit(self, settings: Settings) -> None:
        """Fit all that is switched on, beginning where the controls are."""
        self._start("fit", "fitting", lambda: self._fit(settings, settings))

    def add(self, effects: Sequence[str], settings: Settings) -> None:
        """Switch more effects on and fit."""
        wanted = tuple(dict.fromkeys((*settings.effects, *effects)))
        values = {**settings.values, **self._sizes(wanted)}
        more = replace(settings, effects=wanted, values=values)
        self._start(
            f"add {' '.join(effects)}", f"adding {', '.join(effects)}",
            lambda: self._fit(more, settings),
        )  # fmt: skip

    def _sizes(self, effects: tuple[str, ...]) -> dict[str, float]:
        """What the diagnosis made of a set of effects."""
        found = self.state.diagnosed
        if found is None:
            return {}
        for candidate in (*found.diagnosis.candidates, *found.diagnosis.pairs):
            if set(candidate.effects) == set(effects):
                return {n: known.value for n, known in candidate.parameters.items()}
        return {}

    def _fit(self, wanted: Settings, pressed: Settings) -> None:
        self._make_ready(wanted.effects)
        fitted, rest = self._fitted_campaign(wanted)
        model, found = self._bench_of(fitted).settled_model(rest, wanted.values)
        anchors = dict(self.state.anchors)
        if model.anchor is not None:
            anchors[tuple(sorted(wanted.effects))] = model.anchor
        self._keep()
        self._fitted(model, found, wanted, pressed, self.state.campaign, anchors=anchors)

    def _bench_of(self, campaign: Campaign) -> Workbench:
        """The workbench with other knowledge or readings: what was simulated serves them too."""
        bench = copy.copy(self._bench)
        bench.campaign = campaign
        return bench

    def _fitted(
        self, model: ResponseModel, found: Calibration, wanted: Settings, pressed: Settings,
        campaign: Campaign, **changes: Any,
    ) -> None:  # fmt: skip
        """Take over a fit of what was wanted; what was switched on since it was asked for stays."""
        now = self.state.settings
        values = {**now.values, **{n: found.parameters[n].value for n in found.names}}
        fitted = replace(wanted, values=values, fit_scale=SCALE in found.names)
        step = FitStep(
            next(self._numbers), wanted, fitted, campaign, found, model.campaign.priors,
            self._difference(campaign, wanted),
        )  # fmt: skip
        since = (name for name in now.effects if name not in pressed.effects)
        effects = tuple(dict.fromkeys((*wanted.effects, *since)))
        self._set_controls(
            replace(fitted, effects=effects, known=now.known),
            steps=(*self.state.steps, step), **changes,
        )  # fmt: skip

    def _difference(self, campaign: Campaign, settings: Settings) -> str:
        """What was changed besides effects, in words."""
        first, known = self._bench.campaign, self.known(settings)
        said = []
        rows = zip(first.measurements.readings, campaign.measurements.readings, strict=True)
        for before, after in rows:
            if before.use != after.use:
                said.append(f"{'with' if after.use else 'without'} {after.label}")
            if (before.signal, before.sigma) != (after.signal, after.sigma):
                said.append(f"{after.label} {after.signal:g} ± {after.sigma:g}")
        brought = [c for name in settings.effects for c in self.effects[name][1]]
        for control in (*self.controls, *brought):
            now = known[control.name]
            if now == control.known:
                continue
            how = {
                HELD: f"held at {settings.values[control.name]:.4g}",
                "prior": f"known to be {now.prior} ± {now.prior_sigma}",
            }.get(now.how, "free")
            said.append(f"{without_unit(control.name)} {how}")
        return ", ".join(said)

    def diagnose(self, settings: Settings) -> None:
        """Find out which effects explain the misfit of the campaign without any of the page's."""

        def work() -> None:
            self._make_ready()
            campaign, _ = self._fitted_campaign(replace(settings, effects=()))
            bench = self._bench_of(campaign)
            found = diagnose_on(bench)
            self._bench.responses = bench.responses
            self._keep()
            self._change(diagnosed=found, ready=self._bench.simulated)

        self._start("diagnose", "diagnosing", work)

    # ---- what takes no time ------------------------------------------------------------------

    def go_back(self) -> None:
        """Everything off, the readings as they came, and the campaign's own fit."""
        if self.state.steps:
            self.show_step(self.state.steps[0].number)

    @property
    def can_undo(self) -> bool:
        return bool(self._undone)

    def undo(self) -> None:
        """As it was before the last fit, diagnosis, change of readings or step that was removed."""
        with self.lock:
            if not self._undone:
                return
            *self._undone, before = self._undone
            kept = {name: getattr(self.state, name) for name in ("ready", "anchors", "file")}
            self._set_controls(before.settings, **{
                name: getattr(before, name)
                for name in ("campaign", "steps", "compared", "diagnosed")
            }, **kept)  # fmt: skip

    def _step(self, number: int) -> FitStep:
        for step in self.state.steps:
            if step.number == number:
                return step
        raise InputError("this fit is not there any more", "choose another")

    def show_step(self, number: int) -> None:
        """Controls and readings as they were when a fit ended."""
        step = self._step(number)
        self._keep()
        changes: dict[str, Any] = {}
        if step.campaign is not self.state.campaign:
            changes = {"campaign": step.campaign, "diagnosed": None}
        self._set_controls(step.settings, **changes)

    def remove_step(self, number: int) -> None:
        """Take a fit off the list."""
        step = self._step(number)
        if step is self.state.steps[0]:
            raise InputError("the campaign as it came stays in the list", "remove another fit")
        self._keep()
        self._change(steps=tuple(s for s in self.state.steps if s is not step))

    def compare_with(self, number: int) -> None:
        """Show the model beside a fit."""
        self._change(compared=self._step(number).number)

    def edit_reading(self, place: int, changes: Mapping[str, Any]) -> None:
        """Go on with another `signal`, `sigma` or `use` of a reading.

        Raises
        ------
        InputError
            If it cannot be used.
        """
        campaign = self.state.campaign
        readings = list(campaign.measurements.readings)
        readings[place] = replace(readings[place], **changes)
        campaign = exchange.with_edited(campaign, readings, self._folder)
        self._keep()
        self._change(campaign=campaign, diagnosed=None)

    # ---- files -------------------------------------------------------------------------------

    def take_readings(self, name: str, content: bytes) -> None:
        """Go on with other readings of the same bench.

        Raises
        ------
        InputError
            If the file cannot be used.
        """
        campaign = exchange.with_readings(self._first, name, content, self._folder)
        self.jobs.stop_all()
        # what is under way ends first
        self._start("upload-button", f"opening {name}", lambda: self._reopen(campaign))

    def take_session(self, name: str, content: bytes) -> None:
        """Go on with a session that was kept in a file: its fits are made again.

        Raises
        ------
        InputError
            If the file cannot be used.
        """
        kept = exchange.read_session(name, content, self._first.scene)
        table = kept["table"].encode()
        campaign = exchange.with_readings(self._first, kept["measurements"], table, self._folder)
        self.jobs.stop_all()

        def work() -> None:
            self._reopen(campaign)
            self._start("session", "making its fits again", lambda: self._refit(kept))

        self._start("upload-button", f"opening {name}", work)

    def _refit(self, kept: Mapping[str, Any]) -> None:
        """Make the fits of a kept session, and bring back its readings and controls."""
        first = self._bench.campaign
        now = exchange.with_rows(first, kept["readings"], self._folder)

        def settings(asked: Mapping[str, Any]) -> Settings:
            return settings_of(asked, self.state.settings.values, self.effects)

        self._make_ready()
        self._change(steps=())
        for fit in kept["fits"]:
            self._change(campaign=exchange.with_rows(first, fit["readings"], self._folder))
            wanted = settings(fit["settings"])
            self._fit(wanted, wanted)
        steps, last = self.state.steps, settings(kept["settings"])
        place = int(kept["compared"])
        self._undone = []
        self._set_controls(
            last, campaign=now, compared=steps[place].number if place < len(steps) else 0
        )
        if kept["diagnosed"]:
            self.diagnose(last)

    def _reopen(self, campaign: Campaign) -> None:
        with self.lock:
            self._open(campaign)

    def offer(self, what: str, settings: Settings) -> None:
        """Make a file to be downloaded.

        It is the mended ``scene``, simulated as it is; with the ``campaign`` all that it needs; the
        ``report``; or the ``session``, which `take_session` opens.
        """

        def work() -> None:
            campaign, effects = self.state.campaign, settings.effects
            if what == "session":
                file = exchange.session_file(replace(self.state, settings=settings))
            elif what == "report":
                file = exchange.report_file(campaign, effects, self._run, self._folder)
            else:
                self._make_ready(effects)
                values = self._settle_at(settings)
                if what == "scene":
                    file = exchange.scene_file(campaign, effects, values)
                else:
                    fitted, _ = self._fitted_campaign(settings)
                    named, known = {**fitted.parameters, SCALE: fitted.scale}, self.known(settings)
                    chosen = [named[c.name] for c in self._all_controls()
                              if named.get(c.name) and known[c.name] != c.known]  # fmt: skip
                    file = exchange.campaign_archive(
                        campaign, effects, values, self._priors_of_fit(settings),
                        [parameter for parameter in chosen if parameter is not None],
                    )  # fmt: skip
            with self.lock:
                self.file_number += 1
                self._change(file=file)

        self._start(f"get-{what}", f"writing the {what}", work)

    def _priors_of_fit(self, settings: Settings) -> Mapping[str, tuple[float, float]]:
        """What the last fit with these effects knew of their sizes."""
        for step in reversed(self.state.steps):
            if set(step.settings.effects) == set(settings.effects):
                return {n: known for n, known in step.priors.items() if n != SCALE}
        return {}

    def _settle_at(self, settings: Settings) -> dict[str, float]:
        """Simulate all that is switched on together, where the controls are.

        So that the page shows what a simulation of the downloaded scene gives.
        """
        state, key = self.state, tuple(sorted(settings.effects))
        switched_on = [state.campaign.catalogue[n] for n in (*state.campaign.effects, *key)]
        # sizes of other effects may be the scene's own parameters: those stay as they are
        used = {*state.campaign.parameters, *(p.name for e in switched_on for p in e.parameters)}
        values = {name: value for name, value in settings.values.items() if name in used}
        if not self._bench.own_maker.is_exact(switched_on):
            free = self._model(key, self.known(settings), state).free
            here = {p.name: values.get(p.name, p.start) for p in free if p.name != SCALE}
            model = self._bench.anchored_model(key, here)
            assert model.anchor is not None
            self._change(anchors={**self.state.anchors, key: model.anchor})
        return values


def _fit_scale(likelihood: Likelihood, theta: np.ndarray, place: int) -> float:
    """Let the scale, in place, follow the readings; returns its error with all else held."""
    eta = likelihood.model.predict(theta).eta
    theta[place] = likelihood.best_scale(eta, likelihood.errors_before_any_fit())
    for _ in range(_SCALE_STEPS):
        errors = likelihood.errors_at(theta)
        statistic = FrozenStatistic(likelihood, errors)
        curvature = statistic.information(theta)[place, place]
        theta[place] -= 0.5 * statistic.gradient(theta)[place] / curvature
    return 1.0 / math.sqrt(curvature)
