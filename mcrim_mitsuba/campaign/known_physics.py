"""Physics that follows from what a crystal is made of and what stops in it.

Light is polarised, gammas stop within their attenuation length below the top, the index is the
material's. Where a campaign names material and energy these are no hypotheses: `with_known_physics`
puts them into its scene, at no odds. `budget` asks the same of any other campaign.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mcrim_mitsuba.campaign.entries import ARTICLE, SCALE
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.effects.surroundings import without_wrapping
from mcrim_mitsuba.optics.emission_band import BandIndices, indices_over_band
from mcrim_mitsuba.optics.gammas import AttenuationLength, attenuation_length_mm
from mcrim_mitsuba.optics.materials import material
from mcrim_mitsuba.optics.spectrum import Spectrum
from mcrim_mitsuba.optics.spectrum_file import read_spectrum
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.campaign import Campaign

SOURCE_DEPTH = "source_depth"
POLARIZATION = "polarization"
CRYSTAL_INDEX = "crystal_index"
DEPTH_MM = "source_depth_mm"
INDEX = "n_crystal"
_IN_THE_MODEL = "it is in the model"
#: Light of a bare crystal is another matter, of which a campaign with a wrapping may have rows.
_UNPOLARISED = "beside a wrapping it is left out: a LYSO bar's eta moves by 0.3 % dry in Teflon"


def material_of(campaign: Campaign) -> str | None:
    """What the campaign or its scene say that the crystal is made of; None if nothing does."""
    if campaign.light_yield is not None and campaign.light_yield.material is not None:
        return campaign.light_yield.material
    if (named := campaign.scene.materials.get(INDEX)) is not None:
        return named.material.name
    return None if campaign.raw is None else campaign.raw.material


@dataclass(frozen=True, eq=False)
class KnownCrystal:
    """Indices over the emission band, and the depth at which gammas stop."""

    band: BandIndices | None
    depth: AttenuationLength | None
    #: Effects of which nothing is known, or that a campaign has or cannot take, and why.
    refused: dict[str, str]

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        name: str | None = None,
        emission: str | Path | None = None,
        wavelength_nm: float | None = None,
        *,
        assumed: bool = True,
    ) -> KnownCrystal:
        """What the campaign tells, and what is given besides; see `budget`.

        Unless it is `assumed`, nothing is known of an emission that has no spectrum.
        """
        asked = (name, emission, wavelength_nm) != (None, None, None)
        name = name or material_of(campaign)
        if name is None:
            reason = "nothing tells what the crystal is made of: give --material, such as CaMoO4"
            return cls(None, None, dict.fromkeys((SOURCE_DEPTH, CRYSTAL_INDEX), reason))
        spectrum = efficiency = None
        if campaign.raw is not None and (spectra := campaign.raw.efficiency) is not None:
            spectrum, efficiency = spectra.emission, spectra.quantum_efficiency
        elif (light := campaign.spectrum) is not None:
            seen = light.emission * light.efficiency
            spectrum = Spectrum(light.wavelength_nm, seen, name=light.path.name)
        if emission is not None:
            spectrum = read_spectrum(emission, "emission")
        elif wavelength_nm is not None:
            spectrum = None
        band = depth = None
        crystal, refused = material(name), {}
        if assumed or spectrum is not None:
            try:
                band = indices_over_band(name, spectrum, efficiency, wavelength_nm)
            except InputError as error:
                if asked or spectrum is not None:
                    raise
                refused[CRYSTAL_INDEX] = f"{error.problem}: {error.mend}"
        if campaign.light_yield is None or crystal.formula is None:
            lacking = "energy_keV in [light_yield]" if crystal.formula else "a formula"
            refused[SOURCE_DEPTH] = f"there is no {lacking}"
        else:
            energy, density = campaign.light_yield.energy_keV, crystal.density_g_per_cm3
            try:
                depth = attenuation_length_mm(crystal.formula, energy, density)
            except InputError as error:
                refused[SOURCE_DEPTH] = error.problem
        return cls(band, depth, refused)

    @property
    def effects(self) -> dict[str, dict[str, float]]:
        """Effects whose size is known and that are not refused, with their parameters."""
        sizes_of: dict[str, dict[str, float]] = {POLARIZATION: {}}
        if self.depth is not None:
            sizes_of[SOURCE_DEPTH] = {DEPTH_MM: round(self.depth.length_mm, 5)}
        if self.band is not None:
            sizes_of[CRYSTAL_INDEX] = {INDEX: round(self.band.over.mean, 5)}
        return {name: sizes for name, sizes in sizes_of.items() if name not in self.refused}

    def put_into(self, scene: SceneFile, *effects: str) -> SceneFile:
        """The scene with some of the `effects` in its text; errors as `add`."""
        for name in effects:
            scene = scene.edited(add(name, scene, self.effects[name]))
        return scene

    def left_out_of(self, campaign: Campaign) -> KnownCrystal:
        """What is known, with what the campaign has already or cannot take among the `refused`."""
        reasons = {name: self._reason_against(name, campaign) for name in self.effects}
        refused = {name: reason for name, reason in reasons.items() if reason is not None}
        return replace(self, refused=self.refused | refused)

    def _reason_against(self, name: str, campaign: Campaign) -> str | None:
        """Why a piece of known physics is not put into the model; None where it can be."""
        has = name in (*campaign.effects, *campaign.known_physics)
        if not has and name not in campaign.catalogue:
            return "it was taken out of the catalogue"
        if has or campaign.catalogue[name].is_in(campaign.scene):
            return _IN_THE_MODEL
        if name == POLARIZATION and without_wrapping(campaign.scene) is None:
            return _UNPOLARISED
        for parameter in self.effects[name] or [name]:
            if parameter in campaign.parameters:
                return f"{parameter} is a parameter of the campaign"
            if parameter in campaign.varied:
                return f"{parameter} differs from reading to reading"
        for sample in campaign.samples.values():
            if name == SOURCE_DEPTH and SCALE in sample.own:
                return f"the sample {sample.name} may be of another material"
        if name == SOURCE_DEPTH and (energy := _another_line(campaign)) is not None:
            return f"gammas of {energy:g} keV, which rows are of, stop at another depth"
        try:
            campaign.with_effects([name])
            self.put_into(campaign.scene, name)
        except InputError as error:
            return error.problem
        return None


def _another_line(campaign: Campaign) -> float | None:
    """Energy of a row, keV, that is not that of the light yield; None where there is none."""
    rows = [row.energy_keV for row in campaign.measurements.readings]
    own = None if campaign.light_yield is None else campaign.light_yield.energy_keV
    return next((energy for energy in rows if energy not in (None, own)), None)


def with_known_physics(campaign: Campaign) -> Campaign:
    """The campaign with the physics that its material and its energy tell in its scene.

    Nothing changes where one of the two is not named, or with the article's convention. What the
    campaign or its scene say otherwise of one of these effects stays as it is.

    Raises InputError if the material's index is not known over the spectrum.
    """
    name = material_of(campaign)
    if name is None or campaign.light_yield is None or campaign.convention == ARTICLE:
        return campaign
    crystal = KnownCrystal.of(campaign, name, assumed=False).left_out_of(campaign)
    words = [
        campaign.catalogue[effect].title + "".join(f" ({n} = {v:.4g})" for n, v in sizes.items())
        for effect, sizes in crystal.effects.items()
    ]
    named = f"{name} and {campaign.light_yield.energy_keV:g} keV are named"
    begin, but = f"in the model, as {named}: ", "but not "
    if not words:
        begin, but = f"not in the model, though {named}: ", ""
    refused = {effect: why for effect, why in crystal.refused.items() if why != _IN_THE_MODEL}
    words += [f"{but}{campaign.catalogue[effect].title}: {why}" for effect, why in refused.items()]
    scene, effects = crystal.put_into(campaign.scene, *crystal.effects), tuple(crystal.effects)
    note = begin + "; ".join(words) if words else ""
    return replace(campaign, scene=scene, known_physics=effects, physics_note=note)
