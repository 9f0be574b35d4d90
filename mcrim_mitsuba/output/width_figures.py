"""Widths of peaks by their origins: a bar for every peak and every place where gammas stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.patches import Patch

from mcrim_mitsuba.laboratory.peak_width import Width, WidthParts
from mcrim_mitsuba.output import figure_style as style

#: Of each part: its name and words, and its colours and those of words on it.
_LOOKS = {
    "counting": ("counted photoelectrons", style.DARK, "white"),
    "place": ("where gammas stop", style.LIGHT, "black"),
    "rest": ("rest: crystal, tube, electronics", "0.78", "black"),
}
#: Per cent of the variance below which a part has no number in it.
_NARROW = 9.0


@style.styled
def draw_widths(widths: Mapping[str, Sequence[WidthParts]]) -> style.Drawing:
    """Shares of the variance, which add, with the full widths at half maximum in them."""
    several = [(name, one) for name, parts in widths.items() for one in parts]
    figure = style.canvas(9.6, 1.5 + 0.55 * len(several))
    axes = figure.subplots()
    longest = 100.0
    for row, (_, one) in enumerate(several):
        left = 0.0
        for part, (_, fill, text) in _LOOKS.items():
            width: Width = getattr(one, part)
            percent = 100.0 * (width.fwhm / one.total.fwhm) ** 2
            axes.barh(row, percent, 0.62, left, color=fill, edgecolor="#222222", lw=0.8)
            if percent >= _NARROW:
                axes.text(left + percent / 2, row, f"{100.0 * width.fwhm:.2g} %", ha="center",
                          va="center", color=text, fontsize=10)  # fmt: skip
            left += percent
        longest = max(longest, left)
    names = [
        f"{style.shortened(name, 26)}, FWHM {100 * one.total.fwhm:.2g} %\n"
        f"{style.shortened(one.source)}: {100 * one.place.fwhm:.2g} %"
        for name, one in several
    ]
    axes.set_yticks(range(len(several)), names, parse_math=False, fontsize=9.5)
    axes.tick_params(axis="y", length=0)
    axes.set(ylim=(len(several) - 0.5, -0.5), xlabel="share of the peak's variance (%)")
    axes.set_xlim(0.0, longest)
    style.open_axes(axes, "x")
    handles = [Patch(fc=fill, ec="#222222", lw=0.8, label=words)
               for words, fill, _ in _LOOKS.values()]  # fmt: skip
    style.legend_of(figure, handles, "upper center", 3, handlelength=1.8)
    parts = ("total", *_LOOKS)
    columns = [f"{part}_fwhm{ending}" for part in parts for ending in ("", "_sigma")]
    rows = [
        (name, one.source,
         *(number for part in parts
           for number in (getattr(one, part).fwhm, getattr(one, part).sigma)))
        for name, one in several
    ]  # fmt: skip
    return style.Drawing(figure, ("histogram", "gammas_stop", *columns), rows)
