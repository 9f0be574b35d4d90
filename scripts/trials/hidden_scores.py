"""What hidden-effect trials add up to: rates with their errors, and who is taken for whom."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from shared import fraction_error, markdown

from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import WRONG
from trials.hidden_trials import (
    ADVICE,
    FAMILY_OUT,
    INSTRUMENT_IN_TURN,
    LEFT_OUT,
    NUMBERS,
    NUMBERS_FAMILY,
    NUMBERS_OUT,
    OUTSIDERS,
)

#: Least p-value of a mended campaign, and how far from the truth, in standard errors, it may be.
ACCEPTABLE_P, CLOSE = 0.01, 2.0
#: How much larger than that of who knows what is hidden the averaged yield's error may be.
MOST_COST = 1.3


class Rate(NamedTuple):
    """A count out of trials, of which there are some; the rates that are wanted, if any are."""

    point: str
    hits: int
    trials: int
    least: float | None = None
    most: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the rate is as wanted; None where nothing is wanted."""
        if self.least is None:
            return None
        return self.least <= self.hits / self.trials <= (1.0 if self.most is None else self.most)

    @property
    def wanted(self) -> str:
        """The same in words; empty where nothing is wanted."""
        if self.least is None:
            return ""
        missed = "" if self.met else ", NOT met"
        if self.most is None:
            return f"at least {100 * self.least:.0f} %{missed}"
        return f"{100 * self.least:.0f} to {100 * self.most:.0f} %{missed}"

    def __str__(self) -> str:
        value, error = self.hits / self.trials, fraction_error(self.hits, self.trials)
        return f"{self.hits} of {self.trials}: {100 * value:.0f} ± {100 * error:.0f} %"


def rates(trials: Sequence[dict]) -> list[Rate]:
    """Every point that trials, as `hidden_trials.run_trial` gives them, can answer."""

    def of(kind: str) -> list[dict]:
        return [t for t in trials if t["kind"] == kind]

    single, pairs, instrument, outsiders, too_small, beam = map(
        of, ("single", "pairs", "instrument", "outsiders", "too_small", "beam")
    )
    right = [t for t in single if t["first"] == t["what"]]
    off = [t for t in right if not _close(t["pulls_before"])]
    advised = [t for t in of(ADVICE) if t["advice"] is not None]
    known = [t["known"] for t in of(LEFT_OUT)]

    def rate(point: str, among: Iterable[dict], hit: Callable[[dict], bool], *wanted) -> Rate:
        among = list(among)
        return Rate(point, sum(map(hit, among)), len(among), *wanted)

    made = [
        rate("one effect: first place right", single, lambda t: t["first"] == t["what"], 0.9),
        rate("one effect: leads, or its family", single, _leads, 0.97),
        rate("one effect: 95 % of the averaged yield hold it", single, _covers, 0.9),
        rate("one effect: p > 0.01 after repair", single, _fits_after),
        rate(
            "one effect: repair adds it and nothing else",
            single,
            lambda t: t["added"] == [t["what"]],
        ),
        rate(f"  first right, repaired: within {CLOSE:g} sigma", right, _close_after),
        rate(f"  the same, unrepaired fit off by more than {CLOSE:g} sigma", off, _close_after),
        rate(
            f"  first right, unrepaired: within {CLOSE:g} sigma",
            right,
            lambda t: _close(t["pulls_before"]),
        ),
        rate("nothing hidden: adequate", of("none"), lambda t: t["verdict"] == "adequate", 0.95),
        rate(
            "nothing hidden, masks at the crystal's edge under thick gaps: adequate",
            of("edge"),
            lambda t: t["verdict"] == "adequate",
            0.95,
        ),
        rate("two effects: both lead, or nothing else does", pairs, _no_other, 0.9),
        rate("two effects: 95 % of the averaged yield hold it", pairs, _covers, 0.85),
        rate(
            "two effects: both found by repair",
            pairs,
            lambda t: {effect for effect, _ in t["hidden"]} <= set(t["added"]),
        ),
        rate("instrument: named, with its rows", instrument, _instrument_named, 0.85),
        *(
            rate(
                f"  {what.replace('_', ' ')}",
                [t for t in instrument if t["what"] == what],
                _instrument_named,
            )
            for what in INSTRUMENT_IN_TURN
        ),
        rate("instrument: 95 % of the averaged yield hold it", instrument, _covers, 0.9),
        rate("outsiders: 95 % of the averaged yield hold it", outsiders, _covers),
        rate("outsiders: not adequate", outsiders, lambda t: t["verdict"] != "adequate", 1.0),
        rate(
            "outsiders: not a missing effect with a yield that is off", outsiders, _no_false_claim
        ),
        rate(
            "effect too small to see: adequate, or named",
            too_small,
            lambda t: t["verdict"] == "adequate" or t["what"] in t["leading"],
        ),
        rate(
            "effect too small to see: limit holds the truth",
            [t for t in too_small if t["limits"]],
            _limit_holds,
        ),
        *_of_left_out(of(LEFT_OUT), "effect left out", rate, 0.85),
        rate(
            "  the same campaigns, the effect known: 95 % of the averaged yield hold it",
            known,
            _covers,
            0.9,
        ),
        *_of_left_out(of(FAMILY_OUT), "family left out", rate, 0.8),
        rate("a number of the bench: leads", of(NUMBERS), _number_leads, 0.85),
        rate(
            "a number of the bench: 95 % of the averaged yield hold it", of(NUMBERS), _covers, 0.92
        ),
        *_of_left_out(of(NUMBERS_OUT), "number left out", rate, 0.85),
        rate(
            "advice followed: light yield's error as promised within 30 %",
            advised,
            lambda t: abs(t["advice"]["after"] / t["advice"]["promised"] - 1.0) < 0.3,
            0.8,
        ),
        rate(
            "advice followed: the effect leads",
            advised,
            lambda t: t["what"] in t["advice"]["leading"],
            0.85,
        ),
        rate(
            "advice followed: 95 % of the averaged yield hold it",
            advised,
            lambda t: _covers(t["advice"]),
        ),
        rate("with a transmittance: haze and roughness told apart", beam, _told_apart, 0.8),
        rate("  first place right", beam, lambda t: t["first"] == t["what"]),
        rate(f"  repaired: within {CLOSE:g} sigma", beam, _close_after),
        rate(f"  unrepaired: within {CLOSE:g} sigma", beam, lambda t: _close(t["pulls_before"])),
    ]
    return [each for each in made if each.trials]


def _of_left_out(
    own: Sequence[dict], words: str, rate: Callable[..., Rate], least: float
) -> list[Rate]:
    """Where the truth is in no catalogue: the averaged light yield, and what is said of it."""
    return [
        rate(f"{words}: 95 % of the averaged yield hold it", own, _covers, least),
        rate("  68 % of it hold it", own, lambda t: t["averaged"]["in_68"], 0.55, 0.8),
        rate("  not adequate", own, lambda t: t["verdict"] != "adequate", 1.0),
        rate("  not a missing effect with a yield that is off", own, _no_false_claim, 0.97),
    ]


def cost_of_caution(trials: Sequence[dict]) -> tuple[float, float] | None:
    """Median relative errors of the averaged yield and of the fit that knows what is hidden.

    Of campaigns that are diagnosed with the whole catalogue; None without any.
    """
    known = [t["known"] for t in trials if t["kind"] == LEFT_OUT]
    if not known:
        return None
    return (
        statistics.median(t["averaged"]["relative_sigma"] for t in known),
        statistics.median(t["right_relative_sigma"] for t in known),
    )


def _leads(trial: dict) -> bool:
    """Whether what is hidden is in the leading group, or its family is the likeliest."""
    families = trial["families"]
    family = (
        NUMBERS_FAMILY if trial["what"].startswith(WRONG) else catalogue()[trial["what"]].family
    )
    return trial["what"] in trial["leading"] or bool(families and families[0][0] == family)


def _number_leads(trial: dict) -> bool:
    """Whether the number is in the leading group, by itself or with others of its values."""
    number = trial["what"].partition("=")[0]
    return any(name.partition("=")[0] == number for name in trial["leading"])


def _no_other(trial: dict) -> bool:
    hidden = {effect for effect, _ in trial["hidden"]}
    sets = trial["leading_sets"]
    return not sets or any(set(each) == hidden for each in sets)


def _instrument_named(trial: dict) -> bool:
    if trial["spoiled"]:
        return trial["spoiled"] in trial["suspects"]
    return trial["what"] in trial["leading"]


def _no_false_claim(trial: dict) -> bool:
    return trial["verdict"] != "missing_effect" or _covers(trial)


def _covers(trial: dict) -> bool:
    """Whether the interval with 95 % of the averaged light yield holds the truth."""
    return trial["averaged"]["in_95"]


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
    """Who is taken for whom, of all trials with one effect hidden, or what is in no catalogue.

    What came first, in this order (the columns); for each that was hidden its name, in how many
    trials it is in the leading group, how many there are, and how often each came first.
    """
    counted = [t for t in trials if t["kind"] in ("single", "outsiders")]
    first = [name for name in order if any(t["first"] == name for t in counted)]
    rows = []
    for name in (*order, *OUTSIDERS):
        if own := [t for t in counted if t["what"] == name]:
            counts = [sum(t["first"] == other for t in own) for other in first]
            rows.append((name, sum(name in t["leading"] for t in own), len(own), counts))
    return first, rows


def as_markdown(trials: Sequence[dict], order: Sequence[str]) -> str:
    """Rates, verdicts by what was hidden, and the confusion matrix, as tables."""
    rows = []
    for each in rates(trials):
        rows.append((each.point.strip(), each, each.wanted))
    if (cost := cost_of_caution(trials)) is not None:
        averaged, right = (100 * sigma for sigma in cost)
        found_cost = f"{averaged:.2g} % and {right:.2g} %: {averaged / right:.2f} times"
        rows.append(
            (
                "median error of the averaged yield, and of the fit that knows what is hidden",
                found_cost,
                f"at most {MOST_COST:g} times",
            )
        )
    lines = markdown(("point", "found", "wanted"), rows)
    # effects of the catalogue together
    found: dict[str, Counter] = {}
    for trial in trials:
        name = (
            trial["what"] if trial["kind"] in ("instrument", "outsiders", "beam") else trial["kind"]
        )
        found.setdefault(name, Counter())[trial["verdict"]] += 1
    words = list(dict.fromkeys(word for counts in found.values() for word in counts))
    shown = [[name, *(str(counts[word] or "") for word in words)] for name, counts in found.items()]
    lines += ["", *markdown(["hidden", *words], shown)]
    first, matrix = confusion(trials, order)
    if matrix:
        shown = [
            [f"`{name}`", f"{leading} of {number}"]
            + [
                f"**{n}**" if n and other == name else str(n or "")
                for n, other in zip(counts, first, strict=True)
            ]
            for name, leading, number, counts in matrix
        ]
        numbers = [str(1 + n) for n in range(len(first))]
        lines += ["", *markdown(["hidden", "in the leading group", *numbers], shown)]
        named = ", ".join(f"{n} `{name}`" for n, name in zip(numbers, first, strict=True))
        lines += ["", f"First place: {named}."]
    return "\n".join(lines) + "\n"
