"""Files that a report shows in full, as they were read."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.reading import read_bytes
from mcrim_mitsuba.laboratory.raw_data import LIMIT_MB

#: Characters of all files together that a report shows: it must stay easy to mail.
MOST_CHARACTERS = 250_000
#: Of one file with raw data: a list of events would fill hundreds of printed pages.
MOST_OF_RAW_DATA = 4_000
_LIMIT_MB = 10


@dataclass(frozen=True)
class Source:
    """One file.

    Attributes
    ----------
    role : str
        What it is for the campaign.
    path : Path
    sha256 : str
        Of its bytes, hexadecimal.
    text : str
        What it holds, or its beginning.
    left_out : int
        Characters that are not in `text`.
    """

    role: str
    path: Path
    sha256: str
    text: str
    left_out: int


def sources_of(campaign: Campaign) -> tuple[Source, ...]:
    """The campaign, its measurements, its scene with what that includes, own effects, raw data.

    Raises
    ------
    InputError
        If a file cannot be read any more.
    """
    scene, folder = campaign.scene, campaign.effects_folder
    found = [
        ("campaign", campaign.path, read_bytes(campaign.path, _LIMIT_MB)),
        (
            "measurements",
            campaign.measurements.path,
            read_bytes(campaign.measurements.path, _LIMIT_MB),
        ),
        ("scene", scene.path, scene.source(scene.path)),
        *(("included by the scene", path, scene.source(path)) for path in scene.included),
    ]
    if folder is not None:
        own = sorted(folder.glob("*.py"))
        found += [("own effect", path, read_bytes(path, _LIMIT_MB)) for path in own]
    sources, room = [], MOST_CHARACTERS
    for role, path, data in found:
        sources.append(source_of(role, path, data, room))
        room -= len(sources[-1].text)
    for file in () if campaign.raw is None else campaign.raw.files:
        data = read_bytes(file.path, LIMIT_MB)
        sources.append(source_of(file.role, file.path, data, min(room, MOST_OF_RAW_DATA)))
        room -= len(sources[-1].text)
    return tuple(sources)


def source_of(role: str, path: Path, data: bytes, room: int = MOST_CHARACTERS) -> Source:
    """One file from its bytes, its text cut to so many characters."""
    text = data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    left_out = max(len(text) - max(room, 0), 0)
    return Source(
        role, path, hashlib.sha256(data).hexdigest(), text[: len(text) - left_out], left_out
    )
