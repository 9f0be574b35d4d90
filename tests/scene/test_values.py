"""Values of scene parameters from texts: one, a list, or a material's index."""

import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.scene import values
from mcrim_mitsuba.scene.values import (
    MaterialIndex,
    parse_like,
    parse_list,
    parse_value,
    read_index,
)

cases = cases_of(__file__)


@cases("name", "text", "value")
def test_a_value_is_of_the_kind_that_its_text_shows(name, text, value):
    parsed = parse_value(name, text)
    assert parsed == value and type(parsed) is type(value)


@cases("name", "text", "example", "value")
def test_another_value_is_of_the_scene_s_kind(name, text, example, value):
    parsed = parse_like(name, text, example)
    assert parsed == pytest.approx(value, abs=1e-4) and type(parsed) is type(value)


@pytest.mark.parametrize(
    ("reader", "arguments", "says"),
    [
        (parse_value, ("gap_mm", " "), "gap_mm has no value"),
        (parse_value, ("size", "0,5"), "has a decimal comma"),
        (parse_value, ("size", "nan"), "is not a finite number"),
        (parse_like, ("polarization", "yes", True), "is neither true nor false"),
        (parse_like, ("gap_mm", "", 1.0), "gap_mm has no value"),
        (parse_like, ("gap_mm", "wide", 1.0), "is not a finite number"),
    ],
)
def test_what_is_of_no_kind_is_refused(reader, arguments, says):
    refused = refusal(reader, *arguments, path="bench.xml", line=3)
    assert refused.startswith("bench.xml, line 3: ") and says in refused


@cases("element", "attribute", "text", "says")
def test_what_mitsuba_could_not_read_is_refused_in_our_words(element, attribute, text, says):
    assert values.is_readable(element, attribute, text) == (says == "")
    if says:
        refused = refusal(values.refuse_misread, element, attribute, "x", text, path="b.xml")
        assert refused.startswith("b.xml: x") and says in refused
    else:
        values.refuse_misread(element, attribute, "x", text)
        values.refuse_odd_blanks("x", text)


def test_an_index_comes_from_a_material_and_says_so():
    index = read_index("n_gap = 'BK7@540nm'", "BK7@540nm")
    assert isinstance(index, MaterialIndex)
    assert (index.material.name, index.wavelength_nm, index.emission) == ("BK7", 540.0, None)
    assert "at 540 nm, known to" in index.words and "SCHOTT" in index.words
    assert index.group_index > index.value
    assert values.names_material("n_gap", "BK7@540nm") and values.names_material("n_gap", "bk7")
    assert not values.names_material("gap_mm", "BK7@540nm")
    assert values.parse_material("n_gap", "1.5") is None
    assert values.material_at("n_gap", "BK7@540 nm")[1] == 540.0


def test_an_index_over_an_emission(scenes):
    emission = scenes / "camoo4_raw" / "emission.csv"
    index = read_index("n", f"CaMoO4@{emission.name}", emission.parent)
    at = read_index("n", "CaMoO4@540nm")
    assert index.emission == emission and index.value == pytest.approx(at.value, abs=0.02)
    assert f"over the emission of {emission.name}, mean of all directions" in index.words
    assert index.group_index == pytest.approx(at.group_index, abs=0.05)


@cases("text", "says")
def test_a_material_that_says_no_index_is_refused(text, says):
    refused = refusal(read_index, f"n_gap = '{text}'", text, path="bench.xml", line=3)
    assert refused.startswith("bench.xml, line 3: ") and says in refused


@cases("text", "numbers")
def test_lists(text, numbers):
    assert parse_list("--n-gap", text, "n_gap") == pytest.approx(numbers, rel=1e-4)


@cases("text", "says")
def test_lists_that_are_none(text, says):
    assert says in refusal(parse_list, "--x", text, "gap_mm")


def test_what_a_comma_was_taken_for_is_told():
    assert values.told_of_comma("--x", "1,5") == [
        "--x = 1,5 is two values, 1 and 5; for one write 1.5"
    ]
    assert values.told_of_comma("--x", "0.1,0.5") == values.told_of_comma("--x", None) == []
    assert "write 5.1 for one, 5;1 for two" in refusal(values.told_of_comma, "--x", "5,1")


def test_a_table_that_would_never_be_done_is_refused():
    values.refuse_many_points(values.MOST_POINTS)
    refused = refusal(values.refuse_many_points, values.MOST_POINTS + 1)
    assert refused.startswith("1,000,001 points are asked for, 1,000,000 are the most")
