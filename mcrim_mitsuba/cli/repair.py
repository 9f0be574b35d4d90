"""``mcrim repair``: add what is missing, and see the error fall."""

from __future__ import annotations

import sys
from pathlib import Path

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.output import descriptions
from mcrim_mitsuba.output.described import rich_table


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("-o", "--output", "path", metavar="NEW.toml", required=True,
              help="The mended campaign; its scene is written beside it, as NEW.xml. Never "
              "replaces a file.")  # fmt: skip
@options.figure("how the error falls (and readings and pulls before and after, NAME_readings)")
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@options.work
@options.json_output
def repair(campaign, path, figure, json_file, work) -> None:
    """Add effects to CAMPAIGN (TOML) one by one while the data justify it.

    Writes a campaign and a scene with the effects in them, to go on from.
    """
    figures = (figure, showing.further_picture(figure, "readings"))
    written = _written(path)
    read, _ = showing.read_campaign(campaign, json_file, *figures, further=written)
    showing.refuse_to_replace(written)
    screen = terminal.console(json_file)
    # a table that grows in a terminal, lines elsewhere
    live = sys.stdout.isatty() and sys.stderr.isatty() and not screen.quiet
    steps = _Growing()

    def show(step) -> None:
        steps.add(step)
        if not live:
            screen.line(descriptions.step_text(step))

    with work.begin(steps if live else None) as run:
        found = mcrim.repair(read, path, on_step=show, run=run)
    terminal.write_json(json_file, found.document)
    drawn = found.draw(figure) if figure else ()
    showing.show(screen, descriptions.of_repair(found.found, with_steps=live), drawn)
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


class _Growing:
    """A table of steps for rich, which shows it again and again as it grows."""

    def __init__(self) -> None:
        self._steps: list = []

    def add(self, step) -> None:
        self._steps.append(step)

    def __rich__(self):
        return rich_table(descriptions.steps_table(self._steps))
