"""Random numbers of a launch: one generator per lane, unrelated to all others."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel.scene_model import opaque

#: Rounds of the cipher that spreads the lanes' seeds over all states.
HASH_ROUNDS = 8


def seed_words(count: int, *seed: int) -> list[int]:
    """`count` well-mixed 32-bit words from any number of integers of 0 to 2^64 - 1."""
    # Two words each: SeedSequence pads shorter numbers with zeros, so that others' would coincide.
    halves = [half for value in seed for half in (value & 0xFFFFFFFF, value >> 32)]
    return np.random.SeedSequence(halves).generate_state(count, np.uint32).tolist()


def lane_generators(lanes: int, *seed: int):
    """Independent generators (``mitsuba.PCG32``), one per lane.

    PCG32's own way of making many generators numbers their streams 0, 1, 2, ..., and
    such neighbours draw visibly correlated numbers (a chi-square test across lanes fails
    at once). So start and stream of every lane are hashed from its number and the seed, as in
    Mitsuba's independent sampler (F. Zafar et al., GPU random numbers via the tiny
    encryption algorithm, HPG 2010).

    Parameters
    ----------
    lanes : int
    *seed : int
        Any number of integers from 0 to 2^64 - 1; all of them count.
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
    better than the etas.

    Parameters
    ----------
    lanes : int
    *seed : int
        Any number of integers from 0 to 2^64 - 1; all of them count.
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
