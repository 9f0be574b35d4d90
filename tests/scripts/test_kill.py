"""A job that is killed goes on, and `scripts/trials kill`, which kills many, notices if not."""

import signal
from dataclasses import replace

import pytest
from trials import kill


def test_a_table_that_is_killed_goes_on(scenes, tmp_path, monkeypatch):
    """Seven units, killed with SIGKILL when the log of the second run tells that two are made."""
    job = kill.Job(
        [
            "table",
            str(scenes / "camoo4.xml"),
            *"--alpha-scat 0.2,0.5 --alpha-abs 0.039 --n-gap 1.2:1.5:7".split(),
            *"--photons 131072 --threads 1".split(),
        ],
        tmp_path,
        signal.SIGKILL,
    )
    whole = job.run(job.cache("whole"))
    assert len(whole.log.made) == 7 and not whole.log.kept and not whole.log.lost
    cache = job.cache("killed")
    # not at a processor time: what the first run alone had to compile is no measure of the second
    monkeypatch.setattr(kill, "_processor_s", lambda _: len(kill.Log.read(tmp_path / "2.log").made))
    killed = job.run(cache, moment := 2)
    before = kill.files(cache)
    assert killed.status == -signal.SIGKILL
    assert 2 <= len(killed.log.made) < 7 and 2 <= len(before) < 7
    again = job.run(cache)
    row = kill.row_of(1, moment, killed, before, again, kill.files(cache), whole)
    assert row.as_wanted(processes=1)
    assert set(again.log.kept) >= set(killed.log.made)
    assert set(again.log.made) | set(again.log.kept) == set(whole.log.made)
    # what the trial would say of a job that forgets what it has done, or gives another result
    forgot = kill.row_of(1, moment, whole, before, whole, {}, whole)
    assert forgot.remade == 7 and not forgot.as_wanted(processes=1)
    changed = replace(again, said=again.said.replace('"eta": 0.', '"eta": 0.0', 1))
    row = kill.row_of(1, moment, killed, before, changed, kill.files(cache), whole)
    assert row.same is False and not row.as_wanted(processes=1)


def test_a_log_that_was_cut_short(tmp_path):
    file = tmp_path / "log"
    file.write_text(
        "2026-11-22T06:10:00Z unit 1 of 3 kept, a1-1\n"
        "2026-11-22T06:10:00Z unit 2 of 3 begun, a1-2\n"
        "2026-11-22T06:10:01Z unit 2 of 3 made, 262144 photons, a1-2\n"
        "2026-11-22T06:10:01Z gel: 2.6e+05 of 5e+05 photons, 2 of 3 units\n"
        "2026-11-22T06:10:01Z unit 3 of 3 begun, a1-3\n"
        "2026-11-22T06:10:02Z unit 3 of 3 made, 262144 photons, a1"
    )
    log = kill.Log.read(file)
    assert (log.kept, log.made, log.lost) == ({"a1-1"}, {"a1-2": 262144}, {"a1-3"})
    assert kill.Log.read(tmp_path / "none").begun == set()


@pytest.mark.parametrize(
    ("line", "same"),
    [('  "seconds": 2.5,', True), ('  "cached_photons": 3', True), ('  "eta": 0.25,', False)],
)
def test_what_of_a_result_may_differ(line, same):
    texts = ['{\n  "seed": 0,\n' + each + "\n}\n" for each in (line, line.replace("5", "4"))]
    texts[1] = texts[1].replace("3", "7")
    assert (kill.lasting(texts[0]) == kill.lasting(texts[1])) is same
