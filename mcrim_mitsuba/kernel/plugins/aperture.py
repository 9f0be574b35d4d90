"""BSDF plugin ``aperture``: a black mask with a round hole, lying on an interface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class Aperture(mi.BSDF):
    """Opaque mask of zero thickness around a hole; inside the hole the nested interface acts.

    It absorbs on both sides. XML: ``<bsdf type="aperture">`` with

    ``radius`` : float
        Radius of the hole, in the scene's millimetres.
    ``centre`` : point, default (0, 0, 0)
        Any point of the hole's axis, which is parallel to z.
    nested ``bsdf``
        What the light meets inside the hole.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.radius = float(props["radius"])
        centre = props.get("centre", mi.ScalarPoint3f(0.0))
        self.centre = (float(centre[0]), float(centre[1]))
        nested = [props[k] for k in props.keys() if isinstance(props[k], mi.BSDF)]
        if not nested:
            raise ValueError("an aperture needs a nested bsdf, the interface inside its hole")
        self.interface = nested[0]
        self.m_components = [
            self.interface.flags(i) for i in range(self.interface.component_count())
        ]
        self.m_flags = self.interface.flags()

    def open(self, position):
        """Whether a point (Point3f, mm) lies in the hole (Mask)."""
        x, y = position.x - self.centre[0], position.y - self.centre[1]
        return dr.square(x) + dr.square(y) <= self.radius * self.radius

    def sample(self, ctx, si, sample1, sample2, active=True):
        sample, weight = self.interface.sample(ctx, si, sample1, sample2, active)
        return sample, dr.select(self.open(si.p), weight, 0.0)

    def eval(self, ctx, si, wo, active=True):
        return dr.select(self.open(si.p), self.interface.eval(ctx, si, wo, active), 0.0)

    def pdf(self, ctx, si, wo, active=True):
        return dr.select(self.open(si.p), self.interface.pdf(ctx, si, wo, active), 0.0)

    def traverse(self, callback) -> None:
        callback.put("interface", self.interface, mi.ParamFlags.Differentiable)
        callback.put("radius", self.radius, mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return f"Aperture[radius = {self.radius}, interface = {self.interface}]"


mi.register_bsdf("aperture", Aperture)
