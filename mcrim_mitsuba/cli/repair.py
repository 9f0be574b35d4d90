"""``mcrim repair``: add what is missing, and see the error fall."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from rich.table import Table

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.cli.terminal import add_literal_row
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.rounding import number, p_text
from mcrim_mitsuba.output.findings import (
    ACCEPTABLE_P,
    estimate_text,
    headline,
    light_yield_text,
    together,
)


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("-o", "--output", "path", metavar="NEW.toml", required=True,
              help="The mended campaign; its scene is written beside it, as NEW.xml. Never "
              "replaces a file.")  # fmt: skip
@options.figure("how the error falls (and readings and pulls before and after, NAME_readings)")
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@work_options
@options.json_output
def repair(campaign, path, figure, photons, seed, variant, threads, json_file, work) -> None:
    """Add effects to CAMPAIGN (TOML) one by one while the data justify it.

    Writes a campaign and a scene with the effects in them, to go on from.
    """
    from mcrim_mitsuba.inference.repair import repair as run

    figures = (figure, showing.further_picture(figure, "readings"))
    written = _written(path)
    showing.refuse_places(json_file, [campaign], *figures, further=written)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, files, *figures, further=written)
    showing.refuse_to_replace(written)
    screen = terminal.console(json_file)
    # a table that grows in a terminal, lines elsewhere
    live = sys.stdout.isatty() and sys.stderr.isatty() and not screen.quiet
    steps = _step_table()

    def show(step) -> None:
        _add_step(steps, step)
        if not live:
            screen.line(_step_text(step))

    with work.begin(steps if live else None) as report:
        found = run(
            read, path, photons=photons, seed=seed, variant=variant, threads=threads,
            progress=report, on_step=show,
        )  # fmt: skip
    diagnosis = found.diagnosed.diagnosis
    notes = (*found.calibration.notes, *found.provenance.notes)
    terminal.write_json(
        json_file,
        showing.diagnosis_json(found.diagnosed)
        | {
            "effects": found.effects,
            "calibration": found.calibration.to_json(),
            "campaign": found.campaign_path,
            "scene": found.scene_path,
        }
        | showing.provenance_json(found.provenance, notes),
    )
    drawn = _draw(figures, found) if figure else ()
    if live:
        screen.print(steps)
    screen.line(headline(diagnosis), style="bold")
    showing.show_suspects(screen, diagnosis.suspect_readings)
    if found.effects:
        _show_mended(screen, found)
    else:
        screen.line("Nothing was added, and no file written.", style="bold")
    showing.say_drawn(screen, drawn)
    showing.say_spent(screen, found.provenance)
    screen.say_notes(notes)
    if found.campaign_path is not None:
        screen.line(
            f"{found.campaign_path} and {found.scene_path} were written. "
            f"Next: {showing.command('calibrate', found.campaign_path)}",
            style="bold",
        )
    else:
        screen.line(f"Next: {showing.command('diagnose', campaign)} says more", style="bold")


def _written(path: str) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Files of ``--output``, with the suffixes that they may have."""
    target = Path(path)
    scene = target.parent / f"{target.stem}.xml"
    return {"--output": (path, (".toml",)), "the scene of --output": (str(scene), (".xml",))}


def _draw(figures, found) -> tuple[Path, ...]:
    from mcrim_mitsuba.output.diagnosis_figures import draw_staircase
    from mcrim_mitsuba.output.fit_figures import draw_comparison

    diagnosis, (falling, readings) = found.diagnosed.diagnosis, figures
    after = found.calibration if found.effects else None
    added = together(found.effects) if found.effects else ""
    return (
        *draw_staircase(falling, diagnosis.repair, after),
        *draw_comparison(readings, diagnosis.baseline, after, added=added),
    )


def _step_table() -> Table:
    table = terminal.table(
        "repair, step by step", "added", "chi2 / ndf", "p", "rms pull", "left out",
        "light yield or scale", "alpha_scat (1/cm)",
    )  # fmt: skip
    table.columns[0].no_wrap = True
    return table


def _add_step(table: Table, step) -> None:
    add_literal_row(table, *_cells(step).values())


def _cells(step) -> dict[str, str]:
    """A step's figures in words."""
    _, light = light_yield_text(step.parameters)
    scattering = step.parameters.get(ALPHA_SCAT)
    return {
        "added": "as it came" if step.added is None else f"+ {step.added}",
        "chi2": f"{number(step.chi2)} / {step.ndf}"
        + (f" = {number(step.chi2 / step.ndf)}" if step.ndf > 0 else ""),
        "p": p_text(step.p_value),
        "rms_pull": number(step.rms_pull),
        "left_out": number(step.left_out_error),
        "light": light,
        "scattering": "fixed" if scattering is None else estimate_text(scattering),
    }


def _step_text(step) -> str:
    """A step in one line."""
    cells, (name, _) = _cells(step), light_yield_text(step.parameters)
    if ALPHA_SCAT in step.parameters:
        cells["scattering"] += " /cm"
    return (
        "step {step}, {added}: chi2 / ndf {chi2}, p = {p}, rms pull {rms_pull}, left-out "
        "error {left_out}, {name} {light}, alpha_scat {scattering}"
    ).format(step=step.step, name=name, **cells)


def _show_mended(screen, found) -> None:
    """The fit with all effects simulated together, where the responses' sum was before."""
    fit = found.calibration
    screen.line(
        f"With {together(found.effects)} simulated together: chi2 = {number(fit.chi2)} "
        f"(ndf {fit.ndf}, p = {p_text(fit.p_value)})"
    )
    showing.show_parameters(screen, fit.parameters)
    if fit.p_value is not None and fit.p_value < ACCEPTABLE_P:
        screen.line("The mended campaign still does not describe its readings.", style="bold")
