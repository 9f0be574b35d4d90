"""Reads what the relative method needs: a sample, a reference, and what they share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.files.toml_document import TomlDocument, read_toml
from mcrim_mitsuba.physics.relative_method import QUANTITIES, own_part

SAMPLE, REFERENCE, SHARED = "sample", "reference", "shared"
_YIELD = "light_yield_ph_per_keV"
_FRACTIONS = ("eta", "detector_efficiency")
_EXAMPLE = {"signal": "14.3", "eta": "0.25", "detector_efficiency": "0.127", _YIELD: "16.2"}


@dataclass(frozen=True)
class Comparison:
    """Two crystals on one bench with one source.

    Attributes
    ----------
    path : Path
        The file.
    sample, reference : dict of str to (float, float)
        Value and standard error of ``signal`` (photons per event), ``eta`` and
        ``detector_efficiency`` (fractions).
    reference_yield : (float, float)
        Light yield of the reference and its standard error, photons per keV.
    shared : dict of str to float
        Relative standard errors, by quantity, that move both crystals alike: parts of the
        errors above.
    """

    path: Path
    sample: dict[str, tuple[float, float]]
    reference: dict[str, tuple[float, float]]
    reference_yield: tuple[float, float]
    shared: dict[str, float]


def read_comparison(path: str | Path) -> Comparison:
    """Read and check the file of a relative measurement.

    Parameters
    ----------
    path : str or Path
        TOML with the tables ``[sample]`` and ``[reference]`` (``signal``, ``eta`` and
        ``detector_efficiency``, each with its ``_sigma``; the reference also
        ``light_yield_ph_per_keV``) and, if errors are shared, ``[shared]``.

    Raises
    ------
    InputError
        With file and line, if anything is missing, unknown or impossible.
    """
    document = read_toml(Path(path), "a relative measurement")
    document.table("", (SAMPLE, REFERENCE, SHARED))
    sample = _crystal(document, SAMPLE, tuple(QUANTITIES))
    reference = _crystal(document, REFERENCE, (*QUANTITIES, _YIELD))
    reference_yield = reference.pop(_YIELD)
    shared = _shared(document, {SAMPLE: sample, REFERENCE: reference})
    return Comparison(document.path, sample, reference, reference_yield, shared)


def _crystal(
    document: TomlDocument, table: str, names: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    """Value and standard error of every quantity of one table."""
    if table not in document.content:
        raise document.refusal(
            "", f"there is no table [{table}]", f"write it, with {', '.join(names)}"
        )
    document.table(table, (*names, *(f"{name}_sigma" for name in names)))
    return {name: _with_error(document, table, name) for name in names}


def _with_error(document: TomlDocument, table: str, name: str) -> tuple[float, float]:
    key, sigma_name = f"{table}.{name}", f"{name}_sigma"
    value, sigma = document.number(table, name), document.number(table, sigma_name)
    if value is None:
        raise document.refusal(
            table, f"[{table}] has no {name}", f"write one, such as {name} = {_EXAMPLE[name]}"
        )
    if value <= 0:
        raise document.refusal(key, f"{name} = {value:g}", "give a number above 0")
    if name in _FRACTIONS and value > 1:
        raise document.refusal(
            key, f"{name} = {value:g} is above 1", "give a fraction: 0.25 for 25 %"
        )
    if sigma is None:
        raise document.refusal(
            key, f"{name} has no error", f"write {sigma_name}, in the unit of {name}"
        )
    if not 0 <= sigma < value:
        raise document.refusal(
            f"{table}.{sigma_name}", f"{sigma_name} = {sigma:g} at {name} = {value:g}",
            "errors are propagated to first order: give one from 0 to well below the value",
        )  # fmt: skip
    return value, sigma


def _shared(
    document: TomlDocument, crystals: dict[str, dict[str, tuple[float, float]]]
) -> dict[str, float]:
    """Relative errors in common, none larger than what a crystal has."""
    shared = {}
    for name in document.table(SHARED, tuple(QUANTITIES)):
        key, part = f"{SHARED}.{name}", document.known_number(SHARED, name)
        if part < 0:
            raise document.refusal(key, f"{name} = {part:g}", "give a relative error: 0.05 for 5 %")
        for whose, crystal in crystals.items():
            value, sigma = crystal[name]
            if own_part(value, sigma, part) is None:
                raise document.refusal(
                    key, f"the shared error {name} = {part:g} is larger than the {whose}'s own, "
                    f"{sigma / value:.3g} of its {name}",
                    "shared errors are parts of those of both crystals, as fractions",
                )  # fmt: skip
        shared[name] = part
    return shared
