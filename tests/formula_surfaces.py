"""Surfaces of eta from formulas: a bench in air or gel that costs no simulation."""

import math

from trials.surface_model import EfficiencySurface

from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.efficiency.surface import EtaPoint


class FormulaSurface(EfficiencySurface):
    """A surface from a formula of (a_s, a_a), with a relative Monte Carlo error."""

    alpha_scat_bounds_per_cm = (1e-3, 20.0)

    def __init__(self, formula, relative_sigma=0.0, noise=0.0):
        self.formula, self.relative_sigma, self.factor = formula, relative_sigma, 1 + noise

    def evaluate(self, alpha_scat_per_cm, alpha_abs_per_cm, *, check=True, error=True):
        def eta(a_s, a_a):
            return self.factor * self.formula(a_s, a_a)

        a_s, a_a, step = alpha_scat_per_cm, alpha_abs_per_cm, 1e-6
        return EtaPoint(
            eta(a_s, a_a),
            self.relative_sigma * eta(a_s, a_a),
            {
                ALPHA_SCAT: (eta(a_s + step, a_a) - eta(a_s - step, a_a)) / (2 * step),
                ALPHA_ABS: (eta(a_s, a_a + step) - eta(a_s, a_a - step)) / (2 * step),
            },
        )

    def covariance(self, first, second):
        return self.relative_sigma**2 * math.prod(
            self.evaluate(point[ALPHA_SCAT], point[ALPHA_ABS]).eta for point in (first, second)
        )


def air(a_s, a_a):
    return (0.12 + 0.15 * a_s / (a_s + 0.15)) * math.exp(-2.5 * a_a)


def gel(a_s, a_a):
    return (0.36 + 0.1 * a_s / (a_s + 0.1) - 0.02 * a_s) * math.exp(-1.5 * a_a)


def of_index(n, gap=0.0):
    return lambda a_s, a_a: air(a_s, a_a) * math.sqrt(1 - (1 / n) ** 2) * math.exp(-gap * (1 + n))


def couplings(relative_sigma=0.0, noise=None, calls=None, kind=FormulaSurface):
    """Surfaces by n_gap: air or gel, optionally off by a Monte Carlo fluctuation."""

    def surfaces(parameters):
        if calls is not None:
            calls.append(parameters)
        formula = air if parameters["n_gap"] == 1.0 else gel
        return kind(formula, relative_sigma, (noise or {}).get(parameters["n_gap"], 0.0))

    return surfaces
