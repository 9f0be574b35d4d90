"""Names and units of columns, as laboratories write them above their numbers."""

from __future__ import annotations

import re
import unicodedata

#: Units by their spellings, small letters; what is not here is kept as it was written.
_SPELLINGS = {
    "nm": ("nm", "nm.", "nanometer", "nanometers", "nanometre", "nanometres",
           "нм"),
    "µm": ("μm", "um", "micron", "microns", "micrometer", "micrometers", "micrometre",
           "micrometres", "мкм"),
    "Å": ("å", "ang", "angstrom", "angstroms", "ångström", "ångstrom"),
    "eV": ("ev", "эв"),
    "1/cm": ("1/cm", "cm-1", "cm^-1", "cm⁻¹"),
    "%": ("%", "percent", "per cent", "pct", "pct.", "prozent", "procent", "proc.", "proc", "проц.",
          "процент"),
    "fraction": ("fraction", "1"),
    "a.u.": ("a.u.", "a. u.", "a.u", "au", "arb. u.", "arb. units", "arb.units", "arb.u.",
             "arbitrary units", "rel. u.", "r.u."),
}  # fmt: skip
_UNITS = {
    unicodedata.normalize("NFKC", spelling): unit
    for unit, spellings in _SPELLINGS.items()
    for spelling in spellings
}
# "A" is an Ångström beside wavelengths and an absorbance elsewhere: its reader must know
_UNITS["a"] = "A"
#: Words that are units only in brackets or after a name.
_NOT_ALONE = ("1", "fraction", "proc", "a", "micron", "microns", "au")
_IN_BRACKETS = re.compile(r"[(\[{]([^()\[\]{}]*)[)\]}]")
_AFTER_A_MARK = re.compile(r"(?P<name>.*[^\s,/_])\s*[,/_]\s*(?P<unit>[^,/_]+|1/cm|cm[-^].*)")
_AFTER_A_BLANK = re.compile(r"(?P<name>\D*?[^\s\d])(?:\s+in)?\s+(?P<unit>per\s+cent|\S+)", re.I)
_PERCENT = re.compile(r"%\s*(?P<after>[A-Za-z].*)|(?P<before>[A-Za-z][^%=\d]*?)\s*%")


def unit_alone(cell: str) -> str | None:
    """The unit that a cell is, such as ``nm``; None where it is none or may be a name."""
    key = _key(cell)
    bare = key.strip("()[]{}")
    return None if key in _NOT_ALONE else _UNITS.get(bare)


def name_and_unit(cell: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit.

    Parameters
    ----------
    cell : str
        ``Wavelength (nm)``, ``λ/nm``, ``λ, nm``, ``wavelength_nm``, ``Wavelength nm``, ``%T``,
        ``QE [%]``, ``nm``.

    Returns
    -------
    name : str
        As written; a cell that is only a unit is its own name.
    unit : str or None
        ``nm``, ``µm``, ``Å``, ``A``, ``eV``, ``1/cm``, ``%``, ``fraction`` or ``a.u.`` in any of
        their spellings; another one as written, where it stands in brackets at the end.
    """
    text = " ".join(unicodedata.normalize("NFKC", cell).split())
    if (alone := unit_alone(text)) is not None:
        return text, alone
    brackets = list(_IN_BRACKETS.finditer(text))
    for bracket in brackets:
        if (unit := _known(bracket[1])) is not None:
            return _without(text, bracket), unit
    if brackets and brackets[-1].end() == len(text) and brackets[-1].start() > 0:
        return _without(text, brackets[-1]), brackets[-1][1].strip() or None
    for form in (_AFTER_A_MARK, _AFTER_A_BLANK):
        found = form.fullmatch(text)
        if found and (unit := _known(found["unit"])) is not None:
            return found["name"].strip(), unit
    if found := _PERCENT.fullmatch(text):
        return (found["after"] or found["before"]).strip(), "%"
    return text, None


def _key(text: str) -> str:
    return unicodedata.normalize("NFKC", text).strip().lower()


def _known(text: str) -> str | None:
    return _UNITS.get(_key(text))


def _without(text: str, found: re.Match) -> str:
    return " ".join((text[: found.start()] + " " + text[found.end() :]).split())
