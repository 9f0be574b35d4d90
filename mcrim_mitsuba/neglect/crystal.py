"""What is known of a crystal besides what its campaign's model has."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.materials import is_known
from mcrim_mitsuba.neglect import pieces
from mcrim_mitsuba.neglect.band import BandIndices, indices_over_band
from mcrim_mitsuba.physics.gammas import AttenuationLength, attenuation_length_mm


@dataclass(frozen=True, eq=False)
class KnownCrystal:
    """Indices over the emission band, and the depth at which gammas stop.

    Attributes
    ----------
    band : BandIndices or None
    depth : AttenuationLength or None
    refused : dict of str to str
        Pieces that nothing is known for, and why.
    """

    band: BandIndices | None
    depth: AttenuationLength | None
    refused: dict[str, str]

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        material: str | None,
        emission: str | Path | None,
        wavelength_nm: float | None,
    ) -> KnownCrystal:
        """What the campaign tells, and what is given besides; see `budgeting.budget`."""
        material = material or _material_of(campaign)
        if material is None:
            reason = "nothing tells what the crystal is made of: give --material, such as CaMoO4"
            return cls(None, None, dict.fromkeys((pieces.SOURCE_DEPTH, "indices"), reason))
        spectra = campaign.raw.efficiency if campaign.raw is not None else None
        spectrum = spectra.emission if spectra is not None and wavelength_nm is None else None
        if emission is not None:
            from mcrim_mitsuba.files.spectrum import read_spectrum

            spectrum = read_spectrum(emission, "emission")
        efficiency = spectra.quantum_efficiency if spectra is not None else None
        band = indices_over_band(material, spectrum, efficiency, wavelength_nm)
        known = band.material
        if campaign.light_yield is None or known.formula is None:
            lacking = "energy_keV in [light_yield]" if known.formula else "a formula"
            return cls(band, None, {pieces.SOURCE_DEPTH: f"there is no {lacking}"})
        depth = attenuation_length_mm(
            known.formula, campaign.light_yield.energy_keV, known.density_g_per_cm3
        )
        return cls(band, depth, {})


def _material_of(campaign: Campaign) -> str | None:
    """What the campaign or its scene say that the crystal is made of."""
    named = campaign.scene.materials.get(pieces.INDEX)
    if named is not None:
        return named.material.name
    raw = campaign.raw
    if raw is None:
        return None
    given = [raw.source_depth.entry.formula] if raw.source_depth is not None else []
    if raw.absorption is not None and isinstance(raw.absorption.entry.n, str):
        given.append(raw.absorption.entry.n)
    return next((name for name in given if is_known(name)), None)
