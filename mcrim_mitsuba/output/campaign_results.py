"""What the public functions on campaigns give: typed results that show and export themselves.

Each is what a function of `inference` gave, with what is needed to show it; `of` makes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.editor import to_json
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.reduction import RawData
from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, unit_of
from mcrim_mitsuba.core.run import Provenance
from mcrim_mitsuba.inference.budget import Budget
from mcrim_mitsuba.inference.compare import Comparison
from mcrim_mitsuba.inference.diagnose import Diagnosis
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, FittedRow, ParameterEstimate
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.hypotheses import SideBySide
from mcrim_mitsuba.inference.plan import Plan, Planning
from mcrim_mitsuba.inference.repair import Repaired
from mcrim_mitsuba.output import sentences
from mcrim_mitsuba.output.registry import Document, Result, encoded, fields_of

if TYPE_CHECKING:
    from mcrim_mitsuba.output.report_sections import Sections


@dataclass(frozen=True, repr=False)
class FittedParameter(ParameterEstimate):
    """A fitted parameter with its errors, which says its unit: ``7.5 ± 0.8 ph/keV``."""

    name: str = field(kw_only=True)

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        return " ".join(filter(None, (sentences.estimate_text(self), unit_of(self.name))))

    def __repr__(self) -> str:
        return f"<{self.name} = {self}>"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class CampaignShown(Result):
    """What all results on campaigns have."""

    #: Of the campaign, for figures; and the unit of its signals, empty where it is not known.
    title: str
    unit: str
    #: Of all simulations.
    provenance: Provenance
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...]

    @classmethod
    def of(
        cls,
        result: Any,
        campaign: Campaign,
        provenance: Provenance,
        notes: Iterable[str] = (),
        **further: Any,
    ) -> Self:
        """Fields of a result, and `further` ones; `notes` are those besides the simulations'."""
        fields = fields_of(result) | attributes(campaign, "title unit")
        every_note = tuple(dict.fromkeys((*notes, *provenance.notes)))
        fields |= {"provenance": provenance, "notes": every_note}
        return cls(**fields | further)


_PARAMETERS = (LIGHT_YIELD, ALPHA_SCAT, ALPHA_ABS, SCALE)


class FittedResult(CampaignShown):
    """A result with fitted parameters, each of which is an attribute too.

    Where a campaign does not fit one of them, asking for it is an AttributeError.
    """

    def __dir__(self) -> list[str]:
        absent = set(_PARAMETERS) - set(self.__dict__.get("parameters", {}))
        return sorted(set(super().__dir__()) - absent)

    def _fitted(self, name: str) -> FittedParameter:
        """A fitted parameter by its name; an AttributeError says which were fitted."""
        # while a result is copied or unpickled it has none
        parameters = self.__dict__.get("parameters", {})
        if name in parameters:
            return FittedParameter(**fields_of(parameters[name]), name=name)
        hint = f"; it has fitted {', '.join(parameters)}" if name in _PARAMETERS else ""
        raise AttributeError(f"{type(self).__name__} has no {name}{hint}")

    if not TYPE_CHECKING:  # a type checker shall refuse attributes that are not declared
        __getattr__ = _fitted

    @property
    def light_yield_ph_per_keV(self) -> FittedParameter:
        """Absolute light yield, photons per keV, where the campaign says how to get it."""
        return self._fitted(LIGHT_YIELD)

    @property
    def alpha_scat_per_cm(self) -> FittedParameter:
        """Scattering coefficient of the crystal, 1/cm."""
        return self._fitted(ALPHA_SCAT)

    @property
    def alpha_abs_per_cm(self) -> FittedParameter:
        """Absorption coefficient of the crystal, 1/cm."""
        return self._fitted(ALPHA_ABS)

    @property
    def scale(self) -> FittedParameter:
        """Signal per light collection efficiency."""
        return self._fitted(SCALE)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FitResult(FittedResult, Calibration):
    """A fitted campaign: parameters with all their errors, readings beside predictions."""

    #: Wall time.
    seconds: float

    def numbers(self) -> dict[str, Any]:
        """The fit for JSON, with the ends of the 95 % intervals."""
        document = super().numbers()
        for profile in self.profiles:
            ends = zip(("lower_95", "upper_95"), profile.interval_95, strict=True)
            document["parameters"][profile.name] |= dict(ends)
        return document


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ComparisonResult(FittedResult, Comparison):
    """A campaign beside its model: pulls, suspect readings, trends."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class HypothesesResult(CampaignShown, SideBySide):
    """Hypotheses on the same readings side by side."""

    #: Hashes of the scenes by hypothesis.
    scenes: dict[str, str]

    @property
    def hypotheses_with_scenes(self) -> list[dict[str, Any]]:
        """Fields of the hypotheses, and the hashes of their scenes."""
        return [
            {**fields_of(hypothesis), "scene_hash": self.scenes[hypothesis.name]}
            for hypothesis in self.hypotheses
        ]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DiagnosisResult(CampaignShown, Diagnosis):
    """Which effects of the catalogue explain a campaign's misfit."""

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of its figures; what comes next is one where it lowers the light yield's error."""
        lower = any(new.light_yield_sigma for new in self.next_measurements)
        return super().pictures if lower else super().pictures[:1]


_OF_MENDED_FIT = ("parameters", "chi2", "ndf", "p_value", "rows", "notes")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class RepairResult(FittedResult, Diagnosis):
    """A mended campaign: what was added, its fit, and the diagnosis before."""

    #: Effects that were added; none where the campaign was adequate or nothing explains it.
    effects: tuple[str, ...]
    #: Of the mended campaign, its effects simulated together where the fit ends.
    calibration: Calibration
    #: Those of `calibration`, as are chi2 and the readings beside its predictions.
    parameters: Mapping[str, ParameterEstimate]
    chi2: float
    ndf: int
    p_value: float | None
    rows: tuple[FittedRow, ...]
    #: What was written; None where nothing was added.
    campaign_path: Path | None
    scene_path: Path | None
    #: Why nothing was added although the verdict names an effect: what is not determined with it.
    undetermined: str

    @classmethod
    def of_repair(cls, repaired: Repaired, campaign: Campaign, **further: Any) -> Self:
        """The result of a repair; `further` are fields of a subclass, and such as differ."""
        names = "effects campaign_path scene_path undetermined calibration=fit provenance "
        names += " ".join(f"{of_fit}=fit.{of_fit}" for of_fit in _OF_MENDED_FIT)
        return cls.of(repaired.diagnosis, campaign, **attributes(repaired, names) | further)

    @property
    def mended_fit(self) -> Calibration | None:
        """The fit with the effects that were added; None where none was."""
        return self.calibration if self.effects else None

    @property
    def added(self) -> str:
        """The effects that were added, in words."""
        return sentences.in_words(self, self.effects) if self.effects else ""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ReportResult(RepairResult):
    """A report that was written, and the repair that it tells."""

    path: Path
    #: What it tells.
    sections: Sections

    @classmethod
    def of_report(cls, path: Path, sections: Sections) -> Self:
        """The result of a report that was written."""
        further = {"provenance": sections.simulations.provenance(), "sections": sections}
        return cls.of_repair(sections, sections.campaign, path=path, **further)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BudgetResult(CampaignShown, Budget):
    """Where all errors of a campaign come from, and what its model leaves out."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ReductionResult(Result, RawData):
    """A campaign's raw data, reduced."""

    title: str
    campaign_path: Path
    #: Where the campaign was written in plain numbers; None where it was not.
    plain_path: str | Path | None

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of its figures: its `kinds`."""
        return self.kinds

    @property
    def steps(self) -> dict[str, Any]:
        """Every step from raw data to numbers."""
        return to_json(self)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PlanResult(Result, Planning):
    """How to measure for a wanted error of the light yield."""

    title: str
    seed: int

    def numbers(self) -> Document:
        """Plans with the parameters of their configurations, and what they rest on."""
        floors = ({"configurations": c, **encoded(error)} for c, error in self.floors.items())
        return {
            "wanted": self.wanted,
            "reached": self.cheapest is not None,
            "cheapest": self._plan(self.cheapest),
            "cheapest_statistical": self._plan(self.cheapest_statistical),
            "proposed": self._plan(self.proposed),
            "so_far": self.so_far,
            "verdict": sentences.verdict(self),
            **attributes(self, "capability titles conditions candidates"),
            "floors": list(floors),
            "undetermined": self.undetermined,
            "plans": list(map(self._plan, self.plans)),
            **attributes(self, "solution seed notes"),
        }

    def _plan(self, plan: Plan | None) -> Document | None:
        """A plan with its configurations spelled out, as ``--json`` writes it."""
        if plan is None:
            return None
        return {
            "configurations": [self.candidates[i].parameters for i in plan.configurations],
            **attributes(plan, "mountings events hours light_yield alpha_scat"),
        }
