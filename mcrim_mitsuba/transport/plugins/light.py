"""Plugins through which light goes its way: medium bulk, emitter scintillation, integrator."""

from __future__ import annotations

import weakref
from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.transport.bulk import CollimatedBeam, CrystalVolume
from mcrim_mitsuba.transport.collection import Launcher, collect
from mcrim_mitsuba.transport.plugins import BEAM_AXES, beam_axis, described, number
from mcrim_mitsuba.transport.scene_model import read_scene_model


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
    ``endless`` : boolean, default false
        A clear liquid without end, which light enters through faces that name it as exterior and
        which is nowhere else: there light goes on as it would in the air outside, but what it
        meets borders the liquid, and what that sends back is lost.
    nested ``phase``
        Phase function of the scattering, ``isotropic``, ``hg`` or ``rayleigh``; isotropic when
        absent.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.alpha_scat_per_cm = float(props.get("alpha_scat_per_cm", 0.0))
        self.alpha_abs_per_cm = float(props.get("alpha_abs_per_cm", 0.0))
        self.scattering_gradient = number(props, "scattering_gradient", 0.0, low=-1.0)
        self.endless = bool(props.get("endless", False))
        if self.endless and (self.alpha_scat_per_cm or self.alpha_abs_per_cm):
            raise ValueError(
                "an endless medium neither scatters nor absorbs: take its numbers away"
            )
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

    traverse, _ = described("alpha_scat_per_cm", "alpha_abs_per_cm", "scattering_gradient")

    def to_string(self) -> str:
        return (
            f"BulkMedium[alpha_scat = {self.alpha_scat_per_cm} /cm, "
            f"alpha_abs = {self.alpha_abs_per_cm} /cm]"
        )


mi.register_medium("bulk", BulkMedium)


class ScintillationEmitter(mi.Emitter):
    """Isotropic, unpolarised emission, uniform in the volume of the crystal or near a face.

    XML: ``<emitter type="scintillation"><ref id="crystal"/></emitter>``, where the
    reference names the crystal's medium. Its volume is what the shapes that border this
    medium enclose; nothing about its form or place is written here. It may have

    ``source_depth_mm`` : float, default infinite
        Emission falls with the depth below the top of the crystal, as exp(-depth / this).
    ``side_depth_mm`` : float, default infinite
        The same from the side of the lowest x; not beside ``source_depth_mm``.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        media = [props[key] for key in props.keys() if isinstance(props[key], mi.Medium)]
        if len(media) != 1:
            raise ValueError(
                'a scintillation emitter names one medium, the crystal: write <ref id="crystal"/>'
            )
        self.medium = media[0]
        for name in ("source_depth_mm", "side_depth_mm"):
            depth_mm = float(props.get(name, float("inf")))
            if not depth_mm > 0.0:
                raise ValueError(f"{name} is {depth_mm:g}; give a positive number")
            setattr(self, name, depth_mm)
        if max(self.source_depth_mm, self.side_depth_mm) < float("inf"):
            raise ValueError("light is born near the top or near a side; give one depth")
        self.m_flags = +mi.EmitterFlags.Empty
        self.m_needs_sample_2 = True
        self.m_needs_sample_3 = True
        self._volume: Callable[[], CrystalVolume | None] = lambda: None  # or a weak reference

    def volume(self, model) -> CrystalVolume:
        """The crystal's volume in a scene (`transport.scene_model.SceneModel`).

        Whoever asks must keep it: it holds the scene, and the scene holds this emitter through
        C++, where Python's garbage collector cannot see a cycle.
        """
        volume = self._volume()
        if volume is None or volume.model is not model:
            volume = self._born_in(model, model.volume_index(self.medium))
            self._volume = weakref.ref(volume)
        return volume

    def _born_in(self, model, number: int) -> CrystalVolume:
        return CrystalVolume(model, number, self.source_depth_mm, self.side_depth_mm)

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """A photon's birth as a ray; its weight is 1 whatever the wavelength.

        `sample1` gives the third coordinate that `sample2` lacks: light is monochromatic here.
        """
        volume = self._volume()
        if volume is None:
            problem = "the emitter has not seen its scene"
            raise InputError(problem, "call emitter.volume(model) first, and keep what it gives")
        position = volume.from_uniforms(sample1, sample2.x, sample2.y)
        ray = dr.zeros(mi.Ray3f)
        ray.o, ray.d = position, mi.warp.square_to_uniform_sphere(sample3)
        if volume.aim is not None:
            ray.d = mi.Vector3f(volume.aim)
        ray.maxt, ray.time = dr.inf, time
        return ray, mi.Spectrum(1.0)

    def sample_direction(self, it, sample, active=True):
        return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0.0)

    def pdf_direction(self, it, ds, active=True):
        return mi.Float(0.0)

    def eval(self, si, active=True):
        return mi.Spectrum(0.0)

    def bbox(self):
        return mi.ScalarBoundingBox3f()

    traverse, _ = described("source_depth_mm", "side_depth_mm")

    def to_string(self) -> str:
        return (
            f"ScintillationEmitter[medium = {self.medium.id()}, "
            f"source_depth_mm = {self.source_depth_mm}, side_depth_mm = {self.side_depth_mm}]"
        )


mi.register_emitter("scintillation", ScintillationEmitter)


class CollimatedBeamEmitter(ScintillationEmitter):
    """The beam of a spectrophotometer: parallel light through the middle of the crystal.

    XML: ``<emitter type="collimated_beam"><ref id="crystal"/> ...</emitter>``, where the reference
    names the crystal's medium, with

    ``diameter`` : float
        Of the beam, in the scene's millimetres; evenly lit.
    ``axis`` : string, default ``x``
        ``x``, ``y`` or ``z``: the beam flies along this axis, towards higher values.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.axis = beam_axis(props)
        self.diameter_mm = float(props["diameter"])
        if not self.diameter_mm > 0.0:
            raise ValueError(f"the beam's diameter is {self.diameter_mm:g}; give a positive number")

    def _born_in(self, model, number: int) -> CrystalVolume:
        return CollimatedBeam(model, number, BEAM_AXES.index(self.axis), self.diameter_mm)

    traverse, to_string = described("axis", "diameter_mm")


mi.register_emitter("collimated_beam", CollimatedBeamEmitter)


#: Free flights after which photons are given up in crystals that scatter, and in clear ones.
MAX_DEPTH_SCATTERING, MAX_DEPTH_CLEAR = 200_000, 2_000


class LightCollectionIntegrator(mi.CppADIntegrator):
    """Traces scintillation photons forward, from the crystal to their fate.

    XML: ``<integrator type="light_collection">`` with

    ``max_depth`` : integer, optional
        Free flights after which a photon is given up; what that cuts off is counted as
        ``truncated`` and reported. Without it, 200,000 where the crystal scatters, so that all
        light comes out, and 2,000 where it does not: light that is trapped there stays.
    ``polarization`` : boolean, default false
        Whether Fresnel reflection follows each photon's polarisation.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = int(props["max_depth"]) if "max_depth" in props else None
        self.polarization = bool(props.get("polarization", False))
        if self.max_depth is not None and self.max_depth < 1:
            raise ValueError(f"max_depth is {self.max_depth}; give at least 1")

    def depth_limit(self, scatters: bool) -> int:
        """Free flights after which a photon is given up, in a crystal that scatters or not."""
        if self.max_depth is not None:
            return self.max_depth
        return MAX_DEPTH_SCATTERING if scatters else MAX_DEPTH_CLEAR

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Mitsuba's entrance: the light collection efficiency as a tensor of shape (1, 1, 1).

        ``spp`` is the number of photons; 0 stands for a million.
        """
        emitter = next(e for e in scene.emitters() if hasattr(e, "volume"))
        crystal = emitter.volume(read_scene_model(scene))
        launcher = Launcher(crystal, self.polarization)
        limit = self.depth_limit(crystal.scatters)
        collect(launcher, spp or 10**6, seed=seed, max_depth=limit)
        return mi.TensorXf([launcher.tally.eta], (1, 1, 1))

    def aov_names(self) -> list[str]:
        return []

    traverse, to_string = described("max_depth", "polarization")


mi.register_integrator("light_collection", LightCollectionIntegrator)
