"""Input that means harm or is broken: every one is refused in one line, or does no harm."""

import hashlib
import json
import os
import re
import shutil

import numpy as np
import pytest
import tomlkit
from convert_results import read_results, write_table
from fuzz import __main__ as fuzz
from fuzz.mutation import mutate
from fuzz.targets import TARGETS, Target, attempt, place_of, workplace
from measured import read_measurements
from places import cases_of
from refusals import refusal

from mcrim_mitsuba import effects
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import campaign_with_effects
from mcrim_mitsuba.cli.options import WithError
from mcrim_mitsuba.cli.terminal import run
from mcrim_mitsuba.core import files as reading
from mcrim_mitsuba.core.data_table import read_data_table
from mcrim_mitsuba.core.files import refuse_outputs, write_text
from mcrim_mitsuba.core.toml_document import read_toml
from mcrim_mitsuba.laboratory.error_budget import Uncertain
from mcrim_mitsuba.laboratory.light_yield import light_yield_ph_per_keV
from mcrim_mitsuba.runs import cache_files as chunk_file
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.values import parse_list, parse_value

cases = cases_of(__file__)

HEAD, TAIL = '<scene version="3.0.0">', "</scene>"


def scene(folder, text):
    path = folder / "scene.xml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


ATTRIBUTES = " ".join(f'b{i}="1"' for i in range(30_000))


def laughs(tag):
    entities = "".join(f'<!ENTITY l{i + 1} "{f"&l{i};" * 10}">' for i in range(9))
    return f'<!DOCTYPE s [<!ENTITY l0 "lol">{entities}]>{HEAD}{tag}{TAIL}'


def parameters_in_parameters():
    rows = [f'<default name="a{i + 1}" value="{f"$a{i} " * 10}"/>' for i in range(9)]
    return f'{HEAD}<default name="a0" value="ha"/>{"".join(rows)}<f v="$a9"/>{TAIL}'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (laughs("&l9;"), "line 1"),
        (f'<!DOCTYPE s [<!ENTITY x SYSTEM "file:///etc/passwd">]>{HEAD}&x;{TAIL}', "DTD"),
        (
            f'<!DOCTYPE s [<!ENTITY x SYSTEM "file:///etc/passwd">]>{HEAD}<a b="&x;"/>{TAIL}',
            "external entity 'x'",
        ),
        (f'<!DOCTYPE s SYSTEM "http://127.0.0.1:9/x.dtd">{HEAD}{TAIL}', "DTD"),
        (f'<!DOCTYPE s [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>{HEAD}{TAIL}', "DTD"),
        (parameters_in_parameters(), "parameters stand at more than 50,000 places"),
        (f'{HEAD}<default name="a" value="1"/><f v="{"$a" * 2_000_000}"/>{TAIL}', "50,000 places"),
        (f"{HEAD}{'<a>' * 90_000}{'</a>' * 90_000}{TAIL}", "Excessive depth"),
        (f"{HEAD}{'<a>' * 200}{'</a>' * 200}{TAIL}", "more than 50 deep"),
        (f"{HEAD}{'<a/>' * 900_000}{TAIL}", "more than 200,000 tags"),
        (f"{HEAD}{'<a/>' * 60_000}{TAIL}", "more than 50,000 elements"),
        (f"{HEAD}<a {ATTRIBUTES}/>{TAIL}", "100 attributes"),
        (f'{HEAD}<f v="${"x" * 4_000_000}"/>{TAIL}', "is not declared above this line"),
        (f'{HEAD}<default name="n_a" value="{"A" * 1_000_000}@540nm"/>{TAIL}', "AAA … AAA"),
        (f'{HEAD}<default name="a" value="{"9" * 5000}"/><f v="$a"/>{TAIL}', "not a finite number"),
        (f'{HEAD}<default name="a_mm" value="4.9e-324"/><f v="$a_mm"/>{TAIL}', "too small"),
        (f'{HEAD}<default name="a_mm" value="1e300"/><f v="$a_mm"/>{TAIL}', "too large"),
        (f'{HEAD}<default name="a_mm" value="１２"/><f v="$a_mm"/>{TAIL}', "not a finite number"),
        (f"{HEAD}\0{TAIL}", "line 1"),
        (f'{HEAD}<include filename="/etc/passwd"/>{TAIL}', "outside the scene's folder"),
        (f'{HEAD}<include filename="../scene.xml"/>{TAIL}', "outside the scene's folder"),
        (f'{HEAD}<include filename="away.xml"/>{TAIL}', "outside the scene's folder"),
        (f'{HEAD}<include filename="circle.xml"/>{TAIL}', "does not exist"),
        (f'{HEAD}<include filename="scene.xml"/>{TAIL}', "includes itself"),
        (f'{HEAD}<include filename="twice0.xml"/>{TAIL}', "more than 100 files"),
        (f'{HEAD}<include filename="long0.xml"/>{TAIL}', "8 one in another"),
        (f'{HEAD}<default name="n_a" value="BK7@pipe"/>{TAIL}', "nobody writes into this pipe"),
        (f'{HEAD}<default name="n_a" value="BK7@/dev/zero"/>{TAIL}', "larger than 10 MB"),
    ],
)
def test_scenes_that_would_grow_wander_off_or_hang(tmp_path, monkeypatch, text, said):
    monkeypatch.setattr(reading, "PATIENCE_S", 0.05)
    (tmp_path / "away.xml").symlink_to("/etc/passwd")
    (tmp_path / "circle.xml").symlink_to("circle.xml")
    os.mkfifo(tmp_path / "pipe")
    for name, copies in (("twice", 2), ("long", 1)):
        for i in range(20):
            inner = f'<include filename="{name}{i + 1}.xml"/>' * copies
            # eight deep is allowed: two of each at every level are 255 files
            inner = inner if name == "long" or i < 7 else ""
            (tmp_path / f"{name}{i}.xml").write_text(f"{HEAD}{inner}{TAIL}")
    assert said in refusal(read_scene, scene(tmp_path, text))


@pytest.mark.parametrize(
    "name", ["pipe", "/dev/zero", "/dev/null", "folder", "circle", "a\0b", "a" * 300, "gone"]
)
@pytest.mark.parametrize(
    "reader",
    [
        read_scene,
        read_measurements,
        read_data_table,
        read_campaign,
        lambda path: read_results([path]),
    ],
)
def test_what_is_no_file_hangs_nobody(tmp_path, monkeypatch, reader, name):
    monkeypatch.setattr(reading, "PATIENCE_S", 0.05)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "folder").mkdir()
    refusal(reader, tmp_path / name)


def test_a_pipe_with_a_writer_is_read(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(pipe, os.O_WRONLY)
    os.write(writer, b"label,signal,sigma\nair,14.3,0.2\n")
    os.close(writer)
    try:
        assert read_measurements(f"/dev/fd/{reader}").readings[0].label == "air"
    finally:
        os.close(reader)


def test_a_pipe_whose_writer_says_nothing_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "PATIENCE_S", 0.05)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    ends = [os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), os.open(pipe, os.O_WRONLY)]
    try:
        assert "nothing came through it" in refusal(read_measurements, pipe)
    finally:
        for end in ends:
            os.close(end)


def test_a_scene_does_not_read_what_it_names_whole(tmp_path):
    (tmp_path / "sparse").touch()
    os.truncate(tmp_path / "sparse", 5_000_000_000)
    named = '<shape type="ply"><string name="filename" value="{}"/></shape>'
    huge = read_scene(scene(tmp_path, HEAD + named.format("sparse") + TAIL))
    assert "larger than 1000 MB" in refusal(lambda: huge.content_hash)
    for name in ("/dev/zero", "a" * 5000):
        assert read_scene(scene(tmp_path, HEAD + named.format(name) + TAIL)).content_hash


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"a = {'[' * 100_000}", "line 1: tables or lists are nested more than 20 deep"),
        (f"\na = {'{a=' * 50_000}", "line 2: tables or lists"),
        (f"x = 1\na{'.a' * 400_000} = 1", "line 2: tables or lists"),
        (f"[{'a.' * 30}a]\nx = 1", "line 1: tables or lists"),
        (f"b = {'[' * 30}{']' * 30}", "line 1: tables or lists"),
        (f"b = 1\na = {'9' * 5000}", "line 2: a whole number has thousands of digits"),
        (f"a = 0x{'f' * 5000}", "line 1: a is a whole number of more than 64 bits"),
        ("a = 1\na = 2", "line 2"),
        ("a = 1979-13-45", "line 1"),
        ('a = "\x1b[31m"', "line 1"),
        ('a = "\0"', "line 1: not a text file"),
    ],
)
def test_toml_that_breaks_its_parser(tmp_path, text, said):
    path = tmp_path / "campaign.toml"
    path.write_text(text)
    assert said in refusal(read_toml, path)


def test_campaigns_that_name_what_is_no_such_file(scenes, tmp_path):
    for name in ("camoo4.xml", "camoo4_measured.csv"):
        shutil.copy(scenes / name, tmp_path)
    path, text = tmp_path / "campaign.toml", (scenes / "camoo4_campaign.toml").read_text()
    path.write_text(text.replace('"camoo4.xml"', '"/dev/zero"'))
    assert "larger than 5 MB" in refusal(read_campaign, path)
    path.write_text(text.replace('"camoo4_measured.csv"', '"/etc/passwd"'))
    assert "there is no column label" in refusal(read_campaign, path)
    path.write_text(f'effects_folder = "."\n{text}')
    assert "there is no effect in this folder" in refusal(read_campaign, path)


CSV = "label,signal,sigma\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CSV + "".join(f"r{i},1,1\n" for i in range(300_000)), "line 10002: more than 10,000"),
        (f"label,signal,sigma{',x' * 2_000_000}\n", "line 1: more than 1,000 columns"),
        (f"{CSV}{'a' * 9_000_000},1,1\n", "line 2: not a CSV line"),
        (f"{CSV}a,1,1{',' * 9_000_000}\n", "line 2: 9000003 cells under 3 columns"),
        ("label,signl,sigma\na,1,1\n", "is it signl? Then write signal"),
        ("label,signal,error\na,1,1\n", "no column sigma; is it error? Then write sigma"),
        ("label,hist\na,a.csv\n", "no column signal; is it hist? Then write histogram"),
        (f'{CSV}"a,1,1\n', "line 2: not a CSV line"),
        (f"{CSV}a\0b,1,1\n", "line 2: not a text file (it holds zero bytes)"),
        (f"{CSV}=cmd|' /C calc'!A0,1,1\n", "line 2, column label: spreadsheets would take"),
        (f"{CSV}\x1b[31ma,1,1\n\x1b[31ma,1,1\n", "the label <U+001B>[31ma is on line 2 already"),
        (f"{CSV}\u202ea,1,1\n\u202ea,1,1\n", "the label <U+202E>a is on line 2 already"),
        (f"{CSV}a,{'9' * 1_000_000},1\n", "line 2"),
        (f"{CSV}a,1e300,1\n", "line 2, column signal: signal = '1e300' is too large"),
        (f"{CSV}a,1,1e-300\n", "line 2, column sigma: sigma = '1e-300' is too small"),
        (f"{CSV}a,１,1\n", "line 2, column signal"),
    ],
)
def test_measurement_files_that_are_no_such_thing(tmp_path, text, said):
    path = tmp_path / "measured.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert said in refusal(read_measurements, path)


@pytest.mark.parametrize(
    "reader",
    [
        lambda: parse_list("--n-gap", f"1:2:{'9' * 5000}"),
        lambda: parse_list("--n-gap", "1:2:٣"),
        lambda: parse_list("--n-gap", "1e308:-1e308:5"),
        lambda: parse_value("x", "9" * 5000),
        lambda: WithError().convert("1e200±1e199", type("O", (), {"opts": ["--eta"]}), None),
    ],
)
def test_numbers_on_the_command_line(reader):
    refusal(reader)


def test_results_that_overflow_are_refused():
    tiny = Uncertain(1e-150)
    assert "the result is inf" in refusal(
        light_yield_ph_per_keV, Uncertain(1e200), tiny, tiny, tiny
    )


def test_whole_numbers_beyond_64_bits_are_floats():
    assert parse_value("x", "9" * 30) == 1e30


KEY = {"seed": 1}
GOOD = {"key": KEY, "number": 0, "metadata": {}, "arrays": {}}


def chunk_of(header, data=b"", **numbers):
    """A file of the cache whose digest is right, whatever else is not."""
    text = (header if isinstance(header, str) else json.dumps(header)).encode("utf-8")
    text += b" " * (-(40 + len(text)) % 64)
    length = numbers.get("length", len(text)).to_bytes(8, "little")
    body = length + text + data
    return hashlib.sha256(body).digest() + body


def an_array(dtype="<f8", length=8):
    return {**GOOD, "arrays": {"a": [dtype, length]}}


def test_a_file_of_the_cache_is_what_was_written_or_nothing():
    def read(content):
        return chunk_file.decode(np.frombuffer(content, np.uint8), KEY, 0)

    data = np.arange(8.0).tobytes()
    assert read(chunk_of(GOOD)).arrays == {}
    assert list(read(chunk_of(an_array(), data)).arrays["a"]) == list(range(8))
    for header in (
        "[]",
        "null",
        "1",
        "{",
        "\x80",
        "[" * 50_000,
        "NaN",
        '"a"',
        {},
        {**GOOD, "key": 1},
        {**GOOD, "number": 1},
        {**GOOD, "metadata": []},
        {**GOOD, "arrays": {}},
        {**GOOD, "arrays": [1]},
        {**GOOD, "arrays": {"a": 1}},
        {**GOOD, "arrays": {"a": []}},
        {**an_array(), "more": 1},
        json.dumps(an_array()).replace('"a"', "null"),
        json.dumps(an_array()) + " " * 64,
        an_array(length=9),
        an_array(length=-8),
        an_array(length=-1),
        an_array(length=7),
        an_array(length=2**70),
        an_array(length=8.0),
        an_array(length="8"),
        an_array("|O"),
        an_array("<M8[s]"),
        an_array("|V8"),
        an_array("<U2"),
        an_array("f8,f8"),
        an_array("f8"),
        an_array("nonsense"),
        an_array(8),
    ):
        assert read(chunk_of(header, data)) is None, header
    assert read(chunk_of(an_array(), data + bytes(64))) is None
    assert read(chunk_of(an_array(), data[:-1])) is None
    assert read(chunk_of(GOOD, length=2**63)) is None
    assert read(chunk_of(GOOD, length=0)) is None
    older = b"mcrim records 1\n" + chunk_of(GOOD)
    assert read(older) is None and read(b"") is None and read(older[:20]) is None


CALIBRATED = {
    "chi2": 1.0,
    "ndf": 1,
    "p_value": 0.3,
    "rows": [],
    "fixed": {},
    "parameters": {"scale": {"value": 57.0, "sigma": 2.0}},
}


@cases(
    "old",
    "new",
    "said",
    more=[
        ("57.0", "9" * 400, "parameters.scale.value: a whole number of more than 64 bits"),
        ("57.0", "9" * 5000, "nested too deeply or too long"),
        ("57.0", "[" * 100_000, "nested too deeply or too long"),
    ],
)
def test_results_that_no_command_wrote(tmp_path, old, new, said):
    path = tmp_path / "result.json"
    path.write_text(json.dumps(CALIBRATED).replace(old, new))
    assert said in refusal(read_results, [path])


def test_results_of_a_later_version_are_read_as_far_as_they_are_known(tmp_path):
    path = tmp_path / "result.json"
    path.write_text(json.dumps({**CALIBRATED, "schema": 99, "posterior": {"a": [1, 2]}}))
    assert read_results([path]).rows[0]["scale"] == 57.0


def test_names_and_numbers_that_netcdf_cannot_hold(tmp_path):
    path, target = tmp_path / "result.json", tmp_path / "result.nc"
    path.write_text(json.dumps(CALIBRATED).replace("scale", "ש"))
    assert "cannot hold the name" in refusal(write_table, read_results([path]), target)
    # a comment's name becomes that of an attribute (found by the fuzzer)
    table = tmp_path / "table.csv"
    columns = "n_gap,alpha_abs_per_cm,alpha_scat_per_cm,eta,eta_sigma"
    table.write_text(f"# see\uff11\uff12d: 1.5\n{columns}\n1,1,1,0.25,0.01\n")
    assert "cannot hold the name" in refusal(write_table, read_results([table]), target)
    row = {
        "n_gap": 2**31,
        "alpha_abs_per_cm": 0,
        "alpha_scat_per_cm": 1,
        "eta": 0.2,
        "eta_sigma": 0.01,
    }
    path.write_text(json.dumps({"scene_hash": "ab", "rows": [row]}))
    write_table(read_results([path]), target)
    assert target.stat().st_size > 0


def test_scenes_that_cannot_be_edited(scenes, tmp_path):
    text = (scenes / "camoo4.xml").read_text()
    odd = read_scene(scene(tmp_path, text.replace("</scene>", "<scale１/></scene>")))
    # an element that no scene has is the check's to refuse, and stays as it is
    assert "<scale１/></scene>" in effects.add("edge_chamfer", odd)
    still = re.sub(r'<rotate x="1"', '<rotate x="0"', text)
    for turned in (
        still,
        text.replace('angle="90"', 'angle="nan"'),
        text.replace('<scale value="0.5"/>', '<scale value="1e60"/>' * 9),
    ):
        broken = read_scene(scene(tmp_path, turned))
        assert "no rectangular face" in refusal(effects.add, "gap_bubble", broken)


def test_a_campaign_whose_tables_are_scattered_goes_on(scenes, tmp_path):
    for name in ("camoo4.xml", "camoo4_misfit.csv"):
        (tmp_path / name).write_bytes((scenes / name).read_bytes())
    path, target = tmp_path / "campaign.toml", tmp_path / "next.toml"
    path.write_text(
        (scenes / "camoo4_misfit.toml").read_text() + "[parameters.scale]\nstart = 100.0\n"
    )
    campaign = read_campaign(path).with_effects(["background"])
    starts = {"scale": 50.0, "background": 0.25}
    text = campaign_with_effects(campaign, target, campaign.scene.path, starts)
    target.write_text(text)
    read = read_campaign(target)
    assert (read.scale.start, read.parameters["background"].start) == (50.0, 0.25)


def test_a_campaign_in_which_nothing_can_be_put_is_refused(scenes, tmp_path, monkeypatch):
    campaign = read_campaign(scenes / "camoo4_misfit.toml")
    monkeypatch.setattr(tomlkit, "dumps", lambda document: "scene = ")
    arguments = (campaign, tmp_path / "next.toml", campaign.scene.path, {})
    assert "laid out so that nothing can be added" in refusal(campaign_with_effects, *arguments)


@cases("name", "said")
def test_places_where_nothing_can_be_written(tmp_path, monkeypatch, name, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    os.mkfifo("pipe")
    before = sorted(tmp_path.rglob("*"))

    def write():
        refuse_outputs({"--json": name})
        write_text(name, "{}" * 100_000)

    assert said in refusal(write)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folders_without_permission(tmp_path):
    tmp_path.chmod(0o555)
    assert "permission" in refusal(refuse_outputs, {"--json": str(tmp_path / "a.json")}).lower()


def test_links_that_lead_nowhere_become_files(tmp_path):
    (tmp_path / "link.json").symlink_to("nowhere/at/all")
    (tmp_path / "circle.json").symlink_to("circle.json")
    for name in ("link.json", "circle.json"):
        refuse_outputs({"--json": str(tmp_path / name)})
        write_text(tmp_path / name, "{}")
        assert (tmp_path / name).read_text() == "{}"


def test_labels_do_not_steer_the_terminal(mcrim):
    label = "\x1b[31mred\u202e\x07"
    said = mcrim(
        *"lab yield --signal 14±1 --eta 0.3±0.01 --label".split(),
        label,
        *"--signal 15±1 --eta 0.3±0.01 --label b --efficiency 0.1±0.01 --energy-keV 59".split(),
    )
    assert said.status == 0 and "<U+001B>[31mred<U+202E>" in said.out
    assert not {"\x1b", "\u202e", "\x07"} & {*said.out, *said.err}
    for line in (["peak", f"{label}.csv"], ["efficiency", "a", "b", label], ["peak", f"--{label}"]):
        mcrim.refused("lab", *line)


#: Rounds of changed inputs, and the readers that answer at once.
ROUNDS, QUICK = (
    4,
    (
        "scene measurements campaign raw_campaign table spectrum histogram relative chunk results"
    ).split(),
)


@pytest.mark.parametrize("name", TARGETS)
def test_every_reader_that_is_fuzzed_takes_its_sound_inputs(name):
    """And some changed ones: scripts/fuzz goes on from here."""
    target = TARGETS[name]
    seeds = target.seeds if name != "adding" else target.seeds[:3]
    changed = range(ROUNDS if name in QUICK else 1)
    size = round(1.2 * max(map(len, seeds)))
    with workplace():
        for number, seed in enumerate(seeds):
            assert attempt(target, seed) is None
            for round_ in changed:
                data = mutate(seed, size, 100 * number + round_, target.words)
                error = attempt(target, data)
                assert error is None, (name, number, round_, repr(error))


def test_fuzzing_finds_what_is_planted():
    def broken(data):
        if data == b"overflow":
            np.float64(1e300) ** 2
        return 1 / len(data)

    target = Target(broken, (), ())
    assert attempt(target, b"sound") is None
    assert "ZeroDivisionError at test_hostile.py" in place_of(attempt(target, b""))
    assert "RuntimeWarning" in place_of(attempt(target, b"overflow"))
    assert set(fuzz.NAMES) == set(TARGETS)


def test_fuzzing_gives_a_reader_one_input_again(tmp_path, capsys):
    file = tmp_path / "input"
    file.write_bytes(TARGETS["relative"].seeds[0])
    line = ["--target", "relative", "--again", str(file)]
    assert run(fuzz.main, "fuzz", line) == 0
    assert "read, or refused in one line" in capsys.readouterr().out
    assert run(fuzz.main, "fuzz", line[2:]) == 2
