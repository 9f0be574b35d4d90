"""``mcrim reduce``: a campaign's raw data as readings, priors and efficiency."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.output.laboratory_descriptions import of_reduction


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("-o", "--output", "path", metavar="NEW.toml",
              help="The campaign in plain numbers, its readings beside it (NEW.csv).")  # fmt: skip
@options.figure("the histograms with their peaks (and NAME_spectra, the detector's efficiency, and "
                "NAME_transmittance, the absorption)")  # fmt: skip
@options.json_output
def reduce(campaign, path, figure, json_file) -> None:
    """Reduce the raw data of CAMPAIGN (TOML), every step with its errors.

    Histograms become readings (photons per event; repeated mountings their mean), emission and
    quantum efficiency the detector's efficiency, transmittance the absorption (1/cm), the
    source's gammas the depth of the source (mm). All commands do this by themselves; here it is
    shown.
    """
    from mcrim_mitsuba.campaign.editor import readings_beside, to_json
    from mcrim_mitsuba.campaign.editor import reduce as run

    figures = (figure, *(showing.further_picture(figure, name) for name in _FURTHER))
    written = {}
    if path is not None:
        written = {
            "--output": (path, (".toml",)),
            "the readings of --output": (str(readings_beside(Path(path))), (".csv",)),
        }
    read, _ = showing.read_campaign(campaign, json_file, *figures, further=written)
    showing.refuse_to_replace(written)
    raw = run(read, path).raw
    assert raw is not None  # refused otherwise
    terminal.write_json(json_file, {"campaign": read.path, **to_json(raw), "plain_campaign": path})
    drawn: tuple[Path, ...] = ()
    if figure:
        from mcrim_mitsuba.output.laboratory_figures import draw_raw_data

        places = dict(zip(("histograms", *_FURTHER), figures, strict=True))
        drawn = tuple(
            file for name, made in draw_raw_data(raw).items() for file in made.save(places[name])
        )
    screen = terminal.console(json_file)
    showing.show(screen, of_reduction(raw), drawn)
    if path is not None:
        screen.line(f"{path} and {readings_beside(Path(path))} were written", style="bold")
    screen.line(f"Next: {showing.command('calibrate', path or campaign)}", style="bold")


_FURTHER = ("spectra", "transmittance")
