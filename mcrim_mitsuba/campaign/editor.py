"""Writes a campaign that goes on from another one, its comments and layout kept.

Of every function here: `campaign` is as it was read, and its file is not changed; `target` is where
the text will be written, for paths in it are relative to its folder. All raise `InputError` if the
campaign file cannot be read any more.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.entries import FILE_ENTRIES, HISTOGRAMS, RAW_TABLES
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import read_text

_LIMIT_MB = 1


def campaign_with_effects(
    campaign: Campaign,
    target: Path,
    scene: Path,
    effects: Sequence[str],
    starts: Mapping[str, float],
) -> str:
    """The text of a campaign file with another scene and more effects switched on.

    Parameters
    ----------
    campaign, target
        See above.
    scene : Path
        The scene that has the effects.
    effects : sequence of str
        Names of all effects to be switched on.
    starts : mapping of str to float
        Where fitted parameters begin; those without a table of their own get one.
    """
    document = _document(campaign, target, scene, campaign.measurements.path)
    # a key that is new goes before the first table, or it would belong to the last one
    document["effects"] = list(effects)
    parameters = document.setdefault("parameters", tomlkit.table(is_super_table=True))
    for name, start in starts.items():
        value = float(f"{start:.6g}")
        if name in parameters:
            parameters[name]["start"] = value
        else:
            table = tomlkit.table()
            table.add("start", value)
            table.add(tomlkit.nl())
            parameters[name] = table
    return _text(document, campaign)


def campaign_with_measurements(campaign: Campaign, target: Path, measurements: Path) -> str:
    """The text of a campaign file with other readings."""
    return _text(_document(campaign, target, campaign.scene.path, measurements), campaign)


def campaign_with_numbers(campaign: Campaign, target: Path, measurements: Path) -> str:
    """The text of a campaign file with numbers in the place of its raw data.

    `measurements` gives every signal.
    """
    document = _document(campaign, target, campaign.scene.path, measurements)
    # what was said of the entry may not be true any more
    trivia = document["measurements"].trivia
    trivia.comment_ws = trivia.comment = ""
    document.pop(HISTOGRAMS, None)
    for key, names in RAW_TABLES:
        if (table := _table(document, key)) is not None:
            for name in names:
                table.pop(name, None)
    assert campaign.raw is not None
    for name, value in campaign.raw.numbers.items():
        key, _, entry = name.rpartition(".")
        if (table := _table(document, key)) is not None:  # the raw entry stood there
            table[entry] = value
    return _text(document, campaign)


def _text(document: tomlkit.TOMLDocument, campaign: Campaign) -> str:
    """The document as it is written, once it says what it should."""
    text = tomlkit.dumps(document)
    try:
        sound = tomllib.loads(text) == document.unwrap()
    except tomllib.TOMLDecodeError:
        sound = False
    if not sound:
        raise InputError(
            "the campaign is laid out so that nothing can be added",
            "write a table for each parameter, such as [parameters.alpha_scat_per_cm], and each "
            "table once",
            path=campaign.path,
        )
    return text


def _table(document: tomlkit.TOMLDocument, key: str) -> MutableMapping[str, Any] | None:
    """The table of a dotted name; None if it is not there."""
    table: Any = document
    for part in key.split("."):
        table = table.get(part)
        if table is None:
            return None
    return table


def _document(
    campaign: Campaign, target: Path, scene: Path, measurements: Path
) -> tomlkit.TOMLDocument:
    """The campaign file with its paths as the target needs them."""
    document = tomlkit.parse(read_text(campaign.path, _LIMIT_MB))

    def relative(path: Path) -> str:
        return Path(os.path.relpath(path.absolute(), target.parent.absolute())).as_posix()

    document["scene"] = relative(scene)
    document["measurements"] = relative(measurements)
    if campaign.effects_folder is not None:
        document["effects_folder"] = relative(campaign.effects_folder)
    for key, name in FILE_ENTRIES:
        if (table := _table(document, key)) is None:
            continue
        given = table.get(name)
        if isinstance(given, str):
            table[name] = relative(campaign.path.parent / given)
        elif isinstance(given, list):
            for place, one in enumerate(given):
                given[place] = relative(campaign.path.parent / one)
    return document
