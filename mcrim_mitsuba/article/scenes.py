"""Where the article's scenes lie."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from mcrim_mitsuba.errors import InputError


def scene_path(name: str) -> Path:
    """Path of a scene file that ships with the package.

    An installed wheel has the scenes inside the package, a checkout next to it.

    Parameters
    ----------
    name : str
        File name, e.g. ``camoo4.xml``.

    Raises
    ------
    InputError
        If neither place has it.
    """
    package = Path(str(files("mcrim_mitsuba")))
    for folder in (package / "scenes", package.parent / "scenes"):
        if (folder / name).is_file():
            return folder / name
    raise InputError(
        f"the scene {name} is not installed", "reinstall the package: its scenes are missing"
    )
