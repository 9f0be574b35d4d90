"""A night's batch of campaigns: each in a process of its own, so that none can stop the others."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcrim_mitsuba.cli.showing import read_with_files
from mcrim_mitsuba.cli.terminal import DONE, INTERRUPTED, YOUR_INPUT
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import json_text, read_text, resolved, write_text
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.run import DEFAULT_VARIANT
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.output.result_reading import read_results
from mcrim_mitsuba.output.result_writing import DIAGNOSIS, RESULT, SIGMA, Cell, cells_text
from mcrim_mitsuba.runs.cache import hashes, key_of

VERBS = ("calibrate", "diagnose", "report")
SUMMARY = "summary.csv"
COLUMNS = (
    "campaign", "status", "verdict", "leading", "chi2", "ndf", "p_value", ALPHA_SCAT,
    ALPHA_SCAT + SIGMA, LIGHT_YIELD, LIGHT_YIELD + SIGMA, RESULT, "reason",
)  # fmt: skip
#: What became of a campaign.
STATUSES = MADE, KEPT, REFUSED, FAILED = "made", "kept", "refused", "failed"
_LIMIT_MB = 200
#: Options of a verb that its result does not depend on.
_NO_MATTER = ("threads", "log")
_DEFAULTS = {"photons": None, "seed": 0, "variant": DEFAULT_VARIANT, "threads": None, "log": None}


@dataclass(frozen=True)
class CampaignJob:
    """One campaign of a batch."""

    campaign: Path
    #: One of `VERBS`.
    verb: str
    #: The JSON; the report lies beside it as HTML.
    result: Path
    #: ``photons``, ``seed``, ``variant``, ``threads`` and ``log`` of the verb.
    options: dict[str, Any]

    @property
    def report(self) -> Path:
        """Where the report of the campaign goes."""
        return self.result.with_suffix(".html")

    def key(self) -> str:
        """Of the campaign's files, what is done with them, and the software; raises InputError."""
        read, files = read_with_files(str(self.campaign))
        if read.effects_folder is not None:
            files = [*files, *sorted(read.effects_folder.glob("*.py"))]
        own = {name: value for name, value in self.options.items() if name not in _NO_MATTER}
        return key_of(verb=self.verb, files=hashes(files), scene=read.scene.content_hash, **own)

    def is_done(self, key: str) -> bool:
        """Whether the result of just this is there."""
        if not self.result.is_file() or (self.verb == "report" and not self.report.is_file()):
            return False
        try:
            content = json.loads(read_text(self.result, _LIMIT_MB))
        except (ValueError, RecursionError):  # an InputError, too
            return False
        return isinstance(content, dict) and content.get("batch") == {"key": key}

    def refuse_place(self) -> None:
        """Refuse to replace files that are no results of a batch; raises InputError."""
        files = [self.result, self.report] if self.verb == "report" else [self.result]
        _refuse_foreign(files, lambda text: '"batch": {' in text)

    def make(self, key: str) -> tuple[str, str]:
        """Run the verb; gives what became of it, and why in one line.

        Raises
        ------
        KeyboardInterrupt
            If it was interrupted.
        InputError
            If the result cannot be written.
        """
        words = [self.verb, str(self.campaign), "--json", "-"]
        for name, value in self.options.items():
            words += [f"--{name}", str(value)] if value is not None else []
        if self.verb == "report":
            words += ["--output", str(self.report)]
        # -P: modules that lie about in the folder are none of ours
        done = subprocess.run(
            [sys.executable, "-P", "-m", "mcrim_mitsuba", *words],
            capture_output=True, stdin=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        if done.returncode == INTERRUPTED:
            raise KeyboardInterrupt
        if done.returncode != DONE:
            status = REFUSED if done.returncode == YOUR_INPUT else FAILED
            return status, _reason(done.stderr.decode(errors="replace"), done.returncode)
        content = json.loads(done.stdout)
        document = {**content, "batch": {"key": key}}
        write_text(self.result, json_text(document, indent=2) + "\n")
        return MADE, ""


def campaign_jobs(
    campaigns: Sequence[str | Path], verb: str, folder: Path, **options: Any
) -> list[CampaignJob]:
    """Jobs with results named after the campaigns, and after their folders where needed.

    Parameters
    ----------
    campaigns : sequence of str or Path
    verb : str
    folder : Path
        Of the results.
    **options
        As `CampaignJob` has them; the verb's own where not given.

    Raises
    ------
    InputError
        If two results would have the same name.
    """
    paths = list({resolved(Path(campaign)): Path(campaign) for campaign in campaigns}.values())
    stems = [path.stem for path in paths]
    jobs: dict[Path, CampaignJob] = {}
    for path in paths:
        alone = stems.count(path.stem) == 1
        name = path.stem if alone else f"{resolved(path).parent.name}_{path.stem}"
        result = folder / f"{name}.json"
        if result in jobs:
            problem = f"two results would be written to {result}"
            raise InputError(problem, "give the campaigns different names or folders", path=path)
        jobs[result] = CampaignJob(path, verb, result, _DEFAULTS | options)
    return list(jobs.values())


def refuse_summary(path: Path) -> None:
    """Refuse to replace a file that is no summary of a batch; raises InputError."""
    _refuse_foreign([path], lambda text: text.startswith(",".join(COLUMNS)))


def _refuse_foreign(files: Sequence[Path], is_ours: Callable[[str], bool]) -> None:
    """Refuse to replace files unless the text of the first is ours, or there is none."""
    try:
        ours = is_ours(read_text(files[0], _LIMIT_MB))
    except InputError:  # none, or nobody's
        ours = not files[0].exists()
    for file in files:
        if not ours and file.exists() and file.stat().st_size:
            problem = "there is a file of this name, and it is no result of this script"
            raise InputError(problem, "name another folder, or move the file away", path=file)


def do(job: CampaignJob) -> dict[str, Cell]:
    """Do a job, unless it is done; gives its row of the summary, `COLUMNS` by name."""
    row: dict[str, Cell] = {"campaign": str(job.campaign)}
    try:
        key = job.key()
        status, reason = (KEPT, "") if job.is_done(key) else job.make(key)
        if status in (MADE, KEPT):
            row |= _findings(job) | {"result": str(job.result)}
    except InputError as error:
        status, reason = REFUSED, str(error)
    except Exception as error:  # the other campaigns go on
        status, reason = FAILED, " ".join(f"{type(error).__name__}: {error}".split())
    return row | {"status": status, "reason": reason}


def summary_text(rows: Sequence[dict[str, Cell]]) -> str:
    """The summary as CSV: a campaign a row."""
    return cells_text(COLUMNS, rows)


def _findings(job: CampaignJob) -> dict[str, Cell]:
    """What the summary says of a result; of a diagnosis the fit without further effects."""
    content = json.loads(read_text(job.result, _LIMIT_MB))
    table = read_results([job.result])
    row = dict(table.rows[0])
    if table.kind == DIAGNOSIS and (known := content["baseline"]["parameters"].get(ALPHA_SCAT)):
        row[ALPHA_SCAT] = known["value"]
        row[ALPHA_SCAT + SIGMA] = None if known["at_bound"] else known["sigma"]
    found = {name: row[name] for name in COLUMNS if name in row and name != RESULT}
    leading = " or ".join(content.get("leading", ()))
    return found | {"verdict": content.get("verdict"), "leading": leading}


def _reason(stderr: str, status: int) -> str:
    """The line that says what was wrong."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    if status < 0:
        return f"the process was killed by signal {-status}"
    if status == YOUR_INPUT and lines:
        return lines[-1].removeprefix("mcrim: ")
    # the exception, which the line to the user comes after
    return lines[-2] if len(lines) > 1 else f"exit status {status}"
