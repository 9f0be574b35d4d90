"""Fits with effects added, and how much the best of many effects gains by chance.

Around the baseline fit the readings and priors, whitened and freed of what the free parameters
follow, are ndf independent standard normal numbers z. There ``chi2 = |z|^2``, and an effect is a
curve s(value) through the origin: with it ``chi2 = |z - s|^2``, at best. The curve is sampled at
the effect's nodes, every other parameter fitted there to the baseline's own prediction, and
straight between them. So gains under the null hypothesis are drawn by the thousand without a single
further fit, with bounds, ranges that end, and effects without a parameter (a point instead of a
curve, the gain then negative as often as not) all included; R. B. Davies, Biometrika 64 (1977) 247,
for why no chi-squared distribution describes parameters that only exist under the alternative."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np
from scipy.linalg import null_space
from scipy.special import chdtrc, ndtr

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.inference.drivers import (
    Minimum,
    best_of,
    local_minima,
    newton,
    settle,
)
from mcrim_mitsuba.inference.estimates import corrected, criterion, error_of_difference
from mcrim_mitsuba.inference.evidence import (
    Evidence,
    PriorDensity,
    around,
    even,
    evidence_of,
    of_parameter,
    size,
)
from mcrim_mitsuba.inference.model import Model
from mcrim_mitsuba.inference.settings import CHANCE, EXPLAINING, RISE_95
from mcrim_mitsuba.inference.statistic import Statistic, inverse

#: Gives the model of the campaign with these effects, besides its own.
Models = Callable[[tuple[str, ...]], Model]


class Explanations:
    """The campaign with whatever effects are asked for, each set built and fitted once.

    `scales` are values, by name, of the scale and of samples' own scales, around which their priors
    lie; by default those of the baseline. Give the same to all where evidences of several campaigns
    are compared.
    """

    def __init__(
        self,
        models: Models,
        effects: Mapping[str, Effect],
        baseline: Minimum,
        scales: Mapping[str, float] = {},
    ) -> None:
        self._models = models
        self.effects = dict(effects)
        self._statistics: dict[tuple[str, ...], Statistic] = {}
        self._fits: dict[tuple[str, ...], Minimum] = {}
        self._evidences: dict[tuple[str, ...], Evidence] = {}
        self._by_size: dict[str, Array] = {}
        #: Effects that cannot be fitted here, with the reason.
        self.refused: dict[str, str] = {}
        # an effect may be one of the scene's parameters off its nominal value
        self._scene = self.statistic(()).model.campaign.values
        #: Of the campaign as it is.
        self.baseline = baseline
        campaign = self.statistic(()).model.campaign
        found = self.baseline.values
        self.scales = {n: v for n, v in found.items() if campaign.stands_for(n) == SCALE}
        self.scales |= scales
        self._fits[()] = self.baseline

    def statistic(self, added: Iterable[str]) -> Statistic:
        """The campaign with these effects; `InputError` where the scene cannot take them."""
        key = tuple(sorted(added))
        if key not in self._statistics:
            self._statistics[key] = Statistic(self._models(key))
        return self._statistics[key]

    def possible(self, added: Iterable[str]) -> bool:
        """Whether these effects may be together and leave the readings something to say."""
        added = tuple(added)
        for a, b in combinations(added, 2):
            if a in self.effects[b].excludes or b in self.effects[a].excludes:
                return False
        if any(name in self.refused for name in added):
            return False
        try:
            return self.statistic(added).ndf >= 0
        except InputError as error:
            if len(added) == 1:
                self.refused[added[0]] = error.problem
            return False

    def singles(self) -> dict[str, Minimum]:
        """The fit with each possible effect alone."""
        fits = {}
        for name in self.effects:
            if self.possible((name,)):
                fits[name] = self.fit((name,))
            elif name not in self.refused:
                self.refused[name] = "more parameters than readings and priors"
        return fits

    def fit(self, added: Iterable[str]) -> Minimum:
        """The best fit with these effects added, started from those with one of them less."""
        key = tuple(sorted(added))
        if key not in self._fits:
            statistic = self.statistic(key)
            starts: list[Array] = []
            fewers = {name: tuple(other for other in key if other != name) for name in key}
            # what has been fitted is a start; the rest need not be for this
            known = [name for name, fewer in fewers.items() if fewer in self._fits]
            for name in known or key:
                fewer = self.fit(fewers[name])
                profile = self.profile(key, name, fewer)
                lowest = local_minima([height for height, _ in profile])[:3]
                starts += [profile[i][1] for i in lowest]
            self._fits[key] = best_of(statistic, starts, self.baseline.weights)
        return self._fits[key]

    def free_parameters(self, added: Iterable[str], effect: str) -> tuple[str, ...]:
        """Parameters of an effect that the fit with these effects varies."""
        names = self.statistic(added).names
        return tuple(p.name for p in self.effects[effect].parameters if p.name in names)

    def absent(self, effect: str) -> dict[str, float]:
        """The value of each of an effect's parameters at which it is not there."""
        parameters = self.effects[effect].parameters
        return {p.name: p.origin(self._scene) + (p.absent or 0.0) for p in parameters}

    def plausible(self, added: Iterable[str]) -> dict[str, tuple[float, float]]:
        """What a laboratory usually meets of some effects, by parameter."""
        effects = [self.effects[name] for name in added]
        return plausible_ranges(effects, self.baseline.statistic.model)

    def is_plausible(self, added: Iterable[str]) -> bool:
        """Whether a laboratory meets effects of the sizes that were fitted, or that fit as well.

        Outside of what is plausible, chi2 may not rise by 1 on the way to its nearest end.
        """
        added = tuple(added)
        fit, nearest = self.fit(added), {}
        for name, (low, high) in self.plausible(added).items():
            value = fit.values.get(name, low)
            if not low <= value <= high:
                nearest[name] = min(max(value, low), high)
        if not nearest:
            return True
        start = fit.statistic.theta({**fit.values, **nearest})
        held = [fit.statistic.index(name) for name in nearest]
        chi2 = newton(fit.statistic, start, fit.weights, held=held, precision=0.01)[1]
        return chi2 < fit.chi2 + 1.0

    def title(self, added: Iterable[str]) -> str:
        """Effects in words; several are joined by "with"."""
        return " with ".join(self.effects[name].title for name in added)

    def family(self, added: Iterable[str]) -> str:
        """What effects are relatives of; of several families all, joined by ``+``."""
        return " + ".join(dict.fromkeys(self.effects[name].family for name in added))

    def evidence(self, added: Iterable[str], *, hopeless: bool = False) -> Evidence:
        """Of the campaign with these effects, their sizes being plausible ones.

        A hopeless one is known to its order of magnitude, if not better from before.
        """
        key = tuple(sorted(added))
        if key not in self._evidences:
            fit = self.fit(key)
            self._evidences[key] = evidence_of(fit, self.priors(key), hopeless=hopeless)
        return self._evidences[key]

    def log_odds(self, added: Iterable[str]) -> float:
        """Natural logarithm of the odds, before the readings, of some effects to none.

        Each is there with odds of one to their number: about as often something is missing as
        nothing.
        """
        return -len(tuple(added)) * math.log(max(len(self.singles()), 1))

    def priors(self, added: Iterable[str]) -> dict[str, PriorDensity]:
        """What is known of every free parameter of the model with some effects, by name."""
        added = tuple(added)
        plausible = self.plausible(added)
        of_effects = {p.name: p for name in added for p in self.effects[name].parameters}
        densities = {}
        for known in self.statistic(added).free:
            effect = of_effects.get(known.name)
            if effect is not None and known.prior is None:
                usual, (low, high) = plausible[known.name], (known.minimum, known.maximum)
                least, most = max(usual[0], low), min(usual[1], high)
                if not least < most:  # a campaign asks for what is not usual
                    densities[known.name] = of_parameter(known)
                elif effect.absent is None or not math.isfinite(effect.absent):
                    densities[known.name] = even(least, most)
                else:
                    absent = effect.origin(self._scene) + effect.absent
                    densities[known.name] = size(absent, usual, low, high)
            elif known.name in self.scales and known.prior is None:
                densities[known.name] = around(self.scales[known.name])
            else:
                densities[known.name] = of_parameter(known)
        return densities

    def nodes(self, added: Iterable[str], effect: str) -> list[dict[str, float]]:
        """Values of an effect's free parameters that span it, in their order; [{}] without any."""
        names, absent = self.free_parameters(added, effect), self.absent(effect)
        known = {p.name: p for p in self.effects[effect].parameters}
        axes = []
        for name in names:
            values = np.array(known[name].nodes, float) + known[name].origin(self._scene)
            if not len(values):
                values = self._nodes_by_size(effect, name)
            bounds = self.statistic(added).parameter(name)
            values = np.unique(np.clip(values, bounds.minimum, bounds.maximum)).tolist()
            axes.append([v for v in values if not math.isclose(v, absent[name], abs_tol=1e-12)])
        while math.prod(len(axis) for axis in axes) > EXPLAINING.most_nodes:
            axes = [axis[:: max(1, len(axis) // 3)] for axis in axes]
        return [dict(zip(names, values, strict=True)) for values in product(*axes)]

    def _nodes_by_size(self, effect: str, name: str) -> Array:
        """Values of a parameter for which the catalogue has none: some standard errors of it."""
        if name not in self._by_size:
            statistic, baseline = self.statistic((effect,)), self.baseline
            theta = statistic.theta({**baseline.values, **self.absent(effect)})
            slopes = statistic.model.predict(theta).signal_slopes[statistic.used]
            whitened = baseline.weights.whiten(slopes.T).T
            information = whitened.T @ whitened + np.diag(statistic.prior_weight)
            place = statistic.index(name)
            sigma = math.sqrt(inverse(information)[place, place])
            self._by_size[name] = theta[place] + sigma * np.array(EXPLAINING.sizes)
        return self._by_size[name]

    def profile(
        self,
        added: Iterable[str],
        effect: str,
        fewer: Minimum,
        *,
        statistic: Statistic | None = None,
        steps: int = 4,
        precision: float = 0.05,
    ) -> list[tuple[float, Array]]:
        """chi2 and parameters along an effect's nodes, all other parameters fitted.

        The effect is among `added`, and the others start from the fit `fewer` with all but it. A
        `statistic` may have other readings than the campaign's; `steps` and `precision` are those
        of `newton`.
        """
        statistic = statistic or self.statistic(added)
        names = self.free_parameters(added, effect)
        held = [statistic.index(name) for name in names]
        weights = self.baseline.weights
        if not names:
            start = statistic.theta(fewer.values)
            theta, chi2, _ = newton(statistic, start, weights, steps=steps, precision=precision)
            return [(chi2, theta)]
        nodes, absent = self.nodes(added, effect), self.absent(effect)
        order = list(range(len(nodes)))
        if single := len(names) == 1:
            # from the absent value outwards, each from where its neighbour ended
            thetas = [statistic.theta({**fewer.values, **node}) for node in (absent, *nodes)]
            there, *x = (statistic.internal(theta)[held[0]] for theta in thetas)
            order.sort(key=lambda i: abs(x[i] - there))
        points: dict[int, tuple[float, Array]] = {}
        warm: dict[bool, dict[str, float]] = {}
        for i in order:
            side = nodes[i][names[0]] > absent[names[0]]
            start = statistic.theta({**warm.get(side, fewer.values), **nodes[i]})
            theta, chi2, _ = newton(
                statistic, start, weights, held=held, steps=steps, precision=precision
            )
            points[i] = (chi2, theta)
            if single:
                warm[side] = statistic.values(theta)
        return [points[i] for i in range(len(nodes))]

    def ranked_pairs(self) -> list[tuple[str, ...]]:
        """The best fitting pairs of all effects, the best first, fitted to the end."""
        return self._ranked(combinations(self.singles(), 2), EXPLAINING.pairs_to_the_end)

    def ranked_further(self, chosen: tuple[str, ...]) -> list[tuple[str, ...]]:
        """The same of fitted effects with one more, which is the last."""
        others = [name for name in self.singles() if name not in chosen]
        return self._ranked([(*chosen, name) for name in others], EXPLAINING.further_to_the_end)

    def _ranked(self, sets: Iterable[tuple[str, ...]], to_the_end: int) -> list[tuple[str, ...]]:
        """The best of many sets of effects.

        Every set is followed for two steps from a few starts, the better half further, and the best
        few to the end.
        """

        def followed(
            starts: list[tuple[tuple[str, ...], list[Array]]], steps: int, precision: float
        ) -> list[tuple[tuple[str, ...], Array]]:
            """Sets with where their best start leads, the best first."""
            ranked = []
            for added, each in starts:
                statistic, weights = self.statistic(added), self.baseline.weights
                theta, height, _ = min(
                    (newton(statistic, s, weights, steps=steps, precision=precision) for s in each),
                    key=lambda end: end[1],
                )
                ranked.append((height + 2.0 * len(statistic.names), added, theta))
            ranked.sort(key=lambda item: item[0])
            return [(added, theta) for _, added, theta in ranked]

        rough = followed([(s, self._starts(s)) for s in sets if self.possible(s)], 2, 1.0)
        better = [(added, [theta]) for added, theta in rough[: (len(rough) + 1) // 2]]
        best = followed(better, 5, 0.3)[:to_the_end]
        for added, theta in best:
            key = tuple(sorted(added))
            fit, other = self.fit(key), settle(self.statistic(key), theta)
            if other.deviance < fit.deviance:
                self._fits[key] = other
        return sorted((added for added, _ in best), key=lambda added: criterion(self.fit(added)))

    def _starts(self, added: tuple[str, ...]) -> list[Array]:
        """Effects as they are without one of them, and that one as it is alone, and middling."""
        statistic, starts = self.statistic(added), []
        for other in added:
            fewer = tuple(sorted(name for name in added if name != other))
            if fewer not in self._fits:
                continue
            values = self._fits[fewer].values
            nodes = sorted(self.nodes(added, other), key=lambda n: self._size(added, other, n))
            starts.append(statistic.theta({**values, **nodes[len(nodes) // 2]}))
            if other == added[-1]:
                starts.append(statistic.theta({**self._fits[other,].values, **values}))
        return starts

    def _size(self, added: Iterable[str], effect: str, node: Mapping[str, float]) -> float:
        """How far an effect's values are from its absence, relative to its range."""
        statistic = self.statistic(added)
        base = self.baseline.values
        there = statistic.internal(statistic.theta({**base, **node}))
        absent = statistic.internal(statistic.theta({**base, **self.absent(effect)}))
        span = np.where(
            np.isfinite(statistic.high - statistic.low), statistic.high - statistic.low, 1.0
        )
        return float(np.abs((there - absent) / span).max(initial=0.0))


def plausible_ranges(effects: Iterable[Effect], model: Model) -> dict[str, tuple[float, float]]:
    """What a laboratory usually meets of some effects, by parameter, beside a model's readings."""
    signals = np.array([r.signal for r in model.readings if r.use and not r.of_beam])
    values = model.campaign.values
    return {
        p.name: p.plausible_among(values, signals) for effect in effects for p in effect.parameters
    }


def plausible_priors(effects: Iterable[Effect], model: Model) -> dict[str, tuple[float, float]]:
    """The same as Gaussian knowledge, value and standard error.

    It lies around the effect's absence, and 95 % of it in what is plausible; around the middle of
    that where the absence is infinitely far.
    """
    effects, priors = tuple(effects), {}
    usual = plausible_ranges(effects, model)
    for known in (parameter for effect in effects for parameter in effect.parameters):
        low, high = usual[known.name]
        middle = 0.5 * (low + high)
        if known.absent is not None and math.isfinite(known.absent):
            middle = known.origin(model.campaign.values) + known.absent
        priors[known.name] = (middle, max(high - middle, middle - low) / math.sqrt(RISE_95))
    return priors


# ---- explanations in order, and which of them the data cannot tell apart ----


class Ranking:
    """Sets of effects in the order of their evidence: `order` has the likeliest first.

    All have as many effects: one, two, or one more than some that are there.
    """

    def __init__(self, explanations: Explanations, sets: Iterable[tuple[str, ...]]) -> None:
        self._fits = {key: explanations.fit(key) for key in sets}
        best = min((fit.deviance for fit in self._fits.values()), default=0.0)
        self._scores = {
            key: -2.0
            * explanations.evidence(key, hopeless=fit.deviance > best + EXPLAINING.hopeless).log
            for key, fit in self._fits.items()
        }
        self.order = tuple(sorted(self._scores, key=lambda key: self._scores[key]))

    @property
    def best(self) -> Minimum:
        """Of the first explanation."""
        return self._fits[self.order[0]]

    def behind(self, key: tuple[str, ...]) -> float:
        """How far an explanation is behind the best."""
        return self._scores[key] - self._scores[self.order[0]]

    def leading(self) -> tuple[tuple[str, ...], ...]:
        """Explanations that the data cannot tell from the best, the best first."""
        errors = {key: error_of_difference(self._fits[key], self.best) for key in self.order}
        return tuple(
            k for k in self.order if self.behind(k) <= EXPLAINING.leading + 2.0 * errors[k]
        )

    def unsettled(self) -> tuple[tuple[str, ...], ...]:
        """Those that only the simulation's error lets lead, as they stand far behind the best."""
        return tuple(key for key in self.leading() if self.behind(key) > EXPLAINING.leading)


# ---- what chance gains ----


class BaselineFrame:
    """The readings and priors around a fit, whitened and freed of what its parameters follow."""

    def __init__(self, fit: Minimum) -> None:
        self.fit = fit
        self.statistic = fit.statistic.against(fit.signal[fit.statistic.used], fit.theta.copy())
        slopes = self._whitened(fit.slopes, np.eye(len(fit.theta)))
        self._basis = null_space(slopes[:, fit.movable].T).T

    def _whitened(self, of_readings: Array, of_parameters: Array) -> Array:
        weight = self.fit.statistic.prior_weight
        rows = np.sqrt(weight[weight > 0])
        of_priors = (of_parameters[weight > 0].T * rows).T
        return np.concatenate([self.fit.weights.whiten(of_readings.T).T, of_priors])

    @property
    def dimensions(self) -> int:
        """Degrees of freedom."""
        return len(self._basis)

    def displacement(self, statistic: Statistic, theta: Array) -> Array:
        """(dimensions,) of a model's prediction from the fit's."""
        fit = self.fit
        of_readings = statistic.model.predict(theta).signal - fit.signal
        values = statistic.values(theta)
        of_parameters = np.array([values[name] for name in fit.names]) - fit.theta
        return self._basis @ self._whitened(of_readings[fit.statistic.used], of_parameters)


@dataclass(frozen=True, eq=False)
class Curve:
    """What an effect does to the readings."""

    #: (points, dimensions) float64: The absence of an effect with parameters is the first, at the
    #: origin.
    points: Array
    #: (segments, 2) int: Points between which the curve is straight.
    ends: np.ndarray
    #: Absent at an end of its range.
    boundary: bool
    #: How many the effect brings.
    parameters: int

    def gains(self, drawn: Array) -> Array:
        """(draws,) largest gain in chi2 along the curve, for (draws, dimensions) readings.

        A point p of the curve gains r^2 - (r - p)^2 = 2 r p - p^2 for readings r; on a segment
        from a to a + s the best is where r - p is across it, at a + t s with t = (r - a) s / s^2.
        """
        products, squares = drawn @ self.points.T, (self.points**2).sum(axis=1)
        best = (2.0 * products - squares).max(axis=1)
        if len(self.ends):
            a, b = self.ends.T
            segment = self.points[b] - self.points[a]
            segment_squared = np.maximum((segment**2).sum(axis=1), 1e-300)
            a_segment = np.einsum("ij,ij->i", self.points[a], segment)
            r_segment = products[:, b] - products[:, a]
            t = np.clip((r_segment - a_segment) / segment_squared, 0.0, 1.0)
            p_squared = squares[a] + t * (2.0 * a_segment + t * segment_squared)
            gain = 2.0 * (products[:, a] + t * r_segment) - p_squared
            best = np.maximum(best, gain.max(axis=1))
        return best

    def separation(self, point: Array) -> float:
        """Squared distance of a (dimensions,) point from the curve."""
        return float(point @ point - self.gains(point[None])[0])


def curve_of(explanations: Explanations, effect: str, frame: BaselineFrame) -> Curve:
    """How an effect displaces the readings from the baseline fit, as its size grows.

    Its profile is fitted to readings that the baseline predicts exactly, so that all that moves is
    the effect, and what the other parameters do to follow it.
    """
    added = (effect,)
    statistic = explanations.statistic(added)
    centre = frame.fit.values
    prior = statistic.theta({**{p.name: p.prior or 0.0 for p in statistic.free}, **centre})
    # the effect's own priors, if a campaign gives any, stay where they are
    own = [statistic.index(n) for n in explanations.free_parameters(added, effect)]
    prior[own] = statistic.prior[own]
    ideal = statistic.against(frame.statistic.signal, prior)
    if not own:  # on or off
        theta, _, _ = newton(ideal, statistic.theta(centre), frame.fit.weights, steps=4)
        point = frame.displacement(statistic, theta)
        return Curve(point[None], np.empty((0, 2), int), False, 0)
    profile = explanations.profile(
        added, effect, frame.fit, statistic=ideal, steps=3, precision=0.02
    )
    thetas = [theta for _, theta in profile]
    points = np.array([frame.displacement(statistic, theta) for theta in thetas])
    absent = statistic.theta({**centre, **explanations.absent(effect)})
    x = np.array([statistic.internal(theta)[own] for theta in [absent, *thetas]])
    points = np.vstack([np.zeros(frame.dimensions), points])
    free = [statistic.free[i] for i in own]
    boundary = not any(p.minimum < at < p.maximum for p, at in zip(free, absent[own], strict=True))
    return Curve(points, _neighbours(x), boundary, len(own))


def _neighbours(x: Array) -> np.ndarray:
    """(segments, 2) pairs of (points, parameters) that follow each other along one parameter.

    The first point is the absence of the effect, and every line along one parameter starts there.
    """
    if x.shape[1] == 1:
        order = np.argsort(x[:, 0], kind="stable")
        return np.stack([order[:-1], order[1:]], axis=1)
    pairs = [(0, i) for i in range(1, len(x))]
    for axis in range(x.shape[1]):
        others = np.delete(x, axis, axis=1)
        for row in np.unique(others[1:], axis=0):
            line = 1 + np.flatnonzero((others[1:] == row).all(axis=1))
            line = line[np.argsort(x[line, axis])]
            pairs += list(pairwise(line))
    return np.array(pairs, int).reshape(-1, 2)


class NullDistribution:
    """Gains of fitted effects, drawn where none of them is there."""

    def __init__(self, explanations: Explanations, effects: Iterable[str], seed: int) -> None:
        self.frame = BaselineFrame(explanations.baseline)
        #: By effect.
        self.curves = {name: curve_of(explanations, name, self.frame) for name in effects}
        dimensions = self.frame.dimensions
        drawn = np.random.default_rng(seed).standard_normal((CHANCE.draws, dimensions))
        gains = [curve.gains(drawn) for curve in self.curves.values()]
        self.largest = np.sort(np.max(gains, axis=0)) if gains else np.zeros(CHANCE.draws)

    def p_global(self, gain: float) -> float:
        """Probability that the best of all effects gains as much by chance."""
        above = CHANCE.draws - int(np.searchsorted(self.largest, gain))
        if above > CHANCE.tail * CHANCE.draws or gain <= 0:
            return (1.0 + above) / (1.0 + CHANCE.draws)
        # few or no draws are that high: the tail of chi-squared, joined where there are enough
        joint = float(np.quantile(self.largest, 1.0 - CHANCE.tail))
        return CHANCE.tail * float(chdtrc(1, gain) / chdtrc(1, joint)) if joint > 0 else 0.0

    def p_gain(self, effect: str, gain: float) -> float:
        """Probability that this effect, named beforehand, gains as much by chance.

        Of an effect that is absent inside its range chi-squared with its number of parameters, at
        a boundary the half of it (H. Chernoff, Ann. Math. Stat. 25 (1954) 573); without a parameter
        the gain 2 z s - s^2 is Gaussian.
        """
        curve = self.curves[effect]
        if curve.parameters == 0:
            size = max(float(np.linalg.norm(curve.points[0])), 1e-9)
            return float(ndtr(-(gain + size**2) / (2.0 * size)))
        p = float(chdtrc(curve.parameters, max(gain, 0.0)))
        return 0.5 * p if curve.boundary and gain > 0 else p

    def p_of_best(self, effect: str, gain: float) -> float:
        """`p_gain` corrected for as many tries as there are effects, without drawing."""
        return corrected(self.p_gain(effect, gain), len(self.curves))
