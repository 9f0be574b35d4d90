"""Emitter plugin ``scintillation``: photons born in a crystal's volume."""

from __future__ import annotations

import weakref
from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel.births import CrystalVolume


class ScintillationEmitter(mi.Emitter):
    """Isotropic, unpolarised emission, uniform in the volume of the crystal or near its top.

    XML: ``<emitter type="scintillation"><ref id="crystal"/></emitter>``, where the
    reference names the crystal's medium. Its volume is what the shapes that border this
    medium enclose; nothing about its form or place is written here. It may have

    ``source_depth_mm`` : float, default infinite
        Emission falls with the depth below the top of the crystal, as exp(-depth / this).
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        media = [props[key] for key in props.keys() if isinstance(props[key], mi.Medium)]
        if len(media) != 1:
            raise ValueError(
                'a scintillation emitter names one medium, the crystal: write <ref id="crystal"/>'
            )
        self.medium = media[0]
        self.source_depth_mm = float(props.get("source_depth_mm", float("inf")))
        if not self.source_depth_mm > 0.0:
            raise ValueError(f"source_depth_mm is {self.source_depth_mm:g}; give a positive number")
        self.m_flags = +mi.EmitterFlags.Empty
        self.m_needs_sample_2 = True
        self.m_needs_sample_3 = True
        self._volume: Callable[[], CrystalVolume | None] = lambda: None  # or a weak reference

    def volume(self, model) -> CrystalVolume:
        """The crystal's volume in a scene (`kernel.scene_model.SceneModel`).

        Whoever asks must keep it: it holds the scene, and the scene holds this emitter through
        C++, where Python's garbage collector cannot see a cycle.
        """
        volume = self._volume()
        if volume is None or volume.model is not model:
            volume = CrystalVolume(model, model.volume_index(self.medium), self.source_depth_mm)
            self._volume = weakref.ref(volume)
        return volume

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """A photon's birth as a ray; its weight is 1 whatever the wavelength.

        `sample1` gives the third coordinate that `sample2` lacks: light is monochromatic here.
        """
        volume = self._volume()
        if volume is None:
            raise InputError(
                "the emitter has not seen its scene",
                "call emitter.volume(model) first, and keep what it gives",
            )
        position = volume.from_uniforms(sample1, sample2.x, sample2.y)
        ray = dr.zeros(mi.Ray3f)
        ray.o, ray.d = position, mi.warp.square_to_uniform_sphere(sample3)
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

    def traverse(self, callback) -> None:
        callback.put("source_depth_mm", self.source_depth_mm, mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return (
            f"ScintillationEmitter[medium = {self.medium.id()}, "
            f"source_depth_mm = {self.source_depth_mm}]"
        )


mi.register_emitter("scintillation", ScintillationEmitter)
