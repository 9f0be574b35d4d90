"""Where a model fails: pulls, expected spread, suspect readings, trends, what was absorbed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc, ndtr

from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import ALPHA_SCAT, Value
from mcrim_mitsuba.inference.drivers import Minimum, newton
from mcrim_mitsuba.inference.estimates import corrected, left_out, left_out_error, pulls, rms_pull
from mcrim_mitsuba.inference.explanations import plausible_ranges
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, SUSPICION
from mcrim_mitsuba.inference.statistic import Weights, p_value

#: Kinds of suspicion: one reading off; the signals of two rows exchanged, or of two treatments.
BAD_READING = "bad_reading"
SWAPPED_ROWS = "swapped_rows"
SWAPPED_TREATMENTS = "swapped_treatments"


@dataclass(frozen=True)
class WrongRows:
    """Rows that may be wrong: their places among the readings in use."""

    #: `BAD_READING`, `SWAPPED_ROWS` or `SWAPPED_TREATMENTS`.
    kind: str
    #: Labels of the rows; of treatments their names.
    labels: tuple[str, ...]
    rows: tuple[int, ...]
    #: Rows that have, of each, the reading that it should have, and by what theirs is to be
    #: multiplied; empty: nobody has it.
    partners: tuple[int, ...] = ()
    factors: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """As probabilities list it: ``bad reading gel``, ``swapped rows air and gel``."""
        return f"{self.kind.replace('_', ' ')} {' and '.join(self.labels)}"

    def exchange(self, readings: int) -> tuple[NDArray[np.int64], Array]:
        """(readings,) which row has the reading that a row should have, and its factor."""
        order, factors = np.arange(readings), np.ones(readings)
        if self.partners:
            order[list(self.rows)], factors[list(self.rows)] = self.partners, self.factors
        return order, factors


@dataclass(frozen=True)
class Suspect:
    """Readings that may be wrong, rather than the model."""

    #: `BAD_READING`, `SWAPPED_ROWS` or `SWAPPED_TREATMENTS`.
    kind: str
    #: The reading, or the two; of treatments their names.
    labels: tuple[str, ...]
    #: What chi2 falls by without the reading, or with the two exchanged.
    delta_chi2: float
    #: Probability of as much by chance, corrected for having tried all readings or pairs.
    p_gain: float
    #: Of the fit without it.
    chi2: float
    ndf: int
    p_value: float | None
    #: Of the single reading from what the others predict, in standard errors.
    pull: float | None
    #: Whether the fit without it is acceptable.
    explains: bool

    @property
    def words(self) -> str:
        """``bad reading gel (+5.1 sigma)``, ``swapped air and gel``."""
        names = " and ".join(self.labels)
        if self.kind == SWAPPED_TREATMENTS:
            return f"swapped labels of {names}"
        if self.kind == SWAPPED_ROWS:
            return f"swapped {names}"
        by = "" if self.pull is None else f" ({self.pull:+.1f} sigma)"
        return f"bad reading{'s' if len(self.labels) > 1 else ''} {names}{by}"

    def score(self, readings: int) -> float:
        """What ranks suspicions among so many readings: chi2, unknowns, and ways to suspect."""
        unknowns, ways = _unknowns_and_ways(self.kind, readings, len(self.labels))
        return self.chi2 + 2.0 * unknowns + 2.0 * math.log(ways)


def _unknowns_and_ways(kind: str, readings: int, wrong: int) -> tuple[int, int]:
    """Unknowns that a suspicion adds, and how many there are of its kind."""
    return (wrong if kind == BAD_READING else 0), math.comb(readings, wrong)


@dataclass(frozen=True)
class Trend:
    """How the pulls run along one bench parameter."""

    #: A column of the measurement file.
    parameter: str
    #: Its values, ascending.
    levels: tuple[Value, ...]
    #: Weighted mean residual of each level, in readings' standard errors.
    mean_pulls: tuple[float, ...]
    #: What chi2 falls by if every level may have a factor of its own.
    delta_chi2: float
    #: Factors that the free parameters do not absorb.
    ndf: int
    #: Of the spread between levels against that within (F test), corrected for the number of
    #: bench parameters; None without degrees of freedom left.
    p_value: float | None


@dataclass(frozen=True)
class Absorbed:
    """A fitted parameter that looks as if it had taken up a misfit."""

    parameter: str
    #: ``prior_pulled``, ``bound_reached`` or ``implausible``.
    sign: str
    value: float
    #: The same for the reader.
    words: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Calibration):
    """A fitted campaign, laid out to show where the model fails."""

    #: ndf - sqrt(2 ndf), ndf + sqrt(2 ndf): where chi2 lies in 2 of 3 campaigns.
    expected_chi2: tuple[float, float]
    #: In standard errors of the readings; the second of readings left out of the fit.
    rms_pull: float
    left_out_error: float
    #: By label: how far every reading in use is from what the others predict, in standard errors.
    left_out_pulls: dict[str, float]
    #: Single bad readings and swapped rows that account for the misfit, the likeliest first.
    suspects: tuple[Suspect, ...]
    #: The clearest first.
    trends: tuple[Trend, ...]
    absorbed: tuple[Absorbed, ...]


def comparison_of(fit: Calibration) -> Comparison:
    """A fit laid out to show where the model fails."""
    minimum, spread = fit.minimum, math.sqrt(2.0 * max(fit.ndf, 0))
    _, pulls = left_out(minimum)
    usual = plausible_ranges(fit.model.campaign.switched_on, fit.model)
    return Comparison(
        **{part.name: getattr(fit, part.name) for part in fields(fit)},
        expected_chi2=(max(fit.ndf - spread, 0.0), fit.ndf + spread),
        rms_pull=rms_pull(minimum),
        left_out_error=left_out_error(minimum),
        left_out_pulls=dict(zip(minimum.statistic.labels, pulls.tolist(), strict=True)),
        suspects=tuple(find_suspects(minimum)),
        trends=find_trends(minimum),
        absorbed=find_absorbed(minimum, usual),
    )


# ---- readings that may be wrong ----


def find_suspects(fit: Minimum) -> list[Suspect]:
    """Single readings and pairs of rows that account for a campaign's misfit, the likeliest first.

    Empty where the campaign fits, or has no degrees of freedom to say so. Those that explain the
    readings as well as the best; or the best one, where it accounts for most of the misfit.
    """
    p, readings = fit.p_value, len(fit.statistic.signal)
    if p is None or p > ACCEPTABLE_P:
        return []
    suspects = [suspect for suspect in (*_bad_readings(fit), *_swapped(fit)) if suspect.explains]
    suspects = [suspect for suspect in suspects if suspect.p_gain < ACCEPTABLE_P]
    suspects.sort(key=lambda suspect: suspect.score(readings))
    return [
        suspect
        for suspect in suspects
        if suspect.score(readings) < suspects[0].score(readings) + SUSPICION.rival
    ]


def _bad_readings(fit: Minimum) -> list[Suspect]:
    """Single readings, each with an offset of its own."""
    _, pulls = left_out(fit)
    suspects = []
    for i in np.argsort(-np.abs(pulls))[: SUSPICION.to_the_end]:
        variance = fit.weights.errors.variance.copy()
        variance[i] += SUSPICION.left_out * fit.weights.covariance[i, i]
        weights = Weights(replace(fit.weights.errors, variance=variance))
        chi2 = newton(fit.statistic, fit.theta, weights).height
        gain = max(fit.chi2 - chi2, 0.0)
        # to first order the square of the pull is the gain
        pull = math.copysign(math.sqrt(gain), pulls[i])
        wrong = WrongRows(BAD_READING, (fit.statistic.labels[i],), (i,))
        suspects.append(suspected(fit, wrong, chi2, pull))
    return suspects


def _swapped(fit: Minimum) -> list[Suspect]:
    """Pairs of rows, and treatments, with their signals and errors exchanged."""
    followed = []
    for wrong in (*likely_swaps(fit, 2 * SUSPICION.to_the_end), *swapped_treatments(fit)):
        statistic = fit.statistic.exchanged(*wrong.exchange(len(fit.statistic.signal)))
        # signals move with their own errors, all else stays
        weights = Weights(replace(fit.weights.errors, variance=statistic.variance))
        chi2 = newton(statistic, fit.theta, weights).height
        followed.append((chi2, wrong))
    followed.sort(key=lambda item: (item[0], item[1].rows))
    return [suspected(fit, wrong, chi2) for chi2, wrong in followed[: SUSPICION.to_the_end]]


def swapped_treatments(fit: Minimum) -> list[WrongRows]:
    """Pairs of treatments, of three rows or more, whose labels may have been exchanged.

    A row then should have the reading of that of the other treatment which is nearest along the
    column of most values, by the model carried to the row's own place; in all else they are alike.
    Treatments that have rows without the like are left out.
    """
    model, treatments = fit.statistic.model, dict[tuple[str, ...], list[int]]()
    readings = [reading for reading in model.readings if reading.use]
    for row, reading in enumerate(readings):
        if not reading.of_beam:
            treatments.setdefault(reading.without, []).append(row)
    several = [rows for rows in treatments.values() if len(rows) > 2]
    if not 1 < len(several) <= SUSPICION.most_treatments:
        return []
    columns = {
        name: [reading.parameters.get(name) for reading in readings]
        for name in model.campaign.measurements.columns
    }
    numbers = [n for n, cells in columns.items() if all(isinstance(c, float) for c in cells)]
    axis = max(numbers, key=lambda name: len(set(columns[name])), default=None)
    place = np.zeros(len(readings)) if axis is None else np.array(columns[axis], float)
    others = [cells for name, cells in columns.items() if name != axis]
    alike = [
        (reading.energy_keV, reading.sample, *(cells[row] for cells in others))
        for row, reading in enumerate(readings)
    ]
    log_signal = np.log(np.maximum(fit.signal[fit.statistic.used], 1e-300))

    def from_other(row: int, mine: Sequence[int], other: Sequence[int]) -> tuple[int, float] | None:
        """The other treatment's row for one of a treatment's own, and the factor on its reading."""
        can = [i for i in other if alike[i] == alike[row]]
        if not can:
            return None
        partner = min(can, key=lambda i: abs(place[i] - place[row]))
        line = sorted((i for i in mine if alike[i] == alike[row]), key=lambda i: place[i])
        there = np.interp(place[partner], place[line], log_signal[line])
        return partner, math.exp(log_signal[row] - there)

    pairs = []
    for first, second in combinations(several, 2):
        places = [from_other(row, first, second) for row in first]
        places += [from_other(row, second, first) for row in second]
        whole = [item for item in places if item is not None]
        if len(whole) == len(places):
            labels = tuple(_treatment_name(readings, rows) for rows in (first, second))
            partners, factors = zip(*whole, strict=True)
            rows = (*first, *second)
            pairs.append(WrongRows(SWAPPED_TREATMENTS, labels, rows, partners, factors))
    return pairs


def _treatment_name(readings: Sequence[Reading], rows: Sequence[int]) -> str:
    """What a treatment is called: the mounting that it alone is of, or its first row."""
    first = readings[rows[0]]
    of_mounting = [row for row, reading in enumerate(readings) if reading.group == first.group]
    return first.group if first.group and of_mounting == rows else first.label


def likely_swaps(fit: Minimum, most: int) -> list[WrongRows]:
    """Pairs of rows whose exchange, with that of their own errors, lowers chi2 most.

    To first order around the fit: with residuals that move by d, and P of `Minimum.precision`, chi2
    rises by 2 d^T g + d^T P d, where g = C^-1 r; and falls by h^T (1/v + P)^-1 h of the two rows,
    where v is what is added to their variances and h = g + P d.
    """
    precision, signal = fit.precision, fit.statistic.signal
    pulled, own = fit.weighted_residuals, np.diag(precision)
    variance = fit.statistic.variance
    # (used, used): of the first row by that of the second
    moved, added = (np.subtract.outer(each, each).T for each in (signal, variance))
    first, second = own[:, None], own
    rise = moved * (2.0 * np.subtract.outer(pulled, pulled))
    rise += moved**2 * (first + second - 2.0 * precision)
    of_first = pulled[:, None] + moved * (first - precision)
    of_second = pulled - moved * (second - precision)
    one, other = 1.0 + added * first, 1.0 - added * second
    fall = added * (other * of_first**2 - one * of_second**2)
    fall += 2.0 * (added * precision) * (added * of_first * of_second)
    heights = rise - fall / (one * other + (added * precision) ** 2)
    rows, columns = np.triu_indices(len(signal), 1)
    lowest = np.argsort(heights[rows, columns], kind="stable")[:most]
    labels, pairs = fit.statistic.labels, np.transpose([rows[lowest], columns[lowest]]).tolist()
    return [
        WrongRows(SWAPPED_ROWS, (labels[i], labels[j]), (i, j), (j, i), (1.0, 1.0))
        for i, j in pairs
    ]


def suspected(fit: Minimum, wrong: WrongRows, chi2: float, pull: float | None = None) -> Suspect:
    """A suspicion that leaves a chi2 of a fit's."""
    unknowns, ways = _unknowns_and_ways(wrong.kind, len(fit.statistic.signal), len(wrong.labels))
    gain = fit.chi2 - chi2
    p = _chance(fit, wrong, gain) if wrong.partners else float(chdtrc(unknowns, max(gain, 0.0)))
    ndf = fit.ndf - unknowns
    left = p_value(chi2, ndf)
    return Suspect(
        kind=wrong.kind,
        labels=wrong.labels,
        delta_chi2=gain,
        p_gain=corrected(p, ways),
        chi2=chi2,
        ndf=ndf,
        p_value=left,
        pull=pull,
        explains=left is not None and left >= ACCEPTABLE_P,
    )


def _chance(fit: Minimum, wrong: WrongRows, gain: float) -> float:
    """Probability that exchanging correct rows lowers chi2 by as much.

    Exchanging moves the readings by a known amount: the gain is 2 z s - s^2, s the size of what the
    parameters cannot follow.
    """
    predicted = fit.signal[fit.statistic.used]
    order, factors = wrong.exchange(len(predicted))
    moved = factors * predicted[order] - predicted
    size = math.sqrt(max(float(moved @ fit.precision @ moved), 1e-12))
    return float(ndtr(-(gain + size**2) / (2.0 * size)))


# ---- along which bench parameter the pulls run ----


def find_trends(fit: Minimum) -> tuple[Trend, ...]:
    """Bench parameters by how clearly the pulls differ between their values, the clearest first.

    Every value (level) of a bench parameter is given a factor of its own on the signal, and the
    fall of chi2 is compared with what is left, as an analysis of variance does:
    F = (fall / factors) / (rest / its degrees of freedom). What the free parameters follow is no
    factor: all is weighed with `Minimum.precision`. With too many levels for the readings a
    straight line takes their place. There is one for each column of the readings with two values or
    more, those that switch parts of the bench included.
    """
    model = fit.statistic.model
    rows = [model.campaign.cells(reading) for reading in model.readings if reading.use]
    varied = []
    for name in rows[0]:
        cells = [row[name] for row in rows]
        # a beam has no gap, and the bench no acceptance
        levels = sorted({c for c in cells if c is not None}, key=lambda v: (isinstance(v, str), v))
        if len(levels) > 1:
            at = np.array([-1 if c is None else levels.index(c) for c in cells])
            varied.append((name, tuple(levels), at))
    trends = [_trend(fit, name, levels, which, len(varied)) for name, levels, which in varied]
    # without a p-value the fall in chi2 decides
    return tuple(sorted(trends, key=lambda t: (t.p_value is None, t.p_value, -t.delta_chi2)))


def _trend(fit: Minimum, name: str, levels: tuple, which: np.ndarray, tried: int) -> Trend:
    """How much chi2 falls if predictions have a factor for each level of one parameter.

    `which`, (used,), is the level of every reading, -1 without one. Where levels are too many for
    the degrees of freedom, the factor is linear in their number.
    """
    predicted = fit.signal[fit.statistic.used]
    factors = predicted[:, None] * (which[:, None] == np.arange(len(levels)))
    if len(levels) - 1 > max(fit.ndf // 2, 1):
        factors = (predicted * (which - which[which >= 0].mean()) * (which >= 0))[:, None]
    # what the parameters follow is no factor
    whole = np.sqrt(np.einsum("ij,ij->j", factors, fit.weights.inverse @ factors))
    values, vectors = np.linalg.eigh(factors.T @ fit.precision @ factors / np.outer(whole, whole))
    kept = values > SUSPICION.absorbed
    along = vectors[:, kept].T @ (factors.T @ fit.weighted_residuals / whole)
    fall, count = float((along**2 / values[kept]).sum()), int(kept.sum())
    rest, ndf = max(fit.chi2 - fall, 0.0), fit.ndf - count
    p = None
    if count > 0 and ndf > 0:
        f = (fall / count) / max(rest / ndf, 1e-300)
        p = corrected(float(fdtrc(count, ndf, f)), tried)
    own = pulls(fit)
    means = tuple(float(own[which == i].mean()) for i in range(len(levels)))
    return Trend(name, levels, means, fall, count, p)


# ---- parameters that took up a misfit ----


def find_absorbed(
    fit: Minimum, plausible: Mapping[str, tuple[float, float]]
) -> tuple[Absorbed, ...]:
    """Parameters with the marks of having taken up a misfit."""
    absorbed = []
    for parameter, at, side in zip(fit.statistic.free, fit.theta, fit.at_bound, strict=True):
        name, value, signs = parameter.name, float(at), []
        if parameter.prior is not None and parameter.prior_sigma is not None:
            pull = (value - parameter.prior) / parameter.prior_sigma
            if abs(pull) > SUSPICION.pulled:
                signs.append(
                    ("prior_pulled", f" = {value:.3g} is {pull:+.1f} sigma from its prior")
                )
        if side is not None:
            signs.append(("bound_reached", f" ended at its {side} {value:.3g}"))
        elif name == ALPHA_SCAT:
            edge = (parameter.maximum / parameter.minimum) ** SUSPICION.edge
            if not parameter.minimum * edge < value < parameter.maximum / edge:
                signs.append(("implausible", f" = {value:.3g} is close to an end of its range"))
        low, high = plausible.get(name, (value, value))
        if not low <= value <= high:
            signs.append(("implausible", f" = {value:.3g}, but usual is {low:g} to {high:g}"))
        absorbed += [Absorbed(name, sign, value, name + words) for sign, words in signs]
    return tuple(absorbed)
