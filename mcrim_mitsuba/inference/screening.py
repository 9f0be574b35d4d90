"""Which effects deserve more photons: after a first look at all, those that may explain the misfit.

Most effects are hopeless, and a few photons tell: the best of them misses the readings by far more
than the simulation's error. What the others are compared by, and what a diagnosis then rests on, is
simulated in full before anything is said of it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict
from typing import NamedTuple

from mcrim_mitsuba.effects.effect import Effect, modules_of
from mcrim_mitsuba.efficiency.responses import Sizes
from mcrim_mitsuba.inference.displacement import NullDistribution
from mcrim_mitsuba.inference.drivers import Minimum
from mcrim_mitsuba.inference.estimates import error_of_difference
from mcrim_mitsuba.inference.explanations import Explanations, Models
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, SCREENING
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.inference.weighing import weigh_hypotheses
from mcrim_mitsuba.runs.cache import RecordCache, code_hash, record_versions
from mcrim_mitsuba.runs.executors import current_executor, number_of


def promising_effects(
    models: Models, effects: Mapping[str, Effect], baseline: Minimum
) -> dict[str, Sizes | None]:
    """Effects that may explain the readings, after a first look at all of them, and of which sizes.

    Parameters and errors as for `diagnose.judge`.
    """
    explanations = Explanations(models, effects, baseline)
    fits = explanations.singles()
    if baseline.ndf <= 0 or not fits:
        return {}
    best = min(fits.values(), key=lambda fit: fit.chi2)
    highest = best.chi2 + SCREENING.behind + SCREENING.part_behind * (baseline.chi2 - best.chi2)
    most = {
        name: highest + SCREENING.errors * error_of_difference(fit, best)
        for name, fit in fits.items()
        # what gains nothing is as far behind as the campaign as it is, and stays there
        if baseline.chi2 - fit.chi2
        > SCREENING.least_gain - SCREENING.errors * error_of_difference(fit, baseline)
    }
    promising = {name: chi2 for name, chi2 in most.items() if fits[name].chi2 < chi2}
    if best.p_value is None or best.p_value >= ACCEPTABLE_P:
        return {name: _sizes(explanations, name, chi2) for name, chi2 in promising.items()}
    weighing = weigh_hypotheses(explanations, NullDistribution(explanations, fits), closed=True)
    likely = (name for name, p in weighing.inclusion.items() if p > SCREENING.included)
    # beside others an effect may be of any size
    return dict.fromkeys((*promising, *likely))


def _sizes(explanations: Explanations, effect: str, most: float) -> Sizes | None:
    """Between which sizes an effect may explain the readings: where chi2 is below `most`."""
    names = explanations.free_parameters((effect,), effect)
    if len(names) != 1:
        return None
    profile = explanations.profile((effect,), effect, explanations.baseline)
    nodes = [node[names[0]] for node in explanations.nodes((effect,), effect)]
    near = [x for x, (chi2, _) in zip(nodes, profile, strict=True) if chi2 < most]
    near.append(explanations.fit((effect,)).values[names[0]])
    return min(near), max(near)


class Screened(NamedTuple):
    """What a diagnosis simulates after its first look at all effects."""

    #: Effects, and pairs of them, that get all photons, and at which sizes; None: at all.
    precise: Mapping[str, Sizes | None]
    #: Pairs of effects that are simulated together.
    pairs: Collection[str] = ()


class ScreeningCache:
    """What a screening ended with, kept where simulations are: to screen again takes seconds."""

    def __init__(self, simulations: CampaignSimulations, tried: Iterable[str]) -> None:
        campaign, run = simulations.campaign, simulations.run
        self._cache: RecordCache = current_executor().cache(
            {
                "what": "screening with sizes",
                "versions": record_versions(run.variant, __name__),
                "effects": code_hash(modules_of(campaign.catalogue.values())),
            }
        )
        self._number = number_of(
            campaign.scene.content_hash,
            [asdict(reading) for reading in campaign.measurements.readings],
            repr(campaign.parameters),
            repr(campaign.scale),
            campaign.beam,
            campaign.effects,
            list(tried),
            run.photons,
            run.seed,
        )

    def read(self) -> Screened | None:
        """What it ended with; None where nothing was screened yet."""
        kept = self._cache.read(self._number)
        if kept is None:
            return None
        precise, pairs = (kept.metadata[name] for name in Screened._fields)
        return Screened({name: of and (of[0], of[1]) for name, of in precise.items()}, pairs)

    def write(self, screened: Screened) -> None:
        """Keep it for the next time."""
        kept = {"precise": {**screened.precise}, "pairs": sorted(screened.pairs)}
        self._cache.write(self._number, {}, kept)
