"""Photons in flight: as arrays, how they are born, how they scatter, how they are detected."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.reference.bench import Bench
from mcrim_mitsuba.reference.geometry import Codes, Complexes, Floats, HalfSpaceBody, Indices
from mcrim_mitsuba.reference.interface import about, isotropic


class Record(IntEnum):
    """Rows of `PhotonArrays.record`."""

    SCATTERINGS = 0
    PATH = 1
    SCATTERING_PATH = 2
    MASK_RADIUS = 3


@dataclass
class PhotonArrays:
    """Photons that are in the same region; the last axis of every array counts them."""

    #: (3, n) float64, mm
    position: Floats
    #: (3, n) float64: Unit vectors.
    direction: Floats
    #: (n,) int8: The body (a `Place`) whose surface a photon in air is on; without meaning
    #: elsewhere.
    touched: Codes
    #: (n,) int32: Straight flights so far.
    flights: NDArray[np.int32]
    #: (3, n) complex128 or None: Polarisation states (see `interface`), None when they are not
    #: tracked.
    field: Complexes | None
    #: (4, n) float64 or None: What `DetectedHistories` is made of, by `Record`, in mm; None when
    #: nobody asks for it.
    record: Floats | None

    def __len__(self) -> int:
        return self.touched.size

    def take(self, who: Indices) -> PhotonArrays:
        """Copies of the photons with these indices."""
        arrays = (getattr(self, field.name) for field in fields(self))
        taken: list[Any] = [None if a is None else a.take(who, axis=-1) for a in arrays]
        return PhotonArrays(*taken)

    @staticmethod
    def join(groups: Sequence[PhotonArrays]) -> PhotonArrays:
        """All photons of several groups as one."""
        if len(groups) == 1:
            return groups[0]
        columns = (
            [getattr(group, field.name) for group in groups] for field in fields(PhotonArrays)
        )
        joined: list[Any] = [
            None if column[0] is None else np.concatenate(column, axis=-1) for column in columns
        ]
        return PhotonArrays(*joined)


def birth_positions(
    bench: Bench, crystal: HalfSpaceBody, rng: np.random.Generator, count: int
) -> Floats:
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


def _in_box(bench: Bench, rng: np.random.Generator, count: int) -> Floats:
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


# Phase functions: the direction in which light is scattered.

#: Draws new directions, (3, n), for photons that fly along (3, n).
PhaseFunction = Callable[[np.random.Generator, Floats], Floats]


def phase_function(bench: Bench) -> PhaseFunction:
    """The law by which the bench's crystal scatters."""
    if bench.rayleigh_scattering:
        return lambda rng, direction: about(
            rng, direction, rayleigh_cosine(rng, direction.shape[1])
        )
    g = bench.scattering_g
    if g:
        return lambda rng, direction: about(
            rng, direction, henyey_greenstein_cosine(rng, direction.shape[1], g)
        )
    return lambda rng, direction: isotropic(rng, direction.shape[1])


def henyey_greenstein_cosine(rng: np.random.Generator, count: int, g: float) -> Floats:
    """Cosines of deflection with mean ``g``: (count,) float64.

    L. G. Henyey and J. L. Greenstein, Astrophysical Journal 93 (1941) 70; the
    inverse of the distribution function as in A. N. Witt, ApJ Suppl. 35 (1977) 1.

    Parameters
    ----------
    rng : numpy.random.Generator
    count : int
    g : float
        Between -1 and 1, not 0.
    """
    ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * rng.random(count))
    return np.clip((1.0 + g * g - ratio * ratio) / (2.0 * g), -1.0, 1.0)


def rayleigh_cosine(rng: np.random.Generator, count: int) -> Floats:
    """Cosines with density 3/8 (1 + cos^2): (count,) float64.

    J. R. Frisvad, Importance sampling the Rayleigh phase function, Journal of
    the Optical Society of America A 28 (2011) 2436.
    """
    draw = 2.0 * (2.0 * rng.random(count) - 1.0)
    root = np.cbrt(draw + np.sqrt(draw * draw + 1.0))
    return np.clip(root - 1.0 / root, -1.0, 1.0)


# What the detector does with light that reaches it.

#: Distance from the axis, in mm, at which the radial falloff is reached.
FALLOFF_RADIUS_MM = 14.0


class Detector:
    """Reflectance and acceptance of the plate's back face.

    Attributes
    ----------
    reflectance : float
        Probability of a diffuse reflection back into the plate, decided first.
    detects_all : bool
        Whether everything that reaches the detector is detected.
    """

    def __init__(self, bench: Bench) -> None:
        self.reflectance = bench.detector_reflectance
        self._angular, self._radial = bench.angular_falloff, bench.radial_falloff
        self.detects_all = not (self.reflectance or self._angular or self._radial)

    def acceptance(self, position: Floats, direction: Floats) -> Floats:
        """Probability that light which is not reflected is detected: (n,) float64.

        Parameters
        ----------
        position : (3, n) float64, mm
            Where it arrives.
        direction : (3, n) float64
            Its direction in the plate.
        """
        by_angle = 1.0 - self._angular * (1.0 - np.abs(direction[2]))
        reach = (position[0] ** 2 + position[1] ** 2) / FALLOFF_RADIUS_MM**2
        by_radius = 1.0 - self._radial * reach
        return np.clip(by_angle, 0.0, 1.0) * np.clip(by_radius, 0.0, 1.0)
