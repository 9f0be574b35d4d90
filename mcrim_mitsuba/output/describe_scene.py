"""Results on scenes described: simulations, tables, checks, crosschecks; see `description`.

They stand apart from those on campaigns, whose sentences take half a second to import.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.core.numbers import titled
from mcrim_mitsuba.core.rounding import counted, p_equals, pdg
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
    from mcrim_mitsuba.output.scene_results import (
        CheckResult,
        CrosscheckResult,
        LightResult,
        MapResult,
        SpectrumResult,
        TableResult,
        TimesResult,
    )


#: Of a spectrum, that a table shows.
_MOST_WAVELENGTHS = 9


#: Fates in words; of any medium's absorption too.
_FATES = {
    "absorbed_aperture": "absorbed by the mask",
    "absorbed_reflector": "absorbed by the reflector",
    "absorbed_surface": "lost at a surface",
    "truncated": "under way at the depth limit",
    "lost": "lost by rounding",
}


def fate_words(fate: str) -> str:
    """A fate as in `SimulationResult.budget`, in words: ``absorbed in the crystal``."""
    if fate in _FATES:
        return _FATES[fate]
    medium = fate.removeprefix("absorbed_")
    the = "the " if medium in ("crystal", "gap", "window") else ""
    return f"absorbed in {the}{medium}" if fate != medium else fate


def of_simulation(result: LightResult) -> Description:
    """Efficiency, and what becomes of the light."""
    rows = (
        (Cell(fate_words(fate), fate), shown(part, ".6f"), shown(result.budget_sigma[fate], ".6f"))
        for fate, part in result.budget.items()
        if part > 0
    )
    words = (
        f"{result.photons:,} photons, seed {result.seed}, {result.seconds:.1f} s, "
        f"{result.photons_per_second / 1e6:.2f} million photons/s"
        if result.photons
        else f"no photons, {result.seconds:.2f} s"
    )
    words = f"eta = {pdg(result.eta, result.eta_sigma)}   ({words}, {result.transport})"
    columns = ("fate", "fraction", Column("error", "fraction_sigma"))
    fates = table("where the light ends", columns, rows)
    return Description("light collection efficiency", (Sentence(words), fates), notes=result.notes)


def of_map(mapped: MapResult) -> Description:
    """What the efficiency varies by over the crystal, and what that does to a peak."""
    rows = (
        (
            spread.source,
            measured(spread.eta, spread.eta_sigma),
            Cell(
                pdg(100.0 * spread.relative_rms, 100.0 * spread.relative_rms_sigma),
                100.0 * spread.relative_rms,
                100.0 * spread.relative_rms_sigma,
            ),
            shown(100.0 * spread.fwhm, ".2g"),
        )
        for spread in mapped.gamma_spreads
    )
    percent = Column("rms (%)", "rms_percent"), Column("FWHM (%)", "fwhm_percent")
    columns = (Column("gammas stop", "source"), "eta", *percent)
    cells = " x ".join(str(n) for n in mapped.eta.shape)
    error = float(np.nanmedian(mapped.eta_sigma / mapped.eta))
    words = (
        f"by where light is born: {cells} cells, {mapped.photons:,} photons, {100 * error:.2g} % "
        "error of one; FWHM is what a peak gets from the place alone"
    )
    return Description(
        "map of the light collection efficiency",
        (Sentence(words), table("efficiency where gammas stop", columns, rows)),
    )


def of_spectrum(spectrum: SpectrumResult) -> Description:
    """Means over the light, what one wavelength is off by, and some wavelengths."""
    light, off = spectrum.light, (spectrum.one_wavelength_off, spectrum.one_wavelength_off_sigma)
    eta = pdg(spectrum.eta_detected, spectrum.eta_detected_sigma)
    arriving = _percent(spectrum.efficiency_arriving, spectrum.efficiency_arriving_sigma)
    benches = len(spectrum.nodes_nm)
    simulated = f"{counted(benches, 'simulation')}, {spectrum.photons:,} photons"
    if not spectrum.photons:
        simulated = f"{'a bench' if benches == 1 else f'{benches} benches'} solved by modes"
    lines = [
        f"eta = {eta} of the light as it is {'detected' if light.detected else 'emitted'} "
        f"({simulated})"
    ]
    if light.detected:
        lines += [
            f"eta = {pdg(spectrum.eta_emitted, spectrum.eta_emitted_sigma)} of the light as it is "
            "emitted",
            f"the detector sees {pdg(*arriving)} % of the light that arrives; of all that is "
            f"emitted it would see {100 * spectrum.efficiency_emitted:.4g} % (Eq. 3)",
        ]
    lines.append(
        f"one wavelength, {light.mean_nm:.0f} nm: eta = "
        f"{pdg(spectrum.eta_at_mean, spectrum.eta_at_mean_sigma)}; what is detected would be off "
        f"by {pdg(*_percent(*off))} %"
    )
    count = len(light.wavelength_nm)
    some = set(np.linspace(0, count - 1, _MOST_WAVELENGTHS).astype(int).tolist())
    varying = list(light.parameters)
    rows = (
        row(
            shown(light.wavelength_nm[i], ".0f"),
            *(shown(light.parameters[name][i], ".4g") for name in varying),
            measured(float(spectrum.eta[i]), float(spectrum.eta_sigma[i])),
            hidden=i not in some,
        )
        for i in range(count)
    )
    first = Column("wavelength (nm)", "wavelength_nm")
    columns: list[str | Column] = [first, *(Column(titled(n), n) for n in varying), "eta"]
    notes: tuple[str, ...] = ()
    if spectrum.interpolation_error > 0.0:
        nodes = ", ".join(f"{nm:.0f}" for nm in spectrum.nodes_nm)
        included = ", the noise of the simulations included" if spectrum.photons else ""
        notes = (
            f"{'simulated' if spectrum.photons else 'solved'} at {nodes} nm; between them eta may "
            f"be wrong by {100 * spectrum.interpolation_error:.2g} %{included}",
        )
    parts: list[Part] = [*map(Sentence, lines), table("some wavelengths", columns, rows)]
    return Description("light collection efficiency over wavelengths", tuple(parts), notes=notes)


def _percent(value: float, sigma: float) -> tuple[float, float]:
    return 100.0 * value, 100.0 * sigma


def of_times(times: TimesResult) -> Description:
    """When detected light arrives, in which parts it was, and when the first photons do."""
    numbers = (
        ("mean", measured(times.mean_ps, times.mean_ps_sigma)),
        ("rms", measured(times.rms_ps, times.rms_ps_sigma)),
        ("10 % have arrived", measured(times.begin_ps, times.begin_ps_sigma)),
        ("from 10 to 90 %", measured(times.rise_ps, times.rise_ps_sigma)),
    )
    parts = (
        (
            part.name,
            shown(part.group_index, ".5g"),
            part.origin,
            measured(part.mean_ps, part.mean_ps_sigma),
        )
        for part in times.parts
    )
    emitted = (
        "all emitted at once"
        if times.decay_ns is None
        else (f"emitted with a decay of {times.decay_ns:g} ns")
    )
    words = Sentence(f"arrival of detected light, {emitted}: {times.photons:,} photons followed")
    tables = (
        table("times", ("detected light", "ps"), numbers),
        table(
            "where light is meanwhile",
            ("part", "group index", Column("from", left=True), Column("mean (ps)", "mean_ps")),
            parts,
        ),
        _first_photons(times),
    )
    births = Sentence(
        "light of one event is born everywhere in the crystal, or, as that of a gamma, at one "
        "depth, which is another one in every event"
    )
    below = (births,) if len(times.first) > 1 else ()
    return Description(
        "arrival times of detected light", (words, *tables, *below), notes=times.notes
    )


def _first_photons(times: TimesResult) -> Table:
    """When the first photons of an event are detected, by where its light is born."""
    columns: list[str | Column] = ["photon"]
    values: list[tuple[np.ndarray, np.ndarray]] = []
    for photons in times.first:
        name = photons.born.replace(" ", "_")
        for what in ("mean", "rms"):
            columns.append(Column(f"{photons.born}, {what} (ps)", f"{what}_ps_{name}"))
            values.append((getattr(photons, f"{what}_ps"), getattr(photons, f"{what}_ps_sigma")))
    rows = (
        (
            Cell(str(place + 1), place + 1),
            *(measured(float(value[place]), float(sigma[place])) for value, sigma in values),
        )
        for place in range(len(times.first[0].mean_ps))
    )
    return table(f"first of {times.detected:,} detected photons", columns, rows)


def of_table(tabulated: TableResult, *, written: str | None = None) -> Description:
    """Points of a table; of one that was written to a file what it took alone."""
    parts: tuple[Table, ...] = ()
    if not written:
        rows = (
            (
                *(Cell(f"{v:.5g}" if isinstance(v, float) else str(v), v) for v in at),
                measured(float(eta), float(sigma)),
            )
            for *at, eta, sigma in (point.values() for point in tabulated.rows)
        )
        parts = (table("", (*tabulated.axes, "eta"), rows),)
    spent = (
        f"{tabulated.eta.size} points{f' written to {written}' if written else ''}: "
        + (
            f"{tabulated.photons:,} photons ({tabulated.cached_photons:,} of the cache), "
            if tabulated.photons
            else "no photons, "
        )
        + f"{tabulated.seconds:.1f} s, errors up to "
        f"{100 * tabulated.largest_relative_sigma:.2g} %"
    )
    return Description("table of the light collection efficiency", parts, spent, tabulated.notes)


def of_check(report: CheckResult, *, first: bool = True) -> Description:
    """What a scene means, its faces, and what is wrong with it.

    The command raises the first problem, and shows the others.
    """
    parts: list[Part] = [Sentence(f"- {sentence}") for sentence in report.words]
    if report.interfaces:
        columns = (
            "face",
            "kind",
            "behind it",
            Column("n", "n_behind"),
            "in front of it",
            Column("n", "n_in_front"),
            "line",
        )
        rows = (
            (
                face.surface,
                face.kind,
                face.interior,
                shown(face.n_interior, "g"),
                face.exterior,
                shown(face.n_exterior, "g"),
                shown(face.line, "d"),
            )
            for face in report.interfaces
        )
        parts.append(table("", columns, rows))
    wrong = [
        f"{'also: ' if place else ''}{problem}" for place, problem in enumerate(report.problems)
    ]
    parts += map(Sentence, wrong if first else wrong[1:])
    return Description("check of a scene", tuple(parts), notes=report.notes)


def of_installation(versions: Mapping[str, object]) -> Description:
    """What is installed, by part."""
    rows = ((name, Cell(str(value), value)) for name, value in versions.items())
    words = Sentence("the installation works: a kernel was compiled and run")
    return Description("the installation", (table("", ("part", "found"), rows), words))


def of_crosscheck(compared: CrosscheckResult) -> Description:
    """Every fate from the programs, and whether they agree."""
    from mcrim_mitsuba.reference.crosscheck import FAMILY_LEVEL

    columns: tuple[str | Column, ...] = (
        "quantity",
        "Mitsuba",
        Column("error", "Mitsuba_sigma"),
        "NumPy",
        Column("error", "NumPy_sigma"),
        "z",
    )
    is_solved = any(quantity.modes is not None for quantity in compared.rows)
    if is_solved:
        columns += ("modes", Column("error", "modes_sigma"), Column("z", "modes_z"))
    rows = (
        row(
            Cell(fate_words(quantity.quantity), quantity.quantity),
            *(
                shown(value, ".6f")
                for value in (
                    quantity.mitsuba,
                    quantity.mitsuba_sigma,
                    quantity.numpy,
                    quantity.numpy_sigma,
                )
            ),
            Cell("too few" if quantity.z is None else f"{quantity.z:+.2f}", quantity.z),
            *(
                (
                    shown(quantity.modes, ".6f"),
                    shown(quantity.modes_sigma, ".6f"),
                    shown(quantity.modes_z, "+.2f"),
                )
                if is_solved
                else ()
            ),
        )
        for quantity in compared.rows
    )
    agreement = (
        f"the {'three' if is_solved else 'two'} {'agree' if compared.agrees else 'DISAGREE'}: "
        f"family-wise {p_equals(compared.family_p_value)}, tested at {FAMILY_LEVEL:g}; "
        f"{compared.mitsuba_photons:,} and {compared.numpy_photons:,} photons"
    )
    parts = (table("", columns, rows), Sentence(agreement))
    return Description("Mitsuba beside the NumPy tracer", parts)
