"""Raw data described, a campaign's and a laboratory's: every step to numbers with their errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from mcrim_mitsuba.core.rounding import number, p_equals, p_text, pdg
from mcrim_mitsuba.output.description import (
    Cell,
    Column,
    Description,
    Part,
    Sentence,
    Table,
    measured,
    row,
    shown,
    table,
)

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.reduction import Mounting, RawData, ReducedAbsorption
    from mcrim_mitsuba.laboratory.error_budget import CommonValue, ErrorBudget, Uncertain
    from mcrim_mitsuba.laboratory.light_yield import (
        DetectorEfficiency,
        RelativeMeasurement,
        RelativeYield,
    )
    from mcrim_mitsuba.laboratory.peak import Repeated
    from mcrim_mitsuba.laboratory.peak_band import Peak, WidthParts
    from mcrim_mitsuba.optics.absorption import Absorption
    from mcrim_mitsuba.optics.gammas import AttenuationLength
    from mcrim_mitsuba.optics.materials import Material
    from mcrim_mitsuba.output.laboratory_figures import FittedHistogram

_SCATTER = (
    "The error of a reading is the larger of the mountings' scatter and their peaks' own errors; p "
    "below 0.01: mountings differ by more than their peaks' errors, which is usual"
)


def of_reduction(raw: RawData) -> Description:
    """Every step from raw data to readings, efficiency and priors, with its errors."""
    parts: list[Part] = []
    if raw.readings:
        parts += [_peaks(raw), _means(raw), Sentence(_SCATTER)]
    if raw.efficiency is not None:
        efficiency = raw.efficiency.found
        title = "detector efficiency"
        parts += [
            _origins_table(title, _origins("absolute"), efficiency.contributions, efficiency.value),
            Sentence(f"detector efficiency {pdg(efficiency.value, efficiency.sigma)}", strong=True),
        ]
    if raw.absorption is not None:
        parts += _absorption(raw.absorption)
    if raw.source_depth is not None:
        depth = raw.source_depth
        origins = {
            "tabulated cross-sections": depth.tables_sigma_mm,
            "coherent scattering, a stop or not": depth.process_sigma_mm,
        }
        words = (
            f"source depth {pdg(depth.length_mm, depth.sigma_mm)} mm: {depth.energy_keV:g} keV in "
            f"{depth.formula}, {depth.density_g_per_cm3:g} g/cm3"
        )
        title = "where the gammas stop"
        parts += [
            _origins_table(title, _origins("mm"), origins, depth.length_mm),
            Sentence(words, strong=True),
        ]
    return Description("reduction of raw data", tuple(parts), notes=raw.notes)


def _peaks(raw: RawData) -> Table:
    """Every mounting's peak."""
    columns = ("shape", "centroid", "width", "chi2 / ndf", "p")
    rows = (
        (reduced.reading.label, _name(mounting), *_of_peak(mounting.peak, columns))
        for reduced in raw.readings.values()
        for mounting in reduced.mountings
    )
    heads = ("reading", Column("histogram", left=True), *columns)
    return table("peaks of the histograms", heads, rows)


def _name(mounting: Mounting) -> str:
    if not mounting.use:
        return f"{mounting.file.name} (not used)"
    return mounting.file.name + ("" if mounting.consistent else " (far from the others)")


_PEAK: dict[str, Callable[[Peak], str | Cell]] = {
    "centroid": lambda peak: measured(peak.centroid, peak.centroid_sigma),
    "shape": lambda peak: peak.shape,
    "width": lambda peak: measured(peak.width, peak.width_sigma),
    "fitted bins": lambda peak: f"{peak.low:g} to {peak.high:g}",
    "chi2 / ndf": lambda peak: f"{number(peak.chi2)} / {peak.ndf}",
    "p": lambda peak: shown(peak.p_value, p_text),
    "the other shape's": lambda peak: (
        "" if peak.other is None else measured(peak.other.centroid, peak.other.centroid_sigma)
    ),
}


def _of_peak(peak: Peak | None, columns: Sequence[str]) -> list[str | Cell]:
    """Some columns of `_PEAK`."""
    if peak is None:
        return ["no peak", *[""] * (len(columns) - 1)]
    return [_PEAK[name](peak) for name in columns]


def _means(raw: RawData) -> Table:
    """What the mountings of a reading make together."""
    columns = (
        "reading",
        "signal",
        "error by scatter",
        "by the peaks",
        "chi2 / ndf of the mountings",
        "p",
    )
    rows = []
    for reduced in raw.readings.values():
        mean, reading = reduced.combined, reduced.reading
        rows.append(
            row(
                reading.label if reading.use else f"{reading.label} (not used)",
                measured(reading.signal, reading.sigma),
                shown(mean.scatter_sigma, ".2g"),
                shown(mean.internal_sigma, ".2g"),
                f"{number(mean.chi2)} / {mean.ndf}" if mean.ndf else "",
                "" if mean.p_value is None else shown(mean.p_value, p_text),
                strong=not mean.consistent,
            )
        )
    return table("readings", columns, rows)


def _origins_table(
    title: str, columns: Sequence[str], parts: Mapping[str, float], value: float
) -> Table:
    """An error by its origins; relative to the value where there is a third column."""
    rows = (
        (
            origin,
            shown(part, ".2g"),
            Cell(f"{100 * part / value:.2g} %", part / value) if value > 0 else "",
        )[: len(columns)]
        for origin, part in parts.items()
    )
    return table(title, columns, rows)


def _origins(unit: str) -> tuple[str, str, str]:
    return "origin of the error", unit, "relative"


def _absorption(reduced: ReducedAbsorption) -> Iterator[Part]:
    entry, absorption = reduced.entry, reduced.found
    names = [path.name for path in entry.files if path is not None]
    if not names and entry.value is not None:
        names = [pdg(entry.value, entry.transmittance_sigma)]
    rows = (
        (name, shown(alpha, ".3g"))
        for name, alpha in zip(names, absorption.each_per_cm, strict=True)
    )
    yield table("absorption", ("transmittance", "alpha_abs, 1/cm"), rows)
    yield _origins_table("", _origins("1/cm"), _there(absorption), absorption.alpha_abs_per_cm)
    band = (
        ""
        if absorption.spread_band_per_cm is None
        else f"; over the detected light it varies by {absorption.spread_band_per_cm:.2g}"
    )
    yield Sentence(
        f"alpha_abs {pdg(absorption.alpha_abs_per_cm, absorption.sigma)} /cm, internal "
        "transmittance "
        f"{pdg(absorption.internal_transmittance, absorption.internal_transmittance_sigma)} of "
        f"{entry.thickness_mm:g} mm (n = {absorption.n:.4g}){band}",
        strong=True,
    )


def _there(absorption: Absorption) -> dict[str, float]:
    """Contributions to its error that are not 0."""
    return {name: part for name, part in absorption.contributions.items() if part > 0}


# What `mcrim lab` finds.


def of_peaks(
    fitted: Sequence[FittedHistogram],
    combined: Repeated | None,
    notes: Sequence[str],
    widths: Mapping[str, Sequence[WidthParts]],
) -> Description:
    """The main peak of every histogram, what several mountings make together, and the widths."""
    parts: list[Part] = []
    count = sum(histogram.peak is not None for histogram in fitted)
    if count:
        rows = ((histogram.name, *_of_peak(histogram.peak, [*_PEAK])) for histogram in fitted)
        parts.append(table("peaks, photons per event", ("histogram", *_PEAK), rows))
    if combined is not None:
        mean = pdg(combined.mean, combined.sigma)
        parts.append(Sentence(f"mean of {count}: {mean}", strong=True))
        parts.append(
            Sentence(
                f"its error from their scatter {combined.scatter_sigma:.2g}, from the fits "
                f"{combined.internal_sigma:.2g}; chi2 = {number(combined.chi2)}, "
                f"ndf = {combined.ndf}, {p_equals(combined.p_value)}"
                + ("" if combined.consistent else "; the set is inconsistent")
            )
        )
    lines = list(notes)
    if widths:
        parts += _widths(widths)
        lines += [
            f"{name}: counting and gammas that stop {mounting.source} alone would make the peak "
            f"wider than it is, by {mounting.excess:.2g} standard errors: they do not stop so, the "
            "map is of another bench, or the bins are no photoelectrons"
            for name, several in widths.items()
            for mounting in several
            if mounting.excess > _MUCH_TOO_WIDE
        ]
    return Description("peaks of histograms", tuple(parts), notes=tuple(lines))


#: Standard errors by which parts may exceed the whole without a word.
_MUCH_TOO_WIDE = 2.0


def _widths(widths: Mapping[str, Sequence[WidthParts]]) -> tuple[Part, ...]:
    """A row for every peak and place, per cent of the centroid."""
    columns = ("histogram", Column("gammas stop", left=True), "whole", "counting", "place", "rest")

    def cells(parts: WidthParts) -> list[Cell]:
        several = parts.total, parts.counting, parts.place, parts.rest
        return [measured(100.0 * width.fwhm, 100.0 * width.sigma) for width in several]

    rows = (
        row(name, width_parts.source, *cells(width_parts))
        for name, several in widths.items()
        for width_parts in several
    )
    return (
        table("full width at half maximum, % of the centroid, by origin", columns, rows),
        Sentence(
            "In quadrature: photoelectrons that are counted, eta that differs from place to place, "
            "and the rest, which is the crystal's non-proportionality, the tube and electronics."
        ),
    )


def of_efficiency(efficiency: DetectorEfficiency, notes: Sequence[str]) -> Description:
    """A detector's efficiency, and where its error comes from."""
    title = f"detector efficiency {pdg(efficiency.value, efficiency.sigma)}"
    columns = ("where the error comes from", "error", "relative")
    parts = (
        Sentence(f"{title} ({100 * efficiency.sigma / efficiency.value:.2g} %)", strong=True),
        _origins_table("", columns, efficiency.contributions, efficiency.value),
        Sentence(
            f"over the emission the quantum efficiency varies by {efficiency.spread:.2g} (standard "
            "deviation): the mean is for this emission only"
        ),
    )
    return Description("detector efficiency", parts, notes=tuple(notes))


def of_absorption(
    absorption: Absorption, given: Sequence[str], beside: str, notes: Sequence[str]
) -> Description:
    """An absorption coefficient with its errors; `beside` is said of it, where there is a word."""
    internal = pdg(
        100 * absorption.internal_transmittance,
        100 * absorption.internal_transmittance_sigma or None,
    )
    sigma = absorption.sigma or None
    alpha = pdg(absorption.alpha_abs_per_cm, sigma)
    parts: list[Part] = [
        Sentence(f"alpha_abs {alpha} /cm, internal transmittance {internal} %", strong=True)
    ]
    if beside:
        parts.append(Sentence(beside))
    if origins := _there(absorption):
        columns = ("where the error comes from", "error, 1/cm")
        parts.append(_origins_table("", columns, origins, absorption.alpha_abs_per_cm))
    if len(given) > 1:
        pairs = zip(given, (shown(alpha, ".4g") for alpha in absorption.each_per_cm), strict=True)
        parts.append(table("", ("orientation", "alpha, 1/cm"), pairs))
    if absorption.spread_band_per_cm is not None:
        parts.append(
            Sentence(
                f"over the emission the coefficient varies by {absorption.spread_band_per_cm:.2g} "
                "/cm (standard deviation): one number leaves that out, it is no part of the error"
            )
        )
    if sigma is not None:
        parts.append(
            Sentence(
                f"in a campaign: prior = {absorption.alpha_abs_per_cm:.4g}, prior_sigma = "
                f"{sigma:.2g} under [parameters.alpha_abs_per_cm]"
            )
        )
    return Description("absorption of a sample", tuple(parts), notes=tuple(notes))


def of_materials(indices: Mapping[Material, float | None], wavelength_nm: float) -> Description:
    """The catalogue; no number where a wavelength is outside a formula's range."""
    columns = (
        "material",
        f"n, {wavelength_nm:g} nm",
        "range, nm",
        Column("what it is", left=True),
        Column("source", left=True),
    )
    rows = (
        (crystal.name, shown(n, ".5f"), _range_nm(crystal), crystal.what, crystal.source)
        for crystal, n in indices.items()
    )
    return Description("materials", (table("", columns, rows),))


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
    density = crystal.density_g_per_cm3
    if crystal.extraordinary is not None:
        more.append(
            f"ordinary {ordinary:.5f}, extraordinary {ordinary + difference:.5f}, difference "
            f"{difference:+.5f}; n is the mean of all directions and polarisations, "
            "(2 n_o + n_e) / 3"
        )
    more += [
        f"{crystal.name}: {crystal.what}" + (f"; {density:g} g/cm3" if density is not None else ""),
        f"known from {_range_nm(crystal)} nm; source: {crystal.source}",
        scene,
    ]
    parts = (Sentence(first, strong=True), *map(Sentence, more))
    return Description("refractive index", parts, notes=tuple(notes))


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
    parts = (
        Sentence(
            f"attenuation length {pdg(stops.length_mm, stops.sigma_mm)} mm: {stops.per_cm:.4g} /cm "
            f"for {stops.energy_keV:g} keV in {stops.formula} of {stops.density_g_per_cm3:g} g/cm3",
            strong=True,
        ),
        Sentence(f"of the first interactions {', '.join(shares)}"),
        Sentence(
            f"error: {stops.tables_sigma_mm:.2g} mm by the tables, {stops.process_sigma_mm:.2g} mm "
            f"by the coherent scattering, without which it is {stops.without_coherent_mm:.4g} mm"
        ),
        table("", ("depth, mm", "stopped within"), rows),
        Sentence(
            f"K X-rays of {100 * stops.escaping:.2g} % escape with {stops.escaping_keV:.3g} keV: "
            f"unresolved, they lower the centroid by {100 * stops.escape_loss:.2g} %"
        ),
        Sentence(f"source: {SOURCE}"),
    )
    return Description("where gammas stop", parts)


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
    rows = (
        row(
            label,
            measured(signal[0], signal[1] or None),
            measured(eta[0], eta[1] or None),
            Cell(f"{100 * weight:.0f} %", weight),
            *_yield_cells(light),
        )
        for (label, (signal, eta, light)), weight in zip(
            couplings.items(), together.weights, strict=True
        )
    )
    mean = together.mean
    sums = [row("together", "", "", "", *_yield_cells(mean))] if len(couplings) > 1 else []
    parts: list[Part] = [
        table("light yield by Eq. 2, ph/keV", columns, rows, sums),
        contributions_table("error budget", budgets),
    ]
    if together.p_value is not None:
        numbers = f"chi2 = {together.chi2:.2g}, ndf = {together.ndf}, {p_equals(together.p_value)}"
        agree = together.p_value >= _LEAST_P_VALUE
        parts.append(
            Sentence(
                f"The couplings {'agree' if agree else 'DISAGREE'}: {numbers} "
                "(errors that they share do not count)."
                + (
                    ""
                    if agree
                    else " Efficiencies that fit both signals come from `mcrim calibrate`."
                )
            )
        )
    parts.append(
        Sentence(
            f"Y = {pdg(mean.value, mean.sigma or None)} ph/keV "
            f"(±{100 * mean.sigma / mean.value:.0f} %)",
            strong=True,
        )
    )
    return Description("light yield", tuple(parts), notes=tuple(notes))


def _yield_cells(light: Uncertain) -> tuple[Cell, ...]:
    """Yield, its two kinds of errors and both together, ph/keV."""
    errors = (light.statistical_sigma, light.systematic_sigma, light.sigma)
    return shown(light.value, ".3g"), *(shown(sigma, ".2g") for sigma in errors)


def of_relative(
    read: RelativeMeasurement, compared: RelativeYield, budgets: Mapping[str, ErrorBudget]
) -> Description:
    """A light yield by Eq. 7; budgets without what is shared, and with it, come in this order."""
    from mcrim_mitsuba.output.describe_campaign import contributions_table

    rows: list[tuple[str | Cell, ...]] = [
        (
            name.replace("_", " "),
            measured(*given),
            measured(*read.reference[name]),
            "none" if name not in read.shared else f"{100 * read.shared[name]:.3g} %",
        )
        for name, given in read.sample.items()
    ]
    rows.append(("light yield, ph/keV", "", measured(*read.reference_yield), ""))
    light, equal = compared.light_yield, compared.equal_collection
    ignoring, total = (100 * budget.total for budget in budgets.values())
    sharing = "Nothing is said to be shared: the errors of both crystals count in full."
    if names := " and ".join(name.replace("_", " ") for name, part in read.shared.items() if part):
        sharing = (
            f"What sample and reference share ({names}) cancels; without that the error would be "
            f"±{ignoring:.1f} % and not ±{total:.1f} %. The energy cancels too."
        )
    parts = (
        table("both crystals", ("quantity", "sample", "reference", "shared error"), rows),
        contributions_table("error budget", budgets),
        Sentence(f"Y = {pdg(light.value, light.sigma)} ph/keV (±{total:.1f} %)", strong=True),
        Sentence(sharing),
        Sentence(
            f"With equal light collection assumed it would be {equal:.3g} ph/keV, "
            f"{equal / light.value:.2f} times as much; from the signals alone "
            f"{compared.signals_alone:.3g} ph/keV."
        ),
    )
    return Description("light yield beside a reference", parts)
