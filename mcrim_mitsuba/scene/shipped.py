"""Where the article's scenes lie, with their campaigns and measurements; and copies of them."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import differs, make_folder, write_bytes


def scenes_folder() -> Path:
    """Folder of what ships: in an installed wheel, or next to it; InputError if there is none."""
    package = Path(str(files("mcrim_mitsuba")))
    for folder in (package / "scenes", package.parent / "scenes"):
        if (folder / "camoo4.xml").is_file():
            return folder
    raise InputError("the article's scenes are not installed", "reinstall the package")


def scene_path(name: str) -> Path:
    """Path of a scene that ships, such as ``camoo4.xml``; InputError if it is not there."""
    path = scenes_folder() / name
    if not path.is_file():
        mend = "reinstall the package: its scenes are missing"
        raise InputError(f"the scene {name} is not installed", mend)
    return path


def scene_files() -> tuple[Path, ...]:
    """All that ships: paths below `scenes_folder` (errors as there), subfolders' last."""
    folder = scenes_folder()
    there = (path for path in folder.rglob("*") if path.is_file())
    names = (path.relative_to(folder) for path in there if "__pycache__" not in path.parts)
    return tuple(sorted(names, key=lambda path: (len(path.parts), path.parts)))


def copy_scenes(target: str | Path) -> tuple[Path, ...]:
    """Copy all that ships into a folder, made if need be, to be edited; where the copies lie.

    Raises InputError if something else is there under the name of one of the files, or if the
    folder cannot be written; nothing is copied then, but where a disk fills up on the way.
    """
    source, target = scenes_folder(), Path(target)
    contents = {target / name: (source / name).read_bytes() for name in scene_files()}
    taken = next((path for path, content in contents.items() if differs(path, content)), None)
    if taken is not None:
        raise InputError("it is there already", "name another folder", path=taken)
    for path, content in contents.items():
        make_folder(path.parent)
        if not path.exists():
            write_bytes(path, content)
    return tuple(contents)
