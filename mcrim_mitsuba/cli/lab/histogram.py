"""``mcrim lab histogram``: a synthetic histogram of photons per event."""

from __future__ import annotations

import math
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import STDOUT, refuse_outputs, write_text
from mcrim_mitsuba.core.numbers import refuse_decimal_comma

#: How files begin that this command made, and may replace.
_OURS = "# SYNTHETIC, not measured: mcrim lab histogram made it"
_EVENTS, _MINUTES = 20_000.0, 10.0
#: Lines of a list: some ten megabytes.
_MOST_LISTED = 1e6


class _Number(click.ParamType):
    """A number in the range of `laboratory.peak_shapes.RANGES`, or up to `most`."""

    name = "number"

    def __init__(self, of: str | None = None, most: float = 1e12, percent: bool = False) -> None:
        self.of, self.most, self.percent = of, most, percent

    def convert(self, value, param, ctx) -> float:
        from mcrim_mitsuba.laboratory.peak_shapes import RANGES

        if isinstance(value, float):
            return value
        above, most = RANGES[self.of] if self.of else (True, self.most)
        text = value.strip()
        refuse_decimal_comma(param.opts[0], text)
        share = self.percent and text.endswith("%")
        try:
            number = float(text.removesuffix("%") if share else text) * (0.01 if share else 1.0)
        except ValueError:
            number = math.nan
        if not (number > 0 if above else number >= 0) or not number <= most:
            least = "above 0, at most" if above else "from 0 to"
            such = f" or {100 * most:g}%" if self.percent else ""
            self.fail(f"{value!r} is not in its range; give a number {least} {most:g}{such}")
        return number


@click.command(short_help="Synthetic histogram of photons per event.")
@click.option("--mean", type=_Number("mean_photons"), required=True, metavar="PHOTONS",
              help="Mean number of photons of the band's events.")  # fmt: skip
@click.option("--events", type=_Number("peak_events"), metavar="COUNT",
              help=f"Events of the band (default: {_EVENTS:.0f}).")  # fmt: skip
@click.option("--rate", type=_Number(), metavar="PER_S",
              help="Events of the band per second, instead of --events.")  # fmt: skip
@click.option("--minutes", type=_Number(), metavar="MINUTES",
              help=f"Time of the measurement, with --rate (default: {_MINUTES:g}).")  # fmt: skip
@click.option("--spread", type=_Number("intrinsic_spread", percent=True), default="10%",
              show_default=True, metavar="FRACTION",
              help="Relative standard deviation of an event's light, besides the counting of "
              "its photons: 0.1 or 10%.")  # fmt: skip
@click.option("--dark", type=_Number("dark_photons"), default=0.0, show_default=True,
              metavar="PHOTONS",
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
    from mcrim_mitsuba.laboratory.peak_shapes import RANGES, spectrum_of

    if events is not None and rate is not None:
        raise InputError("both --events and --rate are given", "leave one of them out")
    if minutes is not None and rate is None:
        raise InputError("--minutes is given without --rate", "give --rate, or --events alone")
    refuse_outputs({"--output": path, "--json": json_file})
    _refuse_foreign(path)
    if rate is not None:
        events = rate * 60.0 * (_MINUTES if minutes is None else minutes)
        most = RANGES["peak_events"][1]
        if events > most:
            raise InputError(
                f"--rate and --minutes make {events:g} events", f"let them be {most:g} at most"
            )
    events = _EVENTS if events is None else events
    if as_list and events > _MOST_LISTED:
        raise InputError(
            f"--list would write a line for each of {events:g} events and more",
            f"list {_MOST_LISTED:.0f} at most, or leave out --list for bins",
        )
    made = spectrum_of(mean, events, intrinsic_spread=spread, dark_photons=dark)
    comments = [
        f"{_OURS} with seed {seed}",
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
    terminal.write_json(
        json_file,
        {
            "mean_photons": mean, "peak_events": made.peak_events, "intrinsic_spread": spread,
            "dark_photons": dark, "pedestal_events": made.pedestal_events,
            "pedestal_photons": made.pedestal_photons, "continuum_events": made.continuum_events,
            "continuum_photons": made.continuum_photons, "seed": seed,
        },
    )  # fmt: skip
    screen = terminal.console(json_file, path)
    if path not in STDOUT:
        screen.line(f"{len(rows)} {'events' if as_list else 'bins'} written to {path}")


def _refuse_foreign(path: str) -> None:
    """Refuse to replace what may be a measurement."""
    file = Path(path)
    if path in STDOUT or not file.is_file():
        return
    try:
        with file.open("rb") as stream:
            ours = stream.read(len(_OURS)) == _OURS.encode()
    except OSError:
        ours = False
    if not ours:
        raise InputError(
            "--output would replace a file that this command did not make",
            "name another file, or remove this one", path=path,
        )  # fmt: skip
