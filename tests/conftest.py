"""What all tests share: commands, folders to work in, a cache of records, and the processors.

Tests lie in folders by room of the package; `project` has what concerns all of it, `scripts` those
of scripts/, and `test_golden.py` holds what commands give. `places`, `refusals`, `comparisons`,
`browser` and benches that cost no simulation (`formula_surfaces`,
`findings_by_hand`) are for all: this folder and scripts/ are on the path.
"""

import fcntl
import gc
import json
import os
import shutil
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

# Before NumPy is imported, here and in all processes that tests start: threads of linear algebra
# that wait for each other beside other tests take ten times the processor's time of one.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Tests share the processors already, and Dr.Jit's threads look for work for a while before they
# sleep: with two each, small simulations took 1.4 times the processor's time.
os.environ.setdefault("PYTHON_CPU_COUNT", "1")

import pytest
from browser import browser, chromium  # noqa: F401  (fixtures for all tests)
from places import CAMPAIGN_FILES, SCENES

from mcrim_mitsuba.cli.main import main
from mcrim_mitsuba.transport.variants import selected_llvm

# Some tests import Dr.Jit themselves, which loads an LLVM then.
selected_llvm()
# While tests are collected there is hardly any garbage, and looking for it took time.
gc.disable()

# Tests simulate what they test; those of the cache name a folder of their own.
os.environ["MCRIM_CACHE"] = "off"
# Stored results are as wide as a pipe is.
os.environ.pop("COLUMNS", None)


@pytest.fixture(scope="session")
def scenes() -> Path:
    return SCENES


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def campaign_here(here) -> str:
    """Name of a copy of the article's campaign in the folder one works in."""
    for name in CAMPAIGN_FILES:
        shutil.copy(SCENES / name, here)
    return CAMPAIGN_FILES[0]


class Said(NamedTuple):
    """What a command said."""

    status: int
    out: str
    err: str


class Command:
    """``mcrim`` as it is typed, without a process of its own."""

    def __init__(self, capsys) -> None:
        self._capsys = capsys

    def __call__(self, *words: object) -> Said:
        self._capsys.readouterr()
        status = main([str(word) for word in words])
        return Said(status, *self._capsys.readouterr())

    def shown(self, *words: object) -> str:
        """Standard output of a command that succeeds."""
        status, out, err = self(*words)
        assert status == 0, err
        return out

    def json(self, *words: object) -> dict:
        """What a command that succeeds gives to programs."""
        return json.loads(self.shown(*words, "--json", "-"))

    def refused(self, *words: object) -> str:
        """The one line of a command that is refused, and shows nothing else."""
        status, out, err = self(*words)
        assert (status, out) == (2, ""), (words, err)
        assert err.count("\n") == 1 and err.strip().isprintable(), (words, err)
        return err


@pytest.fixture
def mcrim(capsys) -> Command:
    return Command(capsys)


@pytest.fixture(scope="session")
def shared_cache(tmp_path_factory) -> Path:
    """A record cache for tests that diagnose the misfit's bench: one simulates it for all.

    They lie in several processes, whose temporary folders stand side by side.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return folder / "records"


@pytest.fixture(scope="module")
def kept_records(shared_cache):
    """What a file's tests simulate is kept, as users' commands do: what is alike, is done once.

    For files whose tests ask the same bench several things. Keys tell seed, photons, scene and
    code, so that a test still fails whose verbs simulate something else.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MCRIM_CACHE", str(shared_cache))
        yield


#: Files that take a minute or more: begun last, one would go on when nobody else has work. Those
#: that share a cache with `test_app` come when it is done: side by side all would simulate.
LONGEST = (
    "test_app test_docs test_golden test_page test_every_campaign test_hidden_effects "
    "test_wheel test_calibrate test_session test_effect_responses test_kernel_effects "
    "test_validate test_work test_records test_render test_eta_spectrum test_plugins "
    "test_rival_causes test_tracer_effects test_types test_commands test_closure "
    "test_cross_section test_cluster_scripts test_trials test_article test_wrapping"
).split()


class TurnedFolder(pytest.Dir):
    """A folder of tests in which every process begins to read at another place.

    What is imported first has to be compiled, and asserts to be rewritten, which takes longer than
    all else of the import; what another process has read before is there already.
    """

    def collect(self):
        parts = list(super().collect())
        number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
        turn = number * len(parts) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
        return parts[turn:] + parts[:turn]


def pytest_collect_directory(path, parent):
    return TurnedFolder.from_parent(parent, path=path)


def pytest_collection_modifyitems(items):
    """Files with a test that runs alone come last: no other process has much to end before it."""
    last = {item.path for item in items if item.get_closest_marker("alone")}

    def place(item) -> tuple[bool, int, Path]:
        file = item.path.stem
        rank = LONGEST.index(file) if file in LONGEST else len(LONGEST)
        return item.path in last, rank, item.path

    items.sort(key=place)


def pytest_collection_finish():
    """What is there before the first test stays: looking for garbage in it took 4 % of the time."""
    gc.collect()
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 20, 20)


def pytest_sessionfinish():
    """What is left goes with the process: pytest would look through all of it five times."""
    gc.freeze()


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
