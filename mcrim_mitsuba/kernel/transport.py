"""The transport loop: photons from birth to their fate, many per lane.

One lane of the vector registers follows one photon at a time and starts its next
one as soon as that ends, so no lane waits for the longest path of its packet.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel import surface_physics as physics
from mcrim_mitsuba.kernel.flat_path import NO_FACE
from mcrim_mitsuba.kernel.random_numbers import lane_generators
from mcrim_mitsuba.kernel.scene_model import DIFFUSE, OUTSIDE, opaque
from mcrim_mitsuba.units import MM_PER_CM

#: Lanes of one kernel launch. Fewer lanes with more photons each wait less for the slowest lane of
#: their packet (sums over many photons vary less); more than this gains nothing on two cores.
LANES = 16_384

#: Weight down to which absorption lowers a photon's weight. Below it the photon lives or
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
    """The loop's state of one lane.

    Attributes
    ----------
    o, d : Point3f, Vector3f
        Position in mm, unit direction.
    field : Field or None
        Polarisation, where it is followed.
    volume, face : UInt32
        Volume the photon is in; the face it is on, if any.
    w : Float
        Weight, 1 at birth.
    steps : UInt32
        Free flights so far.
    k, path : UInt32, Float, or None
        Bulk scatterings and path (mm) in the emitting volume, where records are kept.
    left, serial : UInt32
        Photons the lane has yet to follow, this one included; the number of this one in the lane.
    rng : PCG32
    fates : dict of int to Float
        Weight that met each frequent fate, all photons of the lane so far.
    absorbed : dict of int to Float
        Weight absorbed in each volume that absorbs.
    """

    o: object
    d: object
    field: object
    volume: object
    face: object
    w: object
    steps: object
    k: object
    path: object
    left: object
    serial: object
    rng: object
    fates: dict
    absorbed: dict


@dataclass(frozen=True)
class Launch:
    """What one kernel launch found.

    Attributes
    ----------
    photons_per_lane : ndarray of int64, shape (lanes,)
    weights : dict of str to ndarray of float64, shape (lanes,)
        Per fate, the weight summed over the photons of each lane.
    records : dict of str to ndarray, or None
        Of the detected photons: ``k`` (uint16 scatterings), ``path_cm`` (float32, in the
        crystal), ``w`` (float32, weight at the proposal's absorption), ``proposal`` (uint8).
    """

    photons_per_lane: np.ndarray
    weights: dict[str, np.ndarray]
    records: dict[str, np.ndarray] | None


def launch(path, emitter, *, photons, seed, number, max_depth, alpha_scat_per_mm=None,
           alpha_abs_per_mm=None, keep_records=False) -> Launch:  # fmt: skip
    """Follow photons through a scene in one kernel.

    Parameters
    ----------
    path : FlatPath or GeneralPath
    emitter : CrystalVolume
        Where photons are born.
    photons : int
        Shared out evenly among at most `LANES` lanes.
    seed, number : int
        Of the run and of this launch within it; together they fix the random numbers.
    max_depth : int
        Free flights after which a photon is truncated.
    alpha_scat_per_mm : sequence of float, optional
        Proposals for the crystal's scattering coefficient, in equal shares of the lanes;
        the scene's own value when absent.
    alpha_abs_per_mm : float, optional
        Absorption of the crystal in place of the scene's.
    keep_records : bool
        Whether to return the detected photons' histories.
    """
    lanes = min(LANES, photons)
    source = emitter.volume
    scat, absorb = _coefficients(path.model, source, lanes, alpha_scat_per_mm, alpha_abs_per_mm)
    frequent, rare = _fates_of(path)
    # Rare fates are added to memory; registers are kept for what happens all the time.
    seldom = {code: dr.zeros(mi.Float, lanes) for code in rare}
    lane = dr.arange(mi.UInt32, lanes)
    base, extra = divmod(photons, lanes)
    share = opaque([base], mi.UInt32) + dr.select(lane < opaque([extra], mi.UInt32), 1, 0)
    depth_limit = opaque([max_depth], mi.UInt32)
    rng = lane_generators(lanes, seed, number)
    births = None
    if not emitter.direct:
        births = emitter.sample(lane_generators(photons, seed, number, 1), photons)
        dr.eval(births)
        last_slot = opaque([photons - 1], mi.UInt32)
    store = None
    if keep_records:
        slots = photons
        store = {
            "k": dr.zeros(mi.UInt32, slots),
            "path": dr.zeros(mi.Float, slots),
            "w": dr.zeros(mi.Float, slots),
        }
    first_slot = lane * opaque([base], mi.UInt32) + dr.minimum(lane, opaque([extra], mi.UInt32))

    def birthplace(rng, serial):
        if births is None:
            return emitter.from_uniforms(rng.next_float32(), rng.next_float32(), rng.next_float32())
        return dr.gather(mi.Point3f, births, dr.minimum(first_slot + serial, last_slot))

    def step(p: Photon) -> Photon:
        rng = p.rng
        draw = [rng.next_float32() for _ in range(6 if path.polarization else 5)]
        free, survive, choice, u, v = draw[:5]
        angle = dr.two_pi * draw[5] if path.polarization else None

        # ---- flight: to the next scattering or surface --------------------------------
        inside = [p.volume == number for number in range(len(path.model.volumes))]
        a_s, a_a = _here(scat, inside), _here(absorb, inside)
        distance, met = path.intersect(p.o, p.d, p.face, p.volume)
        # A volume that is closed has a face ahead in every direction, scattering or not.
        nowhere = distance == dr.inf
        to_scatter = dr.select(a_s > 0.0, -dr.log(1.0 - free) / a_s, dr.inf)
        scatters = (to_scatter < distance) & ~nowhere
        distance = dr.select(nowhere, 0.0, dr.minimum(distance, to_scatter))
        position = dr.fma(p.d, distance, p.o)

        # ---- absorption: by weight, then whole ----------------------------------------
        kept = dr.exp(-a_a * distance)
        by_weight = p.w > ANALOGUE_BELOW
        dies = ~by_weight & (survive >= kept)
        w = dr.select(by_weight, p.w * kept, dr.select(dies, 0.0, p.w))
        taken = p.w - w
        absorbed = {
            number: total + dr.select(inside[number], taken, 0.0)
            for number, total in p.absorbed.items()
        }

        # ---- scattering or surface ----------------------------------------------------
        at_surface = ~(scatters | nowhere | dies)
        outcome = path.interact(position, p.d, p.field, met, (choice, u, v, draw[-1]), at_surface)
        isotropic = born = mi.warp.square_to_uniform_sphere(mi.Point2f(u, v))
        if path.surfaces_may_absorb:
            # a BSDF may have decided by (u, v) that the photon ends: the next one needs its own
            born = mi.warp.square_to_uniform_sphere(
                mi.Point2f(rng.next_float32(), rng.next_float32())
            )
        direction = dr.select(at_surface, outcome.direction, isotropic)
        fate = dr.select(at_surface, outcome.fate, mi.UInt32(physics.ALIVE))
        fate = dr.select(
            nowhere,
            dr.select(p.volume == OUTSIDE, mi.UInt32(physics.ESCAPED), mi.UInt32(physics.LOST)),
            fate,
        )
        fate = dr.select(dies, mi.UInt32(physics.VOLUME), fate)
        steps = p.steps + 1
        spent = (steps >= depth_limit) & (fate == physics.ALIVE)
        fate = dr.select(spent, mi.UInt32(physics.TRUNCATED), fate)
        ended = fate != physics.ALIVE

        # ---- books --------------------------------------------------------------------
        fates = {code: total + dr.select(fate == code, w, 0.0) for code, total in p.fates.items()}
        if physics.SURFACE in fates:
            dimmed = dr.select(at_surface, w * outcome.weight, w)
            fates[physics.SURFACE] += w - dimmed
            w = dimmed
        for code, totals in seldom.items():
            dr.scatter_add(totals, w, lane, fate == code)
        k = flown = None
        if store is not None:
            k = p.k + dr.select(scatters & inside[source] & ~dies, mi.UInt32(1), mi.UInt32(0))
            flown = p.path + dr.select(inside[source], distance, 0.0)
            slot, seen = first_slot + p.serial, (fate == physics.DETECTED) & (p.left > 0)
            dr.scatter(store["k"], k, slot, seen)
            dr.scatter(store["path"], flown, slot, seen)
            dr.scatter(store["w"], w, slot, seen)

        # ---- go on, or let the lane's next photon be born ------------------------------
        left = p.left - dr.select(ended, mi.UInt32(1), mi.UInt32(0))
        serial = p.serial + dr.select(ended, mi.UInt32(1), mi.UInt32(0))
        # One direction serves both: a photon that ends has no use for the scattered one.
        birth = birthplace(rng, serial)
        direction = dr.select(ended, born, direction)
        field = None
        if path.polarization:
            # A new photon and a scattered one are unpolarised alike.
            fresh = ended | ~at_surface
            unpolarised = physics.unpolarised_field(direction, angle)
            field = physics.Field(
                dr.select(fresh, unpolarised.re, outcome.field.re),
                dr.select(fresh, unpolarised.im, outcome.field.im),
            )
        moved = dr.select(at_surface, outcome.position, position)
        return Photon(
            o=dr.select(ended, birth, moved),
            d=direction,
            field=field,
            volume=dr.select(
                ended, mi.UInt32(source), dr.select(at_surface, outcome.volume, p.volume)
            ),
            face=_face_after(met, at_surface & ~ended),
            w=dr.select(ended, 1.0, w),
            steps=dr.select(ended, mi.UInt32(0), steps),
            k=None if store is None else dr.select(ended, mi.UInt32(0), k),
            path=None if store is None else dr.select(ended, 0.0, flown),
            left=left,
            serial=serial,
            rng=rng,
            fates=fates,
            absorbed=absorbed,
        )

    isotropic = mi.warp.square_to_uniform_sphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
    field = None
    if path.polarization:
        field = physics.unpolarised_field(isotropic, dr.two_pi * rng.next_float32())
    birth = birthplace(rng, mi.UInt32(0))
    start = Photon(
        o=birth, d=isotropic, field=field,
        volume=dr.full(mi.UInt32, source, lanes), face=dr.full(mi.UInt32, NO_FACE, lanes),
        w=dr.full(mi.Float, 1.0, lanes), steps=dr.zeros(mi.UInt32, lanes),
        k=None if store is None else dr.zeros(mi.UInt32, lanes),
        path=None if store is None else dr.zeros(mi.Float, lanes),
        left=share, serial=dr.zeros(mi.UInt32, lanes), rng=rng,
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
    totals = final.fates | seldom
    dr.eval(totals, final.absorbed, store)
    weights = {name: _per_lane(totals.get(code), lanes) for code, name in SURFACE_FATES.items()}
    for number, volume in enumerate(path.model.volumes[1:], start=1):
        weights[f"absorbed_{volume.name}"] = _per_lane(final.absorbed.get(number), lanes)
    per_lane = base + (np.arange(lanes) < extra).astype(np.int64)
    records = None
    if store is not None:
        records = _records(store, per_lane, 1 if alpha_scat_per_mm is None else
                           len(alpha_scat_per_mm))  # fmt: skip
    return Launch(per_lane, weights, records)


def _face_after(met, on_face):
    """The face a photon is on; paths that have no use for it pass other objects."""
    if isinstance(met, mi.UInt32):
        return dr.select(on_face, met, mi.UInt32(NO_FACE))
    return dr.select(on_face, mi.UInt32(NO_FACE), mi.UInt32(NO_FACE))


def _per_lane(total, lanes) -> np.ndarray:
    return np.zeros(lanes) if total is None else np.array(total, dtype=np.float64)


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


def _coefficients(model, source, lanes, proposals, absorption):
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
        lane = dr.arange(mi.UInt32, lanes)
        scat[source] = dr.gather(
            mi.Float, opaque(proposals), lane % opaque([len(proposals)], mi.UInt32)
        )
    if absorption is not None:
        absorb[source] = opaque([absorption])
    return scat, absorb


def _here(coefficients, inside):
    """The coefficient of the volume a photon is in."""
    value = mi.Float(0.0)
    for number, own in coefficients.items():
        value = dr.select(inside[number], own, value)
    return value


def _records(store, per_lane, proposals) -> dict[str, np.ndarray]:
    w = np.array(store["w"])
    seen = np.flatnonzero(w)
    lane = np.repeat(np.arange(len(per_lane)), per_lane)[seen]
    return {
        "k": np.minimum(np.array(store["k"])[seen], 65535).astype(np.uint16),
        "path_cm": np.array(store["path"])[seen] / np.float32(MM_PER_CM),
        "w": w[seen],
        "proposal": (lane % proposals).astype(np.uint8),
    }
