"""The campaign with effects added: its fits, the priors of sizes, and evidences."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from itertools import combinations, product

import numpy as np

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.inference.drivers import Minimum, best_of, local_minima, newton
from mcrim_mitsuba.inference.evidence import (
    Evidence,
    PriorDensity,
    even,
    evidence_of,
    of_parameter,
    size,
)
from mcrim_mitsuba.inference.model import Model
from mcrim_mitsuba.inference.settings import EVIDENCE, EXPLAINING, HYPOTHESES, RISE_95
from mcrim_mitsuba.inference.statistic import Statistic, inverse

#: Gives the model of the campaign with these effects, besides its own.
Models = Callable[[tuple[str, ...]], Model]


class Explanations:
    """The campaign with whatever effects are asked for, each set built and fitted once.

    `scales` are values, by name, of the scale and of samples' own scales, around which their priors
    lie; by default those of the baseline. Give the same to all where evidences of several campaigns
    are compared. `catalogue` holds all effects that may be missing; `effects`, which are tried, may
    be fewer.
    """

    def __init__(
        self,
        models: Models,
        effects: Mapping[str, Effect],
        baseline: Minimum,
        scales: Mapping[str, float] = {},
        catalogue: Mapping[str, Effect] | None = None,
    ) -> None:
        self._models = models
        self.effects = dict(effects)
        possible = effects if catalogue is None else catalogue
        self._relatives = Counter(e.family for e in possible.values() if e.number is None)
        self._statistics: dict[tuple[str, ...], Statistic] = {}
        self._fits: dict[tuple[str, ...], Minimum] = {}
        self._evidences: dict[tuple[str, ...], Evidence] = {}
        self._by_size: dict[str, Array] = {}
        #: Effects that cannot be fitted here, with the reason.
        self.refused: dict[str, str] = {}
        #: The scene's parameters: an effect may be one of them off its nominal value.
        self.scene = self.statistic(()).model.campaign.values
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
                profile = self.profile(key, name, self.fit(fewers[name]))
                lowest = local_minima([height for height, _ in profile])[:3]
                starts += [profile[i][1] for i in lowest]
            self._fits[key] = best_of(statistic, starts, self.baseline.weights)
        return self._fits[key]

    def know(self, added: Iterable[str], fit: Minimum) -> None:
        """Take a fit with these effects that was found elsewhere for the best one."""
        self._fits[tuple(sorted(added))] = fit

    def free_parameters(self, added: Iterable[str], effect: str) -> tuple[str, ...]:
        """Parameters of an effect that the fit with these effects varies."""
        names = self.statistic(added).names
        return tuple(p.name for p in self.effects[effect].parameters if p.name in names)

    def absent(self, effect: str) -> dict[str, float]:
        """The value of each of an effect's parameters at which it is not there."""
        parameters = self.effects[effect].parameters
        return {p.name: p.origin(self.scene) + (p.absent or 0.0) for p in parameters}

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
        chi2 = newton(fit.statistic, start, fit.weights, held=held, precision=0.01).height
        return chi2 < fit.chi2 + 1.0

    def title(self, added: Iterable[str]) -> str:
        """Effects in words; several are joined by "with"."""
        return " with ".join(self.effects[name].title for name in added)

    def family(self, added: Iterable[str]) -> str:
        """What effects are relatives of; of several families all, joined by ``+``."""
        return " + ".join(dict.fromkeys(self.effects[name].family for name in added))

    def evidence(self, added: Iterable[str], *, rough: bool = False) -> Evidence:
        """Of the campaign with these effects, their sizes being plausible ones.

        A `rough` one is of few points, if it is not known better from before.
        """
        key = tuple(sorted(added))
        if key not in self._evidences:
            fit = self.fit(key)
            self._evidences[key] = evidence_of(fit, self.priors(key), rough=rough)
        return self._evidences[key]

    def log_odds(self, added: Iterable[str]) -> float:
        """Natural logarithm of the odds, before the readings, of some effects to none.

        `HYPOTHESES.expected_effects` are expected of all that may be missing, evenly of every
        family and of every effect in it; numbers of the bench are mistaken one by one.
        """
        each = HYPOTHESES.expected_effects / max(len(self._relatives), 1)
        return sum(
            math.log(HYPOTHESES.wrong_number)
            if effect.number is not None
            else math.log(each / self._relatives[effect.family])
            for effect in (self.effects[name] for name in added)
        )

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
                    absent = effect.origin(self.scene) + effect.absent
                    densities[known.name] = size(absent, usual, low, high)
            elif known.name in self.scales and known.prior is None:
                # of which nothing is known, the same for all models of a campaign
                scale, factor = self.scales[known.name], EVIDENCE.scale_factor
                densities[known.name] = even(scale / factor, scale * factor)
            else:
                densities[known.name] = of_parameter(known)
        return densities

    def nodes(self, added: Iterable[str], effect: str) -> list[dict[str, float]]:
        """Values of an effect's free parameters that span it, in their order; [{}] without any."""
        names, absent = self.free_parameters(added, effect), self.absent(effect)
        known = {p.name: p for p in self.effects[effect].parameters}
        axes = []
        for name in names:
            values = np.array(known[name].nodes, float) + known[name].origin(self.scene)
            if not len(values):
                # the catalogue has none: some standard errors of it
                if name not in self._by_size:
                    statistic, baseline = self.statistic((effect,)), self.baseline
                    theta = statistic.theta({**baseline.values, **self.absent(effect)})
                    slopes = statistic.model.predict(theta).signal_slopes[statistic.used]
                    whitened = baseline.weights.whiten(slopes.T).T
                    information = whitened.T @ whitened + np.diag(statistic.prior_weight)
                    place = statistic.index(name)
                    sigma = math.sqrt(inverse(information)[place, place])
                    self._by_size[name] = theta[place] + sigma * np.array(EXPLAINING.sizes)
                values = self._by_size[name]
            bounds = self.statistic(added).parameter(name)
            values = np.unique(np.clip(values, bounds.minimum, bounds.maximum)).tolist()
            fine = 1e-9 * (values[-1] - values[0])
            axes.append([v for v in values if not math.isclose(v, absent[name], abs_tol=fine)])
        while math.prod(len(axis) for axis in axes) > EXPLAINING.most_nodes:
            axes = [axis[:: max(1, len(axis) // 3)] for axis in axes]
        return [dict(zip(names, values, strict=True)) for values in product(*axes)]

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
            side = single and nodes[i][names[0]] > absent[names[0]]
            start = statistic.theta({**warm.get(side, fewer.values), **nodes[i]})
            end = newton(statistic, start, weights, held=held, steps=steps, precision=precision)
            points[i] = (end.height, end.point)
            if single:
                warm[side] = statistic.values(end.point)
        return [points[i] for i in range(len(nodes))]


def plausible_ranges(effects: Iterable[Effect], model: Model) -> dict[str, tuple[float, float]]:
    """What a laboratory usually meets of some effects, by parameter, beside a model's readings."""
    signals = np.array([r.signal for r in model.readings if r.use and not r.of_beam])
    values = model.campaign.values
    return {
        p.name: p.plausible_in(values)
        for effect in effects
        for p in effect.beside(signals).parameters
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
