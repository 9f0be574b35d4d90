"""``mcrim lab absorption``: the absorption coefficient from a transmittance."""

from __future__ import annotations

import re
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import Share, parse_share
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import parse_number
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.output.described import table

_NUMBER_LIKE = re.compile(r"[+-]?[\d.,]+(e[+-]?\d+)?\s*%?", re.IGNORECASE)
_INDEX_LIKE = re.compile(r"[+-]?[\d.,]+", re.ASCII)


@click.command(short_help="Absorption from the transmittance of a polished sample.")
@click.argument("transmittance", nargs=-1, required=True, metavar="T_OR_FILE...")
@click.option("--thickness-mm", type=options.Number(), required=True, metavar="MM",
              help="Thickness of the sample, mm.")  # fmt: skip
@click.option("--n", "index", required=True, metavar="INDEX",
              help="Refractive index, a number or a material such as CaMoO4.")  # fmt: skip
@click.option("--n-sigma", type=options.Number(), metavar="ERROR",
              help="Standard error of the index (default: the material's, or 0).")  # fmt: skip
@click.option("--sigma", type=Share(), default="0", metavar="FRACTION",
              help="Standard error that all readings share, 0.005 or 0.5% of full "
              "transmission.")  # fmt: skip
@click.option("--thickness-sigma-mm", type=options.Number(), default=0.0, metavar="MM",
              help="Standard error of the thickness, mm.")  # fmt: skip
@click.option("--emission", metavar="FILE",
              help="Emission spectrum to average over.")  # fmt: skip
@click.option("--quantum-efficiency", metavar="FILE",
              help="Of the detector: the average is then over the light that it sees.")  # fmt: skip
@click.option("--nm", "wavelength_nm", type=options.Number(), metavar="NM",
              help="Wavelength at which spectra or a material's index are taken, instead of "
              "--emission.")  # fmt: skip
@options.figure("transmittances and coefficients over wavelength")
@options.json_output
def absorption(
    transmittance, thickness_mm, index, n_sigma, sigma, thickness_sigma_mm, emission,
    quantum_efficiency, wavelength_nm, figure, json_file,
) -> None:  # fmt: skip
    r"""Absorption coefficient from the transmittance of a polished sample in air (Eq. 4).

    \b
    mcrim lab absorption 0.76 --sigma 0.005 --n 2.01 --thickness-mm 10
    mcrim lab absorption t_1.csv t_2.csv --n CaMoO4 --thickness-mm 10 --emission emission.csv \\
          --quantum-efficiency tube.csv

    T_OR_FILE is a measured transmittance, 0.76 or 76%, or a spectrum; one for each orientation.
    Reflections of both faces are corrected for (all orders, normal incidence). Light that is
    scattered out of the beam counts as absorbed unless an integrating sphere collected it.
    """
    from mcrim_mitsuba.optics.absorption import EMISSION, absorption_from_transmittance
    from mcrim_mitsuba.optics.spectrum import detected_light
    from mcrim_mitsuba.optics.spectrum_file import read_spectra, read_spectrum

    for text, option in (*((each, "--sigma") for each in transmittance), (index, "--n-sigma")):
        if "±" in text or "+-" in text:
            raise InputError(f"'{text}' has its error beside it", f"give the error as {option}")
    numbers = [text for text in transmittance if _NUMBER_LIKE.fullmatch(text)]
    files = [] if numbers else list(transmittance)
    if numbers and len(numbers) < len(transmittance):
        raise InputError("numbers and files together", "give all orientations the same way")
    if figure is not None and not files:
        raise InputError("--figure has no spectrum to draw", "leave it out, or name files")
    if emission is not None and wavelength_nm is not None:
        raise InputError("both --emission and --nm are given", "leave one of them out")
    if quantum_efficiency is not None and emission is None:
        raise InputError(
            "--quantum-efficiency without --emission", "give the crystal's emission spectrum too"
        )
    weights = [file for file in (emission, quantum_efficiency) if file is not None]
    showing.refuse_places(json_file, [*files, *weights], figure)
    light = None if emission is None else read_spectrum(emission, "emission")
    of_light = [] if light is None else list(light.notes)
    if light is not None and quantum_efficiency is not None:
        detector = read_spectrum(quantum_efficiency, "quantum_efficiency")
        light, of_light = detected_light(light, detector), [*of_light, *detector.notes]
    n, own_sigma, notes = _index(index, light, wavelength_nm)
    n_sigma = own_sigma if n_sigma is None else n_sigma
    spectra = read_spectra(files, "transmittance")
    readings = [parse_share("the transmittance", text) for text in numbers]
    found = absorption_from_transmittance(
        spectra or readings, n, thickness_mm, transmittance_sigma=sigma, n_sigma=n_sigma,
        thickness_sigma_mm=thickness_sigma_mm, emission=light, wavelength_nm=wavelength_nm,
    )  # fmt: skip
    notes = [*of_light, *notes, *(note for each in spectra for note in each.notes), *found.notes]
    if not any(part > 0 for origin, part in found.contributions.items() if origin != EMISSION):
        notes.append("no error is given: give --sigma, --n-sigma or --thickness-sigma-mm")
    article = _beside_the_article(readings, n, thickness_mm)
    terminal.write_json(
        json_file,
        {
            "transmittance": readings or files, "n": found.n, "n_sigma": n_sigma,
            "thickness_mm": thickness_mm, "alpha_abs_per_cm": found.alpha_abs_per_cm,
            "alpha_abs_sigma_per_cm": found.sigma, "contributions": found.contributions,
            "internal_transmittance": found.internal_transmittance,
            "internal_transmittance_sigma": found.internal_transmittance_sigma,
            "each_per_cm": found.each_per_cm,
            "spread_orientations_per_cm": found.spread_orientations_per_cm,
            "spread_band_per_cm": found.spread_band_per_cm,
            "apparent_per_cm": found.apparent_per_cm, "article": article, "notes": notes,
        },
    )  # fmt: skip
    drawn: tuple[Path, ...] = ()
    if figure is not None:
        from mcrim_mitsuba.output.laboratory_figures import draw_absorption

        names = [Path(file).stem for file in files]
        named = list(zip(names, spectra, strict=True))
        drawn = draw_absorption(named, n, found, light).save(figure)
    screen = terminal.console(json_file)
    _show(screen, found, transmittance, article)
    showing.say_drawn(screen, drawn)
    screen.say_notes(notes)


def _index(text: str, light, wavelength_nm: float | None):
    """The index, a number or a function of the wavelength; its error, and notes."""
    if _INDEX_LIKE.fullmatch(text.strip()):
        return parse_number("--n", text), 0.0, []
    from mcrim_mitsuba.optics.emission_band import held_index, index_curve
    from mcrim_mitsuba.optics.materials import material

    if light is not None:
        curve = index_curve(text, light)
        return curve.function, curve.sigma, list(curve.notes)
    known = material(text)
    if wavelength_nm is None:
        raise InputError(
            f"the index of {known.name} depends on the wavelength", "give --emission or --nm"
        )
    known.index(wavelength_nm)  # refuses what is outside the formula's range
    return held_index(known), known.sigma, []


def _beside_the_article(readings: list[float], n, thickness_mm: float) -> dict | None:
    """What the article makes of its own reading; None where another was given."""
    from mcrim_mitsuba.article import published as p

    its_own = [p.MEASURED_TRANSMITTANCE.value / 100]
    if (readings, n, thickness_mm) != (its_own, p.N_CRYSTAL.value, p.CRYSTAL_MM.value):
        return None
    return {
        "internal_transmittance": p.CORRECTED_TRANSMITTANCE.value / 100,
        "alpha_abs_per_cm": p.NOMINAL.alpha_abs_per_cm.value,
        "where": p.CORRECTED_TRANSMITTANCE.where,
    }


def _show(screen, found, given, article: dict | None) -> None:
    sigma = found.sigma or None
    internal_sigma = 100 * found.internal_transmittance_sigma or None
    screen.line(
        f"alpha_abs {pdg(found.alpha_abs_per_cm, sigma)} /cm, internal transmittance "
        f"{pdg(100 * found.internal_transmittance, internal_sigma)} %",
        style="bold",
    )
    if article is not None:
        screen.line(
            f"the article ({article['where']}) has {100 * article['internal_transmittance']:.0f} % "
            f"and {article['alpha_abs_per_cm']:g} /cm for this reading; see `mcrim paper`"
        )
    parts = [(name, f"{part:.2g}") for name, part in found.contributions.items() if part > 0]
    if parts:
        screen.show(table("", ("where the error comes from", "error, 1/cm"), parts))
    if len(given) > 1:
        each = zip(given, (f"{alpha:.4g}" for alpha in found.each_per_cm), strict=True)
        screen.show(table("", ("orientation", "alpha, 1/cm"), each))
    if found.spread_band_per_cm is not None:
        screen.line(
            f"over the emission the coefficient varies by {found.spread_band_per_cm:.2g} /cm "
            "(standard deviation): one number leaves that out, it is no part of the error"
        )
    if sigma is not None:
        screen.line(
            f"in a campaign: prior = {found.alpha_abs_per_cm:.4g}, prior_sigma = {sigma:.2g} under "
            "[parameters.alpha_abs_per_cm]"
        )
