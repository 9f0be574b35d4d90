"""The picture of a bench, made in another process: ``python -m mcrim_mitsuba.output.photographer``.

Mitsuba compiles every scene that lives in a process into each picture's kernel. After a
diagnosis many do, and the page that asked for the report answers meanwhile; the rest of the
report is made meanwhile too.
"""

from __future__ import annotations

import functools
import io
import json
import subprocess
import sys
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

#: Exit status of the process where the scene or the variant cannot be drawn.
_REFUSED = 2


class Photograph:
    """A picture that is being drawn; it is waited for when it is asked for.

    The process writes a PNG to its standard output, or a line to its standard error and fails.
    """

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    def __getstate__(self) -> dict[str, Any]:
        return {"_developed": self._developed}  # a process cannot be sent to another

    @property
    def picture(self) -> NDArray[np.uint8] | None:
        """Pixels, or None: a report does without."""
        return self._developed[0]

    @property
    def trouble(self) -> str:
        """Why there is no picture."""
        return self._developed[1]

    @functools.cached_property
    def _developed(self) -> tuple[NDArray[np.uint8] | None, str]:
        png, complaint = self._process.communicate()
        if self._process.returncode != 0:
            words = complaint.decode(errors="replace").strip() or "the process that draws it ended"
            return None, words.splitlines()[-1]
        with Image.open(io.BytesIO(png)) as picture:
            return np.asarray(picture.convert("RGB")), ""


def photograph(scene: SceneFile, run: Run, scale: float) -> Photograph:
    """Begin to draw a scene, `scale` times as large as `mcrim render`; by the run's variant."""
    job = {
        "path": str(scene.path),
        "text": scene.unwritten_text,
        "overrides": dict(scene.overrides),
        "variant": run.variant,
        "threads": run.threads,
        "scale": scale,
    }
    command = [sys.executable, "-m", "mcrim_mitsuba.output.photographer"]
    try:
        with tempfile.TemporaryFile() as stdin:  # a pipe would have to be written meanwhile
            stdin.write(json.dumps(job).encode())
            stdin.seek(0)
            pipe = subprocess.PIPE
            return Photograph(subprocess.Popen(command, stdin=stdin, stdout=pipe, stderr=pipe))
    except OSError as error:
        # a file without a name does not say where it lies
        place = error.filename or tempfile.gettempdir()
        raise OSError(error.errno, error.strerror, place) from None


def main() -> int:
    """Draw what standard input asks for; the PNG goes to standard output."""
    from mcrim_mitsuba.output.photograph import render

    job = json.load(sys.stdin)
    try:
        scene = read_scene(job["path"])
        if job["text"] is not None:
            scene = scene.edited(job["text"])
        scene = scene.with_overrides(job["overrides"])
        run = Run(variant=job["variant"], threads=job["threads"])
        picture = render(scene, scale=job["scale"], run=run)
    except InputError as error:
        print(error.problem, file=sys.stderr)
        return _REFUSED
    sys.stdout.buffer.write(picture.png())
    return 0


if __name__ == "__main__":
    sys.exit(main())
