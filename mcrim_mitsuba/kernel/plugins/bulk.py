"""Medium plugin ``bulk``: a volume with coefficients in 1/cm, as people meet them."""

from __future__ import annotations

import mitsuba as mi

from mcrim_mitsuba.kernel.filling import is_filled
from mcrim_mitsuba.units import MM_PER_CM


class BulkMedium(mi.Medium):
    """Homogeneous volume that scatters and absorbs; scenes are in millimetres.

    XML: ``<medium type="bulk" id="crystal">`` with

    ``alpha_scat_per_cm`` : float, default 0
        Scattering coefficient.
    ``alpha_abs_per_cm`` : float, default 0
        Absorption coefficient.
    ``scattering_gradient`` : float q, default 0
        The scattering coefficient is alpha_scat (1 + q u), where u runs from -1 at the bottom of
        the volume to 1 at its top (z extent of the shapes that border it). Only the transport
        knows that extent; for pictures scattering is even.
    ``index`` : float, optional
        Index of refraction of what may fill the volume; where it is that of air (up to
        1.0005) nothing does, and the volume neither scatters nor absorbs.
    nested ``phase``
        Phase function of the scattering, ``isotropic``, ``hg`` or ``rayleigh``; isotropic when
        absent.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.alpha_scat_per_cm = float(props.get("alpha_scat_per_cm", 0.0))
        self.alpha_abs_per_cm = float(props.get("alpha_abs_per_cm", 0.0))
        self.scattering_gradient = float(props.get("scattering_gradient", 0.0))
        if not -1.0 <= self.scattering_gradient <= 1.0:
            raise ValueError(f"scattering_gradient is {self.scattering_gradient:g}; give -1 to 1")
        if "index" in props and not is_filled(float(props["index"])):
            self.alpha_scat_per_cm = self.alpha_abs_per_cm = 0.0
        self.m_is_homogeneous = True
        self.m_has_spectral_extinction = False

    def intersect_aabb(self, ray):
        return mi.Mask(True), mi.Float(0.0), mi.Float(mi.math.RayEpsilon)

    def get_majorant(self, mei, active=True):
        return mi.UnpolarizedSpectrum((self.alpha_scat_per_cm + self.alpha_abs_per_cm) / MM_PER_CM)

    def get_scattering_coefficients(self, mei, active=True):
        scattering = mi.UnpolarizedSpectrum(self.alpha_scat_per_cm / MM_PER_CM)
        return scattering, mi.UnpolarizedSpectrum(0.0), self.get_majorant(mei, active)

    def traverse(self, callback) -> None:
        for name in ("alpha_scat_per_cm", "alpha_abs_per_cm", "scattering_gradient"):
            callback.put(name, getattr(self, name), mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return (
            f"BulkMedium[alpha_scat = {self.alpha_scat_per_cm} /cm, "
            f"alpha_abs = {self.alpha_abs_per_cm} /cm]"
        )


mi.register_medium("bulk", BulkMedium)
