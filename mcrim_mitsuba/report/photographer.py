"""The picture of a bench, made in another process: ``python -m mcrim_mitsuba.report.photographer``.

Mitsuba compiles every scene that lives in a process into each picture's kernel. After a
diagnosis many do, and the page that asked for the report answers meanwhile.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile, read_scene
from mcrim_mitsuba.recording import RunOptions

#: Exit status of the process where the scene or the variant cannot be drawn.
_REFUSED = 2


def photograph(
    scene: SceneFile, options: RunOptions, scale: float
) -> tuple[NDArray[np.uint8] | None, str]:
    """The picture, (height, width, 3), or None and why there is none: a report does without.

    Parameters
    ----------
    scene : SceneFile
    options : RunOptions
    scale : float
        Size over that of `mcrim render`.
    """
    job = {
        "path": str(scene.path),
        "text": scene.unwritten_text,
        "overrides": dict(scene.overrides),
        "variant": options.variant,
        "threads": options.threads,
        "scale": scale,
    }
    command = [sys.executable, "-m", "mcrim_mitsuba.report.photographer"]
    done = subprocess.run(command, input=json.dumps(job).encode(), capture_output=True)
    if done.returncode != 0:
        words = done.stderr.decode(errors="replace").strip() or "the process that draws it ended"
        return None, words.splitlines()[-1]
    with Image.open(io.BytesIO(done.stdout)) as picture:
        return np.asarray(picture.convert("RGB")), ""


def main() -> int:
    """Draw what standard input asks for; the PNG goes to standard output."""
    from mcrim_mitsuba.rendering import render

    job = json.load(sys.stdin)
    try:
        scene = read_scene(job["path"])
        if job["text"] is not None:
            scene = scene.edited(job["text"])
        scene = scene.with_overrides(job["overrides"])
        made = render(scene, variant=job["variant"], threads=job["threads"], scale=job["scale"])
    except InputError as error:
        print(error.problem, file=sys.stderr)
        return _REFUSED
    sys.stdout.buffer.write(made.png())
    return 0


if __name__ == "__main__":
    sys.exit(main())
