"""``mcrim lab peak``: centroids of histograms, and the mean of repeated mountings."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.core.errors import InputError, closest
from mcrim_mitsuba.core.files import resolved
from mcrim_mitsuba.core.numbers import parse_number
from mcrim_mitsuba.core.rounding import number, p_text, pdg
from mcrim_mitsuba.output.described import table

_SHAPES = ("auto", "counting", "gaussian")


class _Window(click.ParamType):
    """``LOW:HIGH`` in photons."""

    name = "window"

    def convert(self, value, param, ctx) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        ends = value.split(":")
        if len(ends) != 2:
            self.fail(f"{value!r} is no window; give two numbers such as 8:24")
        low, high = (parse_number(param.opts[0], end) for end in ends)
        return low, high


@click.command(short_help="Centroid of the main peak of histograms, photons per event.")
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option(
    "--shape", default="auto", show_default=True, metavar="|".join(_SHAPES),
    help="Of the band. counting: whole photons of a mean number that varies from event to event; "
    "auto: counting for bins of whole numbers, otherwise gaussian.",
)  # fmt: skip
@click.option(
    "--window", type=_Window(), metavar="LOW:HIGH",
    help="Bins to fit, in photons (default: chosen about the peak).",
)  # fmt: skip
@options.figure("the histograms with their fits")
@options.json_output
def peak(files, shape, window, figure, json_file) -> None:
    """Centroid of the main peak in each histogram, in photons per event.

    \b
    mcrim lab peak air_1.csv air_2.csv air_3.csv air_4.csv --figure air.png

    FILEs hold two columns, bin centre and counts, or one, the photons of every event. Several are
    mountings of one configuration: their mean is given with the error of their scatter and that
    of the fits. A Gaussian that is fitted to counted photons finds the top of the band, below its
    mean: both centroids are shown.
    """
    from mcrim_mitsuba.laboratory.histogram import read_histogram
    from mcrim_mitsuba.laboratory.peak import combine
    from mcrim_mitsuba.output.laboratory_figures import FittedHistogram, draw_histograms

    if shape not in _SHAPES:
        meant = closest(shape, _SHAPES)
        raise InputError(
            f"--shape {shape} is not known",
            f"did you mean {meant}?" if meant else f"give one of {', '.join(_SHAPES)}",
        )
    showing.refuse_places(json_file, files, figure)
    _refuse_twins(files)
    fitted = [
        FittedHistogram(name, histogram, _fit(histogram, shape, window))
        for name, histogram in zip(
            _names(files), [read_histogram(file) for file in files], strict=True
        )
    ]
    peaks = {each.name: each.peak for each in fitted if each.peak is not None}
    without = [each for each in fitted if each.peak is None]
    combined = None
    if len(peaks) > 1:
        combined = combine(
            [each.centroid for each in peaks.values()],
            [each.centroid_sigma for each in peaks.values()],
        )
    notes = [f"{name}: {warning}" for name, one in peaks.items() for warning in one.warnings]
    if combined is not None:
        notes += _notes(combined, list(peaks))
    terminal.write_json(
        json_file,
        {
            "histograms": [
                {"file": file, **_peak_json(each.peak)}
                for file, each in zip(files, fitted, strict=True)
            ],
            "combined": None if combined is None else _combined_json(combined, list(peaks)),
            "notes": notes,
        },
    )
    drawn = draw_histograms(fitted).save(figure) if figure else ()
    screen = terminal.console(json_file)
    if peaks:
        _show(screen, fitted)
    if combined is not None:
        _show_mean(screen, combined, len(peaks))
    showing.say_drawn(screen, drawn)
    screen.say_notes(notes)
    if without:
        raise InputError(
            "no peak stands out",
            "measure longer, or show where it is with --window" if window is None
            else "let --window have the whole peak, and some background beside it",
            path=without[0].histogram.path,
        )  # fmt: skip


def _fit(histogram, shape, window):
    from mcrim_mitsuba.laboratory.peak import fit_peak

    try:
        return fit_peak(histogram.photons, histogram.counts, shape=shape, window=window)
    except InputError as error:
        raise InputError(error.problem, error.mend, path=histogram.path) from None


def _names(files: tuple[str, ...]) -> list[str]:
    """Names of the files; with their folders where names alone are the same."""
    names = [Path(file).name for file in files]
    return names if len(set(names)) == len(names) else list(files)


def _refuse_twins(files: tuple[str, ...]) -> None:
    """A mounting counts once."""
    from mcrim_mitsuba.core.files import first_duplicates

    duplicates = first_duplicates([Path(file) for file in files])
    if duplicates is None:
        return
    first, second = (files[place] for place in duplicates)
    same = resolved(Path(first)) == resolved(Path(second))
    raise InputError(
        "the file is given twice" if same else f"it holds the same bytes as {first}",
        "name each mounting once", path=second,
    )  # fmt: skip


def _show(screen, fitted) -> None:
    columns = ("histogram", "centroid", "shape", "width", "fitted bins", "chi2 / ndf", "p",
               "the other shape's")  # fmt: skip
    rows = ((each.name, *_cells(each.peak)) for each in fitted)
    screen.show(table("peaks, photons per event", columns, rows))


def _cells(one) -> tuple[str, ...]:
    if one is None:
        return "no peak", *[""] * 6
    return (
        pdg(one.centroid, one.centroid_sigma), one.shape, pdg(one.width, one.width_sigma),
        f"{one.low:g} to {one.high:g}", f"{number(one.chi2)} / {one.ndf}", p_text(one.p_value),
        "" if one.other is None else pdg(one.other.centroid, one.other.centroid_sigma),
    )  # fmt: skip


def _show_mean(screen, combined, count: int) -> None:
    screen.line(f"mean of {count}: {pdg(combined.mean, combined.sigma)}", style="bold")
    screen.line(
        f"its error from their scatter {combined.scatter_sigma:.2g}, from the fits "
        f"{combined.internal_sigma:.2g}; chi2 = {number(combined.chi2)}, ndf = {combined.ndf}, "
        f"p = {p_text(combined.p_value)}"
        + ("" if combined.consistent else "; the set is inconsistent")
    )


def _notes(combined, names: list[str]) -> list[str]:
    notes = list(combined.warnings)
    if combined.outliers:
        notes.append(f"outlier: {', '.join(names[i] for i in combined.outliers)}")
    if combined.consistent and combined.p_value < 0.01:
        notes.append(
            "the mountings scatter by more than the errors of their centroids, as mountings do: "
            "the error of the mean is that of the scatter"
        )
    return notes


def _peak_json(one) -> dict:
    """A peak and, without its own `other`, the other shape's."""
    if one is None:
        return {"peak": None}
    return {"peak": _fields(one) | {"other": None if one.other is None else _fields(one.other)}}


def _fields(one) -> dict:
    return {
        "shape": one.shape, "centroid": one.centroid, "centroid_sigma": one.centroid_sigma,
        "width": one.width, "width_sigma": one.width_sigma,
        "intrinsic_spread": one.intrinsic_spread, "events": one.events, "chi2": one.chi2,
        "ndf": one.ndf, "p_value": one.p_value, "low": one.low, "high": one.high,
        "warnings": one.warnings,
    }  # fmt: skip


def _combined_json(combined, names: list[str]) -> dict:
    return {
        "mean": combined.mean, "sigma": combined.sigma, "scatter_sigma": combined.scatter_sigma,
        "internal_sigma": combined.internal_sigma, "chi2": combined.chi2, "ndf": combined.ndf,
        "p_value": combined.p_value, "consistent": combined.consistent,
        "outliers": [names[i] for i in combined.outliers], "warnings": combined.warnings,
    }  # fmt: skip
