"""Findings of compare, diagnose and repair made by hand: no simulation, hostile labels."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from mcrim_mitsuba.core.run import Provenance
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.inference import repair as repairing
from mcrim_mitsuba.inference.candidates import Candidate, Limit
from mcrim_mitsuba.inference.compare import Absorbed, Comparison, Suspect, Trend
from mcrim_mitsuba.inference.diagnose import Diagnosis, FamilyProbability, RepairStep
from mcrim_mitsuba.inference.drivers import Minimum
from mcrim_mitsuba.inference.estimates import FittedRow, ParameterEstimate
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.next_measurements import NextMeasurement
from mcrim_mitsuba.inference.weighing import AveragedYield
from mcrim_mitsuba.output import photograph
from mcrim_mitsuba.output import report as reporting
from mcrim_mitsuba.output import report_sections as sections

MARKUP, QUOTES = "[bold red]gel[/] :smile: $x^2", 'the "good" air, 2nd'
SCRIPT = "<script>x</script>"
LABELS = [MARKUP, QUOTES, SCRIPT] + [
    f"n_gap 1.46, aperture {i} mm, crystal of 10 mm, mounting {i}" for i in range(13)
]
PULLS = [6.0, -3.0, 1.0, *[0.5, -0.5] * 6, 2.0]
OFF, FIRST, SECOND = "polarization", "surface_absorption", "gap_bubble"
TITLES = {name: effect.title for name, effect in catalogue().items()}
PROVENANCE = Provenance(
    3, 4_000_000, 1_000_000, "hash", versions={"mitsuba": "3.9"}, seconds=1.5, notes=("from afar",)
)


def estimate(value: float, sigma: float, at_bound: str | None = None) -> ParameterEstimate:
    ends = value - sigma, value + sigma
    return ParameterEstimate(value, sigma, *ends, at_bound, {"statistical": sigma})


FITTED = {"alpha_scat_per_cm": estimate(0.62, 0.03), "light_yield_ph_per_keV": estimate(8.31, 0.25)}
MENDED = {
    "alpha_scat_per_cm": estimate(0.543, 0.021),
    "light_yield_ph_per_keV": estimate(7.52, 0.22),
    "surface_loss": estimate(0.0123, 0.0008),
}


def rows(shrunk: float = 1.0) -> tuple[FittedRow, ...]:
    def row(i: int) -> FittedRow:
        signal, pull = 20.0 + i, shrunk * PULLS[i]
        return FittedRow(
            LABELS[i], signal, 0.2, signal - 0.2 * pull, 0.01, pull, 0.3, 0.001, i != 15
        )

    return tuple(map(row, range(len(LABELS))))


#: The campaign of what is made by hand: nothing was added to it.
AS_IT_CAME = SimpleNamespace(remark="", yield_to_quote="")
#: A fit made by hand has no model, and no profiles.
NONE = np.zeros((0, 0))
_MODEL = SimpleNamespace(readings=(), campaign=AS_IT_CAME)
_WEIGHTS = SimpleNamespace(errors=SimpleNamespace(tolerances=NONE))
_AT_ALL = {"statistic": SimpleNamespace(model=_MODEL), "weights": _WEIGHTS}
MINIMUM = cast(
    Minimum, SimpleNamespace(names=(), weighted_residuals=np.zeros(0), precision=NONE, **_AT_ALL)
)


def calibration(parameters=FITTED, shrunk: float = 1.0, chi2: float = 64.2) -> Calibration:
    p_value = 0.42 if shrunk < 1 else 2.3e-9
    linear = {"covariance": np.eye(1), "response": np.zeros((1, 16)), "minimum": MINIMUM}
    told = {"names": ("alpha_scat_per_cm",), "fixed": {}, "converged": True, "notes": ()}
    quality = {"chi2": chi2, "ndf": 12, "p_value": p_value, "rows": rows(shrunk)}
    return Calibration(parameters=parameters, **quality, **linear, **told)


def comparison(p_value: float | None = 2.3e-9, suspects: tuple[Suspect, ...] = ()) -> Comparison:
    fit = replace(calibration(), p_value=p_value, ndf=12 if p_value is not None else 0)
    pulled = "alpha_abs = 0.07 is +2.6 sigma off"
    return Comparison(
        **vars(fit),
        expected_chi2=(7.1, 16.9),
        rms_pull=2.1,
        left_out_error=2.6,
        left_out_pulls={row.label: 1.1 * row.pull for row in rows() if row.use},
        suspects=suspects,
        trends=(Trend("n_gap", (1.0, 1.46), (-2.1, 2.2), 40.0, 1, 2e-4),),
        absorbed=(Absorbed("alpha_abs_per_cm", "prior_pulled", 0.07, pulled),),
    )


BAD = Suspect("bad_reading", (MARKUP,), 50.1, 3e-6, 14.1, 11, 0.23, 7.1, True)
SWAPPED = Suspect("swapped_rows", (QUOTES, SCRIPT), 30.2, 1e-5, 34.0, 12, 6e-4, None, False)


def candidate(
    effects: tuple[str, ...],
    gain: float,
    sizes: dict[str, ParameterEstimate],
    mimics: tuple[str, ...] = (),
    plausible: bool = True,
) -> Candidate:
    """Numbers in the order of its fields: of the fit, of the gain, of the evidence."""
    return Candidate(
        " + ".join(effects),
        effects,
        *(64.2 - gain, 12 - len(sizes), 0.44),
        *(gain, 0.8, 1e-9, 2e-8, -gain),
        *(0.4 * gain, 54.2 - gain, 1.3),
        {**FITTED, **sizes},
        tuple(sizes),
        {"value": 7.52, "sigma": 0.2, "change": -0.095},
        *(plausible, any(s.at_bound for s in sizes.values()), 0.5, mimics),
        "surface",
        "Polish it again.",
    )


CANDIDATES = (
    candidate((FIRST,), 52.1, {"surface_loss": estimate(0.0123, 0.0008)}, (SECOND,)),
    candidate((SECOND,), 50.3, {"bubble_fraction": estimate(0.2, 0.01)}, plausible=False),
    candidate(("gap_absorption",), 9.0, {"gap_absorption_per_cm": estimate(20, 3, "max")}),
    candidate((OFF,), -2.2, {}),
)
SIZES = {"surface_loss": estimate(0.01, 0.001), "bubble_fraction": estimate(0.1, 0.02)}
FAMILIES = (
    FamilyProbability("surface", 0.7, (FIRST,)),
    FamilyProbability("gap", 0.29, (SECOND,)),
    FamilyProbability("none", 0.01, ()),
)
PAIR = candidate((FIRST, SECOND), 55.0, SIZES)
YIELDS = {"value": 8.31, "sigma": 0.25}, {"value": 7.52, "sigma": 0.22}
QUALITY = (64.2, 12, 2.3e-9, 2.1, 2.6, 0.0), (12.1, 11, 0.36, 0.9, 1.1, 0.8)
STEPS = (
    RepairStep(0, None, (), *QUALITY[0], FITTED, YIELDS[0]),
    RepairStep(1, FIRST, (FIRST,), *QUALITY[1], MENDED, YIELDS[1], TITLES[FIRST]),
)


def diagnosis(verdict: str, **changed) -> Diagnosis:
    leading = {"missing_effect": ((FIRST,),), "ambiguous": ((FIRST,), (SECOND,))}.get(verdict, ())
    limits = {
        FIRST: Limit("surface_loss", 0.0, None, 0.0021, 0.3, False),
        "source_depth": Limit("source_depth_mm", math.inf, 3.25, None, 0.0, False),
        "gap_index": Limit("gap_index_offset", 0.0, -0.02, 0.031, 0.1, False),
        "crystal_index": Limit("n_crystal", 2.01, -math.inf, math.inf, 0.1, False),
        OFF: Limit(None, None, None, None, -9.3, True),
    }
    following = NextMeasurement(
        kind="reading + reading",
        parameters={"n_gap": 1.333, "gap_mm": 0.5},
        separates=((FIRST, SECOND),),
        expected_delta_chi2=12.3,
        also={"n_gap": 1.46, "aperture_radius_mm": 7.0},
        light_yield_sigma=0.083,
        light_yield_kept=0.72,
        light_yield_sigma_otherwise=0.105,
        probability=0.94,
        hours=1.0,
        words="water, gap of 0.5 mm; and gel, mask of 7 mm radius",
    )
    unchanged = Diagnosis(
        verdict=verdict,
        reason=f"as {MARKUP} shows",
        baseline=comparison(),
        candidates=CANDIDATES,
        leading=tuple(name for names in leading for name in names),
        leading_sets=leading,
        upper_limits=limits if verdict == "adequate" else {},
        repair=STEPS,
        next_measurements=(following,) if verdict == "ambiguous" else (),
        not_tried={"nonlinearity": "excluded"},
        probabilities={FIRST: 0.7, SECOND: 0.29, "none": 0.01},
        light_yield_averaged=AveragedYield(7.7, 0.86, 0.78, 0.34, 0.12),
        seconds=1.0,
        families=FAMILIES,
        titles=TITLES,
    )
    return replace(unchanged, **changed)


@contextmanager
def quick_report(by_hand: Diagnosis) -> Iterator[pytest.MonkeyPatch]:
    """Reports of few photons and without a photograph, their diagnosis made by hand."""

    def repair(campaign, run):
        found = repairing.repair(campaign, run=replace(run, photons=2000))
        return replace(found, diagnosis=by_hand)

    sheets = np.zeros((920, 1440, 3), np.uint8), np.zeros((472, 712, 3), np.uint8)
    blank = SimpleNamespace(picture=sheets, trouble="")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reporting, "repair", repair)
        patch.setattr(photograph, "begin_photograph", lambda *_: blank)
        patch.setattr(sections, "LIGHT_PHOTONS", 4000)
        yield patch
