"""Refractive indices that a file gives by a material's name: ``BK7@540nm``, ``CaMoO4@band.csv``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import is_there
from mcrim_mitsuba.materials import Material, index_over, is_known, material

SEPARATOR = "@"
_WAVELENGTH = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([a-zA-Zµμ]*)")
# No index is known better, and what is shown is then what is used.
_DECIMALS = 5
_EXAMPLE = (
    "{0}@540nm for one wavelength, or {0}@emission.csv for the mean over an emission spectrum"
)


@dataclass(frozen=True)
class MaterialIndex:
    """An index of refraction, and where it comes from.

    Attributes
    ----------
    text : str
        As the file has it.
    value : float
        The index, to five decimals.
    material : Material
    wavelength_nm : float or None
    emission : Path or None
        Spectrum over which the index was averaged; one of the two is given.
    notes : tuple of str
        What must be known of the average.
    """

    text: str
    value: float
    material: Material
    wavelength_nm: float | None
    emission: Path | None
    notes: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """Material, wavelength, error and source."""
        at = (
            f"at {self.wavelength_nm:g} nm"
            if self.emission is None
            else f"over the emission of {self.emission.name}"
        )
        mean = (
            ", mean of all directions and polarisations (2 n_o + n_e) / 3"
            if self.material.extraordinary
            else ""
        )
        notes = "".join(f"; {note}" for note in self.notes)
        return (
            f"{self.material.name} ({self.material.what}) {at}{mean}, known to "
            f"{self.material.sigma:g}; source: {self.material.source}{notes}"
        )


def names_material(name: str, text: str) -> bool:
    """Whether the text of the parameter `name` is a material's, not a number's."""
    return name.startswith("n_") and (SEPARATOR in text or is_known(text))


def read_index(said: str, text: str, folder: Path | None = None, **place: Any) -> MaterialIndex:
    """Index of refraction that a text names.

    Parameters
    ----------
    said : str
        The beginning of a refusal: the parameter and its text.
    text : str
        ``MATERIAL@540nm``, or ``MATERIAL@FILE`` for the mean over the emission spectrum in a
        file.
    folder : Path, optional
        That a relative path of a file starts from; without it, that of the file in `place`.
    **place
        ``path``, ``line``, ``column`` of the text, for the refusal.

    Raises
    ------
    InputError
        If the material or the unit is unknown, the spectrum cannot be read, or the material's
        index is not known at the wavelength, or for too much of the emission.
    """
    known, where = material_at(said, text, **place)
    if isinstance(where, str):
        home = Path(place.get("path") or "").parent if folder is None else folder
        return _over_emission(said, text, known, home / where, place)
    try:
        value = round(float(known.index(where)), _DECIMALS)
    except InputError as error:
        raise _refused(said, error, place) from None
    return MaterialIndex(text.strip(), value, known, where, None)


def material_at(said: str, text: str, **place: Any) -> tuple[Material, float | str]:
    """Material and wavelength in nm, or the name of an emission spectrum, of such a text.

    Parameters and errors as `read_index`, which also reads the spectrum.
    """
    name, _, where = (part.strip() for part in text.partition(SEPARATOR))
    try:
        known = material(name)
    except InputError as error:
        raise _refused(said, error, place) from None
    if not where:
        raise InputError(
            f"{said} names a material without a wavelength",
            f"write {_EXAMPLE.format(known.name)}", **place,
        )  # fmt: skip
    wavelength = _WAVELENGTH.fullmatch(where)
    if wavelength is None:
        return known, where
    number, unit = wavelength.groups()
    if unit != "nm":
        raise InputError(
            f"{said} gives the wavelength in '{unit}'" if unit else
            f"{said} gives the wavelength without its unit",
            f"write it in nm: {_EXAMPLE.format(known.name)}", **place,
        )  # fmt: skip
    return known, float(number)


def _refused(said: str, error: InputError, place: dict[str, Any]) -> InputError:
    """What the catalogue refuses, at the place of the text."""
    return InputError(f"{said.rstrip(',')}: {error.problem}", error.mend, **place)


def _over_emission(
    said: str, text: str, known: Material, path: Path, place: dict[str, Any]
) -> MaterialIndex:
    """Mean over the emission spectrum in a file."""
    if not is_there(path):
        raise InputError(
            f"{said} names neither a wavelength nor a file: {path} does not exist",
            f"write {_EXAMPLE.format(known.name)}", **place,
        )  # fmt: skip
    from mcrim_mitsuba.files.spectrum import read_spectrum

    emission = read_spectrum(path, "emission")
    try:
        band = index_over(known.name, emission)
    except InputError as error:
        raise _refused(said, error, place) from None
    return MaterialIndex(
        text.strip(), round(band.mean, _DECIMALS), known, None, path, (*emission.notes, *band.notes)
    )
