"""``mcrim lab plan``: plan a measurement."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import READS, collected
from mcrim_mitsuba.scene.values import parse_list, told_of_comma

#: What is planned with unless asked otherwise: indices of the gap, events and mountings.
_COUPLINGS = "1.0,1.333,1.46,1.515"
_EVENTS = "log:1e3:1e6:4"
_MOUNTINGS = "1,2,4,8,16"
#: Events and mountings at most.
_LARGEST_COUNT = 1e12
_MOST_MOUNTINGS = 10_000


@click.command(short_help="How many events, mountings and which couplings are needed.")
@options.campaign
@click.option(
    "--yield-error",
    "wanted",
    type=options.Precision(),
    default="10%",
    show_default=True,
    help="Wanted error of the light yield.",
)
@click.option(
    "--n-gap",
    default=_COUPLINGS,
    show_default=True,
    metavar="LIST",
    help="Couplings to choose from, such as 1.0,glycerol@540nm; 8 at most; every set is tried.",
)
@click.option(
    "--events",
    default=_EVENTS,
    show_default=True,
    metavar="LIST",
    help="Events in the band of each mounting's histogram.",
)
@click.option(
    "--mountings",
    default=_MOUNTINGS,
    show_default=True,
    metavar="LIST",
    help="Mountings of each coupling.",
)
@click.option(
    "--rate",
    type=options.Number(1e-6, 1e9),
    metavar="PER_S",
    default=30.0,
    show_default=True,
    help="Events in the band per second.",
)
@click.option(
    "--minutes",
    type=options.Number(0.0, 1e6),
    metavar="MINUTES",
    default=30.0,
    show_default=True,
    help="Time of a mounting besides the counting, in minutes.",
)
@click.option(
    "--scatter",
    type=options.Precision(),
    help="Scatter of the signal from mounting to mounting (default: that of the "
    "campaign's histograms; without any 2.8%, the article's).",
)
@click.option(
    "--spread",
    type=options.Precision(),
    help="Spread of an event's light besides the counting (default: that of the "
    "campaign's histograms; without any 10%).",
)
@options.figure("the error of the light yield over events, for each set of couplings")
@options.work
def plan(
    campaign,
    wanted,
    n_gap,
    events,
    mountings,
    rate,
    minutes,
    scatter,
    spread,
    figure,
    json_file,
    work,
) -> None:
    """Plan a measurement: how many events, mountings and which couplings CAMPAIGN (TOML) needs.

    From the campaign's solution the model predicts what every set of couplings would bring; its
    readings must be detected photons per event. The light yield's statistical error falls with
    events and mountings; priors and detector efficiency stay, and what the model neglects
    (mcrim budget) comes on top.
    """
    from mcrim_mitsuba.inference.plan import measured_conditions

    counts = _counts("--events", events, 1.0, _LARGEST_COUNT)
    times = [int(n) for n in _counts("--mountings", mountings, 1, _MOST_MOUNTINGS, whole=True)]
    with collected(READS) as spectra:
        couplings = parse_list("--n-gap", n_gap, "n_gap", Path(campaign).parent)
    comma = told_of_comma("--n-gap", n_gap)
    read = showing.read_campaign(campaign, json_file, figure, inputs=spectra)
    terminal.console(json_file).say_notes(comma)
    conditions = dataclasses.replace(
        measured_conditions(read),
        events_per_second=rate,
        minutes_per_mounting=minutes,
        **{
            name: value
            for name, value in (("mounting_scatter", scatter), ("intrinsic_spread", spread))
            if value is not None
        },
    )
    with work.begin() as run:
        planning = mcrim.plan(
            read,
            wanted,
            n_gap=couplings,
            mountings=times,
            events=counts,
            conditions=conditions,
            run=run,
        )
    showing.answer(planning, json_file, figure)


def _counts(
    option: str, text: str, least: float, most: float, *, whole: bool = False
) -> list[float]:
    """Numbers of events or mountings."""
    values = parse_list(option, text)
    for value in values:
        if not least <= value <= most or (whole and value != round(value)):
            kind = "whole number" if whole else "number"
            problem = f"{option}: {value:g} is no {kind} from {least:g} to {most:g}"
            raise InputError(problem, "separate numbers by commas, such as 1,2,4")
    return values
