"""``mcrim lab relative``: the light yield by comparison with a reference crystal."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.output.described import table
from mcrim_mitsuba.output.descriptions import contributions_table
from mcrim_mitsuba.output.documents import of_contributions


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
            "light_yield_ph_per_keV": known.value,
            "sigma": known.sigma,
            "statistical": known.statistical_sigma,
            "systematic": known.systematic_sigma,
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
