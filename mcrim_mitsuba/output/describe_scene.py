"""Results on scenes described as tables and sentences: simulations, tables, checks, crosschecks.

They stand apart from those on campaigns, whose sentences take half a second to import. A `Cell` is
a text with the number behind it and its error; a `Column` says what it shows of a record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcrim_mitsuba.core.numbers import said, titled
from mcrim_mitsuba.core.rounding import counted, p_equals, pdg
from mcrim_mitsuba.output.description import (
    Cell,
    Column,
    Description,
    Table,
    described,
    listed,
    measured,
    records,
    row,
    shown,
    table,
)

if TYPE_CHECKING:
    from mcrim_mitsuba.efficiency.attenuation import Attenuation
    from mcrim_mitsuba.output import scene_results as results
    from mcrim_mitsuba.scene.check_text import Interface


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


def of_simulation(result: results.LightResult) -> Description:
    """Efficiency, and what becomes of the light; it may have been computed without photons."""
    work = f"no photons, {result.seconds:.2f} s"
    if result.photons:
        rate = f"{result.photons_per_second / 1e6:.2f} million photons/s"
        work = f"{result.photons:,} photons, seed {result.seed}, {result.seconds:.1f} s, {rate}"
    fates = (
        (Cell(fate_words(fate), fate), shown(part, ".6f"), shown(result.budget_sigma[fate], ".6f"))
        for fate, part in result.budget.items()
        if part > 0
    )
    columns = ("fate", "fraction", Column("error", "fraction_sigma"))
    eta = f"eta = {pdg(result.eta, result.eta_sigma)}   ({work}, {result.transport})"
    etas, sigmas = result.eta_by_detector, result.eta_by_detector_sigma
    of_each = ", ".join(f"{name}: {pdg(etas[name], sigmas[name])}" for name in etas)
    ends = table("where the light ends", columns, fates)
    return described("light collection efficiency", eta, of_each, ends, notes=result.notes)


_SPREADS = (
    Column("gammas stop", "source"),
    Column("eta", form="±"),
    Column(
        "rms (%)", "rms_percent", of=lambda s: measured(s.relative_rms, s.relative_rms_sigma, 100.0)
    ),
    Column("FWHM (%)", "fwhm_percent", of=lambda spread: shown(100.0 * spread.fwhm, ".2g")),
)


def of_map(mapped: results.MapResult) -> Description:
    """What the efficiency varies by over the crystal, and what that does to a peak."""
    cells = " x ".join(str(n) for n in mapped.eta.shape)
    error = float(np.nanmedian(mapped.eta_sigma / mapped.eta))
    return described(
        "map of the light collection efficiency",
        f"by where light is born: {cells} cells, {mapped.photons:,} photons, {100 * error:.2g} % "
        "error of one; FWHM is what a peak gets from the place alone",
        records("efficiency where gammas stop", _SPREADS, mapped.gamma_spreads),
    )


def of_spectrum(spectrum: results.SpectrumResult) -> Description:
    """Means over the light, what one wavelength is off by, and wavelengths, some of them seen."""
    light, count = spectrum.light, len(spectrum.light.wavelength_nm)
    seen = set(np.linspace(0, count - 1, _MOST_WAVELENGTHS).astype(int).tolist())
    rows = []
    for i in range(count):
        values = (shown(of_light[i], ".4g") for of_light in light.parameters.values())
        eta = measured(float(spectrum.eta[i]), float(spectrum.eta_sigma[i]))
        rows.append(row(shown(light.wavelength_nm[i], ".0f"), *values, eta, hidden=i not in seen))
    parameters = (Column(titled(name), name) for name in light.parameters)
    columns = (Column("wavelength (nm)", "wavelength_nm"), *parameters, "eta")
    notes = [*light.notes]
    if spectrum.interpolation_error > 0.0:
        nodes = ", ".join(f"{nm:.0f}" for nm in spectrum.nodes_nm)
        included = ", the noise of the simulations included" if spectrum.photons else ""
        notes.append(
            f"{'simulated' if spectrum.photons else 'solved'} at {nodes} nm; between them eta may "
            f"be wrong by {100 * spectrum.interpolation_error:.2g} %{included}"
        )
    title, some = "light collection efficiency over wavelengths", "some wavelengths"
    return described(title, _means(spectrum), table(some, columns, rows), notes=notes)


def _means(spectrum: results.SpectrumResult) -> list[str]:
    """The efficiency of the whole light, as detected and as emitted, and of one wavelength."""
    light, benches = spectrum.light, len(spectrum.nodes_nm)
    work = f"{counted(benches, 'simulation')}, {spectrum.photons:,} photons"
    if not spectrum.photons:
        work = f"{'a bench' if benches == 1 else f'{benches} benches'} solved by modes"
    lines = [
        f"eta = {pdg(spectrum.eta_detected, spectrum.eta_detected_sigma)} of the light as it is "
        f"{'detected' if light.detected else 'emitted'} ({work})"
    ]
    if light.detected:
        arriving = measured(spectrum.efficiency_arriving, spectrum.efficiency_arriving_sigma, 100.0)
        lines += [
            f"eta = {pdg(spectrum.eta_emitted, spectrum.eta_emitted_sigma)} of the light as it is "
            "emitted",
            f"the detector sees {arriving.text} % of the light that arrives; of all that is "
            f"emitted it would see {100 * spectrum.efficiency_emitted:.4g} % (Eq. 3)",
        ]
    off = measured(spectrum.one_wavelength_off, spectrum.one_wavelength_off_sigma, 100.0)
    return [
        *lines,
        f"one wavelength, {light.mean_nm:.0f} nm: eta = "
        f"{pdg(spectrum.eta_at_mean, spectrum.eta_at_mean_sigma)}; what is detected would be off "
        f"by {off.text} %",
    ]


#: Of the times, what they are, and the attribute; its error ends in _sigma.
_TIMES = {
    "mean": "mean_ps",
    "rms": "rms_ps",
    "10 % have arrived": "begin_ps",
    "from 10 to 90 %": "rise_ps",
}
_PARTS = (
    Column("part", of="name"),
    Column("group index", form=".5g", of="group_index"),
    Column("from", of="origin", left=True),
    Column("mean (ps)", "mean_ps", "±"),
)


def of_times(times: results.TimesResult) -> Description:
    """When detected light arrives, in which parts it was, and when the first photons do."""
    decay = times.decay_ns
    emitted = "all emitted at once" if decay is None else f"emitted with a decay of {decay:g} ns"
    rows = (
        (words, measured(getattr(times, name), getattr(times, f"{name}_sigma")))
        for words, name in _TIMES.items()
    )
    births = (
        "light of one event is born everywhere in the crystal, or, as that of a gamma, at one "
        "depth, which is another one in every event"
    )
    what = f"arrival of detected light, {emitted}: {times.photons:,} photons followed"
    parts = records("where light is meanwhile", _PARTS, times.parts)
    tables = (table("times", ("detected light", "ps"), rows), parts, _first_photons(times))
    pieces = (what, *tables, births if len(times.first) > 1 else "")
    return described("arrival times of detected light", *pieces, notes=times.notes)


def _first_photons(times: results.TimesResult) -> Table:
    """When the first photons of an event are detected: mean and rms by where its light is born."""
    columns: list[str | Column] = ["photon"]
    cells: list[list[Cell]] = []
    for photons in times.first:
        name = photons.born.replace(" ", "_")
        for what in ("mean", "rms"):
            columns.append(Column(f"{photons.born}, {what} (ps)", f"{what}_ps_{name}"))
            of_photons = (getattr(photons, f"{what}_ps"), getattr(photons, f"{what}_ps_sigma"))
            cells.append(list(map(measured, *(values.tolist() for values in of_photons))))
    rows = ((shown(i, "d"), *of_photon) for i, of_photon in enumerate(zip(*cells, strict=True), 1))
    return table(f"first of {times.detected:,} detected photons", columns, rows)


def _lengths(fits: Sequence[Attenuation]) -> Table:
    """Attenuation lengths, and where in the table, if it has more axes than the place."""
    where = Column(
        "where", of=lambda fit: ", ".join(map(said, *zip(*fit.parameters.items(), strict=True)))
    )
    columns = (
        Column("light", of="light"),
        *([where] if fits[0].parameters else []),
        Column("length (mm)", "length_mm", "±"),
        Column(
            "largest departure (%)",
            "departure_percent",
            of=lambda fit: shown(100.0 * fit.departure, ".2g"),
        ),
    )
    return records("attenuation lengths, along z", columns, fits)


def of_table(tabulated: results.TableResult, *, written: str | None = None) -> Description:
    """The points of a table and what it took, or that alone if it was written to a file."""

    def axis(name: str) -> Column:
        def cell(point: dict[str, Any]) -> Cell:
            value = point[name]
            return Cell(f"{value:.5g}" if isinstance(value, float) else str(value), value)

        return Column(name, of=cell)

    eta = Column("eta", of=lambda p: measured(float(p["eta"]), float(p["eta_sigma"])))
    photons = f"{tabulated.photons:,} photons ({tabulated.cached_photons:,} of the cache)"
    return described(
        "table of the light collection efficiency",
        None if written else records("", (*map(axis, tabulated.axes), eta), tabulated.rows),
        _lengths(tabulated.attenuation) if tabulated.attenuation else None,
        spent=f"{tabulated.eta.size} points{f' written to {written}' if written else ''}: "
        f"{photons if tabulated.photons else 'no photons'}, {tabulated.seconds:.1f} s, errors up "
        f"to {100 * tabulated.largest_relative_sigma:.2g} %",
        notes=tabulated.notes,
    )


FACES = (
    Column("face", of="surface"),
    "kind",
    Column("behind it", of="interior"),
    Column("n", "n_behind", "g", of="n_interior"),
    Column("in front of it", of="exterior"),
    Column("n", "n_in_front", "g", of="n_exterior"),
)


def of_check(report: results.CheckResult, *, first: bool = True) -> Description:
    """What a scene means, its faces, and what is wrong with it.

    Not the `first` problem where the command raises it; the others are shown.
    """
    problems = [f"{'also: ' if i else ''}{problem}" for i, problem in enumerate(report.problems)]
    scene = report.scene if isinstance(report.scene, str | Path) else report.scene.path
    scene_file = Path(scene).resolve()

    def line(face: Interface) -> Cell:
        included = "" if face.path.resolve() == scene_file else f"{face.path.name}: "
        return shown(face.line, lambda line: "" if line is None else f"{included}{line}")

    faces = records("", (*FACES, Column("line", of=line)), report.interfaces)
    pieces = (listed(report.words), faces, problems if first else problems[1:])
    return described("check of a scene", *pieces, notes=report.notes)


def of_installation(versions: Mapping[str, object]) -> Description:
    """What is installed, by part."""
    rows = ((name, Cell(str(value), value)) for name, value in versions.items())
    works = "the installation works: a kernel was compiled and run"
    return described("the installation", table("", ("part", "found"), rows), works)


_BOTH = (
    Column("quantity", of=lambda compared: Cell(fate_words(compared.quantity), compared.quantity)),
    Column("Mitsuba", form=".6f", of="mitsuba"),
    Column("error", "Mitsuba_sigma", ".6f", of="mitsuba_sigma"),
    Column("NumPy", form=".6f", of="numpy"),
    Column("error", "NumPy_sigma", ".6f", of="numpy_sigma"),
    Column("z", form=lambda z: "too few" if z is None else f"{z:+.2f}"),
)
_SOLVED = (
    Column("modes", form=".6f"),
    Column("error", "modes_sigma", ".6f"),
    Column("z", "modes_z", "+.2f"),
)


def of_crosscheck(compared: results.CrosscheckResult) -> Description:
    """Every fate from the programs, and whether they agree."""
    from mcrim_mitsuba.reference.crosscheck import FAMILY_LEVEL

    solved = _SOLVED if any(quantity.modes is not None for quantity in compared.rows) else ()
    return described(
        "Mitsuba beside the independent tracer",
        records("", (*_BOTH, *solved), compared.rows),
        f"the {'three' if solved else 'two'} {'agree' if compared.agrees else 'DISAGREE'}: "
        f"family-wise {p_equals(compared.family_p_value)}, tested at {FAMILY_LEVEL:g}; "
        f"{compared.mitsuba_photons:,} and {compared.numpy_photons:,} photons",
    )
