"""Orders explanations, and says which of them the data cannot tell apart."""

from __future__ import annotations

from collections.abc import Hashable, Mapping

from mcrim_mitsuba.diagnosis import statistics
from mcrim_mitsuba.diagnosis.solver import Fit

#: Explanations this close to the best in `statistics.criterion` lead together with it; twice the
#: simulation's error of the difference is added. In synthetic campaigns with one effect of the
#: catalogue hidden the true one then is among them in more than 97 of 100.
LEADING = 6.0


class Ranking:
    """Explanations by `statistics.criterion`, the best first.

    Parameters
    ----------
    fits : mapping of key to Fit
        The keys are effects, or tuples of them.

    Attributes
    ----------
    order : tuple of key
    """

    def __init__(self, fits: Mapping) -> None:
        self._fits = dict(fits)
        self._scores = {key: statistics.criterion(fit) for key, fit in fits.items()}
        self.order = tuple(sorted(self._scores, key=lambda key: self._scores[key]))

    def behind(self, key: Hashable) -> float:
        """How far an explanation is behind the best."""
        return self._scores[key] - self._scores[self.order[0]]

    def leading(self) -> tuple:
        """Explanations that the data cannot tell from the best, the best first."""
        return tuple(
            key
            for key in self.order
            if self.behind(key) <= LEADING + 2.0 * self._error_of_difference(key)
        )

    def _error_of_difference(self, key: Hashable) -> float:
        """Simulation's error of an explanation's chi2 minus that of the best."""
        return error_of_difference(self._fits[key], self._fits[self.order[0]])


def error_of_difference(fit: Fit, other: Fit) -> float:
    """The simulation's standard error of two fits' difference in chi2.

    Both were made with the same batches, so that much of their error is common.
    """
    if fit is other:
        return 0.0
    one, two = statistics.chi2_of_batches(fit), statistics.chi2_of_batches(other)
    if one is None or two is None:
        return 0.0
    return statistics.error_of_mean(one - two)
