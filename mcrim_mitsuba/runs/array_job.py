"""Units without a scheduler: each process of an array job makes its part, then all are merged.

All processes share one folder. It holds the units, as the cache does; the command that all are
parts of (``command.json``); and, per part that is done, ``part-K-of-N.json``.
"""

from __future__ import annotations

import json
import os
import re
import socket
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import is_there, read_text, write_text
from mcrim_mitsuba.runs.cache import RecordCache
from mcrim_mitsuba.runs.cache_files import Chunk
from mcrim_mitsuba.runs.executors import Executor, Finished, Job, kept

#: Where the units of an array job lie, if not told otherwise.
DEFAULT_FOLDER = "mcrim_units"
MOST_PARTS = 100_000
_COMMAND = "command.json"
_LIMIT_MB = 1


@dataclass(frozen=True)
class ArrayPart:
    """Which part of how many: ``3/10``."""

    #: From 1.
    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> ArrayPart:
        """Of what is typed; raises InputError."""
        match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text.strip(), re.ASCII)
        if match and 1 <= int(match[1]) <= int(match[2]) <= MOST_PARTS:
            return cls(int(match[1]), int(match[2]))
        mend = f"write K/N with K from 1 to N and N up to {MOST_PARTS:,}, such as 3/10"
        raise InputError(f"--unit {text} is no part of an array job", mend)

    @property
    def report(self) -> str:
        """Name of the file that says that the part is done."""
        return f"part-{self.number}-of-{self.count}.json"


class PartDoneError(Exception):
    """This process has done its part of an array job: there is no result yet."""

    def __init__(self, units: int, photons: int) -> None:
        super().__init__(units, photons)
        #: That this process has made.
        self.units, self.photons = units, photons


class UnitFolder:
    """The folder that the processes of an array job share."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def begin(self, command: Mapping[str, Any], part: ArrayPart) -> None:
        """Note the command, or see that it is the one that the other parts have.

        Raises InputError if the folder holds parts of something else, or cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            problem = f"the units cannot lie there ({error.strerror})"
            raise InputError(problem, "let --units name a folder", path=self.path) from None
        mine = {**command, "parts": part.count}
        if not is_there(self.path / _COMMAND):
            # unless another process is first: then its file stays
            new = f"{_COMMAND}.{uuid.uuid4().hex}"
            self.write(new, mine)
            try:
                os.link(self.path / new, self.path / _COMMAND)
            except FileExistsError:
                pass
            except OSError:  # a file system without links
                os.replace(self.path / new, self.path / _COMMAND)
            (self.path / new).unlink(missing_ok=True)
        if {**self.command(), "files": mine["files"]} != mine:
            problem = "the folder holds parts of another command, or of another number of parts"
            mend = "let --units name a new folder, or remove this one"
            raise InputError(problem, mend, path=self.path)
        self.refuse_other_files(mine["files"])

    def refuse_other_files(self, hashes: Mapping[str, str]) -> None:
        """Raise InputError if the parts have read other files, or these with other contents.

        `hashes` are SHA-256 (hexadecimal) of files that this process reads, by name.
        """
        before = self.command()["files"]
        for file in sorted({*before, *hashes}):
            if before.get(file) != hashes.get(file):
                theirs, now = (files.get(file, "no such file")[:12] for files in (before, hashes))
                problem = f"the parts have read another {file} (SHA-256 {theirs}; here is {now})"
                mend = "put it back, or let --units name a new folder and run all parts again"
                raise InputError(problem, mend, path=self.path)

    @property
    def files(self) -> list[Path]:
        """What the parts have in it; of units their folders."""
        units = {chunk.parent for chunk in self.path.glob("*/*.chunk")}
        return [self.path / _COMMAND, *self.path.glob("part-*-of-*.json"), *units]

    def command(self) -> dict[str, Any]:
        """What all are parts of.

        Raises InputError if the folder holds no array job, or what no part has written.
        """
        path = self.path / _COMMAND
        if not is_there(path):
            mend = "run its parts first: mcrim VERB ... --unit 1/N --units FOLDER"
            raise InputError("there is no array job here", mend, path=self.path)
        try:
            content = json.loads(read_text(path, _LIMIT_MB))
        except (ValueError, RecursionError):  # numbers of thousands of digits, as many brackets
            content = None
        if not _is_command(content):
            problem = "the file is damaged"
            raise InputError(problem, "remove the folder and run the parts again", path=path)
        return content

    def missing(self) -> list[int]:
        """Parts that are not done."""
        parts = self.command()["parts"]
        numbers = range(1, parts + 1)
        return [k for k in numbers if not is_there(self.path / ArrayPart(k, parts).report)]

    def write(self, name: str, content: Mapping[str, Any]) -> None:
        """Write one of the folder's files; raises InputError as `write_text`."""
        write_text(self.path / name, json.dumps(content, indent=1) + "\n")


class MergingExecutor(Executor):
    """This process, with the units that the parts of an array job have made."""

    def __init__(self, folder: UnitFolder) -> None:
        self.folder = folder

    def cache(self, key: Mapping[str, object]) -> RecordCache:
        return RecordCache(key, self.folder.path, limited=False)


class PartExecutor(MergingExecutor):
    """One process of an array job: makes every N-th unit of each stage, and then is done."""

    def __init__(self, folder: UnitFolder, part: ArrayPart) -> None:
        super().__init__(folder)
        self._part = part
        #: Made so far.
        self.units = self.photons = 0

    def do(self, jobs: Sequence[Job], *, by_all: bool = False, **how: Any) -> Iterator[Finished]:
        """See `Executor.do`; raises PartDoneError where other parts' units are missing."""
        mine = jobs if by_all else jobs[self._part.number - 1 :: self._part.count]
        for _ in super().do(mine, **how):
            pass
        for index, job in enumerate(jobs):
            chunks = kept(job)
            if chunks is None:
                raise self.done
            yield Finished(index, job, chunks, cached=True)

    def make(self, job: Job, threads: int | None) -> dict[int, Chunk]:
        chunks = super().make(job, threads)
        if job.cache.trouble is not None:
            mend = "free or unlock this place, and run this part again"
            raise InputError("a unit would be lost", mend, path=job.cache.trouble)
        self.units, self.photons = self.units + 1, self.photons + job.unit.photons
        return chunks

    @property
    def done(self) -> PartDoneError:
        """What this process has done."""
        return PartDoneError(self.units, self.photons)

    def finish(self) -> None:
        """Note in the folder that this part is done."""
        report = {"units": self.units, "photons": self.photons, "host": socket.gethostname()}
        self.folder.write(self._part.report, report)


def _is_command(content: Any) -> bool:
    """Whether it is what `UnitFolder.begin` writes."""
    match content:
        case {
            "arguments": list(arguments),
            "folder": folder,
            "versions": {"variant": _} as versions,
            "files": dict(files),
            "parts": parts,
        }:
            texts = (*arguments, folder, *versions.values(), *files.values())
            return type(parts) is int and 1 <= parts <= MOST_PARTS and all(map(_is_text, texts))
    return False


def _is_text(value: Any) -> bool:
    """Whether a command line can have it."""
    try:
        return isinstance(value, str) and b"\0" not in os.fsencode(value)
    except UnicodeEncodeError:
        return False
