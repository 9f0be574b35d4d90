"""BSDF plugin ``polish``: the interface of two dielectrics, as well polished as it is."""

from __future__ import annotations

import mitsuba as mi

from mcrim_mitsuba.kernel.filling import is_filled

#: Facets steeper than these have no use as a polish, and their formulas no validity.
ROUGHEST = 1.0


class Polish(mi.BSDF):
    """Dielectric interface that may be rough, lossy, or of indices that are a little off.

    XML: ``<bsdf type="polish">`` with

    ``int_ior``, ``ext_ior`` : float
        Nominal indices of refraction behind the face and in front of it.
    ``int_offset``, ``ext_offset`` : float, default 0
        What is added to them; nothing where the nominal index is that of air, up to 1.0005.
    ``roughness_alpha`` : float, default 0
        Roughness of GGX microfacets, for light from both sides. A facet decides by Fresnel's
        formulas what it reflects; where that would send light to the wrong side of the face,
        another facet decides, so that nothing is lost.
    ``surface_loss`` : float, default 0
        Part of the light reflected back into the interior that the surface absorbs.

    The transport reads these numbers and samples the facets itself, see
    `kernel.surface_physics`; for pictures this is the smooth interface without loss.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.int_ior, self.ext_ior = (
            _shifted(float(props[f"{side}_ior"]), float(props.get(f"{side}_offset", 0.0)), side)
            for side in ("int", "ext")
        )
        self.roughness_alpha = float(props.get("roughness_alpha", 0.0))
        self.surface_loss = float(props.get("surface_loss", 0.0))
        if not 0.0 <= self.roughness_alpha <= ROUGHEST:
            raise ValueError(f"roughness_alpha is {self.roughness_alpha:g}; give 0 to {ROUGHEST:g}")
        if not 0.0 <= self.surface_loss <= 1.0:
            raise ValueError(f"surface_loss is {self.surface_loss:g}; give 0 to 1")
        self.smooth = mi.load_dict(
            {"type": "dielectric", "int_ior": self.int_ior, "ext_ior": self.ext_ior},
            parallel=False,
        )
        self.m_components = [self.smooth.flags(i) for i in range(self.smooth.component_count())]
        self.m_flags = self.smooth.flags()

    def sample(self, ctx, si, sample1, sample2, active=True):
        return self.smooth.sample(ctx, si, sample1, sample2, active)

    def eval(self, ctx, si, wo, active=True):
        return self.smooth.eval(ctx, si, wo, active)

    def pdf(self, ctx, si, wo, active=True):
        return self.smooth.pdf(ctx, si, wo, active)

    def traverse(self, callback) -> None:
        for name in ("int_ior", "ext_ior", "roughness_alpha", "surface_loss"):
            callback.put(name, getattr(self, name), mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return (
            f"Polish[int_ior = {self.int_ior}, ext_ior = {self.ext_ior}, "
            f"roughness_alpha = {self.roughness_alpha}, surface_loss = {self.surface_loss}]"
        )


def _shifted(nominal: float, offset: float, side: str) -> float:
    """An index with its offset."""
    index = nominal + offset if is_filled(nominal) else nominal
    if not index > 0.0:
        raise ValueError(f"{side}_ior is {index:g} with its offset; an index is positive")
    return index


mi.register_bsdf("polish", Polish)
