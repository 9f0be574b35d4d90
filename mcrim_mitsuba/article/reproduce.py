"""The article from beginning to end: simulate, compare, judge."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.article import arithmetic, efficiency_rows, yield_rows
from mcrim_mitsuba.article import arithmetic as inconsistencies
from mcrim_mitsuba.article.efficiency_rows import FittedLine, fit_table_1
from mcrim_mitsuba.article.figures import draw_figures
from mcrim_mitsuba.article.published import ORDER, ArticleRow
from mcrim_mitsuba.article.simulated import (
    DEFAULT_PHOTONS,
    EtaCurve,
    RatioCurve,
    Simulated,
    eta_curves,
    ratio_curves,
    simulate_article,
)
from mcrim_mitsuba.article.yield_rows import LightYields, agreement_sentences, light_yields
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.neglected import Neglected

#: How the Monte Carlo errors come about.
MONTE_CARLO = (
    "Monte Carlo errors: the spread between independent batches of photons, propagated. The "
    "couplings have seeds of their own, so their errors are independent."
)


@dataclass(frozen=True)
class ArticleResult:
    """Every number of the article beside ours."""

    #: In the order of the article.
    rows: tuple[ArticleRow, ...]
    #: Our Table 1: with polarisation, then without.
    fits: tuple[FittedLine, ...]
    yields: LightYields
    #: Whether couplings and methods give one light yield.
    agreement: tuple[str, ...]
    #: Where the article disagrees with itself.
    inconsistencies: tuple[str, ...]
    #: What it leaves open, and where we differ.
    open_points: tuple[str, ...]
    #: Those of Figs. 3 and 4.
    eta_curves: tuple[EtaCurve, ...]
    ratio_curves: tuple[RatioCurve, ...]
    #: Photons of each of the four surfaces.
    photons: int
    seed: int
    #: Wall time.
    seconds: float
    versions: dict[str, str]
    #: SHA-256 per scene file.
    scene_hashes: dict[str, str]

    def draw(self, folder: str | Path) -> tuple[Path, ...]:
        """Write Figs. 2 to 4 as PNG, PDF and CSV; see `figures.draw_figures`."""
        polarised = [fit for fit in self.fits if fit.polarised]
        return draw_figures(folder, self.eta_curves, self.ratio_curves, polarised)


def reproduce_article(*, run: Run = Run()) -> ArticleResult:
    """Compute every number of V. Alenkov et al., JINST 8 (2013) P06002.

    Parameters and errors as `simulated.simulate_article`; about 40 s on two cores.

    Examples
    --------
    >>> result = reproduce_article(run=Run(photons=1_000_000))
    >>> figures = result.draw("mcrim_paper")
    """
    start = time.perf_counter()
    photons = run.photons_or(DEFAULT_PHOTONS)
    simulated = simulate_article(run=run)
    left_out = yield_rows.left_out(run)
    curves = eta_curves(simulated, run.threads)
    ratios = ratio_curves(curves)
    fits = fit_table_1(ratios)
    yields = light_yields(simulated, fits)
    return ArticleResult(
        rows=_rows(simulated, fits, yields, left_out, photons),
        fits=(*fits[True], *fits[False]),
        yields=yields,
        agreement=agreement_sentences(yields),
        inconsistencies=inconsistencies.inconsistencies(),
        open_points=inconsistencies.open_points(simulated),
        eta_curves=curves,
        ratio_curves=ratios,
        photons=photons,
        seed=run.seed,
        seconds=time.perf_counter() - start,
        versions=simulated.versions,
        scene_hashes=simulated.scene_hashes,
    )


def _rows(
    simulated: Simulated,
    fits: efficiency_rows.Fits,
    yields: LightYields,
    left_out: tuple[Neglected, ...],
    photons: int,
) -> tuple[ArticleRow, ...]:
    rows = [
        *arithmetic.transmittance_rows(),
        *arithmetic.bare_crystal_rows(),
        *efficiency_rows.bare_crystal_rows(simulated),
        *efficiency_rows.bench_rows(simulated, photons),
        *arithmetic.ratio_rows(),
        *efficiency_rows.table_1_rows(fits),
        *efficiency_rows.efficiency_rows(simulated, fits),
        *efficiency_rows.other_crystal_rows(simulated),
        *arithmetic.light_yield_rows(),
        *arithmetic.relative_rows(),
        *yield_rows.yield_rows(yields),
        *yield_rows.budget_rows(simulated),
        *yield_rows.neglected_rows(left_out),
        *arithmetic.table_2_rows(),
        yield_rows.wrapped_yield_row(simulated),
        *arithmetic.quoted_rows(),
    ]
    return tuple(sorted(rows, key=lambda row: ORDER.index(row.section)))
