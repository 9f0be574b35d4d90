"""What the article's own transmittance says: its three numbers for one crystal, side by side.

The article takes the transmittance for absorption alone, and fits the bulk scattering to the two
couplings. But a beam loses what is scattered as well as what is absorbed. Here the three numbers
are fitted together, the misfit is diagnosed, and the light yield is averaged over what they allow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import ArticleRow, compare
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.rounding import p_equals
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.diagnose import Diagnosis, diagnose
from mcrim_mitsuba.inference.evidence import NOTHING_MISSING
from mcrim_mitsuba.inference.unexplained import UNKNOWN
from mcrim_mitsuba.optics.attenuation import (
    absorption_coefficient,
    internal_transmittance,
    measured_transmittance,
    transmittance,
)
from mcrim_mitsuba.output.findings import IN_NO_CATALOGUE, told_apart
from mcrim_mitsuba.scene.shipped import scene_path

CAMPAIGN = "camoo4_three.toml"
#: Photons of a simulation with an effect, unless told otherwise: the readings' errors are 1.5 %.
PHOTONS = 32_768
#: Explanations that are named.
_NAMED = 4


@dataclass(frozen=True)
class Contradiction:
    """The article's couplings and its transmittance in one fit."""

    diagnosis: Diagnosis

    @property
    def likeliest(self) -> Mapping[str, float]:
        """The likeliest explanations with their probabilities."""
        known = [
            item for item in self.diagnosis.probabilities.items() if item[0] != NOTHING_MISSING
        ]
        return dict(known[:_NAMED])

    @property
    def light_yields(self) -> dict[str, float]:
        """With each effect alone, ph/keV."""
        found = {c.effect: c.light_yield_ph_per_keV for c in self.diagnosis.candidates}
        return {name: of_light["value"] for name, of_light in found.items() if of_light}

    def title(self, explanation: str) -> str:
        """One of the `likeliest` in words."""
        known = self.diagnosis.titles | {UNKNOWN: IN_NO_CATALOGUE}
        return " with ".join(known.get(name, name) for name in explanation.split(" + "))


def find_contradiction(run: Run) -> Contradiction:
    """Diagnose the three numbers; errors as `diagnose`."""
    campaign = read_campaign(scene_path(CAMPAIGN))
    return Contradiction(diagnose(campaign, run=replace(run, photons=PHOTONS)).diagnosis)


def rows(found: Contradiction) -> list[ArticleRow]:
    """What one number says of the other, the misfit, and the light yield."""
    n, length_mm = p.N_CRYSTAL.value, p.CRYSTAL_MM.value
    fitted = p.ALPHA_SCAT.value + p.NOMINAL.alpha_abs_per_cm.value
    seen = 100 * float(measured_transmittance(transmittance(fitted, length_mm), n))
    inside = internal_transmittance(p.MEASURED_TRANSMITTANCE.value / 100, n)
    allowed = float(absorption_coefficient(inside, length_mm))
    baseline, averaged = found.diagnosis.baseline, found.diagnosis.light_yield_averaged
    made = [
        compare(
            "transmittance with the fitted alpha_scat and alpha_abs, Eqs. 3-4",
            p.MEASURED_TRANSMITTANCE, seen, inconsistent=True,
            remark="polished faces, all scattered light lost: within 5 degrees of the beam a "
            "detector sees 0.05 % more",
        ),
        compare(
            "alpha_scat + alpha_abs that the transmittance allows", p.ALPHA_SCAT, allowed,
            inconsistent=True, remark="the article fits 0.54 /cm of scattering alone",
        ),
        compare(
            "chi2 of 14.3, 24.5 and 76 % in one fit, 1 degree of freedom", None, baseline.chi2,
            unit="", remark=f"{p_equals(baseline.p_value)}; errors as in {CAMPAIGN}",
        ),
    ]  # fmt: skip
    if averaged is not None:
        made.append(
            compare(
                "light yield, averaged over what the three numbers allow", p.LIGHT_YIELD,
                averaged.value, sigma=averaged.sigma, judged=False,
                remark=f"±{averaged.within:.2f} within explanations, ±{averaged.between:.2f} "
                f"between them, ±{averaged.catalogue:.2f} for what is in no catalogue; the light "
                "yields of the best four are in the sentences below",
            )
        )  # fmt: skip
    return made


def sentences(found: Contradiction) -> tuple[str, ...]:
    """The ranking, and what one measurement would decide."""
    diagnosis, said = found.diagnosis, []
    for name, probability in found.likeliest.items():
        of_light = found.light_yields.get(name)
        with_it = "" if of_light is None else f", {of_light:.1f} ph/keV with it"
        said.append(f"{found.title(name)}: probability {100 * probability:.2g} %{with_it}")
    nothing = 100 * diagnosis.probabilities.get(NOTHING_MISSING, 0.0)
    scat = diagnosis.baseline.parameters[ALPHA_SCAT].value
    absorption = diagnosis.baseline.parameters[ALPHA_ABS].value
    return (
        f"without any effect: probability {nothing:.2g} %, at {scat:.2g} /cm of scattering and "
        f"{absorption:.2g} /cm of absorption",
        *said,
        *_next(diagnosis),
    )


def _next(diagnosis: Diagnosis) -> tuple[str, ...]:
    if not diagnosis.next_measurements:
        return ()
    best = diagnosis.next_measurements[0]
    pairs = "; ".join(told_apart(diagnosis, best)[:2])
    told = f" ({pairs})" if pairs else ""
    return (f"one more measurement would tell most at {best.words}{told}",)
