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
        found = raw.efficiency.found
        title = "detector efficiency"
        parts += [
            _origins_table(title, _origins("absolute"), found.contributions, found.value),
            Sentence(f"detector efficiency {pdg(found.value, found.sigma)}", strong=True),
        ]
    if raw.absorption is not None:
        parts += _absorption(raw.absorption)
    if raw.source_depth is not None:
        depth = raw.source_depth
        origins = {
            "tabulated cross-sections": depth.tables_sigma_mm,
            "coherent scattering, a stop or not": depth.process_sigma_mm,
        }
        said = (
            f"source depth {pdg(depth.length_mm, depth.sigma_mm)} mm: {depth.energy_keV:g} keV in "
            f"{depth.formula}, {depth.density_g_per_cm3:g} g/cm3"
        )
        title = "where the gammas stop"
        parts += [
            _origins_table(title, _origins("mm"), origins, depth.length_mm),
            Sentence(said, strong=True),
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
    entry, found = reduced.entry, reduced.found
    names = [path.name for path in entry.files if path is not None]
    if not names and entry.value is not None:
        names = [pdg(entry.value, entry.transmittance_sigma)]
    rows = (
        (name, shown(alpha, ".3g")) for name, alpha in zip(names, found.each_per_cm, strict=True)
    )
    yield table("absorption", ("transmittance", "alpha_abs, 1/cm"), rows)
    yield _origins_table("", _origins("1/cm"), _there(found), found.alpha_abs_per_cm)
    band = (
        ""
        if found.spread_band_per_cm is None
        else f"; over the detected light it varies by {found.spread_band_per_cm:.2g}"
    )
    yield Sentence(
        f"alpha_abs {pdg(found.alpha_abs_per_cm, found.sigma)} /cm, internal transmittance "
        f"{pdg(found.internal_transmittance, found.internal_transmittance_sigma)} of "
        f"{entry.thickness_mm:g} mm (n = {found.n:.4g}){band}",
        strong=True,
    )


def _there(found: Absorption) -> dict[str, float]:
    """Contributions to its error that are not 0."""
    return {name: part for name, part in found.contributions.items() if part > 0}


# What `mcrim lab` finds.


def of_peaks(
    fitted: Sequence[FittedHistogram],
    combined: Repeated | None,
    notes: Sequence[str],
    widths: Mapping[str, Sequence[WidthParts]],
) -> Description:
    """The main peak of every histogram, what several mountings make together, and the widths."""
    parts: list[Part] = []
    found = sum(each.peak is not None for each in fitted)
    if found:
        rows = ((each.name, *_of_peak(each.peak, [*_PEAK])) for each in fitted)
        parts.append(table("peaks, photons per event", ("histogram", *_PEAK), rows))
    if combined is not None:
        mean = pdg(combined.mean, combined.sigma)
        parts.append(Sentence(f"mean of {found}: {mean}", strong=True))
        parts.append(
            Sentence(
                f"its error from their scatter {combined.scatter_sigma:.2g}, from the fits "
                f"{combined.internal_sigma:.2g}; chi2 = {number(combined.chi2)}, "
                f"ndf = {combined.ndf}, {p_equals(combined.p_value)}"
                + ("" if combined.consistent else "; the set is inconsistent")
            )
        )
    said = list(notes)
    if widths:
        parts += _widths(widths)
        said += [
            f"{name}: counting and gammas that stop {one.source} alone would make the peak wider "
            f"than it is, by {one.excess:.2g} standard errors: they do not stop so, the map is of "
            "another bench, or the bins are no photoelectrons"
            for name, several in widths.items()
            for one in several
            if one.excess > _MUCH_TOO_WIDE
        ]
    return Description("peaks of histograms", tuple(parts), notes=tuple(said))


#: Standard errors by which parts may exceed the whole without a word.
_MUCH_TOO_WIDE = 2.0


def _widths(widths: Mapping[str, Sequence[WidthParts]]) -> tuple[Part, ...]:
    """A row for every peak and place, per cent of the centroid."""
    columns = ("histogram", Column("gammas stop", left=True), "whole", "counting", "place", "rest")

    def cells(one: WidthParts) -> list[Cell]:
        several = one.total, one.counting, one.place, one.rest
        return [measured(100.0 * each.fwhm, 100.0 * each.sigma) for each in several]

    rows = (
        row(name, one.source, *cells(one)) for name, several in widths.items() for one in several
    )
    return (
        table("full width at half maximum, % of the centroid, by origin", columns, rows),
        Sentence(
            "In quadrature: photoelectrons that are counted, eta that differs from place to place, "
            "and the rest, which is the crystal's non-proportionality, the tube and electronics."
        ),
    )


def of_efficiency(found: DetectorEfficiency, notes: Sequence[str]) -> Description:
    """A detector's efficiency, and where its error comes from."""
    title = f"detector efficiency {pdg(found.value, found.sigma)}"
    columns = ("where the error comes from", "error", "relative")
    parts = (
        Sentence(f"{title} ({100 * found.sigma / found.value:.2g} %)", strong=True),
        _origins_table("", columns, found.contributions, found.value),
        Sentence(
            f"over the emission the quantum efficiency varies by {found.spread:.2g} (standard "
            "deviation): the mean is for this emission only"
        ),
    )
    return Description("detector efficiency", parts, notes=tuple(notes))


def of_absorption(
    found: Absorption, given: Sequence[str], beside: str, notes: Sequence[str]
) -> Description:
    """An absorption coefficient with its errors; `beside` is said of it, where there is a word."""
    internal = pdg(
        100 * found.internal_transmittance, 100 * found.internal_transmittance_sigma or None
    )
    sigma = found.sigma or None
    alpha = pdg(found.alpha_abs_per_cm, sigma)
    parts: list[Part] = [
        Sentence(f"alpha_abs {alpha} /cm, internal transmittance {internal} %", strong=True)
    ]
    if beside:
        parts.append(Sentence(beside))
    if origins := _there(found):
        columns = ("where the error comes from", "error, 1/cm")
        parts.append(_origins_table("", columns, origins, found.alpha_abs_per_cm))
    if len(given) > 1:
        each = zip(given, (shown(alpha, ".4g") for alpha in found.each_per_cm), strict=True)
        parts.append(table("", ("orientation", "alpha, 1/cm"), each))
    if found.spread_band_per_cm is not None:
        parts.append(
            Sentence(
                f"over the emission the coefficient varies by {found.spread_band_per_cm:.2g} /cm "
                "(standard deviation): one number leaves that out, it is no part of the error"
            )
        )
    if sigma is not None:
        parts.append(
            Sentence(
                f"in a campaign: prior = {found.alpha_abs_per_cm:.4g}, prior_sigma = {sigma:.2g} "
                "under [parameters.alpha_abs_per_cm]"
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
        (each.name, shown(n, ".5f"), _range_nm(each), each.what, each.source)
        for each, n in indices.items()
    )
    return Description("materials", (table("", columns, rows),))


def of_index(
    known: Material,
    said: Iterable[str],
    ordinary: float,
    difference: float,
    scene: str,
    notes: Sequence[str] = (),
) -> Description:
    """An index: what is `said` of it first, its rays, what the material is, how a scene has it."""
    first, *more = said
    density = known.density_g_per_cm3
    if known.extraordinary is not None:
        more.append(
            f"ordinary {ordinary:.5f}, extraordinary {ordinary + difference:.5f}, difference "
            f"{difference:+.5f}; n is the mean of all directions and polarisations, "
            "(2 n_o + n_e) / 3"
        )
    more += [
        f"{known.name}: {known.what}" + (f"; {density:g} g/cm3" if density is not None else ""),
        f"known from {_range_nm(known)} nm; source: {known.source}",
        scene,
    ]
    parts = (Sentence(first, strong=True), *map(Sentence, more))
    return Description("refractive index", parts, notes=tuple(notes))


def _range_nm(known: Material) -> str:
    shortest, longest = known.range_nm
    return f"{shortest:g} to {longest:g}"


def of_gammas(
    found: AttenuationLength, parts_per_cm: Mapping[str, float], stopped: Mapping[float, float]
) -> Description:
    """How deep gammas get: the length, by processes, and what stops within some depths, mm."""
    from mcrim_mitsuba.optics.gammas import SOURCE

    shares = (f"{100 * p / found.per_cm:.1f} % are {name}" for name, p in parts_per_cm.items())
    rows = ((f"{depth:g}", Cell(f"{100 * share:.1f} %", share)) for depth, share in stopped.items())
    parts = (
        Sentence(
            f"attenuation length {pdg(found.length_mm, found.sigma_mm)} mm: {found.per_cm:.4g} /cm "
            f"for {found.energy_keV:g} keV in {found.formula} of {found.density_g_per_cm3:g} g/cm3",
            strong=True,
        ),
        Sentence(f"of the first interactions {', '.join(shares)}"),
        Sentence(
            f"error: {found.tables_sigma_mm:.2g} mm by the tables, {found.process_sigma_mm:.2g} mm "
            f"by the coherent scattering, without which it is {found.without_coherent_mm:.4g} mm"
        ),
        table("", ("depth, mm", "stopped within"), rows),
        Sentence(
            f"K X-rays of {100 * found.escaping:.2g} % escape with {found.escaping_keV:.3g} keV: "
            f"unresolved, they lower the centroid by {100 * found.escape_loss:.2g} %"
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
            *_yield_cells(found),
        )
        for (label, (signal, eta, found)), weight in zip(
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


def _yield_cells(known: Uncertain) -> tuple[Cell, ...]:
    """Yield, its two kinds of errors and both together, ph/keV."""
    errors = (known.statistical_sigma, known.systematic_sigma, known.sigma)
    return shown(known.value, ".3g"), *(shown(sigma, ".2g") for sigma in errors)


def of_relative(
    read: RelativeMeasurement, found: RelativeYield, budgets: Mapping[str, ErrorBudget]
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
    known, equal = found.light_yield, found.equal_collection
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
        Sentence(f"Y = {pdg(known.value, known.sigma)} ph/keV (±{total:.1f} %)", strong=True),
        Sentence(sharing),
        Sentence(
            f"With equal light collection assumed it would be {equal:.3g} ph/keV, "
            f"{equal / known.value:.2f} times as much; from the signals alone "
            f"{found.signals_alone:.3g} ph/keV."
        ),
    )
    return Description("light yield beside a reference", parts)
