"""The whole error budget of a campaign: what its own errors do, and what its model leaves out."""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.inference import neglected
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.likelihood import Likelihood
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.inference.neglected import (
    CRYSTAL_INDEX,
    DEPTH_MM,
    INDEX,
    POLARIZATION,
    SOURCE_DEPTH,
    Neglected,
    Quantities,
    Refit,
    Refitter,
    Total,
    compared,
    fitted,
)
from mcrim_mitsuba.inference.workbench import Workbench
from mcrim_mitsuba.laboratory.error_budget import ErrorBudget, contribution
from mcrim_mitsuba.optics.emission_band import BandIndices, indices_over_band
from mcrim_mitsuba.optics.gammas import AttenuationLength, attenuation_length_mm
from mcrim_mitsuba.optics.materials import is_known


@dataclass(frozen=True, eq=False)
class KnownCrystal:
    """Indices over the emission band, and the depth at which gammas stop."""

    band: BandIndices | None
    depth: AttenuationLength | None
    #: Pieces that nothing is known for, and why.
    refused: dict[str, str]

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        material: str | None,
        emission: str | Path | None,
        wavelength_nm: float | None,
    ) -> KnownCrystal:
        """What the campaign tells, and what is given besides; see `budget`."""
        material = material or _material_of(campaign)
        if material is None:
            reason = "nothing tells what the crystal is made of: give --material, such as CaMoO4"
            return cls(None, None, dict.fromkeys((neglected.SOURCE_DEPTH, "indices"), reason))
        spectra = campaign.raw.efficiency if campaign.raw is not None else None
        spectrum = spectra.emission if spectra is not None and wavelength_nm is None else None
        if emission is not None:
            from mcrim_mitsuba.optics.spectrum_file import read_spectrum

            spectrum = read_spectrum(emission, "emission")
        efficiency = spectra.quantum_efficiency if spectra is not None else None
        band = indices_over_band(material, spectrum, efficiency, wavelength_nm)
        known = band.material
        if campaign.light_yield is None or known.formula is None:
            lacking = "energy_keV in [light_yield]" if known.formula else "a formula"
            return cls(band, None, {neglected.SOURCE_DEPTH: f"there is no {lacking}"})
        depth = attenuation_length_mm(
            known.formula, campaign.light_yield.energy_keV, known.density_g_per_cm3
        )
        return cls(band, depth, {})


def _material_of(campaign: Campaign) -> str | None:
    """What the campaign or its scene say that the crystal is made of."""
    named = campaign.scene.materials.get(neglected.INDEX)
    if named is not None:
        return named.material.name
    raw = campaign.raw
    if raw is None:
        return None
    given = [raw.source_depth.entry.formula] if raw.source_depth is not None else []
    if raw.absorption is not None and isinstance(raw.absorption.entry.n, str):
        given.append(raw.absorption.entry.n)
    return next((name for name in given if is_known(name)), None)


_IN_THE_MODEL = "it is in the model"


class NeglectWork:
    """A campaign's benches, as they are and with what can be put into a scene, and their fits.

    All benches draw the same random numbers.

    Parameters
    ----------
    campaign : Campaign
    known : KnownCrystal
    run : Run
        Its photons are those of every simulation with another index.

    Attributes
    ----------
    bench : Workbench
        Of the campaign as it is.
    refused : dict of str to str
        Pieces that were not put in, and why.
    """

    def __init__(self, campaign: Campaign, known: KnownCrystal, run: Run) -> None:
        self.refused = dict(known.refused)
        self._campaign, self._run = campaign, run
        self._depth, self._band = known.depth, known.band
        self._benches: list[Workbench] = []
        scene, effects = campaign.scene.parameters, campaign.effects
        if known.depth is not None:
            there = SOURCE_DEPTH in effects or DEPTH_MM in scene
            self._refuse_or(
                SOURCE_DEPTH, SOURCE_DEPTH, _IN_THE_MODEL if there else None,
                lambda: self._with(depth=True),
            )  # fmt: skip
            if SOURCE_DEPTH in self.refused:
                self._depth = None
        if (band := known.band) is not None:
            fitted = CRYSTAL_INDEX in effects or INDEX in campaign.parameters
            self._refuse_or(
                "indices", CRYSTAL_INDEX,
                f"{INDEX} is a parameter of the campaign" if fitted else None,
                lambda: neglected.refuse_far(campaign, band),
            )  # fmt: skip
            if "indices" in self.refused:
                self._band = None
        present = scene.get(POLARIZATION)
        if POLARIZATION in effects or present is True:
            self.refused[POLARIZATION] = _IN_THE_MODEL
        elif present is not False or POLARIZATION in campaign.measurements.columns:
            self.refused[POLARIZATION] = "the scene has no parameter polarization to be set"
        self._index = (CRYSTAL_INDEX,) * (self._band is not None)
        # births can be weighted too: that tells what the depth's error does
        depth = (SOURCE_DEPTH,) * (self._depth is not None)
        self.bench = self._bench(campaign, (*self._index, *depth))
        self._own = Refitter(campaign, self.bench.responses)

    def _refuse_or(
        self, piece: str, effect: str, problem: str | None, attempt: Callable[[], object]
    ) -> None:
        """Note why a piece cannot be put in: a problem that is known, or what trying says."""
        if problem is None:
            try:
                self._campaign.with_effects([effect])
                attempt()
            except InputError as error:
                problem = error.problem
        if problem is not None:
            self.refused[piece] = problem

    def _with(self, *, depth: bool = False, polarization: bool = False) -> Campaign:
        """The campaign with another scene."""
        scene = self._campaign.scene
        if depth and self._depth is not None:
            scene = scene.edited(add(SOURCE_DEPTH, scene, {DEPTH_MM: self._depth.length_mm}))
        if polarization:
            scene = scene.with_overrides({POLARIZATION: True})
        return replace(self._campaign, scene=scene)

    def _bench(self, campaign: Campaign, effects: tuple[str, ...]) -> Workbench:
        bench = Workbench(campaign, self._run)
        bench.simulate(effects)
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
        if self._depth is not None:
            with_it = self._refitter(depth=True).own
            found.append(neglected.source_depth(self._own, with_it, self._depth))
        if POLARIZATION not in self.refused:
            found.append(neglected.polarization(self._own, self._refitter(polarization=True).own))
        if self._band is not None:
            found.append(neglected.crystal_index(self._own, self._band))
            found.append(neglected.index_spread(self._own, self._band))
            if self._band.material.extraordinary is not None:
                found.append(neglected.birefringence(self._own, self._band))
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
            **compared(self._own.own, self.corrected),
        )

    @functools.cached_property
    def corrected(self) -> Refit | None:
        """The fit with all corrections."""
        scene = {
            "depth": self._depth is not None,
            "polarization": POLARIZATION not in self.refused,
        }
        if self._band is None and not any(scene.values()):
            return None
        refitter = self._refitter(self._index, **scene)
        if self._band is None:
            return refitter.own
        return refitter.fit({CRYSTAL_INDEX: neglected.held(INDEX, self._band.over.mean)})

    def provenance(self) -> Provenance:
        """Of all benches together."""
        each = [bench.provenance() for bench in self._benches]
        return replace(
            each[0],
            photons=sum(one.photons for one in each),
            cached_photons=sum(one.cached_photons for one in each),
            notes=tuple(dict.fromkeys(note for one in each for note in one.notes)),
        )


# ---- errors of fitted quantities by origin ----

#: Parts of an error smaller than this, relative to the largest, are rounding.
_ROUNDING = 1e-6
#: Priors that have advice of their own.
_PRIORS = {ALPHA_ABS: "absorption", neglected.DEPTH_MM: "source depth"}


def contributions_to(
    model: ResponseModel, found: Calibration, quantities: Quantities
) -> dict[str, ErrorBudget]:
    """The budget of every quantity, the detector's part of the light yield's included."""
    if any(fitted.at_bound is not None for fitted in found.parameters.values()):
        return {}
    theta = np.array([found.parameters[name].value for name in found.names])
    likelihood = Likelihood(model)
    # (quantities, used readings): how a reading moves a quantity
    pulled = quantities.slopes @ found.response[:, likelihood.used]
    readings = likelihood.errors_at(theta).readings
    parts = {"counts": np.sqrt(np.einsum("ij,jk,ik->i", pulled, readings, pulled))}
    for i, parameter in enumerate(model.free):
        if parameter.prior_sigma is not None:
            origin = _PRIORS.get(parameter.name, f"prior, {parameter.name}")
            moved = quantities.slopes @ found.covariance[:, i] / parameter.prior_sigma
            parts[origin] = np.abs(moved)
    parts["monte_carlo"] = quantities.sigmas
    budgets = {}
    known = model.campaign.light_yield
    for i, (name, value) in enumerate(
        zip(quantities.names, quantities.values.tolist(), strict=True)
    ):
        errors = {origin: float(part[i]) for origin, part in parts.items()}
        if name == LIGHT_YIELD and known is not None:
            yield_value = found.parameters[LIGHT_YIELD].value
            own = known.efficiency_parts or {"detector_efficiency": known.detector_efficiency_sigma}
            errors |= {
                origin: yield_value * sigma / known.detector_efficiency
                for origin, sigma in own.items()
            }
        if value:
            least = _ROUNDING * max(errors.values())
            budgets[name] = ErrorBudget(
                tuple(contribution(o, e / abs(value)) for o, e in errors.items() if e > least)
            )
    return budgets


def totals(
    own: Quantities,
    contributions: Mapping[str, ErrorBudget],
    neglected: tuple[Neglected, ...],
    corrected: neglected.Refit | None,
) -> dict[str, Total]:
    """Every quantity with all its errors, as it is and corrected."""
    after: dict[str, float] = {}
    budgets: dict[str, ErrorBudget] = {}
    if corrected is not None:
        quantities = corrected.refitted
        after = dict(zip(quantities.names, quantities.values.tolist(), strict=True))
        budgets = contributions_to(corrected.model, corrected.calibration, quantities)
    found = {}
    for name, value in zip(own.names, own.values.tolist(), strict=True):
        if name not in contributions:
            continue
        sigma = contributions[name].total * abs(value)
        lasting = math.hypot(*(p.refitted[name].as_error for p in neglected if not p.correction))
        total = Total(value, sigma, lasting)
        if name in budgets:
            sizes = (p.refitted[name].size_sigma for p in neglected if p.correction)
            parts = (budgets[name].total * abs(after[name]), lasting, *sizes)
            total = replace(total, corrected=after[name], corrected_sigma=math.hypot(*parts))
        found[name] = total
    return found


# ---- the whole ----

#: Photons of a simulation with another index, shared out among the configurations, and the fewest
#: of each. Simulations with one index get `responses.PLAIN_FACTOR` times as many.
DEFAULT_PHOTONS, FEWEST_PHOTONS = 1_048_576, 131_072


@dataclass(frozen=True, eq=False)
class Budget:
    """Where the errors of a campaign's results come from.

    Quantities have the names of `inference.neglected.Quantities`: the light yield (the scale
    without one), fitted parameters, efficiencies, and the ratio of two of them.
    """

    #: The campaign's own fit.
    calibration: Calibration
    #: Quantities that tables and figures show: the first two efficiencies, parameters without a
    #: prior, the light yield last.
    main: tuple[str, ...]
    #: By quantity; none where a parameter ended at its bound.
    contributions: dict[str, ErrorBudget]
    #: Pieces of physics that the model leaves out, corrections first.
    neglected: tuple[Neglected, ...]
    #: All corrections at once; None where there is none.
    together: Neglected | None
    #: By quantity.
    totals: dict[str, Total]
    #: Pieces that were not put in, and why.
    not_estimated: dict[str, str]
    provenance: Provenance

    @property
    def pieces(self) -> tuple[Neglected, ...]:
        """`neglected`, and `together` last where there are several corrections."""
        if self.together is None or sum(piece.correction for piece in self.neglected) < 2:
            return self.neglected
        return (*self.neglected, self.together)

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts; `provenance` apart."""
        return {
            "calibration": self.calibration.to_json(),
            "contributions": {
                name: {"total": each.total, "contributions": list(map(vars, each.contributions))}
                for name, each in self.contributions.items()
            },
            "neglected": [_plain(piece) for piece in self.neglected],
            "together": self.together and _plain(self.together),
            "totals": {
                name: vars(total) | {"sigma_with_neglected": total.sigma_with_neglected}
                for name, total in self.totals.items()
            },
            "not_estimated": self.not_estimated,
        }


def _plain(piece: Neglected) -> dict[str, Any]:
    """A piece with its shifts spelled out."""
    found = dataclasses.asdict(piece)
    for kind in ("at_fixed", "refitted"):
        for name, moved in getattr(piece, kind).items():
            found[kind][name] |= {"shift": moved.shift, "relative": moved.relative}
    return found


def budget(
    campaign: str | Path | Campaign,
    *,
    material: str | None = None,
    emission: str | Path | None = None,
    wavelength_nm: float | None = None,
    run: Run = Run(),
) -> Budget:
    """Fit a campaign, and fit it again with every piece of physics that it leaves out.

    The pieces: where the source's gammas stop, polarisation, the crystal's index at its emission,
    the spread of the index over the band, and birefringence. A campaign that has one of them
    already is not given it again.

    Parameters
    ----------
    campaign : str, Path or Campaign
    material : str, optional
        What the crystal is made of, as the catalogue of materials names it. Where neither this
        nor the campaign tells, nothing is known of indices and depth.
    emission : str or Path, optional
        File with the emission spectrum; without it the campaign's own, else a Gaussian band.
    wavelength_nm : float, optional
        Maximum of that band.
    run : Run
        Its photons are those of every configuration's simulation with another index; those with
        the scene's own get nine times as many. Its seed is the same for all of them: what they
        have in common cancels in the shifts.

    Raises
    ------
    InputError
        If a file is wrong, a scene is not sound, the readings do not determine the parameters, or
        the material or its band is not known.
    """
    start = time.perf_counter()
    campaign = as_campaign(campaign)
    known = KnownCrystal.of(campaign, material, emission, wavelength_nm)
    configurations = {tuple(r.parameters.items()) for r in campaign.measurements.readings}
    each = run.photons_or(max(DEFAULT_PHOTONS // len(configurations), FEWEST_PHOTONS))
    work = NeglectWork(campaign, known, replace(run, photons=each))
    model, found = work.bench.settled_model()
    own = fitted(model, found)
    contributions = contributions_to(model, found, own)
    neglected = work.neglected()
    return Budget(
        calibration=found,
        main=own.main(campaign.priors),
        contributions=contributions,
        neglected=neglected,
        together=work.together(neglected),
        totals=totals(own, contributions, neglected, work.corrected),
        not_estimated=work.refused,
        provenance=replace(work.provenance(), seconds=time.perf_counter() - start),
    )
