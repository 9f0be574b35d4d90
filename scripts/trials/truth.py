"""What trials that draw campaigns have in common: where truths are drawn, what is not told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.cli.terminal import DONE, OUR_FAULT, Screen
from trials.executor import Trial, Trials

#: Where truths are drawn: alpha_scat evenly in its logarithm, the others evenly.
TRUE_ALPHA_SCAT_PER_CM, TRUE_ALPHA_ABS_PER_CM = (0.15, 1.2), (0.027, 0.051)
TRUE_SCALE = (20.0, 60.0)
#: Standard error of the absorption that is measured beforehand, 1/cm.
PRIOR_SIGMA_PER_CM = 0.012
#: Most causes at once, as of what a diagnosis weighs.
MOST_CAUSES = 3

_Drawn = TypeVar("_Drawn")


def drawn_at_last(draw: Callable[[], _Drawn | None], most: int, what: str) -> _Drawn:
    """The first of at most so many draws that will do; RuntimeError tells of `what` none does."""
    for _ in range(most):
        if (drawn := draw()) is not None:
            return drawn
    raise RuntimeError(what)


def draw_absorption_and_scale(rng: np.random.Generator) -> tuple[float, float]:
    """The absorption, 1/cm, and the readings' unit."""
    return rng.uniform(*TRUE_ALPHA_ABS_PER_CM), rng.uniform(*TRUE_SCALE)


def do_missing(
    screen: Screen,
    who: str,
    trials: Trials,
    function: Callable[..., Any],
    arguments: Mapping[Trial, tuple[Any, ...]],
    log: str | None,
) -> int | None:
    """Do the trials that are missing, and say as `unfinished` what is then lacking."""
    with terminal.photon_progress(log=log) as report:
        failures = trials.do(function, arguments, report)
    return unfinished(screen, who, failures, trials, lacking=bool(failures or trials.elsewhere))


def unfinished(
    screen: Screen, who: str, failures: list[str], *trials: Trials, lacking: bool
) -> int | None:
    """Say what has failed, and, if trials are lacking, how many are done: the exit status then."""
    for words in (*failures, *(one.state() for one in trials if lacking)):
        screen.say(f"{who}: {words}")
    if not lacking:
        return None
    return OUR_FAULT if failures else DONE
