"""``mcrim lab yield`` and ``relative``: light yields from numbers, with their error budgets."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import NumberWithError, WithError
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.output.described import table
from mcrim_mitsuba.output.descriptions import contributions_table
from mcrim_mitsuba.output.documents import of_contributions

# p-value below which couplings are said to disagree
_LEAST_P_VALUE = 0.01


@click.command("yield", short_help="Light yield by Eq. 2, with its error budget.")
@click.option(
    "--signal", "signals", type=WithError(), multiple=True, required=True,
    help="Photons (photoelectrons) per event; again for every further coupling.",
)  # fmt: skip
@click.option(
    "--eta", "etas", type=WithError(fraction=True), multiple=True, required=True,
    help="Light collection efficiency (0.25 or 25%), in the order of the signals; its error "
    "counts as common to all couplings.",
)  # fmt: skip
@click.option(
    "--label", "labels", multiple=True, metavar="TEXT",
    help="Name of the coupling, in the order of the signals.",
)  # fmt: skip
@click.option(
    "--efficiency", type=WithError(fraction=True), required=True,
    help="Emission-weighted detector efficiency (0.127 or 12.7%), common to all couplings.",
)  # fmt: skip
@click.option(
    "--energy-keV", "energy_keV", type=WithError(), required=True,
    help="Energy deposited per event, keV.",
)  # fmt: skip
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
    from mcrim_mitsuba.laboratory.error_budget import Uncertain, budget_of, common_value
    from mcrim_mitsuba.laboratory.light_yield import light_yield_ph_per_keV

    showing.refuse_places(json_file, [])
    notes = _notes(signals, etas, efficiency)
    labels = _labels(signals, etas, labels)
    yields = {}
    for label, signal, eta in zip(labels, signals, etas, strict=True):
        counts = f"counts, {label}" if len(labels) > 1 else "counts"
        yields[label] = light_yield_ph_per_keV(
            Uncertain(signal.value, statistical={counts: signal.sigma} if signal.sigma else {}),
            _common(eta, "eta"),
            _common(efficiency, "detector_efficiency"),
            _common(energy_keV, "energy"),
        )
    together = common_value(list(yields.values()))
    budgets = {label: budget_of(known).merged for label, known in yields.items()}
    if len(yields) > 1:
        budgets["together"] = budget_of(together.mean).merged
    terminal.write_json(
        json_file,
        {
            "yields": [
                {
                    "label": label, "signal": signal.value, "signal_sigma": signal.sigma,
                    "eta": eta.value, "eta_sigma": eta.sigma, "weight": weight,
                    **_yield_json(yields[label]), "budget": of_contributions(budgets[label]),
                }
                for label, signal, eta, weight in zip(
                    labels, signals, etas, together.weights, strict=True
                )
            ],
            **_yield_json(together.mean),
            "budget": of_contributions(list(budgets.values())[-1]),
            "chi2": together.chi2, "ndf": together.ndf, "p_value": together.p_value,
            "notes": notes,
        },
    )  # fmt: skip
    screen = terminal.console(json_file)
    columns = ("coupling", "signal", "eta", "weight", "Y", "statistical", "systematic", "total")
    rows = (
        (
            label, pdg(signal.value, signal.sigma or None), pdg(eta.value, eta.sigma or None),
            f"{100 * weight:.0f} %", *_yield_cells(yields[label]),
        )
        for label, signal, eta, weight in zip(labels, signals, etas, together.weights, strict=True)
    )  # fmt: skip
    sums = [("together", "", "", "", *_yield_cells(together.mean))] if len(yields) > 1 else []
    screen.show(
        table("light yield by Eq. 2, ph/keV", columns, rows, sums),
        contributions_table("error budget", budgets),
    )
    if together.p_value is not None:
        screen.line(_agreement(together))
    mean = together.mean
    screen.line(
        f"Y = {pdg(mean.value, mean.sigma or None)} ph/keV "
        f"(±{100 * mean.sigma / mean.value:.0f} %)",
        style="bold",
    )
    screen.say_notes(notes)


def _notes(signals, etas, efficiency) -> list[str]:
    """What the budget lacks. Energies of sources are exact beside all else."""
    given = {"--signal": signals, "--eta": etas, "--efficiency": (efficiency,)}
    lacking = [
        name for name, numbers in given.items() if any(known.sigma == 0 for known in numbers)
    ]
    if not lacking:
        return []
    return [f"{' and '.join(lacking)} came without an error (as in 14.3±0.2): the budget lacks it"]


def _labels(signals, etas, labels: tuple[str, ...]) -> tuple[str, ...]:
    """A name for every coupling.

    Raises
    ------
    InputError
        If the options do not come in pairs or two names are the same.
    """
    if len(etas) != len(signals):
        raise InputError(
            f"--signal is given {len(signals)} times and --eta {len(etas)} times",
            "give both for every coupling",
        )
    if not labels:
        return tuple(f"coupling {number}" for number in range(1, len(signals) + 1))
    if len(labels) != len(signals):
        raise InputError(
            f"--label is given {len(labels)} times for {len(signals)} signals",
            "give one for every signal, or none",
        )
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise InputError(f"--label {twice} is given twice", "give every coupling its own")
    return labels


def _common(known: NumberWithError, origin: str):
    """A number whose error all couplings share."""
    from mcrim_mitsuba.laboratory.error_budget import Uncertain

    return Uncertain(known.value, systematic={origin: known.sigma} if known.sigma else {})


def _yield_cells(known) -> tuple[str, ...]:
    """Yield, its two kinds of errors and both together, ph/keV."""
    errors = (known.statistical_sigma, known.systematic_sigma, known.sigma)
    return f"{known.value:.3g}", *(f"{sigma:.2g}" for sigma in errors)


def _yield_json(known) -> dict:
    return {
        "light_yield_ph_per_keV": known.value,
        "sigma": known.sigma,
        "statistical": known.statistical_sigma,
        "systematic": known.systematic_sigma,
    }


def _agreement(together) -> str:
    """Whether the couplings agree, in one sentence."""
    numbers = f"chi2 = {together.chi2:.2g}, ndf = {together.ndf}, p = {together.p_value:.2g}"
    if together.p_value >= _LEAST_P_VALUE:
        return f"The couplings agree: {numbers} (errors that they share do not count)."
    return (
        f"The couplings DISAGREE: {numbers} (errors that they share do not count). Efficiencies "
        "that fit both signals come from `mcrim calibrate`."
    )


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
    from mcrim_mitsuba.laboratory.error_budget import budget_of
    from mcrim_mitsuba.laboratory.light_yield import read_comparison, relative_yield

    showing.refuse_places(json_file, [file])
    read = read_comparison(file)
    found = relative_yield(read.sample, read.reference, read.reference_yield, read.shared)
    known, ignoring = found.light_yield, found.uncorrelated
    budget, of_ignoring = budget_of(known), budget_of(ignoring)
    terminal.write_json(
        json_file,
        {
            **_yield_json(known),
            "sigma_ignoring_shared": ignoring.sigma,
            "shared": read.shared,
            "budget": of_contributions(budget),
            "budget_ignoring_shared": of_contributions(of_ignoring),
            "equal_collection_ph_per_keV": found.equal_collection,
            "signals_alone_ph_per_keV": found.signals_alone,
        },
    )
    screen = terminal.console(json_file)
    rows = [
        (
            name.replace("_", " "), pdg(*number), pdg(*read.reference[name]),
            "none" if name not in read.shared else f"{100 * read.shared[name]:.3g} %",
        )
        for name, number in read.sample.items()
    ]  # fmt: skip
    rows.append(("light yield, ph/keV", "", pdg(*read.reference_yield), ""))
    budgets = {"nothing shared": of_ignoring, "Y": budget}
    screen.show(
        table("both crystals", ("quantity", "sample", "reference", "shared error"), rows),
        contributions_table("error budget", budgets),
    )
    screen.line(
        f"Y = {pdg(known.value, known.sigma)} ph/keV (±{100 * budget.total:.1f} %)", style="bold"
    )
    screen.line(_said_of_sharing(read.shared, of_ignoring.total, budget.total))
    screen.line(
        f"With equal light collection assumed it would be {found.equal_collection:.3g} ph/keV, "
        f"{found.equal_collection / known.value:.2f} times as much; from the signals alone "
        f"{found.signals_alone:.3g} ph/keV."
    )


def _said_of_sharing(shared: dict[str, float], ignoring: float, total: float) -> str:
    """What the shared errors do to the yield's, relative ones."""
    if not any(shared.values()):
        return "Nothing is said to be shared: the errors of both crystals count in full."
    names = " and ".join(name.replace("_", " ") for name, part in shared.items() if part)
    return (
        f"What sample and reference share ({names}) cancels; without that the error would be "
        f"±{100 * ignoring:.1f} % and not ±{100 * total:.1f} %. The energy cancels too."
    )
