"""Physics that follows from what a crystal is made of and what stops in it.

Light is polarised, gammas stop within their attenuation length below the top, the index is the
material's. Where a campaign names material and energy these are no hypotheses: `with_known_physics`
puts them into its scene, at no odds. `budget` asks the same of any other campaign.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.campaign.entries import ARTICLE, SCALE
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.optics.emission_band import BandIndices, indices_over_band
from mcrim_mitsuba.optics.gammas import AttenuationLength, attenuation_length_mm
from mcrim_mitsuba.optics.materials import is_known, material
from mcrim_mitsuba.optics.spectrum import Spectrum
from mcrim_mitsuba.optics.spectrum_file import read_spectrum
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.campaign import Campaign

SOURCE_DEPTH, POLARIZATION, CRYSTAL_INDEX = "source_depth", "polarization", "crystal_index"
DEPTH_MM, INDEX = "source_depth_mm", "n_crystal"

IN_THE_MODEL = "it is in the model"


def material_of(campaign: Campaign) -> str | None:
    """What the campaign or its scene say that the crystal is made of; None if nothing does."""
    named = campaign.scene.materials.get(INDEX)
    if campaign.light_yield is not None and campaign.light_yield.material is not None:
        return campaign.light_yield.material
    if named is not None:
        return named.material.name
    raw = campaign.raw
    if raw is None:
        return None
    given = [raw.source_depth.formula] if raw.source_depth is not None else []
    if raw.absorption is not None and isinstance(raw.absorption.entry.n, str):
        given.append(raw.absorption.entry.n)
    return next((name for name in given if is_known(name)), None)


def emission_of(campaign: Campaign) -> tuple[Spectrum | None, Spectrum | None]:
    """Emission and quantum efficiency that a campaign names; None where it names none.

    Light over wavelengths is given as it is detected.
    """
    if campaign.raw is not None and campaign.raw.efficiency is not None:
        return campaign.raw.efficiency.emission, campaign.raw.efficiency.quantum_efficiency
    light = campaign.spectrum
    if light is None:
        return None, None
    seen = light.emission * light.efficiency
    return Spectrum(light.wavelength_nm, seen, name=light.path.name), None


@dataclass(frozen=True, eq=False)
class KnownCrystal:
    """Indices over the emission band, and the depth at which gammas stop."""

    band: BandIndices | None
    depth: AttenuationLength | None
    #: Pieces that nothing is known for, or that cannot be put into a campaign, and why.
    refused: dict[str, str]

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        name: str | None = None,
        emission: str | Path | None = None,
        wavelength_nm: float | None = None,
    ) -> KnownCrystal:
        """What the campaign tells, and what is given besides; see `budget`."""
        name = name or material_of(campaign)
        if name is None:
            reason = "nothing tells what the crystal is made of: give --material, such as CaMoO4"
            return cls(None, None, dict.fromkeys((SOURCE_DEPTH, CRYSTAL_INDEX), reason))
        spectrum, efficiency = emission_of(campaign)
        if emission is not None:
            spectrum = read_spectrum(emission, "emission")
        elif wavelength_nm is not None:
            spectrum = None
        band = indices_over_band(name, spectrum, efficiency, wavelength_nm)
        return cls(band, *_depth_of(campaign, name))

    @classmethod
    def named_by(cls, campaign: Campaign, name: str) -> KnownCrystal:
        """What a campaign's energy, a material, and the spectra that the campaign names tell.

        Nothing is assumed where there is no spectrum.
        """
        spectrum, efficiency = emission_of(campaign)
        depth, refused = _depth_of(campaign, name)
        band = None
        if spectrum is not None:
            try:
                band = indices_over_band(name, spectrum, efficiency)
            except InputError as error:
                refused[CRYSTAL_INDEX] = error.problem
        return cls(band, depth, refused)

    @property
    def pieces(self) -> tuple[str, ...]:
        """Effects that it tells the size of and that are not refused."""
        known = {SOURCE_DEPTH: self.depth, CRYSTAL_INDEX: self.band, POLARIZATION: True}
        return tuple(n for n, of in known.items() if of is not None and n not in self.refused)

    def left_out_of(self, campaign: Campaign) -> KnownCrystal:
        """The same, with what the campaign has already or cannot take among the `refused`."""
        refused = dict(self.refused)
        for piece in self.pieces:
            if (reason := self._reason_against(piece, campaign)) is not None:
                refused[piece] = reason
        return replace(self, refused=refused)

    def _reason_against(self, piece: str, campaign: Campaign) -> str | None:
        effect = campaign.catalogue[piece]
        if piece in (*campaign.effects, *campaign.known_physics) or effect.is_in(campaign.scene):
            return IN_THE_MODEL
        for name in [parameter.name for parameter in effect.parameters] or [piece]:
            if name in campaign.parameters:
                return f"{name} is a parameter of the campaign"
            if name in campaign.varied:
                return f"{name} differs from reading to reading"
        others = [sample.name for sample in campaign.samples.values() if SCALE in sample.own]
        if piece == SOURCE_DEPTH and others:
            return f"the sample {others[0]} may be of another material"
        try:
            campaign.with_effects([piece])
            if piece == CRYSTAL_INDEX and self.band is not None:
                refuse_far(campaign, self.band)
            self.put_into(campaign.scene, piece)
        except InputError as error:
            return error.problem
        return None

    def put_into(self, scene: SceneFile, *pieces: str) -> SceneFile:
        """The scene with effects of the known sizes in its text; errors as `add`."""
        for piece in pieces:
            sizes = {}
            if piece == SOURCE_DEPTH and self.depth is not None:
                sizes = {DEPTH_MM: self.depth.length_mm}
            elif piece == CRYSTAL_INDEX and self.band is not None:
                sizes = {INDEX: self.band.over.mean}
            scene = scene.edited(add(piece, scene, sizes))
        return scene

    def words(self, scene: SceneFile) -> dict[str, str]:
        """What each piece puts into a scene, by effect."""
        found = {POLARIZATION: "each photon's polarisation followed"}
        if (length := self.depth) is not None:
            found[SOURCE_DEPTH] = (
                f"births exp(-t/d) below the top, d = {pdg(length.length_mm, length.sigma_mm)} mm "
                f"({length.energy_keV:g} keV gammas in {length.formula} of "
                f"{length.density_g_per_cm3:g} g/cm3, through the top)"
            )
        if self.band is not None:
            index = pdg(self.band.over.mean, self.band.over.sigma)
            nominal = float(scene.parameters[INDEX])
            found[CRYSTAL_INDEX] = (
                f"n = {index} in the place of {nominal:g} ({self.band.material.name} over "
                f"{self.band.origin})"
            )
        return found


def _depth_of(campaign: Campaign, name: str) -> tuple[AttenuationLength | None, dict[str, str]]:
    """Where gammas of the campaign's energy stop in a material, or why nobody knows."""
    known = material(name)
    if campaign.light_yield is None or known.formula is None:
        lacking = "energy_keV in [light_yield]" if known.formula else "a formula"
        return None, {SOURCE_DEPTH: f"there is no {lacking}"}
    energy, density = campaign.light_yield.energy_keV, known.density_g_per_cm3
    try:
        return attenuation_length_mm(known.formula, energy, density), {}
    except InputError as error:
        return None, {SOURCE_DEPTH: error.problem}


def refuse_far(campaign: Campaign, band: BandIndices) -> None:
    """Refuse indices too far from the scene's to be told from simulations about it.

    Raises
    ------
    InputError
    """
    nominal = float(campaign.scene.parameters[INDEX])
    effect = campaign.catalogue[CRYSTAL_INDEX].parameters[0]
    mean = band.over.mean
    farthest = max(abs(mean - nominal) + 2 * band.over.sigma, *np.abs(band.indices - mean))
    if farthest > effect.maximum:
        raise InputError(
            f"the scene's {INDEX} = {nominal:g} is too far from {mean:.4g}, that of "
            f"{band.material.name}",
            f"set {INDEX} to about {mean:.4g}", path=campaign.scene.path,
        )  # fmt: skip


def with_known_physics(campaign: Campaign) -> Campaign:
    """The campaign with the physics that its material and its energy tell in its scene.

    Nothing changes where one of the two is not named, or with the article's convention. What the
    campaign or its scene say otherwise of one of these effects stays as it is.
    """
    name = material_of(campaign)
    if name is None or campaign.light_yield is None or campaign.convention == ARTICLE:
        return campaign
    known = KnownCrystal.named_by(campaign, name).left_out_of(campaign)
    words = known.words(campaign.scene)
    parts = [words[piece] for piece in known.pieces]
    parts += [
        f"not {campaign.catalogue[piece].title}: {reason}"
        for piece, reason in known.refused.items()
        if reason != IN_THE_MODEL
    ]
    return replace(
        campaign,
        scene=known.put_into(campaign.scene, *known.pieces),
        known_physics=known.pieces,
        physics_note=f"in the model, as {name} and the energy are named: {'; '.join(parts)}",
    )
