"""Where things lie, for all tests: said once."""

import shutil
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "scenes"
SCRIPTS = ROOT / "scripts"
#: A scene in which nothing is flat.
BALL = ROOT / "tests" / "golden" / "inputs" / "ball.xml"
#: The article's campaign with all that it names.
CAMPAIGN_FILES = ("camoo4_campaign.toml", "camoo4.xml", "camoo4_measured.csv")


def raw_copy(scenes: Path, folder: Path, rows: str) -> Path:
    """A copy of the raw campaign with other rows, and its scene beside it: the campaign's file."""
    shutil.copytree(scenes / "camoo4_raw", folder / "raw")
    shutil.copy(scenes / "camoo4.xml", folder)
    (folder / "raw" / "mountings.csv").write_text(rows)
    return folder / "raw" / "campaign.toml"
