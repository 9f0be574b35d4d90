"""Comparisons of numbers that have errors; each test file says how far a z-score may be from 0."""

import math
from collections.abc import Mapping

import pytest


def z_score(value, sigma, expected, expected_sigma=0.0) -> float:
    return (value - expected) / math.hypot(sigma, expected_sigma)


def assert_compatible(value, sigma, expected, expected_sigma=0.0, what="", *, z_max=4.5) -> None:
    z = z_score(value, sigma, expected, expected_sigma)
    assert abs(z) < z_max, (
        f"{what}: {value:.5f} +- {sigma:.5f}, expected {expected:.5f}, z = {z:.1f}"
    )


def assert_same_eta(one, other, what="", *, z_max=4.5) -> None:
    assert_compatible(one.eta, one.eta_sigma, other.eta, other.eta_sigma, what, z_max=z_max)


def assert_same_fates(
    one, other, *, z_max, rare=2e-4, renamed: Mapping[str, str] | None = None
) -> None:
    """Every fate that is frequent in one of two results; `renamed`: what the other calls it."""
    for fate, fraction in one.budget.items():
        theirs = (renamed or {}).get(fate, fate)
        expected = other.budget.get(theirs, 0.0)
        if max(fraction, expected) > rare:
            sigmas = one.budget_sigma[fate], other.budget_sigma[theirs]
            assert_compatible(fraction, sigmas[0], expected, sigmas[1], fate, z_max=z_max)


def assert_all_light_is_told(*results) -> None:
    for result in results:
        assert sum(result.budget.values()) == pytest.approx(1, abs=1e-6)
        assert result.budget["lost"] < 1e-5


def assert_same_light(one, other, **options) -> None:
    """`assert_same_fates` of two results that tell of all light."""
    assert_all_light_is_told(one, other)
    assert_same_fates(one, other, **options)


def eta_slope(simulation, name, *, photons, seed=0) -> tuple[float, float]:
    """Derivative of eta by a coefficient (cm) and its error, by Dr.Jit's forward mode."""
    from mcrim_mitsuba.transport.collection import slope_along  # imports Mitsuba

    along = {"alpha_scat_per_cm": (0.1, 0.0), "alpha_abs_per_cm": (0.0, 0.1)}[name]
    return slope_along(
        simulation.launcher(),
        {simulation.crystal.volume: along},
        photons,
        seed=seed,
        max_depth=simulation.depth_limit,
    )
