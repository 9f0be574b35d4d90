"""Plan a measurement; see `plan`."""

from mcrim_mitsuba.planning.conditions import Conditions, event_sigma, measured_conditions
from mcrim_mitsuba.planning.measuring import plan
from mcrim_mitsuba.planning.plans import Candidate, ExpectedError, Plan, Planning
from mcrim_mitsuba.planning.words import percent, plan_text, verdict

__all__ = [
    "Candidate",
    "Conditions",
    "ExpectedError",
    "Plan",
    "Planning",
    "event_sigma",
    "measured_conditions",
    "percent",
    "plan",
    "plan_text",
    "verdict",
]
