"""Claims LLVM before any test imports Mitsuba, and says where the scenes are."""

from pathlib import Path

import pytest

import mcrim_mitsuba  # noqa: F401  (must come before mitsuba)


@pytest.fixture(scope="session")
def scenes() -> Path:
    return Path(__file__).parents[1] / "scenes"
