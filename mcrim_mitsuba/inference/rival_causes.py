"""Causes that are no effect of the catalogue: wrong readings, understated errors, a discrepancy.

If what a bench lacks is in no catalogue, the best of many wrong effects may fit all the same, with
an error that is much too small. So these causes are weighed with effects, in the same sets.

Wrong readings have a further error of their own; two rows may have been exchanged; or all stated
errors are too small by one factor.

A discrepancy delta changes the logarithms of all predictions (M. C. Kennedy and A. O'Hagan, J. R.
Statist. Soc. B 63 (2001) 425). It is Gaussian, delta ~ N(0, tau^2 Sigma), and made of what a bench
can do:

    Sigma = (U Omega U^T) o [(1 - rho) 1 1^T + rho K] + m (kappa^2 K + lambda^2)

The columns of U are what every effect of the catalogue does at its usual size, nothing refitted;
Omega weighs families alike, and effects of one family; K is a Gaussian kernel over the readings'
configurations, m the mean of the diagonal of U Omega U^T; o multiplies element by element. As it
moves all readings together, too, what it does to the light yield follows.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import erfinv

from mcrim_mitsuba.campaign.measurements import KIND, LIGHT
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.inference.closed_form import Cause, Discrepancy, Surroundings
from mcrim_mitsuba.inference.compare import (
    BAD_READING,
    SWAPPED_ROWS,
    WrongRows,
    likely_swaps,
    swapped_treatments,
)
from mcrim_mitsuba.inference.displacement import BaselineFrame
from mcrim_mitsuba.inference.drivers import Minimum, settle
from mcrim_mitsuba.inference.estimates import left_out
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.settings import DISCREPANCY, RIVALS
from mcrim_mitsuba.inference.statistic import Statistic, Weights, is_misfit

#: What a discrepancy is called beside effects.
UNKNOWN = "unknown"
#: And stated errors that are too small.
UNDERSTATED = "understated errors"


def surroundings() -> tuple[Surroundings, ...]:
    """Nothing besides causes, then discrepancies of rising amplitude, then understated errors."""
    shares = 1.0 / (1.0 + np.square(DISCREPANCY.amplitudes))
    shares *= DISCREPANCY.odds / shares.sum()
    # ln(factor) is half-normal: the middle of as many parts of it
    parts = (np.arange(RIVALS.error_factors) + 0.5) / RIVALS.error_factors
    factors = np.exp(RIVALS.error_factor_sigma * np.sqrt(2.0) * erfinv(parts))
    odds = RIVALS.understated_odds / len(factors)
    return (
        Surroundings(log_prior=0.0),
        *(
            Surroundings(log_prior=math.log(share), amplitude=amplitude)
            for share, amplitude in zip(shares.tolist(), DISCREPANCY.amplitudes, strict=True)
        ),
        *(
            Surroundings(log_prior=math.log(odds), error_factor=factor)
            for factor in factors.tolist()
        ),
    )


# ---- wrong readings ----


def suspicious(
    frame: BaselineFrame,
    most_readings: int = RIVALS.most_readings,
    most_swaps: int = RIVALS.most_swaps,
) -> dict[str, WrongRows]:
    """Readings that may be wrong, rows and treatments that may be exchanged, by name.

    Of many readings those whose error would explain most, of all exchanges of rows the likeliest.
    """
    labels = frame.fit.statistic.labels
    # squared, what chi2 falls by without the reading
    _, pulls = left_out(frame.fit)
    likeliest = np.sort(np.argsort(-np.abs(pulls), kind="stable")[:most_readings])
    wrong = [WrongRows(BAD_READING, (labels[row],), (row,)) for row in likeliest.tolist()]
    wrong += likely_swaps(frame.fit, most_swaps) + swapped_treatments(frame.fit)
    return {rows.name: rows for rows in wrong}


def wrong_readings(frame: BaselineFrame, suspicions: Mapping[str, WrongRows]) -> list[Cause]:
    """Suspicious readings and rows as causes."""
    statistic = frame.fit.statistic
    signal, measured = frame.fit.signal[statistic.used], statistic.signal
    count, kinds = len(signal), Counter(wrong.kind for wrong in suspicions.values())
    # of rows and readings all ways, of treatments all that there are
    ways = {BAD_READING: count, SWAPPED_ROWS: max(math.comb(count, 2), 1)}
    causes = []
    for name, wrong in suspicions.items():
        lone, change = not wrong.partners, np.zeros((count, 1))
        sizes = np.array(RIVALS.bad_sizes if lone else (1.0,))
        # a factor on the reading, or what it would change by, were it put where it belongs
        order, factors = wrong.exchange(count)
        change[:, 0] = (measured - factors * measured[order]) / signal
        if lone:
            change[list(wrong.rows), 0] = 1.0
        moves, of_scale = frame.of_factors(change)
        origins, slopes = np.zeros((len(sizes), len(frame.z))), np.outer(sizes, moves)
        log_scales, log_scale_slopes = np.zeros(len(sizes)), sizes * of_scale
        if not lone:
            origins, slopes = slopes, origins
            log_scales, log_scale_slopes = log_scale_slopes, log_scales
        odds = RIVALS.bad_odds if lone else RIVALS.swapped_odds
        cause = Cause(
            name=name,
            log_odds=math.log(odds / ways.get(wrong.kind, kinds[wrong.kind])),
            log_weights=np.full(len(sizes), -math.log(len(sizes))),
            origins=origins,
            slopes=slopes,
            log_scales=log_scales,
            log_scale_slopes=log_scale_slopes,
        )
        causes.append(cause)
    return causes


# ---- a discrepancy ----


class DiscrepancyModel:
    """The covariance of what the model does not explain, per squared amplitude."""

    def __init__(self, explanations: Explanations, frame: BaselineFrame) -> None:
        self._statistic = frame.fit.statistic
        names = [name for name in explanations.effects if explanations.possible((name,))]
        families = Counter(explanations.effects[name].family for name in names)
        shares = [1.0 / families[explanations.effects[name].family] for name in names]
        self._weights = np.array(shares) / max(len(families), 1)
        #: (used, effects) What effects of usual sizes do to the logarithms of readings.
        self._usual = np.zeros((len(self._statistic.signal), 0))
        if names:
            self._usual = np.column_stack([_usual(explanations, name, frame) for name in names])

    def covariance(self, further: Sequence[Mapping[str, Value]] = ()) -> Array:
        """(used + further,) squared, of the logarithms of readings.

        `further` are configurations by what they differ from the scene: an effect acts there as it
        does, by the kernel, on the readings around them.
        """
        usual, count = self._usual, len(self._usual)
        kernel = _correlation(self._statistic, further)
        if further:
            near = kernel[:count, :count] + DISCREPANCY.smoothing * np.eye(count)
            usual = np.vstack([usual, kernel[count:, :count] @ np.linalg.solve(near, usual)])
        together = (usual * self._weights) @ usual.T
        mean = float(np.trace(together[:count, :count])) / max(count, 1)
        rho = DISCREPANCY.kernel_part
        own = DISCREPANCY.kernel_variance * kernel
        own = own + DISCREPANCY.lone_variance * np.eye(len(kernel))
        return np.asarray(together * (1.0 - rho + rho * kernel) + mean * own, float)

    def seen_from(self, frame: BaselineFrame) -> Discrepancy:
        """As sets are weighed with it around a fit."""
        covariance = self.covariance()
        moves, of_scale = frame.of_factors(np.eye(len(covariance)))
        return Discrepancy(
            covariance=moves @ covariance @ moves.T,
            with_scale=moves @ covariance @ of_scale,
            of_scale=float(of_scale @ covariance @ of_scale),
        )


def frame_beside(explanations: Explanations, frame: BaselineFrame) -> BaselineFrame | None:
    """A frame around where the baseline's fit goes beside a discrepancy; None if it needs none.

    Readings that no fit describes may push a parameter to its bound, far from where all that
    explains them has it: there it could not move, and lines are straight for less far.
    """
    fit, own = frame.fit, frame.fit.statistic
    if not any(fit.at_bound) or not is_misfit(fit.chi2, fit.p_value):
        return None
    covariance = DiscrepancyModel(explanations, frame).covariance()
    fits = [
        settle(own.with_unexplained(amplitude**2 * covariance), fit.theta)
        for amplitude in DISCREPANCY.amplitudes
    ]
    free = [minimum for minimum in fits if not any(minimum.at_bound)]
    if not free:
        return None
    theta = min(free, key=lambda minimum: minimum.deviance).theta
    weights = Weights(own.errors_at(theta))
    return BaselineFrame(Minimum.at(own, theta, own.chi2(theta, weights), weights, converged=True))


def _usual(explanations: Explanations, effect: str, frame: BaselineFrame) -> Array:
    """(used,) change of ln(reading) by an effect of its usual size, nothing fitted."""
    statistic, values = explanations.statistic((effect,)), dict(frame.fit.values)
    priors = explanations.priors((effect,))
    for name in explanations.free_parameters((effect,), effect):
        values[name] = float(priors[name].value(np.array([DISCREPANCY.usual_size]))[0])
    signal = statistic.model.predict(statistic.theta(values)).signal[statistic.used]
    return np.log(np.maximum(signal / frame.fit.signal[frame.fit.statistic.used], 1e-6))


def discrepancy_at(
    fit: Minimum,
    discrepancy: DiscrepancyModel,
    amplitude: float,
    thetas: Array,
    configurations: Sequence[Mapping[str, Value]],
) -> Array:
    """(points, configurations) a discrepancy of ln(reading), drawn given the readings.

    `thetas` are (points, free) parameters of the fit's model. Configurations are given
    by what they differ from the scene; a transmittance has a ``kind``.
    """
    statistic = fit.statistic
    used, count = len(statistic.signal), len(thetas)
    covariance = amplitude**2 * discrepancy.covariance(configurations)
    signal = fit.signal[statistic.used]
    errors = fit.weights.covariance / np.outer(signal, signal)
    predicted = statistic.model.predict_many(thetas)[:, statistic.used]
    gain = np.linalg.solve(covariance[:used, :used] + errors, covariance[:used, used:])
    mean = (statistic.signal / predicted - 1.0) @ gain
    left = covariance[used:, used:] - covariance[used:, :used] @ gain
    values, vectors = np.linalg.eigh(left)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = np.random.default_rng(0).standard_normal((count, len(configurations)))
    return np.asarray(mean + drawn @ spread.T, float)


def _correlation(statistic: Statistic, further: Sequence[Mapping[str, Value]] = ()) -> Array:
    """Correlations of a discrepancy between readings: exp(-d^2 / 2 length^2).

    (used + further,) squared; `further` are configurations by what they differ from the scene. d is
    the distance of two configurations: of every parameter that differs between readings in parts of
    their range, of lengths in that of their logarithms. A beam has nothing in common with light.
    """
    readings = [r for r in statistic.model.readings if r.use]
    values = statistic.model.campaign.values
    rows = [
        *((r.parameters, r.of_beam) for r in readings),
        *((each, each.get(KIND, LIGHT) != LIGHT) for each in further),
    ]
    light = [i for i, (_, of_beam) in enumerate(rows) if not of_beam]
    read = sum(i < len(readings) for i in light)
    squared_distance = np.zeros((len(light), len(light)))
    for name in sorted({n for i in light[:read] for n in rows[i][0]}):
        places = _places(name, [rows[i][0].get(name, values.get(name)) for i in light], read)
        squared_distance += np.subtract.outer(places, places) ** 2
    correlation = np.eye(len(rows))
    correlation[np.ix_(light, light)] = np.exp(-0.5 * squared_distance / DISCREPANCY.length**2)
    return correlation


def _places(name: str, cells: Sequence[Value | None], read: int) -> Array:
    """(cells,) places of values in their range: 0 to 1 for the first ones, those of readings."""
    numbers = [float(c) for c in cells if isinstance(c, int | float)]
    if len(numbers) == len(cells):
        at = np.array(numbers)
        if name.endswith("_mm") and at.min() > 0.0:
            at = np.log(at)
    else:  # names
        levels = sorted({str(cell) for cell in cells})
        at = np.array([float(levels.index(str(cell))) for cell in cells])
    low, span = at[:read].min(), float(np.ptp(at[:read]))
    return (at - low) / span if span > 0.0 else np.zeros(len(at))
