"""Births that fill position and direction evenly: a shifted lattice per batch and proposal.

Photon i of a batch is born at the fractional part of shift + z phi(i): phi mirrors the bits of
i at the point, so that the first n photons are nearly even for every n, and z is a generating
vector of a good lattice (F. Y. Kuo's lattice-32001-1024-1048576, found as described by R. Cools,
F. Y. Kuo and D. Nuyens, SIAM J. Sci. Comput. 28 (2006) 2162). The shifts are random and
independent (R. Cranley and T. N. L. Patterson, SIAM J. Numer. Anal. 13 (1976) 904), so that
every point is uniform, nothing is biased, and the spread between batches is the error.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.kernel.lane_plan import BATCHES, LanePlan
from mcrim_mitsuba.kernel.random_numbers import HASH_ROUNDS, seed_words
from mcrim_mitsuba.kernel.scene_model import opaque

#: Per coordinate: three of the position, two of the direction, the angle of polarisation.
GENERATORS = (1, 182_667, 469_891, 498_753, 110_745, 446_247, 250_185, 118_627, 245_333, 283_199)


class BirthLattice:
    """The lattice points of one launch.

    Parameters
    ----------
    plan : LanePlan
    *seed : int
        Of the run and of the launch.
    """

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
