"""BSDF plugin ``photodetector``: whatever light reaches this face is counted."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class Photodetector(mi.BSDF):
    """Ideal, index-matched absorber; a shape that wears it is a detector.

    XML: ``<bsdf type="photodetector"/>``. Nothing is reflected, on either side.
    """

    #: How the transport recognises a detector.
    detects_light = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = flags

    def sample(self, ctx, si, sample1, sample2, active=True):
        return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0.0)

    def eval(self, ctx, si, wo, active=True):
        return mi.Spectrum(0.0)

    def pdf(self, ctx, si, wo, active=True):
        return mi.Float(0.0)

    def traverse(self, callback) -> None:
        pass

    def to_string(self) -> str:
        return "Photodetector[]"


mi.register_bsdf("photodetector", Photodetector)
