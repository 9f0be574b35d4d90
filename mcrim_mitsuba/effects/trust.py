"""Whose Python runs: a folder of effects is a program, and campaigns come from others too.

A campaign's folder is executed when its user has said so, for these very files: what was said is
kept by their content, in the user's own configuration. The package's own example needs no word.
"""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path

import platformdirs

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import read_bytes, read_text, write_text
from mcrim_mitsuba.scene.shipped import scenes_folder

_LIMIT_MB = 1
_SHIPPED = "own_effects"
_allowed_now: set[str] = set()


class UntrustedEffectsError(InputError):
    """A folder of effects that nobody has allowed to be executed; `folder` is the one."""

    folder: Path


def fingerprint(folder: Path) -> str:
    """SHA-256 (hexadecimal) of the names and contents of its Python files."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        content = read_bytes(path, _LIMIT_MB)
        digest.update(f"{path.name}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def refuse_untrusted(folder: Path, path: str | None = None, line: int | None = None) -> None:
    """Refuse (UntrustedEffectsError with this place) a folder that its user has not allowed."""
    content = fingerprint(folder)
    if content in _allowed_now or content in {fingerprint(scenes_folder() / _SHIPPED), *_kept()}:
        return
    names = ", ".join(sorted(file.name for file in folder.glob("*.py")))
    if not names:  # nothing would be: that no effect is there is the catalogue's to say
        return
    problem = f"the Python in {folder} would be executed ({names})"
    mend = "read these files; then say --trust-effects, or trust_effects=True in Python"
    error = UntrustedEffectsError(problem, mend, path=path, line=line)
    error.folder = folder
    raise error


def execute_allowed(folder: str | Path | None, *, trusted: bool) -> None:
    """Refuse an untrusted folder; one that is `trusted` by its user, or is none, is let through."""
    if folder is None or not Path(folder).is_dir():
        return
    if trusted:
        trust(Path(folder))
    refuse_untrusted(Path(folder))


def trust(folder: Path, *, keep: bool = False) -> None:
    """Allow a folder's files, as they are now, to be executed; for good where they are to be kept.

    What cannot be kept, as in a home that is read-only, holds for this process.
    """
    content = fingerprint(folder)
    _allowed_now.add(content)
    if keep:
        kept = "".join(f"{line}\n" for line in sorted({*_kept(), content}))
        with contextlib.suppress(InputError, OSError):
            _place().parent.mkdir(parents=True, exist_ok=True)
            write_text(_place(), kept)


def whose(folder: Path) -> str:
    """Which code was executed, for the notes of results."""
    names = ", ".join(sorted(file.name for file in folder.glob("*.py")))
    return (
        f"effects of the campaign's own were executed: {names} in {folder}, SHA-256 "
        f"{fingerprint(folder)[:16]}"
    )


def _place() -> Path:
    return platformdirs.user_config_path("mcrim_mitsuba", appauthor=False) / "trusted_effects.txt"


def _kept() -> set[str]:
    try:
        return set(read_text(_place(), _LIMIT_MB).split())
    except InputError:
        return set()
