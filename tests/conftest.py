"""Claims LLVM before any test imports Mitsuba, says where the scenes are, shares the processors."""

import fcntl
import os
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from browser import browser  # noqa: F401  (a fixture for all tests)
from places import SCENES

import mcrim_mitsuba  # noqa: F401  (must come before mitsuba)

# Tests simulate what they test; those of the cache name a folder of their own.
os.environ["MCRIM_CACHE"] = "off"


@pytest.fixture(scope="session")
def scenes() -> Path:
    return SCENES


@pytest.fixture(scope="session")
def shared_cache(tmp_path_factory) -> Path:
    """A record cache for tests that diagnose the misfit's bench: one simulates it for all.

    They lie in several processes, whose temporary folders stand side by side.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return folder / "records"


def pytest_collection_modifyitems(items):
    """Tests that run alone come first, when nobody has to end before they can begin."""
    items.sort(key=lambda item: item.get_closest_marker("alone") is None)


@contextmanager
def locked(path: Path, how: int):
    """Hold the operating system's lock on a file or folder of ours; others wait."""
    file = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(file, how)
        yield
    finally:
        os.close(file)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Run a test that is marked ``alone`` while no other process runs one, and others together.

    Tests run in several processes, and one that measures time would measure its neighbours.
    """
    how = fcntl.LOCK_EX if item.get_closest_marker("alone") else fcntl.LOCK_SH
    with ExitStack() as room:
        # who waits to be alone holds the door, so that nobody overtakes it
        with locked(Path(__file__).parent, fcntl.LOCK_EX):
            room.enter_context(locked(Path(__file__), how))
        return (yield)
