"""Simulates what the neglected pieces of a campaign need, and puts them in."""

from __future__ import annotations

import functools
from dataclasses import replace

from mcrim_mitsuba.diagnosing import Provenance, Workbench
from mcrim_mitsuba.effects import add
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.neglect import pieces
from mcrim_mitsuba.neglect.crystal import KnownCrystal
from mcrim_mitsuba.neglect.pieces import (
    CRYSTAL_INDEX,
    DEPTH_MM,
    INDEX,
    POLARIZATION,
    SOURCE_DEPTH,
    Refit,
    Refitter,
)
from mcrim_mitsuba.neglect.result import Neglected
from mcrim_mitsuba.recording import RunOptions
from mcrim_mitsuba.work import Progress

_IN_THE_MODEL = "it is in the model"


class NeglectWork:
    """A campaign's benches, as they are and with what can be put into a scene, and their fits.

    All benches draw the same random numbers.

    Parameters
    ----------
    campaign : Campaign
    known : KnownCrystal
    options : RunOptions
    photons : int
        Of every simulation with another index.
    progress : callable or None

    Attributes
    ----------
    bench : Workbench
        Of the campaign as it is.
    refused : dict of str to str
        Pieces that were not put in, and why.
    """

    def __init__(
        self,
        campaign: Campaign,
        known: KnownCrystal,
        options: RunOptions,
        photons: int,
        progress: Progress | None,
    ) -> None:
        self.refused = dict(known.refused)
        self._campaign, self._band, self._length = campaign, known.band, known.depth
        self._options, self._photons, self._progress = options, photons, progress
        self._has_depth, self._has_index = self._takes_depth(), self._takes_index()
        self._has_polarization = self._takes_polarization()
        self._index = (CRYSTAL_INDEX,) * self._has_index
        self._benches: list[Workbench] = []
        # births can be weighted too: that tells what the depth's error does
        self.bench = self._bench(campaign, (*self._index, *(SOURCE_DEPTH,) * self._has_depth))
        self._own = Refitter(campaign, self.bench.responses)

    def _takes_depth(self) -> bool:
        campaign = self._campaign
        if self._length is None:
            return False
        if SOURCE_DEPTH in campaign.effects or DEPTH_MM in campaign.scene.parameters:
            self.refused[SOURCE_DEPTH] = _IN_THE_MODEL
            return False
        try:
            campaign.with_effects([SOURCE_DEPTH])
            self._with(depth=True)
        except InputError as error:
            self.refused[SOURCE_DEPTH] = error.problem
            return False
        return True

    def _takes_index(self) -> bool:
        campaign = self._campaign
        if self._band is None:
            return False
        if CRYSTAL_INDEX in campaign.effects or INDEX in campaign.parameters:
            self.refused["indices"] = f"{INDEX} is a parameter of the campaign"
            return False
        try:
            campaign.with_effects([CRYSTAL_INDEX])
            pieces.refuse_far(campaign, self._band)
        except InputError as error:
            self.refused["indices"] = error.problem
            return False
        return True

    def _takes_polarization(self) -> bool:
        campaign = self._campaign
        present = campaign.scene.parameters.get(POLARIZATION)
        if POLARIZATION in campaign.effects or present is True:
            self.refused[POLARIZATION] = _IN_THE_MODEL
        elif present is not False or POLARIZATION in campaign.measurements.columns:
            self.refused[POLARIZATION] = "the scene has no parameter polarization to be set"
        else:
            return True
        return False

    def _with(self, *, depth: bool = False, polarization: bool = False) -> Campaign:
        """The campaign with another scene."""
        scene = self._campaign.scene
        if depth and self._length is not None:
            scene = scene.edited(add(SOURCE_DEPTH, scene, {DEPTH_MM: self._length.length_mm}))
        if polarization:
            scene = scene.with_overrides({POLARIZATION: True})
        return replace(self._campaign, scene=scene)

    def _bench(self, campaign: Campaign, effects: tuple[str, ...]) -> Workbench:
        bench = Workbench(campaign, self._options, self._photons, self._progress)
        bench.simulate_with(effects)
        self._benches.append(bench)
        return bench

    def _refitter(self, effects: tuple[str, ...] = (), **scene: bool) -> Refitter:
        """Fits on another bench, compared with the campaign's own."""
        if not any(scene.values()):
            return self._own
        campaign = self._with(**scene)
        return Refitter(campaign, self._bench(campaign, effects).responses, self._own.fixed)

    def neglected(self) -> tuple[Neglected, ...]:
        """Every piece by itself, corrections first."""
        found = []
        if self._has_depth and self._length is not None:
            with_it = self._refitter(depth=True).own
            found.append(pieces.source_depth(self._own, with_it, self._length))
        if self._has_polarization:
            found.append(pieces.polarization(self._own, self._refitter(polarization=True).own))
        if self._has_index and self._band is not None:
            found.append(pieces.crystal_index(self._own, self._band))
            found.append(pieces.index_spread(self._own, self._band))
            if self._band.material.extraordinary is not None:
                found.append(pieces.birefringence(self._own, self._band))
        return tuple(found)

    def together(self, neglected: tuple[Neglected, ...]) -> Neglected | None:
        """All corrections in one fit."""
        if self.corrected is None:
            return None
        return Neglected(
            "together",
            "all corrections",
            correction=True,
            put_in=", ".join(piece.title for piece in neglected if piece.correction),
            mend="as each of them",
            **pieces.compared(self._own.own, self.corrected),
        )

    @functools.cached_property
    def corrected(self) -> Refit | None:
        """The fit with all corrections."""
        scene = {"depth": self._has_depth, "polarization": self._has_polarization}
        if not self._has_index and not any(scene.values()):
            return None
        refitter = self._refitter(self._index, **scene)
        if not self._has_index or self._band is None:
            return refitter.own
        return refitter.fit({CRYSTAL_INDEX: pieces.index_held(self._band.over.mean)})

    def provenance(self) -> Provenance:
        """Of all benches together."""
        each = [bench.provenance() for bench in self._benches]
        return replace(
            each[0],
            photons=sum(one.photons for one in each),
            cached_photons=sum(one.cached_photons for one in each),
            notes=tuple(dict.fromkeys(note for one in each for note in one.notes)),
        )
