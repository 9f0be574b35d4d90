"""Where photons are born."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.tracer.bench import Bench
from mcrim_mitsuba.tracer.geometry import ConvexBody


def birth_positions(
    bench: Bench, crystal: ConvexBody, rng: np.random.Generator, count: int
) -> NDArray[np.float64]:
    """Points in the crystal, with the bench's density of emission: (3, count) float64, mm.

    Parameters
    ----------
    bench : Bench
    crystal : ConvexBody
        The crystal; points of the whole box outside of it are drawn again.
    rng : numpy.random.Generator
    count : int
    """
    position = _in_box(bench, rng, count)
    if not bench.chamfer_mm:
        return position
    outside = np.flatnonzero(~crystal.contains(position))
    while outside.size:
        position[:, outside] = _in_box(bench, rng, outside.size)
        outside = outside[~crystal.contains(position[:, outside])]
    return position


def _in_box(bench: Bench, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    width, height = bench.crystal_width_mm, bench.crystal_height_mm
    position = rng.random((3, count))
    position[:2] = (position[:2] - 0.5) * width
    depth_mm = bench.source_depth_mm
    if math.isinf(depth_mm):
        position[2] *= height
    else:
        # the inverse of the distribution function of exp(-t/depth) on 0 < t < height
        below_top = -depth_mm * np.log1p(position[2] * math.expm1(-height / depth_mm))
        position[2] = np.clip(height - below_top, 0.0, height)
    return position
