"""A picture of a bench: as it stands, taken apart, and its gap enlarged."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.check.scene import interfaces_of
from mcrim_mitsuba.check.words import volume_indices
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.files.writing import write_bytes
from mcrim_mitsuba.picture import composition, labels
from mcrim_mitsuba.picture.composition import Label, Panel, Sheet
from mcrim_mitsuba.picture.exploded import exploded, raised
from mcrim_mitsuba.picture.parts import assembled, parts_of
from mcrim_mitsuba.picture.section import lower_edge
from mcrim_mitsuba.picture.view import Body, framed
from mcrim_mitsuba.work import Progress

if TYPE_CHECKING:
    from mcrim_mitsuba.picture.parts import Part

#: Variants that know colours.
VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
#: Light paths per pixel.
SAMPLES = 12
#: Left, top, width and height of the photographs of the bench, of its lower edge and of its
#: parts, in pixels of the full sheet; what is right of the parts belongs to their labels.
_BENCH, _EDGE, _PARTS = (0, 100, 890, 590), (0, 690, 890, 460), (870, 100, 660, 1050)
_FIELD_DEG = 20.0
#: Margins of the photograph of the parts: left, right, top and bottom, over its size.
_MARGINS = (0.09, 0.1, 0.06, 0.06)
#: Spaces between the parts that are tried, over the width of the widest; the first one that does
#: not make the picture smaller is taken, or the last.
_SPACINGS = (0.6, 0.5, 0.42, 0.36, 0.3, 0.26)


@dataclass(frozen=True, eq=False)
class Rendering:
    """A picture of a bench.

    Attributes
    ----------
    pixels : ndarray of uint8, shape (height, width, 3)
    labels : tuple of Label
        All texts, with their places.
    parts : tuple of str
        Names of the parts that are shown, lowest first.
    samples, seed : int
        Light paths per pixel, and what they were drawn from.
    parameters : dict
        Effective scene parameters.
    scene_hash : str
        SHA-256 of the scene after substitution.
    versions : dict of str to str
    """

    pixels: np.ndarray
    labels: tuple[Label, ...]
    parts: tuple[str, ...]
    samples: int
    seed: int
    parameters: dict[str, object]
    scene_hash: str
    versions: dict[str, str]

    def png(self) -> bytes:
        """The picture as a PNG file."""
        from PIL import Image

        file = io.BytesIO()
        Image.fromarray(self.pixels).save(file, format="png")
        return file.getvalue()

    def save(self, path: str | Path) -> None:
        """Write the picture; ``path`` ends in ``.png``.

        Raises
        ------
        InputError
            If the suffix is another one, or the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".png":
            raise InputError(
                f"a picture cannot be written as {path.suffix or 'a file without suffix'}",
                "let the name end in .png", path=path,
            )  # fmt: skip
        write_bytes(path, self.png())


def render(
    scene: str | Path | SceneFile,
    overrides: Mapping[str, Value] | None = None,
    *,
    variant: str = VARIANTS[0],
    threads: int | None = None,
    samples: int | None = None,
    seed: int = 0,
    scale: float = 1.0,
    progress: Progress | None = None,
) -> Rendering:
    """Photograph a bench as it stands and taken apart, and its lower edge enlarged.

    Parameters
    ----------
    scene : str, Path or SceneFile
    overrides : mapping, optional
        Scene parameters that differ from the file's.
    variant, threads
        As for `kernel.simulation.Simulation`; a variant of `VARIANTS`.
    samples : int, optional
        Light paths per pixel; `SAMPLES` when not given.
    seed : int
        The same seed gives the same picture.
    scale : float
        Pixels over those of the full size, 1800 x 1150.
    progress : callable, optional
        See `work.Progress`.

    Raises
    ------
    InputError
        If the scene cannot be read or is not sound, the variant has no colours, or a shape cannot
        be drawn.
    """
    if variant not in VARIANTS:
        raise InputError(
            f"the variant {variant!r} makes no pictures in colour",
            f"use {' or '.join(VARIANTS)}",
        )
    from mcrim_mitsuba.kernel.simulation import Simulation, versions

    simulation = Simulation(scene, overrides, variant=variant, threads=threads)
    file, model = simulation.file, simulation.model
    from mcrim_mitsuba.kernel.rendering import photograph
    from mcrim_mitsuba.kernel.triangles import surface_triangles

    try:
        triangles = surface_triangles(model)
    except InputError as error:
        raise InputError(error.problem, error.mend, path=file.path) from None
    indices = volume_indices(interfaces_of(file, model))
    parts = parts_of(model, triangles, indices)
    block = lower_edge(model, simulation.crystal, indices)
    bench = assembled(model, triangles, indices)
    samples, sheet = samples or SAMPLES, Sheet(scale)
    lifts, view = _taken_apart(sheet, parts)
    panels = [
        _panel(sheet, _BENCH, _corners(bench), (0.62, -1.0, 0.5), (0.07, 0.07, 0.1, 0.07)),
        _panel(sheet, _EDGE, block.points, (0.42, -1.0, 0.42), (0.28, 0.16, 0.16, 0.08)),
        view,
    ]
    apart = [
        Body(body.triangles.moved((0.0, 0.0, lift)), body.finish)
        for part, lift in zip(parts, lifts, strict=True)
        for body in part.bodies
    ]
    bodies = [bench, block.bodies, apart]
    for number, (own, panel) in enumerate(zip(bodies, panels, strict=True)):

        def report(done: int, _: int, before: int = number * samples) -> None:
            if progress is not None:
                progress("rendering", before + done, len(panels) * samples)

        points = _corners(own)
        floor = points[:, 2].min() - 0.004 * np.ptp(points, axis=0).max()
        light = photograph(own, panel.camera, floor, samples=samples, seed=seed, progress=report)
        sheet.put(light, panel)
    words = {name: _word(value) for name, value in file.parameters.items()}
    title, parameters = composition.heading(file.path.name, file.overrides, words)
    sheet.text(24 * scale, 20 * scale, title, 19, weight="bold")
    sheet.text(24 * scale, 56 * scale, parameters, 9.5, color=composition.QUIET)
    times = labels.magnification(panels[0], panels[1], block)
    labels.caption(sheet, _BENCH[:2], "The bench as it stands")
    enlarged = f"enlarged {float(f'{times:.2g}'):g} times"
    labels.caption(sheet, _EDGE[:2], f"The crystal's lower edge, cut open, {enlarged}")
    labels.caption(sheet, (_PARTS[0] + 24, _PARTS[1]), "The parts, moved apart, to scale")
    labels.label_bench(sheet, panels[0], block)
    labels.label_layers(sheet, panels[1], block, model, indices)
    labels.label_sheets(sheet, panels[1], block)
    labels.label_parts(sheet, panels[2], parts, lifts)
    return Rendering(
        pixels=sheet.finished(),
        labels=tuple(sheet.labels),
        parts=tuple(part.name for part in parts),
        samples=samples,
        seed=seed,
        parameters=dict(file.parameters),
        scene_hash=file.content_hash,
        versions=versions(variant),
    )


def _word(value: object) -> str:
    """A parameter's value as it stands in a scene."""
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


def _corners(bodies: Sequence[Body]) -> np.ndarray:
    return np.concatenate([body.triangles.corners.reshape(-1, 3) for body in bodies])


def _lifted(parts: Sequence[Part], lifts: Sequence[float]) -> np.ndarray:
    """The corners of all parts where they are shown."""
    return np.concatenate(
        [raised(part.points, lift) for part, lift in zip(parts, lifts, strict=True)]
    )


def _taken_apart(sheet: Sheet, parts: Sequence[Part]) -> tuple[list[float], Panel]:
    """How far the parts are lifted, as wide apart as the photograph is high; and its panel."""
    for spacing in _SPACINGS:
        lifts = exploded(parts, spacing)
        points = _lifted(parts, lifts)
        panel = _panel(sheet, _PARTS, points, (0.62, -1.0, 0.55), _MARGINS)
        wide = np.ptp(panel.camera.project(points)[:, 0]) / panel.camera.width
        if wide > 0.995 - _MARGINS[0] - _MARGINS[1]:
            break
    return lifts, panel


def _panel(
    sheet: Sheet,
    place: tuple[float, float, float, float],
    points: np.ndarray,
    direction: tuple[float, float, float],
    margins: tuple[float, float, float, float],
) -> Panel:
    left, top, width, height = (round(sheet.scale * value) for value in place)
    return Panel(framed(points, direction, _FIELD_DEG, width, height, margins), left, top)
