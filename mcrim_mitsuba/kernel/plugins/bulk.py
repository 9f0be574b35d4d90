"""Medium plugin ``bulk``: a volume with coefficients in 1/cm, as people meet them."""

from __future__ import annotations

import mitsuba as mi

from mcrim_mitsuba.units import MM_PER_CM


class BulkMedium(mi.Medium):
    """Homogeneous volume that scatters and absorbs; scenes are in millimetres.

    XML: ``<medium type="bulk" id="crystal">`` with

    ``alpha_scat_per_cm`` : float, default 0
        Scattering coefficient.
    ``alpha_abs_per_cm`` : float, default 0
        Absorption coefficient.
    nested ``phase``
        Phase function of the scattering; isotropic when absent.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.alpha_scat_per_cm = float(props.get("alpha_scat_per_cm", 0.0))
        self.alpha_abs_per_cm = float(props.get("alpha_abs_per_cm", 0.0))
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
        callback.put("alpha_scat_per_cm", self.alpha_scat_per_cm, mi.ParamFlags.NonDifferentiable)
        callback.put("alpha_abs_per_cm", self.alpha_abs_per_cm, mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return (
            f"BulkMedium[alpha_scat = {self.alpha_scat_per_cm} /cm, "
            f"alpha_abs = {self.alpha_abs_per_cm} /cm]"
        )


mi.register_medium("bulk", BulkMedium)
