"""What goes into the page and out of it: readings, scenes, campaigns, reports."""

from __future__ import annotations

import io
import re
import shutil
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mcrim_mitsuba.campaign.campaign import Campaign, read_campaign
from mcrim_mitsuba.campaign.editor import (
    campaign_with_effects,
    campaign_with_measurements,
    measurements_text,
    write_plain,
)
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.repair import mended_scene, rounded, scene_text

_LONGEST_NAME = 80


def with_readings(campaign: Campaign, name: str, content: bytes, folder: Path) -> Campaign:
    """The campaign with other readings, read as if its file named them.

    Parameters
    ----------
    campaign : Campaign
    name : str
        What the user calls the file; used in what is said of it.
    content : bytes
    folder : Path
        Where the two files are written.

    Raises
    ------
    InputError
        If the readings cannot be used; it names the user's file.
    """
    place = Path(tempfile.mkdtemp(dir=folder))
    readings, target = place / safe_name(name, ".csv"), place / safe_name(campaign.path.name, "")
    readings.write_bytes(content)
    target.write_text(campaign_with_measurements(campaign, target, readings), encoding="utf-8")
    try:
        return read_campaign(target)
    except InputError as error:
        if error.path == str(readings) and error.column == "histogram":
            error.problem = "the table names histograms, which do not come with it"
            error.mend = "upload signals and errors, as `mcrim reduce` writes them"
        path = error.path
        if path is not None:
            path = {str(readings): name, str(target): campaign.path.name}.get(path, path)
        raise InputError(
            error.problem, error.mend, path=path, line=error.line, column=error.column
        ) from None


def with_edited(campaign: Campaign, readings: Sequence[Reading], folder: Path) -> Campaign:
    """The campaign with readings as somebody changed them, read as if its file had them.

    Parameters
    ----------
    readings : sequence of Reading
    folder : Path
        Where the two files are written.

    Raises
    ------
    InputError
        If they cannot be used.
    """
    measurements = replace(campaign.measurements, readings=tuple(readings))
    name = measurements.path.name
    return with_readings(campaign, name, measurements_text(measurements).encode(), folder)


def scene_file(
    campaign: Campaign, effects: Sequence[str], values: Mapping[str, float]
) -> tuple[str, bytes]:
    """Name and content of the mended scene."""
    scene = mended_scene(campaign, effects, rounded(values))
    return f"{safe_name(campaign.path.stem, '')}_mended.xml", scene_text(scene).encode()


def campaign_archive(
    campaign: Campaign, effects: Sequence[str], values: Mapping[str, float],
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[str, bytes]:  # fmt: skip
    """Name and content of a ZIP file with the mended campaign and all that it needs.

    Raw data stay where they are: the campaign has the numbers that they gave. Priors are what a fit
    with these effects knew of their sizes.
    """
    stem = f"{safe_name(campaign.path.stem, '')}_mended"
    values = rounded(values)
    scene = mended_scene(campaign, effects, values)
    with tempfile.TemporaryDirectory() as name:
        if campaign.raw is not None:
            plain = Path(name) / safe_name(campaign.path.name, ".toml")
            write_plain(campaign, plain)
            campaign = read_campaign(plain)
        theirs, own = campaign.effects_folder, None
        folder = Path(name) / stem
        folder.mkdir()
        readings = folder / safe_name(campaign.measurements.path.name, ".csv")
        shutil.copyfile(campaign.measurements.path, readings)
        if theirs is not None:
            own = folder / theirs.name
            own.mkdir()
            for file in theirs.glob("*.py"):
                shutil.copyfile(file, own / file.name)
        for included in scene.included:
            beside = Path(included).resolve()
            root = scene.path.parent.resolve()
            if beside.is_relative_to(root):
                copy = folder / beside.relative_to(root)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(beside, copy)
        target, scene_path = folder / f"{stem}.toml", folder / f"{stem}.xml"
        moved = replace(
            campaign, effects_folder=own, measurements=replace(campaign.measurements, path=readings)
        )
        fitted = {n: v for n, v in values.items() if n in campaign.parameters}
        added = [p.name for e in effects for p in campaign.catalogue[e].parameters]
        sizes = fitted | {name: values[name] for name in added}
        mended = moved.with_effects(effects).with_priors(priors or {})
        text = campaign_with_effects(mended, target, scene_path, sizes)
        scene_path.write_text(scene_text(scene), encoding="utf-8", newline="")
        target.write_text(text, encoding="utf-8", newline="")
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            for file in sorted(folder.rglob("*")):
                if file.is_file():
                    packed.write(file, file.relative_to(folder.parent))
    return f"{stem}.zip", archive.getvalue()


def report_file(
    campaign: Campaign, effects: Sequence[str], run: Run, folder: Path
) -> tuple[str, bytes]:
    """Name and content of the report; without effects, with those that the repair chooses."""
    from mcrim_mitsuba.output.report import report

    name = f"{safe_name(campaign.path.stem, '')}_report.html"
    target = Path(tempfile.mkdtemp(dir=folder)) / name
    report(campaign, target, effects=tuple(effects) or None, run=run)
    return name, target.read_bytes()


def safe_name(name: str, suffix: str) -> str:
    """A file name made of a user's, whatever that is."""
    kept = re.sub(r"[^\w.-]+", "_", Path(name.replace("\\", "/")).name).strip("._")[-_LONGEST_NAME:]
    kept = kept or "file"
    return kept if kept.lower().endswith(suffix) else kept + suffix
