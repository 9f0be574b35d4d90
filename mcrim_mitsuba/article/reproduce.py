"""The article from beginning to end: simulate, compare, judge, and show."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcrim_mitsuba.article import arithmetic, contradiction, efficiency_rows, yield_rows
from mcrim_mitsuba.article.contradiction import Contradiction, find_contradiction
from mcrim_mitsuba.article.figures import draw_figures
from mcrim_mitsuba.article.published import AGREES, DIFFERS, INCONSISTENT, RULE, ArticleRow
from mcrim_mitsuba.article.simulated import (
    DEFAULT_PHOTONS,
    Simulated,
    SimulatedLine,
    simulate_article,
)
from mcrim_mitsuba.article.yield_rows import LightYields, agreement_sentences, light_yields
from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.corrections import Neglected
from mcrim_mitsuba.output.description import Column, Description, Part, Sentence, listed, records

SAYS = "What the article's own transmittance says"
#: How the Monte Carlo errors come about.
MONTE_CARLO = (
    "Monte Carlo errors: the spread between independent batches of photons, propagated. The "
    "couplings draw the same random numbers, so a part of their errors cancels in R."
)


@dataclass(frozen=True, kw_only=True)
class ArticleResult:
    """Every number of the article beside ours."""

    #: In the order of the article.
    rows: tuple[ArticleRow, ...]
    #: Our Table 1, and the curves of Figs. 3 and 4: with polarisation, then without.
    lines: tuple[SimulatedLine, ...]
    yields: LightYields
    #: What its three numbers for one crystal say together.
    contradiction: Contradiction
    #: Whether couplings and methods give one light yield.
    agreement: tuple[str, ...]
    #: Where the article disagrees with itself.
    inconsistencies: tuple[str, ...]
    #: What it leaves open, and where we differ.
    open_points: tuple[str, ...]
    #: Photons of each of the four surfaces.
    photons: int
    seed: int
    #: Wall time.
    seconds: float
    versions: dict[str, str]
    #: SHA-256 per scene file.
    scene_hashes: dict[str, str]

    def draw(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the figures as PNG, PDF and CSV; see `figures.draw_figures`."""
        return draw_figures(folder, self.lines, self.contradiction)


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
    yields = light_yields(simulated)
    contradicted = find_contradiction(run)
    return ArticleResult(
        rows=_rows(simulated, yields, left_out, contradicted, photons),
        contradiction=contradicted,
        lines=simulated.lines,
        yields=yields,
        agreement=agreement_sentences(yields),
        inconsistencies=arithmetic.inconsistencies(),
        open_points=arithmetic.open_points(simulated),
        photons=photons,
        seed=run.seed,
        seconds=time.perf_counter() - start,
        versions=dict(simulated.thin.versions),
        scene_hashes=simulated.scene_hashes,
    )


def _rows(
    simulated: Simulated,
    yields: LightYields,
    left_out: tuple[Neglected, ...],
    contradicted: Contradiction,
    photons: int,
) -> tuple[ArticleRow, ...]:
    """All rows under the article's sections."""
    bare = [*arithmetic.bare_crystal_rows(), *efficiency_rows.bare_crystal_rows(simulated)]
    bench = efficiency_rows.bench_rows(simulated, photons)
    table_1 = efficiency_rows.table_1_rows(simulated)
    efficiencies = efficiency_rows.efficiency_rows(simulated)
    absolute = [*arithmetic.light_yield_rows(), *yield_rows.yield_rows(yields)]
    absolute += [*yield_rows.budget_rows(simulated), *yield_rows.neglected_rows(left_out)]
    relative = [*arithmetic.relative_rows(), yield_rows.relative_yield_row(yields)]
    others = [*arithmetic.table_2_rows(), yield_rows.wrapped_yield_row(simulated)]
    sections: dict[str, Iterable[ArticleRow]] = {
        "Sec. 3-4, Eq. 4: transmittance and absorption": arithmetic.transmittance_rows(),
        "Sec. 5, Eq. 6: light that leaves a bare crystal": bare,
        "Sec. 4-5: the bench, as the article states it and as the scene has it": bench,
        "Sec. 6.1-6.2, Eq. 5: the measured ratio": arithmetic.ratio_rows(),
        "Sec. 6.2-6.3, Table 1 and Fig. 4: scattering coefficient from the ratio": table_1,
        "Sec. 6.2-6.3, Table 1 and Fig. 3: light collection efficiency": efficiencies,
        "Sec. 6.2, 6.4, 6.5: other crystals": efficiency_rows.other_crystal_rows(simulated),
        "Sec. 6.3, Eqs. 1-2: absolute light yield": absolute,
        "Sec. 6.4, Eq. 7: relative method": relative,
        "Sec. 6.5, Table 2: other measurements": others,
        SAYS: contradiction.rows(contradicted),
        "Quoted or measured by the article, and used or kept as they are": arithmetic.quoted_rows(),
    }
    return tuple(replace(row, section=name) for name, rows in sections.items() for row in rows)


# How it is shown and written; see `output.description`.


def document_of(result: ArticleResult, figures: Iterable[Path]) -> dict[str, Any]:
    """What ``--json`` writes."""
    errors = "statistical=statistical_sigma systematic=systematic_sigma"
    weighed = attributes(result.contradiction.diagnosis, "probabilities light_yield_averaged")
    return {
        "rows": result.rows,
        "verdict_rule": RULE,
        "monte_carlo_errors": MONTE_CARLO,
        **attributes(result, "agreement inconsistencies open_points"),
        "light_yield_ph_per_keV": attributes(result.yields.fitted, f"value {errors}"),
        "transmittance": {"sentences": contradiction.sentences(result.contradiction), **weighed},
        "figures": figures,
        **attributes(result, "photons seed seconds versions scene_hashes"),
    }


def described(result: ArticleResult, folder: str) -> Description:
    """Every number beside ours, section by section, and what follows; figures are in `folder`."""
    fitted, verdicts = result.yields.fitted, [row.verdict for row in result.rows]
    counts = (f"{verdicts.count(name)} {name}" for name in (AGREES, DIFFERS, INCONSISTENT))
    differ = (
        f"{row.quantity}: {row.paper_text} against {_ours(row)} {row.unit}".rstrip()
        for row in result.rows
        if row.verdict == DIFFERS
    )
    lists = {
        "Numbers of ours that differ:": differ,
        f"{SAYS}:": contradiction.sentences(result.contradiction),
        "The article disagrees with itself:": result.inconsistencies,
        "The article leaves open, or we find otherwise:": result.open_points,
    }
    light_yield = (
        f"Light yield of CaMoO4: {fitted.value:.2f} ± {fitted.statistical_sigma:.2f} (statistical) "
        f"± {fitted.systematic_sigma:.2f} (systematic) ph/keV; the article: 7.5 ± 1.2."
    )
    parts = (
        Sentence(f"Verdicts. {RULE}"),
        Sentence(MONTE_CARLO),
        Sentence("Errors of ours: statistical, then systematic where there is one."),
        *_tables(result.rows),
        Sentence(""),
        Sentence(light_yield, strong=True),
        *listed(result.agreement),
        Sentence(f"Verdicts: {', '.join(counts)}"),
        *(part for head, of_it in lists.items() for part in (Sentence(""), *listed(of_it, head))),
        Sentence(""),
    )
    spent = (
        f"{result.photons:,} photons per surface, seed {result.seed}, {result.seconds:.0f} s. "
        f"Figs. 2, 3 and 4, and one of the transmittance, are in {folder} (PNG, PDF, CSV)."
    )
    return Description("the article, number by number", parts, spent)


def _tables(rows: tuple[ArticleRow, ...]) -> Iterator[Part]:
    """A table for each section of the article, its remarks below it."""
    for section in dict.fromkeys(row.section for row in rows):
        shown = [row for row in rows if row.section == section]
        yield Sentence("")
        yield records(section, _COLUMNS, shown)
        yield from (Sentence(f"  {row.quantity}: {row.remark}.") for row in shown if row.remark)


def _ours(row: ArticleRow) -> str:
    """Our value with its errors, in digits that the statistical one deserves."""
    if row.ours is None:
        return "-"
    if not row.sigma:
        return f"{row.ours:,.0f}" if row.ours >= 1e4 else f"{row.ours:.4g}"
    text = pdg(row.ours, row.sigma)
    if row.systematic:
        decimals = len(text.rpartition(".")[2])
        text += f" ± {row.systematic:.{decimals}f}"
    return text


_COLUMNS = (
    Column("quantity", of=lambda row: f"{row.quantity} ({row.unit})" if row.unit else row.quantity),
    Column("article", of=lambda row: row.paper_text or "-"),
    Column("ours", of=_ours),
    Column("verdict"),
)
