"""Refusals in one line, and numbers and texts as people read them."""

import math
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import cases_of

from mcrim_mitsuba.core import rounding
from mcrim_mitsuba.core.errors import InputError, closest, did_you_mean, placed, said_by, visible
from mcrim_mitsuba.core.rounding import pdg, pdg_parts

cases = cases_of(__file__)


def test_a_refusal_is_one_line_with_its_place():
    error = InputError("it is\nwrong", "mend it", path="a.csv", line=3, column="signal")
    assert str(error) == "a.csv, line 3, column signal: it is wrong; mend it"
    assert error.place == "a.csv, line 3, column signal"
    assert InputError("x", "y").place == "" and str(InputError("x", "y")) == "x; y"
    # it comes from other processes, and keeps its parts
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.line, copy.mend) == (str(error), 3, "mend it")


def test_a_refusal_of_a_megabyte_is_cut_and_steers_no_terminal():
    error = InputError("x" * 10**6, "\x1b[31m\u202e" + "y" * 10**6)
    assert len(str(error)) < 4000 and str(error).isprintable()
    assert "<U+001B>" in str(error) and "<U+202E>" in str(error)


def test_refusals_within_get_the_place_of_who_knows_it():
    with pytest.raises(InputError, match=r"^b\.toml, line 2: n_gap: it is wrong; mend it$"):
        with placed("n_gap", path="b.toml", line=2):
            raise InputError("it is wrong", "mend it")
    with pytest.raises(InputError, match=r"^it is wrong, he said; mend it$"):
        with said_by(lambda problem, mend: InputError(f"{problem}, he said", mend)):
            raise InputError("it is wrong", "mend it")
    # what knows its file may keep it
    with pytest.raises(InputError, match=r"^d\.csv: it is wrong; mend it$"):
        with said_by(lambda problem, mend: InputError("he said", mend), placed_too=False):
            raise InputError("it is wrong", "mend it", path="d.csv")
    with pytest.raises(ValueError, match="another"), placed(path="c"):
        raise ValueError("another")


def test_a_misspelt_name_is_guessed_among_those_there_are():
    names = ["gap_mm", "n_gap", "n_window"]
    assert closest("n_gapp", names) == "n_gap"
    assert closest("zzz", names) is None and closest("n_gap" * 100, names) is None
    assert did_you_mean("n_gapp", names) == "did you mean n_gap? Known are: gap_mm, n_gap, n_window"
    # a word of a name is enough
    assert did_you_mean("windwo", names).startswith("did you mean n_window?")
    assert did_you_mean("height", ["top_mm", "crystal_height_mm"]).startswith(
        "did you mean crystal_height_mm?"
    )
    assert did_you_mean("zzz", names) == "known are: gap_mm, n_gap, n_window"
    assert did_you_mean("zzz", []) == "there are no names to choose from"


def test_what_is_invisible_is_shown_as_its_code():
    assert visible("a\tb\u200bη") == "a<U+0009>b<U+200B>η"
    assert visible("a\nb", keep="\n") == "a\nb"
    assert visible("👨\u200d👩") == "👨\u200d👩"  # joiners shape letters and emoji


@cases("value", "sigma", "text", more=[(1.0, None, "1"), (0.252, None, "0.252")])
def test_the_rule_of_the_particle_data_group(value, sigma, text):
    assert pdg(value, sigma) == text


def test_what_rounding_leaves_of_an_error_is_none():
    """Of a beam's flight in air: 3.3531498095175616 ± 0.0000000000000019 ps was shown."""
    assert pdg(3.3531498095175616, 1.9e-15) == "3.353"
    assert pdg(-2.5, 1e-14) == "-2.5"
    assert pdg(0.98, 4.9e-10).endswith(" ± 0.0000000005")


@given(st.floats(-1e9, 1e9), st.floats(1e-3, 1e9))
def test_a_rounded_number_is_within_its_error(value, sigma):
    text, _, power = pdg(value, sigma).replace("(", "").replace(")", "").partition("e")
    rounded, error = (float(part) * 10.0 ** int(power or 0) for part in text.split(" ± "))
    # 355 becomes 400, and digits of floats are 16
    assert abs(rounded - value) <= 0.5 * sigma + 1e-15 * abs(value)
    assert abs(error / sigma - 1) < 0.13


def test_errors_of_several_origins_share_the_last_place():
    assert pdg_parts(7.4872, 0.8, 0.3) == "7.5 ± 0.8 ± 0.3"
    assert pdg_parts(7.4872, 0.8, 0.003) == "7.49 ± 0.80 ± 0.00"
    assert pdg_parts(7.4872, 0.8, 0.0) == "7.5 ± 0.8 ± 0"
    assert pdg_parts(7.5) == "7.5 ± 0"
    for wrong in ((1.0, -0.1), (math.nan, 0.1), (1.0, math.inf)):
        with pytest.raises(ValueError, match="cannot be rounded"):
            pdg_parts(*wrong)


def test_numbers_probabilities_and_per_cents():
    assert [
        rounding.number(v) for v in (0.123456, 1234.5, None, math.nan)
    ] == "0.123 1234 - -".split()
    assert [rounding.p_text(p) for p in (0.334, 1e-120, None)] == ["0.33", "< 1e-99", "-"]
    assert [rounding.p_equals(p) for p in (0.334, 1e-120, None)] == [
        "p = 0.33",
        "p < 1e-99",
        "no p-value",
    ]
    known = {0.005: "0.50 %", 0.1: "10.0 %", 1.0: "100 %", 1e-6: "< 0.01 %", 0.0: "0.0 %"}
    known |= {0.00654: "0.65 %", 0.0995: "9.95 %", 2.5: "250 %", 1e-7: "< 0.01 %"}
    assert {p: rounding.percent(p) for p in known} == known
    assert rounding.percent(0.1234, more=1) == "12.34 %"
    assert [rounding.probability(p) for p in (0.7, 0.003, 1e-5, 0.9999, 0.995, 1.0)] == [
        "70 %",
        "0.3 %",
        "< 0.1 %",
        "> 99.9 %",
        "99.5 %",
        "100 %",
    ]


def test_words_of_sentences():
    assert rounding.capital("eta") == "Eta" and rounding.capital("") == ""
    assert rounding.counted(1, "reading") == "1 reading"
    assert rounding.counted(0, "reading") == "0 readings"
    assert rounding.unbroken("7.5 ± 1.2") == "7.5\xa0±\xa01.2" and rounding.unbroken(3) == 3
    assert [
        rounding.short_text(v) for v in (0.1234567, True, "x", 3)
    ] == "0.123457 true x 3".split()
