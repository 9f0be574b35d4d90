"""Draws of what is no effect: wrong readings, understated errors, and what has no name."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, softmax

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.inference.closed_form import MOST_CAUSES, Surroundings
from mcrim_mitsuba.inference.compare import WrongRows
from mcrim_mitsuba.inference.displacement import BaselineFrame
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.rival_causes import (
    UNDERSTATED,
    UNKNOWN,
    DiscrepancyModel,
    surroundings,
    suspicious,
    wrong_readings,
)
from mcrim_mitsuba.inference.settings import RIVALS


@dataclass(frozen=True, kw_only=True)
class Besides:
    """What is drawn besides effects."""

    #: As probabilities are listed.
    names: tuple[str, ...]
    #: That a diagnosis weighs beside it; below 0 where it does not weigh this.
    most_effects: int
    wrong: tuple[WrongRows, ...]
    #: (used,) float64: Further errors of wrong readings, relative to them, squared.
    variance: Array
    around: Surroundings
    #: (used,) float64: Of the logarithms of readings.
    discrepancy: Array

    def errors(self, stated: Array) -> Array:
        """(used, used) relative covariance of readings' own errors, of the one that is stated."""
        return self.around.error_factor**2 * stated + np.diag(self.variance)

    def exchanged(self, readings: Array) -> Array:
        """(used,) readings where they are written down."""
        for wrong in self.wrong:
            order, factors = wrong.exchange(len(readings))
            written = readings.copy()
            written[order] = readings / factors
            readings = written
        return readings


class Rivals:
    """Causes that are no effects, as a diagnosis of a campaign expects them."""

    def __init__(self, explanations: Explanations) -> None:
        frame = BaselineFrame(explanations.baseline)
        count = len(frame.fit.statistic.signal)
        # a diagnosis looks at the likeliest of them
        self._rows = suspicious(frame, count, math.comb(count, 2))
        self._causes = wrong_readings(frame, self._rows)
        self._surroundings = surroundings()
        covariance = DiscrepancyModel(explanations, frame).covariance()
        self._factor = np.linalg.cholesky(covariance)
        self.names = (*self._rows, UNKNOWN, UNDERSTATED)

    def drawn(self, rng: np.random.Generator) -> Besides:
        """Some of them, or none."""
        shares = softmax([around.log_prior for around in self._surroundings])
        around = self._surroundings[rng.choice(len(shares), p=shares)]
        there = rng.random(len(self._causes)) < expit([c.log_odds for c in self._causes])
        wrong = [self._rows[self._causes[place].name] for place in np.flatnonzero(there)]
        variance = np.zeros(len(self._factor))
        for lone in (rows for rows in wrong if not rows.partners):
            variance[list(lone.rows)] = rng.choice(RIVALS.bad_sizes) ** 2
        names = [rows.name for rows in wrong]
        names += [UNKNOWN] if around.amplitude > 0.0 else []
        names += [UNDERSTATED] if around.error_factor != 1.0 else []
        rows = [row for one in wrong for row in one.rows]
        apart = len(set(rows)) == len(rows)
        most = MOST_CAUSES if around.is_plain else MOST_CAUSES - 1
        return Besides(
            names=tuple(names),
            most_effects=most - len(wrong) if apart else -1,
            wrong=tuple(wrong),
            variance=variance,
            around=around,
            discrepancy=around.amplitude * self._factor @ rng.standard_normal(len(variance)),
        )
