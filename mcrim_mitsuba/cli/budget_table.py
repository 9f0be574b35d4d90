"""The table of an error budget: what kind every contribution is, and what would reduce it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from rich.table import Table

from mcrim_mitsuba.cli import output
from mcrim_mitsuba.physics.error_budget import Contribution, ErrorBudget

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
    shown = output.table(title, "contribution", *(f"{name}, %" for name in budgets))
    for name in ("kind", "reducible", "by"):
        shown.add_column(name, justify="left")
    rows: dict[str, Contribution] = {}
    for budget in reversed(list(budgets.values())):
        for row in budget.contributions:
            rows.setdefault(row.name, row)
    for name, row in rows.items():
        output.add_literal_row(
            shown, name.replace("_", " "), *(_percent(name, budget) for budget in budgets.values()),
            row.kind, "yes" if row.reducible else "no", row.by,
        )  # fmt: skip
    shown.add_section()
    for name in ("statistical", "systematic", "total"):
        sums = (f"{100 * getattr(budget, name):.1f}" for budget in budgets.values())
        output.add_literal_row(shown, name, *sums, "", "", "", style="bold")
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
