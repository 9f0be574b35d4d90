"""Long jobs in units: the same digits whoever does them, and nothing lost that was finished."""

import hashlib
import itertools
import json
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import dask
import distributed
import numpy as np
import psutil
import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.cli.main import main
from mcrim_mitsuba.cli.terminal import progress_log
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.efficiency import simulate as simulating
from mcrim_mitsuba.efficiency.eta_grid import Grid, merged, table_of
from mcrim_mitsuba.efficiency.eta_surface import EtaRequest, EtaRun, GridBlock
from mcrim_mitsuba.runs import array_job, executors
from mcrim_mitsuba.runs import cluster as on_cluster
from mcrim_mitsuba.runs import scene_units as cut
from mcrim_mitsuba.runs.array_job import ArrayPart, PartExecutor, UnitFolder
from mcrim_mitsuba.runs.cache import RecordCache, record_versions
from mcrim_mitsuba.runs.executors import (
    Executor,
    Job,
    ProcessExecutor,
    current_executor,
    many_units_executor,
    more_units_follow,
    pickled,
    use_executor,
)
from mcrim_mitsuba.runs.scene_units import PortableScene, unpacked
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.launch_plan import LANES, SHARE_STEPS, ScatteringProposals
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

TABLE = ["--alpha-scat", "0,0.3,1", "--alpha-abs", "0.039", "--n-gap", "1,1.46", "--photons", "6e5"]


def make_units_small(patch):
    """Small launches, so that short runs have many units; the workers are told what to do."""
    patch.setattr("mcrim_mitsuba.efficiency.eta_surface.LARGEST_LAUNCH", 2 * LANES)
    patch.setattr("mcrim_mitsuba.efficiency.eta_surface.FIRST_LOOK", 4 * LANES)
    patch.setattr(cut, "SHORT", 3)


@pytest.fixture(autouse=True)
def small_units(monkeypatch):
    make_units_small(monkeypatch)


@pytest.fixture(scope="module")
def whole(scenes, tmp_path_factory):
    """The table as it is without a cache, in this process, at one go."""
    with pytest.MonkeyPatch.context() as patch:
        make_units_small(patch)
        return table(scenes, tmp_path_factory.mktemp("whole") / "T.csv")


def table(scenes, path, *options) -> bytes:
    assert main(["table", str(scenes / "camoo4.xml"), *TABLE, "-o", str(path), *options]) == 0
    return path.read_bytes() if path.exists() else b""


def test_parts_of_an_array_job_merge_to_the_same_digits(scenes, tmp_path, whole, capsys):
    units, path = str(tmp_path / "units"), tmp_path / "T.csv"
    parts = ["--units", units, "--log", str(tmp_path / "log"), "--unit"]
    assert table(scenes, path, *parts, "1/3") == b""  # a part has no result
    assert main(["merge", units]) == 2
    assert "2 of 3 parts are not done: 2, 3; run them first: mcrim table" in capsys.readouterr().err
    for part in ("3/3", "2/3", "2/3"):
        assert table(scenes, path, *parts, part) == b""
    out = capsys.readouterr().out.splitlines()
    assert out[-1].startswith("mcrim: this part is done (0 units, 0 photons)")  # done before
    assert main(["merge", units]) == 0
    assert path.read_bytes() == whole
    # points that were simulated on their own depend on nothing: all of it was there
    assert "of the cache" in capsys.readouterr().out
    made = [
        line.split(" made")[0]
        for line in (tmp_path / "log").read_text().splitlines()
        if " made, " in line
    ]
    assert len(made) > 10
    # nobody may mix in parts of something else
    line = ["table", str(scenes / "camoo4.xml"), *TABLE, "--seed", "1", "-o", str(path)]
    assert main([*line, *parts, "1/3"]) == 2
    assert "parts of another command" in capsys.readouterr().err
    command = json.loads((tmp_path / "units" / "command.json").read_text())
    command["versions"]["mitsuba"] = "3.9.0"
    (tmp_path / "units" / "command.json").write_text(json.dumps(command))
    assert main(["merge", units]) == 2
    assert "the parts were made with mitsuba 3.9.0, here is" in capsys.readouterr().err
    (tmp_path / "units" / "command.json").write_text("{")
    assert main(["merge", units]) == 2
    assert "the file is damaged; remove the folder" in capsys.readouterr().err


@cases("changes", more=[{"folder": None}, {"folder": "\ud800"}, {"parts": 10**8}, None])
def test_merge_runs_nothing_that_no_part_has_written(here, mcrim, changes):
    command = {
        "arguments": ["table"],
        "folder": str(here),
        "parts": 1,
        "versions": {"variant": "llvm_ad_rgb"},
        "files": {},
    }
    text = "[" * 100_000 if changes is None else json.dumps(command | changes)
    (here / "command.json").write_text(text)
    (here / "part-1-of-1.json").write_text("{}")
    error = mcrim.refused("merge", here)
    assert "the file is damaged" in error or "holds a command that has no parts" in error


def test_a_folder_belongs_to_one_command(tmp_path, monkeypatch):
    """Even if several begin at the same moment, each finding it empty."""
    together, here = threading.Barrier(8), threading.local()

    def is_there(path: Path) -> bool:
        if here.begins:
            here.begins = False
            together.wait(10)
            return False
        return path.exists()

    monkeypatch.setattr(array_job, "is_there", is_there)

    def begin(number: int) -> bool:
        here.begins = True
        command = {
            "arguments": ["table", str(number)],
            "folder": "",
            "files": {},
            "versions": {"variant": ""},
        }
        try:
            UnitFolder(tmp_path / "units").begin(command, ArrayPart(1, 2))
        except InputError as error:
            assert "parts of another command" in str(error)
            return False
        return True

    for _ in range(10):
        with ThreadPoolExecutor(8) as pool:
            assert sum(pool.map(begin, range(8))) == 1
        assert [file.name for file in (tmp_path / "units").iterdir()] == ["command.json"]
        (tmp_path / "units" / "command.json").unlink()


OWN_EFFECT = """from mcrim_mitsuba.effects import Effect
def reading(signals, value):
    return signals, signals, signals
EFFECT = Effect(name="own", title="own", physics="None.", source="None.", edit=lambda editor: None)
"""


@contextmanager
def edited(name: str) -> Iterator[str]:
    """A file with a remark more, which goes again: what is said of it where parts were made."""
    text = Path(name).read_text()
    remark = "<!-- edited -->\n" if name.endswith(".xml") else "# edited\n"
    hashes = [hashlib.sha256(f"{text}{end}".encode()).hexdigest()[:12] for end in ("", remark)]
    Path(name).write_text(f"{text}{remark}")
    yield f"{name} (SHA-256 {hashes[0]}; here is {hashes[1]})"
    Path(name).write_text(text)


def test_parts_of_files_that_were_edited_are_not_merged(scenes, here, mcrim):
    """Whatever the command reads: it would be another bench, or other readings."""
    scene = (scenes / "camoo4.xml").read_text()
    Path("parameters.xml").write_text("<scene version='3.0.0'>\n</scene>\n")
    include = '<include filename="parameters.xml"/>\n</scene>'
    Path("bench.xml").write_text(include.join(scene.rsplit("</scene>", 1)))
    Path("readings.csv").write_text((scenes / "camoo4_measured.csv").read_text())
    Path("own").mkdir()
    Path("own/own.py").write_text(OWN_EFFECT)
    campaign = (scenes / "camoo4_campaign.toml").read_text()
    campaign = campaign.replace("camoo4.xml", "bench.xml")
    campaign = campaign.replace("camoo4_measured.csv", "readings.csv")
    Path("first.toml").write_text('effects_folder = "own"\n' + campaign)
    Path("second.toml").write_text(campaign)
    line = "compare first.toml second.toml --trust-effects --photons 16384 --json found.json"
    files = ["bench.xml", "parameters.xml", "readings.csv", "second.toml", "own/own.py"]
    for part, refused in (("1/2", [*line.split(), "--unit", "2/2"]), ("2/2", ["merge"])):
        mcrim(*line.split(), "--unit", part)
        for name in files:
            with edited(name) as problem:
                assert problem in mcrim.refused(*refused)
                assert not Path("found.json").exists()
    mcrim("merge")
    assert Path("found.json").exists()


def test_parts_that_follow_each_other_share_the_same_units(scenes, tmp_path):
    """A part that finds what others have made still does its own half, and no less."""
    units, found = str(tmp_path / "units"), tmp_path / "found.json"
    command = ["compare", str(scenes / "camoo4_campaign.toml"), "--photons", "16384"]
    command += ["--json", str(found)]
    for part in ("1/2", "2/2"):
        assert main([*command, "--units", units, "--unit", part]) == 0
        assert not found.exists()
    made = [json.loads(file.read_text())["units"] for file in Path(units).glob("part-*.json")]
    assert len(made) == 2 and abs(made[0] - made[1]) <= 1 < sum(made)
    assert main(["merge", units]) == 0
    merged = json.loads(found.read_text())
    assert merged["cached_photons"] == merged["photons"] > 0


@cases("options", "words")
def test_refusals(scenes, monkeypatch, mcrim, options, words):
    monkeypatch.setattr(on_cluster, "ANSWER_S", 0.5)
    status, _, error = mcrim("table", scenes / "camoo4.xml", *TABLE, *options)
    assert status == 2 and words in error and error.count("\n") == 1


@pytest.mark.parametrize("content", ['{"address":', "[]", "{}", "\\x00" * 99, "[" * 100_000])
def test_a_file_of_something_else_is_no_scheduler_s(here, content):
    Path("rubbish.json").write_text(content)
    said = refusal(on_cluster.connect, "rubbish.json")
    assert said.startswith("rubbish.json: this is no file of a scheduler; name the one that dask")


def test_something_else_that_listens_is_no_scheduler(scenes):
    """It takes the connection and says nothing: the command must end all the same."""
    code = (
        "import socket, sys; from mcrim_mitsuba.runs import cluster; cluster.ANSWER_S = 1.0\n"
        "listens = socket.create_server(('127.0.0.1', 0)); port = listens.getsockname()[1]\n"
        "from mcrim_mitsuba.cli.main import main\n"
        f"sys.exit(main(['simulate', {str(scenes / 'camoo4.xml')!r}, '--cluster',"
        " f'tcp://127.0.0.1:{port}']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "what listens there says nothing" in done.stderr
    assert done.stderr.count("\n") == 1


class StumblingClient:
    """Dask's client as it is on a busy machine: it fails by itself so often, then it is there."""

    stumbles = 0

    def __init__(self, address: str, **settings) -> None:
        if StumblingClient.stumbles:
            StumblingClient.stumbles -= 1
            raise AssertionError("Status.running")


def test_a_client_that_fails_by_itself_is_made_again(monkeypatch):
    monkeypatch.setattr(distributed, "Client", StumblingClient)
    monkeypatch.setattr(StumblingClient, "stumbles", 1)
    assert isinstance(on_cluster.connect("tcp://127.0.0.1:8786"), StumblingClient)


def test_a_client_that_always_fails_is_told_with_its_reason(monkeypatch):
    monkeypatch.setattr(distributed, "Client", StumblingClient)
    monkeypatch.setattr(StumblingClient, "stumbles", 100)
    said = refusal(on_cluster.connect, "tcp://127.0.0.1:8786")
    assert said.startswith("no Dask scheduler answers at tcp://127.0.0.1:8786 (Status.running); ")
    assert StumblingClient.stumbles == 100 - on_cluster.CONNECT_TRIES


def test_without_dask_the_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'mcrim-mitsuba\[cluster\]'"):
        on_cluster.connect("tcp://127.0.0.1:8786")


@pytest.fixture(scope="module")
def two_workers():
    """A Dask cluster of this machine: a scheduler and two processes."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    ) as cluster:
        yield cluster


def test_a_cluster_whose_worker_dies_gives_the_same_digits(
    scenes, tmp_path, whole, two_workers, monkeypatch
):
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))
    first = next(iter(two_workers.workers.values())).pid
    killed = []

    class Killing(on_cluster.ClusterExecutor):
        def do(self, jobs, **options):
            # whoever asks Dask for its usual scheduler, as xarray does, is not sent to ours
            assert dask.config.get("scheduler", None) is None
            for number, done in enumerate(super().do(jobs, **options)):
                if number == 1 and len(jobs) > 4 and not killed:
                    os.kill(first, signal.SIGKILL)
                    killed.append(first)
                yield done

    monkeypatch.setattr(on_cluster, "ClusterExecutor", Killing)
    address = two_workers.scheduler_address
    log = tmp_path / "log"
    found = table(scenes, tmp_path / "T.csv", "--cluster", address, "--log", str(log))
    assert killed and found == whole
    lines = log.read_text().splitlines()
    made = [line for line in lines if " made, " in line]
    assert len(made) == sum(" begun, " in line for line in lines) > 10
    # what came back is kept here: again it is there without the cluster
    assert table(scenes, tmp_path / "again.csv", "--log", str(log)) == whole
    again = log.read_text().splitlines()[len(lines) :]
    assert not any(" begun, " in line for line in again)
    assert sum(" kept, " in line for line in again) == len(made)


def test_a_worker_of_other_versions_refuses(two_workers, scenes):
    versions = record_versions("llvm_ad_rgb") | {"mitsuba": "3.9.0"}
    with distributed.Client(two_workers, set_as_default=False) as client:
        future = client.submit(on_cluster.make_on_worker, b"", versions)
        with pytest.raises(InputError, match=r"the worker \S+ has mitsuba \S+, not 3\.9\.0"):
            future.result()


def test_a_worker_without_this_package_says_so(tmp_path, monkeypatch):
    """It can load what it is sent: else it would go away, and be waited for."""
    file = tmp_path / "function.pickle"
    sent = []

    class Listening:
        def get_executor(self, **options):
            return self

        def submit(self, function, *arguments, **options):
            sent.append(function)

    monkeypatch.setattr(on_cluster, "connect", lambda address: Listening())
    unit = SimpleNamespace(portable=lambda: 1, variant="llvm_ad_rgb", modules=())
    on_cluster.ClusterExecutor("tcp://host:1").submit(unit)
    file.write_bytes(distributed.protocol.pickle.dumps(sent[0]))
    code = (
        "import pickle, sys; sys.modules['mcrim_mitsuba'] = None\n"
        f"function = pickle.load(open({str(file)!r}, 'rb'))\n"
        "try: function(b'', {})\nexcept ModuleNotFoundError as error: print(error.name)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, cwd=tmp_path)
    assert done.stdout.startswith(b"mcrim_mitsuba"), done.stderr.decode()


def test_a_scheduler_that_is_gone_is_said_in_one_line(monkeypatch):
    class Gone:
        def scheduler_info(self, **options):
            return {}

    monkeypatch.setattr(on_cluster, "connect", lambda address: Gone())
    with pytest.raises(InputError, match="the connection to the scheduler was lost"):
        _ = on_cluster.ClusterExecutor("tcp://host:1").workers


def test_who_waits_for_workers_is_told(scenes, tmp_path, monkeypatch, capsys):
    """In a pipe too, where no bar is shown."""

    def do(executor, jobs, **options):
        raise InputError("nobody works here", "this test ends")

    monkeypatch.setattr(on_cluster.ClusterExecutor, "do", do)
    with distributed.LocalCluster(
        n_workers=0, dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL
    ) as cluster:
        address = cluster.scheduler_address
        assert main(["simulate", str(scenes / "camoo4.xml"), "--cluster", address]) == 2
    told, wrong = capsys.readouterr().err.splitlines()
    assert told == f"note: no workers at {address} yet: the work begins with the first"
    assert "nobody works here" in wrong


def test_a_scene_that_is_not_sound_is_refused_with_its_own_lines(
    scenes, tmp_path, two_workers, capsys
):
    text = (scenes / "camoo4.xml").read_text()
    path = tmp_path / "leaky.xml"
    shape = text.index("<shape", text.index('id="crystal_top"') - 60)
    end = text.index("</shape>", shape) + len("</shape>")
    path.write_text(text[:shape] + text[end:])
    lines = []
    for where in ([], ["--cluster", two_workers.scheduler_address]):
        assert main(["table", str(path), *TABLE, *where]) == 2
        lines.append(capsys.readouterr().err)
    assert lines[0] == lines[1] and str(path) in lines[0]


GRID = Grid((0.3, 0.4), (0.039, 0.05))


def block(scene, **changes) -> GridBlock:
    given = {
        "what": "x",
        "scene": scene,
        "proposals": ScatteringProposals((0.3,), (SHARE_STEPS,), 0.039),
        "grid": GRID,
        "seed": 1,
        "variant": "llvm_ad_rgb",
        "first": 0,
        "launches": (LANES,),
        "checked": True,
    }
    return GridBlock(**given | changes)


def test_a_unit_needs_no_files_elsewhere(scenes, tmp_path):
    """Includes, parameters and meshes travel with it; what cannot is refused there."""
    text = (scenes / "camoo4.xml").read_text()
    path = tmp_path / "here" / "bench.xml"
    (path.parent / "meshes").mkdir(parents=True)
    (path.parent / "meshes" / "a.ply").write_text("a mesh")
    named = (
        '<shape type="ply" id="a"><string name="filename" value="meshes/a.ply"/></shape></scene>'
    )
    path.write_text(text.replace("</scene>", named))
    scene = read_scene(path, {"n_gap": 1.46})
    portable = pickle.loads(pickle.dumps(PortableScene.of(scene)))
    (path.parent / "meshes" / "a.ply").unlink()
    path.unlink()
    elsewhere = unpacked(portable)
    assert elsewhere.content_hash == portable.content_hash and elsewhere.path != path
    assert (elsewhere.path.parent / "meshes" / "a.ply").read_text() == "a mesh"
    # a mesh that lies above the folder stays where it is, and another one is noticed
    outside = tmp_path / "b.ply"
    outside.write_text("one")
    path.write_text(text.replace("</scene>", named.replace("meshes/a.ply", str(outside))))
    portable = PortableScene.of(read_scene(path))
    assert unpacked(portable).content_hash == portable.content_hash
    outside.write_text("two")
    with pytest.raises(InputError, match="does not see the same files"):
        unpacked(PortableScene(portable.path, portable.content_hash, portable.text + b" ", ()))


def test_an_own_effect_travels_with_the_unit(scenes, tmp_path):
    effect = catalogue(scenes / "own_effects")["black_spot"]
    file = tmp_path / "effect.pickle"
    file.write_bytes(pickled(effect))
    code = f"import pickle; print(pickle.load(open({str(file)!r}, 'rb')).name)"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, cwd=tmp_path)
    assert done.stdout.decode().strip() == "black_spot", done.stderr.decode()


def test_processes_of_this_machine_give_the_same_digits(scenes, tmp_path, monkeypatch):
    """Units in the order of the jobs; a process that is killed ends in one line."""
    monkeypatch.setattr(executors, "FEWEST", (2, 0))
    scene = read_scene(scenes / "camoo4.xml")
    units = [block(scene, first=n) for n in range(8)]
    here, there = (
        [done.chunks for done in who.do([Job(unit, cache) for unit in units])]
        for who, cache in (
            (Executor(), RecordCache({"x": 1}, tmp_path / "here")),
            (ProcessExecutor(2), RecordCache({"x": 1}, tmp_path / "there")),
        )
    )
    for ours, theirs in zip(here, there, strict=True):
        assert ours.keys() == theirs.keys()
        for number, chunk in ours.items():
            for name, array in chunk.arrays.items():
                assert np.array_equal(array, theirs[number].arrays[name])
    jobs = [Job(unit, RecordCache({"x": 2}, tmp_path / "killed")) for unit in units]
    waiting = ProcessExecutor(2).do(jobs)
    next(waiting)
    for process in psutil.Process().children(recursive=True):
        if "loky" in " ".join(process.cmdline()) and "tracker" not in " ".join(process.cmdline()):
            process.kill()
    with pytest.raises(InputError, match="ended from outside"):
        list(waiting)
    # what was finished is kept, and new processes go on
    assert len(list(ProcessExecutor(2).do(jobs))) == len(units)


def test_processes_that_began_elsewhere_see_the_scene_that_is_meant(here, scenes, monkeypatch):
    """One named without its folder was read again where the process had begun: another's."""
    monkeypatch.setattr(executors, "FEWEST", (2, 0))
    etas = []
    for name, n_gap in (("first", "1.0"), ("second", "1.46")):
        (here / name).mkdir()
        monkeypatch.chdir(here / name)
        text = (scenes / "camoo4.xml").read_text()
        line = '<default name="n_gap" value="'
        before, after = text.split(line)
        Path("bench.xml").write_text(before + line + n_gap + after[after.index('"') :])
        scene = read_scene("bench.xml")
        cache = RecordCache({"x": name}, here / "cache")
        jobs = [Job(block(scene, first=n), cache) for n in range(2)]
        done, _ = ProcessExecutor(2).do(jobs)
        slow = next(iter(Executor().do(jobs[:1])))
        (of,), (again,) = done.chunks.values(), slow.chunks.values()
        assert all(np.array_equal(of.arrays[n], again.arrays[n]) for n in of.arrays)
        etas.append(of.arrays)
    assert any(not np.array_equal(etas[0][n], etas[1][n]) for n in etas[0])


def test_few_units_are_done_by_processes_where_many_follow(tmp_path):
    """Else they are done here; and so is what takes less than starting processes does."""

    def who_did(photons):
        def unit(number):
            return SimpleNamespace(
                what="x",
                photons=photons,
                numbers=(number,),
                check=lambda threads: None,
                make=lambda threads: {number: ({"process": np.array([os.getpid()])}, {})},
            )

        units = [unit(n) for n in range(2)]
        cache = RecordCache({"time": next(times)}, tmp_path)
        done = ProcessExecutor(2).do([Job(unit, cache) for unit in units])
        return {int(of.chunks[n].arrays["process"][0]) for n, of in enumerate(done)}

    times = itertools.count()

    enough = executors.FEWEST_OF_MANY[1] // 2
    assert who_did(enough) == {os.getpid()}
    with more_units_follow():
        assert os.getpid() not in who_did(enough)
        assert who_did(enough // 2) == {os.getpid()}
    assert who_did(enough) == {os.getpid()}


#: A process that hands units to others and is killed: what a worker made is more than a pipe holds.
KILLED = """
import os, signal
from types import SimpleNamespace
import numpy as np
from mcrim_mitsuba.runs.executors import Job, ProcessExecutor
from mcrim_mitsuba.runs.cache import RecordCache

class Unit(SimpleNamespace):
    def portable(self): return self
    def check(self, threads): pass
    def make(self, threads): return {self.numbers[0]: ({"a": np.zeros(1_000_000)}, {})}

units = [Unit(what="x", photons=1_000_000, numbers=(n,)) for n in range(40)]
cache = RecordCache({"x": 1})
for done in ProcessExecutor(2).do([Job(unit, cache) for unit in units]):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_processes_end_with_the_one_that_was_killed(tmp_path, monkeypatch):
    """They hold its output open; nobody takes what they have made."""
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path))
    killed = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, timeout=60)
    assert killed.returncode == -signal.SIGKILL and b"Error" not in killed.stderr


def test_who_was_named_does_many_small_units_too(tmp_path):
    assert isinstance(many_units_executor(2), ProcessExecutor)
    assert type(many_units_executor(1)) is Executor
    with use_executor(PartExecutor(UnitFolder(tmp_path), ArrayPart(1, 2))) as named:
        assert many_units_executor(2) is named


def test_long_runs_begin_with_the_same_units():
    launches = list(range(1, 400))
    every = list(cut.blocks(launches))
    assert list(itertools.chain(*every)) == launches
    for length in (1, 3, 50, 64, 65, 200):
        assert (
            list(cut.blocks(launches[:length]))[:-1]
            == every[: len(list(cut.blocks(launches[:length]))) - 1]
        )
    assert len(every) < 35  # long runs leave few files


def test_tables_come_back_to_the_last_digit(scenes, tmp_path):
    """What units made, kept and merged is what is made at once."""
    scene = read_scene(scenes / "camoo4.xml")
    cache = RecordCache({"x": 1}, tmp_path)
    units = [block(scene, first=n) for n in (0, 1)]
    done = list(Executor().do([Job(unit, cache) for unit in units]))
    again = list(Executor().do([Job(unit, cache) for unit in units]))
    assert [each.cached for each in (*done, *again)] == [False, False, True, True]
    tables = []
    for found in (done, again):
        of_units = [
            table_of(chunk.arrays, 1, *GRID.counts)
            for each in found
            for chunk in each.chunks.values()
        ]
        tables.append(merged(of_units, [LANES, LANES]))
    assert len(tables[0].deviations) == 256
    for name in ("log_eta", "deviations"):
        assert np.array_equal(getattr(tables[0], name), getattr(tables[1], name))


def test_a_damaged_unit_is_made_again_and_said(scenes, tmp_path, whole, monkeypatch, capsys):
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))
    assert table(scenes, tmp_path / "T.csv") == whole
    chunk = sorted((tmp_path / "cache").rglob("*.chunk"))[0]
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 4
    chunk.write_bytes(content)
    capsys.readouterr()
    assert table(scenes, tmp_path / "T.csv") == whole
    assert "1 file was damaged, and made again" in capsys.readouterr().out


def test_a_long_simulation_is_kept_in_units(scenes, tmp_path, monkeypatch):
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path))
    monkeypatch.setattr("mcrim_mitsuba.transport.collection.PER_LANE_FLAT", 8)
    monkeypatch.setattr(simulating, "AT_ONCE", 2)
    simulation = Simulation(scenes / "camoo4.xml", check=False)
    photons = 13 * 8 * LANES
    at_once = simulation.collect(photons, seed=3)
    notes = []
    runs = [
        simulating.collect(
            simulation, run=Run(photons, seed=3, progress=lambda *told: notes.append(told))
        )
        for _ in range(2)
    ]
    assert (runs[0].eta, runs[0].eta_sigma) == (runs[1].eta, runs[1].eta_sigma)
    assert runs[0].eta == pytest.approx(at_once.eta, rel=1e-12)
    assert runs[0].eta_sigma == pytest.approx(at_once.eta_sigma, rel=1e-9)
    assert [run.cached_photons for run in runs] == [0, photons]
    assert runs[1].seconds == pytest.approx(runs[1].seconds) and runs[1].seconds > 0
    assert notes[-1][:3] == ("simulating", photons, photons) and "eta 0.2" in notes[-1][3]
    # and it stops where a precision is reached, in whichever way
    short = simulating.collect(simulation, run=Run(10**9, 0.002, seed=3))
    assert short.eta_sigma <= 0.002 * short.eta and short.photons < photons


def test_an_interrupted_long_simulation_tells_what_it_has(scenes, tmp_path, monkeypatch):
    monkeypatch.setattr("mcrim_mitsuba.transport.collection.PER_LANE_FLAT", 8)
    monkeypatch.setattr(simulating, "AT_ONCE", 2)
    simulation = Simulation(scenes / "camoo4.xml", check=False)

    def interrupt(what, done, total, note=""):
        if done > total / 2:
            raise KeyboardInterrupt

    class Alone(PartExecutor):
        """A part that has all units, so that there is something to interrupt."""

        def do(self, jobs, **options):
            return super().do(jobs, **{**options, "by_all": True})

    # a part of an array job is not done then
    executor = Alone(UnitFolder(tmp_path), ArrayPart(1, 2))
    with use_executor(executor), pytest.raises(KeyboardInterrupt):
        simulating.collect(simulation, run=Run(20 * 8 * LANES, seed=3, progress=interrupt))
    found = simulating.collect(simulation, run=Run(20 * 8 * LANES, seed=3, progress=interrupt))
    assert found.interrupted and 0.5 < found.photons / (20 * 8 * LANES) < 1
    assert any("interrupted after" in note for note in found.notes)


def test_progress_is_silent_in_a_pipe_and_written_to_a_log(scenes, tmp_path, mcrim):
    log = tmp_path / "log"
    command = ["table", scenes / "camoo4.xml", *TABLE, "-o", tmp_path / "T.csv", "--log"]
    done = subprocess.run(
        [sys.executable, "-m", "mcrim_mitsuba", *map(str, command), str(log)],
        capture_output=True,
        env={**os.environ, "MCRIM_CACHE": "off"},
    )
    assert done.returncode == 0 and done.stderr == b""
    lines = log.read_text().splitlines()
    assert all(line[:2] == "20" and line[19:21] == "Z " for line in lines)
    last = [line for line in lines if "n_gap = 1.46: " in line][-1]
    assert "of 2 units, errors up to 0." in last or "of 1 units, errors up to 0." in last
    if Path("/dev/full").exists():  # a disk that is full stops the log, not the work
        status, _, err = mcrim(*command, "/dev/full")
        assert status == 0 and "Traceback" not in err


def test_a_log_waits_for_nobody(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="nobody reads from this pipe"), progress_log(str(pipe)):
        pass
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with progress_log(str(pipe)) as report:
        report("a", 1, 1)
        assert os.read(reader, 1000).endswith(b"Z a\n")
        os.close(reader)  # the work goes on without
        for what in "bcd":
            report(what, 1, 1)


def extend(run, photons):
    for done in current_executor().do(run.jobs(photons), threads=None):
        run.take(done)


def test_the_executor_is_named_for_a_block_only(scenes):
    class Counting(Executor):
        asked = 0

        def do(self, jobs, **options):
            self.asked += len(jobs)
            return super().do(jobs, **options)

    executor = Counting()
    with use_executor(executor):
        run = EtaRun(EtaRequest("x", read_scene(scenes / "camoo4.xml"), [(0.3, 0.039)], Run()))
        extend(run, 4 * LANES)
    extend(run, 8 * LANES)
    assert executor.asked == 1 and run.photons == 8 * LANES
