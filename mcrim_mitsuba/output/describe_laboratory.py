"""Raw data described, a campaign's and a laboratory's: every step to numbers with their errors.

What is known of a peak, a mean, an efficiency, an absorption or an attenuation length is worded by
one function, for `mcrim reduce`, `mcrim lab` and the report.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mcrim_mitsuba.core.rounding import number, p_equals, p_text, pdg
from mcrim_mitsuba.output.description import (
    Cell,
    Column,
    Description,
    Piece,
    Table,
    described,
    measured,
    row,
    shown,
    strong,
    table,
)

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.reduction import Mounting, RawData
    from mcrim_mitsuba.laboratory.calibration import ChannelCalibration
    from mcrim_mitsuba.laboratory.energy_scale import Line
    from mcrim_mitsuba.laboratory.error_budget import CommonValue, ErrorBudget, Uncertain
    from mcrim_mitsuba.laboratory.light_yield import DetectorEfficiency, RelativeMeasurement
    from mcrim_mitsuba.laboratory.peak import Repeated
    from mcrim_mitsuba.laboratory.peak_band import Peak, WidthParts
    from mcrim_mitsuba.optics.absorption import Absorption
    from mcrim_mitsuba.optics.gammas import AttenuationLength
    from mcrim_mitsuba.optics.materials import Material
    from mcrim_mitsuba.output.laboratory_figures import FittedHistogram


# Records: each is worded once.


def _per_ndf(fitted: Peak | Repeated) -> str:
    return f"{number(fitted.chi2)} / {fitted.ndf}" if fitted.ndf else ""


_PEAK = (
    Column("shape"),
    Column("centroid", form="±"),
    Column("width", form="±"),
    Column("chi2 / ndf", of=_per_ndf),
    Column("p", form=p_text, of="p_value"),
)
_BELOW = (
    Column("step per bin", form="±", of="step"),
    # their events over those of the peak
    Column(
        "escape lines",
        of=lambda peak: ", ".join(pdg(x.share or 0.0, x.share_sigma or None) for x in peak.lines),
    ),
)
_PEAK_ALONE = (
    Column("fitted bins", of=lambda peak: f"{peak.low:g} to {peak.high:g}"),
    Column("the other shape's", of=lambda peak: _PEAK[1].cell(peak.other) if peak.other else ""),
)
_MEAN = (
    Column("signal", of=lambda mean: measured(mean.mean, mean.sigma)),
    Column("error by scatter", form=".2g", of="scatter_sigma"),
    Column("by the peaks", form=".2g", of="internal_sigma"),
    Column("chi2 / ndf of the mountings", of=_per_ndf),
    Column("p", form=lambda p: "" if p is None else p_text(p), of="p_value"),
)
_SCATTER = (
    "The error of a reading is the larger of the mountings' scatter and their peaks' own errors; p "
    "below 0.01: mountings differ by more than their peaks' errors, which is usual"
)


def histograms_pieces(raw: RawData) -> list[Piece]:
    """The peak of every mounting, and what the mountings of a reading make together."""
    peaks, means = [], []
    for label, reduced in raw.readings.items():
        for mounting in reduced.mountings:
            peaks.append(((Cell(reduced.reading.label), _name(mounting)), mounting.peak))
        means.append((f"{label}{'' if reduced.reading.use else ' (not used)'}", reduced.combined))
    if not raw.readings:
        return []
    heads = ("reading", Column("histogram", left=True))
    return [_peaks("peaks of the histograms", heads, peaks), *_means("readings", "reading", means)]


def calibration_pieces(calibration: ChannelCalibration) -> list[Piece]:
    """What turns channels into photoelectrons: gain, pedestal, ratio of the ranges, errors."""
    fit, pedestal = calibration.gain.fit, calibration.pedestal
    numbers = {"channels per photoelectron": (calibration.gain.value, calibration.gain.sigma)}
    if fit is not None:
        numbers |= {
            "photoelectrons in its spectrum, mean": (fit.mean, fit.mean_sigma),
            "excess noise factor": (fit.excess_noise_factor, fit.excess_noise_factor_sigma),
            "pedestal of its spectrum, channel": (fit.pedestal.position, fit.pedestal.sigma),
        }
        if fit.crosstalk is not None:
            numbers["crosstalk"] = (fit.crosstalk, fit.crosstalk_sigma or 0.0)
        if fit.afterpulsing is not None:
            numbers["afterpulsing"] = (fit.afterpulsing, fit.afterpulsing_sigma or 0.0)
    numbers["ratio of the ranges"] = (calibration.range_ratio, calibration.range_ratio_sigma)
    if calibration.nonlinearity:
        k = (calibration.nonlinearity, calibration.nonlinearity_sigma)
        numbers["nonlinearity, per photoelectron"] = k
    if pedestal is not None:
        numbers["pedestal of the light, channel"] = (pedestal.position, pedestal.sigma)
    rows = [(name, pdg(value, sigma or None)) for name, (value, sigma) in numbers.items()]
    if pedestal is None:
        rows.append(("pedestal of the light", "every spectrum's own"))
    if fit is not None and fit.chi2 is not None:
        rows.append(("chi2 / ndf of single photoelectrons", f"{number(fit.chi2)} / {fit.ndf}"))
    return [
        table("from channels to photoelectrons", ("calibration", Column("", left=True)), rows),
        f"all readings share {100 * calibration.scale_sigma:.2g} % of scale, which is the light "
        f"yield's alone, and {calibration.offset_sigma:.2g} photoelectrons of pedestal",
    ]


def _name(mounting: Mounting) -> str:
    if not mounting.row.use:
        return f"{mounting.file.name} (not used)"
    return mounting.file.name + ("" if mounting.consistent else " (far from the others)")


def _peaks(
    title: str,
    heads: Sequence[str | Column],
    peaks: Iterable[tuple[Sequence[str | Cell], Peak | None]],
    further: tuple[Column, ...] = (),
) -> Table:
    """Peaks below the titles of what stands left of them."""
    peaks = list(peaks)
    columns = (*_PEAK, *further)
    if any(peak and peak.fitted_below for _, peak in peaks):
        columns += _BELOW
    rows = (
        (*left, *(column.cell(peak) for column in columns))
        if peak
        else (*left, "no peak", *[""] * (len(columns) - 1))
        for left, peak in peaks
    )
    return table(title, (*heads, *columns), rows)


def _means(title: str, of: str, means: Iterable[tuple[str, Repeated]]) -> list[Piece]:
    """Means of mountings by name; bold where these are inconsistent."""
    rows = (
        row(name, *(column.cell(mean) for column in _MEAN), strong=not mean.consistent)
        for name, mean in means
    )
    return [table(title, (of, *_MEAN), rows), _SCATTER]


def _origins(title: str, unit: str, parts: Mapping[str, float], value: float) -> Table:
    """An error by its origins, and relative to the value."""
    rows = []
    for origin, part in parts.items():
        relative = Cell(f"{100 * part / value:.2g} %", part / value) if value > 0 else ""
        rows += [(origin, shown(part, ".2g"), relative)] if part > 0 else []
    return table(title, ("origin of the error", unit, "relative"), rows)


def efficiency_pieces(efficiency: DetectorEfficiency) -> list[Piece]:
    """A detector's efficiency, and where its error comes from."""
    value, sigma = efficiency.value, efficiency.sigma
    return [
        strong(f"detector efficiency {pdg(value, sigma)} ({100 * sigma / value:.2g} %)"),
        _origins("detector efficiency", "absolute", efficiency.contributions, value),
        f"over the emission the quantum efficiency varies by {efficiency.spread:.2g} (standard "
        "deviation): the mean is for this emission only",
    ]


def absorption_pieces(
    absorption: Absorption, given: Sequence[str] = (), beside: str = ""
) -> list[Piece]:
    """An absorption coefficient with its errors; `beside` is said of it, where there is a word.

    `given` is how people know the transmittances: by the names of their files unless they say it.
    """
    given = given or [
        *(Path(curve.name).name for curve in absorption.spectra),
        *(pdg(value, absorption.transmittance_sigma) for value in absorption.numbers),
    ]
    alpha, internal_sigma = absorption.alpha_abs_per_cm, absorption.internal_transmittance_sigma
    internal = measured(absorption.internal_transmittance, internal_sigma, 100.0).text
    rows = zip(given, (shown(alpha, ".3g") for alpha in absorption.each_per_cm), strict=True)
    band = absorption.spread_band_per_cm
    varies = f"{band:.2g} /cm (standard deviation)" if band is not None else ""
    return [
        strong(
            f"alpha_abs {pdg(alpha, absorption.sigma)} /cm, internal transmittance {internal} "
            f"% of {absorption.thickness_mm:g} mm (n = {absorption.n:.4g})"
        ),
        beside,
        _origins("absorption", "1/cm", absorption.contributions, alpha),
        table("transmittances", ("transmittance", "alpha_abs, 1/cm"), rows),
        varies
        and f"over the light that it is weighted with the coefficient varies by {varies}: one "
        "number leaves that out, it is no part of the error",
    ]


def depth_pieces(stops: AttenuationLength) -> list[Piece]:
    """How deep gammas get, and where the error of that comes from."""
    origins = {
        "tabulated cross-sections": stops.tables_sigma_mm,
        "coherent scattering, a stop or not": stops.process_sigma_mm,
    }
    return [
        strong(
            f"attenuation length {pdg(stops.length_mm, stops.sigma_mm)} mm: {stops.per_cm:.4g} /cm "
            f"for {stops.energy_keV:g} keV in {stops.formula} of {stops.density_g_per_cm3:g} g/cm3"
        ),
        _origins("where the gammas stop", "mm", origins, stops.length_mm),
        f"without coherent scattering it is {stops.without_coherent_mm:.4g} mm",
    ]


def of_reduction(raw: RawData) -> Description:
    """Every step from raw data to readings, efficiency and priors, with its errors."""
    return described(
        "reduction of raw data",
        calibration_pieces(raw.calibration) if raw.calibration else None,
        histograms_pieces(raw),
        efficiency_pieces(raw.efficiency) if raw.efficiency else None,
        absorption_pieces(raw.absorption) if raw.absorption else None,
        depth_pieces(raw.source_depth) if raw.source_depth else None,
        notes=raw.notes,
    )


# What `mcrim lab` finds.


def of_peaks(
    fitted: Sequence[FittedHistogram],
    combined: Repeated | None,
    notes: Sequence[str],
    widths: Mapping[str, Sequence[WidthParts]],
    calibration: ChannelCalibration | None = None,
    lines: Mapping[str, Sequence[Line]] | None = None,
) -> Description:
    """The main peak of every histogram, what several mountings make together, and the widths."""
    count = sum(histogram.peak is not None for histogram in fitted)
    peaks = (((histogram.name,), histogram.peak) for histogram in fitted)
    title = "peaks, photons per event"
    mean: list[Piece] = []
    if combined is not None:
        mean = _means("together", "histograms", [(f"mean of {count}", combined)])
        mean += [] if combined.consistent else [strong("the set is inconsistent")]
    too_wide = (
        f"{name}: counting and gammas that stop {mounting.source} alone would make the peak wider "
        f"than it is, by {mounting.excess:.2g} standard errors: they do not stop so, the map is of "
        "another bench, or the bins are no photoelectrons"
        for name, several in widths.items()
        for mounting in several
        if mounting.excess > _MUCH_TOO_WIDE
    )
    of_channels = calibration_pieces(calibration) if calibration else None
    of_all = _peaks(title, ("histogram",), peaks, _PEAK_ALONE) if count else None
    further = (lines_pieces(lines) if lines else None, _widths(widths) if widths else None)
    notes = (*notes, *too_wide)
    return described("peaks of histograms", of_channels, of_all, mean, *further, notes=notes)


def lines_pieces(lines: Mapping[str, Sequence[Line]]) -> list[Piece]:
    """Lines of known energies: photons per keV, and their widths by origin."""
    from mcrim_mitsuba.laboratory.energy_scale import intrinsic_width

    heads = "histogram keV photons /keV relative FWHM,% counting,% single,% rest,%".split()
    rows, words = [], []
    for name, of_file in lines.items():
        for line in of_file:
            width = line.width
            parts = (width.total, width.counting, width.place, width.rest)
            of_parts = (measured(part.fwhm, part.sigma, 100.0) for part in parts)
            light = (measured(line.photons, line.photons_sigma), shown(line.per_keV, ".4g"))
            relative = measured(line.relative, line.relative_sigma or None)
            rows.append((name, f"{line.energy_keV:g}", *light, relative, *of_parts))
        if (fit := intrinsic_width(of_file)) is not None:
            intrinsic, counted = fit
            words.append(
                f"{name}: the squares of the widths over 1 / N are a line: intrinsic FWHM "
                f"{measured(intrinsic.fwhm, intrinsic.sigma, 100.0).text} %, {counted:.3g} / N"
            )
    return [
        table("lines: light per energy, and widths by origin", heads, rows),
        "relative: photons per keV over those of the highest energy, which are the crystal's "
        "non-proportionality (and what the readout adds)",
        *words,
    ]


#: Standard errors by which parts may exceed the whole without a word.
_MUCH_TOO_WIDE = 2.0


def _widths(widths: Mapping[str, Sequence[WidthParts]]) -> list[Piece]:
    """A row for every peak and place, per cent of the centroid."""
    columns = ("histogram", Column("gammas stop", left=True), "whole", "counting", "place", "rest")
    rows = []
    for name, parts in ((name, parts) for name, several in widths.items() for parts in several):
        by_origin = (parts.total, parts.counting, parts.place, parts.rest)
        cells = (measured(width.fwhm, width.sigma, 100.0) for width in by_origin)
        rows.append((name, parts.source, *cells))
    return [
        table("full width at half maximum, % of the centroid, by origin", columns, rows),
        "In quadrature: photoelectrons that are counted, eta that differs from place to place, "
        "and the rest, which is the crystal's non-proportionality, the tube and electronics.",
    ]


def of_efficiency(efficiency: DetectorEfficiency) -> Description:
    """A detector's efficiency, and where its error comes from."""
    return described("detector efficiency", efficiency_pieces(efficiency), notes=efficiency.notes)


def of_absorption(
    absorption: Absorption, given: Sequence[str], beside: str, notes: Sequence[str]
) -> Description:
    """An absorption coefficient with its errors, and what a campaign says of it."""
    prior = f"prior = {absorption.alpha_abs_per_cm:.4g}, prior_sigma = {absorption.sigma:.2g}"
    prior = f"in a campaign: {prior} under [parameters.alpha_abs_per_cm]"
    words = (absorption_pieces(absorption, given, beside), prior if absorption.sigma else "")
    return described("absorption of a sample", *words, notes=notes)


def of_materials(indices: Mapping[Material, float | None], wavelength_nm: float) -> Description:
    """The catalogue; no number where a wavelength is outside a formula's range."""
    columns = (Column("what it is", left=True), Column("source", left=True))
    rows = (
        (crystal.name, shown(n, ".5f"), _range_nm(crystal), crystal.what, crystal.source)
        for crystal, n in indices.items()
    )
    heads = ("material", f"n, {wavelength_nm:g} nm", "range, nm", *columns)
    return described("materials", table("", heads, rows))


def of_index(
    crystal: Material,
    lines: Iterable[str],
    ordinary: float,
    difference: float,
    scene: str,
    notes: Sequence[str] = (),
) -> Description:
    """An index: what is `said` of it first, its rays, what the material is, how a scene has it."""
    first, *more = lines
    known = {
        "{:g} g/cm3": crystal.density_g_per_cm3,
        "light about {:g} nm": crystal.emission_nm,
        "decay time {:g} ns": crystal.decay_ns,
    }
    properties = "".join(f"; {words.format(n)}" for words, n in known.items() if n is not None)
    cited = f" ({crystal.properties_source})" if crystal.properties_source else ""
    rays = (
        f"ordinary {ordinary:.5f}, extraordinary {ordinary + difference:.5f}, difference "
        f"{difference:+.5f}; n is the mean of all directions and polarisations, (2 n_o + n_e) / 3"
    )
    what = f"{crystal.name}: {crystal.what}{properties}{cited}"
    source = f"known from {_range_nm(crystal)} nm; source: {crystal.source}"
    words = (more, "" if crystal.extraordinary is None else rays, what, source, scene)
    return described("refractive index", strong(first), *words, notes=notes)


def _range_nm(crystal: Material) -> str:
    shortest, longest = crystal.range_nm
    return f"{shortest:g} to {longest:g}"


def of_gammas(
    stops: AttenuationLength, parts_per_cm: Mapping[str, float], stopped: Mapping[float, float]
) -> Description:
    """How deep gammas get: the length, by processes, and what stops within some depths, mm."""
    from mcrim_mitsuba.optics.gammas import SOURCE

    shares = (f"{100 * p / stops.per_cm:.1f} % are {name}" for name, p in parts_per_cm.items())
    rows = ((f"{depth:g}", Cell(f"{100 * share:.1f} %", share)) for depth, share in stopped.items())
    of_each = f"of the first interactions {', '.join(shares)}"
    within = table("depths", ("depth, mm", "stopped within"), rows)
    escaping = (
        f"K X-rays of {100 * stops.escaping:.2g} % escape with {stops.escaping_keV:.3g} keV: "
        f"unresolved, they lower the centroid by {100 * stops.escape_loss:.2g} %"
    )
    words = (of_each, within, escaping, f"source: {SOURCE}")
    return described("where gammas stop", depth_pieces(stops), *words)


#: p-value below which couplings are said to disagree.
_LEAST_P_VALUE = 0.01


def of_yields(
    couplings: Mapping[str, tuple[tuple[float, float], tuple[float, float], Uncertain]],
    together: CommonValue,
    budgets: Mapping[str, ErrorBudget],
    notes: Sequence[str],
) -> Description:
    """Light yields by Eq. 2 of couplings, by label: signal and eta with errors, and the yield."""
    from mcrim_mitsuba.output.describe_campaign import contributions_table

    columns = ("coupling", "signal", "eta", "weight", "Y", "statistical", "systematic", "total")
    rows = []
    weighted = zip(couplings.items(), together.weights, strict=True)
    for (label, (signal, eta, light)), part in weighted:
        weight = Cell(f"{100 * part:.0f} %", part)
        rows.append((label, measured(*signal), measured(*eta), weight, *_yield_cells(light)))
    mean, agreement = together.mean, ""
    sums = [row("together", "", "", "", *_yield_cells(mean))] if len(couplings) > 1 else []
    if together.p_value is not None:
        agree = together.p_value >= _LEAST_P_VALUE
        agreement = (
            f"The couplings {'agree' if agree else 'DISAGREE'}: chi2 = {together.chi2:.2g}, ndf = "
            f"{together.ndf}, {p_equals(together.p_value)} (errors that they share do not count)."
        )
        if not agree:
            agreement += " Efficiencies that fit both signals come from `mcrim calibrate`."
    yields = table("light yield by Eq. 2, ph/keV", columns, rows, sums)
    budget = contributions_table("error budget", budgets)
    return described("light yield", yields, budget, agreement, _yield(mean), notes=notes)


def _yield_cells(light: Uncertain) -> tuple[Cell, ...]:
    """Yield, its two kinds of errors and both together, ph/keV."""
    errors = (light.statistical_sigma, light.systematic_sigma, light.sigma)
    return shown(light.value, ".3g"), *(shown(sigma, ".2g") for sigma in errors)


def _yield(light: Uncertain) -> Piece:
    relative = 100 * light.sigma / light.value
    return strong(f"Y = {pdg(light.value, light.sigma)} ph/keV (±{relative:.2g} %)")


def of_relative(read: RelativeMeasurement, budgets: Mapping[str, ErrorBudget]) -> Description:
    """A light yield by Eq. 7; budgets without what is shared, and with it, come in this order."""
    from mcrim_mitsuba.output.describe_campaign import contributions_table

    rows: list[tuple[str | Cell, ...]] = []
    for name, given in read.sample.items():
        shared = f"{100 * read.shared[name]:.3g} %" if name in read.shared else "none"
        both = (measured(*given), measured(*read.reference[name]))
        rows.append((name.replace("_", " "), *both, shared))
    rows.append(("light yield, ph/keV", "", measured(*read.reference_yield), ""))
    light, equal = read.light_yield, read.equal_collection
    ignoring, total = (100 * budget.total for budget in budgets.values())
    sharing = "Nothing is said to be shared: the errors of both crystals count in full."
    if names := " and ".join(name.replace("_", " ") for name, part in read.shared.items() if part):
        sharing = (
            f"What sample and reference share ({names}) cancels; without that the error would be "
            f"±{ignoring:.1f} % and not ±{total:.1f} %. The energy cancels too."
        )
    crystals = table("both crystals", ("quantity", "sample", "reference", "shared error"), rows)
    budget = contributions_table("error budget", budgets)
    simpler = (
        f"With equal light collection assumed it would be {equal:.3g} ph/keV, "
        f"{equal / light.value:.2f} times as much; from the signals alone "
        f"{read.signals_alone:.3g} ph/keV."
    )
    words = (crystals, budget, _yield(light), sharing, simpler)
    return described("light yield beside a reference", *words)
