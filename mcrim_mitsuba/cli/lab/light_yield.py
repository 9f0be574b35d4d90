"""``mcrim lab yield``, ``relative`` and ``plan``: light yields, and how to measure them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import Number, NumberWithError, Precision, WithError, option
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import READS, attributes, collected
from mcrim_mitsuba.core.numbers import ENERGIES_KEV, IN_KEV, doubts
from mcrim_mitsuba.laboratory.error_budget import ErrorBudget, Uncertain, budget_of, common_value
from mcrim_mitsuba.output import describe_laboratory
from mcrim_mitsuba.output.registry import VerbResult
from mcrim_mitsuba.scene.values import parse_list, told_of_comma


@click.command("yield", short_help="Light yield by Eq. 2, with its error budget.")
@option(
    "--signal",
    WithError(),
    "Photons (photoelectrons) per event; again for every further coupling.",
    "signals",
    multiple=True,
    required=True,
)
@option(
    "--eta",
    WithError(fraction=True),
    "Light collection efficiency (0.25 or 25%), in the order of the signals; its error "
    "counts as common to all couplings.",
    "etas",
    multiple=True,
    required=True,
)
@option(
    "--label", "TEXT", "Name of the coupling, in the order of the signals.", "labels", multiple=True
)
@option(
    "--efficiency",
    WithError(fraction=True),
    "Emission-weighted detector efficiency (0.127 or 12.7%), common to all couplings.",
    required=True,
)
@option(
    "--energy-keV", WithError(), "Energy deposited per event, keV.", "energy_keV", required=True
)
@options.json_output
def light_yield(signals, etas, labels, efficiency, energy_keV, json_file) -> None:
    """Light yield (photons per keV) by Eq. 2, Y = N / (epsilon eta E), with its error budget.

    \b
    Numbers are written with their standard errors: 14.3±0.2, 14.3+-0.2 or 14.3±1.4%.
    mcrim lab yield --signal 14.3±0.2 --eta 0.25±12% --label air \\
                    --signal 24.5±0.4 --eta 0.43±12% --label gel \\
                    --efficiency 0.127±10% --energy-keV 59.5

    Yields of several couplings are combined: counts are independent, all else is common.
    """
    from mcrim_mitsuba.laboratory.light_yield import light_yield_ph_per_keV

    def common(number: NumberWithError, origin: str) -> Uncertain:
        """A number whose error all couplings share."""
        return Uncertain(number.value, systematic={origin: number.sigma} if number.sigma else {})

    showing.refuse_places(json_file, [])
    # energies of sources are exact beside all else
    given = {"--signal": signals, "--eta": etas, "--efficiency": (efficiency,)}
    lacking = [option for option, numbers in given.items() if not all(n.sigma for n in numbers)]
    words = f"{' and '.join(lacking)} came without an error (as in 14.3±0.2): the budget lacks it"
    notes = [*([words] if lacking else []), _INSIDE_THE_WINDOW]
    labels = _labels(signals, etas, labels)
    if energy_keV.value < ENERGIES_KEV[0]:
        raise InputError(f"--energy-keV = {energy_keV.value:g}", IN_KEV)
    couplings = {}
    for label, signal, eta in zip(labels, signals, etas, strict=True):
        counts = f"counts, {label}" if len(labels) > 1 else "counts"
        light = light_yield_ph_per_keV(
            Uncertain(signal.value, statistical={counts: signal.sigma} if signal.sigma else {}),
            common(eta, "eta"),
            common(efficiency, "detector_efficiency"),
            common(energy_keV, "energy"),
        )
        couplings[label] = (signal.value, signal.sigma), (eta.value, eta.sigma), light
    together = common_value([light for *_, light in couplings.values()])
    of_all = {"light_yield_ph_per_keV": together.mean.value}
    notes += [f"{name} {text}" for name, text in doubts(of_all)]
    budgets = {label: budget_of(light).merged for label, (*_, light) in couplings.items()}
    if len(couplings) > 1:
        budgets["together"] = budget_of(together.mean).merged
    weights = dict(zip(couplings, together.weights, strict=True))
    document = {
        "yields": [
            {"label": label, "signal": signal[0], "signal_sigma": signal[1]}
            | {"eta": eta[0], "eta_sigma": eta[1], "weight": weights[label]}
            | {**_yield_json(light), "budget": _budget_json(budgets[label])}
            for label, (signal, eta, light) in couplings.items()
        ],
        **_yield_json(together.mean),
        "budget": _budget_json(list(budgets.values())[-1]),
        **attributes(together, "chi2 ndf p_value"),
        "notes": notes,
    }
    shown = describe_laboratory.of_yields(couplings, together, budgets, notes)
    showing.answer(VerbResult(kind="light_yield", shown=shown, numbers=document), json_file)


_INSIDE_THE_WINDOW = (
    "--efficiency counts as that of light inside the window: measured in air it has the "
    "window's reflection in it, and the yield is lower by that (4.26 % at n = 1.52)"
)


def _labels(signals, etas, labels: tuple[str, ...]) -> tuple[str, ...]:
    """A name for every coupling; refuses options that do not come in pairs, and names twice."""
    if len(etas) != len(signals):
        problem = f"--signal is given {len(signals)} times and --eta {len(etas)} times"
        raise InputError(problem, "give both for every coupling")
    if not labels:
        return tuple(f"coupling {number}" for number in range(1, len(signals) + 1))
    if len(labels) != len(signals):
        problem = f"--label is given {len(labels)} times for {len(signals)} signals"
        raise InputError(problem, "give one for every signal, or none")
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise InputError(f"--label {twice} is given twice", "give every coupling its own")
    return labels


def _budget_json(budget: ErrorBudget) -> dict:
    """A budget of one value, relative errors without their signs."""
    parts = [
        vars(part) | {"relative": abs(part.relative), "share_of_variance": budget.share(part)}
        for part in budget.contributions
    ]
    return {"contributions": parts, **attributes(budget, "statistical systematic total")}


def _yield_json(light) -> dict:
    """A light yield and its errors, as ``--json`` writes them."""
    errors = "sigma statistical=statistical_sigma systematic=systematic_sigma"
    return attributes(light, f"light_yield_ph_per_keV=value {errors}")


@click.command(short_help="Light yield of a sample against a reference crystal, Eq. 7.")
@click.argument("file", type=click.Path(path_type=str))
@options.json_output
def relative(file, json_file) -> None:
    """Light yield (photons per keV) of a sample by Eq. 7, against the reference in FILE (TOML).

    FILE has the tables [sample] and [reference] with signal, eta and detector_efficiency, each
    with its _sigma; the reference also has light_yield_ph_per_keV. [shared] names relative
    errors, parts of those, that move both crystals alike: they cancel. An example is
    scenes/cawo4_reference.toml.
    """
    from mcrim_mitsuba.laboratory.light_yield import read_comparison

    showing.refuse_places(json_file, [file])
    read = read_comparison(file)
    budgets = {"nothing shared": budget_of(read.uncorrelated), "Y": budget_of(read.light_yield)}
    document = {
        **_yield_json(read.light_yield),
        "sigma_ignoring_shared": read.uncorrelated.sigma,
        "shared": read.shared,
        "budget": _budget_json(budgets["Y"]),
        "budget_ignoring_shared": _budget_json(budgets["nothing shared"]),
        "equal_collection_ph_per_keV": read.equal_collection,
        "signals_alone_ph_per_keV": read.signals_alone,
    }
    shown = describe_laboratory.of_relative(read, budgets)
    showing.answer(VerbResult(kind="relative_yield", shown=shown, numbers=document), json_file)


#: What is planned with unless asked otherwise: events and mountings.
_EVENTS = "log:1e3:1e6:4"
_MOUNTINGS = "1,2,4,8,16"
#: Events and mountings at most.
_LARGEST_COUNT = 1e12
_MOST_MOUNTINGS = 10_000


@click.command(short_help="How many events, mountings and which couplings are needed.")
@options.campaign
@option("--yield-error", Precision(), "Wanted error of the light yield.", "wanted", default="10%")
@option(
    "--n-gap",
    "LIST",
    "Couplings to choose from, such as 1.0,glycerol@540nm; 8 at most; every set is tried (default: "
    "what [next_measurements] lists, or the configurations of the readings).",
)
@option("--events", "LIST", "Events in the band of each mounting's histogram.", default=_EVENTS)
@option("--mountings", "LIST", "Mountings of each coupling.", default=_MOUNTINGS)
@option(
    "--rate",
    Number("PER_S", 1e-6, 1e9),
    "Events in the band per second.",
    "events_per_second",
    default=30.0,
)
@option(
    "--minutes",
    Number("MINUTES", 0.0, 1e6),
    "Time of a mounting besides the counting, in minutes.",
    "minutes_per_mounting",
    default=30.0,
)
@option(
    "--scatter",
    Precision(),
    "Scatter of the signal from mounting to mounting (default: that of the "
    "campaign's histograms; without any 2.8%, the article's).",
    "mounting_scatter",
)
@option(
    "--spread",
    Precision(),
    "Spread of an event's light besides the counting (default: that of the "
    "campaign's histograms; without any 10%).",
    "intrinsic_spread",
)
@click.option("--anew", is_flag=True, help="As if nothing had been measured but transmittances.")
@options.figure("the error of the light yield over events, for each set of couplings")
@options.work
def plan(
    campaign, wanted, n_gap, events, mountings, anew, figure, json_file, work, **conditions
) -> None:
    """Plan a measurement: how many events, mountings and which couplings CAMPAIGN (TOML) needs.

    From the campaign's solution the model predicts what every set of configurations would bring
    beside the readings so far, which must be detected photons per event. The light yield's
    statistical error falls with events and mountings; priors and detector efficiency stay, and what
    the model neglects (mcrim budget) comes on top: what readings of the proposed plan could tell of
    it is said, too.
    """
    from mcrim_mitsuba.inference.plan import measured_conditions

    counts = _counts("--events", events, 1.0, _LARGEST_COUNT)
    times = [int(n) for n in _counts("--mountings", mountings, 1, _MOST_MOUNTINGS, whole=True)]
    choices: dict[str, Any] = {"mountings": times, "events": counts, "anew": anew}
    with collected(READS) as spectra:
        if n_gap is not None:
            choices["n_gap"] = parse_list("--n-gap", n_gap, "n_gap", Path(campaign).parent)
    comma = told_of_comma("--n-gap", n_gap or "")
    read = showing.read_campaign(campaign, json_file, figure, inputs=spectra)
    terminal.console(json_file).say_notes(comma)
    given = {name: value for name, value in conditions.items() if value is not None}
    with work.begin() as run:
        measured = dataclasses.replace(measured_conditions(read), **given)
        planning = mcrim.plan(read, wanted, conditions=measured, run=run, **choices)
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
