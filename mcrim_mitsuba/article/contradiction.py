"""What the article's own transmittance says: its three numbers for one crystal, side by side.

The article takes the transmittance for absorption alone, and fits the bulk scattering to the two
couplings. But a beam loses what is scattered as well as what is absorbed: two claims follow, which
are told apart. The fitted point predicts another transmittance, by far. And the coefficients that
the transmittance allows are fitted to the couplings with all that is known of the bench, the misfit
is diagnosed, and the light yield is averaged over what the three numbers allow.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from scipy.optimize import brentq

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import ArticleRow, compare
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.rounding import p_equals
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.efficiency.simulate import collect_whole
from mcrim_mitsuba.inference.diagnose import Diagnosis, diagnose
from mcrim_mitsuba.inference.evidence import NOTHING_MISSING
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.rival_causes import UNKNOWN
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.optics import slab_transmittance as slab
from mcrim_mitsuba.output.sentences import IN_NO_CATALOGUE, told_apart
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.scene.spectrophotometer import ACCEPTANCE, spectrophotometer_of

CAMPAIGN = "camoo4_three.toml"
#: Photons of a simulation with an effect, unless told otherwise: the readings' errors are 1.5 %.
PHOTONS = 32_768
#: Photons of a bench at the article's own coefficients.
_SINGLE_PHOTONS = 262_144
#: Explanations that are named.
_NAMED = 4
#: The forward scattering that comes nearest to all three numbers.
_FORWARD_G = 0.9
#: The half angle of what a sphere takes, degrees.
_SPHERE_DEG = 90.0


@dataclass(frozen=True)
class Contradiction:
    """The article's couplings and its transmittance in one fit."""

    diagnosis: Diagnosis
    #: The fit with light that is unpolarised and born everywhere.
    ignorant: Calibration
    #: Eta at the article's coefficients, by bench.
    etas: dict[str, float]

    @property
    def likeliest(self) -> Mapping[str, float]:
        """The likeliest explanations with their probabilities."""
        probabilities = dict(self.diagnosis.probabilities)
        probabilities.pop(NOTHING_MISSING, None)
        return dict(itertools.islice(probabilities.items(), _NAMED))

    @property
    def light_yields(self) -> dict[str, float]:
        """Light yields with each effect alone, ph/keV."""
        yields = {c.effect: c.light_yield_ph_per_keV for c in self.diagnosis.candidates}
        return {name: of_light["value"] for name, of_light in yields.items() if of_light}

    def title(self, explanation: str) -> str:
        """One of the `likeliest` in words."""
        titles = self.diagnosis.titles | {UNKNOWN: IN_NO_CATALOGUE}
        return " with ".join(titles.get(name, name) for name in explanation.split(" + "))


def find_contradiction(run: Run) -> Contradiction:
    """Diagnose the three numbers; errors as `diagnose`.

    Ground faces are left out: the article says that all were polished.
    """
    campaign = read_campaign(scene_path(CAMPAIGN))
    run = replace(run, photons=PHOTONS, precision=None)
    ignorant = CampaignSimulations(replace(campaign, scene=read_scene(campaign.scene.path)), run)
    ignorant.simulate()
    fitted = {ALPHA_SCAT: p.ALPHA_SCAT.value, ALPHA_ABS: p.NOMINAL.alpha_abs_per_cm.value}
    bench = campaign.scene.with_overrides(fitted)
    forward = bench.edited(add("anisotropic_scattering", bench, {"scattering_g": _FORWARD_G}))
    sphere = {**campaign.beam, ACCEPTANCE: _SPHERE_DEG}
    benches: dict[str, tuple[SceneFile, dict[str, Value]]] = {
        "sphere": (spectrophotometer_of(bench), sphere),
        "forward, sphere": (spectrophotometer_of(forward), sphere),
        "forward, air": (forward, {"n_gap": p.N_AIR.value}),
        "forward, gel": (forward, {"n_gap": p.N_GEL.value}),
    }
    of_one = replace(run, photons=_SINGLE_PHOTONS)
    etas = {what: collect_whole(*of, what, of_one).eta for what, of in benches.items()}
    ground = [name for name in campaign.catalogue if name.split("_")[0] == "ground"]
    diagnosis = diagnose(CampaignSimulations(campaign, run), without=ground)
    return Contradiction(diagnosis, ignorant.fit(), etas)


def hazy_transmittance(rms_nm: float) -> float:
    """What a spectrophotometer reads on the article's crystal if its faces alone take light.

    The bulk is clear. Of a face of the rms roughness s, exp(-(2 pi s (n - 1) / lambda)^2) of what
    passes and exp(-(4 pi s n / lambda)^2) of what is reflected inside stays in the beam (H. E.
    Bennett and J. O. Porteus, J. Opt. Soc. Am. 51 (1961) 123); all orders of reflection.
    """
    n, q_per_nm = p.N_CRYSTAL.value, 2 * math.pi / p.EMISSION_NM.value
    face = ((n - 1) / (n + 1)) ** 2
    passed = (1 - face) * math.exp(-((q_per_nm * rms_nm * (n - 1)) ** 2))
    reflected = face * math.exp(-((2 * q_per_nm * rms_nm * n) ** 2))
    return passed**2 / (1 - reflected**2)


def rows(contradiction: Contradiction) -> Iterator[ArticleRow]:
    """What one number says of the other, the misfit, and the light yield."""
    yield from _transmittance_rows(contradiction.etas)
    yield from _fit_rows(contradiction)


def _transmittance_rows(etas: Mapping[str, float]) -> Iterator[ArticleRow]:
    """The transmittance that the article's coefficients predict, beside the measured one."""
    measured = p.MEASURED_TRANSMITTANCE.value / 100
    smooth = brentq(lambda rms: hazy_transmittance(rms) - measured, 0.0, p.ROUGHNESS_NM.value)
    ratio = etas["forward, air"] / etas["forward, gel"]
    paper = p.MEASURED_TRANSMITTANCE
    what = "transmittance with the fitted alpha_scat and alpha_abs, Eqs. 3-4"
    lost = "polished faces, all scattered light lost"
    remark = f"{lost}: within 5 degrees of the beam a detector sees 0.05 % more"
    yield compare(what, paper, 100 * _predicted(), inconsistent=True, remark=remark)
    what, percent = "the same into a sphere", 100 * etas["sphere"]
    remark = "all that is scattered forward and leaves is taken"
    yield compare(what, paper, percent, inconsistent=True, remark=remark)
    what += f", scattering forward (g = {_FORWARD_G:g})"
    percent = 100 * etas["forward, sphere"]
    remark = (
        f"the nearest single rescue, at a ratio of {ratio:.3f} where {p.RATIO.text} was "
        "measured: more scattering mends this and spoils the transmittance"
    )
    yield compare(what, paper, percent, judged=False, remark=remark)
    what = f"transmittance, if {p.ROUGHNESS_NM.text} nm are the rms of the faces, Sec. 4"
    remark = f"with a clear bulk; {paper.text} % allows {smooth:.0f} nm"
    hazy = 100 * hazy_transmittance(p.ROUGHNESS_NM.value)
    yield compare(what, paper, hazy, judged=False, remark=remark)
    what = "alpha_scat + alpha_abs that the transmittance allows"
    internal = slab.internal_transmittance(measured, p.N_CRYSTAL.value)
    both = slab.absorption_coefficient(internal, p.CRYSTAL_MM.value)
    remark = "the article fits 0.54 /cm of scattering alone"
    yield compare(what, p.ALPHA_SCAT, both, inconsistent=True, remark=remark)


def _fit_rows(contradiction: Contradiction) -> Iterator[ArticleRow]:
    """The misfit of the three numbers, and the light yield that they allow."""
    diagnosis, ignorant = contradiction.diagnosis, contradiction.ignorant
    baseline, averaged = diagnosis.baseline, diagnosis.light_yield_averaged
    what = "chi2 of 14.3, 24.5 and 76 % in one fit, 1 degree of freedom"
    remark = f"{_as_pull(baseline)}; errors as in {CAMPAIGN}"
    yield compare(what, None, baseline.chi2, unit="", remark=remark)
    what = "the same, light unpolarised and born everywhere"
    yield compare(what, None, ignorant.chi2, unit="", remark=_as_pull(ignorant))
    if averaged is not None:
        what, value = "light yield, averaged over what the three numbers allow", averaged.value
        remark = (
            f"±{averaged.within:.2f} within explanations, ±{averaged.between:.2f} "
            f"between them, ±{averaged.catalogue:.2f} for what is in no catalogue; the light "
            "yields of the best four are in the sentences below"
        )
        yield compare(what, p.LIGHT_YIELD, value, sigma=averaged.sigma, judged=False, remark=remark)


def _predicted() -> float:
    """The transmittance that the article's own coefficients leave."""
    fitted = p.ALPHA_SCAT.value + p.NOMINAL.alpha_abs_per_cm.value
    internal = slab.transmittance(fitted, p.CRYSTAL_MM.value)
    return float(slab.measured_transmittance(internal, p.N_CRYSTAL.value))


def _as_pull(fit: Calibration) -> str:
    """The misfit of a fit with one degree of freedom."""
    return f"{math.sqrt(fit.chi2):.1f} standard errors, {p_equals(fit.p_value)}"


def sentences(contradiction: Contradiction) -> tuple[str, ...]:
    """The two claims, the ranking, and what one measurement would decide."""
    diagnosis, baseline = contradiction.diagnosis, contradiction.diagnosis.baseline
    ranking = []
    for name, probability in contradiction.likeliest.items():
        of_light = contradiction.light_yields.get(name)
        with_it = "" if of_light is None else f", {of_light:.1f} ph/keV with it"
        title = contradiction.title(name)
        ranking.append(f"{title}: probability {100 * probability:.2g} %{with_it}")
    nothing = 100 * diagnosis.probabilities.get(NOTHING_MISSING, 0.0)
    scat, absorption = (baseline.parameters[name].value for name in (ALPHA_SCAT, ALPHA_ABS))
    best = next((new for new in diagnosis.next_measurements if new.is_of_readings), None)
    if best is not None:
        pairs = "; ".join(told_apart(diagnosis, best)[:2])
        separated = f" ({pairs})" if pairs else ""
        ranking.append(f"one more measurement would tell most at {best.words}{separated}")
    return (
        f"the fitted {p.ALPHA_SCAT.value:g} and {p.NOMINAL.alpha_abs_per_cm.text} /cm predict a "
        f"transmittance of {100 * _predicted():.0f} %, or {100 * contradiction.etas['sphere']:.0f} "
        f"% into a sphere, where {p.MEASURED_TRANSMITTANCE.text} % was measured: that is decisive",
        f"what the transmittance allows, {scat:.2g} /cm of scattering and {absorption:.2g} /cm of "
        f"absorption, misses the two signals by {_as_pull(baseline)} (by "
        f"{_as_pull(contradiction.ignorant)}, were light unpolarised and born everywhere): that "
        "is none",
        "over this catalogue with these priors, without ground faces, for the article says that "
        f"all were polished: nothing missing, probability {nothing:.2g} %",
        *ranking,
    )
