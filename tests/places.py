"""Where things lie, for all tests: said once."""

import ctypes
import shutil
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "scenes"
SCRIPTS = ROOT / "scripts"
#: A scene in which nothing is flat.
BALL = ROOT / "tests" / "golden" / "inputs" / "ball.xml"
#: The article's campaign with all that it names.
CAMPAIGN_FILES = ("camoo4_campaign.toml", "camoo4.xml", "camoo4_measured.csv")


def _lacks_libatomic() -> bool:
    """Before the package has made one: of this the loader would say that it is there."""
    try:
        ctypes.CDLL("libatomic.so.1")
    except OSError:
        return sys.platform == "linux"
    return False


#: Of what imports Mitsuba before our own functions.
mitsuba_alone = pytest.mark.skipif(
    _lacks_libatomic(), reason="Mitsuba alone needs libatomic, which this system lacks"
)


def raw_copy(scenes: Path, folder: Path, rows: str) -> Path:
    """A copy of the raw campaign with other rows, and its scene beside it: the campaign's file."""
    shutil.copytree(scenes / "camoo4_raw", folder / "raw")
    shutil.copy(scenes / "camoo4.xml", folder)
    (folder / "raw" / "mountings.csv").write_text(rows)
    return folder / "raw" / "campaign.toml"


def tables_of(file: str) -> dict:
    """What the TOML of a test file's name, beside it, holds."""
    return tomllib.loads(Path(file).with_suffix(".toml").read_text())


def cases_of(file: str) -> Callable:
    """Decorator of the tests of a file whose cases are rows of the TOML of its name, beside it.

    Of ``@cases("text", "says")`` the rows stand there under the test's own name; `more` are those
    that only Python can write.
    """
    tables = tables_of(file)

    def cases(*names: str, more=()):
        def with_cases(test):
            rows = [*tables[test.__name__], *more]
            return pytest.mark.parametrize(names if len(names) > 1 else names[0], rows)(test)

        return with_cases

    return cases
