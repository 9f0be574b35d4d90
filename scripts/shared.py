"""What several scripts share."""

from __future__ import annotations

import contextlib
import functools
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mcrim_mitsuba
from mcrim_mitsuba import effects, reference
from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import is_there, read_text, sha256
from mcrim_mitsuba.core.run import Progress, Provenance
from mcrim_mitsuba.efficiency import bench
from mcrim_mitsuba.efficiency.table import EtaTable
from mcrim_mitsuba.runs.cache import without_comments

SCENES = Path(__file__).resolve().parents[1] / "scenes"
#: The article's bench.
SCENE = SCENES / "camoo4.xml"
#: What became of a job, and the columns of its row.
MADE, KEPT, REFUSED, FAILED = "made", "kept", "refused", "failed"
Row = dict[str, Any]
_LIMIT_MB = 200
#: How the bench is told to Geant4, which knows no scenes; programs, and who makes their scenes.
_BENCH_CODE = Path(bench.__file__)
_TRACER = Path(reference.__file__).parent.glob("*.py")
_EFFECTS = Path(effects.__file__).parent.glob("*.py")
TRACER_CODE = [
    *(file for file in _TRACER if file.stem != "crosscheck"),
    *_EFFECTS,
    Path(__file__).with_name("bench_scene.py"),
]
GEANT4_CODE = [*Path(__file__).parent.glob("geant4*.py"), _BENCH_CODE]


def markdown(head: Sequence[str], rows: Iterable[Sequence], right: Iterable[int] = ()) -> list[str]:
    """Lines of a table in Markdown; the numbered columns are aligned to the right."""
    rule = ["---:" if column in right else "---" for column in range(len(head))]
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (head, *rows)]
    return [lines[0].replace("|  |", "| |"), f"|{'|'.join(rule)}|", *lines[1:]]


def fraction_error(k: int, n: int) -> float:
    """Standard deviation of k / n under a uniform prior: never 0."""
    return math.sqrt((k + 1) * (n - k + 1) / ((n + 2) ** 2 * (n + 3)))


def refuse_foreign(file: Path, is_ours: Callable[[str], bool]) -> None:
    """Refuse to replace a file unless its text is ours; what a power cut has left is nobody's."""
    if not is_there(file) or not file.stat().st_size:
        return
    with contextlib.suppress(InputError):  # of what cannot be read
        if is_ours(read_text(file, _LIMIT_MB)):
            return
    raise InputError(
        "there is a file of this name, and it is no result of this script",
        "name another place, or move the file away",
        path=file,
    )


def status_of(found: EtaTable | Provenance) -> str:
    """Whether anything had to be simulated."""
    return KEPT if found.cached_photons == found.photons else MADE


def counted(benches: int, what: str = "") -> Iterator[int]:
    """Numbers of so many benches, told on a screen where somebody looks at it when each is done."""
    for number in range(benches):
        yield number
        if sys.stderr.isatty():
            print(f"\r{what}{number + 1} of {benches} benches", end="", file=sys.stderr)


def one_after_another(
    what: str,
    paths: Sequence[Path],
    do: Callable[[Path, Progress], Row],
    place: str | Path,
    log: str | None,
    told: Callable[[Mapping[Path, Row]], None] = lambda rows: None,
) -> int:
    """Do a job for each path, a line each; what is refused or fails does not stop the others.

    A job's row has its ``status`` and ``result``, or the ``reason`` why there is none; all rows so
    far are `told`. Returns the exit status.
    """
    screen, rows = terminal.console(), dict[Path, Row]()
    try:
        with terminal.photon_progress(log=log) as report:
            for path in paths:
                report(what, len(rows), len(paths), str(path))

                def progress(part: str, *far: Any, name: str = path.stem) -> None:
                    report(f"{name}: {part}", *far)

                try:
                    rows[path] = do(path, progress)
                except InputError as error:
                    rows[path] = {"status": REFUSED, "reason": str(error)}
                except Exception as error:  # ours
                    reason = " ".join(f"{type(error).__name__}: {error}".split())
                    rows[path] = {"status": FAILED, "reason": reason}
                told(rows)
                row = rows[path]
                screen.line(f"{path}: {row['status']}: {row.get('reason') or row['result']}")
    except KeyboardInterrupt:
        screen.say(
            f"interrupted after {len(rows)} of {len(paths)}; the same line goes on from here"
        )
        return terminal.INTERRUPTED
    count = Counter(row["status"] for row in rows.values())
    words = ", ".join(f"{count[one]} {one}" for one in (MADE, KEPT, REFUSED, FAILED) if count[one])
    screen.line(f"{len(rows)} {what}: {words}; {place}")
    ours, yours = terminal.OUR_FAULT, terminal.YOUR_INPUT
    return ours if FAILED in count else yours if REFUSED in count else terminal.DONE


def source_hash(files: Iterable[Path]) -> str:
    """SHA-256 (hexadecimal) of files; of Python ones no comments, docstrings and empty lines."""
    parts = list[str]()
    for file in sorted(files):
        text = file.read_text(encoding="utf-8")
        parts += [file.name, without_comments(text) if file.suffix == ".py" else text]
    return sha256("\n".join(parts).encode())


@functools.cache
def package_hash() -> str:
    """`source_hash` of the package but its commands."""
    package = Path(mcrim_mitsuba.__file__).parent
    files = [*package.rglob("*.py"), *package.rglob("*.toml")]
    return source_hash(f for f in files if "cli" not in f.relative_to(package).parts)
