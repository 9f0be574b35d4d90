"""The error budget of Sec. 6.3 by the campaign's fit: one likelihood for all its parts."""

from __future__ import annotations

import math
from dataclasses import replace

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article import sections
from mcrim_mitsuba.article.rows import ArticleRow, compare
from mcrim_mitsuba.article.scenes import scene_path
from mcrim_mitsuba.article.simulated import Simulated
from mcrim_mitsuba.files.campaign import Campaign, read_campaign
from mcrim_mitsuba.fit.calibration import calibrate
from mcrim_mitsuba.fit.result import LIGHT_YIELD, Calibration
from mcrim_mitsuba.fit.surface import ALPHA_ABS


def article_campaign(alpha_abs_per_cm: float, sigma_per_cm: float | None) -> Campaign:
    """The article's two readings, with a prior on the absorption; held where sigma is None."""
    campaign = read_campaign(scene_path("camoo4_campaign.toml"))
    known = replace(
        campaign.parameters[ALPHA_ABS],
        start=alpha_abs_per_cm,
        prior=None if sigma_per_cm is None else alpha_abs_per_cm,
        prior_sigma=sigma_per_cm,
        fixed=sigma_per_cm is None,
    )
    return replace(campaign, parameters={**campaign.parameters, ALPHA_ABS: known})


def fit_article(
    simulated: Simulated, alpha_abs_per_cm: float, sigma_per_cm: float | None = None
) -> Calibration:
    """Fit the article's campaign to its simulations, polarisation followed."""
    surfaces = {coupling.n_gap: coupling.surface for coupling in simulated.pair(True)}
    return calibrate(
        article_campaign(alpha_abs_per_cm, sigma_per_cm),
        lambda parameters: surfaces[float(parameters["n_gap"])],
        profile=False,
    )


def budget_rows(simulated: Simulated) -> list[ArticleRow]:
    """What makes up the error of the light yield, if Table 1's transmittances are its range."""
    absorptions = [line.alpha_abs_per_cm.value for line in p.TABLE_1]
    sigma = (max(absorptions) - min(absorptions)) / 2
    found = fit_article(simulated, p.NOMINAL.alpha_abs_per_cm.value, sigma)
    light_yield = found.parameters[LIGHT_YIELD]
    percent = {
        name: 100 * part / light_yield.value for name, part in light_yield.contributions.items()
    }
    eta = math.hypot(percent["prior"], percent["monte_carlo"])
    where = f"campaign fit, alpha_abs ± {sigma:.3f} /cm (half of Table 1's range)"
    return [
        compare(sections.LIGHT_YIELD, "error budget: eta", p.ETA_ERROR, eta, judged=False,
                remark=where),
        compare(sections.LIGHT_YIELD, "error budget: counts", None, percent["statistical"],
                unit="%", remark="with alpha_scat fitted: not the two counts' 1.6 % itself"),
        compare(sections.LIGHT_YIELD, "error budget: total", p.TOTAL_ERROR,
                100 * light_yield.sigma / light_yield.value, judged=False,
                remark="eta, counts and detector efficiency, one covariance"),
    ]  # fmt: skip
