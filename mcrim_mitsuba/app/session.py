"""What the page works on: a campaign with what was simulated and found."""

from __future__ import annotations

import functools
import itertools
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcrim_mitsuba.app import exchange
from mcrim_mitsuba.app.jobs import Jobs, PageJob
from mcrim_mitsuba.app.simulated_bench import SimulatedBench
from mcrim_mitsuba.app.state import (
    FREE,
    PRIOR,
    FitStep,
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
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.diagnose import diagnose_on
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.model import ResponseModel

#: Changes that can be undone.
_MOST_UNDONE = 50


class _OutdatedError(Exception):
    """The readings that are being simulated are not those of the table any more."""


class Session:
    """One user's work on one campaign, shared by all the pages that show it.

    Settings and predictions are asked for from any thread; what simulates runs in `jobs`. The
    campaign of its `state` is the one that it was opened with, or that with other readings; its
    `bench` follows where these have other configurations.

    Parameters
    ----------
    campaign : Campaign
    run : Run
        See `inference.workbench.Workbench`; its progress is shown on the page.
    folder : Path
        For uploads and for files to be downloaded.
    """

    def __init__(self, campaign: Campaign, run: Run, folder: Path) -> None:
        #: Rise with every change, with every one that pages take over, with every file to be
        #: downloaded, and with everything for which pages are loaded anew.
        self.number = self.settings_number = self.file_number = self.bench_number = 0
        self.jobs = Jobs(self._change)
        #: Held by whoever asks for more than one thing that belongs together.
        self.lock = threading.RLock()
        self._run, self._folder = replace(run, progress=self._report), folder
        self._first = campaign
        # that of changed readings, while it is simulated
        self._following: SimulatedBench | None = None
        self._open(campaign)

    def _open(self, campaign: Campaign) -> None:
        # as it came, to the page or from a file
        self._opened = campaign
        self.bench = SimulatedBench(campaign, self._run)
        self._shown_beside: tuple[Any, Campaign, Shown | None] | None = None
        self._undone: list[State] = []
        self._numbers = itertools.count()
        #: What jobs have found so far.
        self.state = State(campaign)
        self.bench_number += 1
        self._set_controls(Settings(values=self._starts(), fit_scale=SCALE in campaign.free))
        self._start("bench", "simulating the bench", self._make_ready)

    def _starts(self) -> dict[str, float]:
        return {control.name: control.start for control in self.bench.all_controls}

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

    @property
    def has_beams(self) -> bool:
        """Whether transmittances are, or were, among the readings."""
        each = (self._opened, self.state.campaign)
        return any(one.of_beam for campaign in each for one in campaign.measurements.readings)

    # ---- what the model says -----------------------------------------------------------------

    def show(self, settings: Settings) -> Shown | None:
        """Predictions at some settings; None before the readings were simulated.

        Their chi2 counts what the last fit with the same effects took as known of their sizes.
        """
        free = {n for n, known in self.bench.known(settings).items() if known.how == FREE}
        sizes = self._priors_of_fit(settings)
        known = {n: Known(PRIOR, *sizes[n]) for n in free & sizes.keys()}
        settings = replace(settings, known={**settings.known, **known})
        return self.bench.show(self.state.campaign, settings)

    def shown_beside(self) -> tuple[FitStep, Shown] | None:
        """The fit beside which the model is shown, and what it predicts for today's readings.

        None while it cannot be: its effects are simulated first.
        """
        campaign = self.state.campaign
        if not self.state.steps:
            return None
        step = self.state.beside
        key = (step.number, id(campaign), id(self.bench), self.bench.version)
        if self._shown_beside is None or self._shown_beside[0] != key:
            # with what its key is the identity of
            self._shown_beside = (key, campaign, self.show(step.settings))
        shown = self._shown_beside[2]
        return None if shown is None or shown.pending else (step, shown)

    # ---- what takes longer -------------------------------------------------------------------

    def _report(self, *told: Any) -> None:
        self.jobs.report(*told)
        if self._following is not None and not self._following.fits(self.state.campaign):
            raise _OutdatedError

    def _start(
        self, key: str, words: str, work: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> None:
        self.jobs.start(PageJob(key, words, work, undo or (lambda: None)))

    def _make_ready(self, effects: Sequence[str] = ()) -> None:
        """Simulate what is not simulated yet: the readings' bench as it is, and effects.

        The first time the campaign is fitted as it came.
        """
        if not self.state.steps:
            before, campaign = self.state.settings, self._opened
            self.bench.simulate()
            self._change()
            model = self.bench.workbench(campaign).model()
            found = fit_model(model, profile=False)
            self._fitted(model, found, Settings(values=before.values), before, campaign)
        while not self._is_simulated:
            self._follow(effects)
        self.bench.simulate(effects)
        self._change()

    def _follow(self, effects: Sequence[str]) -> None:
        """Simulate readings of other configurations, unless they change meanwhile."""
        state = self.state
        bench = SimulatedBench(state.campaign, self._run)
        wanted = {*effects, *state.settings.effects, *state.beside.settings.effects}
        self._following = bench
        try:
            bench.simulate(wanted & bench.effects.keys())
        except _OutdatedError:
            return
        finally:
            self._following = None
        with self.lock:
            if bench.fits(self.state.campaign):
                if not bench.moves_as(self.bench):
                    self.bench_number += 1
                self.bench = bench
                settings = self.state.settings
                values = {**self._starts(), **settings.values}
                self._change(settings=replace(settings, values=values))

    def switch_on(self, effect: str) -> None:
        """Simulate an effect, if it was not simulated yet; its switch is off where that fails."""

        def undo() -> None:
            settings = self.state.settings
            kept = tuple(name for name in settings.effects if name != effect)
            self._set_controls(replace(settings, effects=kept))

        if not self._is_ready([effect]):
            self._start(
                f"effect {effect}",
                f"simulating {self.bench.effects[effect][0].title}",
                lambda: self._make_ready([effect]),
                undo,
            )

    def _is_ready(self, effects: Sequence[str]) -> bool:
        ready = self.bench.ready
        return ready is not None and ready.issuperset(effects) and self._is_simulated

    @property
    def _is_simulated(self) -> bool:
        """Whether the bench is that of the readings in the table."""
        return self.bench.fits(self.state.campaign)

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
        titles = [
            self.bench.effects[name][0].title for name in effects if name in self.bench.effects
        ]
        self._start(
            f"add {' '.join(effects)}",
            f"adding {', '.join(titles)}",
            lambda: self._fit(more, settings),
        )

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
        bench, campaign = self.bench, self.state.campaign
        fitted, rest = bench.fitted_campaign(campaign, wanted)
        model, found = bench.workbench(fitted).settled_model(rest, wanted.values)
        bench.keep_anchor(wanted.effects, model.anchor)
        self._keep()
        self._fitted(model, found, wanted, pressed, campaign)

    def _fitted(
        self,
        model: ResponseModel,
        found: Calibration,
        wanted: Settings,
        pressed: Settings,
        campaign: Campaign,
    ) -> None:
        """Take over a fit of what was wanted; what was switched on since it was asked for stays."""
        now = self.state.settings
        values = {**now.values, **{n: found.parameters[n].value for n in found.names}}
        fitted = replace(wanted, values=values, fit_scale=SCALE in found.names)
        words = difference(
            self._opened,
            campaign,
            wanted,
            self.bench.known(wanted),
            [*self.bench.controls, *(c for n in wanted.effects for c in self.bench.effects[n][1])],
        )
        step = FitStep(
            next(self._numbers), wanted, fitted, campaign, found, model.campaign.priors, words
        )
        since = (name for name in now.effects if name not in pressed.effects)
        effects = tuple(dict.fromkeys((*wanted.effects, *since)))
        self._set_controls(
            replace(fitted, effects=effects, known=now.known), steps=(*self.state.steps, step)
        )

    def diagnose(self, settings: Settings) -> None:
        """Find out which effects explain the misfit of the campaign without any of the page's."""

        def work() -> None:
            self._make_ready()
            bench, campaign = self.bench, self.state.campaign
            fitted, _ = bench.fitted_campaign(campaign, replace(settings, effects=()))
            workbench = bench.workbench(fitted)
            found = diagnose_on(workbench)
            bench.take(workbench)
            with self.lock:
                if self.state.campaign is campaign:
                    self._keep()
                    self._change(diagnosed=found)

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
            if self._undone:
                self._bring_back()
                self._simulate_readings()

    def _bring_back(self) -> None:
        """As it was when it was kept last, but for the file to be downloaded."""
        *self._undone, before = self._undone
        # the campaign's own fit stays, once it is there
        steps = before.steps or self.state.steps[:1]
        self._set_controls(
            before.settings,
            campaign=before.campaign,
            steps=steps,
            compared=before.compared,
            diagnosed=before.diagnosed,
        )

    def _step(self, number: int) -> FitStep:
        for step in self.state.steps:
            if step.number == number:
                return step
        raise InputError("this fit is not there any more", "choose another")

    def show_step(self, number: int) -> None:
        """Controls and readings as they were when a fit ended."""
        step = self._step(number)
        self._keep()
        if step.campaign is not self.state.campaign:
            self._take(step.campaign)
        self._set_controls(step.settings)

    def remove_step(self, number: int) -> None:
        """Take a fit off the list."""
        step = self._step(number)
        if step is self.state.steps[0]:
            raise InputError("the campaign as it came stays in the list", "remove another fit")
        self._keep()
        self._change(steps=tuple(s for s in self.state.steps if s is not step))

    def compare_with(self, number: int) -> None:
        """Show the model beside a fit."""
        step = self._step(number)
        self._change(compared=number)
        effects = step.settings.effects
        if not self._is_ready(effects):
            self._start("compare", "simulating the other fit", lambda: self._make_ready(effects))

    # ---- readings ----------------------------------------------------------------------------

    def edit_reading(self, place: int, column: str, text: str) -> None:
        """Go on with other text in a cell of the table; ``use`` is 1 or 0.

        Raises
        ------
        InputError
            If it cannot be used.
        """
        self._edit(exchange.with_cell, place, column, text)

    def copy_reading(self, place: int) -> None:
        """Go on with one more reading, like another but not in use."""
        self._edit(exchange.with_copy, place)

    def drop_reading(self, place: int) -> None:
        """Go on without a reading.

        Raises
        ------
        InputError
            If the others are too few.
        """
        self._edit(exchange.without_row, place)

    def _edit(self, edited: Callable[..., Campaign], place: int, *given: str) -> None:
        campaign = self.state.campaign
        if not 0 <= place < len(campaign.measurements.readings):
            raise InputError("this reading is not there any more", "choose another")
        campaign = edited(campaign, self._folder, place, *given)
        self._keep()
        self._take(campaign)

    def _take(self, campaign: Campaign) -> None:
        """Go on with a campaign's readings."""
        self.jobs.stop("diagnose")  # it would be of others
        self._change(campaign=campaign, diagnosed=None)
        self._simulate_readings()

    def _simulate_readings(self) -> None:
        """Simulate the readings' configurations where they are others; else they are as before."""

        def undo() -> None:
            with self.lock:
                while self._undone and not self._is_simulated:
                    self._bring_back()

        if not self._is_simulated:
            words = "simulating the changed readings"
            self.jobs.start(PageJob("readings", words, self._make_ready, undo, again=True))

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

        @functools.cache
        def campaign(readings: str) -> Campaign:
            return exchange.with_table(self._opened, readings, self._folder)

        def settings(asked: Mapping[str, Any]) -> Settings:
            return settings_of(asked, self.state.settings.values, self.bench.effects)

        # the first is that of the campaign as it came
        self._make_ready()
        for fit in kept["fits"][1:]:
            self._change(campaign=campaign(fit["readings"]))
            self._make_ready()
            wanted = settings(fit["settings"])
            self._fit(wanted, wanted)
        self._change(campaign=campaign(kept["readings"]))
        self._make_ready()
        steps, last = self.state.steps, settings(kept["settings"])
        place = int(kept["compared"])
        self._undone = []
        self._set_controls(last, compared=steps[place].number if place < len(steps) else 0)
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
            effects = settings.effects
            if what not in ("session", "report"):
                self._make_ready(effects)
            campaign, bench = self.state.campaign, self.bench
            if what == "session":
                file = exchange.session_file(replace(self.state, settings=settings))
            elif what == "report":
                file = exchange.report_file(campaign, effects, self._run, self._folder)
            else:
                values = bench.settle_at(campaign, settings)
                if what == "scene":
                    file = exchange.scene_file(campaign, effects, values)
                else:
                    fitted, _ = bench.fitted_campaign(campaign, settings)
                    named, known = {**fitted.parameters, SCALE: fitted.scale}, bench.known(settings)
                    chosen = [
                        named[c.name]
                        for c in bench.all_controls
                        if named.get(c.name) and known[c.name] != c.known
                    ]
                    file = exchange.campaign_archive(
                        campaign,
                        effects,
                        values,
                        self._priors_of_fit(settings),
                        [parameter for parameter in chosen if parameter is not None],
                    )
            with self.lock:
                self.file_number += 1
                self._change(file=file)

        self._start(f"get-{what}", f"writing the {what}", work)

    def _priors_of_fit(self, settings: Settings) -> Mapping[str, tuple[float, float]]:
        """What the last fit with these effects took as known of sizes that are left free."""
        for step in reversed(self.state.steps):
            if set(step.settings.effects) == set(settings.effects):
                free = {n for n, k in self.bench.known(step.settings).items() if k.how == FREE}
                return {n: known for n, known in step.priors.items() if n in free}
        return {}
