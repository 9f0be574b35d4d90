"""Trials: each depends on its number alone, and is kept in a file of its own when it is done.

Interrupted or killed, the same call goes on from there, to the same results. The processes of an
array job each do a part; afterwards the same call without a part finds all of them.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcrim_mitsuba.batch.hands import Hands
from mcrim_mitsuba.batch.tables import make_folder
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import read_text, write_text
from mcrim_mitsuba.core.run import Progress
from mcrim_mitsuba.runs.cache import cache_folder
from mcrim_mitsuba.runs.executors import log
from mcrim_mitsuba.runs.keys import trial_key

_LIMIT_MB = 200


@dataclass(frozen=True)
class Trial:
    """One trial."""

    #: Good for the name of a folder.
    kind: str
    #: What its random numbers depend on, beside the kind and what all trials have in common.
    number: int

    def __str__(self) -> str:
        return f"{self.kind} {self.number}"


class Trials:
    """Trials that are wanted, and those that are done.

    Parameters
    ----------
    name : str
        Of the script, good for the name of a folder.
    parameters : dict
        What all trials have in common, of what JSON can hold.
    wanted : sequence of Trial
    code : iterable of Path
        Python files that the results depend on, beside this package.
    hands : Hands

    Attributes
    ----------
    missing : list of Trial
        Those that are not done, of this part.
    results : dict of Trial to object
        As JSON gives them back.

    Raises
    ------
    InputError
        If the trials of a part would not be kept.
    """

    def __init__(
        self, name: str, parameters: dict[str, Any], wanted: Sequence[Trial],
        code: Sequence[Path], hands: Hands,
    ) -> None:  # fmt: skip
        self._key, self._hands = trial_key(name, parameters, code), hands
        cache = cache_folder()
        place = hands.folder or (cache and cache / "trials")
        if hands.part != (1, 1) and place is None:
            raise InputError("a part's trials must be kept", "name a folder by --units")
        self._folder = place and place / f"{name}-{self._key[:12]}"
        self._wanted = list(wanted)
        kept = {trial: self._read(trial) for trial in wanted}
        self.results = {trial: found for trial, found in kept.items() if found is not None}
        self.missing = [trial for trial in hands.share(wanted) if trial not in self.results]

    @property
    def elsewhere(self) -> int:
        """Trials that other parts have to do."""
        return len(self._wanted) - len(self.results) - len(self.missing)

    def state(self) -> str:
        """How many are done, in words."""
        done, total = len(self.results), len(self._wanted)
        words = f"{done} of {total} trials done"
        if self.elsewhere:
            return f"{words}; the same line without --unit goes on when the other parts are done"
        return f"{words}; the same line goes on from here"

    def do(
        self,
        function: Callable[..., Any],
        arguments: Mapping[Trial, tuple],
        report: Progress = lambda what, done, total, note="": None,
        found: Callable[[Trial, Any], None] = lambda trial, result: None,
    ) -> list[str]:
        """Do missing trials, and keep each as soon as it is done.

        Parameters
        ----------
        function : callable
            Gives what JSON can hold, never None; found by its name in its module.
        arguments : mapping of Trial to tuple
            Of the trials to do.
        report : callable
            ``report("trials", done, total)``.
        found : callable
            Told of each trial as it ends.

        Returns
        -------
        list of str
            Why others have failed; nothing is kept of those.

        Raises
        ------
        InputError
            If a trial cannot be kept, or there is no such cluster.
        KeyboardInterrupt
            If it was interrupted, with how many are done, in words.
        RuntimeError
            As `Hands.outcomes`.
        """
        failures = []
        waiting = [trial for trial in arguments if trial not in self.results]
        total = len(self.results) + len(waiting)
        report("trials", len(self.results), total)
        work = {trial: arguments[trial] for trial in waiting}
        with contextlib.closing(self._hands.outcomes(function, work)) as outcomes:
            try:
                for trial, result, failure in outcomes:
                    how = "made" if failure is None else f"failed: {failure}"
                    log.info("trial %s %s", trial, how)
                    if failure is not None:
                        failures.append(f"{trial}: {failure}")
                        continue
                    # as it will be read: tuples have become lists
                    text = json.dumps(result)
                    self._write(trial, text)
                    self.results[trial] = json.loads(text)
                    self.missing = [other for other in self.missing if other != trial]
                    found(trial, self.results[trial])
                    report("trials", len(self.results), total)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(f"interrupted: {self.state()}") from None
        return failures

    def _file(self, trial: Trial) -> Path:
        assert self._folder is not None
        return self._folder / f"{trial.kind}-{trial.number:06d}.json"

    def _read(self, trial: Trial) -> Any:
        """What was kept; None where that is nothing, or damaged."""
        if self._folder is None or not self._file(trial).is_file():
            return None
        try:
            content = json.loads(read_text(self._file(trial), _LIMIT_MB))
            text = json.dumps(content["result"])
            sound = (content["key"], content["sha256"]) == (self._key, _digest(text))
        except (ValueError, KeyError, TypeError):  # an InputError, too
            return None
        return content["result"] if sound else None

    def _write(self, trial: Trial, text: str) -> None:
        if self._folder is not None:
            make_folder(self._folder)
            head = f'{{"key": "{self._key}", "sha256": "{_digest(text)}"'
            write_text(self._file(trial), f'{head},\n "result": {text}}}\n')


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
