"""``mcrim lab index``: refractive indices of materials, with their sources."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.output.described import Column, table
from mcrim_mitsuba.scene.values import SEPARATOR, material_at

_USUAL_NM = 540.0


@click.command(short_help="Refractive index of a material; without one, the catalogue.")
@click.argument("material", required=False)
@click.option("--nm", "wavelength_nm", type=options.Number(1, 1e6), metavar="NM",
              help=f"Wavelength in nm (default: {_USUAL_NM:g}).")  # fmt: skip
@click.option("--emission", metavar="FILE",
              help="Emission spectrum to average the index over, instead of --nm.")  # fmt: skip
@options.json_output
def index(material, wavelength_nm, emission, json_file) -> None:
    """Refractive index of MATERIAL; without one, what the catalogue has.

    \b
    mcrim lab index CaMoO4 --emission emission.csv
    mcrim lab index BK7 --nm 540
    mcrim lab index BK7@540nm

    The name of a birefringent crystal stands for the mean over all directions and polarisations,
    (2 n_o + n_e) / 3; NAME_o and NAME_e are its rays. Scenes and measurements may write
    BK7@540nm or CaMoO4@emission.csv where they have a number n_...
    """
    if wavelength_nm is not None and emission is not None:
        raise InputError("both --nm and --emission are given", "leave one of them out")
    if material is not None and SEPARATOR in material:
        material, wavelength_nm, emission = _as_in_scenes(material, wavelength_nm, emission)
    refuse_outputs({"--json": json_file}, [] if emission is None else [emission])
    if material is None:
        if emission is not None:
            raise InputError("--emission needs a material", "name one, such as CaMoO4")
        _list(_USUAL_NM if wavelength_nm is None else wavelength_nm, json_file)
    elif emission is None:
        _at(material, _USUAL_NM if wavelength_nm is None else wavelength_nm, json_file)
    else:
        _over(material, emission, json_file)


def _as_in_scenes(
    text: str, wavelength_nm: float | None, emission: str | None
) -> tuple[str, float | None, str | None]:
    """Material, wavelength and emission of ``BK7@540nm`` or ``CaMoO4@emission.csv``."""
    if option := "--nm" if wavelength_nm is not None else "--emission" if emission else None:
        raise InputError(f"{text} and {option} are given", "leave one of them out")
    known, where = material_at(f"'{text}'", text)
    return (known.name, None, where) if isinstance(where, str) else (known.name, where, None)


def _list(wavelength_nm: float, json_file: str | None) -> None:
    """The catalogue; no number where a wavelength is outside a formula's range."""
    from mcrim_mitsuba.optics.materials import MATERIALS

    known = {
        each: each.index(wavelength_nm) if each.ordinary.covers(wavelength_nm) else None
        for each in MATERIALS
    }
    terminal.write_json(
        json_file,
        {
            "wavelength_nm": wavelength_nm,
            "materials": [{**_json(each), "n": n} for each, n in known.items()],
        },
    )
    screen = terminal.console(json_file)
    columns = ("material", f"n, {wavelength_nm:g} nm", "range, nm",
               Column("what it is", left=True), Column("source", left=True))  # fmt: skip
    rows = (
        (each.name, "" if n is None else f"{n:.5f}", _range(each), each.what, each.source)
        for each, n in known.items()
    )
    screen.show(table("", columns, rows))


def _at(name: str, wavelength_nm: float, json_file: str | None) -> None:
    """The index at one wavelength."""
    from mcrim_mitsuba.optics.materials import material

    known = material(name)
    n, difference = float(known.index(wavelength_nm)), float(known.birefringence(wavelength_nm))
    ordinary = float(known.ordinary.index(wavelength_nm, known.name))
    terminal.write_json(
        json_file,
        {
            **_json(known), "wavelength_nm": wavelength_nm, "n": n, "n_ordinary": ordinary,
            "n_extraordinary": None if known.extraordinary is None else ordinary + difference,
            "birefringence": difference, "notes": [],
        },
    )  # fmt: skip
    screen = terminal.console(json_file)
    screen.line(f"n = {n:.5f} ± {known.sigma:g} at {wavelength_nm:g} nm", style="bold")
    _say_rays(screen, known, ordinary, difference)
    _say_material(screen, known)
    screen.line(f'in a scene: value="{known.name}@{wavelength_nm:g}nm"')


def _over(name: str, emission: str, json_file: str | None) -> None:
    """The index over an emission spectrum."""
    from mcrim_mitsuba.core.rounding import pdg
    from mcrim_mitsuba.optics.emission_band import index_over
    from mcrim_mitsuba.optics.spectrum_file import read_spectrum

    spectrum = read_spectrum(emission, "emission")
    band = index_over(name, spectrum)
    known, notes = band.material, [*spectrum.notes, *band.notes]
    terminal.write_json(
        json_file,
        {
            **_json(known), "emission": emission, "n": band.mean, "n_sigma": band.sigma,
            "spread": band.spread, "n_ordinary": band.ordinary_mean,
            "n_extraordinary": band.extraordinary_mean, "birefringence": band.birefringence,
            "mean_wavelength_nm": band.mean_wavelength_nm, "outside": band.outside,
            "outside_sigma": band.outside_sigma, "notes": notes,
        },
    )  # fmt: skip
    screen = terminal.console(json_file)
    screen.line(f"n = {pdg(band.mean, band.sigma)}, mean over {emission}", style="bold")
    screen.line(
        f"spread over the band {band.spread:.4f} (standard deviation); mean wavelength "
        f"{band.mean_wavelength_nm:.1f} nm"
    )
    _say_rays(screen, known, band.ordinary_mean, band.birefringence)
    _say_material(screen, known)
    screen.line(f'in a scene in its folder: value="{known.name}@{Path(emission).name}"')
    screen.say_notes(notes)


def _say_rays(screen, known, ordinary: float, difference: float) -> None:
    if known.extraordinary is not None:
        screen.line(
            f"ordinary {ordinary:.5f}, extraordinary {ordinary + difference:.5f}, difference "
            f"{difference:+.5f}; n is the mean of all directions and polarisations, "
            "(2 n_o + n_e) / 3"
        )


def _say_material(screen, known) -> None:
    density = known.density_g_per_cm3
    screen.line(
        f"{known.name}: {known.what}" + (f"; {density:g} g/cm3" if density is not None else "")
    )
    screen.line(f"known from {_range(known)} nm; source: {known.source}")


def _range(known) -> str:
    shortest, longest = known.range_nm
    return f"{shortest:g} to {longest:g}"


def _json(known) -> dict:
    """What a material is, for ``--json``."""
    return {
        "material": known.name, "what": known.what, "source": known.source,
        "shortest_nm": known.range_nm[0], "longest_nm": known.range_nm[1],
        "n_sigma": known.sigma, "formula": known.formula,
        "density_g_per_cm3": known.density_g_per_cm3,
    }  # fmt: skip
