"""Fits a campaign with effects added to it: one, two or more at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from itertools import combinations, product

import numpy as np

from mcrim_mitsuba.diagnosis import statistics
from mcrim_mitsuba.diagnosis.solver import (
    Array,
    Fit,
    Problem,
    best_of,
    descend,
    fit_from_scratch,
    inverse,
    local_minima,
    settle,
)
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.fit.model import Model

#: Gives the model of the campaign with these effects, besides its own.
Models = Callable[[tuple[str, ...]], Model]

# Most nodes of a single effect's profile; of more than one parameter, a coarser product.
_MOST_NODES = 27

# Nodes in standard errors, where the catalogue has none.
_SIZES = np.array([-60.0, -20.0, -6.0, -2.0, 2.0, 6.0, 20.0, 60.0])

# Pairs that are fitted to the end after all were followed for a few steps.
_PAIRS_TO_THE_END = 12

# The same of effects added to those that are there.
_FURTHER_TO_THE_END = 3


class Explanations:
    """The campaign with whatever effects are asked for, each set built and fitted once.

    Parameters
    ----------
    models : callable
        See `Models`.
    effects : mapping of str to Effect
        That may be added.
    scene : mapping of str to Value
        The scene's parameters: where the effect is one of these being off its nominal value.

    Attributes
    ----------
    baseline : Fit
        Of the campaign as it is.
    refused : dict of str to str
        Effects that cannot be fitted here, with the reason.
    """

    def __init__(self, models: Models, effects: Mapping, scene: Mapping[str, Value]) -> None:
        self._models, self._scene = models, scene
        self.effects = dict(effects)
        self._coordinates = {
            p.name: p.coordinate for effect in effects.values() for p in effect.parameters
        }
        self._problems: dict[tuple[str, ...], Problem] = {}
        self._fits: dict[tuple[str, ...], Fit] = {}
        self._by_size: dict[str, Array] = {}
        self.refused: dict[str, str] = {}
        self.baseline = fit_from_scratch(self.problem(()))
        self._fits[()] = self.baseline

    def problem(self, added: Iterable[str]) -> Problem:
        """The campaign with these effects; `InputError` where the scene cannot take them."""
        key = tuple(sorted(added))
        if key not in self._problems:
            self._problems[key] = Problem(self._models(key), self._coordinates)
        return self._problems[key]

    def possible(self, added: Iterable[str]) -> bool:
        """Whether these effects may be together and leave the readings something to say."""
        added = tuple(added)
        for a, b in combinations(added, 2):
            if a in self.effects[b].excludes or b in self.effects[a].excludes:
                return False
        if any(name in self.refused for name in added):
            return False
        try:
            return self.problem(added).ndf >= 0
        except InputError as error:
            if len(added) == 1:
                self.refused[added[0]] = error.problem
            return False

    def singles(self) -> dict[str, Fit]:
        """The fit with each possible effect alone."""
        fits = {}
        for name in self.effects:
            if self.possible((name,)):
                fits[name] = self.fit((name,))
            elif name not in self.refused:
                self.refused[name] = "more parameters than readings and priors"
        return fits

    def fit(self, added: Iterable[str]) -> Fit:
        """The best fit with these effects added, started from those with one of them less."""
        key = tuple(sorted(added))
        if key not in self._fits:
            problem = self.problem(key)
            starts: list[Array] = []
            fewers = {name: tuple(other for other in key if other != name) for name in key}
            # what has been fitted is a start; the rest need not be for this
            known = [name for name, fewer in fewers.items() if fewer in self._fits]
            for name in known or key:
                fewer = self.fit(fewers[name])
                starts += profile_minima(self.profile(key, name, fewer))
            self._fits[key] = best_of(problem, starts, self.baseline.weights)
        return self._fits[key]

    def free_parameters(self, added: Iterable[str], effect: str) -> tuple[str, ...]:
        """Parameters of an effect that the fit with these effects varies."""
        names = self.problem(added).names
        return tuple(p.name for p in self.effects[effect].parameters if p.name in names)

    def absent(self, effect: str) -> dict[str, float]:
        """The value of each of an effect's parameters at which it is not there."""
        return {
            p.name: self._origin(p) if p.absent is None else self._origin(p) + p.absent
            for p in self.effects[effect].parameters
        }

    def plausible(self, effect: str) -> dict[str, tuple[float, float]]:
        """What a laboratory usually meets, by parameter."""
        return plausible_ranges(self.effects[effect], self._scene)

    def _origin(self, parameter: EffectParameter) -> float:
        return _origin(parameter, self._scene)

    def nodes(self, added: Iterable[str], effect: str) -> list[dict[str, float]]:
        """Values of an effect's free parameters that span it, in their order; [{}] without any."""
        problem = self.problem(added)
        axes = []
        known = {p.name: p for p in self.effects[effect].parameters}
        names = self.free_parameters(added, effect)
        for name in names:
            parameter = problem.free[problem.index(name)]
            low, high = parameter.minimum, parameter.maximum
            values = np.array(known[name].nodes, float) + self._origin(known[name])
            if not len(values):
                values = self._nodes_by_size(effect, name)
            values = np.unique(np.clip(values, low, high))
            absent = self.absent(effect)[name]
            axes.append([float(v) for v in values if not math.isclose(v, absent, abs_tol=1e-12)])
        while math.prod(len(axis) for axis in axes) > _MOST_NODES:
            axes = [axis[:: max(1, len(axis) // 3)] for axis in axes]
        return [dict(zip(names, values, strict=True)) for values in product(*axes)]

    def _nodes_by_size(self, effect: str, name: str) -> Array:
        """Values of a parameter for which the catalogue has none: some standard errors of it."""
        if name not in self._by_size:
            problem, baseline = self.problem((effect,)), self.baseline
            theta = problem.theta({**baseline.values, **self.absent(effect)})
            slopes = problem.model.predict(theta).signal_slopes[problem.used]
            whitened = baseline.weights.whitener @ slopes
            information = whitened.T @ whitened + np.diag(problem.prior_weight)
            place = problem.index(name)
            sigma = math.sqrt(inverse(information)[place, place])
            self._by_size[name] = theta[place] + sigma * _SIZES
        return self._by_size[name]

    def is_boundary(self, added: Iterable[str], effect: str) -> bool:
        """Whether the effect is absent at an end of its range."""
        problem = self.problem(added)
        for name in self.free_parameters(added, effect):
            parameter = problem.free[problem.index(name)]
            absent = self.absent(effect)[name]
            if parameter.minimum < absent < parameter.maximum:
                return False
        return True

    def profile(
        self,
        added: Iterable[str],
        effect: str,
        fewer: Fit,
        *,
        problem: Problem | None = None,
        steps: int = 4,
        precision: float = 0.05,
    ) -> list[tuple[float, Array]]:
        """chi2 and parameters along an effect's nodes, all other parameters fitted.

        Parameters
        ----------
        added : iterable of str
            `effect` among them.
        effect : str
        fewer : Fit
            With all of `added` but the effect: where the others start.
        problem : Problem, optional
            Other readings than the campaign's.
        steps, precision
            As `descend`.
        """
        problem = problem or self.problem(added)
        names = self.free_parameters(added, effect)
        held = [problem.index(name) for name in names]
        weights = self.baseline.weights
        if not names:
            start = problem.theta(fewer.values)
            theta, chi2, _ = descend(problem, start, weights, steps=steps, precision=precision)
            return [(chi2, theta)]
        absent = self.absent(effect)
        nodes = self.nodes(added, effect)
        warm: dict[bool, dict[str, float]] = {}
        # from the absent value outwards, each from where its neighbour ended
        order = list(range(len(nodes)))
        if len(names) == 1:
            place = problem.index(names[0])

            def away(i: int) -> float:
                theta = problem.theta({**fewer.values, **nodes[i]})
                there = problem.theta({**fewer.values, **absent})
                return abs((problem.internal(theta) - problem.internal(there))[place])

            order = sorted(order, key=away)
        found: dict[int, tuple[float, Array]] = {}
        for i in order:
            side = len(names) == 1 and nodes[i][names[0]] > absent[names[0]]
            begin = warm.get(side, fewer.values) if len(names) == 1 else fewer.values
            start = problem.theta({**begin, **nodes[i]})
            theta, chi2, _ = descend(
                problem, start, weights, held=held, steps=steps, precision=precision
            )
            found[i] = (chi2, theta)
            warm[side] = dict(zip(problem.names, theta.tolist(), strict=True))
        return [found[i] for i in range(len(nodes))]

    def ranked_pairs(self) -> list[tuple[str, ...]]:
        """The best fitting pairs of all effects, the best first, fitted to the end."""
        return self._ranked(combinations(self.singles(), 2), _PAIRS_TO_THE_END)

    def ranked_further(self, chosen: tuple[str, ...]) -> list[tuple[str, ...]]:
        """The same of fitted effects with one more, which is the last."""
        others = [name for name in self.singles() if name not in chosen]
        return self._ranked([(*chosen, name) for name in others], _FURTHER_TO_THE_END)

    def _ranked(self, sets: Iterable[tuple[str, ...]], to_the_end: int) -> list[tuple[str, ...]]:
        """The best of many sets of effects.

        Every set is followed for two steps from a few starts, the better half further, and the best
        few to the end.
        """
        weights = self.baseline.weights
        rough: list[tuple[float, tuple[str, ...], Array]] = []
        for added in sets:
            if not self.possible(added):
                continue
            problem = self.problem(added)
            followed = []
            for start in self._starts(added):
                theta, height, _ = descend(problem, start, weights, steps=2, precision=1.0)
                followed.append((height, theta))
            height, theta = min(followed, key=lambda item: item[0])
            rough.append((height + 2.0 * len(problem.names), added, theta))
        rough.sort(key=lambda item: item[0])
        closer = []
        for _, added, start in rough[: (len(rough) + 1) // 2]:
            problem = self.problem(added)
            theta, height, _ = descend(problem, start, weights, steps=5, precision=0.3)
            closer.append((height + 2.0 * len(problem.names), added, theta))
        closer.sort(key=lambda item: item[0])
        best = [(added, theta) for _, added, theta in closer[:to_the_end]]
        for added, theta in best:
            key = tuple(sorted(added))
            fit, other = self.fit(key), settle(self.problem(key), theta)
            if other.deviance < fit.deviance:
                self._fits[key] = other
        return sorted(
            (added for added, _ in best), key=lambda added: statistics.criterion(self.fit(added))
        )

    def _starts(self, added: tuple[str, ...]) -> list[Array]:
        """Effects as they are without one of them, and that one as it is alone, and middling."""
        problem, starts = self.problem(added), []
        for other in added:
            fewer = tuple(sorted(name for name in added if name != other))
            if fewer not in self._fits:
                continue
            values = self._fits[fewer].values
            nodes = sorted(self.nodes(added, other), key=lambda n: self._size(added, other, n))
            starts.append(problem.theta({**values, **nodes[len(nodes) // 2]}))
            if other == added[-1]:
                starts.append(problem.theta({**self._fits[other,].values, **values}))
        return starts

    def _size(self, added: Iterable[str], effect: str, node: Mapping[str, float]) -> float:
        """How far an effect's values are from its absence, relative to its range."""
        problem = self.problem(added)
        base = self.baseline.values
        there = problem.internal(problem.theta({**base, **node}))
        absent = problem.internal(problem.theta({**base, **self.absent(effect)}))
        span = np.where(np.isfinite(problem.high - problem.low), problem.high - problem.low, 1.0)
        return float(np.abs((there - absent) / span).max(initial=0.0))


def plausible_ranges(effect: Effect, scene: Mapping[str, Value]) -> dict[str, tuple[float, float]]:
    """What a laboratory usually meets of an effect, by parameter."""
    ranges = {}
    for parameter in effect.parameters:
        origin, (low, high) = _origin(parameter, scene), parameter.plausible
        ranges[parameter.name] = (origin + low, origin + high)
    return ranges


def _origin(parameter: EffectParameter, scene: Mapping[str, Value]) -> float:
    """What an effect parameter's numbers count from."""
    return float(scene[parameter.nominal]) if parameter.nominal else 0.0


def profile_minima(profile: list[tuple[float, Array]]) -> list[Array]:
    """Parameters at the lowest few minima of a profile."""
    return [profile[i][1] for i in local_minima([height for height, _ in profile])[:3]]
