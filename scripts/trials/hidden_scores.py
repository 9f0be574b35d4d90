"""What hidden-effect trials add up to: rates with their errors, and who is taken for whom."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from shared import fraction_error, markdown

from trials.hidden_trials import BAD_READING, SWAPPED_ROWS

#: Least p-value of a mended campaign, and how far from the truth, in standard errors, it may be.
ACCEPTABLE_P, CLOSE = 0.01, 2.0


@dataclass(frozen=True)
class Rate:
    """A count out of several trials; `least` is the rate that is wanted, None where none is."""

    point: str
    hits: int
    trials: int
    least: float | None = None

    @property
    def value(self) -> float:
        return self.hits / self.trials if self.trials else math.nan

    @property
    def error(self) -> float:
        return fraction_error(self.hits, self.trials)

    @property
    def met(self) -> bool | None:
        """Whether the rate is as wanted; None where nothing is wanted or counted."""
        if self.least is None or not self.trials:
            return None
        return self.value >= self.least

    def __str__(self) -> str:
        if not self.trials:
            return "no trials"
        return f"{self.hits} of {self.trials}: {100 * self.value:.0f} ± {100 * self.error:.0f} %"


def rates(trials: Sequence[dict]) -> list[Rate]:
    """Every point that trials, as `hidden_trials.run_trial` gives them, can answer."""
    single, none, pairs, outsiders, mimics, too_small = (
        [t for t in trials if t["kind"] == kind]
        for kind in ("single", "none", "pairs", "outsiders", "mimic", "too_small")
    )
    right = [t for t in single if t["first"] == t["what"]]
    off = [t for t in right if not _close(t["pulls_before"])]
    spoiled = [t for t in outsiders if t["spoiled"]]

    def rate(point: str, of: Iterable[dict], hit: Callable[[dict], bool], least=None) -> Rate:
        of = list(of)
        return Rate(point, sum(map(hit, of)), len(of), least)

    made = [
        rate("one effect: first place right", single, lambda t: t["first"] == t["what"], 0.9),
        rate("one effect: in the leading group", single, lambda t: t["what"] in t["leading"], 0.97),
        rate("one effect: p > 0.01 after repair", single, _fits_after, 0.9),
        rate("one effect: repair adds it and nothing else", single, _added_just_it),
        rate(f"  first right, repaired: within {CLOSE:g} sigma", right, _close_after),
        rate(f"  the same, unrepaired fit off by more than {CLOSE:g} sigma",
             off, _close_after, 0.85),
        rate(f"  first right, unrepaired: within {CLOSE:g} sigma",
             right, lambda t: _close(t["pulls_before"])),
        rate("nothing hidden: adequate", none, lambda t: t["verdict"] == "adequate", 0.93),
        rate("two effects: both found by repair", pairs, _added_both, 0.7),
        rate("two effects: p > 0.01 after repair", pairs, _fits_after),
        rate("outsiders: unexplained", outsiders, lambda t: t["verdict"] == "unexplained", 0.8),
        rate("outsiders: not adequate", outsiders, lambda t: t["verdict"] != "adequate", 1.0),
        *(
            rate(f"  {what.replace('_', ' ')}: named first among the suspects",
                 [t for t in spoiled if t["what"] == what],
                 lambda t: t["suspects"][:1] == [t["spoiled"]])
            for what in (BAD_READING, SWAPPED_ROWS)
        ),
        rate("  bad reading: named among the suspects",
             [t for t in spoiled if t["what"] == BAD_READING],
             lambda t: t["spoiled"] in t["suspects"], 1.0),
        rate("black spot: said to look like surface_absorption", mimics,
             lambda t: "surface_absorption" in t["leading"]),
        rate("black spot: not adequate", mimics, lambda t: t["verdict"] != "adequate"),
        rate("effect too small to see: adequate, or named", too_small,
             lambda t: t["verdict"] == "adequate" or t["what"] in t["leading"]),
        rate("effect too small to see: limit holds the truth",
             [t for t in too_small if t["limits"]], _limit_holds),
    ]  # fmt: skip
    return [each for each in made if each.trials]


def _fits_after(trial: dict) -> bool:
    return (trial["p_after"] or 0.0) > ACCEPTABLE_P


def _added_just_it(trial: dict) -> bool:
    return trial["added"] == [trial["what"]]


def _added_both(trial: dict) -> bool:
    return {effect for effect, _ in trial["hidden"]} <= set(trial["added"])


def _close(pulls: dict[str, float]) -> bool:
    """Whether alpha_scat and light yield are both near the truth."""
    return max(map(abs, pulls.values())) <= CLOSE


def _close_after(trial: dict) -> bool:
    return _close(trial["pulls_after"])


def _limit_holds(trial: dict) -> bool:
    ((effect, size),) = trial["hidden"]
    limit = trial["limits"][effect]
    if limit["parameter"] is None:
        return not limit["excluded"]
    lower, upper = limit["lower"], limit["upper"]
    # a side without a limit allows everything
    return (lower is None or lower <= size) and (upper is None or size <= upper)


@dataclass(frozen=True)
class Confusion:
    """Who is taken for whom: what was hidden (rows), and what came first (columns).

    By row also how many trials, and in how many what was hidden is in the leading group.
    """

    hidden: tuple[str, ...]
    first: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    trials: tuple[int, ...]
    leading: tuple[int, ...]

    def rows(self) -> Iterator[tuple[str, tuple[int, ...], int, int]]:
        """What was hidden, counts, trials and how many in the leading group."""
        return zip(self.hidden, self.counts, self.trials, self.leading, strict=True)


def confusion(trials: Sequence[dict], order: Sequence[str]) -> Confusion:
    """The matrix of all trials with one effect hidden, or a black spot; effects in this order."""
    counted = [t for t in trials if t["kind"] in ("single", "mimic")]
    pairs = Counter((t["what"], t["first"]) for t in counted)
    hidden = [name for name in (*order, "black_spot") if any(t["what"] == name for t in counted)]
    first = [name for name in order if any(t["first"] == name for t in counted)]
    of = {name: [t for t in counted if t["what"] == name] for name in hidden}
    return Confusion(
        tuple(hidden),
        tuple(first),
        tuple(tuple(pairs[name, other] for other in first) for name in hidden),
        tuple(len(of[name]) for name in hidden),
        tuple(sum(name in t["leading"] for t in of[name]) for name in hidden),
    )


def verdicts(trials: Sequence[dict]) -> list[list[str]]:
    """Verdicts by what was hidden, effects of the catalogue together: a head, then rows."""
    found: dict[str, Counter] = {}
    for trial in trials:
        name = trial["what"] if trial["kind"] in ("outsiders", "mimic") else trial["kind"]
        found.setdefault(name, Counter())[trial["verdict"]] += 1
    words = list(dict.fromkeys(word for counts in found.values() for word in counts))
    rows = [[name, *(str(counts[word] or "") for word in words)] for name, counts in found.items()]
    return [["hidden", *words], *rows]


def as_markdown(trials: Sequence[dict], order: Sequence[str]) -> str:
    """Rates, verdicts and the confusion matrix, as tables for a README."""
    points = (
        (
            each.point.strip(),
            each,
            "" if each.least is None else f"at least {100 * each.least:.0f} %",
        )
        for each in rates(trials)
    )
    head, *rows = verdicts(trials)
    lines = [*markdown(("point", "found", "wanted"), points), "", *markdown(head, rows)]
    matrix = confusion(trials, order)
    if matrix.hidden:
        rows = [
            [f"`{name}`", f"{leading} of {number}"]
            + [
                f"**{n}**" if n and other == name else str(n or "")
                for n, other in zip(counts, matrix.first, strict=True)
            ]
            for name, counts, number, leading in matrix.rows()
        ]
        numbers = [str(1 + n) for n in range(len(matrix.first))]
        lines += ["", *markdown(["hidden", "in the leading group", *numbers], rows)]
        named = ", ".join(f"{n} `{name}`" for n, name in zip(numbers, matrix.first, strict=True))
        lines += ["", f"First place: {named}."]
    return "\n".join(lines) + "\n"


def excess_range(trials: Sequence[dict]) -> tuple[float, float]:
    """Lowest and highest expected excess."""
    excess = [trial["expected_excess"] for trial in trials]
    return float(np.min(excess)), float(np.max(excess))
