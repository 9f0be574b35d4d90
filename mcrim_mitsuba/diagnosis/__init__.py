"""Where a campaign's model fails, which effects explain it, and what to do about it.

Knows nothing of any renderer: ``diagnose(models, effects)`` works on models with the interface of
`fit.model.CampaignModel`, ``compare(model)`` on one of them.
"""

from mcrim_mitsuba.diagnosis.comparison import compare
from mcrim_mitsuba.diagnosis.diagnosis import diagnose
from mcrim_mitsuba.diagnosis.next_measurements import Proposals
from mcrim_mitsuba.diagnosis.result import (
    ADEQUATE,
    AMBIGUOUS,
    MISSING_EFFECT,
    TOO_FEW_READINGS,
    UNEXPLAINED,
    Candidate,
    Comparison,
    Diagnosis,
    Limit,
    NextMeasurement,
    RepairStep,
    Suspect,
)

__all__ = [
    "ADEQUATE",
    "AMBIGUOUS",
    "MISSING_EFFECT",
    "TOO_FEW_READINGS",
    "UNEXPLAINED",
    "Candidate",
    "Comparison",
    "Diagnosis",
    "Limit",
    "NextMeasurement",
    "Proposals",
    "RepairStep",
    "Suspect",
    "compare",
    "diagnose",
]
