"""What is written is read as it was, whatever it is: properties that hold for any input."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measured import read_measurements
from places import SCENES

from mcrim_mitsuba import effects
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import campaign_with_effects, plain_texts
from mcrim_mitsuba.campaign.measurements import Measurements, Reading
from mcrim_mitsuba.campaign.reduction import RawData
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import LARGEST, SMALLEST, value_text
from mcrim_mitsuba.runs import cache_files as chunk_file
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.values import parse_like, parse_list, parse_value

#: The same examples every time, and no more than the suite has time for.
KEPT = settings(derandomize=True, deadline=None, max_examples=40, database=None)
SLOW = settings(KEPT, max_examples=15)

sizes = st.floats(min_value=SMALLEST, max_value=LARGEST)
numbers = st.one_of(st.just(0.0), sizes, sizes.map(lambda x: -x))
#: What a cell of a file can hold: no line ends, no half characters.
words = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\n\r\0"), max_size=30)
names = words.map(str.strip).filter(lambda text: text and text[0] not in "=@+-")
BENCH = read_scene(SCENES / "camoo4.xml")
EFFECTS = {n: e for n, e in effects.catalogue().items() if e.edit is not None and e.acts_in(BENCH)}


@pytest.fixture(scope="module")
def campaign():
    return read_campaign(SCENES / "camoo4_misfit.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("properties")


@KEPT
@given(numbers)
def test_a_number_is_read_as_it_was_written(number):
    assert parse_value("gap_mm", value_text(number)) == number
    assert parse_like("x", value_text(number), 1.5) == number


@KEPT
@given(st.integers(-(10**17), 10**17), st.booleans())
def test_whole_numbers_and_truth_keep_their_kind(whole, truth):
    assert parse_value("x", value_text(whole)) == whole
    assert type(parse_value("x", value_text(whole))) is int
    assert parse_value("x", value_text(truth)) is truth


@KEPT
@given(st.lists(numbers, min_size=1, max_size=20))
def test_a_list_is_read_as_it_was_written(values):
    assert parse_list("--n-gap", ",".join(map(value_text, values))) == values


@KEPT
@given(names, words, st.one_of(st.none(), st.integers(1, 10**6)), st.one_of(st.none(), words))
def test_a_refusal_is_one_line_that_steers_no_terminal(problem, mend, line, path):
    said = str(InputError(problem, mend, path=path, line=line))
    assert said and said.isprintable()


@KEPT
@given(
    st.lists(
        st.tuples(names, sizes, sizes, st.booleans(), st.floats(1.0, 3.0)),
        min_size=1,
        max_size=5,
        unique_by=lambda row: row[0],
    )
)
def test_a_measurement_file_is_read_as_it_was_written(campaign, folder, rows):
    readings = tuple(
        Reading(
            label,
            float(f"{signal:.6g}"),
            float(f"{sigma:.6g}"),
            {"n_gap": n},
            use=use and sigma <= signal,
            line=line,
        )
        for line, (label, signal, sigma, use, n) in enumerate(rows)
    )
    readings = (*readings, Reading("in use, surely", 1.0, 0.1, {"n_gap": 1.5}))
    written = Measurements(folder / "old.csv", (), ("n_gap",), readings)
    raw = RawData({}, None, None, None, material=None, numbers={}, files=())
    before = dataclasses.replace(campaign, measurements=written, raw=raw)
    _, text = plain_texts(before, folder / "new.toml", folder / "new.csv")
    (folder / "new.csv").write_bytes(text.encode())
    read = read_measurements(folder / "new.csv", {"n_gap": 1.0}).readings
    assert [dataclasses.replace(each, line=0) for each in read] == [
        dataclasses.replace(each, line=0) for each in readings
    ]


@SLOW
@given(st.sampled_from(sorted(EFFECTS)), st.data())
def test_an_effect_put_into_a_scene_has_the_values_that_were_given(campaign, folder, name, data):
    scene = read_scene(campaign.scene.path)
    given_values = {}
    for parameter in EFFECTS[name].parameters:
        _, low, high = (round(each, 12) for each in parameter.range_in(scene.parameters))
        given_values[parameter.name] = data.draw(st.floats(low, high).filter(_is_a_quantity))
    added = scene.edited(effects.add(name, scene, given_values)).parameters
    assert {each: added[each] for each in given_values} == given_values
    others = scene.parameters.keys() - given_values.keys() - {"polarization"}
    assert all(added[each] == scene.parameters[each] for each in others)


def _is_a_quantity(value):
    return value == 0 or abs(value) >= SMALLEST


@SLOW
@given(st.lists(sizes, min_size=4, max_size=4))
def test_a_campaign_with_more_effects_is_read_with_their_starts(campaign, folder, starts):
    chosen = ("background", "nonlinearity")
    mended = campaign.with_effects(chosen)
    known = mended.parameters
    inside = {
        name: min(max(start, known[name].minimum), known[name].maximum)
        for name, start in zip(known, starts, strict=False)
    }
    target = folder / "next.toml"
    target.write_text(campaign_with_effects(mended, target, campaign.scene.path, inside))
    read = read_campaign(target)
    assert read.effects == chosen
    for name, start in inside.items():
        assert read.parameters[name].start == pytest.approx(start, rel=1e-5)


kept_arrays = st.dictionaries(
    st.text(max_size=5),
    st.tuples(
        st.sampled_from(["?", "|i1", "<u2", ">i4", "<i8", "<f4", ">f8", "<c16"]),
        st.binary(max_size=64),
    ).map(lambda given: np.frombuffer(given[1][: len(given[1]) // 16 * 16], given[0])),
    max_size=3,
)


KEY = {"seed": 7}


def _file_of(arrays, metadata):
    return np.frombuffer(b"".join(chunk_file.encode(KEY, 7, arrays, metadata)), np.uint8)


@KEPT
@given(kept_arrays, st.dictionaries(st.text(max_size=5), st.integers() | words, max_size=3))
def test_records_come_back_as_they_were_kept(arrays, metadata):
    chunk = chunk_file.decode(_file_of(arrays, metadata), KEY, 7)
    assert chunk is not None and chunk.metadata == metadata
    assert list(chunk.arrays) == list(arrays)
    for name, array in arrays.items():
        assert chunk.arrays[name].dtype == array.dtype
        assert chunk.arrays[name].tobytes() == array.tobytes()


@KEPT
@given(kept_arrays, st.data())
def test_one_changed_bit_or_a_lost_end_is_no_record(arrays, data):
    content = _file_of(arrays, {"photons": 5})
    changed = content.copy()
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    changed[bit // 8] ^= 1 << bit % 8
    assert chunk_file.decode(changed, KEY, 7) is None
    end = data.draw(st.integers(0, len(content) - 1))
    assert chunk_file.decode(content[:end], KEY, 7) is None
