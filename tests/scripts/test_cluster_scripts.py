"""`scripts/cluster.py` starts a cluster for one command; shell scripts play batch systems."""

import os
import subprocess
import sys

import pytest
from places import SCRIPTS

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


def run(*arguments: str, env=None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPTS / "cluster.py"), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=100, env={**os.environ, **(env or {})}
    )


def eta_line(text: str) -> str:
    """The result without what it took."""
    return next(line for line in text.splitlines() if line.startswith("eta = ")).split("(")[0]


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_command_on_a_batch_system(system, scenes, tmp_path, mcrim):
    submit, content, cancel = SYSTEMS[system]
    for name, text in ((submit, content), (cancel, CANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    fake = {"FAKE": str(tmp_path), "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = run(
        system,
        *"--jobs 1 --cores 1 --memory 2GB --".split(),
        *SIMULATE,
        str(scenes / "camoo4.xml"),
        env=fake,
    )
    log = tmp_path / "job.out"
    assert done.returncode == 0, done.stderr + (log.read_text() if log.exists() else "no job")
    assert eta_line(done.stdout) == eta_line(mcrim.shown(*SIMULATE, scenes / "camoo4.xml"))


def test_without_a_batch_system_one_line(scenes):
    done = run(
        "slurm",
        "--jobs",
        "1",
        "--",
        *SIMULATE,
        str(scenes / "camoo4.xml"),
        env={"PATH": "/nowhere"},
    )
    line = "cluster: there is no command sbatch here; run this where jobs can be submitted\n"
    assert (done.returncode, done.stderr) == (2, line)


def test_a_job_can_be_looked_at_beforehand():
    done = run("slurm", "--show", "--cores", "3", "--queue", "short", "--", "paper")
    assert done.returncode == 0
    assert "#SBATCH -p short" in done.stdout and "--nworkers 3" in done.stdout


def test_a_command_on_this_machine(scenes):
    done = run("local", "--workers", "1", "--", "check", str(scenes / "camoo4.xml"))
    assert done.returncode == 2 and "--cluster" in done.stderr  # has no use for a cluster
    done = run("local", "--workers", "1", "--", "mcrim", *SIMULATE, str(scenes / "camoo4.xml"))
    assert done.returncode == 0 and eta_line(done.stdout), done.stderr
