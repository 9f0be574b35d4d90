"""Numbers with named errors, light yields on top of them, their budgets and commands."""

import math

import numpy as np
import pytest
from places import SCENES, cases_of
from refusals import refusal

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.laboratory.error_budget import (
    ADVICE,
    Uncertain,
    budget_of,
    common_value,
    contribution,
    quotient,
)
from mcrim_mitsuba.laboratory.light_yield import (
    RelativeMeasurement,
    light_yield_by_reference,
    light_yield_ph_per_keV,
    read_comparison,
)

cases = cases_of(__file__)

EXAMPLE = SCENES / "cawo4_reference.toml"
#: Two-sided false alarms of a standard normal number: about 1e-5.
SIGMAS = 4.4


def test_what_is_shared_cancels_in_a_ratio_and_adds_up_in_a_product():
    first = Uncertain(2.0, {"counts, a": 0.02}, {"tube scale": 0.10})
    second = Uncertain(5.0, {"counts, b": 0.10}, {"tube scale": 0.25})
    ratio = quotient([("a", first)], [("b", second)])
    assert ratio.value == pytest.approx(0.4)
    assert ratio.systematic["tube scale"] == pytest.approx(0.0, abs=1e-15)
    assert ratio.sigma == pytest.approx(0.4 * math.hypot(0.01, 0.02))

    product = quotient([("a", first), ("b", second)], [])
    assert product.systematic_sigma == pytest.approx(10.0 * (0.05 + 0.05))
    assert product.statistical_sigma == pytest.approx(10.0 * math.hypot(0.01, 0.02))

    opposed = Uncertain(5.0, systematic={"tube scale": -0.25})
    assert quotient([("a", first)], [("b", opposed)]).systematic["tube scale"] > 0.039


def test_different_origins_are_independent():
    parts = quotient(
        [("a", Uncertain(1.0, systematic={"eta": 0.12}))],
        [("b", Uncertain(1.0, systematic={"detector_efficiency": 0.10}))],
    )
    assert parts.sigma == pytest.approx(math.hypot(0.12, 0.10))
    assert parts.systematic["detector_efficiency"] == pytest.approx(-0.10)
    known = Uncertain(1.0, systematic={"eta": 0.12})
    own = quotient([("a", known.own("a"))], [("b", known.own("b"))])
    assert own.sigma == pytest.approx(0.12 * math.sqrt(2))


def test_an_origin_is_of_one_kind():
    with pytest.raises(ValueError, match="counts cannot be"):
        Uncertain(1.0, {"counts": 0.1}, {"counts": 0.1})
    one, other = Uncertain(1.0, {"counts": 0.1}), Uncertain(1.0, systematic={"counts": 0.1})
    with pytest.raises(ValueError, match="counts cannot be"):
        quotient([("a", one)], [("b", other)])
    with pytest.raises(ValueError, match="nan"):
        Uncertain(1.0, {"counts": math.nan})


def test_propagation_against_random_numbers():
    """Relative width and correlation of Eq. 7, 200,000 draws: second order and chance allowed."""
    count, rng = 200_000, np.random.default_rng(6)
    draws = {
        name: rng.standard_normal(count)
        for name in ("counts, a", "counts, b", "eta, a", "eta, b", "eta, shared", "scale")
    }
    errors = {
        "signal": ({"counts, a": 0.014}, {"counts, b": 0.010}),
        "eta": ({"eta, a": 0.03, "eta, shared": 0.02}, {"eta, b": 0.02, "eta, shared": 0.04}),
        "efficiency": ({"scale": 0.05}, {"scale": 0.05}),
    }
    values = {"signal": (14.3, 40.1), "eta": (0.25, 0.162), "efficiency": (0.127, 0.221)}
    known, drawn = [], []
    for crystal in (0, 1):
        for name, pair in errors.items():
            value, parts = values[name][crystal], pair[crystal]
            known.append(Uncertain(value, systematic={o: value * r for o, r in parts.items()}))
            drawn.append(value * (1 + sum(r * draws[o] for o, r in parts.items())))
    found = light_yield_by_reference(*known, 16.2)
    sample = (
        light_yield_by_reference(*(Uncertain(1.0),) * 6, 1.0).value
        * 16.2
        * (drawn[0] * drawn[4] * drawn[5] / (drawn[1] * drawn[2] * drawn[3]))
    )
    width = sample.std() / sample.mean()
    # the shared part of eta is larger in the reference: 4 % - 2 % is left
    expected = math.hypot(0.014, 0.010, 0.03, 0.02, 0.02)
    assert found.sigma / found.value == pytest.approx(expected)
    assert abs(width / expected - 1) < SIGMAS / math.sqrt(2 * count) + 2 * expected**2


def test_mean_of_two_that_share_a_scale():
    values = [
        Uncertain(7.5, {"counts, air": 0.15}, {"detector_efficiency": -0.75}),
        Uncertain(7.5, {"counts, gel": 0.30}, {"detector_efficiency": -0.75}),
    ]
    together = common_value(values)
    assert together.mean.value == pytest.approx(7.5)
    assert together.weights == pytest.approx([0.8, 0.2], abs=1e-6)
    assert together.mean.systematic_sigma == pytest.approx(0.75)
    assert together.mean.statistical_sigma == pytest.approx(1 / math.hypot(1 / 0.15, 1 / 0.30))
    assert together.chi2 == pytest.approx(0.0) and together.p_value == pytest.approx(1.0)


def test_peelles_puzzle_stays_between_its_values():
    """1.5 and 1.0, 10 % each and 20 % in common: absolute errors would give 0.88 ± 0.22."""
    values = [Uncertain(v, {f"counts, {v}": 0.1 * v}, {"eta": 0.2 * v}) for v in (1.5, 1.0)]
    together = common_value(values)
    assert together.mean.value == pytest.approx(1.25)
    assert together.mean.sigma / 1.25 == pytest.approx(math.hypot(0.2, 0.1 / math.sqrt(2)))
    assert together.chi2 == pytest.approx((0.5 / 1.25) ** 2 / 0.02)


def test_shared_errors_of_almost_one_size_do_not_choose_a_value():
    """12.0 and 11.6 % of one origin: taken as they are, the first would weigh -0.44."""
    air, gel = (0.014, 0.120), (0.016, 0.116)
    off = gel[1] * (gel[1] - air[1]) + gel[0] ** 2, air[1] * (air[1] - gel[1]) + air[0] ** 2
    assert off[0] / sum(off) == pytest.approx(-0.44, abs=0.005)
    together = common_value(
        [
            Uncertain(1.0, {"counts, air": air[0]}, {"eta": air[1]}),
            Uncertain(2.0, {"counts, gel": 2 * gel[0]}, {"eta": 2 * gel[1]}),
        ]
    )
    assert (together.weights > 0.1).all()
    assert together.mean.systematic_sigma / together.mean.value == pytest.approx(
        together.weights @ [air[1], gel[1]]
    )


def test_means_without_errors_of_their_own():
    for shared in (0.0, 0.1):
        values = [Uncertain(v, systematic={"eta": shared * v}) for v in (2.0, 3.0)]
        together = common_value(values)
        assert together.mean.value == pytest.approx(2.5)
        assert together.mean.sigma == pytest.approx(2.5 * shared)
        assert together.chi2 is None and together.p_value is None
    exact = common_value([Uncertain(2.0), Uncertain(3.0, {"counts": 0.1})])
    assert exact.mean.value == pytest.approx(2.0, abs=1e-4) and exact.chi2 is not None
    single = common_value([Uncertain(2.0, {"counts": 0.1})])
    assert single.mean.value == pytest.approx(2.0)
    assert single.mean.contributions == {"counts": pytest.approx(0.1)}
    assert single.ndf == 0 and single.p_value is None
    with pytest.raises(InputError, match="is 0"):
        common_value([Uncertain(0.0)])


def test_mean_against_random_numbers():
    """4,000 campaigns of three couplings: error, and chi2 with 2 degrees of freedom."""
    rng, count = np.random.default_rng(7), 4000
    counts, scale = np.array([0.010, 0.015, 0.030]), 0.05
    drawn = 7.5 * (1 + counts * rng.standard_normal((count, 3)))
    drawn *= 1 + scale * rng.standard_normal((count, 1))
    found = [
        common_value(
            [
                Uncertain(v, {f"counts, {place}": c * v}, {"detector_efficiency": -scale * v})
                for place, (v, c) in enumerate(zip(row, counts, strict=True))
            ]
        )
        for row in drawn
    ]
    pulls = np.array([(known.mean.value - 7.5) / known.mean.sigma for known in found])
    chi2 = np.array([known.chi2 for known in found])
    assert abs(pulls.mean()) < SIGMAS / math.sqrt(count)
    # errors are relative ones of the value found: second order widens the pulls a little
    assert abs(pulls.std() - 1) < SIGMAS / math.sqrt(2 * count) + scale**2
    assert abs(chi2.mean() - 2) < SIGMAS * 2 / math.sqrt(count)


def article_yields():
    return [
        light_yield_ph_per_keV(
            Uncertain(signal, {f"counts, {label}": 0.016 * signal}),
            Uncertain(eta, systematic={"eta": 0.12 * eta}),
            Uncertain(0.127, systematic={"detector_efficiency": 0.0127}),
            59.5,
        )
        for label, signal, eta in (("air", 14.3, 0.25), ("gel", 24.5, 0.43))
    ]


def test_light_yields_of_the_article_and_their_budget():
    """Sec. 6.3: 7.5 and 7.5 ph/keV; eta 12 %, efficiency 10 %, counts 1.6 %: 16 %."""
    air, gel = article_yields()
    assert air.value == pytest.approx(7.57, abs=0.005)
    assert gel.value == pytest.approx(7.54, abs=0.005)
    assert pdg(7.5, air.sigma) == "7.5 ± 1.2"
    budget = budget_of(air)
    assert [row.name for row in budget.contributions] == [
        "eta",
        "detector_efficiency",
        "counts, air",
    ]
    assert [abs(row.relative) for row in budget.contributions] == pytest.approx([0.12, 0.10, 0.016])
    assert [row.kind[:4] for row in budget.contributions] == ["syst", "syst", "stat"]
    assert all(row.by for row in budget.contributions)
    assert budget.total == pytest.approx(math.hypot(0.12, 0.10, 0.016))
    assert round(100 * budget.total) == 16
    assert budget.statistical == pytest.approx(0.016)
    assert sum(budget.share(row) for row in budget.contributions) == pytest.approx(1.0)

    together = budget_of(common_value([air, gel]).mean)
    assert together.statistical == pytest.approx(0.016 / math.sqrt(2), rel=1e-4)
    assert {row.name for row in together.merged.contributions} == {
        "counts",
        "eta",
        "detector_efficiency",
    }
    assert together.merged.total == pytest.approx(together.total)


def test_advice_covers_what_other_modules_name():
    fit = ("statistical", "prior", "monte_carlo", "detector_efficiency")
    spectra = ("tube scale", "quantum efficiency curve", "emission spectrum")
    assert set(ADVICE) > {*fit, *spectra}
    assert "standard" in contribution("tube scale, sample", 0.05).by
    with pytest.raises(ValueError, match="no advice"):
        contribution("moonlight", 0.1)


def test_relative_method_of_the_article():
    """Sec. 6.4: 7.1 ± 1.7 with eta = 0.23 and all errors independent."""
    sample = {
        "signal": (14.3, 0.2),
        "eta": (0.23, 0.12 * 0.23),
        "detector_efficiency": (0.127, 0.0127),
    }
    reference = {
        "signal": (40.1, 0.4),
        "eta": (0.162, 0.12 * 0.162),
        "detector_efficiency": (0.221, 0.0221),
    }
    independent = RelativeMeasurement(sample, reference, (16.2, 1.6), {})
    assert pdg(independent.light_yield.value, independent.light_yield.sigma) == "7.1 ± 1.7"
    assert independent.light_yield.sigma == pytest.approx(independent.uncorrelated.sigma)
    assert independent.signals_alone == pytest.approx(5.78, abs=0.005)
    assert independent.equal_collection == pytest.approx(10.05, abs=0.005)

    shared = RelativeMeasurement(
        sample, reference, (16.2, 1.6), {"detector_efficiency": 0.05, "eta": 0.04, "signal": 0.009}
    )
    assert shared.uncorrelated.sigma == pytest.approx(independent.light_yield.sigma)
    known = shared.light_yield
    gained = (shared.uncorrelated.sigma**2 - known.sigma**2) / known.value**2
    assert gained == pytest.approx(2 * (0.05**2 + 0.04**2 + 0.009**2))
    for origin in ("detector_efficiency, shared", "eta, shared", "signal, shared"):
        assert known.systematic[origin] == pytest.approx(0.0, abs=1e-15)
    # all of an error shared: nothing is left of it
    whole = RelativeMeasurement(sample, reference, (16.2, 1.6), {"detector_efficiency": 0.1})
    left = {origin for origin, part in whole.light_yield.relative.items() if abs(part) > 1e-9}
    assert not any("detector_efficiency" in origin for origin in left)
    with pytest.raises(ValueError, match="larger"):
        _ = RelativeMeasurement(
            sample, reference, (16.2, 1.6), {"detector_efficiency": 0.11}
        ).light_yield


AIR = ["--signal", "14.3±0.2", "--eta", "0.25 ± 12%"]
GEL = ["--signal", "24.5+-0.4", "--eta", "0.43+/-12%"]
REST = ["--efficiency", "0.127±0.0127", "--energy-keV", "59.5"]


def test_lab_yield(mcrim):
    shown = mcrim.shown("lab", "yield", "--signal", "14.3", "--eta", "0.25", *REST)
    assert "note: --signal and --eta came without an error" in shown
    assert mcrim.shown("lab", "yield", "--signal", "14.3", "--eta", "25%", *REST) == shown
    other = ["--signal", "30±0.4", "--eta", "0.43±12%"]
    assert "DISAGREE" in mcrim.shown("lab", "yield", *AIR, *other, *REST)


@cases("old", "new", "says")
def test_lab_relative_refuses_with_file_and_line(old, new, says, tmp_path, mcrim):
    text = EXAMPLE.read_text()
    assert old in text
    file = tmp_path / "bench.toml"
    file.write_text(text.replace(old, new, 1))
    line = mcrim.refused("lab", "relative", file)
    assert line.startswith(f"mcrim: {file}") and says in line


def test_a_reference_without_a_table_is_refused(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text(EXAMPLE.read_text().split("[reference]")[0])
    refused = refusal(read_comparison, file)
    assert "no table [reference]; write it, with signal, eta" in refused


def test_the_error_that_readings_share_is_not_said_to_be_the_dark_runs_alone():
    """A nonlinearity's error counts under the same origin, and no run in the dark helps there."""
    assert "nonlinearity" in contribution("pedestal", 0.04).by
