"""Calibrate a campaign: simulate its configurations, then fit its readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign, read_campaign
from mcrim_mitsuba.fit import Calibration
from mcrim_mitsuba.fit import calibrate as fit_campaign
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT, Surface

DEFAULT_PHOTONS = 4_000_000
#: Photons per configuration of the first look, which shows where the fit will end.
PILOT_PHOTONS = 300_000
#: Range of alpha_scat (1/cm) that the first look covers, within the campaign's bounds.
PILOT_RANGE_PER_CM = (0.02, 8.0)
#: The second look covers the first solution times and over this, and 4 standard errors.
REACH = 3.0


@dataclass(frozen=True)
class CampaignResult:
    """A calibration with what it took.

    Attributes
    ----------
    calibration : Calibration
    photons : int
        Photons spent, over all configurations.
    configurations : int
    seed : int
    scene_hash : str
    versions : dict of str to str
    """

    calibration: Calibration
    photons: int
    configurations: int
    seed: int
    scene_hash: str
    versions: dict[str, str]


def calibrate(
    campaign: str | Path | Campaign,
    *,
    photons: int = DEFAULT_PHOTONS,
    seed: int = 0,
    variant: str = "llvm_ad_rgb",
    threads: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> CampaignResult:
    """Fit a campaign's readings, and with them the light yield.

    Every configuration is simulated twice: a short look over the whole range of alpha_scat, and a
    long one over the part where the first fit ended.

    Parameters
    ----------
    campaign : str, Path or Campaign
    photons : int
        Per configuration.
    seed : int
    progress : callable, optional
        ``progress(what, done, total)``.

    Raises
    ------
    InputError
        If a file is wrong, a configuration's scene is not sound, or the readings do not
        determine the parameters.
    """
    from mcrim_mitsuba.kernel.simulation import versions

    if not isinstance(campaign, Campaign):
        campaign = read_campaign(campaign)
    for name in (ALPHA_SCAT, ALPHA_ABS):
        if name not in campaign.scene.parameters:
            raise InputError(
                f"the scene has no parameter {name}", "declare it as a <default> of the crystal",
                path=campaign.scene.path,
            )  # fmt: skip
    work = _Simulations(campaign, seed, variant, threads, progress)
    pilot = fit_campaign(campaign, work.surfaces(PILOT_PHOTONS, _pilot_range(campaign)),
                         profile=False)  # fmt: skip
    work.checked = True
    found = fit_campaign(campaign, work.surfaces(photons, _final_range(campaign, pilot)))
    return CampaignResult(
        calibration=found,
        photons=work.photons,
        configurations=work.configurations,
        seed=seed,
        scene_hash=campaign.scene.content_hash,
        versions=versions(variant),
    )


class _Simulations:
    """Makes the surfaces that the fit asks for, and counts what they cost."""

    def __init__(self, campaign, seed, variant, threads, progress) -> None:
        self.campaign = campaign
        self.seed = seed
        self.options = {"variant": variant, "threads": threads}
        self.progress = progress
        self.photons = 0
        self.configurations = 0
        self.checked = False

    def surfaces(self, photons: int, alpha_scat_range_per_cm: tuple[float, float]):
        """A maker of surfaces: every call is one configuration with random numbers of its own."""
        self.configurations = 0

        def make(parameters: Mapping[str, object]) -> Surface:
            from mcrim_mitsuba.kernel.records import collect_surface
            from mcrim_mitsuba.kernel.simulation import Simulation

            simulation = Simulation(
                self.campaign.scene, parameters, check=not self.checked, **self.options
            )
            self.configurations += 1
            self.photons += photons
            what = f"configuration {self.configurations}"
            report = self.progress
            return collect_surface(
                simulation,
                photons=photons,
                # far apart, so that configurations are statistically independent
                seed=self.seed + 1_000_003 * self.configurations + (7 if self.checked else 0),
                alpha_scat_range_per_cm=alpha_scat_range_per_cm,
                lowest_alpha_abs_per_cm=_lowest_absorption(self.campaign),
                progress=report and (lambda done, total, *_: report(what, done, total)),
            )

        return make


def _pilot_range(campaign: Campaign) -> tuple[float, float]:
    known = campaign.parameters.get(ALPHA_SCAT)
    if known is None or known.fixed:
        value = campaign.scene.parameters[ALPHA_SCAT] if known is None else known.start
        return value / 1.5, value * 1.5
    low, high = PILOT_RANGE_PER_CM
    return max(low, known.minimum), min(high, known.maximum)


def _final_range(campaign: Campaign, pilot: Calibration) -> tuple[float, float]:
    if ALPHA_SCAT not in pilot.parameters:
        return _pilot_range(campaign)
    found = pilot.parameters[ALPHA_SCAT]
    known = campaign.parameters[ALPHA_SCAT]
    low = min(found.value / REACH, max(found.value - 4 * found.sigma, found.value / 20))
    high = max(found.value * REACH, min(found.value + 4 * found.sigma, found.value * 20))
    return max(low, known.minimum), min(high, known.maximum)


def _lowest_absorption(campaign: Campaign) -> float:
    """Below most of what the fit will ask for; weights reach a little further."""
    known = campaign.parameters.get(ALPHA_ABS)
    if known is None or known.fixed:
        return campaign.scene.parameters[ALPHA_ABS] if known is None else known.start
    if known.prior is not None:
        return max(known.minimum, known.prior - 3 * known.prior_sigma, 0.1 * known.prior, 0.0)
    return max(known.minimum, 0.1 * known.start)
