"""The transport loop: photons fly, are absorbed, scatter or meet a surface, and are born again.

One lane of the vector registers follows one photon at a time and starts its next
one as soon as that ends, so no lane waits for the longest path of its packet.

Letters are those of the field: o, d and w are a photon's place, direction and weight, a_s and a_a
the coefficients of scattering and absorption (1/mm), u and v numbers even in [0, 1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.transport import surface_physics as physics
from mcrim_mitsuba.transport.bulk import CrystalVolume, Scattering, lane_generators, lane_numbers
from mcrim_mitsuba.transport.conversion import opaque, opaque_vector
from mcrim_mitsuba.transport.convex import NO_FACE
from mcrim_mitsuba.transport.dielectric import resumed, unpolarised_field
from mcrim_mitsuba.transport.launch_plan import BATCHES, LanePlan, ScatteringProposals, detected_by
from mcrim_mitsuba.transport.record_store import RecordStore, TrailStore
from mcrim_mitsuba.transport.scene_model import DIFFUSE, OUTSIDE

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
    """The loop's state: what every lane knows of its photon."""

    o: mi.Point3f  #: position, mm
    d: mi.Vector3f  #: unit direction of flight
    field: Any  #: polarisation (`dielectric.Field`), where it is followed
    volume: mi.UInt32  #: volume it is in
    face: mi.UInt32  #: flat face it is on, or `NO_FACE`
    free: Any  #: what is left of its way to a scattering, mm; 0 if not known, ``None`` if never
    w: mi.Float  #: weight, 1 at birth
    steps: mi.UInt32  #: free flights so far
    history: Any  #: what records keep of the flights (`RecordStore.nothing`)
    left: mi.UInt32  #: photons the lane has yet to follow, this one included
    serial: mi.UInt32  #: number of this one in the lane
    state: mi.UInt64  #: of its random numbers, which start anew for every photon
    fates: dict  #: weight that met each frequent fate, all photons of the lane so far
    absorbed: dict  #: weight absorbed in each volume that absorbs, likewise
    detected: dict  #: weight that each of several detectors took, by number, likewise


@dataclass
class Step:
    """One free flight of the photons of all lanes, for those who write it down."""

    p: Photon  #: at its beginning
    survive: mi.Float  #: part of the light that a flight must leave for a photon to live
    inside: list  #: per volume, whether the flight is in it
    a_a: mi.Float  #: absorption there, 1/mm
    distance: mi.Float  #: of the flight, mm
    weighted: mi.Float  #: the same, weighted with the relative strength of scattering
    position: mi.Point3f  #: where the flight ends, mm
    arriving: mi.Vector3f  #: direction there
    folds: Any  #: total reflections that it passed over (UInt32), where flights do
    scatters: mi.Bool  #: whether it ends in a scattering, if the photon lives
    scattered: Any  #: direction after a scattering or at birth
    dies: mi.Bool  #: whether absorption took the photon whole
    at_surface: mi.Bool  #: whether the flight ended at a surface
    outcome: Any  #: what happened there (`surface_physics.Outcome`)
    w: mi.Float  #: weight that is left
    fate: mi.UInt32  #: of `surface_physics`; ALIVE where the photon goes on
    ended: mi.Bool  #: whether the photon met its fate


@dataclass(frozen=True)
class Launch:
    """What one kernel launch found."""

    #: ndarray of int64, shape (batches,)
    photons_per_batch: np.ndarray
    #: dict of str to ndarray of float64, shape (batches,): Per fate, and per detector where there
    #: are several (`launch_plan.detected_by`), the weight summed over the photons of each batch.
    weights: dict[str, np.ndarray]
    #: dict of str to ndarray: Of the detected photons, see `RecordStore.collected`; empty where no
    #: records were asked for.
    records: dict[str, np.ndarray]
    #: ndarray of float64, shape (batches,), or None: Derivative of the detected weight along the
    #: tangent that was asked for.
    detected_slope: np.ndarray | None
    births: np.ndarray  #: int64, (batches, x, y, z): In the cells; empty where none were given


def launch(path, emitter: CrystalVolume, plan: LanePlan, **options) -> Launch:
    """Follow photons through a scene in one kernel; parameters as those of `Loop`."""
    loop = Loop(path, emitter, plan, **options)
    (final,) = dr.while_loop(
        state=(loop.start(),),
        cond=lambda p: p.left > 0,
        body=lambda p: (loop.step(p),),
        labels=("photon",),
        label="light transport",
    )
    return loop.gathered(final)


class Loop:
    """What all lanes of one launch share.

    `seed` and `number`, of the run and of this launch within it, together fix the random numbers.
    After `max_depth` free flights a photon is truncated. Coefficients of the crystal may be
    `proposals` in place of the scene's, shared out by the plan. With `columns` the histories
    of the photons that eta counts are returned, these besides scatterings, path, weight and batch
    (see `RecordStore`); what is not asked for costs nothing. Of `birth_cells` the
    evenly rising edges are given, mm: births are random then, on no lattice, and counted in them.

    With a `tangent` the detected weight is also differentiated, by Dr.Jit's forward mode, along
    this change of volumes' scattering and absorption, 1/mm per unit of whatever varies: photons'
    ways stay as they are drawn, their probabilities and weights are differentiated. Of a volume
    that does not scatter they tell the absorption's part only.

    With `trails` it is also written down where every photon flies. Absorption then takes photons
    whole, so that each has one fate; other photons than without are absorbed, but their random
    numbers are alike.

    Raises InputError for a record column that the scene does not give.
    """

    def __init__(
        self,
        path,
        emitter: CrystalVolume,
        plan: LanePlan,
        *,
        seed: int,
        number: int,
        max_depth: int,
        proposals: ScatteringProposals | None = None,
        columns: Sequence[str] | None = None,
        tangent: Mapping[int, Sequence[float]] | None = None,
        trails: TrailStore | None = None,
        birth_cells: Sequence[np.ndarray] = (),
    ) -> None:
        lanes, photons = plan.lanes, int(plan.photons.sum())
        self.path, self.emitter, self.plan = path, emitter, plan
        self.store = None if columns is None else RecordStore(emitter, photons, columns)
        assert trails is None or path.folded is None
        self.trails, self._tangent = trails, tangent
        numbers = lane_numbers(mi.variant(), plan, seed, number)
        self._stream, self._seeds, self._lattice, self._first_slot = numbers
        self._lane = dr.arange(mi.UInt32, lanes)
        self._depth_limit = opaque([max_depth], mi.UInt32)
        self._aim = None if emitter.aim is None else opaque_vector(emitter.aim)
        self._place_of: Any = None  # by the photon's number, where births lie on no lattice
        self._birth_cells = birth_cells
        if birth_cells and emitter.direct:
            self._place_of = lambda slot: emitter.hashed_birth(slot, (seed, number, 1))
        elif not emitter.direct:
            born = emitter.sample(lane_generators(photons, seed, number, 1), photons)
            dr.eval(born)
            last_slot = opaque([photons - 1], mi.UInt32)
            self._place_of = lambda slot: dr.gather(mi.Point3f, born, dr.minimum(slot, last_slot))
        self._frequent = _frequent_fates(path)
        detectors = len(path.model.detectors)
        self._detectors = range(detectors if detectors > 1 else 0)
        self._counted = path.model.counted if self._detectors else None
        # Rare fates are added to memory; registers are kept for what happens all the time.
        self._rare = {code: dr.zeros(mi.Float, lanes) for code in (physics.TRUNCATED, physics.LOST)}
        # Scattering and absorption (1/mm) of the volumes that have them, by their number.
        source = emitter.volume
        self._scat, self._absorb = (
            {
                n: opaque([alpha])
                for n, volume in enumerate(path.model.volumes)
                if (alpha := getattr(volume, name)) > 0.0 or n == source or n in (tangent or ())
            }
            for name in ("alpha_scat_per_mm", "alpha_abs_per_mm")
        )
        if proposals is not None:
            scat = np.array(proposals.alpha_scat_per_cm) / MM_PER_CM
            self._scat[source] = opaque(scat[plan.proposal])
            self._absorb[source] = opaque([proposals.alpha_abs_per_cm / MM_PER_CM])
        for number, slopes in (tangent or {}).items():
            for coefficients, slope in zip((self._scat, self._absorb), slopes, strict=True):
                coefficients[number] = mi.Float(coefficients[number])
                dr.enable_grad(coefficients[number])
                dr.set_grad(coefficients[number], slope)
        self._scattering = Scattering(path.model, self._scat, source)

    def start(self) -> Photon:
        """The first photon of every lane, at birth."""
        lanes, zero = self.plan.lanes, mi.UInt32(0)
        point = self._lattice.mirrored(zero)
        u, v = (self._lattice.coordinate(point, j) for j in (3, 4))
        born = mi.warp.square_to_uniform_sphere(mi.Point2f(u, v))
        if self._aim is not None:
            born = self._aim + dr.zeros(mi.Vector3f, lanes)
        field = None
        if self.path.polarization:
            field = unpolarised_field(born, dr.two_pi * self._lattice.coordinate(point, 5))
        return Photon(
            o=self._birthplace(zero),
            d=born,
            field=field,
            volume=dr.full(mi.UInt32, self.emitter.birth_volume, lanes),
            face=dr.full(mi.UInt32, NO_FACE, lanes),
            free=None if self.path.shuttle is None else dr.zeros(mi.Float, lanes),
            w=dr.full(mi.Float, 1.0, lanes),
            steps=dr.zeros(mi.UInt32, lanes),
            history=None if self.store is None else self.store.nothing(lanes),
            left=opaque(self.plan.photons, mi.UInt32),
            serial=dr.zeros(mi.UInt32, lanes),
            state=self._seeds.state(zero),
            fates={code: dr.zeros(mi.Float, lanes) for code in self._frequent},
            absorbed={number: dr.zeros(mi.Float, lanes) for number in self._absorb},
            detected={number: dr.zeros(mi.Float, lanes) for number in self._detectors},
        )

    def step(self, p: Photon) -> Photon:
        """One free flight and what follows from it."""
        path, polarized = self.path, self.path.polarization
        rng = resumed(self._stream, p.state)

        # ---------------- random numbers, in this order whatever the step will need
        free, survive, u, v = (rng.next_float32() for _ in range(4))
        turn = rng.next_float32() if polarized else None
        # only a surface that scatters needs a choice besides what else scattering takes
        choice = rng.next_float32() if path.surfaces_scatter else u

        # ---------------- flight: straight to the next scattering or surface
        inside = [p.volume == number for number in range(len(path.model.volumes))]
        a_s, a_a = _here(self._scat, inside), _here(self._absorb, inside)
        ahead, met = path.intersect(p.o, p.d, p.face, p.volume, rng)
        # A volume that is closed has a face ahead in every direction, scattering or not.
        nowhere = ahead == dr.inf
        drawn = dr.detach(a_s)
        to_scatter = -dr.log(1.0 - free) / drawn
        if p.free is not None:
            to_scatter = dr.select(p.free > 0.0, p.free, to_scatter)
        colour = None
        if self._scattering.coloured and self._aim is None:
            colour = self._lattice.coordinate(self._lattice.mirrored(p.serial), 6)
        strength = self._scattering.strength(inside, p.o, p.d, colour)
        if strength is not None:
            to_scatter = strength.until(to_scatter)
        to_scatter = dr.select(drawn > 0.0, to_scatter, dr.inf)
        scatters = (to_scatter < ahead) & ~nowhere
        distance = dr.select(nowhere, 0.0, dr.minimum(ahead, to_scatter))
        weighted = distance if strength is None else strength.path(distance)
        position, arriving, folds = dr.fma(p.d, distance, p.o), p.d, None
        onwards = mi.Mask(False)
        if path.folded is not None:
            mine = inside[path.folded.solid.volume]
            reached = dr.select(scatters, mi.UInt32(NO_FACE), met)
            position, arriving, folds = path.folded.folded(p.o, p.d, distance, reached, mine)
            onwards = mine & ~scatters & (met == NO_FACE)

        # ---------------- surface: reflects, refracts, counts or absorbs
        at_surface = ~(scatters | nowhere | onwards)
        uniforms = choice, u, v, turn
        outcome = path.interact(position, arriving, p.field, met, uniforms, rng, at_surface)
        way_left = None
        if path.shuttle is not None:
            left, mine = to_scatter - distance, mine & at_surface
            flown, passed = path.shuttle.go(outcome, met, left, rng, mine)
            distance, weighted, folds = distance + flown, weighted + flown, folds + passed
            mine &= outcome.volume == path.folded.solid.volume
            way_left = dr.select(mine, left - flown, 0.0)

        # ---------------- absorption in the volume: by weight; of faint photons some whole
        transmitted = dr.exp(-a_a * distance)
        kept = dr.detach(transmitted)
        by_weight = p.w > (ANALOGUE_BELOW if self.trails is None else dr.inf)
        dies = ~by_weight & (survive >= kept)
        w = dr.select(by_weight, p.w * transmitted, dr.select(dies, 0.0, p.w))
        absorbed = {
            number: total + dr.select(inside[number], p.w - w, 0.0)
            for number, total in p.absorbed.items()
        }
        if self._tangent is not None:
            # factors of 1 whose slopes are those of the probabilities of what was drawn
            w *= dr.select(by_weight, 1.0, transmitted / kept)
            w *= dr.exp((drawn - a_s) * weighted) * dr.select(scatters, a_s / drawn, 1.0)
        at_surface &= ~dies

        # ---------------- fate: what became of the photon, and whether it is over
        fate = dr.select(at_surface, outcome.fate, mi.UInt32(physics.ALIVE))
        outside = p.volume == OUTSIDE
        if path.model.endless is not None:
            outside |= inside[path.model.endless]
        leaves = dr.select(outside, mi.UInt32(physics.ESCAPED), mi.UInt32(physics.LOST))
        fate = dr.select(nowhere, leaves, fate)
        fate = dr.select(dies, mi.UInt32(physics.VOLUME), fate)
        if path.model.endless is not None:
            # what is sent back into a liquid without end is in it for ever
            back = inside[path.model.endless] & (outcome.volume == path.model.endless)
            lost = at_surface & back & (fate == physics.ALIVE)
            fate = dr.select(lost, mi.UInt32(physics.ESCAPED), fate)
        dimmed = w
        if path.surfaces_may_absorb:
            # as in volumes; of a `survive` that was no death there the rest is even again
            whole = at_surface & ~by_weight & (survive >= kept * outcome.weight)
            absorbed_after = (fate == physics.DETECTED) | (fate == physics.REFLECTOR)
            whole &= (fate == physics.ALIVE) | absorbed_after
            fate = dr.select(whole, mi.UInt32(physics.SURFACE), fate)
            factor = dr.select(by_weight, outcome.weight, dr.maximum(outcome.weight, 1.0))
            dimmed = dr.select(at_surface, w * factor, w)
        steps = p.steps + 1
        spent = (steps >= self._depth_limit) & (fate == physics.ALIVE)
        fate = dr.select(spent, mi.UInt32(physics.TRUNCATED), fate)
        ended = fate != physics.ALIVE

        # ---------------- counts
        fates = {
            code: total + dr.select(fate == code, dimmed, 0.0) for code, total in p.fates.items()
        }
        if path.surfaces_may_absorb:
            fates[physics.SURFACE] += w - dimmed
        w = dimmed
        detected = {
            number: total + dr.select(self._taken(fate, outcome, number), w, 0.0)
            for number, total in p.detected.items()
        }
        for code, totals in self._rare.items():
            dr.scatter_add(totals, dr.detach(w), self._lane, fate == code)

        # ---------------- the photon goes on, or the lane's next one is born
        over = dr.select(ended, mi.UInt32(1), mi.UInt32(0))
        left, serial = p.left - over, p.serial + over
        point = self._lattice.mirrored(serial)
        u = dr.select(ended, self._lattice.coordinate(point, 3), u)
        v = dr.select(ended, self._lattice.coordinate(point, 4), v)
        scattered = self._scattering.direction(inside, arriving, (u, v), ended)
        if self._aim is not None:
            scattered = dr.select(ended, self._aim, scattered)
        # A new photon and a scattered one are unpolarised alike.
        fresh = ended | ~(at_surface | onwards)
        field = None
        if polarized:
            turn = dr.select(ended, self._lattice.coordinate(point, 5), turn)
            field = dr.select(fresh, unpolarised_field(scattered, dr.two_pi * turn), outcome.field)
        flight = p, survive, inside, a_a, distance, weighted, position, arriving, folds
        end = scatters, scattered, dies, at_surface, outcome, w, fate, ended
        history = self._write(Step(*flight, *end))
        place = dr.select(at_surface, outcome.position, position)
        volume = dr.select(at_surface, outcome.volume, p.volume)
        face = path.face_of(met) if outcome.face is None else outcome.face
        return Photon(
            o=dr.select(ended, self._birthplace(serial), place),
            d=dr.select(fresh, scattered, dr.select(onwards, arriving, outcome.direction)),
            field=field,
            volume=dr.select(ended, mi.UInt32(self.emitter.birth_volume), volume),
            face=dr.select(at_surface & ~ended, face, mi.UInt32(NO_FACE)),
            free=None if way_left is None else dr.select(ended, 0.0, way_left),
            w=dr.select(ended, 1.0, w),
            steps=dr.select(ended, mi.UInt32(0), steps),
            history=history,
            left=left,
            serial=serial,
            state=dr.select(ended, self._seeds.state(serial), rng.state),
            fates=fates,
            absorbed=absorbed,
            detected=detected,
        )

    @staticmethod
    def _taken(fate, outcome, detector: int | None):
        """Whether photons (Mask) are detected: by the detector of this number; ``None``: by any."""
        detected = fate == physics.DETECTED
        return detected if detector is None else detected & (outcome.detector == detector)

    def _write(self, s: Step):
        """Records and trails, where they are wanted; what is known of the flights from now on."""
        p, history, slot = s.p, s.p.history, self._first_slot + s.p.serial
        if self.store is not None:
            history = self.store.grown(history, s)
            detected = self._taken(s.fate, s.outcome, self._counted) & (p.left > 0)
            self.store.put(slot, detected, s, history, lambda: self._birthplace(p.serial))
            history = dr.select(s.ended, self.store.nothing(), history)
        if self.trails is not None:
            self.trails.put(slot, p.left > 0, s)
        return history

    def _birthplace(self, serial):
        """Where the lanes' photons number `serial` (UInt32) are born (Point3f, mm)."""
        if self._place_of is not None:
            return self._place_of(self._first_slot + serial)
        point = self._lattice.mirrored(serial)
        return self.emitter.from_uniforms(*(self._lattice.coordinate(point, j) for j in range(3)))

    def _births_in(self, cells: Sequence[np.ndarray]) -> np.ndarray:
        """(batches, x, y, z) random births in cells, by their edges."""
        shape = BATCHES, *(len(edges) - 1 for edges in cells)
        cell = mi.UInt32(np.repeat(self.plan.batch, self.plan.photons))
        places = self._place_of(dr.arange(mi.UInt32, len(cell)))
        for place, edges, number in zip(places, cells, shape[1:], strict=True):
            low, per_mm = opaque([edges[0]]), opaque([1.0 / (edges[1] - edges[0])])
            cell = cell * number + mi.UInt32(dr.clip((place - low) * per_mm, 0, number - 1))
        counts = dr.zeros(mi.UInt32, int(np.prod(shape)))
        dr.scatter_reduce(dr.ReduceOp.Add, counts, mi.UInt32(1), cell)
        return np.array(counts, np.int64).reshape(shape)

    def gathered(self, final: Photon) -> Launch:
        """What the loop found, when it has run."""
        slope: Any = None
        if self._tangent is not None:
            both = self._scat, self._absorb
            varied = [coefficients[n] for coefficients in both for n in self._tangent]
            dr.enqueue(dr.ADMode.Forward, varied)
            dr.traverse(dr.ADMode.Forward)
            every = final.fates[physics.DETECTED]
            slope = dr.grad(every if self._counted is None else final.detected[self._counted])
        totals = final.fates | self._rare
        tables = [store.tables for store in (self.store, self.trails) if store is not None]
        dr.eval(totals, final.absorbed, final.detected, slope, tables)

        def per_batch(total):
            lanes = np.zeros(self.plan.lanes) if total is None else np.array(total, dtype=float)
            return self.plan.per_batch(lanes)

        weights = {name: per_batch(totals.get(code)) for code, name in SURFACE_FATES.items()}
        for number, name in enumerate(self.path.model.volume_names):
            if number != OUTSIDE:
                weights[f"absorbed_{name}"] = per_batch(final.absorbed.get(number))
        for number, total in final.detected.items():
            weights[detected_by(self.path.model.detectors[number])] = per_batch(total)
        return Launch(
            self.plan.per_batch(self.plan.photons).astype(np.int64),
            weights,
            {} if self.store is None else self.store.collected(self.plan),
            None if slope is None else per_batch(slope),
            self._births_in(self._birth_cells) if self._birth_cells else np.empty(0, np.int64),
        )


def _frequent_fates(path) -> list[int]:
    """Fates that photons of the scene meet all the time."""
    surfaces = path.model.surfaces
    happens = {
        physics.DETECTED: True,
        physics.ESCAPED: True,
        physics.APERTURE: any(s.aperture_radius_mm < np.inf for s in surfaces),
        physics.REFLECTOR: any(s.kind == DIFFUSE or s.contact for s in surfaces),
        physics.SURFACE: path.surfaces_may_absorb,
    }
    return [code for code, often in happens.items() if often]


def _here(coefficients, inside):
    """The coefficient of the volume a photon is in."""
    value = mi.Float(0.0)
    for number, alpha in coefficients.items():
        value = dr.select(inside[number], alpha, value)
    return value
