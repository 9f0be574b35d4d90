"""All sets of up to three causes at once, in closed form.

Around the baseline fit the readings and priors, whitened and freed of what the free parameters
follow, are independent standard normal numbers z. A cause of the size v displaces them by s(v), and
the logarithm of the fitted scale by t(v); several causes add. The prior of a size is cut into
strips, in each of which it is a Gaussian, and s and t are straight:

    s = o + a x,  t = c + b x,  x ~ N(0, 1).

With a set's strips, r = z - sum of o, A = 1 + a^T a (a, b with a column and a row for each strip)

    ln Z = -r^T r / 2 + (a^T r)^T A^-1 (a^T r) / 2 - ln|A| / 2 + sum of ln w
    ln S = ln S0 + sum of c + b^T A^-1 a^T r,  variance s0^2 + b^T A^-1 b

(C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press 2006,
section 2.7, for a linear model with Gaussian weights). No fit is needed for a set, so that all of
them are weighed, not only those that some rule lets through.

What no cause explains, a discrepancy, is Gaussian with a covariance: z then has the covariance
V = f^2 + tau^2 D, f a factor by which all stated errors are too small, and is whitened once more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from mcrim_mitsuba.core.descent import Array

Indices = NDArray[np.int64]

#: Causes of one set, at most.
MOST_CAUSES = 3


@dataclass(frozen=True, eq=False, kw_only=True)
class Cause:
    """Something that may displace readings, with what is known of its size before them."""

    #: As sets are listed; that of an effect is its id.
    name: str
    #: Natural logarithm of the odds, before the readings, that it is there.
    log_odds: float
    #: (strips,) float64: Natural logarithms of the prior's parts, which add up to 1.
    log_weights: Array
    #: (strips, dimensions) float64: Displacement of z in the middle of a strip, and per standard
    #: deviation of the size inside of it.
    origins: Array
    slopes: Array
    #: (strips,) float64: The same of the logarithm of the scale.
    log_scales: Array
    log_scale_slopes: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Discrepancy:
    """Covariance, per squared amplitude, of what no cause explains."""

    #: (dimensions, dimensions) float64: Of z.
    covariance: Array
    #: (dimensions,) float64: Of z with the logarithm of the scale.
    with_scale: Array
    #: Variance of the logarithm of the scale.
    of_scale: float


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What besides causes the readings are weighed with."""

    #: Natural logarithm of its prior probability.
    log_prior: float
    #: Of the discrepancy; 0: there is none.
    amplitude: float = 0.0
    #: By which all stated errors are too small.
    error_factor: float = 1.0

    @property
    def is_plain(self) -> bool:
        """Whether there is nothing besides causes."""
        return self.amplitude == 0.0 and self.error_factor == 1.0


@dataclass(frozen=True, eq=False, kw_only=True)
class WeighedSets:
    """Every set of causes in every surroundings, and what the readings say of the scale with it."""

    causes: tuple[Cause, ...]
    surroundings: tuple[Surroundings, ...]
    #: (sets, 3) int64: Places of the causes; -1 where there are fewer.
    members: Indices
    #: (sets,) int64: Places of the surroundings.
    within: Indices
    #: (sets,) float64: Natural logarithms of the weights, up to a constant.
    log_weights: Array
    #: (sets,) float64: Mean and variance of ln(scale / that of the baseline).
    log_scales: Array
    variances: Array

    @cached_property
    def amplitudes(self) -> Array:
        """(sets,) of their discrepancies; 0 where there is none."""
        return np.array([around.amplitude for around in self.surroundings])[self.within]

    @cached_property
    def error_factors(self) -> Array:
        """(sets,) by which all stated errors are too small."""
        return np.array([around.error_factor for around in self.surroundings])[self.within]

    def names(self, place: int) -> tuple[str, ...]:
        """Causes of a set."""
        return tuple(self.causes[i].name for i in self.members[place] if i >= 0)

    def moved(self, place: int, z: Array) -> Array:
        """(dimensions,) mean displacement by a set's causes, without any discrepancy."""
        members = self.members[place]
        causes = [self.causes[i] for i in members[members >= 0]]
        if not causes:
            return np.zeros(len(z))
        chosen = np.indices([len(cause.log_weights) for cause in causes]).reshape(len(causes), -1)
        pairs = list(zip(causes, chosen, strict=True))
        left = z - sum(cause.origins[strips] for cause, strips in pairs)
        slopes = np.stack([cause.slopes[strips] for cause, strips in pairs], axis=1)
        matrix = np.eye(len(causes)) + slopes @ slopes.transpose(0, 2, 1)
        of_left = slopes @ left[..., None]
        sizes = np.linalg.solve(matrix, of_left)
        log_weights = 0.5 * (of_left * sizes).sum(axis=(1, 2)) - 0.5 * (left**2).sum(axis=1)
        log_weights -= 0.5 * np.linalg.slogdet(matrix)[1]
        log_weights += sum(cause.log_weights[strips] for cause, strips in pairs)
        moves = z - left + (slopes * sizes).sum(axis=1)
        return np.asarray(softmax(log_weights) @ moves, float)


def weigh_sets(
    causes: Sequence[Cause],
    surroundings: Sequence[Surroundings],
    z: Array,
    *,
    discrepancy: Discrepancy,
    scale_variance: float,
    excluded: NDArray[np.bool_],
    most: int = MOST_CAUSES,
) -> WeighedSets:
    """Weigh every set of up to three causes, or fewer; one less where there is something besides.

    `z`, (dimensions,), are the readings, whitened and freed of what the free parameters follow;
    `scale_variance` is that of the logarithm of the scale in the baseline fit; `excluded`, (causes,
    causes), says which two cannot be there at the same time.
    """
    parts, strips = [], _Strips.of(causes, len(z))
    for place, around in enumerate(surroundings):
        seen = _Seen.through(around, strips, discrepancy, scale_variance)
        own = seen.whitening @ z
        products = _Products(seen.strips, own, seen.scale_variance, excluded)
        shift = float(seen.followed @ own)
        causes_here = most if around.is_plain else most - 1
        for members, log_weights, log_scales, variances in products.sets(causes_here):
            within, log_weights = np.full(len(members), place), log_weights + seen.log_weight
            parts.append((members, within, log_weights, log_scales + shift, variances))
    columns = zip(*parts, strict=True)
    members, within, log_weights, log_scales, variances = map(np.concatenate, columns)
    return WeighedSets(
        causes=tuple(causes),
        surroundings=tuple(surroundings),
        members=members,
        within=within,
        log_weights=log_weights,
        log_scales=log_scales,
        variances=variances,
    )


def weigh_singles(
    causes: Sequence[Cause],
    surroundings: Sequence[Surroundings],
    z: Array,
    *,
    discrepancy: Discrepancy,
    scale_variance: float,
) -> tuple[Indices, Array, Array, Array]:
    """Weigh none or one cause as `weigh_sets` does, for many (draws, dimensions) readings at once.

    Returns the causes, (sets,), -1 for none; and log_weights, log_scales, variances, (draws, sets).
    """
    parts, strips = [], _Strips.of(causes, z.shape[1])
    for around in surroundings:
        seen = _Seen.through(around, strips, discrepancy, scale_variance)
        origins, slopes, own = seen.strips.origins, seen.strips.slopes, z @ seen.whitening.T
        b, shift = seen.strips.b, own @ seen.followed[:, None]
        none = -0.5 * (own**2).sum(axis=1, keepdims=True)
        width = 1.0 + (slopes**2).sum(axis=1)
        along = own @ slopes.T - (slopes * origins).sum(axis=1)
        heights = own @ origins.T - 0.5 * (origins**2).sum(axis=1) + strips.log_weights
        of_strips = none + heights + 0.5 * (along**2 / width - np.log(width))
        log_weights = np.hstack([none, of_strips]) + seen.log_weight
        log_scales = np.hstack([shift, seen.strips.t + b * along / width + shift])
        variances = seen.scale_variance + np.append(0.0, b**2 / width)
        parts.append((log_weights, log_scales, np.broadcast_to(variances, log_scales.shape)))
    members = np.tile(np.append(-1, strips.owner), len(surroundings))
    log_weights, log_scales, variances = (np.hstack(part) for part in zip(*parts, strict=True))
    return members, log_weights, log_scales, variances


@dataclass(frozen=True, eq=False, kw_only=True)
class _Strips:
    """The strips of all causes one after the other: (strips, ...) as of `Cause`."""

    #: (strips,) int64: Places of their causes.
    owner: Indices
    #: With the odds of the cause.
    log_weights: Array
    origins: Array
    slopes: Array
    #: Of the logarithm of the scale.
    t: Array
    b: Array

    @classmethod
    def of(cls, causes: Sequence[Cause], dimensions: int) -> _Strips:
        """Those of some causes, or of none."""
        counts = [len(cause.log_weights) for cause in causes]
        none = np.empty((0, dimensions))
        return cls(
            owner=np.repeat(np.arange(len(causes)), counts),
            log_weights=np.concatenate([[], *(c.log_weights + c.log_odds for c in causes)]),
            origins=np.vstack([none, *(cause.origins for cause in causes)]),
            slopes=np.vstack([none, *(cause.slopes for cause in causes)]),
            t=np.concatenate([[], *(cause.log_scales for cause in causes)]),
            b=np.concatenate([[], *(cause.log_scale_slopes for cause in causes)]),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Seen:
    """Strips in the numbers in which z is standard normal, in some surroundings."""

    #: Of ln(scale) is taken off what these numbers say of it through the discrepancy.
    strips: _Strips
    #: (dimensions, dimensions) float64: Of z.
    whitening: Array
    #: (dimensions,) float64: What these numbers say of ln(scale), and its variance besides.
    followed: Array
    scale_variance: float
    #: Natural logarithm of the surroundings' prior, over the root of the determinant.
    log_weight: float

    @classmethod
    def through(
        cls, around: Surroundings, strips: _Strips, discrepancy: Discrepancy, scale_variance: float
    ) -> _Seen:
        """What a discrepancy and a factor of the errors make of strips."""
        covariance = around.amplitude**2 * discrepancy.covariance
        covariance = covariance + around.error_factor**2 * np.eye(len(covariance))
        factor = np.linalg.cholesky(covariance)
        whitening = np.asarray(np.linalg.inv(factor), float)
        followed = around.amplitude**2 * (whitening @ discrepancy.with_scale)
        variance = around.error_factor**2 * scale_variance
        variance += around.amplitude**2 * discrepancy.of_scale - float(followed @ followed)
        origins, slopes = strips.origins @ whitening.T, strips.slopes @ whitening.T
        t, b = strips.t - origins @ followed, strips.b - slopes @ followed
        return cls(
            strips=replace(strips, origins=origins, slopes=slopes, t=t, b=b),
            whitening=whitening,
            followed=followed,
            scale_variance=max(variance, 0.0),
            log_weight=around.log_prior - float(np.log(np.diag(factor)).sum()),
        )


class _Products:
    """What strips have to do with each other and with the readings, and sets made of it."""

    def __init__(
        self, strips: _Strips, z: Array, variance: float, excluded: NDArray[np.bool_]
    ) -> None:
        self._owner, self._t, self._b = strips.owner, strips.t, strips.b
        origins, slopes = strips.origins, strips.slopes
        self._variance, self._excluded = variance, excluded
        self._squared = float(z @ z)
        self._oo: NDArray[Any] = origins @ origins.T
        self._aa: NDArray[Any] = slopes @ slopes.T
        self._ao: NDArray[Any] = slopes @ origins.T
        # of a strip alone: -r^2 / 2 but for z^2, its row of A, a^T r
        self._heights = origins @ z - 0.5 * np.diag(self._oo) + strips.log_weights
        self._own = 1.0 + np.diag(self._aa)
        self._along = slopes @ z - np.diag(self._ao)

    def sets(self, most: int) -> Iterator[tuple[Indices, Array, Array, Array]]:
        """Members, log weights, and mean and variance of the scale's logarithm, of all sets."""
        none = np.full((1, MOST_CAUSES), -1)
        yield (none, np.array([-0.5 * self._squared]), np.zeros(1), np.array([self._variance]))
        if not len(self._owner):
            return
        yield self._singles()
        if most < 2:
            return
        pairs = self._pairs()
        if not len(pairs.first):
            return
        members = pairs.members(self._owner)
        starts = _starts(members)
        yield (
            members[starts],
            *self._gathered(starts, pairs.log_weights, pairs.means, pairs.variances),
        )
        if most == MOST_CAUSES:
            # there are millions of strips: float32 holds their logarithms to 1e-4
            pairs = pairs.in_single_precision()
            self._oo, self._aa, self._ao = (
                products.astype(np.float32) for products in (self._oo, self._aa, self._ao)
            )
            for third in range(1, self._owner[-1] + 1):
                yield from self._triples(pairs, third)

    def _singles(self) -> tuple[Indices, Array, Array, Array]:
        own, along = self._own, self._along
        log_weights = self._heights + 0.5 * along**2 / own - 0.5 * np.log(own)
        members = np.full((len(own), MOST_CAUSES), -1)
        members[:, 0] = self._owner
        starts = _starts(members)
        means = self._t + self._b * along / own
        return (
            members[starts],
            *self._gathered(starts, log_weights - 0.5 * self._squared, means, self._b**2 / own),
        )

    def _pairs(self) -> _Pairs:
        """Two strips of two causes, the set with the lower last cause first."""
        owner = self._owner
        together = (owner[:, None] < owner[None, :]) & ~self._excluded[owner[:, None], owner]
        first, second = np.nonzero(together)
        order = np.lexsort((owner[first], owner[second]))
        i, j = first[order], second[order]
        between = self._aa[i, j]
        d1 = self._own[i]
        ratio = between / d1
        d2 = self._own[j] - ratio * between
        along1, along2 = self._along[i] - self._ao[i, j], self._along[j] - self._ao[j, i]
        b2 = self._b[j] - ratio * self._b[i]
        left2 = along2 - ratio * along1
        heights = self._heights[i] + self._heights[j] - self._oo[i, j]
        log_determinants = np.log(d1 * d2)
        return _Pairs(
            first=i,
            second=j,
            d1=d1,
            d2=d2,
            ratio=ratio,
            along1=along1,
            along2=along2,
            b1=self._b[i],
            b2=b2,
            t=self._t[i] + self._t[j],
            heights=heights,
            log_determinants=log_determinants,
            log_weights=heights
            - 0.5 * (self._squared + log_determinants)
            + 0.5 * (along1**2 / d1 + left2**2 / d2),
            means=self._t[i] + self._t[j] + self._b[i] * along1 / d1 + b2 * left2 / d2,
            variances=self._b[i] ** 2 / d1 + b2**2 / d2,
        )

    def _triples(self, pairs: _Pairs, third: int) -> Iterator[tuple[Indices, Array, Array, Array]]:
        """Sets of a cause with all pairs of causes before it.

        The pair's rows of A were eliminated before: what is left is one row for each third strip.
        """
        owner = self._owner
        last = int(np.searchsorted(owner[pairs.second], third))
        first, second = owner[pairs.first[:last]], owner[pairs.second[:last]]
        at = np.flatnonzero(~(self._excluded[first, third] | self._excluded[second, third]))
        if not len(at):
            return
        p = pairs.taken(at)
        members = p.members(owner)
        members[:, 2] = third
        log_weights, means, variances = [], [], []
        for k in np.flatnonzero(owner == third):
            row, lower, along = self._aa[k], self._ao[:, k].copy(), self._ao[k]
            of_strips = self._own, self._heights, self._along, self._b, self._t
            own, height, along_own, b, t = (np.float32(values[k]) for values in of_strips)
            along1, along2 = p.along1 - lower[p.first], p.along2 - lower[p.second]
            left2 = along2 - p.ratio * along1
            with1 = row[p.first]
            with2 = row[p.second] - p.ratio * with1
            ratio1, ratio2 = with1 / p.d1, with2 / p.d2
            d3 = own - ratio1 * with1 - ratio2 * with2
            left3 = along_own - along[p.first] - along[p.second]
            left3 -= ratio1 * along1 + ratio2 * left2
            b3 = b - ratio1 * p.b1 - ratio2 * p.b2
            heights = p.heights + height - self._oo[k][p.first] - self._oo[k][p.second]
            gains = along1**2 / p.d1 + left2**2 / p.d2 + left3**2 / d3
            log_determinants = p.log_determinants + np.log(d3)
            log_weights.append(
                heights + np.float32(0.5) * (gains - log_determinants - np.float32(self._squared))
            )
            step = p.b1 * along1 / p.d1 + p.b2 * left2 / p.d2 + b3 * left3 / d3
            means.append(p.t + t + step)
            variances.append(p.variances + b3**2 / d3)
        count = len(log_weights)
        starts = _starts(members)
        yield (
            members[starts],
            # strips of one set stand together
            *self._gathered(
                count * starts,
                *(np.stack(values, axis=1).ravel() for values in (log_weights, means, variances)),
            ),
        )

    def _gathered(
        self, starts: Indices, log_weights: Array, means: Array, variances: Array
    ) -> tuple[Array, Array, Array]:
        """Strips of one set, which stand together from `starts` on, as one Gaussian."""
        highest = np.maximum.reduceat(log_weights, starts)
        counts = np.diff(np.append(starts, len(log_weights)))
        weights = np.exp(log_weights - np.repeat(highest, counts))
        total = np.add.reduceat(weights, starts)
        mean = np.add.reduceat(weights * means, starts) / total
        square = np.add.reduceat(weights * (variances + means**2), starts) / total
        variance = np.maximum(square - mean**2, 0.0) + self._variance
        return highest + np.log(total), mean, variance


def _starts(members: Indices) -> Indices:
    """Where strips of another set begin; (strips, 3) causes, those of one set together."""
    first, second, third = (members[1:] != members[:-1]).T
    return np.flatnonzero(np.append(True, first | second | third))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Pairs:
    """Pairs of strips: the elimination of their two rows, all (pairs,)."""

    first: Indices
    second: Indices
    #: Diagonal of A after elimination, and what of the first row is taken off the second.
    d1: Array
    d2: Array
    ratio: Array
    #: a^T r of either strip, r without both origins.
    along1: Array
    along2: Array
    #: Slopes of ln S after elimination, and its shift.
    b1: Array
    b2: Array
    t: Array
    #: -r^2 / 2 + z^2 / 2 with the weights; ln |A|.
    heights: Array
    log_determinants: Array
    #: Of the pair as a set.
    log_weights: Array
    means: Array
    variances: Array

    def taken(self, at: Indices) -> _Pairs:
        """Some of them."""
        return _Pairs(**{name: values[at] for name, values in vars(self).items()})

    def in_single_precision(self) -> _Pairs:
        """The same numbers in float32."""
        numbers = {
            name: values.astype(np.float32) if values.dtype == np.float64 else values
            for name, values in vars(self).items()
        }
        return _Pairs(**numbers)

    def members(self, owner: Indices) -> Indices:
        """(pairs, 3) causes, the third of which is none."""
        none = np.full(len(self.first), -1)
        return np.stack([owner[self.first], owner[self.second], none], axis=1)
