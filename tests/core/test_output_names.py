"""Names that outputs may have: as long as the file system allows, and of files, not of folders."""

import pytest
from places import SCENES
from refusals import refusal

from mcrim_mitsuba.core.files import refuse_outputs, write_text

LONGEST_NAME = 255
BENCH, RAW = SCENES / "camoo4.xml", SCENES / "camoo4_raw" / "campaign.toml"


@pytest.mark.parametrize("length", [246, LONGEST_NAME])
def test_a_name_as_long_as_can_be_is_written(here, length):
    name = "a" * (length - len(".csv")) + ".csv"
    refuse_outputs({"--output": name})
    write_text(name, "1\n")
    assert [path.name for path in here.iterdir()] == [name]


def test_a_longer_name_is_told_to_be_shorter(here):
    line = refusal(refuse_outputs, {"--output": "a" * LONGEST_NAME + ".csv"})
    assert line.endswith("cannot be written (File name too long); give it a shorter name")


@pytest.mark.parametrize(
    "words",
    [
        ("table", BENCH, "--alpha-scat", "0.5", "--alpha-abs", "0.039", "-o", "x.csv/"),
        ("simulate", BENCH, "--figure", "x.png/"),
        ("simulate", BENCH, "--json", "x.json/."),
        ("check", BENCH, "-o", "x.png/"),
        ("reduce", RAW, "-o", "x.toml/"),
        ("reduce", RAW, "-o", "."),
    ],
    ids=lambda words: f"{words[0]} {words[-2]} {words[-1]}",
)
def test_the_name_of_a_folder_is_refused_before_the_work(here, mcrim, words):
    assert "names a folder; name a file in it" in mcrim.refused(*words)
    assert not any(here.iterdir())


def test_a_campaign_without_a_name_is_refused(here, mcrim):
    refused = mcrim.refused("reduce", RAW, "-o", "")
    assert "--output cannot write a file without suffix" in refused


@pytest.mark.parametrize(
    "words",
    [
        ("table", BENCH, "--alpha-scat", "0.5", "--unit", "1/2", "--units"),
        ("scenes", "-o"),
        ("paper", "-o"),
        ("add", "gap_bubble", BENCH, "-o", "new.xml", "--effects-folder"),
    ],
    ids=lambda words: words[0],
)
def test_the_empty_name_is_not_the_folder_one_is_in(here, mcrim, words):
    assert "names no folder; give its name; . is the one you are in" in mcrim.refused(*words, "")
    assert not any(here.iterdir())
