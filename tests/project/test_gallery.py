"""The gallery: its commands work, and made its pictures.

    python -m pytest tests/project/test_gallery.py                      # the quick ones
    MCRIM_GALLERY=renew python -m pytest tests/project/test_gallery.py  # all pictures anew

Commands stand in docs/gallery.md alone, under the pictures that they make. Renewed pictures are
those of the very commands, small enough to be kept: an hour on two cores.
"""

import io
import os
import re
import shlex
from pathlib import Path

from PIL import Image
from places import ROOT, SCENES

from mcrim_mitsuba.cli.main import mcrim as command

GALLERY = ROOT / "docs" / "gallery"
RENEW = os.environ.get("MCRIM_GALLERY") == "renew"
#: Done with few photons in every test; others take long, and are only read.
QUICK = {"check": (), "simulate": ("--photons", "20000"), "reduce": ()}
WIDTH, MOST_BYTES = 900, 60_000
#: Commands under one entry are alike: of more the rest is only read.
MOST_ALIKE = 2


def entries() -> list[tuple[list[str], list[list[str]]]]:
    """Pictures of docs/gallery, and the commands that stand under them, as words."""
    text = (ROOT / "docs" / "gallery.md").read_text()
    found = re.findall(r"(.*?)```sh\n(.*?)```", text, re.DOTALL)
    return [
        (re.findall(r"\(gallery/(\w+\.png)\)", above), [*map(shlex.split, lines.splitlines())])
        for above, lines in found
    ]


def keep(picture: Path) -> None:
    """A picture as the gallery has it: of as many colours as there is room for."""
    full = Image.open(picture).convert("RGB")
    size = (WIDTH, round(full.height * WIDTH / full.width))
    small = full.resize(size, Image.Resampling.LANCZOS)
    for colours in (256, 128, 64, 48, 32):
        file = io.BytesIO()
        small.quantize(colours, dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
        if file.tell() <= MOST_BYTES:
            break
    (GALLERY / picture.name).write_bytes(file.getvalue())


def test_every_picture_is_kept_small_and_shown():
    shown = [name for pictures, _ in entries() for name in pictures]
    assert sorted(shown) == sorted(path.name for path in GALLERY.iterdir())
    assert all(path.stat().st_size <= MOST_BYTES for path in GALLERY.iterdir())
    assert 10 <= len(entries()) <= 16


def test_the_commands_make_their_pictures(here, mcrim, monkeypatch):
    (here / "scenes").symlink_to(SCENES)
    if RENEW:
        monkeypatch.setenv("MCRIM_CACHE", str(here / "records"))
    for pictures, lines in entries():
        done = True
        for number, (program, *words) in enumerate(lines):
            if program == "python" and words[0] == "-c":
                exec(words[1], {})
            elif program == "python":
                done = False  # validation: a night
            elif RENEW:
                mcrim.shown(*words)
            elif words[0] in QUICK and number < MOST_ALIKE:
                mcrim.shown(*words, *QUICK[words[0]])
            else:
                read(words)
                done = False
        for name in pictures if done else ():
            [picture] = here.rglob(name)
            assert picture.stat().st_size > 10_000
            if RENEW:
                keep(picture)


def read(words: list[str]) -> None:
    """Refuses a command with a verb or an option that there is not."""
    context = command.make_context("mcrim", words)
    name, verb, rest = command.resolve_command(context, words)
    verb.make_context(name, rest, parent=context)
