"""Load a scene file with Mitsuba, and put its complaints into one line."""

from __future__ import annotations

import re

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile

_PLACE = re.compile(r"(?P<file>\S+\.xml)? ?\(line (?P<line>\d+), col (?P<column>\d+)\):? ?")
_SOURCE = re.compile(r"\[[\w.]+\.(cpp|h):\d+\] ?")


def load_scene(mi, file: SceneFile):
    """The scene, loaded into the active variant.

    Parameters
    ----------
    mi : module
        Mitsuba, switched to a variant.
    file : SceneFile

    Raises
    ------
    InputError
        With the file, line and column that Mitsuba names; if the scene on the disk is no
        longer the one that was read; or if a GPU lacks what traces its rays.
    """
    try:
        scene = _load(mi, file)
        _refuse_changed(file)
        return scene
    except InputError:
        raise
    except (RuntimeError, ValueError, TypeError, KeyError) as error:
        text = str(error)
    if "initialize OptiX" in text:
        raise InputError(
            "NVIDIA's ray tracing library OptiX (libnvoptix.so.1) does not start here",
            "install a complete NVIDIA driver (a container needs its capability graphics), or use "
            "--variant llvm_ad_rgb",
        )
    place = _PLACE.search(text)
    raise InputError(
        f"Mitsuba refuses the scene: {_cause(text[place.end() :] if place else text)}",
        "mend the element at this place",
        path=place["file"] if place and place["file"] else file.path,
        line=int(place["line"]) if place else None,
        column=int(place["column"]) if place else None,
    )


def _load(mi, file: SceneFile):
    """What Mitsuba makes of the file, or of the text that stands for it."""
    overrides = file.overrides_for_mitsuba()
    # Optimising merges shapes, and with that their ids and faces.
    if file.unwritten_text is None:
        return mi.load_file(str(file.path), optimize=False, **overrides)
    outside = mi.file_resolver()
    folder = mi.FileResolver(outside)
    folder.prepend(str(file.path.parent))
    mi.set_file_resolver(folder)
    try:
        text = file.unwritten_text.removeprefix("\ufeff")
        return mi.load_string(text, optimize=False, **overrides)
    finally:
        mi.set_file_resolver(outside)


def _refuse_changed(file: SceneFile) -> None:
    """Refuse a scene whose files are not (any more) what its hash was made of.

    Results are labelled, and photon records kept, by the text that was read; Mitsuba reads the
    files a second time, and someone may have edited them in between.
    """
    if not file.is_unchanged():
        raise InputError(
            "the scene, or a file that it names, changed while it was being used",
            "run the command again",
            path=file.path,
        )


def _cause(text: str) -> str:
    """What is wrong, without source lines of Mitsuba and without a plugin's traceback."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if any(line.endswith("Traceback (most recent call last):") for line in lines):
        beginning = lines[0].removesuffix("Traceback (most recent call last):").rstrip(": ")
        return f"{beginning}: {_clean(lines[-1])}"
    return _clean(" ".join(lines)).replace(" - ", " ")


def _clean(line: str) -> str:
    return re.sub(r"^\w*Error: ", "", _SOURCE.sub("", line)).strip()
