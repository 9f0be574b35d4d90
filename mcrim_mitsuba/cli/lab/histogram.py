"""``mcrim lab histogram``: a synthetic histogram of photons per event."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.writing import STDOUT, refuse_outputs, write_text


@click.command()
@click.option("--mean", type=float, required=True, metavar="PHOTONS",
              help="Mean number of photons of the band's events.")  # fmt: skip
@click.option("--events", type=float, metavar="COUNT",
              help="Events of the band (default: 20000).")  # fmt: skip
@click.option("--rate", type=float, metavar="PER_S",
              help="Events of the band per second, instead of --events.")  # fmt: skip
@click.option("--minutes", type=float, default=10.0, show_default=True,
              help="Time of the measurement, with --rate.")  # fmt: skip
@click.option("--spread", type=float, default=0.10, show_default=True, metavar="FRACTION",
              help="Relative standard deviation of an event's light, besides the counting of "
              "its photons.")  # fmt: skip
@click.option("--dark", type=float, default=0.0, show_default=True, metavar="PHOTONS",
              help="Mean number of dark counts per event: dark rate times gate; they add to the "
              "mean.")  # fmt: skip
@click.option("--list", "as_list", is_flag=True,
              help="Write the photons of every event, one a line, instead of bins.")  # fmt: skip
@options.seed
@click.option("-o", "--output", "path", required=True, metavar="FILE",
              help="CSV to write; - for the screen.")  # fmt: skip
@options.json_output
def histogram(mean, events, rate, minutes, spread, dark, as_list, seed, path, json_file) -> None:
    """Write a synthetic histogram of photons per event, as a measurement would fill it.

    \b
    mcrim lab histogram --mean 14.3 --rate 33 --minutes 10 -o trial.csv
    mcrim lab peak trial.csv

    A pedestal of 0.75 events and a continuum of 0.15 events per event of the band come on top;
    both fall off exponentially, with 1.2 and 25 photons.
    """
    from mcrim_mitsuba.physics.photon_histogram import spectrum_of

    if events is not None and rate is not None:
        raise InputError("both --events and --rate are given", "leave one of them out")
    refuse_outputs({"--output": path, "--json": json_file})
    if rate is not None:
        events = rate * 60.0 * minutes
    made = spectrum_of(
        mean, 20_000.0 if events is None else events, intrinsic_spread=spread, dark_photons=dark
    )
    comments = [
        f"# SYNTHETIC, not measured: mcrim lab histogram made it with seed {seed}",
        f"# band: {made.peak_events:g} events, mean {mean:g} photons, intrinsic spread {spread:g}",
        f"# pedestal: {made.pedestal_events:g} events, exp(-n/{made.pedestal_photons:g}); "
        f"continuum: {made.continuum_events:g} events, exp(-n/{made.continuum_photons:g})",
        f"# dark counts per event: {dark:g}",
    ]
    if as_list:
        rows = [f"{photons:g}" for photons in made.events(seed)]
        lines = [*comments, "photons", *rows]
    else:
        counts = made.sample(seed)
        rows = [f"{n:g},{c:g}" for n, c in zip(made.photons(), counts, strict=True)]
        lines = [*comments, "photons_per_event,events", *rows]
    write_text(path, "\n".join(lines) + "\n")
    output.write_json(
        json_file,
        {
            "mean_photons": mean, "peak_events": made.peak_events, "intrinsic_spread": spread,
            "dark_photons": dark, "pedestal_events": made.pedestal_events,
            "pedestal_photons": made.pedestal_photons, "continuum_events": made.continuum_events,
            "continuum_photons": made.continuum_photons, "seed": seed,
        },
    )  # fmt: skip
    screen = output.console(json_file, path)
    if path not in STDOUT:
        screen.line(f"{len(rows)} {'events' if as_list else 'bins'} written to {path}")
