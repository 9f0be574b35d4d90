"""``mcrim lab peak`` and ``histogram``: photons per event, measured or made up."""

from __future__ import annotations

import contextlib
from dataclasses import asdict
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import option
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.files import (
    STDOUT,
    attributes,
    first_duplicates,
    inside,
    refuse_outputs,
    resolved,
    write_text,
)
from mcrim_mitsuba.core.numbers import ENERGIES_KEV, parse_number
from mcrim_mitsuba.output.describe_laboratory import of_peaks
from mcrim_mitsuba.output.registry import VerbResult, laboratory_figures


class _Window(options.Written):
    """``LOW:HIGH`` in photons."""

    name = "low:high"

    def read(self, what: str, text: str) -> tuple[float, float]:
        ends = text.split(":")
        if len(ends) != 2:
            self.fail(f"{text!r} is no window; give two numbers such as 8:24")
        low, high = (parse_number(what, end) for end in ends)
        return low, high


@click.command(short_help="Centroid of the main peak of histograms, photons per event.")
@click.argument("files", nargs=-1, required=True, type=click.Path(), metavar="FILE...")
@option(
    "--shape",
    "auto|counting|gaussian",
    "Of the band. counting: whole photons of a mean number that varies from event to event; "
    "auto: counting for bins of whole numbers, otherwise gaussian.",
    default="auto",
)
@option(
    "--window",
    _Window(),
    "Bins to fit, in photons, or in channels with --calibration (default: chosen about the peak).",
)
@click.option(
    "--step", is_flag=True, help="Fit a continuum too that ends under the peak, as Compton's does."
)
@option(
    "--escape-keV",
    "KEV[:SHARE]",
    "Quantum that leaves the crystal, such as 511 or 17.4:0.05 (may be repeated): a line below the "
    "peak, its events over those of the peak fitted, or this share. Needs --energy-keV.",
    "escapes",
    multiple=True,
)
@option("--energy-keV", options.Number("KEV", *ENERGIES_KEV), "Energy of the peak.", "energy_keV")
@options.file(
    "--calibration",
    "Campaign, or a file with its table [calibration]: FILEs are in channels of a digitiser; how "
    "they become photoelectrons is drawn as NAME_calibration.",
    "calibration_file",
    metavar="FILE.toml",
)
@option(
    "--lines",
    click.STRING,
    "Energies of lines, as 59.5,661.7 in keV, that every FILE has: photons per keV, and "
    "the resolution; drawn as NAME_lines.",
    metavar="keV,keV",
)
@options.file(
    "--map",
    "Map of eta by `mcrim simulate --map`: split the peaks' widths into counted photoelectrons, "
    "where gammas stop, and the rest; drawn as NAME_widths.",
    "map_file",
    metavar="FILE.nc",
)
@options.depth(1e-6, default="1")
@options.deposits
@options.figure("the histograms with their fits")
@options.json_output
def peak(
    files,
    shape,
    window,
    step,
    escapes,
    energy_keV,
    calibration_file,
    lines,
    map_file,
    depth_mm,
    deposits,
    figure,
    json_file,
) -> None:
    """Centroid of the main peak in each histogram, in photons per event.

    \b
    mcrim lab peak air_1.csv air_2.csv air_3.csv air_4.csv --figure air.png

    FILEs hold two columns, bin centre and counts, or one, the photons of every event; with
    --calibration what digitisers write (.Spe, .n42, .chn, .cnf, .mca, .root too). Several are
    mountings of one configuration: their mean is given with the error of their scatter and that
    of the fits. A Gaussian that is fitted to counted photons finds the top of the band, below its
    mean: both centroids are shown.
    """
    from mcrim_mitsuba.campaign.calibration import calibration_of_file
    from mcrim_mitsuba.campaign.editor import calibration_json

    below = _below(escapes, energy_keV, step)
    if lines and (below.step or below.lines):
        problem = "--step or --escape-keV beside --lines, whose neighbours lie below them"
        raise InputError(problem, "fit one peak, with --window about it")
    options.refuse_without_map()
    inputs = [inside(Path(file))[0] for file in files]
    inputs += map(Path, filter(None, (calibration_file, map_file, deposits)))
    further = {"calibration": calibration_file, "lines": lines, "widths": map_file}
    showing.refuse_places(json_file, inputs, figure, *(name for name, of in further.items() if of))
    _refuse_duplicates(files)
    calibration = calibration_of_file(calibration_file) if calibration_file else None
    fitted = _fitted(files, calibration, shape, window, below)
    peaks = {of.name: of.peak for of in fitted if of.peak is not None}
    notes = [f"{name}: {words}" for name, peak in peaks.items() for words in peak.warnings]
    combined, outliers, of_mean = _combined(fitted)
    notes += of_mean
    document = {
        "histograms": [
            {"file": file, "peak": of.peak and _peak_json(of.peak)}
            for file, of in zip(files, fitted, strict=True)
        ],
        "combined": combined and attributes(combined, _OF_MEAN) | {"outliers": outliers},
        "notes": notes,
    }
    pictures = {"histograms": lambda: laboratory_figures.draw_histograms(fitted)}
    if calibration:
        document["calibration"] = calibration_json(calibration)
        notes += calibration.notes
        histograms = [of.histogram for of in fitted]
        pictures["calibration"] = lambda: laboratory_figures.draw_calibration(histograms)
    if widths := _widths(peaks, map_file, depth_mm, deposits):
        pictures["widths"] = lambda: laboratory_figures.draw_widths(widths)
        parts = [(name, width) for name, of_peak in widths.items() for width in of_peak]
        document["widths"] = [{"histogram": name, **asdict(width)} for name, width in parts]
    found, numbers = _lines(fitted, lines)
    if found:
        document["lines"], pictures["lines"] = numbers, lambda: laboratory_figures.draw_lines(found)
    shown = of_peaks(fitted, combined, notes, widths, calibration, found)
    result = VerbResult(kind="peaks", shown=shown, numbers=document, drawings=pictures)
    showing.answer(result, json_file, figure)
    for without in (histogram for histogram in fitted if histogram.peak is None):
        mend = "measure longer, or show where it is with --window"
        if window is not None:
            mend = "let --window have the whole peak, and some background beside it"
        raise InputError("no peak stands out", mend, path=without.histogram.path)


def _fitted(files: tuple[str, ...], calibration, shape: str, window, below) -> list:
    """Histograms by short names with their main peaks."""
    from mcrim_mitsuba.laboratory.calibration import fit_histogram, read_photons, window_of

    names = [Path(file).name for file in files]
    names = names if len(set(names)) == len(names) else list(files)
    fitted = []
    for name, file in zip(names, files, strict=True):
        histogram = read_photons(file, calibration)
        with placed(path=histogram.path):
            within = window_of(histogram, window)
            main = fit_histogram(histogram, shape=shape, window=within, below=below)
        fitted.append(laboratory_figures.FittedHistogram(name, histogram, main))
    return fitted


_OF_LINE = "energy_keV photons photons_sigma per_keV relative relative_sigma width"
_OF_MEAN = "mean sigma scatter_sigma internal_sigma chi2 ndf p_value consistent outliers warnings"


def _lines(fitted: list, energies: str | None) -> tuple[dict, list[dict]]:
    """Lines of these energies by histogram, and the same for JSON; nothing without energies."""
    from mcrim_mitsuba.laboratory.energy_scale import lines_of

    given = [parse_number("--lines", text) for text in energies.split(",")] if energies else []
    if given and (min(given) < ENERGIES_KEV[0] or len(set(given)) < len(given)):
        raise InputError(f"--lines {energies} are no energies", "give each once, in keV, not MeV")
    found = {of.name: lines_of(of.histogram, given) for of in fitted if given}
    return found, [
        {"histogram": name, **attributes(line, _OF_LINE), "peak": _peak_json(line.peak)}
        for name, of_file in found.items()
        for line in of_file
    ]


def _combined(fitted: list):
    """The mean of several mountings, None of one; names of outliers among them, and notes."""
    from mcrim_mitsuba.laboratory.calibration import combined_photons

    peaks = {name: (of, peak) for name, of, peak, _ in fitted if peak is not None}
    if len(peaks) < 2:
        return None, [], []
    combined, _, _ = combined_photons(list(peaks.values()))
    outliers = [list(peaks)[i] for i in combined.outliers]
    notes = list(combined.warnings)
    if outliers:
        notes.append(f"outlier: {', '.join(outliers)}")
    p = combined.p_value
    if combined.consistent and p is not None and p < 0.01:
        notes.append(
            "the mountings scatter by more than the errors of their centroids, as mountings do: "
            "the error of the mean is that of the scatter"
        )
    return combined, outliers, notes


def _widths(
    peaks: dict, map_file: str | None, depth_mm: float, deposits: str | None
) -> dict[str, list]:
    """Parts of each peak's width, for every place where gammas may stop; nothing without a map."""
    if map_file is None:
        return {}
    from mcrim_mitsuba.efficiency.lighting import all_spreads, read_map
    from mcrim_mitsuba.laboratory.peak_band import width_parts

    spreads = all_spreads(read_map(map_file), depth_mm, deposits)
    return {
        name: [
            width_parts(peak, spread.source, spread.relative_rms, spread.relative_rms_sigma)
            for spread in spreads
        ]
        for name, peak in peaks.items()
    }


def _below(escapes: tuple[str, ...], energy_keV: float | None, step: bool):
    """What is fitted below a peak, as the options say it."""
    from mcrim_mitsuba.laboratory.peak_shapes import Below

    quanta = []
    for text in escapes:
        quantum, _, share = text.partition(":")
        number = parse_number("--escape-keV", quantum)
        quanta.append((number, parse_number("its share", share) if share else None))
    below = Below(tuple(quanta), step, energy_keV)
    if len(below.lines) < len(quanta):
        raise InputError("a quantum has more than the energy of the peak", "give less")
    return below


def _refuse_duplicates(files: tuple[str, ...]) -> None:
    """Refuse a file that is given twice, by its name or its content: a mounting counts once."""
    duplicates = first_duplicates([Path(file) for file in files])
    if duplicates is None:
        return
    first, second = (files[place] for place in duplicates)
    same = resolved(Path(first)) == resolved(Path(second))
    problem = "the file is given twice" if same else f"it holds the same bytes as {first}"
    raise InputError(problem, "name each mounting once", path=second)


_OF_PEAK = (
    "shape centroid centroid_sigma width width_sigma intrinsic_spread events chi2 ndf p_value "
    "low high warnings **fitted_below"
)


def _peak_json(main) -> dict:
    """A peak and, without its own `other`, the other shape's."""
    return attributes(main, _OF_PEAK) | {"other": main.other and attributes(main.other, _OF_PEAK)}


#: How files begin that this command made, and may replace.
_OURS = "# SYNTHETIC, not measured: mcrim lab histogram made it"
#: Events of the band, and minutes beside --rate, unless asked otherwise.
_EVENTS = 20_000.0
_MINUTES = 10.0
#: Lines of a list: some ten megabytes.
_MOST_LISTED = 1e6
_MOST_POSITIVE = 1e12


class _Number(options.Written):
    """A number in the range of `laboratory.peak_shapes.RANGES`, or positive."""

    def __init__(self, metavar: str, of: str | None = None, *, percent: bool = False) -> None:
        self.name, self.of, self.percent = metavar, of, percent

    def read(self, what: str, text: str) -> float:
        from mcrim_mitsuba.laboratory.peak_shapes import RANGES

        above, most = RANGES[self.of] if self.of else (True, _MOST_POSITIVE)
        number = options.float_of(what, text, percent=self.percent)
        if not (number > 0 if above else number >= 0) or not number <= most:
            least = "above 0, at most" if above else "from 0 to"
            such = f" or {100 * most:g}%" if self.percent else ""
            self.fail(f"{text!r} is not in its range; give a number {least} {most:g}{such}")
        return number


@click.command(short_help="Synthetic histogram of photons per event.")
@option(
    "--mean",
    _Number("PHOTONS", "mean_photons"),
    "Mean number of photons of the band's events.",
    required=True,
)
@option(
    "--events", _Number("COUNT", "peak_events"), f"Events of the band (default: {_EVENTS:.0f})."
)
@option("--rate", _Number("PER_S"), "Events of the band per second, instead of --events.")
@option(
    "--minutes",
    _Number("MINUTES"),
    f"Time of the measurement, with --rate (default: {_MINUTES:g}).",
)
@option(
    "--spread",
    _Number("FRACTION", "intrinsic_spread", percent=True),
    "Relative standard deviation of an event's light, besides the counting of "
    "its photons: 0.1 or 10%.",
    default="10%",
)
@option(
    "--dark",
    _Number("PHOTONS", "dark_photons"),
    "Mean number of dark counts per event: dark rate times gate; they add to the mean.",
    default=0.0,
)
@click.option(
    "--list",
    "as_list",
    is_flag=True,
    help="Write the photons of every event, one a line, instead of bins.",
)
@options.seed
@options.output("FILE", "CSV to write; - for the screen.", required=True)
@options.json_output
def histogram(mean, events, rate, minutes, spread, dark, as_list, seed, path, json_file) -> None:
    """Write a synthetic histogram of photons per event, as a measurement would fill it.

    \b
    mcrim lab histogram --mean 14.3 --rate 33 --minutes 10 -o trial.csv
    mcrim lab peak trial.csv

    A pedestal of 0.75 events and a continuum of 0.15 events per event of the band come on top;
    both fall off exponentially, with 1.2 and 25 photons.
    """
    from mcrim_mitsuba.laboratory.peak_shapes import RANGES, PhotonSpectrum

    if events is not None and rate is not None:
        raise InputError("both --events and --rate are given", "leave one of them out")
    if minutes is not None and rate is None:
        raise InputError("--minutes is given without --rate", "give --rate, or --events alone")
    refuse_outputs({"--output": path, "--json": json_file})
    _refuse_foreign(path)
    if rate is not None:
        events = rate * 60.0 * (_MINUTES if minutes is None else minutes)
        most = RANGES["peak_events"][1]
        if events > most:
            problem = f"--rate and --minutes make {events:g} events"
            raise InputError(problem, f"let them be {most:g} at most")
    events = _EVENTS if events is None else events
    if as_list and events > _MOST_LISTED:
        problem = f"--list would write a line for each of {events:g} events and more"
        raise InputError(problem, f"list {_MOST_LISTED:.0f} at most, or leave out --list for bins")
    spectrum = PhotonSpectrum(mean, events, spread, dark_photons=dark)
    comments = [
        f"{_OURS} with seed {seed}",
        f"# band: {spectrum.peak_events:g} events, mean {mean:g} photons, "
        f"intrinsic spread {spread:g}",
        f"# pedestal: {spectrum.pedestal_events:g} events, exp(-n/{spectrum.pedestal_photons:g}); "
        f"continuum: {spectrum.continuum_events:g} events, exp(-n/{spectrum.continuum_photons:g})",
        f"# dark counts per event: {dark:g}",
    ]
    if as_list:
        head, rows = "photons", [f"{photons:g}" for photons in spectrum.events(seed)]
    else:
        counts = zip(spectrum.photons(), spectrum.sample(seed), strict=True)
        head, rows = "photons_per_event,events", [f"{n:g},{c:g}" for n, c in counts]
    write_text(path, "\n".join([*comments, head, *rows]) + "\n")
    made_from = attributes(
        spectrum,
        "mean_photons peak_events intrinsic_spread dark_photons pedestal_events "
        "pedestal_photons continuum_events continuum_photons",
    )
    terminal.write_json(json_file, {"kind": "histogram", "version": 1, **made_from, "seed": seed})
    screen = terminal.console(json_file, path)
    if path not in STDOUT:
        screen.line(f"{len(rows)} {'events' if as_list else 'bins'} written to {path}")


def _refuse_foreign(path: str) -> None:
    """Refuse to replace what may be a measurement."""
    file, ours = Path(path), False
    if path in STDOUT or not file.is_file():
        return
    with contextlib.suppress(OSError), file.open("rb") as stream:
        ours = stream.read(len(_OURS)) == _OURS.encode()
    if not ours:
        problem = "--output would replace a file that this command did not make"
        raise InputError(problem, "name another file, or remove this one", path=path)
