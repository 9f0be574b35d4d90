"""BSDF plugins of a bench: aperture (a mask), photodetector, and polish (two dielectrics)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.core.numbers import LARGEST_INDEX
from mcrim_mitsuba.optics.emission_band import USUAL_NM
from mcrim_mitsuba.optics.thin_film import ThinFilm, cathode_index
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.transport.plugins import described, number

#: Distance from the axis at which `radial_falloff` is what is lacking, in the scene's mm.
RADIUS_MM = 14.0
#: Facets steeper than these have no use as a polish, and their formulas no validity.
ROUGHEST = 1.0
#: Films thicker than this, nm, let no light through: they are no photocathodes.
THICKEST_NM = 200.0
#: Fine roughness beyond which the formula for its scattered part holds no longer.
HIGHEST_NM = 200.0


def _centre(props: mi.Properties) -> tuple[float, float]:
    """x and y of an axis parallel to z, of which ``centre`` is any point."""
    centre = props.get("centre", mi.ScalarPoint3f(0.0))
    return float(centre[0]), float(centre[1])


def _take_flags(bsdf, inner) -> None:
    """Make a BSDF reflect and transmit as another one does."""
    bsdf.m_components = [inner.flags(i) for i in range(inner.component_count())]
    bsdf.m_flags = inner.flags()


class Aperture(mi.BSDF):
    """Opaque mask of zero thickness around a hole; inside the hole the nested interface acts.

    It absorbs on both sides, all of the light unless it has a `reflectance`. XML:
    ``<bsdf type="aperture">`` with

    ``radius`` : float
        Radius of the hole, in the scene's millimetres.
    ``centre`` : point, default (0, 0, 0)
        Any point of the hole's axis, which is parallel to z.
    ``reflectance`` : float, default 0
        Part of the light that the mask's upper side, towards +z, sends back by Lambert's law and
        unpolarised.
    nested ``bsdf``
        What the light meets inside the hole.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.radius = float(props["radius"])
        self.centre = _centre(props)
        self.reflectance = number(props, "reflectance", 0.0)
        nested = [props[k] for k in props.keys() if isinstance(props[k], mi.BSDF)]
        if not nested:
            raise ValueError("an aperture needs a nested bsdf, the interface inside its hole")
        self.interface = nested[0]
        _take_flags(self, self.interface)

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
        callback.put("reflectance", self.reflectance, mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return f"Aperture[radius = {self.radius}, interface = {self.interface}]"


mi.register_bsdf("aperture", Aperture)


class Photodetector(mi.BSDF):
    """Index-matched detector; a shape that wears it counts the light that it accepts.

    XML: ``<bsdf type="photodetector">``, an ideal absorber on both sides unless it has

    ``reflectance`` : float, default 0
        Probability with which light is sent back to where it came from, by Lambert's law and
        unpolarised; decided first.
    ``specular`` : float, default 0
        Probability with which other light is reflected as by a metal's mirror; decided next.
    ``cathode_nm`` : float, default 0
        Thickness of a photocathode (`optics.thin_film`) between the medium before the detector, of
        index ``window_index``, and vacuum. Other light is reflected specularly, absorbed, which
        is detected, or lost in the vacuum, at ``wavelength_nm`` (540). Without a thickness there
        is none.
    ``cathode_n``, ``cathode_k`` : float
        Index n + ik of the photocathode; by default K-Cs-Sb at the wavelength.
    ``angular_falloff`` : float a, default 0
        Light that arrives at an angle theta to the normal is accepted with probability
        1 - a (1 - cos theta), and else absorbed in the surface. If a is negative the
        probability is that over 1 - a.
    ``radial_falloff`` : float b, default 0
        Light that arrives at r mm from its axis is accepted with probability 1 - b (r / 14)^2.
    ``centre`` : point, default (0, 0, 0)
        Any point of the axis, which is parallel to z. In an aperture it is that of the hole.
    ``acceptance_deg`` : float, default 90
        Light that arrives at a larger angle to the normal is absorbed in the surface.

    Detectors are calibrated with light that arrives head-on. What they detect of it (`head_on`) is
    below 1 with a photocathode or a negative ``angular_falloff``; eta counts relative to it.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        for name in ("reflectance", "specular", "radial_falloff"):
            setattr(self, name, number(props, name, 0.0))
        self.angular_falloff = number(props, "angular_falloff", 0.0, low=-1.0)
        self.cathode_nm = number(props, "cathode_nm", 0.0, high=THICKEST_NM)
        self.wavelength_nm = number(props, "wavelength_nm", USUAL_NM, low=100.0, high=1e4)
        self.cathode_n = number(props, "cathode_n", 0.0, high=LARGEST_INDEX)
        self.cathode_k = number(props, "cathode_k", 0.0, high=LARGEST_INDEX)
        if bool(self.cathode_n) != bool(self.cathode_k):
            raise ValueError("cathode_n and cathode_k are one index; give both, above 0")
        if self.cathode_n and "cathode_nm" not in props:
            raise ValueError("cathode_n and cathode_k without cathode_nm; give the thickness")
        self.window_index = number(props, "window_index", 1.0, low=1.0, high=LARGEST_INDEX)
        self.centre = _centre(props)
        self.acceptance_deg = number(props, "acceptance_deg", 90.0, high=90.0)
        if self.specular and self.cathode_nm:
            raise ValueError("cathode_nm says how the detector reflects; leave out specular")
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = flags

    @property
    def film(self) -> ThinFilm | None:
        """The photocathode."""
        if not self.cathode_nm:
            return None
        index = complex(self.cathode_n, self.cathode_k) or cathode_index(self.wavelength_nm)
        return ThinFilm(index, self.cathode_nm / self.wavelength_nm, self.window_index)

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

    traverse, to_string = described(
        "reflectance specular cathode_nm angular_falloff radial_falloff acceptance_deg"
    )


mi.register_bsdf("photodetector", Photodetector)


class Polish(mi.BSDF):
    """Dielectric interface that may be rough, lossy, or of indices that are a little off.

    XML: ``<bsdf type="polish">`` with

    ``int_ior``, ``ext_ior`` : float
        Nominal indices of refraction behind the face and in front of it.
    ``int_offset``, ``ext_offset`` : float, default 0
        What is added to them; nothing where the nominal index is that of air, up to 1.0005.
    ``roughness_alpha`` : float, default 0
        Roughness of microfacets, for light from both sides. Facets decide by Fresnel's formulas
        what they reflect, one after the other until light leaves the face: nothing is lost.
    ``distribution`` : ``ggx`` or ``beckmann``, default ``ggx``
        Of the facets' slopes.
    ``surface_loss`` : float, default 0
        Part of the light reflected back into the interior that the surface absorbs.
    ``ground_loss`` : float, default 0
        Part of the light from the interior that a rough face absorbs before its facets decide.
    ``rms_roughness_nm`` : float, default 0
        Height of a fine roughness, whose slopes do not matter: part of the light that is reflected
        or refracted goes to other directions of that side.
    ``wavelength_nm`` : float, default 540
        Of the light, in vacuum: what fine roughness is compared with.

    The transport reads these numbers and samples the facets itself, see
    `transport.surface_physics`; for pictures this is the smooth interface without loss.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.int_ior, self.ext_ior = _shifted(props, "int"), _shifted(props, "ext")
        self.roughness_alpha = number(props, "roughness_alpha", 0.0, high=ROUGHEST)
        self.distribution = str(props.get("distribution", "ggx"))
        if self.distribution not in ("ggx", "beckmann"):
            raise ValueError(f"distribution is ggx or beckmann, not {self.distribution}")
        self.surface_loss = number(props, "surface_loss", 0.0)
        self.ground_loss = number(props, "ground_loss", 0.0)
        self.rms_roughness_nm = number(props, "rms_roughness_nm", 0.0, high=HIGHEST_NM)
        self.wavelength_nm = number(props, "wavelength_nm", USUAL_NM, low=100.0, high=1e4)
        dielectric = {"type": "dielectric", "int_ior": self.int_ior, "ext_ior": self.ext_ior}
        self.smooth = mi.load_dict(dielectric, parallel=False)
        _take_flags(self, self.smooth)

    def sample(self, ctx, si, sample1, sample2, active=True):
        return self.smooth.sample(ctx, si, sample1, sample2, active)

    def eval(self, ctx, si, wo, active=True):
        return self.smooth.eval(ctx, si, wo, active)

    def pdf(self, ctx, si, wo, active=True):
        return self.smooth.pdf(ctx, si, wo, active)

    traverse, to_string = described(
        "int_ior ext_ior roughness_alpha surface_loss ground_loss rms_roughness_nm wavelength_nm"
    )


def _shifted(props: mi.Properties, side: str) -> float:
    """An index with its offset."""
    nominal, offset = float(props[f"{side}_ior"]), float(props.get(f"{side}_offset", 0.0))
    index = nominal + offset if is_filled(nominal) else nominal
    if not index > 0.0:
        raise ValueError(f"{side}_ior is {index:g} with its offset; an index is positive")
    return index


mi.register_bsdf("polish", Polish)
