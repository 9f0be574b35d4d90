"""What hidden-effect trials add up to: rates with their errors, and who is taken for whom."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from shared import fraction_error, markdown

from trials.hidden_trials import BAD_READING, FAMILY_OUT, LEFT_OUT, SWAPPED_ROWS

#: Least p-value of a mended campaign, and how far from the truth, in standard errors, it may be.
ACCEPTABLE_P, CLOSE = 0.01, 2.0


class Rate(NamedTuple):
    """A count out of trials, of which there are some; the rate that is wanted, if one is."""

    point: str
    hits: int
    trials: int
    least: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the rate is as wanted; None where nothing is wanted."""
        return None if self.least is None else self.hits / self.trials >= self.least

    def __str__(self) -> str:
        value, error = self.hits / self.trials, fraction_error(self.hits, self.trials)
        return f"{self.hits} of {self.trials}: {100 * value:.0f} ± {100 * error:.0f} %"


def rates(trials: Sequence[dict]) -> list[Rate]:
    """Every point that trials, as `hidden_trials.run_trial` gives them, can answer."""
    single, none, pairs, outsiders, mimics, too_small, beam = (
        [t for t in trials if t["kind"] == kind]
        for kind in ("single", "none", "pairs", "outsiders", "mimic", "too_small", "beam")
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
        rate("one effect: repair adds it and nothing else", single,
             lambda t: t["added"] == [t["what"]]),
        rate(f"  first right, repaired: within {CLOSE:g} sigma", right, _close_after),
        rate(f"  the same, unrepaired fit off by more than {CLOSE:g} sigma",
             off, _close_after, 0.85),
        rate(f"  first right, unrepaired: within {CLOSE:g} sigma",
             right, lambda t: _close(t["pulls_before"])),
        rate("nothing hidden: adequate", none, lambda t: t["verdict"] == "adequate", 0.93),
        rate("two effects: both found by repair", pairs,
             lambda t: {effect for effect, _ in t["hidden"]} <= set(t["added"]), 0.7),
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
        *_of_left_out(trials, rate),
        rate("with a transmittance: haze and roughness told apart", beam, _told_apart, 0.8),
        rate("  first place right", beam, lambda t: t["first"] == t["what"]),
        rate(f"  repaired: within {CLOSE:g} sigma", beam, _close_after),
        rate(f"  unrepaired: within {CLOSE:g} sigma", beam, lambda t: _close(t["pulls_before"])),
    ]  # fmt: skip
    return [each for each in made if each.trials]


def _of_left_out(trials: Sequence[dict], rate: Callable[..., Rate]) -> list[Rate]:
    """Where the truth is in no catalogue: the averaged light yield, and what is said of it."""
    made = []
    for kind, words, least in ((LEFT_OUT, "effect left out", 0.85),
                               (FAMILY_OUT, "family left out", 0.8)):  # fmt: skip
        own = [t for t in trials if t["kind"] == kind]
        made += [
            rate(f"{words}: averaged yield within {CLOSE:g} of its errors", own, _covers, least),
            rate("  within 1 of its errors", own, lambda t: abs(t["averaged"]["pull"]) < 1.0),
            rate("  not adequate", own, lambda t: t["verdict"] != "adequate", 1.0),
            rate("  not a missing effect with a yield that is off", own,
                 lambda t: t["verdict"] != "missing_effect" or _covers(t), 0.97),
        ]  # fmt: skip
    known = [t for t in trials if t["kind"] == "single" and "averaged" in t]
    made.append(rate("one effect: averaged yield within 2 of its errors", known, _covers, 0.9))
    return made


def _covers(trial: dict) -> bool:
    """Whether the averaged light yield is near the truth."""
    return abs(trial["averaged"]["pull"]) < CLOSE


def _fits_after(trial: dict) -> bool:
    return (trial["p_after"] or 0.0) > ACCEPTABLE_P


def _close(pulls: dict[str, float]) -> bool:
    """Whether alpha_scat and light yield are both near the truth."""
    return max(map(abs, pulls.values())) <= CLOSE


def _close_after(trial: dict) -> bool:
    return _close(trial["pulls_after"])


def _told_apart(trial: dict) -> bool:
    """Whether what is hidden leads, and of haze and roughness of all faces the other does not."""
    others = {"surface_haze", "surface_roughness"} - {trial["what"]}
    return trial["what"] in trial["leading"] and others.isdisjoint(trial["leading"])


def _limit_holds(trial: dict) -> bool:
    ((effect, size),) = trial["hidden"]
    limit = trial["limits"][effect]
    if limit["parameter"] is None:
        return not limit["excluded"]
    lower, upper = limit["lower"], limit["upper"]
    # a side without a limit allows everything
    return (lower is None or lower <= size) and (upper is None or size <= upper)


def confusion(
    trials: Sequence[dict], order: Sequence[str]
) -> tuple[list[str], list[tuple[str, int, int, list[int]]]]:
    """Who is taken for whom, of all trials with one effect hidden, or a black spot.

    What came first, in this order (the columns); for each that was hidden its name, in how many
    trials it is in the leading group, how many there are, and how often each came first.
    """
    counted = [t for t in trials if t["kind"] in ("single", "mimic")]
    first = [name for name in order if any(t["first"] == name for t in counted)]
    rows = []
    for name in (*order, "black_spot"):
        if own := [t for t in counted if t["what"] == name]:
            counts = [sum(t["first"] == other for t in own) for other in first]
            rows.append((name, sum(name in t["leading"] for t in own), len(own), counts))
    return first, rows


def as_markdown(trials: Sequence[dict], order: Sequence[str]) -> str:
    """Rates, verdicts by what was hidden, and the confusion matrix, as tables."""
    rows = []
    for each in rates(trials):
        wanted = "" if each.least is None else f"at least {100 * each.least:.0f} %"
        missed = ", NOT met" if each.met is False else ""
        rows.append((each.point.strip(), each, wanted + missed))
    lines = markdown(("point", "found", "wanted"), rows)
    # effects of the catalogue together
    found: dict[str, Counter] = {}
    for trial in trials:
        name = trial["what"] if trial["kind"] in ("outsiders", "mimic", "beam") else trial["kind"]
        found.setdefault(name, Counter())[trial["verdict"]] += 1
    words = list(dict.fromkeys(word for counts in found.values() for word in counts))
    shown = [[name, *(str(counts[word] or "") for word in words)] for name, counts in found.items()]
    lines += ["", *markdown(["hidden", *words], shown)]
    first, matrix = confusion(trials, order)
    if matrix:
        shown = [
            [f"`{name}`", f"{leading} of {number}"]
            + [f"**{n}**" if n and other == name else str(n or "")
               for n, other in zip(counts, first, strict=True)]
            for name, leading, number, counts in matrix
        ]  # fmt: skip
        numbers = [str(1 + n) for n in range(len(first))]
        lines += ["", *markdown(["hidden", "in the leading group", *numbers], shown)]
        named = ", ".join(f"{n} `{name}`" for n, name in zip(numbers, first, strict=True))
        lines += ["", f"First place: {named}."]
    return "\n".join(lines) + "\n"
