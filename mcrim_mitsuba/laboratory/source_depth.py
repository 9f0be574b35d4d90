"""How deep the source's gammas get into the crystal: the prior of the source's depth."""

from __future__ import annotations

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.raw_entries import SOURCE_DEPTH, GammasEntry
from mcrim_mitsuba.files.toml_document import TomlDocument
from mcrim_mitsuba.laboratory.raw_data import ReducedSourceDepth
from mcrim_mitsuba.physics.gammas import attenuation_length_mm


def reduce_gammas(document: TomlDocument, entry: GammasEntry) -> ReducedSourceDepth:
    """The attenuation length of the gammas.

    Raises
    ------
    InputError
        If the formula, its density or the energy cannot be used: with the campaign's line.
    """
    try:
        found = attenuation_length_mm(entry.formula, entry.energy_keV, entry.density_g_per_cm3)
    except InputError as error:
        key = f"parameters.{SOURCE_DEPTH}.gammas_in"
        raise document.refusal(key, error.problem, error.mend) from None
    return ReducedSourceDepth(entry, found)
