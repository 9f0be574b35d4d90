"""Random numbers of the lanes: generators, a start for every photon, and evenly spread births.

Births fill position and direction evenly, by a shifted lattice per batch and proposal. Photon i of
a batch is born at the fractional part of shift + z phi(i): phi mirrors the bits of
i at the point, so that the first n photons are nearly even for every n, and z is a generating
vector of a good lattice (F. Y. Kuo's lattice-32001-1024-1048576, found as described by R. Cools,
F. Y. Kuo and D. Nuyens, SIAM J. Sci. Comput. 28 (2006) 2162). The shifts are random and
independent (R. Cranley and T. N. L. Patterson, SIAM J. Numer. Anal. 13 (1976) 904), so that
every point is uniform, nothing is biased, and the spread between batches is the error.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport.launch_plan import BATCHES, LanePlan
from mcrim_mitsuba.transport.scene_model import opaque

#: Rounds of the cipher that spreads the lanes' seeds over all states.
HASH_ROUNDS = 8
#: Of the lattice, per coordinate: three of the position, two of the direction, the angle of
#: polarisation.
GENERATORS = (1, 182_667, 469_891, 498_753, 110_745, 446_247, 250_185, 118_627, 245_333, 283_199)


def seed_words(count: int, *seed: int) -> list[int]:
    """`count` well-mixed 32-bit words from integers of 0 to 2^64 - 1, of which all count."""
    # Two words each: SeedSequence pads shorter numbers with zeros, so that others' would coincide.
    halves = [half for value in seed for half in (value & 0xFFFFFFFF, value >> 32)]
    return np.random.SeedSequence(halves).generate_state(count, np.uint32).tolist()


def lane_generators(lanes: int, *seed: int):
    """Independent generators (``mitsuba.PCG32``), one per lane.

    PCG32's own way of making many generators numbers their streams 0, 1, 2, ..., and
    such neighbours draw visibly correlated numbers (a chi-square test across lanes fails
    at once). So start and stream of every lane are hashed from its number and the seed, as in
    Mitsuba's independent sampler (F. Zafar et al., GPU random numbers via the tiny
    encryption algorithm, HPG 2010). `seed` is as of `seed_words`.
    """
    start, start_too, stream, stream_too = (
        opaque([word], mi.UInt32) for word in seed_words(4, *seed)
    )
    lane = dr.arange(mi.UInt32, lanes)
    return mi.PCG32(
        initstate=mi.sample_tea_64(lane ^ start, start_too, HASH_ROUNDS),
        initseq=mi.sample_tea_64(lane ^ stream, stream_too, HASH_ROUNDS),
    )


class PhotonSeeds:
    """States from which a lane's generator starts, one for each of the lane's photons.

    With these a photon's numbers do not depend on how many the photons before it took: in two
    scenes that differ a little, most photons do the same, and differences of eta are known far
    better than the etas. `seed` is as of `seed_words`.
    """

    def __init__(self, lanes: int, *seed: int) -> None:
        words = [opaque([word], mi.UInt32) for word in seed_words(2, *seed)]
        lane = dr.arange(mi.UInt32, lanes)
        self._low, self._high = mi.sample_tea_32(lane ^ words[0], words[1], HASH_ROUNDS)
        dr.eval(self._low, self._high)

    def state(self, serial):
        """State (UInt64) for every lane's photon number `serial` (UInt32)."""
        low = _mixed(self._low + serial * mi.UInt32(0x9E3779B9))
        high = _mixed(self._high + serial * mi.UInt32(0x85EBCA6B))
        return mi.UInt64(low) | (mi.UInt64(high) << 32)


def _mixed(word):
    """A permutation of 32-bit words whose every output bit depends on all input bits.

    C. Wellons, "Prospecting for hash functions" (2018), lowbias32.
    """
    word = (word ^ (word >> 16)) * mi.UInt32(0x7FEB352D)
    word = (word ^ (word >> 15)) * mi.UInt32(0x846CA68B)
    return word ^ (word >> 16)


class BirthLattice:
    """The lattice points of one launch; `seed` is as of `seed_words`."""

    def __init__(self, plan: LanePlan, *seed: int) -> None:
        self._rank, self._stride, proposal = (
            opaque(values, mi.UInt32) for values in (plan.rank, plan.stride, plan.proposal)
        )
        lane = dr.arange(mi.UInt32, plan.lanes)
        group = proposal * BATCHES + lane % BATCHES
        words = [opaque([word], mi.UInt32) for word in seed_words(2 * len(GENERATORS), *seed)]
        self._shift = [
            mi.sample_tea_32(group ^ first, second, HASH_ROUNDS)[0]
            for first, second in zip(words[::2], words[1::2], strict=True)
        ]
        dr.eval(self._shift)

    def mirrored(self, serial):
        """Bit-mirrored number (UInt32) of every lane's photon number `serial` (UInt32)."""
        return dr.brev(self._rank + self._stride * serial)

    def coordinate(self, mirrored, dimension: int):
        """Coordinate (Float in [0, 1)) of the photons that `mirrored` tells."""
        # 32-bit integers wrap, which is just what a fractional part needs
        word = self._shift[dimension] + mirrored * mi.UInt32(GENERATORS[dimension])
        return mi.Float(word >> 8) * 2.0**-24
