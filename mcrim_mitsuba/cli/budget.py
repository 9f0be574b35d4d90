"""``mcrim budget``: where all errors come from, and what the model leaves out."""

from __future__ import annotations

import math
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.rounding import pdg_parts

#: Smaller errors of shifts, in per cent, need no digits.
_LEAST_PERCENT = 0.001


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("--material", metavar="NAME",
              help="What the crystal is made of, such as CaMoO4 (default: what the campaign says): "
              "its indices, and how it stops gammas, are then known.")  # fmt: skip
@click.option("--emission", metavar="FILE",
              help="Emission spectrum (default: the campaign's, else a Gaussian band).",
)  # fmt: skip
@click.option("--wavelength-nm", type=options.Number(200, 2000), metavar="NM",
              help="Maximum of that Gaussian band (default: the material's).")  # fmt: skip
@options.figure("the budget, with what the model leaves out")
@options.photons("5e5 of each simulation with another index, fewer for many configurations",
                 further=showing.FURTHER_PHOTONS)  # fmt: skip
@options.seed
@options.machine
@work_options
@options.json_output
def budget(
    campaign,
    material,
    emission,
    wavelength_nm,
    figure,
    photons,
    seed,
    variant,
    threads,
    json_file,
    work,
) -> None:
    """Show where the errors of CAMPAIGN (TOML) come from, and which can be reduced.

    The fit is repeated with every piece of physics that the model leaves out: where the source's
    gammas stop, polarisation, the index of the material, its spread over the emission band, and
    birefringence. What the model can take is a correction, to be made; what one index cannot
    describe is added to the errors.
    """
    from mcrim_mitsuba.inference.budget import budget as run

    showing.refuse_places(json_file, [campaign], figure)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, [*files, *([emission] if emission else [])], figure)
    with work.begin() as report:
        found = run(
            read, material=material, emission=emission, wavelength_nm=wavelength_nm,
            photons=photons, seed=seed, variant=variant, threads=threads, progress=report,
        )  # fmt: skip
    notes = (*found.calibration.notes, *found.provenance.notes)
    terminal.write_json(
        json_file, found.to_json() | showing.provenance_json(found.provenance, notes)
    )
    drawn: tuple[Path, ...] = ()
    if figure:
        from mcrim_mitsuba.output.budget_figures import draw_neglected

        drawn = draw_neglected(figure, found)
    screen = terminal.console(json_file)
    _show_contributions(screen, found)
    _show_shifts(screen, found)
    _show_totals(screen, found)
    showing.say_drawn(screen, drawn)
    showing.say_spent(screen, found.provenance)
    screen.say_notes(notes)


def _show_contributions(screen, found) -> None:
    """Contributions in per cent of every quantity, and what would reduce them."""
    from mcrim_mitsuba.cli.showing import budget_table

    budgets = {name: found.contributions[name] for name in found.main if name in found.totals}
    if budgets:
        screen.print(budget_table("where the errors come from, in the model as it is", budgets))


def _show_shifts(screen, found) -> None:
    """What every piece does, at fixed coefficients and refitted."""
    for kind, how in (
        ("at_fixed", "at the coefficients that were fitted"),
        ("refitted", "with everything fitted again"),
    ):
        if not found.pieces:
            break
        moved = getattr(found.pieces[0], kind)
        # fitted again, the ratio is that of the readings
        names = [n for n in moved if n in found.main or (kind == "at_fixed" and " / " in n)]
        table = _folding(
            terminal.table(f"what the model leaves out would move, %, {how}", "left out", *names)
        )
        for piece in found.pieces:
            cells = [_percent(getattr(piece, kind)[name]) for name in names]
            style = "bold" if piece is found.together else ""
            terminal.add_literal_row(table, piece.title, *cells, style=style)
        screen.print(table)
    if found.pieces:
        screen.line(
            "Errors: of the simulation, by the differences of its batches with and without; then "
            "of the size of what was put in."
        )
    for piece in found.neglected:
        kind = "a correction" if piece.correction else "a systematic error"
        screen.line(f"- {piece.title}, {kind}: {piece.put_in}. What helps: {piece.mend}.")
    for name, reason in found.not_estimated.items():
        screen.line(f"- not put in: {name.replace('_', ' ')}: {reason}")


def _percent(shift) -> str:
    """``-4.62 ± 0.08 ± 0.05``: a shift in per cent with its errors."""
    percent = 100 / abs(shift.before)
    sigmas = [shift.monte_carlo_sigma, *([shift.size_sigma] if shift.size_sigma else [])]
    rounded = [max(percent * sigma, _LEAST_PERCENT) for sigma in sigmas]
    text = pdg_parts(percent * shift.shift, *rounded)
    return text if text.startswith("-") else f"+{text}"


def _show_totals(screen, found) -> None:
    """The values as they are, and as they ought to be."""
    if not found.totals:
        return
    corrected = found.together is not None
    columns = ["and what is left out for good", *(["corrected"] if corrected else [])]
    table = terminal.table("results, with all errors", "quantity", "as fitted", *columns)
    for name in found.main:
        total = found.totals[name]
        cells = [_two_digits(total.value, sigma)
                 for sigma in (total.sigma, total.sigma_with_neglected)]  # fmt: skip
        if corrected:
            cells.append(_two_digits(total.corrected, total.corrected_sigma))
        terminal.add_literal_row(table, name, *cells)
    screen.print(table)
    if corrected:
        screen.line(
            "A correction is no error: make it in the scene or the campaign. The errors of "
            "corrected values have those of the corrections' sizes in them."
        )


def _two_digits(value: float, sigma: float) -> str:
    """Two digits of the error, so that a correction smaller than it is seen."""
    places = max(1 - math.floor(math.log10(sigma)), 0)
    return f"{value:.{places}f} ± {sigma:.{places}f}"


def _folding(table):
    """The table, with cells that go on in the next line rather than being cut."""
    for column in table.columns:
        column.overflow = "fold"
    return table
