"""Numbers as people type them, and what a parameter's value may be."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from refusals import refusal

from mcrim_mitsuba.core import numbers
from mcrim_mitsuba.core.numbers import judge, number_of, parse_number, value_text, whole_of


@pytest.mark.parametrize(
    ("name", "unit", "words", "title"),
    [
        ("gap_mm", "mm", "gap", "gap (mm)"),
        ("alpha_scat_per_cm", "1/cm", "scattering", "scattering (1/cm)"),
        ("light_yield_ph_per_keV", "keV", "light yield ph per", "light yield ph per (keV)"),
        ("acceptance_deg", "degrees", "acceptance", "acceptance (degrees)"),
        ("n_gap", None, "gap index", "gap index"),
        ("polarization", None, "polarization", "polarization"),
    ],
)
def test_the_unit_of_a_parameter_is_the_end_of_its_name(name, unit, words, title):
    assert numbers.unit_of(name) == unit
    assert numbers.without_unit(name) == words
    assert numbers.titled(name) == title


def test_values_in_words():
    assert numbers.said("gap_mm", 0.05) == "gap 0.05 mm"
    assert numbers.said("polarization", np.bool_(False)) == "polarization off"
    assert numbers.said("beam_axis", "x") == "beam axis x"


@pytest.mark.parametrize("text", ["1.46", " 1.46 ", "+146e-2", "1460E-3"])
def test_a_number_is_read_with_blanks_signs_and_powers(text):
    assert parse_number("n_gap", text) == 1.46


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "gap_mm is empty; write a number"),
        ("0,05", "gap_mm = '0,05' has a decimal comma; write a decimal point: 0.05"),
        ("12,5%", "has a decimal comma; write a decimal point: 12.5%"),
        ("0.05 mm", "is not a finite number; write a plain number such as 1.46, without a unit"),
        ("nan", "is not a finite number"),
        ("1_0", "is not a finite number"),
        ("1e999", "is not a finite number"),
        ("-1e61", "is too large for any quantity; give 0, or a number from 1e-60 to 1e+60"),
        ("1e-61", "is too small for any quantity"),
    ],
)
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
    assert [value_text(v) for v in (True, np.False_, np.int64(3), "x")] == [
        "true",
        "false",
        "3",
        "x",
    ]


@pytest.mark.parametrize(
    ("name", "value", "kind", "says"),
    [
        ("gap_mm", 5e-5, "unit", "write it in mm: 0.05"),  # metres
        ("gap_mm", 50.0, "unit", "write it in mm: 0.05"),  # micrometres
        ("crystal_width_mm", 0.01, "unit", "write it in mm: 10"),
        ("crystal_width_mm", 10_000.0, "unit", "write it in mm: 10"),
        ("gap_mm", 0.0, "value", "give it in mm"),
        ("alpha_abs_per_cm", -0.1, "coefficient", "give 0 or more, in 1/cm"),
        ("alpha_abs_per_cm", 3.9e2, "unit", "write it in 1/cm: 3.9"),
        ("n_crystal", 0.9, "index", "give a number from 1 to 4.5"),
        ("n_crystal", 4.6, "index", "give a number from 1 to 4.5"),
        ("top_reflectance", 98.0, "value", "give a fraction, not percent"),
        ("scattering_g", 1.0, "value", "give a number from -0.999 to 0.999"),
    ],
)
def test_a_value_in_another_unit_or_out_of_range_is_told(name, value, kind, says):
    wrong = judge(name, value)
    assert wrong is not None and wrong[0] == kind and wrong[2] == says


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gap_mm", 0.05),
        ("chamfer_mm", 0.0),  # the part is not there
        ("source_depth_mm", 100.0),  # may exceed the crystal
        ("gap_offset_mm", -0.02),
        ("n_gap", 1.0),
        ("alpha_scat_per_cm", 0.0),
        ("anything", -1e9),
    ],
)
def test_usual_values_are_not_judged(name, value):
    assert judge(name, value) is None
