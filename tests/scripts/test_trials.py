"""Trials that are interrupted, killed, damaged, done in parts: the results are the same."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import SCRIPTS
from trials import peak
from trials.executor import Trial, TrialExecutor, Trials

from mcrim_mitsuba.cli.terminal import run
from mcrim_mitsuba.core.errors import InputError

WANTED = [Trial("third", number) for number in range(7)]


def third(number, calls):
    """A number that only all of its digits tell; each call leaves a line."""
    with Path(calls).open("a") as stream:
        stream.write(f"{number}\n")
    return {"third": (number + 1) / 3}


def dies_once(number, calls):
    """As `third`, but the first process that comes to number 3 is killed there."""
    died = Path(calls).with_suffix(".died")
    if number == 3 and not died.exists():
        died.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return third(number, calls)


def refuses_3(number, calls):
    if number == 3:
        raise InputError("3 is too much", "take 2")
    if number == 4:
        raise ZeroDivisionError("4 - 4")
    return third(number, calls)


@pytest.fixture
def do(tmp_path):
    """Does all trials: what `Trials.do` returns, the trials, and the numbers that were called."""

    def do(function=third, wanted=WANTED, parameters=(), found=lambda *_: None, **executor):
        executor = TrialExecutor(**({"folder": tmp_path / "units"} | executor))
        trials = Trials("test", {"p": list(parameters)}, wanted, [Path(__file__)], executor)
        calls = tmp_path / "calls"
        calls.write_text("")
        work = {trial: (trial.number, str(calls)) for trial in trials.missing}
        failures = trials.do(function, work, found=found)
        return failures, trials, [int(line) for line in calls.read_text().split()]

    return do


def results(trials):
    return json.dumps([trials.results.get(trial) for trial in WANTED])


EXPECTED = json.dumps([{"third": (number + 1) / 3} for number in range(7)])


def test_interrupted_trials_go_on(do):
    def interrupted(trial, result):
        if trial.number == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="interrupted: 3 of 7 trials done; the same"):
        do(found=interrupted)
    failures, trials, calls = do()
    assert (failures, calls, results(trials)) == ([], [3, 4, 5, 6], EXPECTED)
    # and more of them begin with the same ones
    assert do(wanted=[*WANTED, Trial("third", 7)])[2] == [7]
    # other trials are others
    assert do(parameters=[1])[2] == list(range(7))


@pytest.mark.parametrize(
    "damage",
    [lambda text: text[: len(text) // 2], lambda text: text.replace("1.33", "1.34"), lambda _: ""],
)
def test_a_damaged_trial_is_done_again(do, tmp_path, damage):
    do()
    (file,) = tmp_path.rglob("third-000003.json")
    file.write_text(damage(file.read_text()))
    failures, trials, calls = do()
    assert (failures, calls, results(trials)) == ([], [3], EXPECTED)


def test_parts_together_are_the_whole(do, monkeypatch):
    first, second = do(part=(1, 2)), do(part=(2, 2))
    assert (first[2], second[2]) == ([0, 2, 4, 6], [1, 3, 5])
    assert (first[1].elsewhere, second[1].elsewhere) == (3, 0)
    assert "without --unit" in first[1].state()
    _, trials, calls = do()
    assert (calls, results(trials)) == ([], EXPECTED)
    monkeypatch.setenv("MCRIM_CACHE", "off")
    with pytest.raises(InputError, match="name a folder by --units"):
        do(part=(1, 2), folder=None)


def test_a_process_that_dies_costs_what_was_under_way(do):
    failures, trials, calls = do(dies_once, processes=2)
    assert (failures, results(trials)) == ([], EXPECTED)
    # the other process was at something, which may have begun anew
    assert sorted(set(calls)) == list(range(7)) and len(calls) <= 8


@pytest.mark.parametrize("processes", [1, 2])
def test_a_trial_that_fails_stops_no_other(do, processes):
    failures, trials, calls = do(refuses_3, processes=processes)
    assert sorted(failures) == [
        "third 3: 3 is too much; take 2",
        f"third 4: ZeroDivisionError: 4 - 4 (test_trials.py, line {_line_of('4 - 4')})",
    ]
    assert [trial.number for trial in trials.missing] == [3, 4] and 2 in calls
    assert do()[2] == [3, 4]


def _line_of(text):
    lines = Path(__file__).read_text().split("\n")
    return 1 + next(n for n, line in enumerate(lines) if text in line)


def test_trials_that_cannot_be_kept(do, tmp_path):
    (tmp_path / "units").write_text("")
    with pytest.raises(InputError, match="the folder cannot be made"):
        do()


def test_a_cluster_gives_the_same_digits(do):
    """Two workers with the package, and this file's folder, from somewhere else."""
    distributed = pytest.importorskip("distributed")
    pytest.importorskip("mcrim_mitsuba.runs.cluster")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0"
    ) as cluster:
        failures, trials, calls = do(dies_once, cluster=cluster.scheduler_address)
    assert (failures, results(trials)) == ([], EXPECTED)
    assert sorted(set(calls)) == list(range(7))


def test_a_script_that_is_killed_goes_on(tmp_path, capfd, monkeypatch):
    """kill -9, with its processes, and again; against the same without."""
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))
    words = ["--repeats", "40", "--json", "-", "--processes"]
    process = subprocess.Popen(
        [sys.executable, str(SCRIPTS / "trials"), "peak", *words, "2"],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
    )
    folder = tmp_path / "cache" / "trials"
    while not list(folder.rglob("*.json")):
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = {file: file.stat().st_mtime_ns for file in folder.rglob("*.json")}
    assert 0 < len(before) < 4
    assert run(peak.main, "peak", [*words, "1"]) == 0
    went_on = capfd.readouterr().out
    assert {file: file.stat().st_mtime_ns for file in before} == before
    assert len(list(folder.rglob("*.json"))) == 4
    monkeypatch.setenv("MCRIM_CACHE", "off")
    assert run(peak.main, "peak", [*words, "1"]) == 0
    assert capfd.readouterr().out == went_on


@pytest.mark.parametrize("part", ["0/2", "3/2", "1", "1/2/3", "x/2"])
def test_parts_that_are_none(capfd, part):
    assert run(peak.main, "peak", ["--unit", part]) == 2
    assert "is no part of an array job; write K/N" in capfd.readouterr().err
