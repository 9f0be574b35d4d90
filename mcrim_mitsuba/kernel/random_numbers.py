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
