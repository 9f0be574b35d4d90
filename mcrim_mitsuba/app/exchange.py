"""What goes into the page and out of it: readings, scenes, campaigns, reports."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcrim_mitsuba.app.state import MALFORMED, State, settings_of
from mcrim_mitsuba.campaign import editor
from mcrim_mitsuba.campaign.campaign import Campaign, read_campaign
from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, TRANSMITTANCE
from mcrim_mitsuba.campaign.parameter import CampaignParameter
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.files import attributes, json_text, write_bytes, write_text
from mcrim_mitsuba.core.numbers import value_text
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.effect import with_new_names
from mcrim_mitsuba.inference.repair import mended_scene, rounded, scene_text
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.spectrophotometer import GAP_INDEX, spectrophotometer_of

_LONGEST_NAME = 80


@contextlib.contextmanager
def page_folder() -> Iterator[Path]:
    """A temporary folder that goes with the page; those of pages that were killed go first."""
    for mark in Path(tempfile.gettempdir()).glob("mcrim_app_*/locked"):
        # OSError: of a page that lives, or of another user
        with contextlib.suppress(OSError), _locked(mark.parent):
            shutil.rmtree(mark.parent)
    with tempfile.TemporaryDirectory(prefix="mcrim_app_") as name, contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError):  # Windows: what a killed page leaves stays
            stack.enter_context(_locked(Path(name)))
            (Path(name) / "locked").touch()
        yield Path(name)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold a folder's lock, which ends with the process however it ends; OSError if it is held."""
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def with_readings(campaign: Campaign, name: str, content: bytes, folder: Path) -> Campaign:
    """The campaign with other readings, read as if its file named them.

    The user calls their file `name`, which messages use; both files are written to `folder`.

    Raises InputError, naming the user's file, if the readings cannot be used.
    """
    _refuse_other(campaign.scene)
    place = Path(tempfile.mkdtemp(dir=folder))
    readings, target = place / safe_name(name, ".csv"), place / safe_name(campaign.path.name, "")
    write_bytes(readings, content)
    write_text(target, editor.campaign_with_measurements(campaign, target, readings))
    try:
        return read_campaign(target)
    except InputError as error:
        if error.path == str(readings) and error.column == "histogram":
            error.problem = "the table names histograms, which do not come with it"
            error.mend = "upload signals and errors, as `mcrim reduce` writes them"
        names = {str(readings): name, str(target): campaign.path.name}
        error.path = names.get(error.path or "", error.path)
        raise


def _refuse_other(scene: SceneFile) -> None:
    """Refuse a scene whose files changed: what was simulated is of what they were."""
    if not scene.is_unchanged():
        problem = f"{scene.path.name}, or a file that it names, changed since the page was opened"
        raise InputError(problem, "start mcrim app again, or put back what it was")


def with_table(campaign: Campaign, table: str, folder: Path) -> Campaign:
    """The campaign with the text of another table, or itself where that says the same.

    Raises InputError if it cannot be used.
    """
    if table == editor.measurements_text(campaign.measurements):
        return campaign
    return with_readings(campaign, campaign.measurements.path.name, table.encode(), folder)


def with_cell(campaign: Campaign, folder: Path, place: int, column: str, text: str) -> Campaign:
    """The campaign with other text in a cell of a reading, read as if its file had it.

    `place` is the reading's; column and text are as files have them, which are written to `folder`.

    Raises InputError if they cannot be used.
    """
    cells = _cells(campaign)
    if column not in cells:
        raise InputError(f"the table has no column {column}", "choose another")
    cells[column][place] = text
    if column == KIND:
        # the other kind's own cells are emptied, and empty ones of its own as they usually are
        seen = dict(campaign.scene.parameters)
        if text == TRANSMITTANCE:
            seen = {**spectrophotometer_of(campaign.scene).parameters, **campaign.beam}
            seen.pop(GAP_INDEX, None)
        for name in campaign.measurements.columns:
            given = cells[name][place] or value_text(seen.get(name, ""))
            cells[name][place] = given if name in seen else ""
    return _with_cells(campaign, cells, folder)


def with_copy(campaign: Campaign, folder: Path, place: int) -> Campaign:
    """The campaign with one more reading at the end, like another but not in use."""
    cells = _cells(campaign)
    for of_column in cells.values():
        of_column.append(of_column[place])
    label, labels = cells["label"][place], cells["label"]
    names = (f"{label} ({number})" for number in itertools.count(2))
    labels[-1] = next(name for name in names if name not in labels)
    cells["use"][-1] = "0"
    return _with_cells(campaign, cells, folder)


def without_row(campaign: Campaign, folder: Path, place: int) -> Campaign:
    """The campaign without a reading.

    Raises InputError if the others are too few.
    """
    cells = _cells(campaign)
    for of_column in cells.values():
        del of_column[place]
    return _with_cells(campaign, cells, folder)


def _cells(campaign: Campaign) -> dict[str, list[str]]:
    """Cells of its table by column; whether readings are used, and their kind, are among them."""
    measurements = campaign.measurements
    usual = {"use": "1", KIND: LIGHT}
    every = {name: [cell] * len(measurements.readings) for name, cell in usual.items()}
    return every | editor.measurement_cells(measurements)


def _with_cells(campaign: Campaign, cells: Mapping[str, list[str]], folder: Path) -> Campaign:
    """The campaign with other cells; the refusal stands beside the cell, and tells no line."""
    with placed():
        table = editor.table_text(campaign.measurements.comments, cells)
        return with_table(campaign, table, folder)


def scene_file(
    campaign: Campaign, effects: Sequence[str], values: Mapping[str, float]
) -> tuple[str, bytes]:
    """Name and content of the mended scene."""
    name = f"{safe_name(campaign.path.stem, '')}_{'mended' if effects else 'as_shown'}.xml"
    return name, scene_text(mended_scene(campaign, effects, rounded(values))).encode()


def campaign_archive(
    campaign: Campaign,
    effects: Sequence[str],
    values: Mapping[str, float],
    priors: Mapping[str, tuple[float, float]] | None = None,
    chosen: Iterable[CampaignParameter] = (),
) -> tuple[str, bytes]:
    """Name and content of a ZIP file with the mended campaign and all that it needs.

    Raw data stay where they are: the campaign has the numbers that they gave. Priors are what a fit
    with these effects knew of their sizes, `chosen` what the user chose to hold or to know.
    """
    stem = f"{safe_name(campaign.path.stem, '')}_{'mended' if effects else 'as_shown'}"
    values = rounded(values)
    _refuse_other(campaign.scene)
    scene = mended_scene(campaign, effects, values)
    with tempfile.TemporaryDirectory() as name:
        if campaign.raw is not None:
            plain = Path(name) / safe_name(campaign.path.name, ".toml")
            editor.write_plain(campaign, plain)
            campaign = read_campaign(plain)
        folder = Path(name) / stem
        folder.mkdir()
        sizes = {n: v for n, v in values.items() if n in campaign.parameters}
        sizes |= {p.name: values[p.name] for e in effects for p in campaign.catalogue[e].parameters}
        mended = _copied(campaign, folder).with_effects(effects).with_priors(priors or {})
        target, scene_path = folder / f"{stem}.toml", folder / f"{stem}.xml"
        text = editor.campaign_with_effects(mended, target, scene_path, sizes, chosen)
        for path, content in ((scene_path, scene_text(scene)), (target, text)):
            path.write_text(content, encoding="utf-8", newline="")
        itself, root = scene.path.resolve(), scene.path.parent.resolve()
        for file in {path.resolve() for path in scene.files} - {itself}:
            if file.is_relative_to(root) and file.is_file():  # else it lies or is found elsewhere
                copy = folder / file.relative_to(root)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, copy)
        return f"{stem}.zip", Path(shutil.make_archive(str(folder), "zip", name, stem)).read_bytes()


def _copied(campaign: Campaign, folder: Path) -> Campaign:
    """A campaign whose files were copied to a folder, the readings as the page has them."""
    table, light = campaign.measurements, campaign.spectrum
    copy = folder / safe_name(table.path.name, ".csv")
    write_text(copy, editor.measurements_text(table))
    moved: dict[str, Any] = {"measurements": replace(table, path=copy)}
    if light is not None:
        copy = folder / safe_name(light.path.name, ".csv")
        moved["spectrum"] = replace(light, path=Path(shutil.copyfile(light.path, copy)))
    if campaign.effects_folder is not None:
        moved["effects_folder"] = folder / campaign.effects_folder.name
        moved["effects_folder"].mkdir()
        for file in campaign.effects_folder.glob("*.py"):
            shutil.copy(file, moved["effects_folder"])
    return replace(campaign, **moved)


def report_file(
    campaign: Campaign, effects: Sequence[str], run: Run, folder: Path
) -> tuple[str, bytes]:
    """Name and content of the report; without effects, with those that the repair chooses."""
    from mcrim_mitsuba.output.report import report

    name = f"{safe_name(campaign.path.stem, '')}_report.html"
    target = Path(tempfile.mkdtemp(dir=folder)) / name
    report(campaign, target, effects=tuple(effects) or None, run=run)
    return name, target.read_bytes()


#: What a file of a session says that it is.
_SESSION = "mcrim app session 2"
#: The most fits that it may have.
_MOST_FITS = 200


def session_file(state: State) -> tuple[str, bytes]:
    """Name and content of a file with readings, controls and the list of fits."""

    def readings(campaign: Campaign) -> str:
        return editor.measurements_text(campaign.measurements)

    # as it came
    campaign = state.steps[0].campaign if state.steps else state.campaign
    fits = ({"settings": s.asked.to_json(), "readings": readings(s.campaign)} for s in state.steps)
    document = {
        "format": _SESSION,
        **attributes(campaign, "scene=scene.path.name scene_hash=scene.content_hash"),
        "measurements": campaign.measurements.path.name,
        "table": readings(campaign),
        "readings": readings(state.campaign),
        "settings": state.settings.to_json(),
        "fits": list(fits),
        "compared": state.steps.index(state.beside) if state.steps else 0,
        "diagnosed": state.diagnosis is not None,
    }
    return f"{safe_name(campaign.path.stem, '')}_session.json", json_text(document).encode()


def read_session(name: str, content: bytes, scene: SceneFile) -> dict[str, Any]:
    """The document that `session_file` wrote, of the same scene.

    Raises InputError if it is none, or of another scene.
    """
    try:
        document = with_new_names(json.loads(content))
        fits = document["fits"]
        tables = [document["table"], *(state["readings"] for state in (document, *fits))]
        is_ours = document["format"] == _SESSION and len(fits) <= _MOST_FITS
        texts = [*tables, document["measurements"], document["scene"]]
        is_ours &= all(isinstance(text, str) for text in texts)
        is_ours &= document["compared"] >= 0 and document["diagnosed"] in (True, False)
        for state in (document, *fits):
            settings_of(state["settings"], {}, ())
    except MALFORMED:
        is_ours = False
    if not is_ours:
        problem = "this is not a session of the page"
        raise InputError(problem, "open one that Keep session wrote", path=name)
    if document["scene_hash"] != scene.content_hash:
        other, ours = document["scene"], scene.path.name
        problem = f"the session is of another scene, {other}, than {ours} as it is now"
        mend = "start mcrim app with the campaign that it was made with"
        raise InputError(problem, mend, path=name)
    return document


def safe_name(name: str, suffix: str) -> str:
    """A file name made of a user's, whatever that is."""
    kept = re.sub(r"[^\w.-]+", "_", Path(name.replace("\\", "/")).name).strip("._")[-_LONGEST_NAME:]
    kept = kept or "file"
    return kept if kept.lower().endswith(suffix) else kept + suffix
