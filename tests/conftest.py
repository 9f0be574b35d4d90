"""Claims LLVM before any test imports Mitsuba, and says where the scenes are."""

import os
from pathlib import Path

import pytest
from browser import browser  # noqa: F401  (a fixture for all tests)

import mcrim_mitsuba  # noqa: F401  (must come before mitsuba)

# Tests simulate what they test; those of the cache name a folder of their own.
os.environ["MCRIM_CACHE"] = "off"


@pytest.fixture(scope="session")
def scenes() -> Path:
    return Path(__file__).parents[1] / "scenes"
