"""Claims LLVM before any test imports Mitsuba, and says where the scenes are."""

from pathlib import Path

import mcrim_mitsuba  # noqa: F401  (must come before mitsuba)
import pytest


@pytest.fixture(scope="session")
def scenes() -> Path:
    return Path(__file__).parents[1] / "scenes"
