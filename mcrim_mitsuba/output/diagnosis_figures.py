"""Effects by what they gain, how the misfit falls while they are added, what comes next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from scipy.special import chdtri

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.rounding import capital, number, p_equals, p_text, percent, probability
from mcrim_mitsuba.inference.candidates import Candidate
from mcrim_mitsuba.inference.diagnose import Diagnosis, FinalStep, RepairStep, final_step
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.output import figure_style as style
from mcrim_mitsuba.output.sentences import (
    ACCEPTABLE_P,
    MOST_PAIRS,
    NO_EFFECTS,
    added_text,
    estimate_text,
    leading_candidates,
    likeliest_first,
    plausibility,
    short_headline,
    size_text,
)

#: Inches of a row.
_PER_ROW = 0.34
#: Inches of the bars without their names: probabilities, gains.
_BARS_WIDTHS = (1.9, 2.9)
#: Inches of a character.
_LABEL_PER_CHARACTER = 0.08
_BARS_WIDTH = sum(_BARS_WIDTHS)
#: Of a line of an effect's title, and of its size.
_LETTERS = 26
_SIZE_LETTERS = 32
#: Height of a size's second line in rows.
_FURTHER_LINE = 0.5
#: Rows that are drawn: the likeliest.
_MOST_ROWS = 8
_OTHERS = "#b9c4d0"
#: What is no effect has a row from here on.
_LEAST_PROBABILITY = 1e-3
#: And so has an effect together with that.
_LEAST_BESIDES = 0.05
#: The axis of gains reaches at least so far.
_LEAST_GAIN = 4.0
#: For losses it reaches so much of that; larger ones are told in digits.
_LOSSES = 0.6
#: Of a candidate, columns of the CSV.
_STATISTICS = (
    "delta_chi2 delta_chi2_sigma chi2 ndf p_value p_gain p_global behind aicc left_out_error"
)


def _ranking_numbers(diagnosis: Diagnosis) -> style.Numbers:
    """A row for each parameter of each effect, or for an effect without; then what is no effect."""
    leading, statistics = leading_candidates(diagnosis), attrgetter(*_STATISTICS.split())
    no_size: list[tuple] = [(None, None, None)]
    rows = [
        (
            candidate.effect,
            candidate in leading,
            diagnosis.probabilities.get(candidate.effect),
            *statistics(candidate),
            *size,
            candidate.plausible,
            candidate.at_bound,
            (candidate.light_yield_ph_per_keV or {}).get("value"),
            " ".join(candidate.mimics),
        )
        for tried in (diagnosis.candidates, diagnosis.pairs)
        for candidate in likeliest_first(diagnosis, tried)
        for size in [(n, e.value, e.sigma) for n, e in candidate.sizes.items()] or no_size
    ]
    of_size = "parameter value sigma plausible at_bound light_yield_ph_per_keV mimics"
    columns = f"effect leading probability {_STATISTICS} {of_size}".split()
    # these have a name and a probability alone
    probabilities, empty = diagnosis.probabilities, [None] * (len(columns) - 3)
    others = (name for name in NO_EFFECTS if name in probabilities)
    rows += [(name, False, probabilities[name], *empty) for name in others]
    return columns, rows


@dataclass(frozen=True)
class _Row:
    """An effect, a pair, or what is no effect and has a probability alone."""

    name: str
    probability: float | None
    leading: bool = False
    candidate: Candidate | None = None

    @property
    def weight(self) -> str:
        return "bold" if self.leading else "normal"

    @property
    def colour(self) -> str:
        return style.DARK if self.leading else _OTHERS


def _rows(diagnosis: Diagnosis) -> list[list[_Row]]:
    """Single effects, among them what is no effect by its probability; pairs: the likeliest."""
    leading, probabilities = leading_candidates(diagnosis), diagnosis.probabilities

    def title(causes: Sequence[str]) -> str:
        titles = (diagnosis.titles.get(cause, NO_EFFECTS.get(cause, cause)) for cause in causes)
        return capital("\n+ ".join(style.in_lines(t, _LETTERS, 2) for t in titles))

    def row(candidate: Candidate) -> _Row:
        p = probabilities.get(candidate.effect)
        return _Row(title(candidate.effects), p, candidate in leading, candidate)

    tried = diagnosis.candidates, diagnosis.pairs
    singles, pairs = (list(map(row, likeliest_first(diagnosis, kind))) for kind in tried)
    del pairs[MOST_PAIRS:]
    for name, words in NO_EFFECTS.items():
        p = probabilities.get(name)
        if p is not None and p >= _LEAST_PROBABILITY and (singles or pairs):
            singles.append(_Row(style.in_lines(capital(words), _LETTERS), p))
    effects = {candidate.effect for candidate in diagnosis.candidates}
    for name, p in probabilities.items():
        causes = name.split(" + ")
        # an effect with something beside it that is none
        if p >= _LEAST_BESIDES and effects & {*causes} and not effects >= {*causes}:
            pairs.append(_Row(title(causes), p))
    likeliest = sorted([*singles, *pairs], key=lambda row: -(row.probability or 0.0))[:_MOST_ROWS]
    return [[row for row in likeliest if row in rows] for rows in (singles, pairs)]


@style.styled
def draw_ranking(diagnosis: Diagnosis, *, brief: bool = False) -> style.Drawing:
    """The likeliest effects and what they gain, single ones above pairs; the others are counted.

    `brief` leaves the sizes to a table elsewhere: it fits a narrow page.
    """
    numbers, (singles, pairs) = _ranking_numbers(diagnosis), _rows(diagnosis)
    rows = [*singles, *pairs]
    tried = len(diagnosis.candidates) + len(diagnosis.pairs)
    if left_out := tried - sum(row.candidate is not None for row in rows):
        rows.append(_Row(f"and {left_out} others, none likelier", None))
    if not rows:
        figure, words = style.canvas(_BARS_WIDTH + 5.6, 1.6), "no effect was tried: "
        _title_ranking(figure, diagnosis)
        figure.text(0.01, 0.3, words + diagnosis.reason, wrap=True, parse_math=False)
        return style.Drawing(figure, *numbers)
    # a row is as high as its effects, and its sizes, have lines
    table = [_beside(row, brief) for row in rows]
    whole = ((row.name, *texts) for row, texts in zip(rows, table, strict=True))
    further_lines = [max(text.count("\n") for text in texts) for texts in whole]
    heights = 1 + _FURTHER_LINE * np.array(further_lines)
    edges = np.cumsum([0.0, *heights])
    places = edges[1:] - heights / 2
    # a title and a text for each row; brief tables have the first column alone
    columns = list(zip(_BESIDE, *table, strict=False))
    widths = [
        _LABEL_PER_CHARACTER * max(len(line) for text in column for line in text.split("\n")) + 0.25
        for column in columns
    ]
    longest = max(len(line) for row in rows for line in row.name.split("\n"))
    room = _LABEL_PER_CHARACTER * longest + 0.4
    wide, high = room + _BARS_WIDTH + sum(widths), 1.8 + _PER_ROW * max(edges[-1], 4)
    parts: dict[str, Any] = {"width_ratios": (*_BARS_WIDTHS, sum(widths)), "sharey": True}
    figure, (chances, bars, beside) = style.axes_of(wide, high, 1, 3, lines="x", **parts)
    _draw_probabilities(chances, places, rows)
    threshold = _draw_threshold(bars, edges, diagnosis.baseline.chi2, rows)
    _draw_gains(bars, places, rows)
    if singles and pairs:
        for axes in (chances, bars, beside):
            axes.axhline(edges[len(singles)], color=style.GREY, lw=0.9, ls=":")
    chances.set_yticks(places, [row.name for row in rows], fontsize=10, parse_math=False)
    for tick, row in zip(chances.get_yticklabels(), rows, strict=True):
        tick.set_fontweight(row.weight)
    chances.set_ylim(edges[-1] + 0.1, -0.1)
    for axes in (chances, bars):
        axes.tick_params(axis="y", length=0)
    bars.tick_params(axis="y", labelleft=False)
    beside.set_axis_off()
    beside.set_xlim(0, sum(widths))
    look: dict[str, Any] = {"fontsize": 9.5, "parse_math": False}
    for (title, *column), left in zip(columns, np.cumsum([0.1, *widths[:-1]]), strict=True):
        beside.text(left, -0.2, title, weight="bold", va="bottom", **look)
        for place, row, text in zip(places, rows, column, strict=True):
            beside.text(left, place, text, va="center", weight=row.weight, **look)
    leading = sum(row.leading for row in rows)
    style.legend_of(figure, _handles(leading, threshold), "lower left", 2 if brief else 4)
    _title_ranking(figure, diagnosis)
    return style.Drawing(figure, *numbers)


_BAR: dict[str, Any] = {"height": 0.62, "edgecolor": style.DARK, "lw": 0.8}
#: Titles of the columns beside the bars.
_BESIDE = "p, fit", "fitted size"


def _beside(row: _Row, brief: bool) -> tuple[str, ...]:
    """Texts of a row in the columns of `_BESIDE`, the first alone if `brief`."""
    if (candidate := row.candidate) is None:  # it is no effect
        return ("",) if brief else ("", "")
    lines = (*size_text(candidate, "\n").split("\n"), plausibility(candidate))
    size = "\n".join(n if len(n) <= _SIZE_LETTERS else n.replace(" = ", "\n= ") for n in lines)
    return (p_text(candidate.p_value),) if brief else (p_text(candidate.p_value), size)


def _draw_probabilities(axes: Axes, places: np.ndarray, rows: Sequence[_Row]) -> None:
    """How likely each row is, with the number at the right of its bar; pairs may have none."""
    for place, row in zip(places, rows, strict=True):
        if (p := row.probability) is not None:
            axes.barh(place, 100 * p, color=row.colour, **_BAR)
            style.text_after_bar(axes, probability(p), (100 * p, place), weight=row.weight)
    axes.set(xlim=(0, 135), xticks=[0, 50, 100], xlabel="probability, %")


def _draw_gains(axes: Axes, places: np.ndarray, rows: Sequence[_Row]) -> None:
    """Falls of chi2 with errors; a loss that leaves gains no room is told in digits alone."""
    pairs = zip(places, rows, strict=True)
    tried = [(place, row, row.candidate) for place, row in pairs if row.candidate is not None]
    gains = [candidate.delta_chi2 + candidate.delta_chi2_sigma for _, _, candidate in tried]
    # as far as the line of the threshold too, if it was drawn
    right = 1.08 * max(*gains, axes.dataLim.x1 if axes.lines else 0.0, _LEAST_GAIN)
    left = -_LOSSES * right
    for place, row, candidate in tried:
        beyond = candidate.delta_chi2 - candidate.delta_chi2_sigma < left
        if beyond:  # a bar that is cut off would be read
            style.text_after_bar(axes, f"χ² rises by {number(-candidate.delta_chi2)}", (0, place))
            continue
        error: dict[str, Any] = {"ecolor": style.WARM, "capsize": 3, "lw": 1.5}
        sigma = candidate.delta_chi2_sigma
        axes.barh(place, candidate.delta_chi2, color=row.colour, xerr=sigma, error_kw=error, **_BAR)
    axes.set_xlim(1.08 * min(0.0, axes.dataLim.x0), right)
    axes.axvline(0, color=style.GREY, lw=0.9)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("fall of χ² when the effect is added")


def _title_ranking(figure: Figure, diagnosis: Diagnosis) -> None:
    baseline = diagnosis.baseline
    fit = f"χ² = {number(baseline.chi2)}, ndf {baseline.ndf}, {p_equals(baseline.p_value)}"
    style.entitle(figure, f"{short_headline(diagnosis)}; without any effect {fit}")


def _handles(leading: int, threshold: bool) -> list[Artist]:
    """The legend's entries: what bars mean by their colours, and what the dashed line is."""
    handles: list[Artist] = [
        Patch(facecolor=_OTHERS, edgecolor=style.DARK, label="others" if leading else "effects"),
        Line2D([], [], color=style.WARM, lw=1.5, marker="|", ms=8, label="simulation's error"),
    ]
    if leading:
        words = "leading: the data cannot tell these apart" if leading > 1 else "leading"
        handles.insert(0, Patch(facecolor=style.DARK, edgecolor=style.DARK, label=words))
    if threshold:
        handles.append(Line2D([], [], label=f"enough for p = {ACCEPTABLE_P:g}", **_THRESHOLD))
    return handles


_THRESHOLD: dict[str, Any] = {"color": "black", "ls": "--", "lw": 1.4}


def _draw_threshold(axes: Axes, edges: np.ndarray, chi2: float, rows: Sequence[_Row]) -> bool:
    """Draw the gain that makes a fit acceptable, by its parameters; say whether one is needed."""
    needed = [
        math.nan
        if row.candidate is None
        else chi2 - float(chdtri(row.candidate.ndf, ACCEPTABLE_P) if row.candidate.ndf > 0 else 0)
        for row in rows
    ]
    if not any(gain > 0 for gain in needed):
        return False
    seen_on_dark_bars = [withStroke(linewidth=3.4, foreground="white")]
    # upright in each row, from its upper edge to its lower one
    x, y = np.repeat(needed, 2), np.repeat(edges, 2)[1:-1]
    axes.plot(x, y, zorder=4, path_effects=seen_on_dark_bars, **_THRESHOLD)
    return True


# The light yield's error now, and after each of the measurements that are proposed.

#: Proposals that are drawn: the best.
_MOST_PROPOSALS = 5


@style.styled
def draw_next(diagnosis: Diagnosis) -> style.Drawing:
    """The light yield's error bar now, and after each of the proposed measurements."""
    averaged, columns = diagnosis.light_yield_averaged, "words value sigma sigma_otherwise".split()
    errors = [
        (new.words, new.light_yield_sigma, new.light_yield_sigma_otherwise)
        for new in diagnosis.next_measurements
        if new.light_yield_sigma is not None
    ]
    if averaged is None or not errors:
        words = "nothing is proposed that would lower the light yield's error"
        return style.sentence_instead(words, (columns, ()))
    value = averaged.value
    rows: list[tuple[str, float, float, float | None]] = [("now", value, averaged.sigma, None)]
    rows += [
        (f"after: {words}", value, value * sigma, value * otherwise if otherwise else None)
        for words, sigma, otherwise in errors[:_MOST_PROPOSALS]
    ]
    names = [style.in_lines(name, 28) for name, *_ in rows]
    figure, axes = style.axes_of(6.4, 1.2 + 0.6 * len(rows), lines="x")
    axes.axvspan(value - averaged.sigma, value + averaged.sigma, color=style.PALE, lw=0)
    for place, (_, _, sigma, otherwise) in enumerate(rows):
        colour = style.DARK if place else style.WARM
        bar: dict[str, Any] = {"color": colour, "capsize": 4}
        if otherwise:
            axes.errorbar(value, place, xerr=otherwise, lw=1.0, ls="", **bar)
        axes.errorbar(value, place, xerr=sigma, fmt="o", ms=6, lw=3.0, **bar)
        end = (value + max(sigma, otherwise or 0.0), place)
        style.text_after_bar(axes, f" ± {percent(sigma / value)}", end)
    style.rows_of_bars(axes, names, fontsize=9.5, parse_math=False)
    axes.margins(x=0.16)
    thin = " (thin: in other outcomes)" if any(row[-1] for row in rows) else ""
    axes.set_xlabel(f"{style.parameter_title(LIGHT_YIELD)},\none standard error{thin}")
    return style.Drawing(figure, columns, rows)


# How the error falls while effects are added one by one, and what the results become.


#: From this chi2 per degree of freedom its axis is logarithmic.
_STEEP = 10.0
#: Width of a character of a step's name, inches.
_STEP_PER_CHARACTER = 0.085


@style.styled
def draw_staircase(steps: Sequence[RepairStep], final: Calibration | None = None) -> style.Drawing:
    """How the misfit falls while effects are added, and what becomes of the light yield.

    The first step is the campaign as it came. The last one is the `final` fit, if it is given: that
    of the mended campaign, its effects simulated together; steps add the effects' responses.
    """
    stairs = list(steps) if final is None else [*steps[:-1], final_step(steps[-1], final)]
    # a step a row: its fit, and three parameters with their errors, empty where it lacks them
    names = "step added final_simulation chi2 ndf delta_chi2_sigma p_value rms_pull left_out_error"
    columns, rows = style.numbers_of(
        stairs, names, final_simulation=lambda step: isinstance(step, FinalStep)
    )
    for name, stem in ((LIGHT_YIELD, "light_yield"), (SCALE, "scale"), (ALPHA_SCAT, "alpha_scat")):
        columns += [name, f"{stem}_sigma"]
        estimates = [step.parameters.get(name) for step in stairs]
        cells = [(e.value, e.sigma) if e else (None, None) for e in estimates]
        rows = [(*row, *pair) for row, pair in zip(rows, cells, strict=True)]
    if len(stairs) == 1:  # dots in empty frames would say no more
        step = stairs[0]
        words = f"nothing was added: χ² = {number(step.chi2)}, ndf {step.ndf}"
        return style.sentence_instead(f"{words}, {p_equals(step.p_value)}", (columns, rows))
    # a campaign without an absolute light yield has a scale
    light_or_scale = LIGHT_YIELD if any(LIGHT_YIELD in s.parameters for s in stairs) else SCALE
    count = 1 + any(light_or_scale in step.parameters for step in stairs)
    width = max(4.6 * count, 2.0 + 1.4 * count * len(stairs))
    figure = style.canvas(width, 4.2)
    panels = style.panels(figure, count, "y", sharex=True)
    _draw_chi2(panels[0], stairs)
    for axes in panels[1:]:
        estimates = [step.parameters.get(light_or_scale) for step in stairs]
        axes.set_title(style.parameter_title(light_or_scale), loc="left", fontsize=11)
        heights = [e.value if e else None for e in estimates]
        # without errors where it is at a bound
        errors = [e.sigma if e and e.at_bound is None else 0.0 for e in estimates]
        _stairs(axes, stairs, heights, [estimate_text(e) if e else "" for e in estimates], errors)
    # as wide as a step of a panel, its part of the figure less its margin
    letters = int((width / count - 0.8) / len(stairs) / _STEP_PER_CHARACTER)
    titles = [style.in_lines(added_text(step), letters, 4) for step in stairs]
    for axes in panels:
        axes.set_xticks(range(len(titles)), titles, fontsize=10, parse_math=False)
        axes.set_xlim(-0.5, len(titles) - 0.5)
    return style.Drawing(figure, columns, rows)


def _draw_chi2(axes: Axes, steps: Sequence[RepairStep]) -> None:
    """chi2 per degree of freedom over the band where a right model's lies in two of three cases."""
    for place, step in enumerate(steps):
        spread = math.sqrt(2 / step.ndf) if step.ndf > 0 else math.nan
        ends, low = [place - 0.5, place + 0.5], max(1 - spread, 0)
        axes.fill_between(ends, low, 1 + spread, color=style.PALE, lw=0)
    heights = [s.chi2 / s.ndf if s.ndf > 0 else math.nan for s in steps]
    highest = max((height for height in heights if math.isfinite(height)), default=1.0)
    if highest > _STEEP:
        axes.set_yscale("log")
    texts = [f"{number(s.chi2)} / {s.ndf}\n{p_equals(s.p_value)}" for s in steps]
    _stairs(axes, steps, heights, texts)
    if highest > _STEEP:
        axes.set_ylim(0.2, 4 * highest)
        axes.yaxis.set_major_formatter("{x:g}")
    else:
        axes.set_ylim(0, 1.3 * axes.dataLim.y1)  # with room for a text above the highest
    axes.set_title("χ² per degree of freedom (band: 1 ± √(2/ndf))", loc="left", fontsize=11)


def _stairs(
    axes: Axes,
    steps: Sequence[RepairStep],
    heights: Sequence[float | None],
    texts: Sequence[str],
    errors: Sequence[float] | None = None,
) -> None:
    """One value per step with its text, at the bottom without a value, joined by a staircase."""
    finite = [math.nan if h is None or not math.isfinite(h) else h for h in heights]
    places = range(len(finite))
    axes.plot(places, finite, color=style.DARK, lw=1.2, drawstyle="steps-mid", zorder=3)
    bar: dict[str, Any] = {"color": style.DARK, "ecolor": style.WARM, "capsize": 4, "lw": 1.6}
    for place, height, step in zip(places, finite, steps, strict=True):
        look: dict[str, Any] = {"fmt": "o", "ms": 7}
        if isinstance(step, FinalStep):
            look = {"fmt": "D", "ms": 8.5, "mfc": "white", "mew": 2}
        error = None if errors is None else errors[place]
        axes.errorbar(place, height, yerr=error, zorder=4, **bar, **look)
    tops = finite if errors is None else [h + e for h, e in zip(finite, errors, strict=True)]
    look = {"textcoords": "offset points", "ha": "center", "fontsize": 9.5, "parse_math": False}
    for place, top, text, step in zip(places, tops, texts, steps, strict=True):
        end = (place, top if math.isfinite(top) else axes.get_ylim()[0])
        above = 9 if isinstance(step, FinalStep) else 7
        axes.annotate(text, end, (0, above), zorder=3.5, bbox=style.paper(0.75, 0.8), **look)
    axes.margins(y=0.28)
