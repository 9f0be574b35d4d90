"""What else than a reading in a new configuration may be proposed, on a bench in formulas.

Seeds are fixed.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import synthetic_bench as bench

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.inference.diagnose import _judged
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.next_measurements import next_measurements
from mcrim_mitsuba.inference.simulations import MeasurementProposals

TRUTH = {"alpha_scat_per_cm": 0.54, "alpha_abs_per_cm": 0.039, "scale": 40.0}
LIGHT = LightYieldInput(50.0, 0.1, 0.0)


@dataclass
class Bench:
    """A campaign on a bench whose truth is known."""

    values: dict
    effects: tuple
    known: tuple
    rows: tuple  # places of its readings among those of the bench
    seed: int = 0
    wrong: dict = field(default_factory=dict)  # factors, by place
    more: tuple = ()  # places of readings that are made later
    numbers: int = 1  # times that the absorption was measured

    def judged(self) -> Judgement:
        explanations = bench.explanations_of(
            self.models, {name: bench.EFFECTS[name] for name in self.known}
        )
        return _judged(explanations, 0, lambda words: None)

    def models(self, added: tuple) -> bench.Model:
        rng = np.random.default_rng(self.seed)
        true = bench.signals({**TRUTH, **self.values}, self.effects)
        once = true * (1.0 + bench.SIGMA * rng.standard_normal(len(true)))
        later = true * (1.0 + bench.SIGMA * rng.standard_normal(len(true)))
        for place, factor in self.wrong.items():
            once[place] *= factor
        first, second = bench.readings(once), bench.readings(later)
        rows = [first[place] for place in self.rows]
        rows += [replace(second[place], label=f"{place} later") for place in self.more]
        measured = TRUTH["alpha_abs_per_cm"] + bench.PRIOR_SIGMA * rng.standard_normal(2)
        return bench.Model(
            tuple(rows),
            tuple(added),
            bench.simulation_noise(self.seed),
            measured[: self.numbers].mean(),
            LIGHT,
            prior_sigma=bench.PRIOR_SIGMA / math.sqrt(self.numbers),
        )

    def proposals(self) -> MeasurementProposals:
        new = [place for place in range(len(bench.ROWS)) if place not in self.rows]
        nobodys = bench.readings(np.ones(len(bench.ROWS)))
        rows, noise = tuple(nobodys[place] for place in new), bench.simulation_noise(self.seed)
        return MeasurementProposals(
            [bench.ROWS[place] for place in new],
            [lambda added: bench.Model(rows, added, noise)] if new else [],
            self.models,
            bench.SIGMA,
        )

    def advice(self):
        return next_measurements(self.judged(), self.proposals())
