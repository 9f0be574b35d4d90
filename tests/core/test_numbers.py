"""Numbers as people type them, and what a parameter's value may be."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.core import numbers
from mcrim_mitsuba.core.numbers import judge, number_of, parse_number, value_text, whole_of

cases = cases_of(__file__)


@cases("name", "unit", "words", "title")
def test_the_unit_of_a_parameter_is_the_end_of_its_name(name, unit, words, title):
    assert numbers.unit_of(name) == (unit or None)
    assert numbers.without_unit(name) == words
    assert numbers.titled(name) == title


@cases("parameters", "told")
def test_what_is_hardly_meant_is_doubted(parameters, told):
    doubts = dict(numbers.doubts(parameters))
    assert doubts == ({next(iter(parameters)): told} if told else {})


def test_values_in_words():
    assert numbers.said("gap_mm", 0.05) == "gap 0.05 mm"
    assert numbers.said("polarization", np.bool_(False)) == "polarization off"
    assert numbers.said("beam_axis", "x") == "beam axis x"


@pytest.mark.parametrize("text", ["1.46", " 1.46 ", "+146e-2", "1460E-3"])
def test_a_number_is_read_with_blanks_signs_and_powers(text):
    assert parse_number("n_gap", text) == 1.46


@cases("text", "says")
def test_what_is_no_number_is_refused_with_its_mend(text, says):
    assert says in refusal(parse_number, "gap_mm", text)


def test_a_refusal_has_the_place_and_says_where_the_text_was_given():
    refused = refusal(parse_number, "n_gap", "gel", path="bench.xml", line=3, column="value")
    assert refused.startswith("bench.xml, line 3, column value: n_gap = 'gel' is not a finite")
    # an index may be a material's
    assert "or a material at a wavelength, such as glycerol@540nm" in refused
    given = refusal(parse_number, "n_gap", "gel", given=True)
    assert given.startswith("the value given for n_gap, 'gel', is not a finite number")
    assert numbers.as_said("n_gap", "gel", False) == "n_gap = 'gel'"
    numbers.refuse_decimal_comma("n_gap", "1.5")
    assert "decimal comma" in refusal(numbers.refuse_decimal_comma, "n_gap", "1,5")


@pytest.mark.parametrize(
    ("value", "number"),
    [
        (3, 3),
        ("3", 3),
        ("1e3", 1000.0),
        (np.float32(0.5), 0.5),
        (np.array(7), 7),
        (Fraction(1, 4), 0.25),
        (Decimal("2.5"), 2.5),
    ],
)
def test_numbers_of_any_kind_are_taken(value, number):
    taken = number_of("the seed", value, "give one")
    assert taken == number and type(taken) is type(number)


@pytest.mark.parametrize("value", [True, None, 1j, np.array([1, 2]), math.nan, 1e99, [3]])
def test_what_is_no_number_of_any_kind_is_refused(value):
    assert refusal(number_of, "the seed", value, "give 0 or more").startswith("the seed is ")


def test_whole_numbers_have_limits():
    assert whole_of("photons", 1e6, "give more", 1) == 1_000_000
    assert whole_of("photons", "12", "give more", 1, 12) == 12
    for value in (0, 13, 2.5, "2.5"):
        assert refusal(whole_of, "photons", value, "give 1 to 12", 1, 12).endswith("give 1 to 12")


@pytest.mark.parametrize("value", [0.1, 1e-7, 1 / 3, 5e-324, 12345678.9])
def test_a_value_s_text_loses_no_digit(value):
    assert float(value_text(value)) == value and float(value_text(np.float64(value))) == value


def test_texts_of_values_are_those_of_scenes():
    assert [value_text(v) for v in (True, np.False_, np.int64(3), "x")] == "true false 3 x".split()


@cases("name", "value", "kind", "says")
def test_a_value_in_another_unit_or_out_of_range_is_told(name, value, kind, says):
    wrong = judge(name, value)
    assert wrong is not None and wrong[0] == kind and wrong[2] == says


@cases("name", "value")
def test_usual_values_are_not_judged(name, value):
    assert judge(name, value) is None
