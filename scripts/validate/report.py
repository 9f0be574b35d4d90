"""What the validation found: a page in Markdown, its numbers as CSV, and a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from shared import markdown

from mcrim_mitsuba.core.files import write_text
from mcrim_mitsuba.output import figure_style as style
from validate.formulas import SOURCES
from validate.judging import FALSE_ALARM, POWER, TESTS, Judgement, agree, quantile_band

COLUMNS = (
    "program",
    "group",
    "bench",
    "quantity",
    "mitsuba",
    "mitsuba_sigma",
    "other",
    "other_sigma",
    "z",
    "mitsuba_photons",
    "other_photons",
    "scene_hash",
)
#: A `Row` in these.
_cells = attrgetter(
    "program",
    "group",
    "bench",
    "quantity",
    "ours",
    "ours_sigma",
    "other",
    "other_sigma",
    "z",
    "photons",
    "other_photons",
    "scene_hash",
)


@dataclass(frozen=True)
class Row:
    """One quantity of one bench, from Mitsuba (ours) and from another program.

    Fractions of the emitted light: ``eta``, or a fate. A closed form has no photons. `leading`:
    whether this is the one independent number of its bench and program.
    """

    program: str
    group: str
    bench: str
    quantity: str
    ours: float
    ours_sigma: float
    other: float
    other_sigma: float
    photons: int
    other_photons: int
    scene_hash: str
    leading: bool

    @property
    def sigma(self) -> float:
        """Of the difference."""
        return float(np.hypot(self.ours_sigma, self.other_sigma))

    @property
    def z(self) -> float:
        return (self.ours - self.other) / self.sigma


def write_report(
    page: Path, rows: Sequence[Row], judged: Mapping[str, Judgement], provenance: Mapping[str, Any]
) -> None:
    """Write the page, and beside it a picture and its numbers, of the same name.

    The provenance is that of the JSON: ``command``, ``date``, ``seed``; the ``precision`` of eta in
    the other programs, for which they follow ``most_photons`` on one bench at most, or
    ``most_photons_of_beam``; ``versions``; and ``refused``, a program, a bench and why it cannot
    trace it. Raises InputError if a file cannot be written.
    """
    picture = page.with_suffix(".png")
    draw(picture, rows, judged)
    text = style.numbers_text(COLUMNS, map(_cells, rows))
    write_text(style.numbers_beside(picture), text)
    write_text(page, _page(picture.name, rows, judged, provenance))


def verdict(judged: Mapping[str, Judgement]) -> str:
    """One sentence."""
    failed = [
        f"{program} ({', '.join(t for t in TESTS if j.p_values[t] < j.level)})"
        for program, j in judged.items()
        if not j.agrees
    ]
    tested = f"right programs pass this with {100 * (1 - FALSE_ALARM):g} % probability"
    if agree(judged):
        return f"Mitsuba agrees with {_listed(list(judged))}: {tested}."
    return f"Mitsuba DISAGREES with {_listed(failed)}: {tested}."


def summary(judged: Mapping[str, Judgement]) -> list[tuple[str, ...]]:
    """A row of words for each program, under `SUMMARY_HEAD`."""
    return [
        (
            program,
            f"{j.benches}",
            f"{100 * j.median_error:.2g} %",
            f"{j.mean:+.2f} ± {j.mean_error:.2f}",
            f"{j.rms:.2f}",
            *(f"{j.p_values[test]:.2g}" for test in TESTS),
            f"{j.largest:+.2f} of {j.scores}",
            f"{100 * j.shift:+.3f} ± {100 * j.shift_error:.3f} %",
            "yes" if j.agrees else "NO",
        )
        for program, j in judged.items()
    ]


SUMMARY_HEAD = (
    "Mitsuba against",
    "benches",
    "error of each",
    "mean z",
    "rms z",
    *(f"p ({test})" for test in TESTS),
    "largest z",
    "mean shift",
    "agrees",
)


@style.styled
def draw(path: Path, rows: Sequence[Row], judged: Mapping[str, Judgement]) -> None:
    """Sorted z-scores against the normal's quantiles, with the band that holds honest ones."""
    figure = style.canvas(3.9 * len(judged) + 0.4, 4.6)
    for axes, (program, found) in zip(
        np.atleast_1d(figure.subplots(1, len(judged), sharey=True)), judged.items(), strict=True
    ):
        z = np.sort([row.z for row in rows if row.leading and row.program == program])
        expected, lower, upper = quantile_band(len(z))
        honest = f"{100 * (1 - FALSE_ALARM):g} % of honest sets lie within"
        axes.fill_between(expected, lower, upper, color=style.PALE, lw=0, label=honest)
        axes.plot(expected, expected, color=style.GREY, lw=1)
        axes.plot(expected, z, "o", ms=4, color=style.DARK, label="benches")
        axes.set_title(f"Mitsuba − {program}", loc="left")
        axes.set_xlabel("z expected of the standard normal")
        axes.text(
            0.97,
            0.04,
            f"{found.benches} benches\nmean {found.mean:+.2f} ± {found.mean_error:.2f}\n"
            f"rms {found.rms:.2f}\np(χ²) = {found.p_values['chi2']:.2g}",
            transform=axes.transAxes,
            ha="right",
            va="bottom",
        )
        style.open_axes(axes)
    first = figure.axes[0]
    first.set_ylabel("z found: difference of η in its own errors")
    first.legend(loc="upper left", frameon=False, fontsize=9)
    style.save(figure, path)


def _page(
    picture: str, rows: Sequence[Row], judged: Mapping[str, Judgement], provenance: Mapping
) -> str:
    reasons: dict[tuple[str, str], list[str]] = {}
    for program, bench, why in provenance["refused"]:
        reasons.setdefault((program, why), []).append(bench)
    refused = [
        f"- {program}, {len(benches)} benches: {why}."
        + (f" ({'; '.join(benches)})" if len(benches) < 3 else "")
        for (program, why), benches in reasons.items()
    ]
    template = Path(__file__).with_name("page.md").read_text(encoding="utf-8")
    return template.format(
        verdict=verdict(judged),
        stem=Path(picture).stem,
        summary=_lines(markdown(SUMMARY_HEAD, summary(judged))),
        level=next(iter(judged.values())).level,
        false_alarm=100 * FALSE_ALARM,
        noticed=_lines(
            f"- {program}: an error of η common to all benches of {100 * j.noticed_shift:.2g} %, "
            f"or one of {100 * j.noticed_error:.2g} % in a single bench (of median precision), "
            f"with {100 * POWER:g} % probability."
            for program, j in judged.items()
        ),
        **{name: provenance[name] for name in ("command", "date", "seed")},
        precision=100 * provenance["precision"],
        millions=provenance["most_photons"] / 1e6,
        millions_of_beam=provenance["most_photons_of_beam"] / 1e6,
        versions=_lines(f"- {name}: {known}" for name, known in provenance["versions"].items()),
        refused=f"## Not compared\n\n{_lines(refused)}\n\n" if refused else "",
        forms=_lines(f"- *{name}*: {formula}." for name, formula in SOURCES.items()),
        benches="\n\n".join(
            f"## Mitsuba against {program}\n\n{_lines(_benches(rows, program))}"
            for program in judged
        ),
    )


_lines = "\n".join


def _benches(rows: Sequence[Row], program: str) -> list[str]:
    own = [row for row in rows if row.program == program]
    fates: dict[str, list[str]] = {}
    for row in own:
        of_bench = fates.setdefault(row.bench, [])
        if not row.leading:
            of_bench.append(f"{row.quantity} {row.z:+.1f}")
    head = ["bench", "quantity", "Mitsuba", program, "z", "z of other fates"]
    found = [
        (
            row.bench,
            row.quantity,
            f"{row.ours:.5f} ± {row.ours_sigma:.5f}",
            f"{row.other:.5f} ± {row.other_sigma:.5f}",
            f"{row.z:+.2f}",
            ", ".join(fates[row.bench]),
        )
        for row in own
        if row.leading
    ]
    width = len(head) if any(fates.values()) else len(head) - 1
    return markdown(head[:width], [row[:width] for row in found])


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
