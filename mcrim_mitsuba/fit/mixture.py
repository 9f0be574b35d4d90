"""Light that has many values of an effect's parameter at once, such as indices over a band."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.fit.response import EffectResponse


def mixture(response: EffectResponse, values: ArrayLike, weights: ArrayLike) -> EffectResponse:
    """The mean of eta over values of an effect's parameter, as an effect that is on or off.

    Eta itself is averaged, not its logarithm: photons of every value are counted.

    Parameters
    ----------
    response : EffectResponse
        With one parameter.
    values : (values,) array_like
        Of the parameter, as the scene takes it (an index, not its offset).
    weights : (values,) array_like
        Parts of the light, none negative; their sum need not be 1.

    Raises
    ------
    ValueError
        If the response has not one parameter, or a value is beyond its outermost nodes.
    """
    if len(response.axes) != 1:
        raise ValueError(f"a mixture over {len(response.axes)} parameters")
    (axis,) = response.axes
    values = np.asarray(values, dtype=float)
    low, high = (axis.nominal + end for end in (min(axis.values), max(axis.values)))
    if values.min() < low or values.max() > high:
        raise ValueError(
            f"{axis.name} = {values.min():g}..{values.max():g} is beyond {low:g}..{high:g}"
        )
    # (values, nodes): what each node contributes to the logarithm at each value
    nodes = np.array([axis.weights(value)[0] for value in values])
    parts = np.exp(np.tensordot(nodes, response.log_ratio, axes=1))
    parts *= (np.asarray(weights, dtype=float) / np.sum(weights))[:, None, None, None]
    total = parts.sum(axis=0)
    of_nodes = np.tensordot(nodes.T, parts / total, axes=1)
    deviations = np.einsum("nrsa,bnrsa->brsa", of_nodes, response.deviations)
    return EffectResponse((), np.log(total), deviations.astype(np.float32))
