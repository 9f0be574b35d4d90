"""Faces that lie on each other, or too close for single precision."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.check.report import Problem
from mcrim_mitsuba.files.scene_xml import SceneFile

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.scene_model import FlatFace, SceneModel

#: Mitsuba moves a new ray off its surface by this times (1 + largest coordinate); measured.
RAY_OFFSET = 8.94e-5
#: A gap must be this many offsets wide, or rays start beyond its other side.
OFFSETS_PER_GAP = 2.0


def problems_of_contacts(file: SceneFile, model: SceneModel) -> list[Problem]:
    """Parallel faces that overlap at no distance, or at one too small for Mitsuba's rays.

    Parameters
    ----------
    file : SceneFile
    model : kernel.scene_model.SceneModel
    """
    narrowest = OFFSETS_PER_GAP * RAY_OFFSET * (1.0 + model.size_mm)
    problems, seen = [], set()
    for first, second in itertools.combinations(model.faces or (), 2):
        pair = (first.surface, second.surface)
        if pair in seen or abs(first.normal @ second.normal) < 1 - 1e-6:
            continue
        distance = abs((second.corner - first.corner) @ first.normal)
        if distance >= narrowest or not _overlap(first, second):
            continue
        seen.add(pair)
        one, other = (model.surfaces[i].name for i in pair)
        place = file.place_of_id(other)
        if distance < 1e-6 * model.size_mm:
            text = f"{one} (line {file.line_of(one)}) and {other} lie on each other"
            mend = "an interface is ONE surface that names both indices: take one of them away"
            problems.append(Problem("overlap", text, mend, *place))
        else:
            text = (
                f"{one} (line {file.line_of(one)}) and {other} are {distance:.3g} mm apart, "
                f"too thin for single precision in a scene of this size"
            )
            mend = f"make the gap at least {_round_up(narrowest):g} mm, or one single face"
            problems.append(Problem("thin_gap", text, mend, *place))
    return problems


def _overlap(first: FlatFace, second: FlatFace) -> bool:
    """Whether two parallel faces share area when projected along their normal."""
    grid = (np.arange(16) + 0.5) / 16
    a, b = (g.ravel() for g in np.meshgrid(grid, grid))
    for one, other in ((first, second), (second, first)):
        u, v = (a, b) if not one.triangle else (a * (1 - b), b)
        points = one.corner + u[:, None] * one.edge_u + v[:, None] * one.edge_v
        basis = np.column_stack([other.edge_u, other.edge_v, other.normal])
        p, q, _ = np.linalg.solve(basis, (points - other.corner).T)
        inside = (p > 1e-6) & (q > 1e-6)
        inside &= (p + q < 1 - 1e-6) if other.triangle else (p < 1 - 1e-6) & (q < 1 - 1e-6)
        if inside.any():
            return True
    return False


def _round_up(value: float) -> float:
    """Next number of one significant digit."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / power) * power)
