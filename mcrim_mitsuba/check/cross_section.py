"""Draws a vertical cross-section of a loaded scene, to scale, with what light meets where.

A few photons' paths, traced by the transport itself, show which fates light meets.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mcrim_mitsuba.check.cut import CrossSection, cross_section, masked
from mcrim_mitsuba.check.panel import INK, Panel
from mcrim_mitsuba.check.paths import chosen_paths, draw_legend, draw_path, legend_rows
from mcrim_mitsuba.errors import InputError

if TYPE_CHECKING:
    from mcrim_mitsuba.check.report import Interface
    from mcrim_mitsuba.kernel.simulation import Simulation

#: Suffixes of the pictures that can be drawn.
SUFFIXES = (".png", ".svg", ".pdf")

_FRAME = "#d95f02"
_WIDTH_IN, _MARGIN_IN, _DETAIL_IN, _DPI = 12.0, 0.85, 2.6, 150


def draw_cross_section(
    simulation: Simulation, interfaces: tuple[Interface, ...], path: str | Path
) -> None:
    """Draw a loaded scene to scale in the vertical plane through the middle of its crystal.

    A second panel enlarges the thinnest layer at the crystal's lower edge, where there is one. Both
    show a few photons' paths, projected on the plane; the same scene gives the same ones.

    Parameters
    ----------
    simulation : kernel.simulation.Simulation
    interfaces : sequence of check.report.Interface
        From `check.scene.interfaces_of`: they know the indices.
    path : str or Path
        The picture, overwritten if it exists: PNG (1800 pixels wide), SVG or PDF by its suffix.

    Raises
    ------
    InputError
        If the suffix is another one or the file cannot be written.
    """
    path = Path(path)
    if (suffix := path.suffix.lower()) not in SUFFIXES:
        problem = f"a cross-section cannot be drawn as {path.suffix or 'a file without suffix'}"
        raise InputError(problem, f"let the name end in {' or '.join(SUFFIXES)}", path=path)
    figure = cross_section_figure(simulation, interfaces)
    try:
        figure.savefig(path, format=suffix[1:], dpi=_DPI)
    except OSError as error:
        problem = f"the picture cannot be written ({error.strerror or error})"
        raise InputError(problem, "name a file in a writable folder", path=path) from None


def cross_section_figure(simulation: Simulation, interfaces: tuple[Interface, ...]) -> Figure:
    """The figure of `draw_cross_section`."""
    # Title, parameters, the panel to scale and, where something is thin, the enlarged one.
    crystal, file, model = simulation.crystal, simulation.file, simulation.model
    cut = cross_section(model, float(crystal.lower[1] + crystal.upper[1]) / 2)
    box, inner_in = model.scene.bbox(), _WIDTH_IN - 1.5 * _MARGIN_IN
    (middle_x, _, middle_z), (wide, _, tall) = np.array(box.center()), np.array(box.extents())
    per_mm = min((inner_in - 2.0) / wide, 4.6 / tall)  # with inches of air for labels
    main_in = max(tall * per_mm + 1.5, 2.9)
    view = _closer_view(cut, crystal.volume)
    times = round(_DETAIL_IN / 2 / view[2] / per_mm, 1)
    below_in, frame = _MARGIN_IN, None
    if times > 1.3:
        below_in += _DETAIL_IN + 0.9
        reach = view[2] * np.array([inner_in / _DETAIL_IN, 1.0])
        frame = np.array([view[:2] - reach, view[:2] + reach])
    paths, shares = chosen_paths(simulation, frame)
    height_in = below_in + main_in + 1.75 + 0.22 * legend_rows(paths, shares)
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)  # which measures texts
    words = {n: f"{v:g}" if isinstance(v, float) else v for n, v in file.parameters.items()}
    changed = ", ".join(f"{name}={words[name]}" for name in file.overrides)
    title = textwrap.shorten(f"{file.path.name} {changed and 'with'} {changed}", 90)
    shown = textwrap.fill(",  ".join(map("{0[0]}={0[1]}".format, words.items())), 150, max_lines=3)
    style: dict[str, Any] = {
        "ha": "center", "va": "top", "color": INK, "linespacing": 1.4, "parse_math": False,
    }  # fmt: skip
    figure.text(0.5, 1 - 0.18 / height_in, title, size=16, weight="bold", **style)
    figure.text(0.5, 1 - 0.55 / height_in, shown, size=9.5, **style)
    draw_legend(figure, (0.5, 1 - 1.2 / height_in), paths, shares)

    def panel(
        bottom_in: float, tall_in: float, x: float, z: float, half: float, title: str
    ) -> Panel:
        place = np.array([_MARGIN_IN, bottom_in, inner_in, tall_in])
        ax = figure.add_axes(place / np.tile([_WIDTH_IN, height_in], 2), xlabel="x (mm)")
        wide = half * inner_in / tall_in
        ax.set(xlim=(x - wide, x + wide), ylim=(z - half, z + half), ylabel="z (mm)")
        ax.set_title(title, size=11, loc="left")
        made = Panel(ax, cut, model, interfaces)
        for path in paths:
            draw_path(ax, path)
            made.cross(path.points)
        return made

    title = f"Vertical plane y = {cut.y_mm:.3g} mm, to scale"
    if np.isfinite([s.aperture_radius_mm for s in model.surfaces]).any() and not masked(model, cut):
        title += "; the black mask does not reach it"
    main = panel(below_in, main_in, middle_x, middle_z, main_in / 2 / per_mm, title)
    if frame is not None:
        title = f"The frame above, enlarged {times:g} times, alike in both directions"
        detail = panel(_MARGIN_IN, _DETAIL_IN, *view, title)
        detail.measure()
        detail.label(brief=True)
        rim = detail.ax.viewLim.corners()[[0, 1, 3, 2, 0]]
        main.line(rim, _FRAME, 1.5)
        main.named[f"enlarged {times:g} times below"] = [rim]
    main.label()
    return figure


def _closer_view(cut: CrossSection, crystal: int) -> tuple[float, float, float]:
    """x, z, half height (mm) around the thinnest volume or layer at the crystal's lower edge."""
    boxes = {r.volume: (cut.corners(r.volume).min(axis=0), cut.corners(r.volume).max(axis=0))
             for r in cut.regions}  # fmt: skip
    if crystal not in boxes:  # it is not closed: nothing to be seen
        return 0.0, 0.0, np.inf
    (_, bottom), size, outline = boxes[crystal][0], np.ptp(boxes[crystal]), cut.corners(crystal)
    x = outline[outline[:, 1] <= bottom + 1e-6 * size, 0].max()
    layers = [(cut.area(v) / np.ptp(box, axis=0).max(), *box) for v, box in boxes.items()]
    below = cut.levels(x - 1e-3 * size, 0)
    below = below[below < bottom - 1e-4 * size]
    layers += [(bottom - z, (x, z), (x, bottom)) for z in below[-1:]]
    thickness, low, high = min(layers, key=lambda layer: layer[0])
    x, z = np.clip((x, bottom), low, high)
    half = 1.6 * thickness
    if 0 < bottom - low[1] < 6 * thickness:  # room for all between it and the crystal
        z, half = (bottom + low[1]) / 2, max(half, 0.7 * (bottom - low[1]))
    return x, z, half
