"""General path: any Mitsuba scene, through `ray_intersect` and the BSDFs' own `sample`."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.kernel import surface_physics
from mcrim_mitsuba.kernel.scene_model import DIELECTRIC, OTHER, SceneModel, surface_numbers


class GeneralPath:
    """Intersection and interaction through Mitsuba's own shapes and BSDFs.

    Known kinds of surface (photodetector, mask, and any surface when photons are
    polarised) follow `surface_physics`; everything else asks the BSDF.

    Parameters
    ----------
    model : SceneModel
    polarization : bool
        Whether photons carry a field, see `surface_physics`.
    """

    name = "any shape, by Mitsuba's ray_intersect"
    #: BSDFs of Mitsuba's own may lose light.
    surfaces_may_absorb = True

    def __init__(self, model: SceneModel, polarization: bool) -> None:
        self.model = model
        self.polarization = polarization
        self._tables = surface_physics.SurfaceTables(model.surfaces)
        self.surface_number = surface_numbers(model)
        self._context = mi.BSDFContext(mi.TransportMode.Importance)

    def intersect(self, ray_o, ray_d, last_face, volume):
        """Nearest surface ahead: distance in mm (Float) and what `interact` needs of it."""
        ray = mi.Ray3f(ray_o, ray_d)
        si = self.model.scene.ray_intersect(ray, mi.RayFlags.ShadingFrame, coherent=False)
        return dr.select(si.is_valid(), si.t, dr.inf), si

    def interact(self, position, direction, field, si, uniforms, active):
        """What happens at the surface: see `surface_physics.interact`.

        The next ray starts where Mitsuba spawns it, a little off the surface.
        """
        number = self.surface_number(si.shape, active)
        row = self._tables.at(number, active)
        normal = mi.Vector3f(si.n)
        outcome = surface_physics.interact(
            row, si.p, direction, field, normal, uniforms, self.polarization
        )
        # Mitsuba's own sampling decides where nothing of ours has to be carried along.
        asks = row.kind == OTHER
        if not self.polarization:
            asks |= row.kind == DIELECTRIC
        sample, weight = si.bsdf().sample(
            self._context, si, uniforms[0], mi.Point2f(uniforms[1], uniforms[2]), active & asks
        )
        wo = si.to_world(sample.wo)
        value = mi.unpolarized_spectrum(weight)[0]
        crossed = dr.dot(wo, normal) * dr.dot(direction, normal) > 0
        outcome.direction = dr.select(asks, wo, outcome.direction)
        outcome.crossed = dr.select(asks, crossed, outcome.crossed)
        alive = outcome.fate == surface_physics.ALIVE
        dead = asks & (value <= 0.0) & alive
        outcome.weight = dr.select(asks & alive & ~dead, value, 1.0)
        outcome.fate = dr.select(dead, mi.UInt32(surface_physics.SURFACE), outcome.fate)
        if self.polarization:
            fresh = surface_physics.unpolarised_field(wo, dr.two_pi * uniforms[3])
            # what lets light straight through leaves its polarisation alone
            kept = dr.dot(wo, direction) > 1.0 - 1e-6
            outcome.field = surface_physics.Field(
                dr.select(asks, dr.select(kept, field.re, fresh.re), outcome.field.re),
                dr.select(asks, dr.select(kept, field.im, fresh.im), outcome.field.im),
            )
        leaving = dr.dot(direction, normal) > 0
        # it ends up behind the face if it left from there and was turned back, or came through
        outcome.volume = dr.select(outcome.crossed ^ leaving, row.interior, row.exterior)
        outcome.position = mi.Point3f(si.spawn_ray(outcome.direction).o)
        return outcome
