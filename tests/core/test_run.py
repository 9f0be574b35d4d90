"""How simulations are done, and what a result says of it."""

import gc
import os
import pickle
import signal

import numpy as np
import pytest
from places import cases_of
from refusals import refusal
from threadpoolctl import threadpool_info, threadpool_limits

from mcrim_mitsuba.core.run import (
    JobProgress,
    OverAxes,
    Provenance,
    Run,
    arguments_of,
    one_thread,
    processors,
    seldom_garbage,
    signals_wait,
)

cases = cases_of(__file__)


def test_a_run_takes_numbers_of_any_kind():
    run = Run(photons="1e6", seed=np.int64(3), threads=2.0, precision="0.01")
    assert (run.photons, run.seed, run.threads, run.precision) == (1_000_000, 3, 2, 0.01)
    assert run.photons_or(5) == 1_000_000 and Run().photons_or(5) == 5
    assert arguments_of(10.0, "0") == (10, 0)


@cases("given", "says")
def test_what_no_run_can_have_is_refused(given, says):
    assert says in refusal(Run, **given)


def test_progress_is_told_here_and_sent_nowhere():
    told = []
    run = Run(progress=lambda *words: told.append(words))
    run.tell("eta", 1, 2, "half")
    assert told == [("eta", 1, 2, "half")]
    sent = pickle.loads(pickle.dumps(run))
    assert sent.progress is None and sent == Run()
    Run().tell("eta", 1, 2)


def test_a_job_is_one_bar_that_never_goes_back():
    looks = [("simulation", done, 100) for done in (0, 50, 100)]
    further = [("simulation", done, 300) for done in (0, 150, 300)]
    fits = [("trying 52 effects", 1, 1), ("weighing", 1, 1), ("one more", 1, 1)]
    bar, places = JobProgress([("simulation", 10), ("simulation", 20), ("trying", 8)]), []
    for report in (*looks, ("looking", 1, 1), *further, *fits):
        bar.tell(*report)
        places.append(round(bar.done, 3))
    # the same name again is the next part; what is in no plan does not take the others' places
    assert places == [0, 0.125, 0.25, 0.25, 0.25, 0.5, 0.75, 0.75, 0.95, 0.988]
    assert bar.left == ""  # too quick to tell

    # side by side, and one after the other, without a plan
    bar, places = JobProgress(), []
    for report in (("air", 0, 100), ("gel", 0, 300), ("gel", 150, 300), ("air", 100, 100)):
        bar.tell(*report)
        places.append(round(bar.done, 3))
    assert places == [0, 0, 0.353, 0.588]
    bar.tell("gel", 300, 300)
    bar.tell("fitting", 1, 1)
    assert round(bar.done, 3) == 0.941


def test_linear_algebra_has_one_thread_meanwhile():
    np.eye(2) @ np.eye(2)

    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    with threadpool_limits(2, "blas"):
        assert (threads(), one_thread()(threads)(), threads()) == ({2}, {1}, {2})


def test_a_signal_waits_for_the_end(request):
    """Where Mitsuba is at work: `project/test_signals.py`."""
    done = []
    # a command that a test of the same process interrupted ignores signals from then on
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))

    @signals_wait()
    def work() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        done.append("the work")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["the work"]


def test_a_result_says_how_it_was_done():
    done = Provenance(1, 10, 5, "hash", versions={"numpy": "2"}, seconds=0.5, notes=())
    assert done.photons - done.cached_photons == 5


def test_an_answer_over_axes_is_a_dataset_with_units_that_is_reproducible():
    parameters = {"polarization": True, "n_gap": 1.5}
    answer = OverAxes(photons=10, seed=1, parameters=parameters, scene_hash="hash")
    axes = {"gap_mm": [0.1, 0.2], "born": ["at one depth"]}
    data = answer.dataset({"eta": (tuple(axes), [[0.5], [0.6]])}, axes, detected=3)
    assert data.eta.sel(gap_mm=0.2).item() == 0.6
    assert data.gap_mm.attrs == {"units": "mm"} and data.born.attrs == {}
    # NetCDF has no true and false
    parameters["polarization"] = "True"
    assert (
        data.attrs == {"detected": 3, "photons": 10, "seed": 1, "scene_hash": "hash"} | parameters
    )


def test_processors_are_those_that_are_granted(monkeypatch):
    """A batch system grants a few of a machine's; all were used, and waited for each other."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3, 7, 11}, raising=False)
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    assert processors() == 3
    for stated, number in {"2": 2, "default": 3, "0": 3}.items():
        monkeypatch.setenv("PYTHON_CPU_COUNT", stated)
        assert processors() == number


def test_processes_of_ours_look_seldom_for_garbage():
    usual = gc.get_threshold()
    try:
        gc.set_threshold(700, 10, 10)  # Python's own
        seldom_garbage()
        assert gc.get_threshold()[0] >= 10_000
    finally:
        gc.set_threshold(*usual)
