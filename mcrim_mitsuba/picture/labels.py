"""Writes beside the photographs what they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.figures.style import shortened
from mcrim_mitsuba.kernel.filling import is_filled
from mcrim_mitsuba.picture.composition import QUIET, Panel, Sheet, apart
from mcrim_mitsuba.picture.exploded import raised
from mcrim_mitsuba.picture.parts import Part
from mcrim_mitsuba.picture.section import Block

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.scene_model import SceneModel

#: Where the labels of the parts begin, in pixels of the full sheet.
_LEFT = 1490
#: Height of a line over the size of its letters, in pixels per point.
_LINE = 1.39


def caption(sheet: Sheet, place: tuple[float, float], text: str) -> None:
    """Words in bold at the upper left corner of a panel."""
    sheet.text(sheet.scale * (place[0] + 24), sheet.scale * (place[1] + 8), text, 13, weight="bold")


def magnification(bench: Panel, edge: Panel, block: Block) -> float:
    """How much larger a millimetre at the lower edge is than in the picture of the bench."""
    step = 0.5 * block.height_mm
    ends = [raised(block.centre_mm, side * step) for side in (-1, 1)]
    own = edge.at(np.array([(0.0, 0.0, -0.5), (0.0, 0.0, 0.5)]))
    return float(
        np.linalg.norm(np.diff(own, axis=0)) / np.linalg.norm(np.diff(bench.at(ends), axis=0))
    )


def label_bench(sheet: Sheet, panel: Panel, block: Block) -> None:
    """A ring around what the block below was cut out of."""
    x, y = panel.at(block.centre_mm)
    sheet.ring((x, y), 13 * sheet.scale)
    camera = panel.camera
    end = (panel.left + 0.74 * camera.width, panel.top + 0.93 * camera.height)
    sheet.line([(x + 9 * sheet.scale, y + 9 * sheet.scale), end])
    sheet.text(end[0] + 6 * sheet.scale, end[1] - 9 * sheet.scale, "enlarged below", 11.5)


def label_layers(
    sheet: Sheet, panel: Panel, block: Block, model: SceneModel, indices: Mapping[str, float]
) -> None:
    """Names of the layers at the left of the block, with arrows across the thin ones."""
    scale = sheet.scale
    texts, tops, heights, ends = [], [], [], []
    for layer in reversed(block.layers):
        volume = model.volumes[layer.volume].name if layer.volume else "air"
        index = indices.get(volume)
        text = volume + (f", n = {index:g}" if index else "")
        if index is not None and not is_filled(index):
            text += " (air)"
        if layer.thickness_mm is not None:
            text += f"\n{layer.thickness_mm:.3g} mm"
        texts.append(text)
        ends.append(panel.at(layer.edge))
        heights.append((22 + 21 * (layer.thickness_mm is not None)) * scale)
        tops.append(ends[-1][:, 1].mean() - heights[-1] / 2)
    places = apart(tops, heights, panel.top + 40 * scale,
                               panel.top + panel.camera.height - 8 * scale)  # fmt: skip
    rows = zip(block.layers[::-1], texts, places, heights, ends, strict=True)
    for layer, text, top, high, edge in rows:
        middle = edge.mean(axis=0)
        right = min(edge[:, 0]) - 34 * scale
        sheet.text(right - 8 * scale, top, text, 13, ha="right")
        sheet.line([(right, top + high / 2), middle - (16 * scale, 0)])
        if layer.thickness_mm is not None:
            sheet.span(edge - (10 * scale, 0))


def label_sheets(sheet: Sheet, panel: Panel, block: Block) -> None:
    """Names of masks, detectors and reflectors at the right of the block."""
    scale = sheet.scale
    right = panel.at(block.points)[:, 0].max() + 30 * scale
    rows = [(tuple(panel.at(point)), name) for name, point in block.sheets.items()]
    rows.sort(key=lambda row: row[0][1])
    high = 26 * scale
    places = apart([y - high / 2 for (_, y), _ in rows], [high] * len(rows),
                               panel.top + 40 * scale, panel.top + panel.camera.height)  # fmt: skip
    for (target, name), top in zip(rows, places, strict=True):
        sheet.text(right, top, shortened(name, 14), 13, target=target)
        sheet.line([(right - 5 * scale, top + high / 2), target])


def label_parts(sheet: Sheet, panel: Panel, parts: Sequence[Part], lifts: Sequence[float]) -> None:
    """What each part is, to the right of it."""
    scale = sheet.scale
    left = scale * _LEFT
    rows = []
    for part, lift in zip(parts, lifts, strict=True):
        seen = panel.at(raised(part.points, lift))
        if not part.bodies:
            sheet.ghost(seen)
        target = seen[seen[:, 0] > seen[:, 0].max() - 0.5 * scale].mean(axis=0)
        rows.append((target, part))
    rows.sort(key=lambda row: row[0][1])
    room = panel.camera.height - 50 * scale
    heights = np.array([(1.75 + 1.3 * len(part.details)) * _LINE * scale for _, part in rows])
    size = min(13.0, room / heights.sum())
    heights *= size
    tops = [target[1] - 0.9 * size * scale for target, _ in rows]
    low = panel.top + 40 * scale
    places = apart(tops, heights, low, low + room)
    for (target, part), top in zip(rows, places, strict=True):
        name, details = shortened(part.name, 24), "\n".join(map(shortened, part.details))
        below = top + 2.0 * size * scale
        sheet.text(left, top, name, size + 1, weight="bold", target=tuple(target))
        sheet.text(left, below, details, size - 1.5, color=QUIET)
        start = (left - 8 * scale, top + 0.9 * size * scale)
        sheet.line([start, (left - 28 * scale, start[1]), target])
        sheet.dot(target)
