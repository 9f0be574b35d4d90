"""Integrator plugin ``light_collection``: follows photons and counts where each one ends."""

from __future__ import annotations

import mitsuba as mi

from mcrim_mitsuba.kernel import collection
from mcrim_mitsuba.kernel.scene_model import read_scene_model

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

    def collect(self, model, crystal, **options) -> collection.Collected:
        """Fates of photons born in the crystal: see `kernel.collection.collect`.

        `max_depth` among the options replaces the scene's.
        """
        options = {"max_depth": self.depth_limit(crystal.scatters)} | options
        return collection.collect(model, crystal, polarization=self.polarization, **options)

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Mitsuba's entrance: the light collection efficiency as a tensor of shape (1, 1, 1).

        ``spp`` is the number of photons; 0 stands for a million.
        """
        emitter = next(e for e in scene.emitters() if hasattr(e, "volume"))
        model = read_scene_model(scene)
        found = self.collect(model, emitter.volume(model), photons=spp or 10**6, seed=seed)
        return mi.TensorXf([found.tally.fraction("detected")], (1, 1, 1))

    def aov_names(self) -> list[str]:
        return []

    def traverse(self, callback) -> None:
        if self.max_depth is not None:
            callback.put("max_depth", self.max_depth, mi.ParamFlags.NonDifferentiable)
        callback.put("polarization", self.polarization, mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return (
            f"LightCollectionIntegrator[max_depth = {self.max_depth}, "
            f"polarization = {self.polarization}]"
        )


mi.register_integrator("light_collection", LightCollectionIntegrator)
