"""One hidden-effect trial: what is hidden, the campaign that a laboratory would write, the verdict.

Kinds of trials:

single      one effect, of a size whose expected excess is 40 to 670
none        nothing
edge        nothing, but masks that end at the crystal's edge under a thick gap are in the design
pairs       two effects, either of which leaves an excess of 30 at least if fitted alone
instrument  one, two or three bad readings, two rows swapped, a drift, other pieces' yield
outsiders   what the catalogue does not have: a collar of gel, a black spot on the top face
too_small   effects at the ends of their ranges that cannot reach an excess of 40
beam        haze or roughness of the faces, in campaigns with a transmittance as well
left_out    as single, but the package does not know the effect; and once more when it does
numbers     a number of the bench is another one than the scene says, by far more than its tolerance
numbers_out the same, but the number is no candidate; and once more when it is
family_out  the same with all its relatives
advice      as single; where it is ambiguous, what is proposed is measured, and that once

Every trial has a design of its own. The expected excess is what hides in a campaign's chi2:
noise-free readings fitted with the plain bench, which is the tracer's here too. Of a transmittance
it holds nothing.
"""

from __future__ import annotations

import functools
import math
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench_scene import FILLED_ONLY, USUAL, bench_scene
from numpy.polynomial import chebyshev
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares
from shared import SCENE

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.files import plain, write_text
from mcrim_mitsuba.effects.effect import WRONG, Effect
from mcrim_mitsuba.inference.judgement import UNEXPLAINED
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.check_text import is_filled
from trials.hidden_histories import (
    COLUMNS,
    EDGE,
    POOL,
    Design,
    HistoryStore,
    draw_design,
)
from trials.truth import PRIOR_SIGMA_PER_CM, TRUE_ALPHA_SCAT_PER_CM, draw_absorption_and_scale

#: Relative standard error of a reading, the tracer's own apart.
READING_SIGMA = 0.007
#: The same of a transmittance, within this half angle of a beam so wide.
TRANSMITTANCE_SIGMA, ACCEPTANCE_DEG, BEAM_DIAMETER_MM = 0.01, 5.0, 3.0
#: Photons of the tracer's beam: a quarter of that error at 0.3 of the beam transmitted.
BEAM_PHOTONS = 40_000
#: What turns the scale into a light yield; without an error, which would blur the pulls.
ENERGY_KEV, DETECTOR_EFFICIENCY = 59.5, 0.127
#: Sizes of the readings' effects are relative: a background to the smallest reading, a nonlinearity
#: is the relative loss of the largest, below 0 its gain.
OF_READINGS = ("background", "nonlinearity", "gain_drift", "sample_scale")
#: Expected excess of the plain fit's chi2 that trials are drawn with.
EXCESS = (40.0, 670.0)
#: The same where advice is tried: little tells the effects apart.
ADVICE_EXCESS = (20.0, 80.0)
#: Least of it that the better of two hidden effects leaves unexplained.
PAIR_EXCESS = 30.0

# Chebyshev nodes of the tables: plain bench, effects
_PLAIN_RANGES, _PLAIN_NODES = ((0.05, 4.5), (0.001, 0.12)), (11, 4)
_EFFECT_RANGES, _EFFECT_NODES = ((0.12, 1.6), (0.001, 0.12)), (6, 3)
# how far beyond the sizes on offer an effect may go when it is fitted, straight on
_REACH = 2.5
KINDS = (
    "single",
    "none",
    "pairs",
    "instrument",
    "outsiders",
    "too_small",
    "beam",
    "left_out",
    "family_out",
    "advice",
    "edge",
    "numbers",
    "numbers_out",
)
#: Kinds that are diagnosed without the effect that is hidden, or without its relatives too; and
#: the one where a proposed reading is added.
LEFT_OUT, FAMILY_OUT, ADVICE, _, NUMBERS, NUMBERS_OUT = KINDS[-6:]
#: Ways in which readings are wrong, in turn: so many bad ones, exchanged rows, or effects.
BAD_READINGS = {"bad_reading": 1, "two_bad_readings": 2, "three_bad_readings": 3}
SWAPPED_ROWS = "swapped_rows"
INSTRUMENT_IN_TURN = (*BAD_READINGS, SWAPPED_ROWS, "gain_drift", "sample_scale")
#: How far off a bad reading is: between these, either way.
BAD_READING_OFF = (0.05, 0.12)
#: Truths that are drawn before a trial is given up.
_MOST_TRUTHS = 60
#: The scene's values of what a design changes.
_USUAL = dict(zip(COLUMNS, (1.0, 14.0, 10.0, 0.05), strict=True))
#: What a laboratory says of its numbers where one is wrong: lengths by a caliper.
CALIPER = "\n[tolerances]\n" + "".join(
    f"{name} = 0.05\n" for name in ("crystal_width_mm", "crystal_height_mm", "aperture_radius_mm")
)
#: What it says elsewhere: lengths by a micrometer, gaps by spacers, indices by a refractometer. The
#: tracer's bench is exact, and the excess that trials are drawn with is what it leaves of that.
MICROMETER = "\n[tolerances]\n" + "".join(
    f"{name} = {sigma:g}\n"
    for sigma, names in {
        0.01: "crystal_width_mm crystal_height_mm aperture_radius_mm window_thickness_mm",
        0.05: "window_width_mm",
        0.002: "gap_mm",
        0.0005: "n_crystal n_gap n_window",
    }.items()
    for name in names.split()
)
#: Photons of a reading that is measured on advice: as good as it is promised, the tracer's error
#: being a fifth of `READING_SIGMA` behind the narrowest mask.
FURTHER_PHOTONS = 6_000_000


class HiddenEffect(NamedTuple):
    """A parameter of the bench, or an effect of the readings; sizes it is hidden with."""

    parameter: str
    sizes: tuple[float | bool, ...]


TABLES = tomllib.loads(Path(__file__).with_name("hidden.toml").read_text(encoding="utf-8"))
#: Effects that can reach an excess of 50, those that cannot, those that a transmittance tells
#: apart, numbers of the bench, and what the catalogue does not have.
EFFECTS, TOO_SMALL, BESIDE_BEAM, WRONG_NUMBERS, OUTSIDERS = (
    {name: HiddenEffect(known[0], tuple(known[1:])) for name, known in TABLES[kind].items()}
    for kind in ("effects", "too_small", "beside_beam", "numbers", "outsiders")
)
_ALL = BESIDE_BEAM | EFFECTS | TOO_SMALL | WRONG_NUMBERS | OUTSIDERS
#: The family of numbers of the bench.
NUMBERS_FAMILY = "numbers"

#: What is hidden: effects and their sizes.
Hidden = tuple[tuple[str, float | bool], ...]

#: Two effects at once.
PAIRS: tuple[Hidden, ...] = tuple(tuple(map(tuple, pair)) for pair in TABLES["pairs"])


def hidden_alone(effects: Iterable[str], known: Mapping[str, HiddenEffect] = _ALL) -> list[Hidden]:
    """Every size of effects, one at a time."""
    return [((name, size),) for name in effects for size in known[name].sizes]


@dataclass(frozen=True)
class Truth:
    """What a campaign is made with, and the absorption as measured beforehand."""

    alpha_scat_per_cm: float
    alpha_abs_per_cm: float
    scale: float
    prior_per_cm: float

    @property
    def light_yield_ph_per_keV(self) -> float:
        return self.scale / (ENERGY_KEV * DETECTOR_EFFICIENCY)


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings (readings,) of a design as they would be without errors of measurement.

    Sigma holds the error of measurement and the tracer's; `light` is the signal without effects
    of the readings. Where there is a transmittance it is the last.
    """

    design: Design
    signal: Array
    sigma: Array
    light: Array


def draw_truth(rng: np.random.Generator) -> Truth:
    """A truth, and a measured absorption that scatters about it but is positive."""
    low, high = np.log(TRUE_ALPHA_SCAT_PER_CM)
    alpha_scat = math.exp(rng.uniform(low, high))
    alpha_abs, scale = draw_absorption_and_scale(rng)
    prior = -1.0
    while prior <= 0.0:
        prior = rng.normal(alpha_abs, PRIOR_SIGMA_PER_CM)
    return Truth(alpha_scat, alpha_abs, scale, prior)


def changes_of(hidden: Hidden) -> dict[str, float | bool]:
    """What is hidden, as parameters of the bench."""
    return {_ALL[name].parameter: size for name, size in hidden if name not in OF_READINGS}


def size_in_units(effect: str, size: float, signal: Array) -> float:
    """A size as the catalogue has it; `signal` is without the effects of the readings.

    That of a number of the bench is how far it is off.
    """
    if effect == f"{WRONG}{_ALL[effect].parameter}":
        name, _, value = _ALL[effect].parameter.partition("=")
        return size - float(value or USUAL.get(name, 0.0))
    if effect == "background":
        return size * float(signal.min())
    if effect == "nonlinearity":
        return size / ((1.0 - size) * float(signal.max()))
    return size


def distort(
    sizes: Mapping[str, float], signal: Array, design: Design, position: Array | None = None
) -> tuple[Array, Array]:
    """Readings with the effects of the readings, in their order, and d reading / d signal.

    Sizes are the catalogue's; position is -1/2 for the first row and 1/2 for the last.
    """
    if position is None:
        position = np.linspace(-0.5, 0.5, len(signal))
    other_sample = np.array([row[2] != _USUAL["crystal_height_mm"] for row in design])
    of_sample = 1.0 + sizes.get("sample_scale", 0.0) * other_sample
    light = of_sample * signal
    bent = 1.0 + sizes.get("nonlinearity", 0.0) * light
    gain = 1.0 + sizes.get("gain_drift", 0.0) * position
    read = gain * (light / bent + sizes.get("background", 0.0))
    return read, gain * of_sample / bent**2


def readings_of(store: HistoryStore, hidden: Hidden, truth: Truth, design: Design) -> Readings:
    """Noise-free readings of a campaign, and their standard errors."""
    eta, relative = store.etas(
        changes_of(hidden), truth.alpha_scat_per_cm, truth.alpha_abs_per_cm, design
    )
    light = truth.scale * eta
    own = {n: size_in_units(n, size, light) for n, size in hidden if n in OF_READINGS}
    signal, slope = distort(own, light, design)
    sigma = np.hypot(READING_SIGMA * signal, slope * light * relative)
    return Readings(design, signal, sigma, light)


def with_transmittance(readings: Readings, hidden: Hidden, truth: Truth, seed: int) -> Readings:
    """Readings with the transmittance of the same crystal, without error of measurement, last."""
    beam = bench_scene(
        alpha_scat_per_cm=truth.alpha_scat_per_cm,
        alpha_abs_per_cm=truth.alpha_abs_per_cm,
        beam_diameter_mm=BEAM_DIAMETER_MM,
        acceptance_deg=ACCEPTANCE_DEG,
        **changes_of(hidden),
    )
    found = trace(beam, BEAM_PHOTONS, seed, threads=1)
    sigma = math.hypot(TRANSMITTANCE_SIGMA * found.eta, found.eta_sigma)
    return replace(
        readings,
        signal=np.append(readings.signal, found.eta),
        sigma=np.append(readings.sigma, sigma),
    )


class LogEta:
    """Logarithms of the efficiencies as polynomials in ln alpha_scat and alpha_abs.

    A table for each case (changes of the bench), within two ranges, 1/cm, with so many nodes.
    """

    def __init__(self, store: HistoryStore, cases, ranges, nodes) -> None:
        self._ends = (tuple(np.log(ranges[0])), ranges[1])
        self._degrees = tuple(n - 1 for n in nodes)
        points = [chebyshev.chebpts1(n) for n in nodes]
        axes = [
            lo + (x + 1) / 2 * (hi - lo) for x, (lo, hi) in zip(points, self._ends, strict=True)
        ]
        basis = [np.linalg.inv(chebyshev.chebvander(x, len(x) - 1)) for x in points]
        tables = [store.log_eta_table(case, np.exp(axes[0]), axes[1]) for case in cases]
        self._terms = np.einsum("pi,qj,crij->crpq", *basis, np.array(tables))

    def __call__(self, log_alpha_scat: float, alpha_abs_per_cm: float) -> Array:
        """(cases, rows of `POOL`) float64; beyond its ends a coefficient counts as at them."""
        at = [
            chebyshev.chebvander(np.clip(2 * (v - lo) / (hi - lo) - 1, -1, 1), degree).ravel()
            for v, (lo, hi), degree in zip(
                (log_alpha_scat, alpha_abs_per_cm), self._ends, self._degrees, strict=True
            )
        ]
        return np.einsum("p,q,crpq->cr", *at, self._terms)


class Excess:
    """What fits of the plain bench, or of one effect, leave of hidden ones."""

    def __init__(self, store: HistoryStore) -> None:
        self._store = store
        self._effects: dict[str, Callable] = {}

    @functools.cached_property
    def _plain(self) -> LogEta:
        return LogEta(self._store, [{}], _PLAIN_RANGES, _PLAIN_NODES)

    def plain(self, readings: Readings, truth: Truth) -> float:
        """chi2 of noise-free readings under the plain bench; the prior is at the truth."""
        return self._fit(readings, truth, None, _PLAIN_RANGES[0])

    def single(self, effect: str, readings: Readings, truth: Truth) -> float:
        """The same with an effect of `EFFECTS` fitted as well.

        Its sizes are traced apart from each other, and the tracer's error of each adds to what
        is left: some units with `PHOTONS`, tens with a tenth of them.
        """
        return self._fit(readings, truth, effect, _EFFECT_RANGES[0])

    def _fit(self, readings, truth, effect, range_per_cm) -> float:
        rows = [POOL.index(row) for row in readings.design]

        def residuals(x):
            light = np.exp(x[2] + self._plain(x[0], x[1])[0])
            if effect is not None and effect not in OF_READINGS:
                light = self._with(effect)(light, *x[[0, 1, 3]])
            light = light[rows]
            if effect in OF_READINGS:
                own = {effect: size_in_units(effect, min(x[3], 0.9), light)}
                light = distort(own, light, readings.design)[0]
            of_light = slice(len(light))
            pulls = (light - readings.signal[of_light]) / readings.sigma[of_light]
            return np.append(pulls, (x[1] - truth.alpha_abs_per_cm) / PRIOR_SIGMA_PER_CM)

        lows = [math.log(range_per_cm[0]), 0.001, -math.inf]
        highs = [math.log(range_per_cm[1]), 0.12, math.inf]
        starts: list[list[float]] = [[]]
        if effect is not None:
            places = [_place(effect, size) for size in EFFECTS[effect].sizes]
            starts = [[place] for place in places]
            reach = 1.0 if EFFECTS[effect].sizes == (True,) else _REACH
            lows = [*lows, reach * min(0.0, *places) - 1e-9]
            highs = [*highs, reach * max(0.0, *places) + 1e-9]
        best = math.inf
        for alpha_scat in (0.2, 0.6, 1.3):
            for further in starts:
                start = [math.log(alpha_scat), truth.alpha_abs_per_cm, math.log(truth.scale)]
                start += further
                found = least_squares(residuals, start, bounds=(lows, highs), x_scale="jac")
                best = min(best, 2.0 * found.cost)
        return best

    def _with(self, effect: str) -> Callable:
        """``light, ln alpha_scat, alpha_abs, place -> light`` with an effect of any size."""
        if effect not in self._effects:
            sizes = EFFECTS[effect].sizes
            cases = [{}, *(changes_of(((effect, size),)) for size in sizes)]
            tables = LogEta(self._store, cases, _EFFECT_RANGES, _EFFECT_NODES)
            nodes = np.array([0.0, *(_place(effect, size) for size in sizes)])
            order = np.argsort(nodes)

            def with_effect(light, log_alpha_scat, alpha_abs, place):
                found = tables(log_alpha_scat, alpha_abs)
                curve = PchipInterpolator(nodes[order], (found - found[0])[order])
                within = np.clip(place, *nodes[order][[0, -1]])
                return light * np.exp(curve(within) + (place - within) * curve(within, 1))

            self._effects[effect] = with_effect
        return self._effects[effect]


def _place(effect: str, size: float) -> float:
    """An effect's size on a scale where it is absent at 0: a source's depth is so at infinity."""
    return 1.0 / (1.0 + size) if effect == "source_depth" else float(size)


def write_campaign(
    folder: Path, name: str, design: Design, signal: Array, sigma: Array, truth: Truth
) -> Path:
    """Write what a laboratory would: readings and a campaign; returns the campaign's file.

    Of the truth only the measured absorption is written; signal and sigma are (readings,), or one
    more with a transmittance.
    """
    in_beam = len(signal) > len(design)
    kinds = ["light,", "transmittance,"] if in_beam else ["", ""]
    lines = [
        "# 59.5 keV, photoelectrons per event",
        f"label,{'kind,' * in_beam}signal,sigma," + ",".join(COLUMNS),
    ]
    for label, s, error, row in zip(labels(design), signal, sigma, design, strict=not in_beam):
        values = ",".join(f"{value:g}" for value in row)
        lines.append(f"{label},{kinds[0]}{s:.6g},{error:.4g},{values}")
    if in_beam:
        lines.append(f"beam,{kinds[1]}{signal[-1]:.6g},{sigma[-1]:.4g}" + "," * len(COLUMNS))
    write_text(folder / f"{name}.csv", "\n".join(lines) + "\n")
    campaign = folder / f"{name}.toml"
    beam = f"[beam]\nbeam_diameter_mm = {BEAM_DIAMETER_MM}\nacceptance_deg = {ACCEPTANCE_DEG}\n\n"
    prior = f"prior = {truth.prior_per_cm:.5f}\nprior_sigma = {PRIOR_SIGMA_PER_CM}\n"
    write_text(
        campaign,
        f'scene = "{SCENE.as_posix()}"\nmeasurements = "{name}.csv"\n\n{beam * in_beam}'
        "[parameters.alpha_scat_per_cm]\nstart = 0.5\nmin = 0.001\nmax = 10.0\n\n"
        f"[parameters.alpha_abs_per_cm]\nstart = 0.039\n{prior}\n[light_yield]\n"
        f"energy_keV = {ENERGY_KEV}\ndetector_efficiency = {DETECTOR_EFFICIENCY}\n"
        # the truth counts light that arrives at the detector
        'efficiency_of = "inside the window"\n',
    )
    return campaign


def labels(design: Design) -> list[str]:
    """Labels of the readings: what each differs in from the bench's own values."""
    liquids = {
        1.0: "air",
        1.333: "water",
        1.4: "silicone",
        1.46: "gel",
        1.515: "oil",
        1.6: "resin",
        1.74: "iodide",
    }
    usual = dict(zip((" hole", " height", " gap"), list(_USUAL.values())[1:], strict=True))
    return [
        liquids[n_gap]
        + "".join(
            f"{what} {value:g}"
            for (what, own), value in zip(usual.items(), further, strict=True)
            if value != own
        )
        for n_gap, *further in design
    ]


@dataclass(frozen=True, eq=False)
class Trial:
    """A campaign with something hidden in it.

    It is drawn from its kind, number and seed. Hidden are effects, with their sizes in the
    catalogue's units; spoiled are readings, by their labels; `what` names either, the same for all
    sizes. The excess is that of the noise-free readings' chi2 under the plain bench; signal and
    sigma are (readings,), the transmittance last where there is one.
    """

    kind: str
    number: int
    seed: int
    hidden: Hidden
    spoiled: tuple[str, ...]
    what: str
    truth: Truth
    expected_excess: float
    design: Design
    signal: Array
    sigma: Array


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
            **dict.fromkeys(("single", LEFT_OUT, FAMILY_OUT, ADVICE), hidden_alone(self._only)),
            "pairs": [*PAIRS, *hidden_alone(of_pairs)],
            "outsiders": hidden_alone(OUTSIDERS),
            "too_small": hidden_alone(TOO_SMALL),
            **dict.fromkeys((NUMBERS, NUMBERS_OUT), hidden_alone(WRONG_NUMBERS)),
            "beam": hidden_alone(BESIDE_BEAM, BESIDE_BEAM),
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
        rng = self._random(kind, number)
        for _ in range(_MOST_TRUTHS):
            truth = draw_truth(rng)
            design = draw_design(rng, EDGE if kind == "edge" else ())
            found = self._found(kind, number, rng, truth, design)
            if found is not None:
                return self._noisy(rng, kind, number, truth, *found)
        raise RuntimeError(f"{kind} trial {number}: no size has the wanted excess")

    def _found(self, kind: str, number: int, rng, truth: Truth, design: Design):
        """What is hidden, what is spoiled, its name, and the readings; None if it will not do."""
        if kind in ("none", "edge"):
            return (), (), "nothing", readings_of(self._store, (), truth, design)
        if kind == "pairs":
            return self._pair(self._in_turn(kind, PAIRS, number), truth, design)
        if kind == "too_small":
            ends = [(effect, size) for effect, known in TOO_SMALL.items() for size in known.sizes]
            hidden = (ends[number % len(ends)],)
            return hidden, (), hidden[0][0], readings_of(self._store, hidden, truth, design)
        if kind == "instrument":
            what = INSTRUMENT_IN_TURN[number % len(INSTRUMENT_IN_TURN)]
            if what not in EFFECTS:
                return self._spoiled(rng, what, truth, design)
            return self._sized(rng, what, truth, design)
        of_kind = {
            "outsiders": OUTSIDERS,
            "beam": BESIDE_BEAM,
            NUMBERS: WRONG_NUMBERS,
            NUMBERS_OUT: WRONG_NUMBERS,
        }.get(kind)
        effect = self._in_turn(kind, tuple(of_kind) if of_kind else self._only, number)
        bounds = ADVICE_EXCESS if kind == ADVICE else EXCESS
        found = self._sized(rng, effect, truth, design, of_kind or EFFECTS, bounds)
        if found is None or kind != "beam":
            return found
        hidden, spoiled, what, readings = found
        seed = int(rng.integers(2**31))
        return hidden, spoiled, what, with_transmittance(readings, hidden, truth, seed)

    def _pair(self, pair: Hidden, truth: Truth, design: Design):
        readings = readings_of(self._store, pair, truth, design)
        for effect, _ in pair:
            if self._excess.single(effect, readings, truth) < PAIR_EXCESS:
                return None
        return pair, (), " + ".join(effect for effect, _ in pair), readings

    def _spoiled(self, rng, what: str, truth: Truth, design: Design):
        """Readings of the plain bench, some of them wrong."""
        readings = readings_of(self._store, (), truth, design)
        signal, sigma = readings.signal.copy(), readings.sigma.copy()
        rows = rng.choice(len(signal), BAD_READINGS.get(what, 2), replace=False)
        if what == SWAPPED_ROWS:
            signal[rows], sigma[rows] = signal[rows[::-1]], sigma[rows[::-1]]
        else:
            off = rng.uniform(*BAD_READING_OFF, len(rows)) * rng.choice([-1.0, 1.0], len(rows))
            signal[rows] *= 1.0 + off
            sigma[rows] *= 1.0 + off
        spoiled = replace(readings, signal=signal, sigma=sigma)
        if self._excess.plain(spoiled, truth) < EXCESS[0]:
            return None
        named = labels(design)
        return (), tuple(named[row] for row in sorted(rows)), what, spoiled

    def _sized(self, rng, effect: str, truth: Truth, design: Design, known=None, bounds=EXCESS):
        """One of the sizes whose excess is within bounds, or None."""
        fitting = []
        for size in (known or EFFECTS)[effect].sizes:
            readings = readings_of(self._store, ((effect, size),), truth, design)
            if bounds[0] <= self._excess.plain(readings, truth) <= bounds[1]:
                fitting.append((((effect, size),), (), effect, readings))
        return fitting[rng.integers(len(fitting))] if fitting else None

    def _in_turn(self, kind: str, items: Sequence, number: int):
        """Items in a shuffled order, each as often as any other."""
        order = self._random(kind, 2**31).permutation(len(items))
        return items[order[number % len(items)]]

    def _random(self, kind: str, number: int) -> np.random.Generator:
        key = (KINDS.index(kind), number)
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))

    def _noisy(self, rng, kind, number, truth, hidden, spoiled, what, readings) -> Trial:
        """The trial, with errors of measurement; the tracer's are in the readings already."""
        of_readings = np.full(len(readings.signal), READING_SIGMA)
        of_readings[len(readings.design) :] = TRANSMITTANCE_SIGMA
        noise = 1.0 + of_readings * rng.standard_normal(len(readings.signal))
        sizes = tuple((name, size_in_units(name, size, readings.light)) for name, size in hidden)
        return Trial(
            kind,
            number,
            self._seed,
            sizes,
            spoiled,
            what,
            truth,
            self._excess.plain(readings, truth),
            readings.design,
            readings.signal * noise,
            readings.sigma,
        )


@functools.cache
def trial_maker(histories: Path, photons: int, seed: int, only: tuple[str, ...]) -> TrialMaker:
    """The one of this process: it remembers what it has read."""
    return TrialMaker(HistoryStore(histories, photons), seed, only)


def draw_and_run(
    maker: tuple, kind: str, number: int, folder: Path | None, threads: int | None
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
    campaign = write_campaign(folder, name, trial.design, trial.signal, trial.sigma, trial.truth)
    tolerances = CALIPER if trial.kind in (NUMBERS, NUMBERS_OUT) else MICROMETER
    write_text(campaign, campaign.read_text(encoding="utf-8") + tolerances)
    start = time.perf_counter()
    without = left_out_of(trial, mcrim.read_campaign(campaign).catalogue)
    said = diagnose_and_repair(campaign, threads, photons, without)
    further: dict = {}
    if trial.kind == ADVICE:
        further["advice"] = _advised(trial, folder, said, threads, photons)
    if trial.kind in (LEFT_OUT, FAMILY_OUT, NUMBERS_OUT):
        further["known"] = _known(trial, campaign, threads, photons)
    seconds = time.perf_counter() - start
    effects = {effect for effect, _ in trial.hidden}
    limits, before, after = said["upper_limits"], said["baseline"], said["calibration"]
    return {
        "kind": trial.kind,
        "number": trial.number,
        "seed": trial.seed,
        "hidden": [list(item) for item in trial.hidden],
        "spoiled": list(trial.spoiled),
        "what": trial.what,
        "truth": asdict(trial.truth),
        "readings": len(trial.design),
        "expected_excess": trial.expected_excess,
        **_judged(trial, said),
        "suspects": [one["labels"] for one in said["suspect_readings"]],
        "candidates": [
            {key: one[key] for key in ("effect", "chi2", "p_value", "plausible")}
            for one in (*said["candidates"][:4], *said["pairs"][:4])
        ],
        "without": list(without),
        "limits": {effect: limits[effect] for effect in effects if effect in limits},
        "steps": [[step["added"], step["chi2"], step["p_value"]] for step in said["repair"]],
        "chi2_before": before["chi2"],
        "p_before": before["p_value"],
        "p_after": after["p_value"],
        "pulls_before": _pulls(before["parameters"], trial.truth),
        "pulls_after": _pulls(after["parameters"], trial.truth),
        "seconds": seconds,
        "diagnosis_seconds": said["diagnosis_seconds"],
        **further,
    }


def _judged(trial: Trial, said: dict) -> dict:
    """The verdict, what leads, what was added, and how good the averaged light yield is."""
    averaged, truth = said["light_yield_averaged"], trial.truth.light_yield_ph_per_keV
    return {
        "verdict": said["verdict"],
        "reason": said["reason"],
        "first": said["candidates"][0]["effect"] if said["candidates"] else None,
        "leading": said["leading"],
        "leading_sets": said["leading_sets"],
        "added": said["effects"],
        "families": [[one["family"], one["probability"]] for one in said["families"][:4]],
        "probabilities": dict(list(said["probabilities"].items())[:6]),
        "averaged": {
            "relative_sigma": averaged["sigma"] / truth,
            "pull": (averaged["value"] - truth) / averaged["sigma"],
            "in_68": averaged["lower"] <= truth <= averaged["upper"],
            "in_95": averaged["lower_95"] <= truth <= averaged["upper_95"],
            "value": averaged["value"],
            "within": averaged["within"],
            "between": averaged["between"],
            "catalogue": averaged["catalogue"],
        },
    }


def _known(trial: Trial, campaign: Path, threads: int | None, photons: int | None) -> dict:
    """What is said where the catalogue has what is hidden; and the error of who knows that."""
    said = diagnose_and_repair(campaign, threads, photons)
    right = mcrim.read_campaign(campaign).with_effects([trial.what])
    fitted = plain(mcrim.calibrate(right, photons=photons, threads=threads).document)
    own = fitted["parameters"]["light_yield_ph_per_keV"]
    relative = own["sigma"] / trial.truth.light_yield_ph_per_keV
    return _judged(trial, said) | {"right_relative_sigma": relative}


def _advised(
    trial: Trial, folder: Path, said: dict, threads: int | None, photons: int | None
) -> dict | None:
    """What becomes of the diagnosis where the first new configuration that is proposed is measured.

    None where effects could be told apart, or nothing is proposed.
    """
    new = (p for p in said["next_measurements"] if {*p["kind"].split(" + ")} == {"reading"})
    best = next(new, None)
    if said["verdict"] != "ambiguous" or best is None:
        return None
    proposed = [best["parameters"]] + ([best["also"]] if best["also"] else [])
    further = measured(trial, proposed)
    name = f"{trial.kind}-{trial.number}-further"
    campaign = write_campaign(folder, name, *further, trial.truth)
    again = diagnose_and_repair(campaign, threads, photons)
    return {
        "proposed": proposed,
        "promised": best["light_yield_sigma"],
        "before": _relative(said),
        "after": _relative(again),
        **_judged(trial, again),
    }


def _relative(said: dict) -> float:
    averaged = said["light_yield_averaged"]
    return averaged["sigma"] / averaged["value"]


def measured(trial: Trial, proposed: Sequence[Mapping]) -> tuple[Design, Array, Array]:
    """A trial's campaign with further readings, of light or a transmittance, after its own.

    They are traced at the truth, in configurations by what they differ from the scene.
    """
    rng = np.random.default_rng([trial.seed, trial.number])
    design, signal, sigma = trial.design, trial.signal, trial.sigma
    own = {name: size for name, size in trial.hidden if name in OF_READINGS}
    changes = changes_of(trial.hidden)
    coefficients = {
        "alpha_scat_per_cm": trial.truth.alpha_scat_per_cm,
        "alpha_abs_per_cm": trial.truth.alpha_abs_per_cm,
    }
    in_beam = None
    for each in proposed:
        if each.get("kind", "light") != "light":
            readings = Readings(design, signal[:0], sigma[:0], signal)
            found = with_transmittance(
                readings, trial.hidden, trial.truth, int(rng.integers(2**31))
            )
            noise = 1.0 + TRANSMITTANCE_SIGMA * rng.standard_normal()
            in_beam = found.signal * noise, found.sigma
            continue
        values = _USUAL | {name: float(each[name]) for name in each if name in _USUAL}
        filled = is_filled(values["n_gap"])
        here = {n: v for n, v in changes.items() if filled or n not in FILLED_ONLY}
        scene = bench_scene(**values, **coefficients, **here)
        found = trace(scene, FURTHER_PHOTONS, int(rng.integers(2**31)), threads=1)
        position = 0.5 + (len(design) + 1 - len(trial.design)) / (len(trial.design) - 1)
        row, light = tuple(values.values()), np.array([trial.truth.scale * found.eta])
        read, slope = distort(own, light, (row,), np.array([position]))
        error = np.hypot(READING_SIGMA * read, slope * light * found.eta_sigma / found.eta)
        design = (*design, row)
        signal = np.append(signal, read * (1.0 + READING_SIGMA * rng.standard_normal()))
        sigma = np.append(sigma, error)
    if in_beam is not None:
        signal, sigma = np.append(signal, in_beam[0]), np.append(sigma, in_beam[1])
    return design, signal, sigma


def left_out_of(trial: Trial, known: Mapping[str, Effect]) -> tuple[str, ...]:
    """Effects of those of a campaign that the package must not know in a trial."""
    if trial.kind in (LEFT_OUT, NUMBERS_OUT):
        # of a number all that says that it, or another of its values, is wrong
        number = trial.what.partition("=")[0]
        return tuple(name for name in known if name.partition("=")[0] == number)
    if trial.kind == FAMILY_OUT:
        family = known[trial.what].family
        return tuple(name for name, effect in known.items() if effect.family == family)
    return ()


def diagnose_and_repair(
    campaign: Path,
    threads: int | None = None,
    photons: int | None = None,
    without: Sequence[str] = (),
) -> dict:
    """What the package says of a campaign, as `mcrim repair --json` has it; diagnosis_seconds."""
    known = mcrim.read_campaign(campaign)
    if without:
        rest = {name: effect for name, effect in known.catalogue.items() if name not in without}
        known = replace(known, catalogue=rest)
    found = mcrim.repair(known, photons=photons, threads=threads)
    seconds = found.seconds
    if (set_aside := found.set_aside) and found.verdict != UNEXPLAINED:
        # larger than usual, as much of what is hidden: somebody looked for it, and it is there
        found = mcrim.repair(known, effect=set_aside, photons=photons, threads=threads)
    return plain(found.document) | {"diagnosis_seconds": seconds}


def _pulls(parameters: dict, truth: Truth) -> dict[str, float]:
    """Distances from the truth in standard errors."""
    names = ("alpha_scat_per_cm", "light_yield_ph_per_keV")
    return {
        name: (parameters[name]["value"] - getattr(truth, name)) / parameters[name]["sigma"]
        for name in names
    }
