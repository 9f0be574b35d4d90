"""What the page works on: a campaign with what was simulated and found."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcrim_mitsuba.app import exchange
from mcrim_mitsuba.app.jobs import Jobs, PageJob
from mcrim_mitsuba.app.live_model import LiveModel
from mcrim_mitsuba.app.state import (
    FREE,
    PRIOR,
    FitStep,
    History,
    Known,
    Settings,
    Shown,
    State,
    difference,
    settings_of,
)
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Progress, Run
from mcrim_mitsuba.inference.diagnose import PARTS, diagnose
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.model import Model, ResponseModel


class _OutdatedError(Exception):
    """The readings that are being simulated are not those of the table any more."""


class ReadingsModel:
    """The model of the readings in the table: it is simulated where they change, and shown.

    The readings are those of the history's campaign. Only jobs simulate: `progress`, as
    `Run.progress`, is told and may raise an exception to end it. What the model says is asked for
    from any thread.
    """

    def __init__(self, campaign: Campaign, history: History, run: Run, progress: Progress) -> None:
        self._history, self._progress = history, progress
        self._run = replace(run, progress=self._report)
        self.live = LiveModel(campaign, self._run)
        # that of changed readings, while it is simulated
        self._following: LiveModel | None = None
        self._shown_beside: tuple[Any, Campaign, Shown | None] | None = None

    @property
    def is_simulated(self) -> bool:
        """Whether what is simulated is that of the readings in the table."""
        return self.live.fits(self._history.state.campaign)

    def make_ready(self, effects: Sequence[str] = ()) -> None:
        """Simulate what is not simulated yet: the readings' bench as it is, and effects."""
        while not self.is_simulated:
            self._follow(effects)
        self.live.simulate(effects)
        self._history.change()

    def _follow(self, effects: Sequence[str]) -> None:
        """Simulate readings of other configurations, unless they change meanwhile."""
        history = self._history
        state = history.state
        live = LiveModel(state.campaign, self._run)
        wanted = {*effects, *state.settings.effects, *state.beside.settings.effects}
        self._following = live
        try:
            live.simulate(wanted & live.controls.effects.keys())
        except _OutdatedError:
            return
        finally:
            self._following = None
        with history.lock:
            if live.fits(history.state.campaign):
                if live.controls != self.live.controls:
                    history.bench_number += 1
                self.live = live
                settings = history.state.settings
                values = {**live.controls.starts, **settings.values}
                history.change(settings=replace(settings, values=values))

    def _report(self, stage: str, done: int, total: int, note: str = "") -> None:
        self._progress(stage, done, total, note)
        if self._following is not None and not self._following.fits(self._history.state.campaign):
            raise _OutdatedError

    def show(self, settings: Settings) -> Shown | None:
        """Predictions at some settings; None before the readings were simulated.

        Their chi2 counts what the last fit with the same effects took as known of their sizes.
        """
        free = {n for n, k in self.live.controls.known(settings).items() if k.how == FREE}
        priors = self.priors_of_fit(settings)
        of_fit = {n: Known(PRIOR, *priors[n]) for n in free & priors.keys()}
        settings = replace(settings, known={**settings.known, **of_fit})
        state, key = self._history.state, self._anchor_key(settings)
        return self.live.show(state.campaign, settings, state.anchors.get(key))

    def _anchor_key(self, settings: Settings) -> tuple[object, tuple[str, ...]]:
        return self.live.mark, tuple(sorted(settings.effects))

    def keep_anchor(self, settings: Settings, model: Model | None) -> None:
        """Models with the effects of these settings are corrected as this one from now on."""
        if isinstance(model, ResponseModel) and model.anchor is not None:
            anchors = self._history.state.anchors
            self._history.change(anchors={**anchors, self._anchor_key(settings): model.anchor})

    def fit_at(self, settings: Settings) -> FitStep | None:
        """The fit of the readings in the table that ended at these settings; None if none did."""
        state, controls = self._history.state, self.live.controls
        for step in reversed(state.steps):
            alike = step.campaign is state.campaign and not settings.moved_from(step.settings)
            alike &= set(step.settings.effects) == set(settings.effects)
            if alike and controls.known(settings) == controls.known(step.settings):
                return step
        return None

    def shown_beside(self) -> tuple[FitStep, Shown] | None:
        """The fit beside which the model is shown, and what it predicts for today's readings.

        None while it cannot be: its effects are simulated first.
        """
        state = self._history.state
        if not state.steps:
            return None
        step = state.beside
        now = (id(state.campaign), id(state.anchors), id(self.live), self.live.version)
        key = (step.number, *now)
        if self._shown_beside is None or self._shown_beside[0] != key:
            # with what its key is the identity of
            self._shown_beside = (key, state.campaign, self.show(step.settings))
        shown = self._shown_beside[2]
        return None if shown is None or shown.pending else (step, shown)

    def priors_of_fit(self, settings: Settings) -> Mapping[str, tuple[float, float]]:
        """What the last fit with these effects took as known of sizes that are left free."""
        for step in reversed(self._history.state.steps):
            if set(step.settings.effects) == set(settings.effects):
                knowledge = self.live.controls.known(step.settings)
                free = {n for n, k in knowledge.items() if k.how == FREE}
                return {n: prior for n, prior in step.priors.items() if n in free}
        return {}


class Session:
    """One user's work on one campaign, shared by all the pages that show it.

    Its methods are what buttons do. What takes longer runs in `jobs`, one after the other, with
    what `run` says but its progress. The `history` holds how things are; its campaign is the one
    that the session was opened with, or that with other readings, whose `model` it is. Uploads, and
    files to be downloaded, lie in `folder`.
    """

    def __init__(self, campaign: Campaign, run: Run, folder: Path) -> None:
        self.history = History(State(campaign))
        self.jobs = Jobs(self.history.change)
        self._run, self._folder = replace(run, progress=self.jobs.report), folder
        self._first = campaign
        self._open(campaign)

    def _open(self, campaign: Campaign) -> None:
        with self.history.lock:
            # as it came, to the page or from a file
            self._opened = campaign
            self.model = ReadingsModel(campaign, self.history, self._run, self.jobs.report)
            self._numbers = itertools.count()
            values = self.model.live.controls.starts
            settings = Settings(values=values, fit_scale=SCALE in campaign.free)
            self.history.begin(State(campaign, settings=settings))
        self.jobs.start(PageJob("bench", "simulating the bench", self._make_ready))

    @property
    def state(self) -> State:
        """How things are now."""
        return self.history.state

    @property
    def has_beams(self) -> bool:
        """Whether transmittances are, or were, among the readings."""
        campaigns = (self._opened, self.state.campaign)
        return any(r.of_beam for campaign in campaigns for r in campaign.measurements.readings)

    # ---- fits and diagnoses ------------------------------------------------------------------

    def _make_ready(self, effects: Sequence[str] = ()) -> None:
        """Simulate what is not simulated yet; the first time the campaign is fitted as it came."""
        if not self.state.steps:
            before, campaign = self.state.settings, self._opened
            self.model.live.simulate()
            self.history.change()
            fit = self.model.live.simulations.of(campaign).fit()
            self._take_fit(fit, Settings(values=before.values), before, campaign)
        self.model.make_ready(effects)

    def switch(self, effect: str) -> None:
        """Fit with an effect that was switched on, or without one that was switched off.

        The switch is as before where that is stopped, or the effect cannot be simulated; where a
        fit is refused, as of too few readings, the effect is there to be moved by hand.
        """
        is_on, key = effect in self.state.settings.effects, f"effect {effect}"
        if not is_on and self.jobs.stop(key):
            return

        def before(settings: Settings) -> tuple[str, ...]:
            rest = tuple(name for name in settings.effects if name != effect)
            return rest if is_on else (*rest, effect)

        def work() -> None:
            # with what was switched meanwhile
            settings = self.state.settings
            self._make_ready(settings.effects)
            if self.model.fit_at(settings) is not None:
                return
            asked = self.at_found(settings) if is_on else settings
            with contextlib.suppress(InputError):
                self._fit(asked, settings, before(settings))

        def undo() -> None:
            now = self.state.settings
            self.history.set_controls(replace(now, effects=before(now)))

        title = self.model.live.controls.effects[effect][0].title
        words = f"fitting {'with' if is_on else 'without'} {title}"
        self.jobs.start(PageJob(key, words, work, undo=undo, again=True))

    def fit(self, settings: Settings) -> None:
        """Fit all that is switched on, beginning where the controls are."""
        self.jobs.start(PageJob("fit", "fitting", lambda: self._fit(settings, settings)))

    def add(self, effects: Sequence[str], settings: Settings) -> None:
        """Switch more effects on and fit, beginning with the sizes that the diagnosis found."""
        together = tuple(dict.fromkeys((*settings.effects, *effects)))
        more = self.at_found(replace(settings, effects=together))
        offered = self.model.live.controls.effects
        titles = ", ".join(offered[name][0].title for name in effects if name in offered)
        work = functools.partial(self._fit, more, settings)
        self.jobs.start(PageJob(f"add {' '.join(effects)}", f"adding {titles}", work))

    def at_found(self, settings: Settings) -> Settings:
        """Settings with the sizes of their effects that the diagnosis found, if it did."""
        diagnosis = self.state.diagnosis
        candidate = diagnosis and diagnosis.candidate(settings.effects)
        fitted = candidate.parameters if candidate else {}
        sizes = {name: estimate.value for name, estimate in fitted.items()}
        return replace(settings, values={**settings.values, **sizes})

    def _fit(
        self, asked: Settings, on_page: Settings, before: tuple[str, ...] | None = None
    ) -> None:
        """Simulate and fit what is asked for, and show it; as in `_take_fit`.

        Undoing brings back the effects that were on `before`, where a switch asked for it.
        """
        self._make_ready(asked.effects)
        live, campaign = self.model.live, self.state.campaign
        fitted, rest = live.controls.campaign_at(campaign, asked)
        fit = live.simulations.of(fitted).settled_fit(rest, asked.values)
        with self.history.lock:
            self.history.keep(before)
            self.model.keep_anchor(asked, fit.model)
            self._take_fit(fit, asked, on_page, campaign)

    def _take_fit(
        self, fit: Calibration, asked: Settings, on_page: Settings, campaign: Campaign
    ) -> None:
        """Set the controls to a fit, and make it a step of the history.

        A fit takes a while: effects that were switched on meanwhile, on now and not in `on_page`,
        the controls when it began, stay on.
        """
        now, controls = self.state.settings, self.model.live.controls
        values = {**now.values, **{n: fit.parameters[n].value for n in fit.names}}
        fitted = replace(asked, values=values, fit_scale=SCALE in fit.names)
        step = FitStep(
            number=next(self._numbers),
            asked=asked,
            settings=fitted,
            campaign=campaign,
            calibration=fit,
            priors=fit.model.campaign.priors,
            words=difference(self._opened, campaign, asked, controls),
        )
        switched_on = (name for name in now.effects if name not in on_page.effects)
        effects = tuple(dict.fromkeys((*asked.effects, *switched_on)))
        settings = replace(fitted, effects=effects, known=now.known)
        self.history.set_controls(settings, steps=(*self.state.steps, step))

    def diagnose(self, settings: Settings) -> None:
        """Find out which effects explain the misfit of the campaign without any of the page's."""

        def work() -> None:
            self._make_ready()
            live, campaign = self.model.live, self.state.campaign
            fitted, _ = live.controls.campaign_at(campaign, replace(settings, effects=()))
            simulations = live.simulations.of(fitted)
            diagnosis = diagnose(simulations)
            live.take(simulations)
            with self.history.lock:
                if self.state.campaign is campaign:
                    self.history.change(diagnosis=diagnosis)

        self.jobs.start(PageJob("diagnose", "diagnosing", work, parts=PARTS[1:]))

    # ---- the list of fits --------------------------------------------------------------------

    def go_back(self) -> None:
        """Everything off, the readings as they came, and the campaign's own fit."""
        if self.state.steps:
            self.show_step(self.state.steps[0].number)

    def undo(self, *, again: bool = False) -> None:
        """Take back the last fit, change of controls or readings, or removed step, or redo it."""
        with self.history.lock:
            if self.history.can_redo if again else self.history.can_undo:
                self.history.bring_back(undone=again)
                self._simulate_readings()

    def show_step(self, number: int) -> None:
        """Controls and readings as they were when a fit ended."""
        step = self.state.step(number)
        self.history.keep()
        if step.campaign is not self.state.campaign:
            self._take_readings(step.campaign)
        self.model.keep_anchor(step.settings, step.calibration.model)
        self.history.set_controls(step.settings)

    def remove_step(self, number: int) -> None:
        """Take a fit off the list."""
        step = self.state.step(number)
        if step is self.state.steps[0]:
            raise InputError("the campaign as it came stays in the list", "remove another fit")
        self.history.keep()
        self.history.change(steps=tuple(s for s in self.state.steps if s is not step))

    def compare_with(self, number: int) -> None:
        """Show the model beside a fit."""
        effects, ready = self.state.step(number).settings.effects, self.model.live.ready
        self.history.change(compared=number)
        if ready is None or not (ready.issuperset(effects) and self.model.is_simulated):
            work = functools.partial(self._make_ready, effects)
            self.jobs.start(PageJob("compare", "simulating the other fit", work))

    # ---- readings ----------------------------------------------------------------------------

    def edit(self, edited: Callable[..., Campaign], place: int, *cell: str) -> None:
        """Go on with another table.

        It is what ``exchange.with_cell`` (with column and text of a cell, ``use`` being 1 or 0),
        ``with_copy`` or ``without_row`` makes of the reading at a place.

        Raises InputError if it cannot be used, or the reading is not there any more.
        """
        campaign = self.state.campaign
        if not 0 <= place < len(campaign.measurements.readings):
            raise InputError("this reading is not there any more", "choose another")
        campaign = edited(campaign, self._folder, place, *cell)
        self.history.keep()
        self._take_readings(campaign)

    def _take_readings(self, campaign: Campaign) -> None:
        """Go on with a campaign's readings."""
        self.jobs.stop("diagnose")  # it would be of others
        self.history.change(campaign=campaign, diagnosis=None)
        self._simulate_readings()

    def _simulate_readings(self) -> None:
        """Simulate the readings' configurations where they are others; else they are as before."""

        def undo() -> None:
            with self.history.lock:
                while self.history.can_undo and not self.model.is_simulated:
                    self.history.bring_back()

        if not self.model.is_simulated:
            words = "simulating the changed readings"
            self.jobs.start(PageJob("readings", words, self._make_ready, undo=undo, again=True))

    # ---- files -------------------------------------------------------------------------------

    def take_readings(self, name: str, content: bytes) -> None:
        """Go on with other readings of the same bench.

        Raises InputError if the file cannot be used.
        """
        campaign = exchange.with_readings(self._first, name, content, self._folder)
        self.jobs.stop_all()
        # what is under way ends first
        work = functools.partial(self._open, campaign)
        self.jobs.start(PageJob("upload-button", f"opening {name}", work))

    def take_session(self, name: str, content: bytes) -> None:
        """Go on with a session that was kept in a file: its fits are made again.

        Raises InputError if the file cannot be used.
        """
        kept = exchange.read_session(name, content, self._first.scene)
        table = kept["table"].encode()
        campaign = exchange.with_readings(self._first, kept["measurements"], table, self._folder)
        self.jobs.stop_all()

        def work() -> None:
            self._open(campaign)
            self.jobs.start(PageJob("session", "making its fits again", lambda: self._refit(kept)))

        self.jobs.start(PageJob("upload-button", f"opening {name}", work))

    def _refit(self, kept: Mapping[str, Any]) -> None:
        """Make the fits of a kept session, and bring back its readings and controls."""

        @functools.cache
        def campaign(readings: str) -> Campaign:
            return exchange.with_table(self._opened, readings, self._folder)

        def settings(asked: Mapping[str, Any]) -> Settings:
            return settings_of(asked, self.state.settings.values, self.model.live.controls.effects)

        # the first is that of the campaign as it came
        self._make_ready()
        for fit in kept["fits"][1:]:
            self.history.change(campaign=campaign(fit["readings"]))
            self._make_ready()
            asked = settings(fit["settings"])
            self._fit(asked, asked)
        self.history.change(campaign=campaign(kept["readings"]))
        self._make_ready()
        steps, last = self.state.steps, settings(kept["settings"])
        place = int(kept["compared"])
        self.history.forget()
        self.history.set_controls(last, compared=steps[place].number if place < len(steps) else 0)
        if kept["diagnosed"]:
            self.diagnose(last)

    def offer(self, what: str, settings: Settings) -> None:
        """Make a file to be downloaded.

        It is the mended ``scene``, simulated as it is; with the ``campaign`` all that it needs; the
        ``report``; or the ``session``, which `take_session` opens.
        """

        def work() -> None:
            file = self._file(what, settings)
            with self.history.lock:
                self.history.file_number += 1
                self.history.file_kind = what
                self.history.change(file=file)

        parts = (*PARTS, ("report", 40)) if what == "report" else ()
        self.jobs.start(PageJob(f"get-{what}", f"writing the {what}", work, parts=parts))

    def _file(self, what: str, settings: Settings) -> tuple[str, bytes]:
        """Name and content of a file."""
        effects = settings.effects
        if what == "session":
            return exchange.session_file(replace(self.state, settings=settings))
        if what == "report":
            return exchange.report_file(self.state.campaign, effects, self._run, self._folder)
        self._make_ready(effects)
        campaign, controls = self.state.campaign, self.model.live.controls
        values, model = self.model.live.settle_at(campaign, settings)
        self.model.keep_anchor(settings, model)
        if what == "scene":
            return exchange.scene_file(campaign, effects, values)
        fitted, _ = controls.campaign_at(campaign, settings)
        parameters = {**fitted.parameters, SCALE: fitted.scale}
        named = (parameters.get(name) for name in controls.changed(settings))
        chosen = [parameter for parameter in named if parameter is not None]
        priors = self.model.priors_of_fit(settings)
        return exchange.campaign_archive(campaign, effects, values, priors, chosen)
