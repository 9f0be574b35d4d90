"""`scripts/trials faults` stops verbs that write; a few of its trials, and that it notices loss."""

import pytest
from trials import faults
from trials.faults import OLD, Ended, Trial, Whole


def test_verbs_that_are_stopped_go_on():
    said = []
    trials = [
        Trial(1, "scenes", "KILL", 0.9),
        Trial(2, "histogram", "TERM", 0.6),
        Trial(3, "add", "INT", 0.9),
        Trial(4, "histogram", "disk", 0.0),
    ]
    assert faults.campaign_of(trials, said.append) == {} and said == []


WHOLE = Whole(
    1.0, {"scene.xml": b"scene"}, {"a.json": b'{"eta": 0.25, "seconds": 3}', "f.png": b"f"}
)
FILES = WHOLE.inputs | WHOLE.results


@pytest.mark.parametrize(
    ("status", "changed", "said"),
    [
        (0, {}, None),
        (-9, {"a.json": OLD, "f.png": OLD}, None),
        (0, {"a.json": b'{"eta": 0.25, "seconds": 4}'}, None),
        (0, {"f.png": OLD}, "status 0, but f.png is another one"),
        (-9, {"f.png": b""}, "f.png is neither the old one nor whole (0 bytes)"),
        (-9, {"f.png": None}, "f.png is gone"),
        (-9, {"a.json": b'{"eta": 0.24, "seconds": 3}'}, "a.json is neither"),
        (-9, {"scene.xml": b"s"}, "scene.xml, which is read, is another one"),
        (1, {}, "status 1"),
    ],
)
def test_what_is_lost_is_noticed(status, changed, said):
    found = {name: content for name, content in (FILES | changed).items() if content is not None}
    ended = Ended(status, 1.0, "")
    wrong = list(faults.wrong_results(ended, WHOLE, found, set(WHOLE.results), "KILL"))
    assert [said in line for line in wrong] == [True] if said else wrong == []


def test_a_trial_can_be_had_again():
    jobs = sorted(faults.JOBS)
    trials = [faults.drawn(0, number, jobs) for number in range(1, 201)]
    assert trials[16] == faults.drawn(0, 17, jobs)
    assert {trial.job for trial in trials} >= set(jobs) - {"paper"}
    assert {trial.fault for trial in trials} == set(faults.FAULTS)
