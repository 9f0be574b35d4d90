"""The crystal's absorption from its transmittance: the prior of alpha_abs_per_cm."""

from __future__ import annotations

import math
from dataclasses import replace

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.material_index import read_index
from mcrim_mitsuba.files.raw_entries import ABSORPTION, TransmittanceEntry
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.spectrum import read_spectra
from mcrim_mitsuba.files.toml_document import TomlDocument
from mcrim_mitsuba.laboratory.raw_data import ReducedAbsorption
from mcrim_mitsuba.materials.over_emission import index_curve
from mcrim_mitsuba.physics.absorption import EMISSION, absorption_from_transmittance
from mcrim_mitsuba.physics.attenuation import MM_PER_CM
from mcrim_mitsuba.physics.slab import Index
from mcrim_mitsuba.physics.spectrum import Spectrum

#: Of the light inside the sample: no spectrophotometer is as exact.
_SMALLEST_SIGMA = 2e-4
_KEY, _CRYSTAL = f"parameters.{ABSORPTION}", "n_crystal"


def reduce_transmittance(
    document: TomlDocument,
    entry: TransmittanceEntry,
    light: Spectrum | None,
    scene: SceneFile,
) -> ReducedAbsorption:
    """Eq. 4 of the article with the files, or the number, of a campaign.

    Parameters
    ----------
    document : TomlDocument
        For the lines of refusals.
    entry : TransmittanceEntry
    light : Spectrum or None
        As the detector of ``[light_yield]`` sees it; what spectra are weighted with.
    scene : SceneFile
        Has the crystal's index where the entry gives none.

    Raises
    ------
    InputError
        If a spectrum cannot be used, with its line; or with the campaign's, if the entry cannot.
    """
    spectra = tuple(read_spectra(entry.files, "transmittance"))
    of_curve = entry.n is not None and not isinstance(entry.n, float) and "@" not in entry.n
    if light is None and (spectra or of_curve):
        raise document.refusal(
            f"{_KEY}.{'transmittance' if spectra else 'n'}",
            "a spectrum says nothing of the crystal's own light without its emission",
            "add emission and quantum_efficiency to [light_yield], or give plain numbers",
        )  # fmt: skip
    n, n_sigma, notes = _index(document, entry, scene, light)
    numbers = () if entry.value is None else (entry.value,)
    try:
        found = absorption_from_transmittance(
            spectra or numbers, n, entry.thickness_mm,
            transmittance_sigma=entry.transmittance_sigma, n_sigma=n_sigma,
            thickness_sigma_mm=entry.thickness_sigma_mm, emission=light,
        )  # fmt: skip
    except InputError as error:
        if error.path is not None:
            raise
        raise document.refusal(f"{_KEY}.transmittance", error.problem, error.mend) from None
    # the emission only weights: its noise is no error of the readings
    parts = [part for origin, part in found.contributions.items() if origin != EMISSION]
    sigma = math.hypot(*parts)
    if sigma * entry.thickness_mm / MM_PER_CM < _SMALLEST_SIGMA:
        raise document.refusal(
            f"{_KEY}.transmittance",
            f"the absorption coefficient comes with an error of {sigma:.1g} /cm, less than any "
            "spectrophotometer's"
            if sigma > 0
            else "the absorption coefficient comes without any error",
            "give transmittance_sigma, the error that all readings share, or errors as a column of "
            "the spectra",
        )
    found = replace(found, notes=(*found.notes, *notes))
    return ReducedAbsorption(entry, spectra, light, n, found)


def _index(
    document: TomlDocument, entry: TransmittanceEntry, scene: SceneFile, light: Spectrum | None
) -> tuple[Index, float, tuple[str, ...]]:
    """The crystal's index, a number or a function of the wavelength, its error, and notes."""
    if isinstance(entry.n, float):
        return entry.n, entry.n_sigma, ()
    if entry.n is None:
        known = scene.parameters.get(_CRYSTAL)
        if not isinstance(known, float):
            raise document.refusal(
                f"{_KEY}.transmittance", f"{scene.path.name} has no {_CRYSTAL}",
                'give the crystal\'s index: n = 2.01, or a material such as n = "CaMoO4"',
            )  # fmt: skip
        named = scene.materials.get(_CRYSTAL)
        return known, 0.0 if named is None else named.material.sigma, ()
    try:
        if "@" in entry.n:
            named = read_index("n", entry.n, document.path.parent)
            return named.value, named.material.sigma, ()
        assert light is not None  # without it an index over wavelengths was refused
        curve = index_curve(entry.n, light)
    except InputError as error:
        if error.path is not None:
            raise
        raise document.refusal(f"{_KEY}.n", error.problem, error.mend) from None
    return curve.function, curve.sigma, curve.notes
