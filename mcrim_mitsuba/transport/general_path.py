"""General path: any Mitsuba scene, through `ray_intersect` and, where needed, the BSDFs' `sample`.

Embree takes most of a step's time, and most of that for triangles (a rectangle is two of them);
so the flat faces of a scene with some curved ones are still tested in registers, and
Mitsuba is asked for the rest only.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport import surface_physics
from mcrim_mitsuba.transport.conversion import opaque, surface_numbers
from mcrim_mitsuba.transport.dielectric import unpolarised_field
from mcrim_mitsuba.transport.flat_path import MOST_FACES, NO_FACE, FlatPath, rows_of
from mcrim_mitsuba.transport.scene_model import OTHER, OUTSIDE, SceneModel

#: Distance in mm, over (1 + largest coordinate in mm), at which a new ray starts off a traced
#: surface: some thirty roundings. Mitsuba's own is 47 times larger: inside a curved surface it
#: lowers the sine of the next angle of incidence by 1e-4 at every reflection, and what total
#: reflection traps leaks out after some hundred of them.
RAY_OFFSET = 2.0**-19


@dataclass(frozen=True)
class Met:
    """What a ray meets first: a flat face tested in registers, or a shape asked of Mitsuba."""

    #: Number of the flat face; `NO_FACE` where Mitsuba's shape is nearer.
    face: mi.UInt32
    ray: mi.Ray3f
    #: Of Mitsuba's shapes; not valid where the flat face is nearer.
    hit: mi.PreliminaryIntersection3f
    #: Volume the ray is in.
    volume: mi.UInt32


class GeneralPath:
    """Intersection and interaction with a scene of any shapes and BSDFs.

    Dielectrics, reflectors, masks and detectors follow `surface_physics`; any other BSDF is asked
    for its own `sample`. Light meets the triangles of a mesh, not the smooth normals that a
    mesh may have for rendering: only so does it never find itself on the wrong side.

    With `trace_all` Mitsuba intersects all shapes, the flat ones included (for cross-checks). A
    scene of nothing but flat faces, which the fast path could do, is always traced so.
    """

    #: What reports call this path; a scene whose flat faces need no tracing has its own name.
    name = "Mitsuba for all shapes"
    #: Flights of its light are straight.
    folded = shuttle = None

    def __init__(self, model: SceneModel, polarization: bool, *, trace_all: bool = False) -> None:
        self.model = model
        self.polarization = polarization
        surfaces = model.surfaces
        flat = () if trace_all else _surfaces_for_registers(model)
        #: Surfaces whose shapes are intersected by Mitsuba; all others are tested in registers.
        self.traced = tuple(number for number in range(len(surfaces)) if number not in flat)
        if not self.traced:
            flat, self.traced = (), tuple(range(len(surfaces)))
        faces = tuple(face for face in model.flat_faces if face.surface in flat)
        walls = tuple(wall for wall in model.walls if wall.surface in flat)
        self._flat = None
        self._scene = model.scene
        if faces:
            self.name = "fast path for flat faces, Mitsuba for other shapes"
            registers = replace(model, flat_faces=faces, walls=walls, curved=())
            self._flat = FlatPath(registers, polarization)
            self._scene = _scene_of([model.shapes[number] for number in self.traced])
        # rows of the flat faces first, then one for each surface
        rows, normals = rows_of(replace(model, flat_faces=faces, walls=walls))
        self._first_surface = len(rows)
        rows += surfaces
        if model.endless is not None:
            rows += [model.open_to(s) for s in surfaces]
            ends = [[side in s.sides for s in surfaces] for side in (OUTSIDE, model.endless)]
            self._ends = [opaque(flags, mi.Bool) for flags in ends]
        normals += [np.zeros(3)] * (len(rows) - len(normals))
        self._tables = surface_physics.SurfaceTables(rows, normals)
        self._surface_number = surface_numbers(model)
        self._asks_bsdfs = any(surfaces[number].kind == OTHER for number in self.traced)
        #: As of `surface_physics.SurfaceTables`; BSDFs of Mitsuba's own may do both.
        self.surfaces_may_absorb = self._asks_bsdfs or self._tables.may_absorb
        self.surfaces_scatter = self._asks_bsdfs or self._tables.may_scatter
        self._context = mi.BSDFContext(mi.TransportMode.Importance)

    def intersect(self, ray_o, ray_d, last_face, volume, rng=None):
        """Nearest surface ahead: distance in mm (Float) and what `interact` needs of it."""
        ray = mi.Ray3f(ray_o, ray_d)
        face = mi.UInt32(NO_FACE)
        distance = mi.Float(dr.inf)
        if self._flat is not None:
            distance, face = self._flat.intersect(ray_o, ray_d, last_face, volume)
            ray.maxt = dr.minimum(distance, dr.largest(mi.Float))
        traced = self._scene.ray_intersect_preliminary(ray, coherent=False)
        nearer = traced.is_valid()
        distance = dr.select(nearer, traced.t, distance)
        return distance, Met(dr.select(nearer, mi.UInt32(NO_FACE), face), ray, traced, volume)

    @staticmethod
    def face_of(met: Met):
        """Number (UInt32) of the flat face that `intersect` found, if it was one."""
        return met.face

    def interact(self, position, direction, field, met, uniforms, rng, active):
        """What happens at the surface: see `surface_physics.interact`.

        A traced surface that the volume of the light is not on the near side of is passed as if
        it were not there: rounding has put the ray's start beyond the surface that it left.
        """
        traced = active & met.hit.is_valid()
        flags = mi.RayFlags.ShadingFrame if self._asks_bsdfs else mi.RayFlags.Minimal
        si = met.hit.compute_surface_interaction(met.ray, flags, traced)
        surface = self._surface_number(met.hit.shape, traced)
        number = self._first_surface + surface
        if self.model.endless is not None:
            # outside and the endless volume are in one place: the face names one of them
            to_air, to_liquid = (dr.gather(mi.Bool, ends, surface, traced) for ends in self._ends)
            others = (met.volume == self.model.endless) & to_air
            others |= (met.volume == OUTSIDE) & to_liquid
            number = dr.select(others, number + len(self.model.surfaces), number)
        row = self._tables.at(dr.select(traced, number, met.face), active)
        normal, point = mi.Vector3f(si.n), mi.Point3f(si.p)
        if self._flat is not None:
            self._flat.turn_normals(row, met.face, position)
            normal = dr.select(traced, normal, row.normal)
            point = dr.select(traced, point, position)
        row.normal = normal
        outcome = surface_physics.interact(row, point, direction, field, uniforms, rng, active)
        leaving = dr.dot(direction, normal) > 0
        if self._asks_bsdfs:
            asks = traced & (row.kind == OTHER)
            self._ask_bsdf(outcome, si, direction, field, normal, uniforms, asks)
            outcome.volume = surface_physics.volume_after(row, outcome.crossed, leaving)
        one_volume = row.interior == row.exterior
        faced = dr.select(leaving, row.interior, row.exterior)
        passes = traced & ~one_volume & (met.volume != faced)
        through = replace(
            outcome,
            direction=direction,
            field=field,
            fate=mi.UInt32(surface_physics.ALIVE),
            weight=mi.Float(1.0),
            crossed=mi.Mask(True),
            volume=met.volume,
        )
        for event in ("from_reflector", "from_detector", "met_rough", "from_mask"):
            if getattr(outcome, event) is not None:
                setattr(through, event, mi.Mask(False))
        if outcome.mask_radius2_mm2 is not None:
            through.mask_radius2_mm2 = mi.Float(0.0)
        outcome = dr.select(passes, through, outcome)
        # a flat face between one volume and itself is met from both sides: leave it behind too
        offset = RAY_OFFSET * (1.0 + dr.max(dr.abs(point)))
        off = dr.mulsign(offset, dr.dot(normal, outcome.direction))
        outcome.position = dr.select(traced | one_volume, dr.fma(normal, off, point), point)
        return outcome

    def _ask_bsdf(self, outcome, si, direction, field, normal, uniforms, asks) -> None:
        """Replace the outcome, where `asks`, by what the BSDF samples."""
        along = si.sh_frame.s
        along = dr.normalize(along - normal * dr.dot(normal, along))
        si.sh_frame = mi.Frame3f(along, dr.cross(normal, along), normal)
        si.wi = si.to_local(-direction)
        sample, weight = si.bsdf().sample(
            self._context, si, uniforms[0], mi.Point2f(uniforms[1], uniforms[2]), asks
        )
        wo = si.to_world(sample.wo)
        value = mi.unpolarized_spectrum(weight)[0]
        crossed = dr.dot(wo, normal) * dr.dot(direction, normal) > 0
        outcome.direction = dr.select(asks, wo, outcome.direction)
        outcome.crossed = dr.select(asks, crossed, outcome.crossed)
        alive = outcome.fate == surface_physics.ALIVE
        dead = asks & (value <= 0.0) & alive
        outcome.weight = dr.select(asks & alive & ~dead, value, outcome.weight)
        outcome.fate = dr.select(dead, mi.UInt32(surface_physics.SURFACE), outcome.fate)
        if self.polarization:
            fresh = unpolarised_field(wo, dr.two_pi * uniforms[3])
            # what lets light straight through leaves its polarisation alone
            kept = dr.dot(wo, direction) > 1.0 - 1e-6
            outcome.field = dr.select(asks, dr.select(kept, field, fresh), outcome.field)


def _surfaces_for_registers(model: SceneModel) -> set[int]:
    """Flat surfaces with BSDFs known here; those of fewest faces where there are too many."""
    numbers = [face.surface for face in model.flat_faces]
    numbers += [wall.surface for wall in model.walls]
    surfaces = (number for number in numbers if model.surfaces[number].kind != OTHER)
    fewest_first = sorted(Counter(surfaces).items(), key=lambda item: item[1])
    totals = itertools.accumulate(faces for _, faces in fewest_first)
    pairs = zip(fewest_first, totals, strict=True)
    return {surface for (surface, _), total in pairs if total <= MOST_FACES}


def _scene_of(shapes):
    """A scene of some of another scene's shapes."""
    names = [shape.id() for shape in shapes]
    members = {f"shape_{number}": shape for number, shape in enumerate(shapes)}
    scene = mi.load_dict({"type": "scene", **members}, parallel=False, optimize=False)
    # loading gave them the keys as ids
    for shape, name in zip(shapes, names, strict=True):
        shape.set_id(name)
    return scene
