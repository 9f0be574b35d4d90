"""Every result as the document that ``--json`` writes; `convert` reads them again."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mcrim_mitsuba.core.files import attributes

if TYPE_CHECKING:
    from mcrim_mitsuba.core.run import Provenance
    from mcrim_mitsuba.efficiency.arrival_times import ArrivalTimes
    from mcrim_mitsuba.efficiency.eta_spectrum import EtaSpectrum
    from mcrim_mitsuba.efficiency.lighting import EtaMap, Spread
    from mcrim_mitsuba.efficiency.table import EtaTable
    from mcrim_mitsuba.inference.budget import Budget
    from mcrim_mitsuba.inference.calibrate import CampaignResult
    from mcrim_mitsuba.inference.compare import Compared
    from mcrim_mitsuba.inference.diagnose import Diagnosed
    from mcrim_mitsuba.inference.hypotheses import HypothesesCompared
    from mcrim_mitsuba.inference.plan import ExpectedError, Plan, Planning
    from mcrim_mitsuba.inference.repair import Repaired
    from mcrim_mitsuba.laboratory.error_budget import ErrorBudget
    from mcrim_mitsuba.output.photograph import Rendering
    from mcrim_mitsuba.output.report import Reported
    from mcrim_mitsuba.reference.crosscheck import Crosscheck
    from mcrim_mitsuba.scene.check_text import CheckReport, Interface, SceneProblem
    from mcrim_mitsuba.transport.simulation import SimulationResult

Document = dict[str, Any]


def of_simulation(result: SimulationResult) -> Document:
    return attributes(
        result,
        "eta eta_sigma photons cached_photons seed seconds photons_per_second budget budget_sigma "
        "parameters versions scene_hash polarization transport",
        photons_requested="requested",
    ) | attributes(result, "interrupted notes")


def of_map(mapped: EtaMap, spreads: Sequence[Spread]) -> Document:
    names = "source eta eta_sigma relative_rms relative_rms_sigma fwhm"
    return {
        "spreads": [attributes(one, names) for one in spreads],
        "cells": mapped.eta.shape,
        **attributes(mapped, "photons seed parameters scene_hash"),
    }


def of_spectrum(found: EtaSpectrum) -> Document:
    light = found.light
    columns = {"eta": found.eta, "eta_sigma": found.eta_sigma, "detected_part": found.detected_part}
    known = {"emission": light.emission, "efficiency": light.efficiency, **light.parameters}
    every = zip(light.wavelength_nm, *columns.values(), *known.values(), strict=True)
    names = ("wavelength_nm", *columns, *known)
    return attributes(
        found,
        "eta_emitted eta_emitted_sigma eta_detected eta_detected_sigma efficiency_emitted "
        "efficiency_arriving efficiency_arriving_sigma eta_at_mean eta_at_mean_sigma "
        "one_wavelength_off one_wavelength_off_sigma interpolation_error nodes_nm photons "
        "cached_photons seed parameters scene_hash",
    ) | {
        "mean_wavelength_nm": light.mean_nm,
        "wavelengths": [dict(zip(names, map(float, one), strict=True)) for one in every],
    }


def of_times(found: ArrivalTimes) -> Document:
    first = "born mean_ps mean_ps_sigma rms_ps rms_ps_sigma"
    return {
        **attributes(found, "mean_ps mean_ps_sigma rms_ps rms_ps_sigma begin_ps begin_ps_sigma"),
        **attributes(found, "rise_ps rise_ps_sigma decay_ns detected"),
        "first": [attributes(one, first) for one in found.first],
        "parts": [
            attributes(one, "name group_index origin mean_ps mean_ps_sigma") for one in found.parts
        ],
        **attributes(found, "photons seed parameters scene_hash notes"),
    }


def of_table(made: EtaTable, *, seconds: float | None = None) -> Document:
    return (
        attributes(made, "rows photons cached_photons seed")
        | {"seconds": seconds}
        | attributes(made, "parameters scene_hash notes")
    )


def of_calibration(result: CampaignResult, *, seconds: float | None = None) -> Document:
    fit, provenance = result.calibration, result.provenance
    known = {"seconds": seconds, "photons": provenance.photons, "spent": result.spent}
    notes = {"notes": [*fit.notes, *provenance.notes]}
    document = fit.to_json()
    for profile in result.profiles:
        ends = zip(("lower_95", "upper_95"), profile.interval_95, strict=True)
        document["parameters"][profile.name] |= dict(ends)
    return document | known | attributes(provenance, "seed scene_hash versions") | notes


def of_comparison(found: Compared) -> Document:
    fit = found.calibration
    said = dataclasses.asdict(found.comparison) | fit.to_json()
    return said | _provenance(found.provenance, fit.notes)


def of_hypotheses(found: HypothesesCompared) -> Document:
    document = dataclasses.asdict(found.comparison)
    for one in document["hypotheses"]:
        one["scene_hash"] = found.scenes[one["name"]]
    return document | _provenance(found.provenance, ()) | {"scene_hash": found.scenes}


def of_diagnosis(found: Diagnosed) -> Document:
    return _diagnosis(found) | _provenance(found.provenance, found.baseline.notes)


def of_repair(found: Repaired) -> Document:
    return {
        **_diagnosis(found.diagnosed),
        "effects": found.effects,
        "calibration": found.calibration.to_json(),
        **attributes(found, "undetermined", campaign="campaign_path", scene="scene_path"),
        **_provenance(found.provenance, found.calibration.notes),
    }


def _diagnosis(found: Diagnosed) -> Document:
    """A diagnosis, its baseline as `of_calibration` has it."""
    document = dataclasses.asdict(found.diagnosis)
    document["baseline"] |= found.baseline.to_json()
    return document


def _provenance(provenance: Provenance, notes: Sequence[str]) -> Document:
    return dataclasses.asdict(provenance) | {"notes": [*notes, *provenance.notes]}


def of_budget(found: Budget) -> Document:
    return found.to_json() | _provenance(found.provenance, found.calibration.notes)


def of_contributions(budget: ErrorBudget) -> Document:
    """A budget of one value, relative errors without their signs."""
    parts = [
        vars(one) | {"relative": abs(one.relative), "share_of_variance": budget.share(one)}
        for one in budget.contributions
    ]
    return {"contributions": parts, **attributes(budget, _SUMS)}


_SUMS = "statistical systematic total"


def of_planning(found: Planning, seed: int) -> Document:
    from mcrim_mitsuba.output import sentences

    floors = [
        {"configurations": chosen, **_expected(error)} for chosen, error in found.floors.items()
    ]
    return {
        "wanted": found.wanted,
        "reached": found.cheapest is not None,
        "cheapest": _plan(found, found.cheapest),
        "cheapest_statistical": _plan(found, found.cheapest_statistical),
        "verdict": sentences.verdict(found),
        **attributes(found, "conditions candidates"),
        "floors": floors,
        "undetermined": found.undetermined,
        "plans": [_plan(found, each) for each in found.plans],
        "solution": found.solution,
        "seed": seed,
        "notes": found.notes,
    }


def _plan(found: Planning, plan: Plan | None) -> Document | None:
    if plan is None:
        return None
    return {
        "configurations": [found.candidates[i].parameters for i in plan.configurations],
        **attributes(plan, "mountings events hours"),
        "light_yield": _expected(plan.light_yield),
        "alpha_scat": None if plan.alpha_scat is None else _expected(plan.alpha_scat),
    }


def _expected(error: ExpectedError) -> Document:
    """Relative errors."""
    return attributes(error, f"{_SUMS} parts")


def of_check(report: CheckReport) -> Document:
    return {
        "ok": report.ok,
        "problems": [_with_file(problem) for problem in report.problems],
        "parameters": report.parameters,
        "interfaces": [_with_file(face) for face in report.interfaces],
        "words": list(report.words),
        "notes": list(report.notes),
    }


def _with_file(placed: SceneProblem | Interface) -> Document:
    return {"file" if name == "path" else name: value for name, value in vars(placed).items()}


def of_installation(found: Mapping[str, object]) -> Document:
    return {"ok": True, "problems": [], "installation": dict(found)}


def of_crosscheck(found: Crosscheck, seed: int) -> Document:
    return {
        **attributes(found, "rows family_p_value agrees"),
        "photons": {"mitsuba": found.mitsuba_photons, "numpy": found.numpy_photons},
        "seed": seed,
    }


def of_rendering(made: Rendering, picture: str, *, seconds: float) -> Document:
    high, wide = made.pixels.shape[:2]
    return (
        {"picture": picture, "width": wide, "height": high}
        | attributes(made, "parts samples seed")
        | {"seconds": seconds}
        | attributes(made, "parameters versions scene_hash")
    )


def of_report(found: Reported) -> Document:
    repaired = found.sections.repaired
    said = _diagnosis(repaired.diagnosed) | found.sections.numbers() | {"report": found.path}
    of_run = _provenance(found.provenance, repaired.calibration.notes)
    return said | of_run | {"notes": [*dict.fromkeys(of_run["notes"])]}
