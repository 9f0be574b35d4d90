"""What to measure next, to tell the leading explanations apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mcrim_mitsuba.diagnosis.explanations import Explanations
from mcrim_mitsuba.diagnosis.result import NextMeasurement
from mcrim_mitsuba.diagnosis.solver import Array
from mcrim_mitsuba.files.values import Value

# An expected difference in chi2 from which two explanations count as separated.
_SEPARATED = 6.0

# More than this per pair is worth no more: both are told apart.
_ENOUGH = 25.0

# Configurations handed back.
_MOST = 10


@dataclass(frozen=True)
class Proposals:
    """Configurations that the laboratory can build.

    Attributes
    ----------
    configurations : sequence of dict
        Scene parameters of each, by name.
    predict : callable
        ``predict(effects, theta)`` gives their (m,) signals and (m, free) slopes, of the model with
        these effects at these values of its free parameters.
    relative_sigma : float
        Of a new reading.
    """

    configurations: Sequence[dict[str, Value]]
    predict: Callable[[tuple[str, ...], Array], tuple[Array, Array]]
    relative_sigma: float


def next_measurements(
    explanations: Explanations, leading: Sequence[tuple[str, ...]], proposals: Proposals
) -> tuple[NextMeasurement, ...]:
    """Configurations by how well a reading there would separate the leading explanations.

    With one explanation true, a further reading y raises the chi2 of another by (y - m)^2 /
    (s^2 + v), m and v its prediction and the variance of that: both fits follow the new reading to
    first order. s is the reading's error.

    Parameters
    ----------
    explanations : Explanations
    leading : sequence of tuple of str
        Sets of effects, each an explanation.
    proposals : Proposals

    Returns
    -------
    tuple of NextMeasurement
        The best first, at most ten; none without two explanations.
    """
    if len(leading) < 2 or not proposals.configurations:
        return ()
    signals, variances = [], []
    for effects in leading:
        fit = explanations.fit(effects)
        signal, slopes = proposals.predict(tuple(sorted(effects)), fit.theta)
        at = fit.movable
        signals.append(signal)
        covariance = fit.parameter_covariance[np.ix_(at, at)]
        variances.append(np.einsum("ij,jk,ik->i", slopes[:, at], covariance, slopes[:, at]))
    pairs = list(combinations(range(len(leading)), 2))
    rises = np.array(
        [
            (signals[a] - signals[b]) ** 2
            / (
                (proposals.relative_sigma * 0.5 * (signals[a] + signals[b])) ** 2
                + np.maximum(variances[a], variances[b])
            )
            for a, b in pairs
        ]
    )
    order = np.argsort(-np.minimum(rises, _ENOUGH).mean(axis=0), kind="stable")[:_MOST]
    names = [" + ".join(effects) for effects in leading]
    return tuple(
        NextMeasurement(
            parameters=dict(proposals.configurations[i]),
            separates=tuple(
                (names[a], names[b])
                for (a, b), rise in zip(pairs, rises[:, i], strict=True)
                if rise >= _SEPARATED
            ),
            expected_delta_chi2=float(rises[:, i].mean()),
        )
        for i in order
    )
