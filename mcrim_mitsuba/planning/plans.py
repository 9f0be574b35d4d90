"""Plans of a measurement with the errors that they would bring."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mcrim_mitsuba.fit.result import ParameterEstimate
from mcrim_mitsuba.planning.conditions import Conditions

#: Origins of the light yield's error; that of a prior goes on with its parameter.
PRIOR = "prior of "
EVENTS_ORIGIN, MOUNTINGS_ORIGIN, EFFICIENCY = "events", "mountings", "detector efficiency"
STATISTICAL = (EVENTS_ORIGIN, MOUNTINGS_ORIGIN)
# A plan is more precise than another if its error is less than this part of the other's.
_BETTER = 0.98


@dataclass(frozen=True)
class Candidate:
    """A configuration that may be measured.

    Attributes
    ----------
    parameters : dict
        What differs from the scene.
    signal : float
        Photons per event that the model predicts at the solution.
    event_sigma : float
        Error of the mean that a fit finds times the square root of the events in the band:
        the band's width, and what the fitted background and the window lose.
    """

    parameters: dict[str, float]
    signal: float
    event_sigma: float

    @property
    def name(self) -> str:
        """``n_gap = 1.46``."""
        return ", ".join(f"{name} = {value:g}" for name, value in self.parameters.items())


@dataclass(frozen=True)
class ExpectedError:
    """Expected relative standard error of a parameter.

    Attributes
    ----------
    parts : dict of str to float
        By origin: ``events``, ``mountings``, ``prior of NAME`` and, of the light yield,
        ``detector efficiency`` or what makes its error; they add up in quadrature.
    """

    parts: dict[str, float]

    @property
    def statistical(self) -> float:
        """What more events and mountings lower."""
        return math.hypot(self.parts[EVENTS_ORIGIN], self.parts[MOUNTINGS_ORIGIN])

    @property
    def systematic(self) -> float:
        """Priors and detector efficiency."""
        return math.hypot(self.priors, self.efficiency)

    @property
    def total(self) -> float:
        """All parts in quadrature, relative."""
        return math.hypot(*self.parts.values())

    @property
    def priors(self) -> float:
        """The parts by priors in quadrature, relative."""
        return math.hypot(*(p for n, p in self.parts.items() if n.startswith(PRIOR)))

    @property
    def of_plan(self) -> float:
        """What depends on the plan: all but the detector efficiency."""
        return math.hypot(self.statistical, self.priors)

    @property
    def efficiency(self) -> float:
        """Of the detector."""
        own = (*STATISTICAL, PRIOR)
        return math.hypot(*(p for n, p in self.parts.items() if not n.startswith(own)))


@dataclass(frozen=True)
class Plan:
    """One way to measure.

    Attributes
    ----------
    configurations : tuple of int
        Places in `Planning.candidates`.
    mountings : int
        Of each configuration.
    events : float
        In the band, of each mounting.
    hours : float
    light_yield : ExpectedError
        Of the scale, where the campaign has no light yield.
    alpha_scat : ExpectedError or None
        None where the campaign holds it.
    """

    configurations: tuple[int, ...]
    mountings: int
    events: float
    hours: float
    light_yield: ExpectedError
    alpha_scat: ExpectedError | None


@dataclass(frozen=True)
class Planning:
    """Plans, and what they rest on.

    Attributes
    ----------
    wanted : float
        Relative error of the light yield.
    conditions : Conditions
    candidates : tuple of Candidate
    plans : tuple of Plan
        The cheapest first; sets of configurations that do not determine the parameters have none.
    floors : dict of tuple of int to ExpectedError
        Per set of configurations, what readings without any error would leave of the light
        yield's.
    solution : dict of str to ParameterEstimate
        The campaign's own calibration, from which all was predicted.
    undetermined : tuple of tuple of int
        Sets that do not determine the parameters.
    notes : tuple of str
        What the reader must know before using the numbers.
    """

    wanted: float
    conditions: Conditions
    candidates: tuple[Candidate, ...]
    plans: tuple[Plan, ...]
    floors: dict[tuple[int, ...], ExpectedError]
    solution: dict[str, ParameterEstimate]
    undetermined: tuple[tuple[int, ...], ...]
    notes: tuple[str, ...]

    @property
    def cheapest(self) -> Plan | None:
        """The first plan whose whole error is the wanted one or less."""
        return next((p for p in self.plans if p.light_yield.total <= self.wanted), None)

    @property
    def cheapest_statistical(self) -> Plan | None:
        """The first plan whose statistical part is the wanted error or less."""
        return next((p for p in self.plans if p.light_yield.statistical <= self.wanted), None)

    @property
    def efficient(self) -> tuple[Plan, ...]:
        """Plans that are more precise than every cheaper one, the cheapest first."""
        found: list[Plan] = []
        for plan in self.plans:
            of_plan = plan.light_yield.of_plan
            if not found or of_plan < _BETTER * found[-1].light_yield.of_plan:
                found.append(plan)
        return tuple(found)

    @property
    def lowest_floor(self) -> tuple[tuple[int, ...], ExpectedError]:
        """The set of configurations that could become most precise, and how precise."""
        return min(self.floors.items(), key=lambda item: (item[1].total, len(item[0])))

    def name(self, configurations: Sequence[int]) -> str:
        """``n_gap = 1, 1.46``."""
        chosen = [self.candidates[i] for i in configurations]
        names = {name for each in chosen for name in each.parameters}
        if len(names) == 1:
            (name,) = names
            return f"{name} = {', '.join(f'{each.parameters[name]:g}' for each in chosen)}"
        return "; ".join(each.name for each in chosen)
