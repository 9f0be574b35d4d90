"""BSDF plugin ``photodetector``: light that reaches this face is counted."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

#: Distance from the axis at which `radial_falloff` is what is lacking, in the scene's mm.
RADIUS_MM = 14.0


class Photodetector(mi.BSDF):
    """Index-matched detector; a shape that wears it counts the light that it accepts.

    XML: ``<bsdf type="photodetector">``, an ideal absorber on both sides unless it has

    ``reflectance`` : float, default 0
        Probability with which light is sent back to where it came from, by Lambert's law and
        unpolarised; decided first.
    ``angular_falloff`` : float a, default 0
        Light that arrives at an angle theta to the normal is accepted with probability
        1 - a (1 - cos theta), and else absorbed in the surface.
    ``radial_falloff`` : float b, default 0
        Light that arrives at r mm from x = y = 0 is accepted with probability 1 - b (r / 14)^2.
    """

    #: How the transport recognises a detector.
    detects_light = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        for name in ("reflectance", "angular_falloff", "radial_falloff"):
            value = float(props.get(name, 0.0))
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} is {value:g}; give 0 to 1")
            setattr(self, name, value)
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = flags

    @property
    def radial_falloff_per_mm2(self) -> float:
        """`radial_falloff` as the factor of r^2."""
        return self.radial_falloff / RADIUS_MM**2

    def sample(self, ctx, si, sample1, sample2, active=True):
        cosine = mi.Frame3f.cos_theta(si.wi)
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        sample = dr.zeros(mi.BSDFSample3f)
        sample.pdf = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        wo.z = dr.mulsign(wo.z, cosine)
        sample.wo, sample.eta = wo, 1.0
        sample.sampled_type = +mi.BSDFFlags.DiffuseReflection
        reflected = active & (cosine != 0.0) & (sample.pdf > 0.0)
        return sample, dr.select(reflected, self._unpolarised(), 0.0)

    def eval(self, ctx, si, wo, active=True):
        return self._unpolarised() * self.pdf(ctx, si, wo, active)

    def pdf(self, ctx, si, wo, active=True):
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        return dr.select(active & (cos_i * cos_o > 0.0), dr.inv_pi * dr.abs(cos_o), 0.0)

    def _unpolarised(self):
        """The reflectance as a factor of any variant's spectra."""
        return mi.depolarizer(mi.UnpolarizedSpectrum(self.reflectance))

    def traverse(self, callback) -> None:
        for name in ("reflectance", "angular_falloff", "radial_falloff"):
            callback.put(name, getattr(self, name), mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return (
            f"Photodetector[reflectance = {self.reflectance}, "
            f"angular_falloff = {self.angular_falloff}, radial_falloff = {self.radial_falloff}]"
        )


mi.register_bsdf("photodetector", Photodetector)
