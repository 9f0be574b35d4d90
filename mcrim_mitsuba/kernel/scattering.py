"""Scattering in volumes: how far light flies before it, and where it goes on.

Formulas: L. G. Henyey and J. L. Greenstein, Astrophys. J. 93 (1941) 70, and J. R. Frisvad,
J. Opt. Soc. Am. A 28 (2011) 2436 for Rayleigh's; both invert the distribution of the cosine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.kernel.scene_model import opaque


@dataclass
class Strength:
    """Scattering relative to the volume's coefficient, along a straight flight.

    Attributes
    ----------
    here : Float
        Where the flight begins.
    per_mm : Float
        Its change per millimetre of flight.
    """

    here: Any
    per_mm: Any

    def until(self, path):
        """Distance (mm, Float) at which the weighted path is `path`; infinite if it never is."""
        discriminant = dr.fma(2.0 * self.per_mm, path, dr.square(self.here))
        # the root that does not cancel; no volume with nothing to scatter has one
        denominator = dr.maximum(self.here + dr.safe_sqrt(discriminant), dr.smallest(mi.Float))
        return dr.select(discriminant < 0.0, dr.inf, 2.0 * path / denominator)

    def path(self, distance):
        """Path (mm, Float) of a flight over `distance`, weighted with the strength."""
        return distance * dr.fma(0.5 * self.per_mm, distance, self.here)


class Scattering:
    """How the volumes that scatter do so, as numbers of the loop.

    Parameters
    ----------
    volumes : sequence of scene_model.Volume
    scattering : collection of int
        Numbers of the volumes that scatter.
    """

    def __init__(self, volumes, scattering) -> None:
        self._mean_cosine, self._rayleigh, self._graded = {}, [], {}
        for number in scattering:
            volume = volumes[number]
            if volume.phase == "hg":
                self._mean_cosine[number] = opaque([volume.scattering_g])
            if volume.phase == "rayleigh":
                self._rayleigh.append(number)
            if volume.scattering_gradient:
                slope = 2.0 * volume.scattering_gradient / (volume.top_mm - volume.bottom_mm)
                middle = (volume.top_mm + volume.bottom_mm) / 2.0
                self._graded[number] = (opaque([1.0 - slope * middle]), opaque([slope]))

    @property
    def isotropic(self) -> bool:
        """Whether all volumes scatter evenly to all sides."""
        return not (self._mean_cosine or self._rayleigh)

    def strength(self, inside, origin, direction) -> Strength | None:
        """Along a flight in the volume that `inside` (list of Mask) tells; ``None`` if 1."""
        if not self._graded:
            return None
        here, per_mm = mi.Float(1.0), mi.Float(0.0)
        for number, (at_zero, slope) in self._graded.items():
            own = dr.maximum(dr.fma(slope, origin.z, at_zero), 0.0)
            here = dr.select(inside[number], own, here)
            per_mm = dr.select(inside[number], slope * direction.z, per_mm)
        return Strength(here, per_mm)

    def direction(self, inside, old, uniforms, afresh):
        """Unit direction (Vector3f) after a scattering; where `afresh`, any direction at all.

        Parameters
        ----------
        inside : list of Mask
            Whether the photon is in each volume.
        old : Vector3f
        uniforms : tuple of Float
            For the azimuth and for the angle.
        afresh : Mask
        """
        if self.isotropic:
            return mi.warp.square_to_uniform_sphere(mi.Point2f(*uniforms))
        even = dr.fma(-2.0, uniforms[1], 1.0)
        cosine = even
        for number, g in self._mean_cosine.items():
            cosine = dr.select(inside[number], henyey_greenstein_cosine(even, g), cosine)
        for number in self._rayleigh:
            cosine = dr.select(inside[number], rayleigh_cosine(even), cosine)
        cosine = dr.select(afresh, even, cosine)
        sine = dr.safe_sqrt(dr.fma(-cosine, cosine, 1.0))
        across, along = dr.sincos(dr.two_pi * uniforms[0])
        axis = dr.select(afresh, mi.Vector3f(0.0, 0.0, 1.0), old)
        return dr.normalize(
            mi.Frame3f(axis).to_world(mi.Vector3f(sine * along, sine * across, cosine))
        )


def henyey_greenstein_cosine(even, g):
    """Cosine of the scattering angle, from a number even in [-1, 1]; good for g = 0 as well."""
    # (1 + g^2 - ((1 - g^2) / (1 + g t))^2) / (2 g), multiplied out so that nothing is over g
    numerator = even + g * (0.5 * (dr.square(even) + 3.0) + g * even)
    numerator += 0.5 * g * g * g * (dr.square(even) - 1.0)
    return dr.clip(numerator / dr.square(dr.fma(g, even, 1.0)), -1.0, 1.0)


def rayleigh_cosine(even):
    """Cosine of the scattering angle by 3/8 (1 + cos^2), from a number even in [-1, 1]."""
    half = 2.0 * dr.abs(even)
    root = dr.cbrt(half + dr.sqrt(dr.fma(half, half, 1.0)))
    return dr.mulsign(dr.minimum(root - dr.rcp(root), 1.0), even)
