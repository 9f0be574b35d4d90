"""``mcrim lab plan``: plan a measurement."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.scene.values import parse_list

_COUPLINGS = "1.0,1.333,1.46,1.515"
_EVENTS, _MOUNTINGS = "log:1e3:1e6:4", "1,2,4,8,16"
_LARGEST_COUNT, _MOST_MOUNTINGS = 1e12, 10_000
#: Plans shown; --json has all.
_MOST_SHOWN = 16


@click.command(short_help="How many events, mountings and which couplings are needed.")
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("--yield-error", "wanted", type=options.Precision(), metavar="FRACTION",
              default="10%", show_default=True,
              help="Wanted error of the light yield.")  # fmt: skip
@click.option("--n-gap", default=_COUPLINGS, show_default=True, metavar="LIST",
              help="Couplings to choose from, such as 1.0,glycerol@540nm; 8 at most; every set is "
                   "tried.")  # fmt: skip
@click.option("--events", default=_EVENTS, show_default=True, metavar="LIST",
              help="Events in the band of each mounting's histogram.")  # fmt: skip
@click.option("--mountings", default=_MOUNTINGS, show_default=True, metavar="LIST",
              help="Mountings of each coupling.")  # fmt: skip
@click.option("--rate", type=options.Number(1e-6, 1e9), metavar="PER_S", default=30.0,
              show_default=True, help="Events in the band per second.")  # fmt: skip
@click.option("--minutes", type=options.Number(0.0, 1e6), metavar="MINUTES", default=30.0,
              show_default=True,
              help="Time of a mounting besides the counting, in minutes.")  # fmt: skip
@click.option("--scatter", type=options.Precision(), metavar="FRACTION",
              help="Scatter of the signal from mounting to mounting (default: that of the "
                   "campaign's histograms; without any 2.8%, the article's).")  # fmt: skip
@click.option("--spread", type=options.Precision(), metavar="FRACTION",
              help="Spread of an event's light besides the counting (default: that of the "
                   "campaign's histograms; without any 10%).")  # fmt: skip
@options.figure("the error of the light yield over events, for each set of couplings")
@options.seed
@options.machine
@work_options
@options.json_output
def plan(campaign, wanted, n_gap, events, mountings, rate, minutes, scatter, spread, figure,
         seed, variant, threads, json_file, work) -> None:  # fmt: skip
    """Plan a measurement: how many events, mountings and which couplings CAMPAIGN (TOML) needs.

    From the campaign's solution the model predicts what every set of couplings would bring; its
    readings must be detected photons per event. The light yield's statistical error falls with
    events and mountings; priors and detector efficiency stay, and what the model neglects
    (mcrim budget) comes on top.
    """
    from mcrim_mitsuba.inference.plan import plan as run
    from mcrim_mitsuba.inference.plans import measured_conditions

    counts = _counts("--events", events, 1.0, _LARGEST_COUNT)
    times = [int(n) for n in _counts("--mountings", mountings, 1, _MOST_MOUNTINGS, whole=True)]
    couplings = parse_list("--n-gap", n_gap, "n_gap", Path(campaign).parent)
    showing.refuse_places(json_file, [campaign], figure)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, files, figure)
    conditions = dataclasses.replace(
        measured_conditions(read), events_per_second=rate, minutes_per_mounting=minutes,
        **{name: value for name, value in (("mounting_scatter", scatter),
                                           ("intrinsic_spread", spread)) if value is not None},
    )  # fmt: skip
    with work.begin() as report:
        found = run(
            read, wanted, n_gap=couplings, mountings=times, events=counts, conditions=conditions,
            seed=seed, variant=variant, threads=threads, progress=report,
        )  # fmt: skip
    terminal.write_json(json_file, _as_json(found, seed))
    drawn: tuple[Path, ...] = ()
    if figure:
        from mcrim_mitsuba.output.budget_figures import draw_plan

        drawn = draw_plan(figure, found)
    _show(terminal.console(json_file), found, drawn)


def _counts(
    option: str, text: str, least: float, most: float, *, whole: bool = False
) -> list[float]:
    """Numbers of events or mountings."""
    values = parse_list(option, text)
    for value in values:
        if not least <= value <= most or (whole and value != round(value)):
            kind = "whole number" if whole else "number"
            raise InputError(
                f"{option}: {value:g} is no {kind} from {least:g} to {most:g}",
                "separate numbers by commas, such as 1,2,4",
            )
    return values


def _as_json(found, seed: int) -> dict:
    """All plans, for ``--json``."""
    from mcrim_mitsuba.output.findings import verdict

    return {
        "wanted": found.wanted,
        "reached": found.cheapest is not None,
        "cheapest": _plan_json(found, found.cheapest),
        "cheapest_statistical": _plan_json(found, found.cheapest_statistical),
        "verdict": list(verdict(found)),
        "conditions": found.conditions,
        "candidates": found.candidates,
        "floors": [
            {"configurations": list(chosen), **_error_json(error)}
            for chosen, error in found.floors.items()
        ],
        "undetermined": [list(chosen) for chosen in found.undetermined],
        "plans": [_plan_json(found, each) for each in found.plans],
        "solution": found.solution,
        "seed": seed,
        "notes": list(found.notes),
    }


def _plan_json(found, plan) -> dict | None:
    if plan is None:
        return None
    return {
        "configurations": [found.candidates[i].parameters for i in plan.configurations],
        "mountings": plan.mountings,
        "events": plan.events,
        "hours": plan.hours,
        "light_yield": _error_json(plan.light_yield),
        "alpha_scat": None if plan.alpha_scat is None else _error_json(plan.alpha_scat),
    }


def _error_json(error) -> dict:
    """Relative errors."""
    return {
        "statistical": error.statistical,
        "systematic": error.systematic,
        "total": error.total,
        "parts": error.parts,
    }


def _show(screen, found, drawn) -> None:
    from mcrim_mitsuba.core.rounding import percent
    from mcrim_mitsuba.output.findings import verdict

    at = ", ".join(
        f"{name} = {pdg(known.value, known.sigma)}" for name, known in found.solution.items()
    )
    screen.line(f"At the campaign's solution: {at}")
    signals = terminal.table(
        "what would be measured", "coupling", "photons per event", "error of 10,000 events"
    )
    for each in found.candidates:
        terminal.add_literal_row(
            signals, each.name, f"{each.signal:.1f}",
            percent(each.event_sigma / each.signal / 100),
        )  # fmt: skip
    screen.print(signals)
    floors = terminal.table(
        "what readings without error would leave of the light yield's", "couplings", "total",
        "priors", "detector efficiency",
    )  # fmt: skip
    for chosen, error in found.floors.items():
        parts = (error.total, error.priors, error.efficiency)
        terminal.add_literal_row(floors, found.name(chosen), *map(percent, parts))
    screen.print(floors)
    plans = terminal.table(
        "plans that no cheaper one beats (relative errors)", "couplings", "mountings", "events",
        "hours", "light yield, stat.", "syst.", "total", "alpha_scat",
    )  # fmt: skip
    shown = found.efficient
    for plan in shown[-_MOST_SHOWN:]:
        light, scattering = plan.light_yield, plan.alpha_scat
        terminal.add_literal_row(
            plans, found.name(plan.configurations), f"{plan.mountings}", f"{plan.events:,.0f}",
            f"{plan.hours:.1f}", percent(light.statistical), percent(light.systematic),
            percent(light.total), "" if scattering is None else percent(scattering.total),
            style="bold" if plan is found.cheapest else "",
        )  # fmt: skip
    screen.print(plans)
    for line in verdict(found):
        screen.line(line, style="bold")
    screen.line(_assumed(found.conditions))
    if found.undetermined:
        sets = "; ".join(found.name(chosen) for chosen in found.undetermined)
        screen.line(f"Not enough to determine the parameters: {sets}")
    showing.say_drawn(screen, drawn)
    screen.say_notes(found.notes)


def _assumed(conditions) -> str:
    from mcrim_mitsuba.core.rounding import percent

    return (
        f"Assumed: {conditions.events_per_second:g} events per second in the band, "
        f"{conditions.minutes_per_mounting:g} minutes per mounting, a scatter of "
        f"{percent(conditions.mounting_scatter)} from mounting to mounting, and a spread of "
        f"{percent(conditions.intrinsic_spread)} of an event's light."
    )
