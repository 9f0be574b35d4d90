"""The table of an error budget: what kind every contribution is, and what would reduce it."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.table import Table

from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.cli.terminal import Screen, add_literal_row
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import is_there
from mcrim_mitsuba.core.rounding import number, p_text, pdg
from mcrim_mitsuba.laboratory.error_budget import Contribution, ErrorBudget
from mcrim_mitsuba.output.findings import (
    carriers,
    configuration_text,
    estimate_text,
    leading_candidates,
    limit_text,
    misfit_shares,
    plausibility,
    quality,
    size_text,
    suspicion,
    together,
    trend_text,
)

#: How ``--photons`` is explained: the default, and what it counts.
PHOTONS = "2.6e5 of each simulation with an effect in the scene"
FURTHER_PHOTONS = "Configurations as they are get nine times as many."


_ORDINALS = ("first", "second", "third")


def further_picture(figure: str | None, ending: str) -> str | None:
    """Where another picture of ``--figure`` goes: ``fit.png`` gives ``fit_profiles.png``."""
    if figure is None:
        return None
    path = Path(figure)
    return str(path.parent / f"{path.stem}_{ending}{path.suffix}")


def read_with_files(campaign: str):
    """A campaign, and the files that were read for it."""
    from mcrim_mitsuba.campaign.campaign import read_campaign

    read = read_campaign(campaign)
    scene = read.scene
    raw = () if read.raw is None else read.raw.files
    return read, [
        campaign, scene.path, *scene.included, read.measurements.path,
        *(file.path for file in raw),
    ]  # fmt: skip


def refuse_places(
    json_file: str | None,
    inputs: Iterable[str | Path],
    *figures: str | None,
    further: Mapping[str, tuple[str | None, tuple[str, ...]]] | None = None,
) -> None:
    """Refuse outputs that could not be written or would replace what is read.

    Parameters
    ----------
    json_file : str or None
    inputs : iterable of str or Path
        Files that the command reads.
    figures : str or None
        Pictures; the numbers beside them are looked at too.
    further : mapping of str to (str or None, tuple of str)
        Other files by option, each with the suffixes that it may have.

    Raises
    ------
    InputError
        Before any work is done.
    """
    from mcrim_mitsuba.core.files import refuse_outputs
    from mcrim_mitsuba.output.figure_style import SUFFIXES, numbers_beside

    places: dict[str, str | None] = {"--json": json_file}
    suffixes: dict[str, tuple[str, ...]] = {}
    for option, (path, wanted) in (further or {}).items():
        places[option], suffixes[option] = path, wanted
    for count, path in enumerate(figures):
        if path is not None:
            option = "--figure" if count == 0 else f"the {_ORDINALS[count]} picture of --figure"
            places[option], suffixes[option] = path, SUFFIXES
            places[f"the numbers of {option.removeprefix('the ')}"] = str(numbers_beside(path))
    refuse_outputs(places, inputs, suffixes=suffixes)


def refuse_to_replace(written: Mapping[str, tuple[str, tuple[str, ...]]]) -> None:
    """Refuse outputs that are there already: a campaign or a scene may hold somebody's work.

    Parameters
    ----------
    written : mapping of str to (str, tuple of str)
        As `refuse_places` takes `further`.

    Raises
    ------
    InputError
    """
    for path, _ in written.values():
        if is_there(Path(path)) and Path(path).is_file():
            raise InputError(
                "this file exists already", "name another, or remove it first", path=path
            )


def provenance_json(provenance, notes: Sequence[str]) -> dict:
    """What makes a result reproducible, for ``--json``."""
    return dataclasses.asdict(provenance) | {"notes": list(notes)}


def diagnosis_json(diagnosed) -> dict:
    """A diagnosis for ``--json``, its baseline as `calibrate` has it."""
    document = diagnosed.diagnosis.to_json()
    document["baseline"] |= diagnosed.baseline.to_json()
    return document


def show_comparison(screen: Screen, comparison) -> None:
    """Readings beside predictions, what chi2 says, and where the misfit lies."""
    shares = misfit_shares(comparison)
    table = terminal.table(
        "readings", "reading", "measured", "model", "pull", "pull from the others", "of the misfit"
    )
    suspects = {label for one in comparison.suspects for label in one.labels}
    for row in comparison.rows:
        of_others = comparison.left_out_pulls.get(row.label)
        label = row.label if row.use else f"{row.label} (not used)"
        add_literal_row(
            table, label, pdg(row.measured, row.sigma), pdg(row.model, row.model_sigma),
            f"{row.pull:+.2f}",
            "" if of_others is None else f"{of_others:+.2f}",
            f"{100 * shares[row.label]:.0f} %" if row.use else "",
            style="bold" if row.label in suspects else "",
        )  # fmt: skip
    screen.print(table)
    screen.line(quality(comparison), style="bold")
    if fails(comparison):
        screen.line(f"- {carriers(comparison)}")
    show_suspects(screen, comparison.suspects)
    for trend in comparison.trends:
        screen.line(f"- {trend_text(trend)}")
    if comparison.absorbed:
        screen.line("Fitted parameters that may have taken up a misfit:", style="bold")
        for one in comparison.absorbed:
            screen.line(f"- {one.words}")


def fails(comparison) -> bool:
    """Whether the model fails to describe the readings."""
    from mcrim_mitsuba.output.findings import ACCEPTABLE_P

    return comparison.p_value is not None and comparison.p_value < ACCEPTABLE_P


def show_suspects(screen: Screen, suspects: Sequence) -> None:
    """Readings that may be wrong, before physics is blamed."""
    if suspects:
        screen.line("Look at these readings before physics is blamed:", style="bold")
    for suspect in suspects:
        screen.line(f"- {suspicion(suspect)}")


def show_parameters(screen: Screen, parameters: Mapping) -> None:
    """Every fitted parameter with its error; nothing where all is held."""
    if not parameters:
        return
    table = terminal.table("parameters", "parameter", "value")
    for name, known in parameters.items():
        add_literal_row(table, name, estimate_text(known))
    screen.print(table)


def show_candidates(screen: Screen, diagnosis) -> None:
    """Effects as explanations, alone and in pairs, the best first."""
    leading = leading_candidates(diagnosis)
    titles = (
        (diagnosis.candidates, "effects, each added alone"),
        (diagnosis.pairs, "the best pairs of effects"),
    )
    # a narrow terminal gets the columns that decide
    columns = _COLUMNS if screen.width >= _WIDE else _COLUMNS[:_DECIDING]
    for candidates, title in titles:
        if not candidates:
            continue
        table = terminal.table(title, *(name for name, _ in columns))
        for column in table.columns:
            column.overflow = "fold"
        for candidate in candidates:
            add_literal_row(
                table, *(text(candidate) for _, text in columns),
                style="bold" if candidate in leading else "",
            )  # fmt: skip
        screen.print(table)
    if diagnosis.candidates:
        screen.line(_EXPLANATION)
        if len(columns) < len(_COLUMNS):
            screen.line("A wider terminal shows more columns; --json and --figure have all.")
    for candidate in leading:
        if candidate.mimics:
            screen.line(
                f"- {together(candidate.effects)} could be mistaken for "
                f"{together(candidate.mimics, 'or')}"
            )


def _light(candidate) -> str:
    """The light yield with its change from the campaign as it is."""
    found = candidate.light_yield_ph_per_keV
    if found is None:
        return ""
    change = found.get("change")
    return number(found["value"]) + ("" if change is None else f" ({100 * change:+.1f} %)")


def _mimics(candidate) -> str:
    """The likeliest mistakes; JSON has all."""
    first = candidate.mimics[:_MIMICS_SHOWN]
    more = len(candidate.mimics) - len(first)
    return ", ".join(first) + (f" and {more} more" if more else "")


_MIMICS_SHOWN = 2
_COLUMNS = (
    ("effect", lambda c: c.effect),
    ("gain in chi2", lambda c: pdg(c.delta_chi2, c.delta_chi2_sigma or None)),
    ("p, fit", lambda c: p_text(c.p_value)),
    ("p, gain", lambda c: p_text(c.p_global)),
    ("size", lambda c: size_text(c, "\n")),
    ("plausible?", plausibility),
    ("left out", lambda c: number(c.left_out_error)),
    ("behind", lambda c: f"{c.behind:.1f}"),
    ("AICc", lambda c: number(c.aicc)),
    ("light yield", _light),
    ("could be mistaken for", _mimics),
)
#: Columns of a narrow terminal, and the width from which all are shown.
_DECIDING, _WIDE = 5, 150
_EXPLANATION = (
    "gain: fall of chi2, with the simulation's error; p, fit: of the fit with the effect; p, gain: "
    "probability that chance gives the best of all effects as much; left out: rms error on "
    "readings left out of the fit, in standard errors; behind: the best, in chi2 + 2 per "
    "parameter; AICc: information criterion for small samples, against no effect (negative is "
    "better); light yield: photons per keV, and its change"
)


def show_limits(screen: Screen, diagnosis) -> None:
    """How large each effect may be, where the readings need none."""
    if not diagnosis.upper_limits:
        return
    table = terminal.table(
        "what the readings allow, 95 % confidence", "effect", "parameter", "size"
    )
    for name, limit in diagnosis.upper_limits.items():
        add_literal_row(table, name, limit.parameter or "on or off", limit_text(limit))
    screen.print(table)


def show_next_measurements(screen: Screen, diagnosis) -> None:
    """Configurations that would tell the leading effects apart, the best first."""
    if not diagnosis.next_measurements:
        return
    table = terminal.table(
        "what to measure next", "configuration", "expected gain in chi2", "tells apart"
    )
    for measurement in diagnosis.next_measurements:
        pairs = "; ".join(" from ".join(pair) for pair in measurement.separates)
        add_literal_row(
            table, configuration_text(measurement), number(measurement.expected_delta_chi2), pairs
        )
    screen.print(table)


def show_not_tried(screen: Screen, diagnosis) -> None:
    """Effects that could not be fitted."""
    for name, reason in diagnosis.not_tried.items():
        screen.line(f"not tried: {name}: {reason}")


def say_spent(screen: Screen, provenance) -> None:
    """What the result rests on."""
    screen.line(
        f"{provenance.photons:,} photons ({provenance.cached_photons:,} of the cache), seed "
        f"{provenance.seed}, {provenance.seconds:.1f} s"
    )


def say_drawn(screen: Screen, files: Iterable[Path]) -> None:
    """Which figures were written."""
    if names := [str(path) for path in files]:
        screen.line(f"drawn to {together(names)}")


def command(*words: str | Path) -> str:
    """What to type, such as ``mcrim diagnose 'my campaign.toml'``."""
    return shlex.join(["mcrim", *map(str, words)])


# The table of an error budget: what kind every contribution is, and what would reduce it.

# smaller parts of the value are rounding of shared errors that cancel
_NOTHING = 1e-9


def budget_table(title: str, budgets: Mapping[str, ErrorBudget]) -> Table:
    """A row per contribution, a column per budget, sums last; percent of each value.

    Parameters
    ----------
    title : str
    budgets : mapping of str to ErrorBudget
        By the column's name. The last one puts the rows in order.
    """
    shown = terminal.table(title, "contribution", *(f"{name}, %" for name in budgets))
    for name in ("kind", "reducible", "by"):
        shown.add_column(name, justify="left")
    rows: dict[str, Contribution] = {}
    for budget in reversed(list(budgets.values())):
        for row in budget.contributions:
            rows.setdefault(row.name, row)
    for name, row in rows.items():
        terminal.add_literal_row(
            shown, name.replace("_", " "), *(_percent(name, budget) for budget in budgets.values()),
            row.kind, "yes" if row.reducible else "no", row.by,
        )  # fmt: skip
    shown.add_section()
    for name in ("statistical", "systematic", "total"):
        sums = (f"{100 * getattr(budget, name):.1f}" for budget in budgets.values())
        terminal.add_literal_row(shown, name, *sums, "", "", "", style="bold")
    return shown


def _percent(name: str, budget: ErrorBudget) -> str:
    found = next((row.relative for row in budget.contributions if row.name == name), None)
    if found is None:
        return ""
    return f"{100 * abs(found):.1f}" if abs(found) > _NOTHING else "0"


def budget_json(budget: ErrorBudget) -> dict:
    """A budget for ``--json``, relative errors without their signs."""
    return {
        "contributions": [
            dataclasses.asdict(row)
            | {"relative": abs(row.relative), "share_of_variance": budget.share(row)}
            for row in budget.contributions
        ],
        "statistical": budget.statistical,
        "systematic": budget.systematic,
        "total": budget.total,
    }
