"""The page of recipes: every piece works when it is pasted, and gives the η that stands beside it.

    python -m pytest tests/project/test_recipes.py

With fixed seeds; 4 standard deviations in 21 comparisons: a false alarm in 1000.
"""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from lxml import etree
from places import ROOT, SCENES

from mcrim_mitsuba.transport.simulation import Simulation

PAGE = (ROOT / "docs" / "recipes.md").read_text()
PHOTONS = 200_000
#: Of numbers on the page: a million photons.
ON_THE_PAGE = 4e-4


def eta_on_the_page(text: str) -> float:
    return float(re.search(r"η = (0\.\d+)", text)[1])


def recipes() -> list[tuple[str, str, float]]:
    """Kind of a piece (``sh``, or the scene that XML belongs into), the piece, and its η."""
    found = [
        ("sh", line, float(eta))
        for line, eta in re.findall(r"^\| [^|]+ \| `(mcrim [^`]+)` \| (0\.\d+) \|$", PAGE, re.M)
    ]
    pieces = re.split(r"^```(sh|xml)\n(.*?)^```$", PAGE, flags=re.M | re.S)
    for before, kind, piece, after in zip(
        pieces[::3], pieces[1::3], pieces[2::3], pieces[3::3], strict=False
    ):
        scene = re.findall(r"In `(\w+\.xml)`", before)
        found.append((scene[-1] if kind == "xml" else kind, piece, eta_on_the_page(after)))
    return found


def put_into(scene: str, piece: str) -> etree._Element:
    """A scene in which this is, in place of what has the same ids."""
    root = etree.parse(SCENES / scene).getroot()
    known = {one.get("id"): one for one in root if one.get("id")}
    for one in etree.fromstring(f"<piece>{piece}</piece>"):
        if one.get("id") in known:
            root.replace(known[one.get("id")], one)
        else:
            root.append(one)
    return root


@pytest.mark.parametrize(("kind", "piece", "eta"), recipes())
def test_a_recipe_gives_what_the_page_says(tmp_path, monkeypatch, kind, piece, eta):
    monkeypatch.chdir(tmp_path)
    Path("scenes").symlink_to(SCENES)
    overrides: dict[str, float] = {}
    if kind == "sh":
        *before, last = piece.splitlines()
        for line in before:
            run(line)
        command, verb, path, *options = shlex.split(last)
        assert (command, verb) == ("mcrim", "simulate") and options[::2] == ["-D"] * (
            len(options) // 2
        )
        for option in options[1::2]:
            name, value = option.split("=")
            overrides[name] = float(value)
    else:
        path = "recipe.xml"
        Path(path).write_bytes(etree.tostring(put_into(kind, piece)))
    result = Simulation(path, overrides).collect(PHOTONS, seed=1)
    assert abs(result.eta - eta) < 4.0 * (result.eta_sigma**2 + ON_THE_PAGE**2) ** 0.5, result.eta


def run(line: str) -> None:
    """A line of a shell; our own command within this process."""
    if line.startswith("mcrim "):
        from mcrim_mitsuba.cli.main import mcrim

        mcrim.main(shlex.split(line)[1:], standalone_mode=False)
    else:
        subprocess.run(line, shell=True, check=True)


def test_the_page_has_its_recipes():
    assert len(recipes()) == 22
    headings = re.findall(r"^## (.+)$", PAGE, re.M)
    assert headings == [
        "Change the shape",
        "Tilt a face",
        "Grind a face",
        "Change the detector",
        "Add a second mask",
        "Wrap it",
        "Read it with a SiPM",
        "Glue it",
    ]
