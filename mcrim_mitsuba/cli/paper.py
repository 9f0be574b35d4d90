"""``mcrim paper``: every number of the article beside ours."""

from __future__ import annotations

from collections.abc import Iterable

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.cli.terminal import Screen
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.output.described import table


@click.command()
@click.option("-o", "--output", "folder", default="mcrim_paper", show_default=True,
              metavar="FOLDER", help="Where the figures go: PNG, PDF and CSV.")  # fmt: skip
@click.option("--photons", type=options.PhotonCount(), metavar="COUNT",
              help="Photons of each of four efficiency surfaces (default: 8e6); "
              "single configurations get a tenth.")  # fmt: skip
@options.work
def paper(folder, json_file, work) -> None:
    """Reproduce the article behind the method: its numbers beside ours, and its figures.

    That is V. Alenkov et al., JINST 8 (2013) P06002, with Figs. 3 and 4, and Fig. 2 from
    synthetic histograms. Units are the article's: mm, 1/cm, %, keV, photons per keV.
    """
    from mcrim_mitsuba.article.published import RULE
    from mcrim_mitsuba.article.reproduce import MONTE_CARLO, reproduce_article
    from mcrim_mitsuba.core.files import make_folder

    # before a minute of simulation, not after it
    make_folder(folder)
    refuse_outputs({"--json": json_file})
    with work.begin() as run:
        result = reproduce_article(run=run)
    figures = result.draw(folder)
    terminal.write_json(
        json_file,
        {
            "rows": result.rows,
            "verdict_rule": RULE,
            "monte_carlo_errors": MONTE_CARLO,
            "agreement": result.agreement,
            "inconsistencies": result.inconsistencies,
            "open_points": result.open_points,
            "light_yield_ph_per_keV": {
                "value": result.yields.fitted.value,
                "statistical": result.yields.fitted.statistical_sigma,
                "systematic": result.yields.fitted.systematic_sigma,
            },
            "figures": figures,
            "photons": result.photons,
            "seed": result.seed,
            "seconds": result.seconds,
            "versions": result.versions,
            "scene_hashes": result.scene_hashes,
        },
    )
    screen = terminal.console(json_file)
    _show_rows(screen, result.rows)
    _show_summary(screen, result, folder)


def _show_rows(screen: Screen, rows) -> None:
    from mcrim_mitsuba.article.published import RULE
    from mcrim_mitsuba.article.reproduce import MONTE_CARLO

    screen.line(f"Verdicts. {RULE}")
    screen.line(MONTE_CARLO)
    screen.line("Errors of ours: statistical, then systematic where there is one.")
    for section in dict.fromkeys(row.section for row in rows):
        shown = [row for row in rows if row.section == section]
        cells = (
            (
                f"{row.quantity} ({row.unit})" if row.unit else row.quantity,
                row.paper_text or "-", _ours(row), row.verdict,
            )
            for row in shown
        )  # fmt: skip
        screen.print()
        screen.show(table(section, ("quantity", "article", "ours", "verdict"), cells))
        for row in shown:
            if row.remark:
                screen.line(f"  {row.quantity}: {row.remark}.")


def _ours(row) -> str:
    """Our value with its errors, in digits that the statistical one deserves."""
    from mcrim_mitsuba.core.rounding import pdg

    if row.ours is None:
        return "-"
    if not row.sigma:
        return f"{row.ours:,.0f}" if row.ours >= 1e4 else f"{row.ours:.4g}"
    text = pdg(row.ours, row.sigma)
    if row.systematic:
        decimals = len(text.rpartition(".")[2])
        text += f" ± {row.systematic:.{decimals}f}"
    return text


def _show_summary(screen: Screen, result, folder: str) -> None:
    from mcrim_mitsuba.article.published import AGREES, DIFFERS, INCONSISTENT

    fitted = result.yields.fitted
    counts = {
        name: sum(row.verdict == name for row in result.rows)
        for name in (AGREES, DIFFERS, INCONSISTENT)
    }
    screen.print()
    screen.line(
        f"Light yield of CaMoO4: {fitted.value:.2f} ± {fitted.statistical_sigma:.2f} (statistical) "
        f"± {fitted.systematic_sigma:.2f} (systematic) ph/keV; the article: 7.5 ± 1.2.",
        style="bold",
    )
    _list(screen, "", result.agreement)
    screen.line("Verdicts: " + ", ".join(f"{count} {name}" for name, count in counts.items()))
    _list(
        screen, "Numbers of ours that differ:",
        [f"{row.quantity}: {row.paper_text} against {_ours(row)} {row.unit}".rstrip()
         for row in result.rows if row.verdict == DIFFERS],
    )  # fmt: skip
    _list(screen, "The article disagrees with itself:", result.inconsistencies)
    _list(screen, "The article leaves open, or we find otherwise:", result.open_points)
    screen.print()
    screen.line(
        f"{result.photons:,} photons per surface, seed {result.seed}, {result.seconds:.0f} s. "
        f"Figs. 2, 3 and 4 are in {folder} (PNG, PDF, CSV).",
    )


def _list(screen: Screen, title: str, lines: Iterable[str]) -> None:
    if title:
        screen.print()
        screen.line(title, style="bold")
    for line in lines:
        screen.line(f"- {line}")
