"""``mcrim lab efficiency``, ``absorption``, ``index`` and ``gammas``: numbers of a material."""

from __future__ import annotations

import re
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing
from mcrim_mitsuba.cli.options import Number, Share, option, parse_share
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.numbers import parse_number
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.optics.emission_band import index_over
from mcrim_mitsuba.optics.materials import catalogue, material
from mcrim_mitsuba.optics.spectrum import detected_light
from mcrim_mitsuba.output import describe_laboratory
from mcrim_mitsuba.output.registry import VerbResult, laboratory_figures
from mcrim_mitsuba.scene.values import SEPARATOR, material_at


@click.command(short_help="Quantum efficiency weighted with an emission spectrum, Eq. 3.")
@click.argument("emission", type=click.Path(path_type=str))
@click.argument("quantum_efficiency", type=click.Path(path_type=str))
@option(
    "--scale-sigma",
    Share(),
    "Relative error that all points of the quantum efficiency share.",
    default="5%",
)
@options.figure("both curves with their product and the weighted mean")
@options.json_output
def efficiency(emission, quantum_efficiency, scale_sigma, figure, json_file) -> None:
    """Quantum efficiency weighted with an emission spectrum (Eq. 3 of the article).

    \b
    mcrim lab efficiency emission.csv quantum_efficiency.csv

    Both tables have the columns wavelength, value and, where it is known, the value's standard
    error (named sigma). Wavelengths are in nm unless their name says µm, Å, eV or 1/cm, quantum
    efficiencies fractions unless their name says %. Errors of points are independent.
    """
    from mcrim_mitsuba.laboratory.light_yield import detector_efficiency
    from mcrim_mitsuba.optics.spectrum_file import read_spectrum

    showing.refuse_places(json_file, [emission, quantum_efficiency], figure)
    light = read_spectrum(emission, "emission")
    tube = read_spectrum(quantum_efficiency, "quantum_efficiency")
    weighted = detector_efficiency(light, tube, scale_sigma)
    document = {
        "emission": emission,
        "quantum_efficiency": quantum_efficiency,
        "scale_sigma": scale_sigma,
        **attributes(weighted, "detector_efficiency=value detector_efficiency_sigma=sigma"),
        **attributes(weighted, "contributions spread outside=mean.outside notes"),
    }
    kind, shown = "detector_efficiency", describe_laboratory.of_efficiency(weighted)
    drawings = {"efficiency": lambda: laboratory_figures.draw_efficiency(weighted)}
    result = VerbResult(kind=kind, shown=shown, numbers=document, drawings=drawings)
    showing.answer(result, json_file, figure)


_NUMBER_LIKE = re.compile(r"[+-]?[\d.,]+(e[+-]?\d+)?\s*%?", re.IGNORECASE)
_INDEX_LIKE = re.compile(r"[+-]?[\d.,]+", re.ASCII)


@click.command(short_help="Absorption from the transmittance of a polished sample.")
@click.argument("transmittance", nargs=-1, required=True, metavar="T_OR_FILE...")
@option("--thickness-mm", Number("MM"), "Thickness of the sample, mm.", required=True)
@option(
    "--n",
    "INDEX",
    "Refractive index, a number or a material such as CaMoO4.",
    "index",
    required=True,
)
@option(
    "--n-sigma", Number("ERROR"), "Standard error of the index (default: the material's, or 0)."
)
@option(
    "--sigma",
    Share(),
    "Standard error that all readings share, 0.005 or 0.5% of full transmission.",
    default="0",
)
@option("--thickness-sigma-mm", Number("MM"), "Standard error of the thickness, mm.", default=0.0)
@options.file("--emission", "Emission spectrum to average over.")
@options.file(
    "--quantum-efficiency", "Of the detector: the average is then over the light that it sees."
)
@option(
    "--nm",
    Number("NM"),
    "Wavelength at which spectra or a material's index are taken, instead of --emission.",
    "wavelength_nm",
)
@options.figure("transmittances and coefficients over wavelength")
@options.json_output
def absorption(
    transmittance, index, n_sigma, sigma, emission, quantum_efficiency, figure, json_file, **sample
) -> None:
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
    from mcrim_mitsuba.optics.spectrum_file import read_transmittances

    numbers, files = _numbers_or_files(transmittance, index)
    thickness_mm, wavelength_nm = sample["thickness_mm"], sample["wavelength_nm"]
    if figure is not None and not files:
        raise InputError("--figure has no spectrum to draw", "leave it out, or name files")
    if emission is not None and wavelength_nm is not None:
        raise InputError("both --emission and --nm are given", "leave one of them out")
    if quantum_efficiency is not None and emission is None:
        problem = "--quantum-efficiency without --emission"
        raise InputError(problem, "give the crystal's emission spectrum too")
    weights = [file for file in (emission, quantum_efficiency) if file is not None]
    showing.refuse_places(json_file, [*files, *weights], figure)
    light, of_light = _light(emission, quantum_efficiency)
    n, own_sigma, notes = _index(index, light, wavelength_nm)
    n_sigma = own_sigma if n_sigma is None else n_sigma
    spectra = read_transmittances(files)
    readings = [parse_share("the transmittance", text) for text in numbers]
    errors = {"transmittance_sigma": sigma, "n_sigma": n_sigma}
    coefficient = absorption_from_transmittance(
        spectra or readings, n, emission=light, **errors, **sample
    )
    notes = [*of_light, *notes, *coefficient.notes]
    others = (part for origin, part in coefficient.contributions.items() if origin != EMISSION)
    if not any(part > 0 for part in others):
        notes.append("no error is given: give --sigma, --n-sigma or --thickness-sigma-mm")
    article = _beside_the_article(readings, n, thickness_mm)
    document = {"transmittance": readings or files, "n": coefficient.n, "n_sigma": n_sigma}
    document |= {"thickness_mm": thickness_mm, **attributes(coefficient, _OF_ABSORPTION)}
    document |= {"article": article, "notes": notes}
    beside = article and (
        f"the article ({article['where']}) has {100 * article['internal_transmittance']:.0f} % "
        f"and {article['alpha_abs_per_cm']:g} /cm for this reading; see `mcrim paper`"
    )
    shown = describe_laboratory.of_absorption(coefficient, transmittance, beside or "", notes)
    drawings = {"absorption": lambda: laboratory_figures.draw_absorption(coefficient)}
    result = VerbResult(kind="absorption", shown=shown, numbers=document, drawings=drawings)
    showing.answer(result, json_file, figure)


_OF_ABSORPTION = (
    "alpha_abs_per_cm alpha_abs_sigma_per_cm=sigma contributions internal_transmittance "
    "internal_transmittance_sigma each_per_cm spread_orientations_per_cm spread_band_per_cm "
    "apparent_per_cm"
)


def _numbers_or_files(transmittance: tuple[str, ...], index: str) -> tuple[list[str], list[str]]:
    """Transmittances as they were typed, all numbers or all files."""
    for text, flag in (*((value, "--sigma") for value in transmittance), (index, "--n-sigma")):
        if "±" in text or "+-" in text:
            raise InputError(f"'{text}' has its error beside it", f"give the error as {flag}")
    numbers = [text for text in transmittance if _NUMBER_LIKE.fullmatch(text)]
    if numbers and len(numbers) < len(transmittance):
        raise InputError("numbers and files together", "give all orientations the same way")
    return numbers, [] if numbers else list(transmittance)


def _light(emission: str | None, quantum_efficiency: str | None):
    """The light that the coefficient is averaged over, None without a spectrum; and notes."""
    from mcrim_mitsuba.optics.spectrum_file import read_spectrum

    if emission is None:
        return None, []
    light = read_spectrum(emission, "emission")
    if quantum_efficiency is None:
        return light, list(light.notes)
    detector = read_spectrum(quantum_efficiency, "quantum_efficiency")
    return detected_light(light, detector), [*light.notes, *detector.notes]


def _index(text: str, light, wavelength_nm: float | None):
    """The index, a number or a function of the wavelength; its error, and notes."""
    if _INDEX_LIKE.fullmatch(text.strip()):
        return parse_number("--n", text), 0.0, []
    if light is not None:
        band = index_over(text, light)
        return band.material.held_index, band.sigma, list(band.notes)
    crystal = material(text)
    if wavelength_nm is None:
        problem = f"the index of {crystal.name} depends on the wavelength"
        raise InputError(problem, "give --emission or --nm")
    crystal.index(wavelength_nm)  # refuses what is outside the formula's range
    return crystal.held_index, crystal.sigma, []


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


_USUAL_NM = 540.0


@click.command(short_help="Refractive index of a material; without one, the catalogue.")
@click.argument("material", required=False)
@option(
    "--nm", Number("NM", 1, 1e6), f"Wavelength in nm (default: {_USUAL_NM:g}).", "wavelength_nm"
)
@options.file("--emission", "Emission spectrum to average the index over, instead of --nm.")
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

    Any entry of refractiveindex.info is a MATERIAL too, as rii:SHELF/BOOK/PAGE of its address:
    rii:main/BaF2/Malitson. A page that has no ending -o or -e stands for both rays.
    """
    if wavelength_nm is not None and emission is not None:
        raise InputError("both --nm and --emission are given", "leave one of them out")
    if material is not None and SEPARATOR in material:
        if typed := "--nm" if wavelength_nm is not None else "--emission" if emission else None:
            raise InputError(f"{material} and {typed} are given", "leave one of them out")
        crystal, where = material_at(f"'{material}'", material)
        material = crystal.name
        wavelength_nm, emission = (None, where) if isinstance(where, str) else (where, None)
    showing.refuse_places(json_file, [] if emission is None else [emission])
    if material is None and emission is not None:
        raise InputError("--emission needs a material", "name one, such as CaMoO4")
    if material is not None and emission is not None:
        answer = _over(material, emission)
    else:
        nm = _USUAL_NM if wavelength_nm is None else wavelength_nm
        answer = _catalogue(nm) if material is None else _at(material, nm)
    showing.answer(answer, json_file)


def _catalogue(wavelength_nm: float) -> VerbResult:
    """All materials with their indices at a wavelength; None beyond a formula's range."""
    covered = {crystal: crystal.ordinary.covers(wavelength_nm) for crystal in catalogue()}
    indices = {c: float(c.index(wavelength_nm)) if there else None for c, there in covered.items()}
    materials = [{**_json(crystal), "n": n} for crystal, n in indices.items()]
    document = {"wavelength_nm": wavelength_nm, "materials": materials}
    shown = describe_laboratory.of_materials(indices, wavelength_nm)
    return VerbResult(kind="materials", shown=shown, numbers=document)


def _at(name: str, wavelength_nm: float) -> VerbResult:
    """The index at one wavelength."""
    crystal = material(name)
    n, difference = float(crystal.index(wavelength_nm)), float(crystal.birefringence(wavelength_nm))
    ordinary = float(crystal.ordinary.index(wavelength_nm, crystal.name))
    extraordinary = None if crystal.extraordinary is None else ordinary + difference
    document = {**_json(crystal), "wavelength_nm": wavelength_nm, "n": n, "n_ordinary": ordinary}
    document |= {"n_extraordinary": extraordinary, "birefringence": difference, "notes": []}
    error = f" ± {crystal.sigma:g}" if crystal.sigma else ""
    lines = [f"n = {n:.5f}{error} at {wavelength_nm:g} nm"]
    if (extinction := crystal.extinction) is not None and extinction.covers(wavelength_nm):
        k = float(extinction.at(wavelength_nm))
        reflectance = abs((n + 1j * k - 1.0) / (n + 1j * k + 1.0)) ** 2
        document |= {"k": k, "reflectance": reflectance}
        lines.append(f"k = {k:.3g}; in air it reflects {reflectance:.4f} at normal incidence")
    scene = f'in a scene: value="{crystal.name}@{wavelength_nm:g}nm"'
    if crystal.is_opaque(wavelength_nm):
        scene = "light does not cross it: no index of a scene"
    shown = describe_laboratory.of_index(crystal, lines, ordinary, difference, scene)
    return VerbResult(kind="index", shown=shown, numbers=document)


def _over(name: str, emission: str) -> VerbResult:
    """The index over an emission spectrum."""
    from mcrim_mitsuba.optics.spectrum_file import read_spectrum

    spectrum = read_spectrum(emission, "emission")
    band = index_over(name, spectrum)
    crystal, notes = band.material, [*spectrum.notes, *band.notes]
    names = (
        "n=mean n_sigma=sigma spread n_ordinary=ordinary_mean n_extraordinary=extraordinary_mean "
        "birefringence mean_wavelength_nm outside outside_sigma"
    )
    document = {**_json(crystal), "emission": emission, **attributes(band, names), "notes": notes}
    lines = [
        f"n = {pdg(band.mean, band.sigma)}, mean over {emission}",
        f"spread over the band {band.spread:.4f} (standard deviation); mean wavelength "
        f"{band.mean_wavelength_nm:.1f} nm",
    ]
    scene = f'in a scene in its folder: value="{crystal.name}@{Path(emission).name}"'
    shown = describe_laboratory.of_index(
        crystal, lines, band.ordinary_mean, band.birefringence, scene, notes
    )
    return VerbResult(kind="index", shown=shown, numbers=document)


def _json(crystal) -> dict:
    """What a material is, for ``--json``."""
    shortest, longest = crystal.range_nm
    return {
        **attributes(crystal, "material=name what source"),
        "shortest_nm": shortest,
        "longest_nm": longest,
        **attributes(crystal, "n_sigma=sigma formula density_g_per_cm3 emission_nm decay_ns"),
    }


_DEPTHS_MM = (1.0, 2.0, 5.0, 10.0)


@click.command(short_help="Depth at which gammas stop in a crystal: a prior.")
@click.argument("formula")
@option("--energy-keV", Number("KEV"), "Energy of the gammas, keV.", "energy_keV", required=True)
@option(
    "--density-g-per-cm3",
    Number("DENSITY"),
    "Density in g/cm3 (default: that of the catalogue's material).",
    "density",
)
@options.json_output
def gammas(formula, energy_keV, density, json_file) -> None:
    """Where gammas stop in a crystal of a chemical FORMULA: the prior of source_depth_mm.

    \b
    mcrim lab gammas CaMoO4 --energy-keV 59.5

    FORMULA may be the name of a material that has one, such as LYSO.

    The length is that in which their number falls to 1/e at normal incidence; slanting gammas
    stop nearer to the surface.
    """
    from mcrim_mitsuba.optics.gammas import SOURCE, attenuation_length_mm

    showing.refuse_places(json_file, [])
    stops = attenuation_length_mm(formula, energy_keV, density)
    stopped = {depth: float(stops.stopped_within(depth)) for depth in _DEPTHS_MM}
    processes = ("photoelectric", "incoherent", "coherent")
    parts = attributes(stops, " ".join(f"{name}={name}_per_cm" for name in processes))
    names = (
        "formula energy_keV density_g_per_cm3 length_mm length_sigma_mm=sigma_mm tables_sigma_mm "
        "process_sigma_mm without_coherent_mm per_cm"
    )
    document = {
        **attributes(stops, names),
        "parts_per_cm": parts,
        **attributes(stops, "escaping escaping_keV escape_loss"),
        "stopped": [{"depth_mm": depth, "share": share} for depth, share in stopped.items()],
        "source": SOURCE,
    }
    shown = describe_laboratory.of_gammas(stops, parts, stopped)
    showing.answer(VerbResult(kind="gammas", shown=shown, numbers=document), json_file)
