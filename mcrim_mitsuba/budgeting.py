"""The whole error budget of a campaign, and what its model leaves out."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcrim_mitsuba.diagnosing import Provenance
from mcrim_mitsuba.files.campaign import Campaign, read_campaign
from mcrim_mitsuba.fit import Calibration
from mcrim_mitsuba.neglect.contributions import contributions_to, totals
from mcrim_mitsuba.neglect.crystal import KnownCrystal
from mcrim_mitsuba.neglect.quantities import fitted
from mcrim_mitsuba.neglect.result import Neglected, Total
from mcrim_mitsuba.neglect.work import NeglectWork
from mcrim_mitsuba.physics.error_budget import ErrorBudget
from mcrim_mitsuba.recording import DEFAULT_VARIANT, RunOptions
from mcrim_mitsuba.work import Progress

#: Photons of a simulation with another index, shared out among the configurations, and the fewest
#: of each. Simulations with one index get `responses.PLAIN_FACTOR` times as many.
DEFAULT_PHOTONS, FEWEST_PHOTONS = 1_048_576, 131_072


@dataclass(frozen=True, eq=False)
class Budget:
    """Where the errors of a campaign's results come from.

    Quantities have the names of `neglect.quantities.Quantities`: the light yield (the scale
    without one), fitted parameters, efficiencies, and the ratio of two of them.

    Attributes
    ----------
    calibration : Calibration
        The campaign's own fit.
    main : tuple of str
        Quantities that tables and figures show: the first two efficiencies, parameters without a
        prior, the light yield last.
    contributions : dict of str to ErrorBudget
        By quantity; none where a parameter ended at its bound.
    neglected : tuple of Neglected
        Pieces of physics that the model leaves out, corrections first.
    together : Neglected or None
        All corrections at once; None where there is none.
    totals : dict of str to Total
        By quantity.
    not_estimated : dict of str to str
        Pieces that were not put in, and why.
    provenance : Provenance
    """

    calibration: Calibration
    main: tuple[str, ...]
    contributions: dict[str, ErrorBudget]
    neglected: tuple[Neglected, ...]
    together: Neglected | None
    totals: dict[str, Total]
    not_estimated: dict[str, str]
    provenance: Provenance

    @property
    def pieces(self) -> tuple[Neglected, ...]:
        """`neglected`, and `together` last where there are several corrections."""
        if self.together is None or sum(piece.correction for piece in self.neglected) < 2:
            return self.neglected
        return (*self.neglected, self.together)

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts; `provenance` apart."""
        return {
            "calibration": self.calibration.to_json(),
            "contributions": {
                name: {"total": each.total, "contributions": list(map(vars, each.contributions))}
                for name, each in self.contributions.items()
            },
            "neglected": [_plain(piece) for piece in self.neglected],
            "together": self.together and _plain(self.together),
            "totals": {
                name: vars(total) | {"sigma_with_neglected": total.sigma_with_neglected}
                for name, total in self.totals.items()
            },
            "not_estimated": self.not_estimated,
        }


def _plain(piece: Neglected) -> dict[str, Any]:
    """A piece with its shifts spelled out."""
    found = dataclasses.asdict(piece)
    for kind in ("at_fixed", "refitted"):
        for name, moved in getattr(piece, kind).items():
            found[kind][name] |= {"shift": moved.shift, "relative": moved.relative}
    return found


def budget(
    campaign: str | Path | Campaign,
    *,
    material: str | None = None,
    emission: str | Path | None = None,
    wavelength_nm: float | None = None,
    photons: int | None = None,
    seed: int = 0,
    variant: str = DEFAULT_VARIANT,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Budget:
    """Fit a campaign, and fit it again with every piece of physics that it leaves out.

    The pieces: where the source's gammas stop, polarisation, the crystal's index at its emission,
    the spread of the index over the band, and birefringence. A campaign that has one of them
    already is not given it again.

    Parameters
    ----------
    campaign : str, Path or Campaign
    material : str, optional
        What the crystal is made of, as the catalogue of materials names it. Where neither this
        nor the campaign tells, nothing is known of indices and depth.
    emission : str or Path, optional
        File with the emission spectrum; without it the campaign's own, else a Gaussian band.
    wavelength_nm : float, optional
        Maximum of that band.
    photons : int, optional
        Of every configuration's simulation with another index; those with the scene's own get
        nine times as many.
    seed : int
        The same for all simulations: what they have in common cancels in the shifts.
    variant : str
        Mitsuba variant.
    threads : int, optional
        Processor threads; all when not given.
    progress : callable, optional
        See `work.Progress`.

    Raises
    ------
    InputError
        If a file is wrong, a scene is not sound, the readings do not determine the parameters, or
        the material or its band is not known.
    """
    start = time.perf_counter()
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(campaign)
    known = KnownCrystal.of(campaign, material, emission, wavelength_nm)
    options = RunOptions(seed, variant, threads)
    configurations = {tuple(r.parameters.items()) for r in campaign.measurements.readings}
    each = photons or max(DEFAULT_PHOTONS // len(configurations), FEWEST_PHOTONS)
    work = NeglectWork(campaign, known, options, each, progress)
    model, found = work.bench.settled_model()
    own = fitted(model, found)
    contributions = contributions_to(model, found, own)
    neglected = work.neglected()
    return Budget(
        calibration=found,
        main=own.main(campaign.priors),
        contributions=contributions,
        neglected=neglected,
        together=work.together(neglected),
        totals=totals(own, contributions, neglected, work.corrected),
        not_estimated=work.refused,
        provenance=replace(work.provenance(), seconds=time.perf_counter() - start),
    )
