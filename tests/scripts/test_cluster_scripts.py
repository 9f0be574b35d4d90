"""`scripts/cluster.py` starts a cluster for one command; shell scripts play batch systems."""

import os
import subprocess
import sys

import cluster
import pytest
from places import SCRIPTS

from mcrim_mitsuba.cli import terminal

#: What Slurm and HTCondor do with a job, as far as the scripts can see.
SBATCH = """#!/bin/sh
for job; do :; done
cp "$job" "$FAKE/job.sh"
setsid sh "$FAKE/job.sh" > "$FAKE/job.out" 2>&1 &
echo $! > "$FAKE/pid"
echo "Submitted batch job 4711"
"""
CONDOR = """#!/bin/sh
for job; do :; done
sed -n "s/^Arguments = \\"-c '\\\\(.*\\\\)'\\"$/\\\\1/p" "$job" | sed "s/''/'/g" > "$FAKE/job.sh"
setsid sh "$FAKE/job.sh" > "$FAKE/job.out" 2>&1 &
echo $! > "$FAKE/pid"
echo "1 job(s) submitted to cluster 4711."
"""
CANCEL = """#!/bin/sh
kill -- "-$(cat "$FAKE/pid")"
"""
SYSTEMS = {
    "slurm": ("sbatch", SBATCH, "scancel"),
    "htcondor": ("condor_submit", CONDOR, "condor_rm"),
}
SIMULATE = ["simulate", "--photons", "3e5", "--seed", "2"]


@pytest.fixture
def run(capsys):
    """The script in this process: exit status, standard output and error."""

    def run(*arguments: object):
        status = terminal.run(cluster.main, "cluster", [str(word) for word in arguments])
        return status, *capsys.readouterr()

    return run


def eta_line(text: str) -> str:
    """The result without what it took."""
    return next(line for line in text.splitlines() if line.startswith("eta = ")).split("(")[0]


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_command_on_a_batch_system(system, scenes, tmp_path, monkeypatch, mcrim, run):
    submit, content, cancel = SYSTEMS[system]
    for name, text in ((submit, content), (cancel, CANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("FAKE", str(tmp_path))
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    command = [*SIMULATE, scenes / "camoo4.xml"]
    status, out, err = run(system, *"--jobs 1 --cores 1 --memory 2GB --".split(), *command)
    log = tmp_path / "job.out"
    assert status == 0, err + (log.read_text() if log.exists() else "no job")
    assert eta_line(out) == eta_line(mcrim.shown(*command))


def test_without_a_batch_system_one_line(scenes, monkeypatch, run):
    monkeypatch.setenv("PATH", "/nowhere")
    line = "cluster: there is no command sbatch here; run this where jobs can be submitted\n"
    assert run("slurm", "--jobs", "1", "--", *SIMULATE, scenes / "camoo4.xml") == (2, "", line)


def test_a_job_can_be_looked_at_beforehand(run):
    status, out, _ = run(*"slurm --show --cores 3 --queue short -- paper".split())
    assert status == 0 and "#SBATCH -p short" in out and "--nworkers 3" in out


def test_a_command_on_this_machine(scenes, run):
    words = "local", "--workers", "1", "--"
    status, _, err = run(*words, "check", scenes / "camoo4.xml")
    assert status == 2 and "--cluster" in err  # has no use for a cluster
    # as a program
    line = [sys.executable, SCRIPTS / "cluster.py", *words, "mcrim", *SIMULATE]
    done = subprocess.run(
        [*line, scenes / "camoo4.xml"], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0 and eta_line(done.stdout), done.stderr
