"""Campaigns with something hidden in them, for `hidden`: weighed and written.

The expected excess is what hides in a campaign's chi2: noise-free readings fitted with the plain
bench. The plain bench is the tracer's here too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares
from shared import SCENE

from mcrim_mitsuba.core.files import write_text
from trials.hidden_histories import COLUMNS, READINGS, HistoryStore
from trials.truth import PRIOR_SIGMA_PER_CM, TRUE_ALPHA_SCAT_PER_CM, draw_absorption_and_scale

#: Relative standard error of a reading, the tracer's own apart.
READING_SIGMA = 0.007
#: What turns the scale into a light yield; without an error, which would blur the pulls.
ENERGY_KEV, DETECTOR_EFFICIENCY = 59.5, 0.127
#: Sizes of the readings' effects are relative: a background to the smallest reading, a saturation
#: is the relative loss of the largest.
OF_READINGS = ("background", "saturation")
#: Expected excess of the plain fit's chi2 that trials are drawn with.
EXCESS = (50.0, 400.0)
#: Least of it that the better of two hidden effects leaves unexplained.
PAIR_EXCESS = 30.0

# Chebyshev nodes of the tables: plain bench, effects
_PLAIN_RANGES, _PLAIN_NODES = ((0.05, 4.5), (0.001, 0.12)), (11, 4)
_EFFECT_RANGES, _EFFECT_NODES = ((0.12, 1.6), (0.001, 0.12)), (6, 3)
# how far beyond the sizes on offer an effect may go when it is fitted, straight on
_REACH = 2.5


class HiddenEffect(NamedTuple):
    """A field of `Bench`, or the own name of an effect of the readings; sizes it is hidden with."""

    parameter: str
    sizes: tuple[float | bool, ...]


#: Effects that can reach an excess of 50. The smallest sizes do so for some truths only.
EFFECTS: dict[str, HiddenEffect] = {
    "anisotropic_scattering": HiddenEffect("scattering_g", (0.85, 0.95)),
    "scattering_gradient": HiddenEffect("scattering_gradient", (-1.0, 1.0)),
    "source_depth": HiddenEffect("source_depth_mm", (1.0, 2.5, 5.0)),
    "surface_roughness": HiddenEffect("roughness_alpha", (0.1, 0.18, 0.3)),
    "surface_absorption": HiddenEffect("surface_loss", (0.01, 0.02, 0.045)),
    "gap_index": HiddenEffect("gap_index_offset", (-0.08, 0.06, 0.09)),
    "gap_absorption": HiddenEffect("gap_absorption_per_cm", (0.8, 1.4, 2.4)),
    "gap_bubble": HiddenEffect("bubble_fraction", (0.15, 0.3, 0.5)),
    "top_reflector": HiddenEffect("top_reflectance", (0.25, 0.4, 0.6)),
    "detector_reflection": HiddenEffect("detector_reflectance", (0.15, 0.25, 0.4)),
    "detector_angle": HiddenEffect("angular_falloff", (0.45, 0.6, 0.8)),
    "detector_radius": HiddenEffect("radial_falloff", (0.2, 0.3, 0.5)),
    "aperture_at_detector": HiddenEffect("aperture_at_detector", (True,)),
    "edge_chamfer": HiddenEffect("chamfer_mm", (0.15, 0.25, 0.45)),
    "background": HiddenEffect("background", (0.07, 0.1, 0.15)),
    "saturation": HiddenEffect("saturation", (0.08, 0.12, 0.17)),
}
#: Effects that cannot, at the ends of their ranges.
TOO_SMALL: dict[str, HiddenEffect] = {
    "polarization": HiddenEffect("polarization", (True,)),
    "rayleigh_scattering": HiddenEffect("rayleigh_scattering", (True,)),
    "crystal_index": HiddenEffect("n_crystal", (1.91, 2.11)),
    "gap_thickness": HiddenEffect("gap_offset_mm", (-0.04, 0.5)),
}
#: What the catalogue does not have.
OUTSIDERS: dict[str, HiddenEffect] = {
    "gel_creep": HiddenEffect("gel_creep_mm", (0.5, 1.5)),
    "black_spot": HiddenEffect("black_spot_mm", (2.0, 4.0, 7.0)),
}
_ALL = EFFECTS | TOO_SMALL | OUTSIDERS

#: What is hidden: effects and their sizes.
Hidden = tuple[tuple[str, float | bool], ...]

#: Two effects at once.
PAIRS: tuple[Hidden, ...] = (
    (("source_depth", 2.0), ("gap_absorption", 1.2)),
    (("surface_absorption", 0.04), ("gap_index", 0.05)),
    (("detector_angle", 0.7), ("gap_bubble", 0.4)),
    (("top_reflector", 0.5), ("background", 0.12)),
    (("edge_chamfer", 0.35), ("detector_reflection", 0.35)),
    (("detector_radius", 0.4), ("source_depth", 2.0)),
    (("gap_bubble", 0.4), ("saturation", 0.14)),
    (("aperture_at_detector", True), ("surface_absorption", 0.04)),
    (("gap_absorption", 1.8), ("background", 0.12)),
    (("surface_roughness", 0.25), ("detector_radius", 0.4)),
    (("top_reflector", 0.5), ("gap_index", 0.06)),
    (("source_depth", 1.5), ("edge_chamfer", 0.35)),
)


def hidden_alone(effects: Iterable[str]) -> list[Hidden]:
    """Every size of effects, one at a time."""
    return [((name, size),) for name in effects for size in _ALL[name].sizes]


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
    """Readings (readings,) as they would be without errors of measurement.

    Sigma holds the error of measurement and the tracer's; `light` is the signal without effects
    of the readings.
    """

    signal: NDArray[np.float64]
    sigma: NDArray[np.float64]
    light: NDArray[np.float64]


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
    """What is hidden, as fields of `Bench`."""
    return {_ALL[name].parameter: size for name, size in hidden if name not in OF_READINGS}


def size_in_units(effect: str, size: float, signal: NDArray[np.float64]) -> float:
    """A size as the catalogue has it; `signal` is without the effects of the readings."""
    if effect == "background":
        return size * float(signal.min())
    if effect == "saturation":
        return size / ((1.0 - size) * float(signal.max()))
    return size


def distort(
    hidden: Sequence[tuple[str, float]], signal: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Readings with the effects of the readings, saturation first, and d reading / d signal."""
    sizes = {name: size_in_units(name, size, signal) for name, size in hidden}
    held_back = 1.0 + sizes.get("saturation", 0.0) * signal
    return signal / held_back + sizes.get("background", 0.0), 1.0 / held_back**2


def readings_of(store: HistoryStore, hidden: Hidden, truth: Truth) -> Readings:
    """Noise-free readings of a campaign, and their standard errors."""
    eta, relative = store.etas(changes_of(hidden), truth.alpha_scat_per_cm, truth.alpha_abs_per_cm)
    light = truth.scale * eta
    own = [item for item in hidden if item[0] in OF_READINGS]
    signal, slope = distort(own, light)
    sigma = np.hypot(READING_SIGMA * signal, slope * light * relative)
    return Readings(signal, sigma, light)


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

    def __call__(self, log_alpha_scat: float, alpha_abs_per_cm: float) -> NDArray[np.float64]:
        """(cases, readings) float64; beyond its ends a coefficient counts as at them."""
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

    @cached_property
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
        def residuals(x):
            light = np.exp(x[2] + self._plain(x[0], x[1])[0])
            if effect is not None:
                light = self._with(effect)(light, *x[[0, 1, 3]])
            pulls = (light - readings.signal) / readings.sigma
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
        if effect in OF_READINGS:
            return lambda light, a, b, size: distort([(effect, min(size, 0.9))], light)[0]
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
    folder: Path, name: str, signal: NDArray[np.float64], sigma: NDArray[np.float64], truth: Truth
) -> Path:
    """Write what a laboratory would: readings and a campaign; returns the campaign's file.

    Of the truth only the measured absorption is written; signal and sigma are (readings,).
    """
    lines = ["# 59.5 keV, photoelectrons per event", "label,signal,sigma," + ",".join(COLUMNS)]
    for label, s, error, row in zip(labels(), signal, sigma, READINGS, strict=True):
        lines.append(f"{label},{s:.6g},{error:.4g}," + ",".join(f"{value:g}" for value in row))
    write_text(folder / f"{name}.csv", "\n".join(lines) + "\n")
    campaign = folder / f"{name}.toml"
    write_text(
        campaign,
        f'scene = "{SCENE.as_posix()}"\nmeasurements = "{name}.csv"\n\n'
        "[parameters.alpha_scat_per_cm]\nstart = 0.5\nmin = 0.001\nmax = 10.0\n\n"
        "[parameters.alpha_abs_per_cm]\nstart = 0.039\n"
        f"prior = {truth.prior_per_cm:.5f}\nprior_sigma = {PRIOR_SIGMA_PER_CM}\n\n"
        f"[light_yield]\nenergy_keV = {ENERGY_KEV}\n"
        f"detector_efficiency = {DETECTOR_EFFICIENCY}\n",
    )
    return campaign


def labels() -> list[str]:
    """Labels of the readings: what each differs in from the bench's own values."""
    liquids = {1.0: "air", 1.333: "water", 1.46: "gel", 1.515: "oil"}
    usual = {" hole": 14.0, " height": 10.0, " gap": 0.05}
    return [
        liquids[n_gap]
        + "".join(
            f"{what} {value:g}"
            for (what, own), value in zip(usual.items(), further, strict=True)
            if value != own
        )
        for n_gap, *further in READINGS
    ]
