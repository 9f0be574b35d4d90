"""What the page works on: a campaign with what was simulated and found, and the job that runs."""

from __future__ import annotations

import math
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from mcrim_mitsuba.app import exchange
from mcrim_mitsuba.app.state import (
    Control,
    FitStep,
    Settings,
    Shown,
    State,
    effect_control,
    parameter_control,
)
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.diagnose import diagnose_on
from mcrim_mitsuba.inference.estimates import fitted_rows
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.likelihood import FrozenStatistic, Likelihood, p_value
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.inference.workbench import Workbench


class CancelledError(Exception):
    """The user wants the job to end."""


@dataclass(frozen=True)
class Status:
    """What the job thread is doing."""

    #: In words; empty when idle.
    job: str = ""
    #: What the job is at.
    stage: str = ""
    #: Of the stage.
    done: int = 0
    total: int = 0
    #: Why the last job came to nothing; empty if it did not fail.
    error: str = ""

    @property
    def busy(self) -> bool:
        """Whether a job is running."""
        return bool(self.job)


class Jobs:
    """Runs jobs one after the other.

    All of them run in the same thread: Mitsuba's variant belongs to a thread.
    """

    def __init__(self) -> None:
        self._waiting: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        # Ctrl-C need not wait for a long simulation
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()
        self._lock = threading.Lock()
        #: What is going on now.
        self.status = Status()
        self._cancelled = False

    def start(self, job: str, work: Callable[[], None]) -> bool:
        """Begin a job, unless another one is running; returns whether it began."""
        with self._lock:
            if self.status.busy:
                return False
            self._cancelled = False
            self.status = Status(job=job, stage=job)
        self._waiting.put(work)
        return True

    def cancel(self) -> None:
        """Let the running job end at its next report."""
        self._cancelled = True

    def report(self, stage: str, done: int, total: int, _note: str = "") -> None:
        """Told by the job how far it is.

        Raises
        ------
        CancelledError
            If the job is to end.
        """
        if self._cancelled:
            raise CancelledError
        self.status = replace(self.status, stage=stage, done=done, total=total)

    def close(self, patience_seconds: float) -> None:
        """Stop the running job and take no more; waits for so long at most."""
        self.cancel()
        self._waiting.put(None)
        self._thread.join(patience_seconds)

    def _work(self) -> None:
        while (work := self._waiting.get()) is not None:
            self._run(work)

    def _run(self, work: Callable[[], None]) -> None:
        error = ""
        try:
            work()
        except CancelledError:
            error = f"{self.status.job}: stopped; what was simulated is kept"
        except InputError as refusal:
            error = str(refusal)
        except Exception as fault:
            traceback.print_exc(file=sys.stderr)
            error = (
                f"this is our fault, not yours ({type(fault).__name__}): please report the lines "
                "in the terminal"
            )
        self.status = Status(error=error)


# The campaign.

#: Steps of the scale's fit: it is linear but for effects of the readings, which bend it a little.
_SCALE_STEPS = 4


class Session:
    """One user's work on one campaign, shared by all the pages that show it.

    Settings and predictions are asked for from any thread; what simulates runs in `jobs`. Its
    `campaign` is the one that it was opened with, or that with uploaded readings.

    Parameters
    ----------
    campaign : Campaign
    run : Run
        See `inference.diagnose.Workbench`; its progress is shown on the page.
    folder : Path
        For uploads and for files to be downloaded.
    """

    def __init__(self, campaign: Campaign, run: Run, folder: Path) -> None:
        self.jobs = Jobs()
        self._lock = threading.Lock()
        self._run, self._folder = replace(run, progress=self.jobs.report), folder
        self._first = campaign
        #: What jobs have found so far.
        self.state = State()
        self._open(campaign)

    def _open(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self._bench = Workbench(campaign, self._run)
        self._models: dict[tuple[str, ...], tuple[frozenset[str] | None, ResponseModel]] = {}
        #: Of the campaign's own parameters; the scale, where it is free, comes last.
        self.controls = self._own_controls()
        readings, own = campaign.measurements.readings, self._bench.own_maker.configurations()
        # sliders are the bench's
        of_bench = [v for v, r in zip(own, readings, strict=True) if not r.of_beam]
        scene = campaign.scene.parameters
        known = (scene, of_bench or [scene], self._largest_signal)
        #: Effects that can be switched on, with their controls.
        self.effects = {
            name: (effect, tuple(effect_control(one, *known) for one in effect.parameters))
            for name, effect in self._bench.possible().items()
        }
        values = {c.name: c.start for c in self._all_controls()}
        self._change(
            ready=None, baseline=None, settled={}, steps=(), diagnosed=None, file=None,
            settings=Settings(values=values), settings_number=self.state.settings_number + 1,
        )  # fmt: skip
        self.jobs.start("simulating the bench", self._simulate)

    def _change(self, **changes: Any) -> None:
        with self._lock:
            self.state = replace(self.state, number=self.state.number + 1, **changes)

    def _set_controls(self, settings: Settings, **changes: Any) -> None:
        """Let the pages take over other settings."""
        number = self.state.settings_number + 1
        self._change(settings=settings, settings_number=number, **changes)

    def remember(self, settings: Settings, number: int) -> Settings:
        """Keep what a page's controls say, for the next page that opens; returns what holds.

        `number` is the `settings_number` that the page knows: if it is an older one, what it says
        is out of date.
        """
        with self._lock:
            if number == self.state.settings_number:
                self.state = replace(self.state, settings=settings)
            return self.state.settings

    # ---- what can be moved -------------------------------------------------------------------

    def _own_controls(self) -> tuple[Control, ...]:
        maker, free = self._bench.own_maker, self.campaign.free
        covered = {
            ALPHA_SCAT: maker.grid.alpha_scat_range_per_cm,
            ALPHA_ABS: maker.grid.alpha_abs_range_per_cm,
        }
        own = [
            parameter_control(known, covered.get(name))
            for name, known in self.campaign.parameters.items()
            if not known.fixed
        ]
        if SCALE in free:
            # a quarter of the light is a usual part
            usual = 4.0 * self._largest_signal
            own.append(Control(SCALE, "scale", "signal at η = 1", 0.0, 3.0 * usual, usual))
        return tuple(own)

    @property
    def _largest_signal(self) -> float:
        return max(abs(reading.signal) for reading in self.campaign.measurements.readings)

    def _all_controls(self) -> list[Control]:
        return [*self.controls, *(c for _, own in self.effects.values() for c in own)]

    @property
    def refused(self) -> tuple[str, ...]:
        """Why some effects cannot be switched on."""
        return tuple(self._bench.notes)

    # ---- what the model says -----------------------------------------------------------------

    def show(self, settings: Settings) -> Shown | None:
        """Predictions at some settings; None before anything was simulated.

        Takes about a millisecond.
        """
        state = self.state
        if state.ready is None:
            return None
        effects = tuple(name for name in settings.effects if name in state.ready)
        model = self._model(effects, state)
        likelihood = Likelihood(model)
        theta = np.array([
            min(max(settings.values.get(p.name, p.start), p.minimum), p.maximum)
            if p.name != SCALE
            else settings.values[SCALE]
            for p in model.free
        ])  # fmt: skip
        names = [parameter.name for parameter in model.free]
        sigma = 0.0
        if SCALE in names and settings.fit_scale:
            sigma = _fit_scale(likelihood, theta, names.index(SCALE))
        statistic = FrozenStatistic(likelihood, likelihood.errors_at(theta))
        prediction = model.predict(theta, check=True)
        assert prediction.eta_sigma is not None  # checked
        assert prediction.interpolation_error is not None
        errors = list(map(math.hypot, prediction.eta_sigma, prediction.interpolation_error))
        chi2, ndf = statistic.chi2(theta), model.campaign.ndf
        return Shown(
            rows=fitted_rows(model.readings, prediction, errors), chi2=chi2, ndf=ndf,
            p_value=p_value(chi2, ndf), scale=prediction.scale,
            light_yield=self._light_yield(prediction.scale, sigma),
            pending=tuple(name for name in settings.effects if name not in effects),
        )  # fmt: skip

    def _model(self, effects: tuple[str, ...], state: State) -> ResponseModel:
        key = tuple(sorted(effects))
        if key in state.settled:
            return state.settled[key]
        # while nothing new was simulated a model stays what it is
        known = self._models.get(key)
        if known is None or known[0] != state.ready:
            known = self._models[key] = (state.ready, self._bench.model(key))
        return known[1]

    @property
    def light_title(self) -> str:
        """What is proportional to the light: the light yield, or else the scale."""
        if self.campaign.light_yield is None or SCALE not in self.campaign.free:
            return SCALE
        return "light yield (ph/keV)"

    def _light_yield(self, scale: float, sigma: float) -> tuple[float, float, float] | None:
        known = self.campaign.light_yield
        if known is None or SCALE not in self.campaign.free:
            return None
        relative = known.detector_efficiency_sigma / known.detector_efficiency
        return scale * known.per_scale, sigma * known.per_scale, scale * known.per_scale * relative

    # ---- what takes longer -------------------------------------------------------------------

    def _simulate(self) -> None:
        """Simulate the bench as it is, and fit it."""
        self._bench.simulate()
        self._change(ready=self._bench.simulated)
        found = fit_model(self._bench.model(), profile=False)
        self._set_controls(
            self._fitted(found, ()), baseline=found, steps=(FitStep((), found),)
        )  # fmt: skip

    def switch_on(self, effects: Sequence[str]) -> bool:
        """Simulate effects that were not simulated yet."""
        return self.jobs.start(
            f"simulating {', '.join(effects)}", lambda: self._make_ready(effects)
        )

    def _make_ready(self, effects: Sequence[str]) -> None:
        ready = self.state.ready or frozenset()
        known = self._bench.precise
        if any(name not in ready or name not in known for name in effects):
            self._bench.simulate(sorted({*ready, *effects}), look=ready - {*effects})
            self._change(ready=self._bench.simulated)

    def fit(self, settings: Settings) -> bool:
        """Fit all that is switched on, beginning where the controls are."""
        return self.jobs.start("fitting", lambda: self._fit(settings.effects, settings.values))

    def add(self, effects: Sequence[str], settings: Settings) -> bool:
        """Switch more effects on and fit."""
        wanted = tuple(dict.fromkeys((*settings.effects, *effects)))
        values = {**settings.values, **self._sizes(wanted)}
        return self.jobs.start(f"adding {', '.join(effects)}", lambda: self._fit(wanted, values))

    def _sizes(self, effects: tuple[str, ...]) -> dict[str, float]:
        """What the diagnosis made of a set of effects."""
        found = self.state.diagnosed
        if found is None:
            return {}
        for candidate in (*found.diagnosis.candidates, *found.diagnosis.pairs):
            if set(candidate.effects) == set(effects):
                return {n: known.value for n, known in candidate.parameters.items()}
        return {}

    def _fit(self, effects: Sequence[str], values: Mapping[str, float]) -> None:
        self._make_ready(effects)
        key = tuple(sorted(effects))
        model, found = self._bench.settled_model(key, values)
        steps = self.state.steps
        if steps and sorted(steps[-1].effects) == list(key):
            steps = steps[:-1]
        self._set_controls(
            self._fitted(found, tuple(effects)),
            settled={**self.state.settled, key: model},
            steps=(*steps, FitStep(tuple(effects), found)),
        )

    def _fitted(self, found: Calibration, effects: tuple[str, ...]) -> Settings:
        """Controls at the values of a fit."""
        values = dict(self.state.settings.values)
        values |= {name: found.parameters[name].value for name in found.names}
        return Settings(effects, values, fit_scale=True)

    def diagnose(self) -> bool:
        """Find out which effects explain the misfit of the campaign as it came."""

        def work() -> None:
            found = diagnose_on(self._bench)
            self._change(diagnosed=found, ready=self._bench.simulated)

        return self.jobs.start("diagnosing", work)

    def go_back(self) -> None:
        """Everything off, and the campaign's own fit."""
        baseline, values = self.state.baseline, {c.name: c.start for c in self._all_controls()}
        self._change(steps=self.state.steps[:1])
        settings = Settings(values=values)
        self._set_controls(settings if baseline is None else self._fitted(baseline, ()))

    # ---- files -------------------------------------------------------------------------------

    def take_readings(self, name: str, content: bytes) -> None:
        """Go on with other readings of the same bench.

        Raises
        ------
        InputError
            If the file cannot be used.
        """
        self._open(exchange.with_readings(self._first, name, content, self._folder))

    def offer(self, what: str, settings: Settings) -> bool:
        """Make a file to be downloaded.

        It is the mended ``scene``, simulated as it is; with the ``campaign`` all that it needs; or
        the ``report``.
        """

        def work() -> None:
            campaign, effects = self.campaign, settings.effects
            if what == "report":
                file = exchange.report_file(campaign, effects, self._run, self._folder)
            else:
                self._make_ready(effects)
                fitted = self.state.settled.get(tuple(sorted(effects)))
                values = self._settle_at(settings)
                if what == "scene":
                    file = exchange.scene_file(campaign, effects, values)
                else:
                    priors = fitted.campaign.priors if fitted is not None else {}
                    file = exchange.campaign_archive(campaign, effects, values, priors)
            self._change(file=file, file_number=self.state.file_number + 1)

        return self.jobs.start(f"writing the {what}", work)

    def _settle_at(self, settings: Settings) -> dict[str, float]:
        """Simulate all that is switched on together, where the controls are.

        So that the page shows what a simulation of the downloaded scene gives.
        """
        key = tuple(sorted(settings.effects))
        switched_on = [self.campaign.catalogue[n] for n in (*self.campaign.effects, *key)]
        # sizes of other effects may be the scene's own parameters: those stay as they are
        used = {*self.campaign.parameters, *(p.name for e in switched_on for p in e.parameters)}
        values = {name: value for name, value in settings.values.items() if name in used}
        if not self._bench.own_maker.is_exact(switched_on):
            free = self._bench.model(key).free
            here = {p.name: values.get(p.name, p.start) for p in free if p.name != SCALE}
            model = self._bench.anchored_model(key, here)
            self._set_controls(settings, settled={**self.state.settled, key: model})
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
