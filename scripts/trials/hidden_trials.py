"""One hidden-effect trial: what is hidden, the campaign that a laboratory would write, the verdict.

Kinds of trials:

single     one effect, of a size whose expected excess is 50 to 400
none       nothing
pairs      two effects, either of which leaves an excess of 30 at least if fitted alone
outsiders  what the catalogue does not have: gel crept up the sides, two rows swapped, a bad reading
mimic      a black spot on the top face, which the catalogue can mimic
too_small  effects at the ends of their ranges that cannot reach an excess of 50
"""

from __future__ import annotations

import functools
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trials.hidden_campaigns import (
    EFFECTS,
    EXCESS,
    OUTSIDERS,
    PAIR_EXCESS,
    PAIRS,
    READING_SIGMA,
    TOO_SMALL,
    Excess,
    Hidden,
    Readings,
    Truth,
    changes_of,
    draw_truth,
    hidden_alone,
    labels,
    readings_of,
    size_in_units,
    write_campaign,
)
from trials.hidden_histories import HistoryStore

KINDS = ("single", "none", "pairs", "outsiders", "mimic", "too_small")
#: Ways to be an outsider, in turn; the last two spoil readings instead of the bench.
GEL_CREEP, SWAPPED_ROWS, BAD_READING = "gel_creep", "swapped_rows", "bad_reading"
OUTSIDERS_IN_TURN = (GEL_CREEP, SWAPPED_ROWS, BAD_READING)
#: Least expected excess of an outsider in the bench, and of swapped rows.
OUTSIDER_EXCESS, SWAP_EXCESS = 400.0, 100.0
#: How far off a bad reading is.
BAD_READING_OFF = 0.08
#: Truths that are drawn before a trial is given up.
_MOST_TRUTHS = 60


@dataclass(frozen=True, eq=False)
class Trial:
    """A campaign with something hidden in it.

    It is drawn from its kind, number and seed. Hidden are effects, with their sizes in the
    catalogue's units; spoiled are readings, by their labels; `what` names either, the same for all
    sizes. The excess is that of the noise-free readings' chi2 under the plain bench; signal and
    sigma are (readings,).
    """

    kind: str
    number: int
    seed: int
    hidden: Hidden
    spoiled: tuple[str, ...]
    what: str
    truth: Truth
    expected_excess: float
    signal: NDArray[np.float64]
    sigma: NDArray[np.float64]


class TrialMaker:
    """Draws trials; the same number of a kind gives the same trial.

    `only` are the effects to hide in single trials; empty for all that can reach the excess.
    """

    def __init__(self, store: HistoryStore, seed: int, only: Sequence[str] = ()) -> None:
        self._store, self._seed = store, seed
        self._excess = Excess(store)
        self._only = tuple(only) or tuple(EFFECTS)

    def cases(self, kinds: Iterable[str]) -> list[dict[str, float | bool]]:
        """Changes of the bench that trials of some kinds need, the plain bench first."""
        of_pairs = dict.fromkeys(effect for pair in PAIRS for effect, _ in pair)
        of_kind = {
            "single": hidden_alone(self._only),
            "pairs": [*PAIRS, *hidden_alone(of_pairs)],
            "outsiders": hidden_alone([GEL_CREEP]),
            "mimic": hidden_alone(["black_spot"]),
            "too_small": hidden_alone(TOO_SMALL),
        }
        hidden = [(), *(each for kind in kinds for each in of_kind.get(kind, ()))]
        unlike = dict.fromkeys(tuple(changes_of(each).items()) for each in hidden)
        return [dict(items) for items in unlike]

    def draw(self, kind: str, number: int) -> Trial:
        """A trial of one of `KINDS`.

        Raises
        ------
        RuntimeError
            If nothing of the wanted excess is found: the sizes on offer are wrong then.
        """
        rng = np.random.default_rng(
            np.random.SeedSequence(self._seed, spawn_key=(KINDS.index(kind), number))
        )
        draw = getattr(self, f"_{kind}")
        for _ in range(_MOST_TRUTHS):
            truth = draw_truth(rng)
            found = draw(rng, number, truth)
            if found is not None:
                return self._noisy(rng, kind, number, truth, *found)
        raise RuntimeError(f"{kind} trial {number}: no size has the wanted excess")

    def _single(self, rng, number: int, truth: Truth):
        effect = self._in_turn("single", self._only, number)
        return self._sized(rng, effect, EFFECTS[effect].sizes, truth, *EXCESS)

    def _none(self, rng, number: int, truth: Truth):
        return (), (), "nothing", readings_of(self._store, (), truth)

    def _pairs(self, rng, number: int, truth: Truth):
        pair = self._in_turn("pairs", PAIRS, number)
        readings = readings_of(self._store, pair, truth)
        for effect, _ in pair:
            if self._excess.single(effect, readings, truth) < PAIR_EXCESS:
                return None
        return pair, (), " + ".join(effect for effect, _ in pair), readings

    def _mimic(self, rng, number: int, truth: Truth):
        sizes = OUTSIDERS["black_spot"].sizes
        return self._sized(rng, "black_spot", sizes, truth, EXCESS[0], np.inf)

    def _too_small(self, rng, number: int, truth: Truth):
        ends = [(effect, size) for effect, known in TOO_SMALL.items() for size in known.sizes]
        hidden = (ends[number % len(ends)],)
        return hidden, (), hidden[0][0], readings_of(self._store, hidden, truth)

    def _outsiders(self, rng, number: int, truth: Truth):
        what = OUTSIDERS_IN_TURN[number % len(OUTSIDERS_IN_TURN)]
        if what == GEL_CREEP:
            sizes = OUTSIDERS[GEL_CREEP].sizes
            return self._sized(rng, what, sizes, truth, OUTSIDER_EXCESS, np.inf)
        readings = readings_of(self._store, (), truth)
        signal, sigma = readings.signal.copy(), readings.sigma.copy()
        if what == SWAPPED_ROWS:
            rows = rng.choice(len(signal), 2, replace=False)
            signal[rows], sigma[rows] = signal[rows[::-1]], sigma[rows[::-1]]
        else:
            rows = rng.choice(len(signal), 1)
            factor = 1.0 + rng.choice([-1.0, 1.0]) * BAD_READING_OFF
            signal[rows] *= factor
            sigma[rows] *= factor
        spoiled = Readings(signal, sigma, signal)
        if what == SWAPPED_ROWS and self._excess.plain(spoiled, truth) < SWAP_EXCESS:
            return None
        return (), tuple(labels()[row] for row in sorted(rows)), what, spoiled

    def _sized(self, rng, effect: str, sizes, truth: Truth, least: float, most: float):
        """One of the sizes whose excess is within bounds, or None."""
        fitting = []
        for size in sizes:
            readings = readings_of(self._store, ((effect, size),), truth)
            if least <= self._excess.plain(readings, truth) <= most:
                fitting.append((((effect, size),), (), effect, readings))
        return fitting[rng.integers(len(fitting))] if fitting else None

    def _in_turn(self, kind: str, items: Sequence, number: int):
        """Items in a shuffled order, each as often as any other."""
        rng = np.random.default_rng(
            np.random.SeedSequence(self._seed, spawn_key=(KINDS.index(kind), 2**31))
        )
        return items[rng.permutation(len(items))[number % len(items)]]

    def _noisy(self, rng, kind, number, truth, hidden, spoiled, what, readings) -> Trial:
        """The trial, with errors of measurement; the tracer's are in the readings already."""
        noise = 1.0 + READING_SIGMA * rng.standard_normal(len(readings.signal))
        sizes = tuple((name, size_in_units(name, size, readings.light)) for name, size in hidden)
        return Trial(
            kind, number, self._seed, sizes, spoiled, what, truth,
            self._excess.plain(readings, truth), readings.signal * noise, readings.sigma,
        )  # fmt: skip


@functools.cache
def trial_maker(histories: Path, photons: int, seed: int, only: tuple[str, ...]) -> TrialMaker:
    """The one of this process: it remembers what it has read."""
    return TrialMaker(HistoryStore(histories, photons), seed, only)


def draw_and_run(
    maker: tuple[Path, int, int, tuple[str, ...]],
    kind: str,
    number: int,
    folder: Path | None,
    threads: int | None,
) -> dict:
    """`run_trial` of a trial that is drawn first, by what `trial_maker` gives.

    The campaign is kept in the folder, if there is one.
    """
    trial = trial_maker(*maker).draw(kind, number)
    if folder is not None:
        return run_trial(trial, folder, threads)
    with tempfile.TemporaryDirectory(prefix="hidden-effects-") as passing:
        return run_trial(trial, Path(passing), threads)


def run_trial(
    trial: Trial, folder: Path, threads: int | None = None, photons: int | None = None
) -> dict:
    """Write the campaign's files, hand them to the package and note what it says.

    Threads and photons are those of the package's simulation, if not its own. Gives plain values,
    which `hidden_scores` counts.
    """
    name = f"{trial.kind}-{trial.number}"
    campaign = write_campaign(folder, name, trial.signal, trial.sigma, trial.truth)
    start = time.perf_counter()
    said = diagnose_and_repair(campaign, threads, photons)
    seconds = time.perf_counter() - start
    effects = {effect for effect, _ in trial.hidden}
    limits, before, after = said["upper_limits"], said["baseline"], said["calibration"]
    return {
        "kind": trial.kind, "number": trial.number, "seed": trial.seed,
        "hidden": [list(item) for item in trial.hidden], "spoiled": list(trial.spoiled),
        "what": trial.what, "truth": asdict(trial.truth),
        "expected_excess": trial.expected_excess,
        "verdict": said["verdict"], "reason": said["reason"],
        "first": said["candidates"][0]["effect"] if said["candidates"] else None,
        "leading": said["leading"],
        "suspects": [one["labels"] for one in said["suspect_readings"]],
        "candidates": [
            {key: one[key] for key in ("effect", "chi2", "p_value", "plausible")}
            for one in (*said["candidates"][:4], *said["pairs"][:4])
        ],
        "limits": {effect: limits[effect] for effect in effects if effect in limits},
        "added": said["effects"],
        "steps": [[step["added"], step["chi2"], step["p_value"]] for step in said["repair"]],
        "chi2_before": before["chi2"], "p_before": before["p_value"], "p_after": after["p_value"],
        "pulls_before": _pulls(before["parameters"], trial.truth),
        "pulls_after": _pulls(after["parameters"], trial.truth),
        "seconds": seconds, "diagnosis_seconds": said["diagnosis_seconds"],
    }  # fmt: skip


def diagnose_and_repair(
    campaign: Path, threads: int | None = None, photons: int | None = None
) -> dict:
    """What the package says of a campaign: the only place that knows its interface.

    As `mcrim repair --json` has it: verdict, candidates, leading, suspect_readings, repair,
    upper_limits, baseline, effects (added), calibration (of the mended campaign); and
    diagnosis_seconds.
    """
    from mcrim_mitsuba.inference.repair import repair

    found = repair(campaign, threads=threads, photons=photons)
    said = found.diagnosed.diagnosis.to_json()
    said["baseline"] |= found.diagnosed.baseline.to_json()
    return said | {
        "effects": list(found.effects),
        "calibration": found.calibration.to_json(),
        "diagnosis_seconds": found.diagnosed.provenance.seconds,
    }


def _pulls(parameters: dict, truth: Truth) -> dict[str, float]:
    """Distances from the truth in standard errors."""
    names = ("alpha_scat_per_cm", "light_yield_ph_per_keV")
    return {
        name: (parameters[name]["value"] - getattr(truth, name)) / parameters[name]["sigma"]
        for name in names
    }
