"""The transport loop: photons from birth to their fate, many per lane.

One lane of the vector registers follows one photon at a time and starts its next
one as soon as that ends, so no lane waits for the longest path of its packet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport import surface_physics as physics
from mcrim_mitsuba.transport.bulk import Scattering
from mcrim_mitsuba.transport.flat_path import NO_FACE
from mcrim_mitsuba.transport.launch_plan import LanePlan
from mcrim_mitsuba.transport.random_numbers import BirthLattice, PhotonSeeds, lane_generators
from mcrim_mitsuba.transport.record_store import Happened, RecordStore, TrailStore
from mcrim_mitsuba.transport.scene_model import DIFFUSE, OUTSIDE, opaque

#: Weight down to which losses lower a photon's weight. Below it the photon lives or
#: dies whole, so that faint photons end and every photon's fates still sum to one.
ANALOGUE_BELOW = 0.1

SURFACE_FATES = {
    physics.DETECTED: "detected",
    physics.APERTURE: "absorbed_aperture",
    physics.REFLECTOR: "absorbed_reflector",
    physics.SURFACE: "absorbed_surface",
    physics.ESCAPED: "escaped",
    physics.TRUNCATED: "truncated",
    physics.LOST: "lost",
}


@dataclass
class Photon:
    """The loop's state of one lane."""

    #: Point3f, Vector3f: Position in mm, unit direction.
    o: Any
    d: Any
    #: Polarisation, where it is followed.
    field: Any
    #: UInt32: Volume the photon is in; the face it is on, if any.
    volume: Any
    face: Any
    #: Weight, 1 at birth.
    w: Any
    #: UInt32: Free flights so far.
    steps: Any
    #: What records keep of the flight so far.
    history: Any
    #: UInt32: Photons the lane has yet to follow, this one included; the number of this one in the
    #: lane.
    left: Any
    serial: Any
    #: PCG32: Starts from a state of its own for every photon.
    rng: Any
    #: Weight that met each frequent fate, all photons of the lane so far.
    fates: dict
    #: Weight absorbed in each volume that absorbs.
    absorbed: dict


@dataclass(frozen=True)
class Launch:
    """What one kernel launch found."""

    #: ndarray of int64, shape (batches,)
    photons_per_batch: np.ndarray
    #: dict of str to ndarray of float64, shape (batches,): Per fate, the weight summed over the
    #: photons of each batch.
    weights: dict[str, np.ndarray]
    #: dict of str to ndarray, or None: Of the detected photons, see `RecordStore.collected`.
    records: dict[str, np.ndarray] | None
    #: ndarray of float64, shape (batches,), or None: Derivative of the detected weight along the
    #: tangent that was asked for.
    detected_slope: np.ndarray | None


@dataclass(frozen=True)
class Tangent:
    """Direction of a derivative through the simulation, in 1/mm per unit of whatever varies."""

    #: Change of the crystal's coefficients.
    alpha_scat_per_mm: float = 0.0
    alpha_abs_per_mm: float = 0.0


def launch(path, emitter, plan: LanePlan, *, seed, number, max_depth, alpha_scat_per_mm=None,
           alpha_abs_per_mm=None, keep_records=False, columns: Sequence[str] = (),
           tangent: Tangent | None = None, trails: TrailStore | None = None) -> Launch:  # fmt: skip
    """Follow photons through a scene in one kernel.

    Parameters
    ----------
    path : FlatPath or GeneralPath
    emitter : CrystalVolume
        Where photons are born.
    plan : LanePlan
    seed, number : int
        Of the run and of this launch within it; together they fix the random numbers.
    max_depth : int
        Free flights after which a photon is truncated.
    alpha_scat_per_mm : sequence of float, optional
        Proposals for the crystal's scattering coefficient, shared out by the plan; the
        scene's own value when absent.
    alpha_abs_per_mm : float, optional
        Absorption of the crystal in place of the scene's.
    keep_records : bool
        Whether to return the detected photons' histories.
    columns : sequence of str
        What histories hold besides scatterings, path, weight and batch: see `RecordStore`; what is
        not asked for costs nothing.
    tangent : Tangent, optional
        Also differentiate the detected weight along this direction, by Dr.Jit's forward mode:
        photons' ways stay as they are drawn, their probabilities and weights are differentiated.
    trails : TrailStore, optional
        Also write down where every photon flies. Absorption then takes photons whole, so that each
        has one fate; other photons than without are absorbed, but their random numbers are alike.

    Raises
    ------
    InputError
        For a record column that the scene does not give.
    """
    lanes, source = plan.lanes, emitter.volume
    scat, absorb = _coefficients(path.model, source, plan, alpha_scat_per_mm, alpha_abs_per_mm)
    scattering = Scattering(path.model.volumes, scat)
    if tangent is not None:
        for known, along in (
            (scat, tangent.alpha_scat_per_mm),
            (absorb, tangent.alpha_abs_per_mm),
        ):
            known[source] = mi.Float(known[source])
            dr.enable_grad(known[source])
            dr.set_grad(known[source], along)
    frequent, rare = _fates_of(path)
    # Rare fates are added to memory; registers are kept for what happens all the time.
    seldom = {code: dr.zeros(mi.Float, lanes) for code in rare}
    lane = dr.arange(mi.UInt32, lanes)
    depth_limit = opaque([max_depth], mi.UInt32)
    rng = lane_generators(lanes, seed, number)
    seeds = PhotonSeeds(lanes, seed, number, 2)
    lattice = BirthLattice(plan, seed, number)
    first_slot = opaque(plan.first_slot, mi.UInt32)
    photons = int(plan.photons.sum())
    births = None
    if not emitter.direct:
        births = emitter.sample(lane_generators(photons, seed, number, 1), photons)
        dr.eval(births)
        last_slot = opaque([photons - 1], mi.UInt32)
    store = RecordStore(path.model, source, photons, columns) if keep_records else None
    analogue_below = ANALOGUE_BELOW if trails is None else dr.inf

    def birthplace(serial):
        if births is None:
            point = lattice.mirrored(serial)
            return emitter.from_uniforms(*(lattice.coordinate(point, j) for j in range(3)))
        return dr.gather(mi.Point3f, births, dr.minimum(first_slot + serial, last_slot))

    def step(p: Photon) -> Photon:
        rng = p.rng
        free, survive, u, v = (rng.next_float32() for _ in range(4))
        turn = rng.next_float32() if path.polarization else None
        # only a surface that scatters needs a choice besides what else scattering takes
        choice = rng.next_float32() if path.surfaces_scatter else u

        # ---- flight: to the next scattering or surface --------------------------------
        inside = [p.volume == number for number in range(len(path.model.volumes))]
        a_s, a_a = _here(scat, inside), _here(absorb, inside)
        distance, met = path.intersect(p.o, p.d, p.face, p.volume)
        # A volume that is closed has a face ahead in every direction, scattering or not.
        nowhere = distance == dr.inf
        a_drawn = dr.detach(a_s)
        to_scatter = -dr.log(1.0 - free) / a_drawn
        strength = scattering.strength(inside, p.o, p.d)
        if strength is not None:
            to_scatter = strength.until(to_scatter)
        to_scatter = dr.select(a_drawn > 0.0, to_scatter, dr.inf)
        scatters = (to_scatter < distance) & ~nowhere
        distance = dr.select(nowhere, 0.0, dr.minimum(distance, to_scatter))
        weighted = distance if strength is None else strength.path(distance)
        position = dr.fma(p.d, distance, p.o)

        # ---- absorption: by weight, then whole ----------------------------------------
        kept = dr.exp(-a_a * distance)
        kept_drawn = dr.detach(kept)
        by_weight = p.w > analogue_below
        dies = ~by_weight & (survive >= kept_drawn)
        w = dr.select(by_weight, p.w * kept, dr.select(dies, 0.0, p.w))
        taken = p.w - w
        absorbed = {
            number: total + dr.select(inside[number], taken, 0.0)
            for number, total in p.absorbed.items()
        }
        if tangent is not None:
            # factors of 1 whose slopes are those of the probabilities of what was drawn
            w *= dr.select(by_weight, 1.0, kept / kept_drawn)
            w *= dr.exp((a_drawn - a_s) * weighted) * dr.select(scatters, a_s / a_drawn, 1.0)

        # ---- scattering or surface ----------------------------------------------------
        at_surface = ~(scatters | nowhere | dies)
        outcome = path.interact(position, p.d, p.field, met, (choice, u, v, turn), rng, at_surface)
        fate = dr.select(at_surface, outcome.fate, mi.UInt32(physics.ALIVE))
        fate = dr.select(
            nowhere,
            dr.select(p.volume == OUTSIDE, mi.UInt32(physics.ESCAPED), mi.UInt32(physics.LOST)),
            fate,
        )
        fate = dr.select(dies, mi.UInt32(physics.VOLUME), fate)
        dimmed = None
        if path.surfaces_may_absorb:
            # as in volumes; of a `survive` that was no death there the rest is even again
            whole = at_surface & ~by_weight & (survive >= kept_drawn * outcome.weight)
            fate = dr.select(whole & (fate == physics.ALIVE), mi.UInt32(physics.SURFACE), fate)
            factor = dr.select(by_weight, outcome.weight, dr.maximum(outcome.weight, 1.0))
            dimmed = dr.select(at_surface, w * factor, w)
        steps = p.steps + 1
        spent = (steps >= depth_limit) & (fate == physics.ALIVE)
        fate = dr.select(spent, mi.UInt32(physics.TRUNCATED), fate)
        ended = fate != physics.ALIVE

        # ---- books --------------------------------------------------------------------
        fates = {code: total + dr.select(fate == code, w, 0.0) for code, total in p.fates.items()}
        if dimmed is not None:
            fates[physics.SURFACE] += w - dimmed
            w = dimmed
        for code, totals in seldom.items():
            dr.scatter_add(totals, dr.detach(w), lane, fate == code)

        # ---- go on, or let the lane's next photon be born ------------------------------
        left = p.left - dr.select(ended, one, zero)
        serial = p.serial + dr.select(ended, one, zero)
        point = lattice.mirrored(serial)
        u = dr.select(ended, lattice.coordinate(point, 3), u)
        v = dr.select(ended, lattice.coordinate(point, 4), v)
        scattered = scattering.direction(inside, p.d, (u, v), ended)
        # A new photon and a scattered one are unpolarised alike.
        fresh = ended | ~at_surface
        direction = dr.select(fresh, scattered, outcome.direction)
        rng.state = dr.select(ended, seeds.state(serial), rng.state)
        field = None
        if path.polarization:
            angle = dr.two_pi * dr.select(ended, lattice.coordinate(point, 5), turn)
            unpolarised = physics.unpolarised_field(scattered, angle)
            field = physics.Field(
                dr.select(fresh, unpolarised.re, outcome.field.re),
                dr.select(fresh, unpolarised.im, outcome.field.im),
            )
        history = p.history
        if store is not None:
            happened = Happened(
                inside, distance, weighted, scatters & ~dies, dr.dot(p.d, scattered),
                at_surface, ~ended, outcome,
            )  # fmt: skip
            history = store.grown(history, happened)
            store.put(
                first_slot + p.serial, (fate == physics.DETECTED) & (p.left > 0), w, history,
                lambda: birthplace(p.serial), outcome.cosine, position,
            )  # fmt: skip
            history = dr.select(ended, store.nothing(), history)
        if trails is not None:
            # `survive` is the part that a flight up to here leaves of the light
            taken_at = dr.minimum(-dr.log(survive) / a_a, distance)
            trails.put(
                first_slot + p.serial, p.left > 0, p.steps, p.volume, p.o, p.d,
                dr.select(dies, dr.fma(p.d, taken_at, p.o), position), fate,
            )  # fmt: skip
        moved = dr.select(at_surface, outcome.position, position)
        return Photon(
            o=dr.select(ended, birthplace(serial), moved),
            d=direction,
            field=field,
            volume=dr.select(
                ended, mi.UInt32(source), dr.select(at_surface, outcome.volume, p.volume)
            ),
            face=dr.select(at_surface & ~ended, path.face_of(met), mi.UInt32(NO_FACE)),
            w=dr.select(ended, 1.0, w),
            steps=dr.select(ended, zero, steps),
            history=history,
            left=left,
            serial=serial,
            rng=rng,
            fates=fates,
            absorbed=absorbed,
        )

    zero, one = mi.UInt32(0), mi.UInt32(1)
    point = lattice.mirrored(zero)
    isotropic = mi.warp.square_to_uniform_sphere(
        mi.Point2f(*(lattice.coordinate(point, j) for j in (3, 4)))
    )
    rng.state = seeds.state(zero)
    field = None
    if path.polarization:
        field = physics.unpolarised_field(isotropic, dr.two_pi * lattice.coordinate(point, 5))
    start = Photon(
        o=birthplace(zero), d=isotropic, field=field,
        volume=dr.full(mi.UInt32, source, lanes), face=dr.full(mi.UInt32, NO_FACE, lanes),
        w=dr.full(mi.Float, 1.0, lanes), steps=dr.zeros(mi.UInt32, lanes),
        history=None if store is None else store.nothing(lanes),
        left=opaque(plan.photons, mi.UInt32), serial=dr.zeros(mi.UInt32, lanes), rng=rng,
        fates={code: dr.zeros(mi.Float, lanes) for code in frequent},
        absorbed={number: dr.zeros(mi.Float, lanes) for number in absorb},
    )  # fmt: skip
    (final,) = dr.while_loop(
        state=(start,),
        cond=lambda p: p.left > 0,
        body=lambda p: (step(p),),
        labels=("photon",),
        label="light transport",
    )
    slope: Any = None
    if tangent is not None:
        dr.enqueue(dr.ADMode.Forward, scat[source], absorb[source])
        dr.traverse(dr.ADMode.Forward)
        slope = dr.grad(final.fates[physics.DETECTED])
    totals = final.fates | seldom
    tables = [*(() if store is None else store.tables), *(() if trails is None else trails.tables)]
    dr.eval(totals, final.absorbed, slope, *tables)

    def per_batch(total):
        values = np.zeros(lanes) if total is None else np.array(total, dtype=np.float64)
        return plan.per_batch(values)

    weights = {name: per_batch(totals.get(code)) for code, name in SURFACE_FATES.items()}
    for number, volume in enumerate(path.model.volumes[1:], start=1):
        weights[f"absorbed_{volume.name}"] = per_batch(final.absorbed.get(number))
    return Launch(
        plan.per_batch(plan.photons).astype(np.int64),
        weights,
        None if store is None else store.collected(plan, float(emitter.upper[2])),
        None if slope is None else per_batch(slope),
    )


def _fates_of(path) -> tuple[list[int], list[int]]:
    """Fates that can happen at this scene's surfaces: frequent ones and rare ones."""
    surfaces = path.model.surfaces
    frequent = [physics.DETECTED, physics.ESCAPED]
    if any(s.aperture_radius_mm < np.inf for s in surfaces):
        frequent.append(physics.APERTURE)
    if any(s.kind == DIFFUSE for s in surfaces):
        frequent.append(physics.REFLECTOR)
    if path.surfaces_may_absorb:
        frequent.append(physics.SURFACE)
    return frequent, [physics.TRUNCATED, physics.LOST]


def _coefficients(model, source, plan, proposals, absorption):
    """Scattering and absorption in 1/mm of the volumes that have them, by their number."""
    scat = {
        number: opaque([volume.alpha_scat_per_mm])
        for number, volume in enumerate(model.volumes)
        if volume.alpha_scat_per_mm > 0.0 or number == source
    }
    absorb = {
        number: opaque([volume.alpha_abs_per_mm])
        for number, volume in enumerate(model.volumes)
        if volume.alpha_abs_per_mm > 0.0 or number == source
    }
    if proposals is not None:
        scat[source] = opaque(np.asarray(proposals)[plan.proposal])
    if absorption is not None:
        absorb[source] = opaque([absorption])
    return scat, absorb


def _here(coefficients, inside):
    """The coefficient of the volume a photon is in."""
    value = mi.Float(0.0)
    for number, own in coefficients.items():
        value = dr.select(inside[number], own, value)
    return value
