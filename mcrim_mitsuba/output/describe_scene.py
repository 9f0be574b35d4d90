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
    found = (
        f"{result.photons:,} photons, seed {result.seed}, {result.seconds:.1f} s, "
        f"{result.photons_per_second / 1e6:.2f} million photons/s"
        if result.photons
        else f"no photons, {result.seconds:.2f} s"
    )
    found = f"eta = {pdg(result.eta, result.eta_sigma)}   ({found}, {result.transport})"
    columns = ("fate", "fraction", Column("error", "fraction_sigma"))
    fates = table("where the light ends", columns, rows)
    return Description("light collection efficiency", (Sentence(found), fates), notes=result.notes)


def of_map(mapped: MapResult) -> Description:
    """What the efficiency varies by over the crystal, and what that does to a peak."""
    rows = (
        (
            one.source,
            measured(one.eta, one.eta_sigma),
            Cell(
                pdg(100.0 * one.relative_rms, 100.0 * one.relative_rms_sigma),
                100.0 * one.relative_rms,
                100.0 * one.relative_rms_sigma,
            ),
            shown(100.0 * one.fwhm, ".2g"),
        )
        for one in mapped.gamma_spreads
    )
    percent = Column("rms (%)", "rms_percent"), Column("FWHM (%)", "fwhm_percent")
    columns = (Column("gammas stop", "source"), "eta", *percent)
    cells = " x ".join(str(n) for n in mapped.eta.shape)
    error = float(np.nanmedian(mapped.eta_sigma / mapped.eta))
    said = (
        f"by where light is born: {cells} cells, {mapped.photons:,} photons, {100 * error:.2g} % "
        "error of one; FWHM is what a peak gets from the place alone"
    )
    return Description(
        "map of the light collection efficiency",
        (Sentence(said), table("efficiency where gammas stop", columns, rows)),
    )


def of_spectrum(found: SpectrumResult) -> Description:
    """Means over the light, what one wavelength is off by, and some wavelengths."""
    light, off = found.light, (found.one_wavelength_off, found.one_wavelength_off_sigma)
    eta = pdg(found.eta_detected, found.eta_detected_sigma)
    arriving = _percent(found.efficiency_arriving, found.efficiency_arriving_sigma)
    benches = len(found.nodes_nm)
    simulated = f"{counted(benches, 'simulation')}, {found.photons:,} photons"
    if not found.photons:
        simulated = f"{'a bench' if benches == 1 else f'{benches} benches'} solved by modes"
    said = [
        f"eta = {eta} of the light as it is {'detected' if light.detected else 'emitted'} "
        f"({simulated})"
    ]
    if light.detected:
        said += [
            f"eta = {pdg(found.eta_emitted, found.eta_emitted_sigma)} of the light as it is "
            "emitted",
            f"the detector sees {pdg(*arriving)} % of the light that arrives; of all that is "
            f"emitted it would see {100 * found.efficiency_emitted:.4g} % (Eq. 3)",
        ]
    said.append(
        f"one wavelength, {light.mean_nm:.0f} nm: eta = "
        f"{pdg(found.eta_at_mean, found.eta_at_mean_sigma)}; what is detected would be off by "
        f"{pdg(*_percent(*off))} %"
    )
    count = len(light.wavelength_nm)
    some = set(np.linspace(0, count - 1, _MOST_WAVELENGTHS).astype(int).tolist())
    varying = list(light.parameters)
    rows = (
        row(
            shown(light.wavelength_nm[i], ".0f"),
            *(shown(light.parameters[name][i], ".4g") for name in varying),
            measured(float(found.eta[i]), float(found.eta_sigma[i])),
            hidden=i not in some,
        )
        for i in range(count)
    )
    first = Column("wavelength (nm)", "wavelength_nm")
    columns: list[str | Column] = [first, *(Column(titled(n), n) for n in varying), "eta"]
    notes: tuple[str, ...] = ()
    if found.interpolation_error > 0.0:
        nodes = ", ".join(f"{each:.0f}" for each in found.nodes_nm)
        included = ", the noise of the simulations included" if found.photons else ""
        notes = (
            f"{'simulated' if found.photons else 'solved'} at {nodes} nm; between them eta may be "
            f"wrong by {100 * found.interpolation_error:.2g} %{included}",
        )
    parts: list[Part] = [*map(Sentence, said), table("some wavelengths", columns, rows)]
    return Description("light collection efficiency over wavelengths", tuple(parts), notes=notes)


def _percent(value: float, sigma: float) -> tuple[float, float]:
    return 100.0 * value, 100.0 * sigma


def of_times(found: TimesResult) -> Description:
    """When detected light arrives, in which parts it was, and when the first photons do."""
    numbers = (
        ("mean", measured(found.mean_ps, found.mean_ps_sigma)),
        ("rms", measured(found.rms_ps, found.rms_ps_sigma)),
        ("10 % have arrived", measured(found.begin_ps, found.begin_ps_sigma)),
        ("from 10 to 90 %", measured(found.rise_ps, found.rise_ps_sigma)),
    )
    parts = (
        (
            one.name,
            shown(one.group_index, ".5g"),
            one.origin,
            measured(one.mean_ps, one.mean_ps_sigma),
        )
        for one in found.parts
    )
    columns: list[str | Column] = ["photon"]
    for one in found.first:
        name = one.born.replace(" ", "_")
        columns += [
            Column(f"{one.born}, mean (ps)", f"mean_ps_{name}"),
            Column(f"{one.born}, rms (ps)", f"rms_ps_{name}"),
        ]
    values = [
        pair
        for one in found.first
        for pair in ((one.mean_ps, one.mean_ps_sigma), (one.rms_ps, one.rms_ps_sigma))
    ]
    first = (
        (
            Cell(str(place + 1), place + 1),
            *(measured(float(value[place]), float(sigma[place])) for value, sigma in values),
        )
        for place in range(len(found.first[0].mean_ps))
    )
    emitted = (
        "all emitted at once"
        if found.decay_ns is None
        else (f"emitted with a decay of {found.decay_ns:g} ns")
    )
    said = Sentence(f"arrival of detected light, {emitted}: {found.photons:,} photons followed")
    tables = (
        table("times", ("detected light", "ps"), numbers),
        table(
            "where light is meanwhile",
            ("part", "group index", Column("from", left=True), Column("mean (ps)", "mean_ps")),
            parts,
        ),
        table(f"first of {found.detected:,} detected photons", columns, first),
    )
    births = Sentence(
        "light of one event is born everywhere in the crystal, or, as that of a gamma, at one "
        "depth, which is another one in every event"
    )
    below = (births,) if len(found.first) > 1 else ()
    return Description(
        "arrival times of detected light", (said, *tables, *below), notes=found.notes
    )


def of_table(made: TableResult, *, written: str | None = None) -> Description:
    """Points of a table; of one that was written to a file what it took alone."""
    parts: tuple[Table, ...] = ()
    if not written:
        rows = (
            (
                *(Cell(f"{v:.5g}" if isinstance(v, float) else str(v), v) for v in at),
                measured(float(eta), float(sigma)),
            )
            for *at, eta, sigma in (one.values() for one in made.rows)
        )
        parts = (table("", (*made.axes, "eta"), rows),)
    spent = (
        f"{made.eta.size} points{f' written to {written}' if written else ''}: "
        + (
            f"{made.photons:,} photons ({made.cached_photons:,} of the cache), "
            if made.photons
            else "no photons, "
        )
        + f"{made.seconds:.1f} s, errors up to "
        f"{100 * made.largest_relative_sigma:.2g} %"
    )
    return Description("table of the light collection efficiency", parts, spent, made.notes)


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


def of_installation(found: Mapping[str, object]) -> Description:
    """What is installed, by part."""
    rows = ((name, Cell(str(value), value)) for name, value in found.items())
    said = Sentence("the installation works: a kernel was compiled and run")
    return Description("the installation", (table("", ("part", "found"), rows), said))


def of_crosscheck(found: CrosscheckResult) -> Description:
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
    is_solved = any(one.modes is not None for one in found.rows)
    if is_solved:
        columns += ("modes", Column("error", "modes_sigma"), Column("z", "modes_z"))
    rows = (
        row(
            Cell(fate_words(one.quantity), one.quantity),
            *(
                shown(value, ".6f")
                for value in (one.mitsuba, one.mitsuba_sigma, one.numpy, one.numpy_sigma)
            ),
            Cell("too few" if one.z is None else f"{one.z:+.2f}", one.z),
            *(
                (shown(one.modes, ".6f"), shown(one.modes_sigma, ".6f"), shown(one.modes_z, "+.2f"))
                if is_solved
                else ()
            ),
        )
        for one in found.rows
    )
    agreement = (
        f"the {'three' if is_solved else 'two'} {'agree' if found.agrees else 'DISAGREE'}: "
        f"family-wise {p_equals(found.family_p_value)}, tested at {FAMILY_LEVEL:g}; "
        f"{found.mitsuba_photons:,} and {found.numpy_photons:,} photons"
    )
    parts = (table("", columns, rows), Sentence(agreement))
    return Description("Mitsuba beside the NumPy tracer", parts)
