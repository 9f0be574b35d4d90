"""The transport loop: photons fly, are absorbed, scatter or meet a surface, and are born again.

One lane of the vector registers follows one photon at a time and starts its next
one as soon as that ends, so no lane waits for the longest path of its packet.

Letters are those of the field: o, d and w are a photon's place, direction and weight, a_s and a_a
the coefficients of scattering and absorption (1/mm), u and v numbers even in [0, 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport import surface_physics as physics
from mcrim_mitsuba.transport.bulk import BirthLattice, PhotonSeeds, Scattering, lane_generators
from mcrim_mitsuba.transport.convex import NO_FACE
from mcrim_mitsuba.transport.launch_plan import LanePlan
from mcrim_mitsuba.transport.record_store import RecordStore
from mcrim_mitsuba.transport.scene_model import DIFFUSE, OUTSIDE, opaque

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.trails import TrailStore

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


# fmt: off
@dataclass
class Photon:
    """The loop's state: what every lane knows of its photon."""

    o: mi.Point3f         #: position, mm
    d: mi.Vector3f        #: unit direction of flight
    field: Any            #: polarisation (`surface_physics.Field`), where it is followed
    volume: mi.UInt32     #: volume it is in
    face: mi.UInt32       #: flat face it is on, or `NO_FACE`
    w: mi.Float           #: weight, 1 at birth
    steps: mi.UInt32      #: free flights so far
    history: Any          #: what records keep of the flights (`RecordStore.nothing`)
    left: mi.UInt32       #: photons the lane has yet to follow, this one included
    serial: mi.UInt32     #: number of this one in the lane
    rng: mi.PCG32         #: starts from a state of its own for every photon
    fates: dict           #: weight that met each frequent fate, all photons of the lane so far
    absorbed: dict        #: weight absorbed in each volume that absorbs, likewise


class Step:
    """What happens to the photons of all lanes in one step, written down piece by piece."""

    p: Photon             #: at the beginning of the step
    free: mi.Float        #: random numbers, even in [0, 1): for the free path,
    survive: mi.Float     #: for life or death where absorption takes photons whole,
    u: mi.Float           #: two for a new direction,
    v: mi.Float
    turn: Any             #: for a new polarisation, where that is followed,
    choice: mi.Float      #: and for what a surface does

    inside: list          #: per volume, whether the flight is in it
    a_s: mi.Float         #: coefficients there, 1/mm
    a_a: mi.Float
    distance: mi.Float    #: of the flight, mm
    weighted: mi.Float    #: the same, weighted with the relative strength of scattering
    position: mi.Point3f  #: where the flight ends, mm
    met: Any              #: what lies ahead, as the path through the scene tells
    nowhere: mi.Bool      #: whether nothing does
    scatters: mi.Bool     #: whether the flight ends in a scattering, if the photon lives

    w: mi.Float           #: weight that is left
    kept: mi.Float        #: fraction that the flight leaves of the light
    by_weight: mi.Bool    #: whether losses lower the weight; else the photon lives or dies whole
    dies: mi.Bool         #: whether absorption took it whole
    absorbed: dict        #: `Photon.absorbed` afterwards

    at_surface: mi.Bool   #: whether the flight ended at a surface
    outcome: Any          #: what happened there (`surface_physics.Outcome`)
    dimmed: Any           #: weight that surfaces leave, where they may absorb
    fate: mi.UInt32       #: of `surface_physics`; ALIVE where the photon goes on
    steps: mi.UInt32      #: free flights so far, this one included
    ended: mi.Bool        #: whether the photon met its fate

    serial: mi.UInt32     #: number of the lane's photon from now on
    scattered: Any        #: direction after a scattering or at birth
# fmt: on


@dataclass(frozen=True)
class Launch:
    """What one kernel launch found."""

    #: ndarray of int64, shape (batches,)
    photons_per_batch: np.ndarray
    #: dict of str to ndarray of float64, shape (batches,): Per fate, the weight summed over the
    #: photons of each batch.
    weights: dict[str, np.ndarray]
    #: dict of str to ndarray: Of the detected photons, see `RecordStore.collected`; empty where no
    #: records were asked for.
    records: dict[str, np.ndarray]
    #: ndarray of float64, shape (batches,), or None: Derivative of the detected weight along the
    #: tangent that was asked for.
    detected_slope: np.ndarray | None


def launch(path, emitter, plan: LanePlan, *, seed, number, max_depth, alpha_scat_per_mm=None,
           alpha_abs_per_mm=None, columns: Sequence[str] | None = None,
           tangent: tuple[float, float] | None = None,
           trails: TrailStore | None = None) -> Launch:  # fmt: skip
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
    columns : sequence of str, optional
        Return the detected photons' histories, with these columns besides scatterings, path,
        weight and batch (see `RecordStore`); what is not asked for costs nothing.
    tangent : tuple of float, optional
        Also differentiate the detected weight, by Dr.Jit's forward mode, along this change of the
        crystal's scattering and absorption, 1/mm per unit of whatever varies: photons' ways stay
        as they are drawn, their probabilities and weights are differentiated.
    trails : TrailStore, optional
        Also write down where every photon flies. Absorption then takes photons whole, so that each
        has one fate; other photons than without are absorbed, but their random numbers are alike.

    Raises
    ------
    InputError
        For a record column that the scene does not give.
    """
    loop = Loop(path, emitter, plan, seed, number, max_depth)
    loop.set_coefficients(alpha_scat_per_mm, alpha_abs_per_mm, tangent)
    if columns is not None:
        loop.store = RecordStore(emitter, loop.photons, columns)
    loop.trails = trails
    (final,) = dr.while_loop(
        state=(loop.start(),),
        cond=lambda p: p.left > 0,
        body=lambda p: (loop.step(p),),
        labels=("photon",),
        label="light transport",
    )
    return loop.gathered(final)


class Loop:
    """What all lanes of one launch share; parameters as those of `launch`.

    Attributes
    ----------
    photons : int
        Of all lanes.
    store : RecordStore or None
    trails : TrailStore or None
    """

    def __init__(self, path, emitter, plan: LanePlan, seed, number, max_depth) -> None:
        lanes = plan.lanes
        self.path, self.emitter, self.plan = path, emitter, plan
        self.photons = int(plan.photons.sum())
        self.store: RecordStore | None = None
        self.trails: TrailStore | None = None
        self._rng = lane_generators(lanes, seed, number)
        self._seeds = PhotonSeeds(lanes, seed, number, 2)
        self._lattice = BirthLattice(plan, seed, number)
        self._lane = dr.arange(mi.UInt32, lanes)
        self._first_slot = opaque(plan.first_slot, mi.UInt32)
        self._depth_limit = opaque([max_depth], mi.UInt32)
        self._births = None
        if not emitter.direct:
            rng = lane_generators(self.photons, seed, number, 1)
            self._births = emitter.sample(rng, self.photons)
            dr.eval(self._births)
            self._last_slot = opaque([self.photons - 1], mi.UInt32)
        self._frequent = _frequent_fates(path)
        # Rare fates are added to memory; registers are kept for what happens all the time.
        self._rare = {code: dr.zeros(mi.Float, lanes) for code in (physics.TRUNCATED, physics.LOST)}

    def set_coefficients(self, proposals, absorption, tangent: tuple[float, float] | None) -> None:
        """Scattering and absorption (1/mm) of the volumes that have them, by their number."""
        volumes, source = self.path.model.volumes, self.emitter.volume

        def coefficients(name):
            known = {number: getattr(volume, name) for number, volume in enumerate(volumes)}
            return {n: opaque([a]) for n, a in known.items() if a > 0.0 or n == source}

        scat, absorb = coefficients("alpha_scat_per_mm"), coefficients("alpha_abs_per_mm")
        if proposals is not None:
            scat[source] = opaque(np.asarray(proposals)[self.plan.proposal])
        if absorption is not None:
            absorb[source] = opaque([absorption])
        if tangent is not None:
            for known, slope in zip((scat, absorb), tangent, strict=True):
                known[source] = mi.Float(known[source])
                dr.enable_grad(known[source])
                dr.set_grad(known[source], slope)
        self._scat, self._absorb, self._tangent = scat, absorb, tangent
        self._scattering = Scattering(volumes, scat)

    def start(self) -> Photon:
        """The first photon of every lane, at birth."""
        lanes, zero = self.plan.lanes, mi.UInt32(0)
        point = self._lattice.mirrored(zero)
        u, v = (self._lattice.coordinate(point, j) for j in (3, 4))
        isotropic = mi.warp.square_to_uniform_sphere(mi.Point2f(u, v))
        self._rng.state = self._seeds.state(zero)
        field = None
        if self.path.polarization:
            turn = self._lattice.coordinate(point, 5)
            field = physics.unpolarised_field(isotropic, dr.two_pi * turn)
        return Photon(
            o=self._birthplace(zero),
            d=isotropic,
            field=field,
            volume=dr.full(mi.UInt32, self.emitter.volume, lanes),
            face=dr.full(mi.UInt32, NO_FACE, lanes),
            w=dr.full(mi.Float, 1.0, lanes),
            steps=dr.zeros(mi.UInt32, lanes),
            history=None if self.store is None else self.store.nothing(lanes),
            left=opaque(self.plan.photons, mi.UInt32),
            serial=dr.zeros(mi.UInt32, lanes),
            rng=self._rng,
            fates={code: dr.zeros(mi.Float, lanes) for code in self._frequent},
            absorbed={number: dr.zeros(mi.Float, lanes) for number in self._absorb},
        )

    def step(self, p: Photon) -> Photon:
        """One free flight and what follows from it."""
        s = Step()
        s.p = p
        self._draw(s)
        self._fly(s)
        self._absorb_light(s)
        self._meet_surface(s)
        self._meet_fate(s)
        fates = self._count(s)
        return self._go_on_or_be_born(s, fates)

    def _draw(self, s: Step) -> None:
        """Random numbers: in this order, whatever the step will need."""
        rng = s.p.rng
        s.free, s.survive, s.u, s.v = (rng.next_float32() for _ in range(4))
        s.turn = rng.next_float32() if self.path.polarization else None
        # only a surface that scatters needs a choice besides what else scattering takes
        s.choice = rng.next_float32() if self.path.surfaces_scatter else s.u

    def _fly(self, s: Step) -> None:
        """To the next scattering or surface, in a straight line."""
        p = s.p
        s.inside = [p.volume == number for number in range(len(self.path.model.volumes))]
        s.a_s, s.a_a = _here(self._scat, s.inside), _here(self._absorb, s.inside)
        ahead, s.met = self.path.intersect(p.o, p.d, p.face, p.volume)
        # A volume that is closed has a face ahead in every direction, scattering or not.
        s.nowhere = ahead == dr.inf
        drawn = dr.detach(s.a_s)
        to_scatter = -dr.log(1.0 - s.free) / drawn
        strength = self._scattering.strength(s.inside, p.o, p.d)
        if strength is not None:
            to_scatter = strength.until(to_scatter)
        to_scatter = dr.select(drawn > 0.0, to_scatter, dr.inf)
        s.scatters = (to_scatter < ahead) & ~s.nowhere
        s.distance = dr.select(s.nowhere, 0.0, dr.minimum(ahead, to_scatter))
        s.weighted = s.distance if strength is None else strength.path(s.distance)
        s.position = dr.fma(p.d, s.distance, p.o)

    def _absorb_light(self, s: Step) -> None:
        """In the volume, by weight; of faint photons some are taken whole."""
        p = s.p
        kept = dr.exp(-s.a_a * s.distance)
        s.kept = dr.detach(kept)
        s.by_weight = p.w > (ANALOGUE_BELOW if self.trails is None else dr.inf)
        s.dies = ~s.by_weight & (s.survive >= s.kept)
        s.w = dr.select(s.by_weight, p.w * kept, dr.select(s.dies, 0.0, p.w))
        taken = p.w - s.w
        s.absorbed = {
            number: total + dr.select(s.inside[number], taken, 0.0)
            for number, total in p.absorbed.items()
        }
        if self._tangent is not None:
            # factors of 1 whose slopes are those of the probabilities of what was drawn
            drawn = dr.detach(s.a_s)
            s.w *= dr.select(s.by_weight, 1.0, kept / s.kept)
            s.w *= dr.exp((drawn - s.a_s) * s.weighted) * dr.select(s.scatters, s.a_s / drawn, 1.0)

    def _meet_surface(self, s: Step) -> None:
        """Which reflects, refracts, counts or absorbs the photons that are there."""
        s.at_surface = ~(s.scatters | s.nowhere | s.dies)
        s.outcome = self.path.interact(
            s.position, s.p.d, s.p.field, s.met, (s.choice, s.u, s.v, s.turn), s.p.rng, s.at_surface
        )

    def _meet_fate(self, s: Step) -> None:
        """What became of the photon, and whether it is over."""
        outside = s.p.volume == OUTSIDE
        fate = dr.select(s.at_surface, s.outcome.fate, mi.UInt32(physics.ALIVE))
        leaves = dr.select(outside, mi.UInt32(physics.ESCAPED), mi.UInt32(physics.LOST))
        fate = dr.select(s.nowhere, leaves, fate)
        fate = dr.select(s.dies, mi.UInt32(physics.VOLUME), fate)
        s.dimmed = None
        if self.path.surfaces_may_absorb:
            # as in volumes; of a `survive` that was no death there the rest is even again
            weight = s.outcome.weight
            whole = s.at_surface & ~s.by_weight & (s.survive >= s.kept * weight)
            fate = dr.select(whole & (fate == physics.ALIVE), mi.UInt32(physics.SURFACE), fate)
            factor = dr.select(s.by_weight, weight, dr.maximum(weight, 1.0))
            s.dimmed = dr.select(s.at_surface, s.w * factor, s.w)
        s.steps = s.p.steps + 1
        spent = (s.steps >= self._depth_limit) & (fate == physics.ALIVE)
        s.fate = dr.select(spent, mi.UInt32(physics.TRUNCATED), fate)
        s.ended = s.fate != physics.ALIVE

    def _count(self, s: Step) -> dict:
        """Weight of every fate so far; the weight that goes on."""
        fates = {
            code: total + dr.select(s.fate == code, s.w, 0.0) for code, total in s.p.fates.items()
        }
        if s.dimmed is not None:
            fates[physics.SURFACE] += s.w - s.dimmed
            s.w = s.dimmed
        for code, totals in self._rare.items():
            dr.scatter_add(totals, dr.detach(s.w), self._lane, s.fate == code)
        return fates

    def _go_on_or_be_born(self, s: Step, fates: dict) -> Photon:
        """The photon after the step, or the lane's next one."""
        p, ended = s.p, s.ended
        over = dr.select(ended, mi.UInt32(1), mi.UInt32(0))
        left, s.serial = p.left - over, p.serial + over
        point = self._lattice.mirrored(s.serial)
        u = dr.select(ended, self._lattice.coordinate(point, 3), s.u)
        v = dr.select(ended, self._lattice.coordinate(point, 4), s.v)
        s.scattered = self._scattering.direction(s.inside, p.d, (u, v), ended)
        # A new photon and a scattered one are unpolarised alike.
        fresh = ended | ~s.at_surface
        d = dr.select(fresh, s.scattered, s.outcome.direction)
        p.rng.state = dr.select(ended, self._seeds.state(s.serial), p.rng.state)
        field = None
        if self.path.polarization:
            turn = dr.select(ended, self._lattice.coordinate(point, 5), s.turn)
            unpolarised = physics.unpolarised_field(s.scattered, dr.two_pi * turn)
            field = physics.select_field(fresh, unpolarised, s.outcome.field)
        history = self._write(s)
        position = dr.select(s.at_surface, s.outcome.position, s.position)
        volume = dr.select(s.at_surface, s.outcome.volume, p.volume)
        return Photon(
            o=dr.select(ended, self._birthplace(s.serial), position),
            d=d,
            field=field,
            volume=dr.select(ended, mi.UInt32(self.emitter.volume), volume),
            face=dr.select(s.at_surface & ~ended, self.path.face_of(s.met), mi.UInt32(NO_FACE)),
            w=dr.select(ended, 1.0, s.w),
            steps=dr.select(ended, mi.UInt32(0), s.steps),
            history=history,
            left=left,
            serial=s.serial,
            rng=p.rng,
            fates=fates,
            absorbed=s.absorbed,
        )

    def _write(self, s: Step):
        """Records and trails, where they are wanted; what is known of the flights from now on."""
        p, history, slot = s.p, s.p.history, self._first_slot + s.p.serial
        if self.store is not None:
            history = self.store.grown(history, s)
            detected = (s.fate == physics.DETECTED) & (p.left > 0)
            self.store.put(slot, detected, s, history, lambda: self._birthplace(p.serial))
            history = dr.select(s.ended, self.store.nothing(), history)
        if self.trails is not None:
            # `survive` is the part that a flight up to here leaves of the light
            taken_at = dr.minimum(-dr.log(s.survive) / s.a_a, s.distance)
            self.trails.put(
                slot, p.left > 0, p.steps, p.volume, p.o, p.d,
                dr.select(s.dies, dr.fma(p.d, taken_at, p.o), s.position), s.fate,
            )  # fmt: skip
        return history

    def _birthplace(self, serial):
        """Where the lanes' photons number `serial` (UInt32) are born (Point3f, mm)."""
        if self._births is None:
            point = self._lattice.mirrored(serial)
            return self.emitter.from_uniforms(
                *(self._lattice.coordinate(point, j) for j in range(3))
            )
        slot = dr.minimum(self._first_slot + serial, self._last_slot)
        return dr.gather(mi.Point3f, self._births, slot)

    def gathered(self, final: Photon) -> Launch:
        """What the loop found, when it has run."""
        slope: Any = None
        if self._tangent is not None:
            source = self.emitter.volume
            dr.enqueue(dr.ADMode.Forward, self._scat[source], self._absorb[source])
            dr.traverse(dr.ADMode.Forward)
            slope = dr.grad(final.fates[physics.DETECTED])
        totals = final.fates | self._rare
        tables = [each.tables for each in (self.store, self.trails) if each is not None]
        dr.eval(totals, final.absorbed, slope, tables)

        def per_batch(total):
            lanes = np.zeros(self.plan.lanes) if total is None else np.array(total, dtype=float)
            return self.plan.per_batch(lanes)

        weights = {name: per_batch(totals.get(code)) for code, name in SURFACE_FATES.items()}
        for number, name in enumerate(self.path.model.volume_names):
            if number != OUTSIDE:
                weights[f"absorbed_{name}"] = per_batch(final.absorbed.get(number))
        return Launch(
            self.plan.per_batch(self.plan.photons).astype(np.int64),
            weights,
            {} if self.store is None else self.store.collected(self.plan),
            None if slope is None else per_batch(slope),
        )


def _frequent_fates(path) -> list[int]:
    """Fates that can happen often at this scene's surfaces."""
    surfaces = path.model.surfaces
    frequent = [physics.DETECTED, physics.ESCAPED]
    if any(s.aperture_radius_mm < np.inf for s in surfaces):
        frequent.append(physics.APERTURE)
    if any(s.kind == DIFFUSE for s in surfaces):
        frequent.append(physics.REFLECTOR)
    if path.surfaces_may_absorb:
        frequent.append(physics.SURFACE)
    return frequent


def _here(coefficients, inside):
    """The coefficient of the volume a photon is in."""
    value = mi.Float(0.0)
    for number, own in coefficients.items():
        value = dr.select(inside[number], own, value)
    return value
