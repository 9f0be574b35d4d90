"""Emitter plugin ``scintillation``: photons born uniformly in a crystal's volume."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel.births import CrystalVolume


class ScintillationEmitter(mi.Emitter):
    """Isotropic, unpolarised emission, uniform in the volume of the crystal.

    XML: ``<emitter type="scintillation"><ref id="crystal"/></emitter>``, where the
    reference names the crystal's medium. Its volume is what the shapes that border this
    medium enclose; nothing about its form or place is written here.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        media = [props[key] for key in props.keys() if isinstance(props[key], mi.Medium)]
        if len(media) != 1:
            raise ValueError(
                'a scintillation emitter names one medium, the crystal: write <ref id="crystal"/>'
            )
        self.medium = media[0]
        self.m_flags = +mi.EmitterFlags.Empty
        self.m_needs_sample_2 = True
        self.m_needs_sample_3 = True
        self._volume = None

    def volume(self, model) -> CrystalVolume:
        """The crystal's volume in a scene (`kernel.scene_model.SceneModel`)."""
        if self._volume is None or self._volume.model is not model:
            self._volume = CrystalVolume(model, model.volume_index(self.medium))
        return self._volume

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """A photon's birth as a ray; its weight is 1 whatever the wavelength.

        `sample1` gives the third coordinate that `sample2` lacks: light is monochromatic here.
        """
        if self._volume is None:
            raise InputError(
                "the emitter has not seen its scene", "call emitter.volume(model) first"
            )
        position = self._volume.from_uniforms(sample1, sample2.x, sample2.y)
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
        pass

    def to_string(self) -> str:
        return f"ScintillationEmitter[medium = {self.medium.id()}]"


mi.register_emitter("scintillation", ScintillationEmitter)
