"""The simulations behind the article's numbers, and the curves of Figs. 3 and 4.

Main results follow the photons' polarisation, as the article's ZEMAX does; the surfaces exist
without it as well. The couplings' seeds differ, so that their Monte Carlo errors are independent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import Table1Line
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.eta_surface import EtaRequest, EtaSurface, record_surfaces
from mcrim_mitsuba.efficiency.simulate import collect
from mcrim_mitsuba.efficiency.surface import Coefficients, EtaPoint
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.transport.simulation import SimulationResult

AIR = "air"
GEL = "gel"
COUPLINGS = {AIR: p.N_AIR.value, GEL: p.N_GEL.value}

#: Scenes: the article's bench, and its relatives.
BENCH = "camoo4.xml"
_THIN = "camoo4_thin.xml"
_CAWO4 = "cawo4.xml"
_WRAPPED = "camoo4_wrapped.xml"
_SCENES = (BENCH, _THIN, _CAWO4, _WRAPPED)

#: Photons of each of the four surfaces. The Monte Carlo error of alpha_scat is then 0.005 /cm.
DEFAULT_PHOTONS = 8_000_000
FEWEST_PHOTONS = 200_000

#: Absorptions that fits of the article's readings may try.
_ABSORPTION_PER_CM = (0.005, 0.2)
#: Photons of a single bench, as a share of a surface's.
_SINGLE_SHARE = 0.1
#: Free flights of Eq. 6's photons. Light in an escape cone needs a few; after 300, less than
#: 1e-5 of it is left, and all that is left is trapped.
_BARE_MAX_DEPTH = 300

#: The scene's reflectance of the wrapping, and the range that the article gives for Teflon tape.
DEFAULT_WRAP_REFLECTANCE = 0.97
WRAP_REFLECTANCES = (p.TEFLON_LOW.value, DEFAULT_WRAP_REFLECTANCE, p.TEFLON_HIGH.value)


@dataclass(frozen=True)
class Coupling:
    """The article's bench with one medium in the gap, at any coefficients of the crystal."""

    #: ``air`` or ``gel``.
    name: str
    polarised: bool
    #: Of alpha_scat and alpha_abs, over the article's range.
    surface: EtaSurface

    @property
    def n_gap(self) -> float:
        """Refractive index of the gap."""
        return COUPLINGS[self.name]

    def at(self, alpha_scat_per_cm: float, alpha_abs_per_cm: float) -> EtaPoint:
        """Light collection efficiency at coefficients in 1/cm."""
        return self.surface.evaluate(alpha_scat_per_cm, alpha_abs_per_cm)


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Everything that was simulated for the article."""

    #: `Coupling` by (``air`` or ``gel``, polarised).
    couplings: dict[tuple[str, bool], Coupling]
    #: Eq. 6: crystals without scattering and absorption by their index relative to the
    #: surroundings; what is not ``truncated`` left the crystal.
    bare: dict[float, SimulationResult]
    #: ``thin_clear`` is the thin sample without absorption.
    thin: SimulationResult
    thin_clear: SimulationResult
    cawo4: SimulationResult
    #: By the reflectance of the wrapping.
    wrapped: dict[float, SimulationResult]
    #: Scene parameters of the article's bench.
    parameters: dict[str, Value]

    def pair(self, polarised: bool) -> tuple[Coupling, Coupling]:
        """The two couplings, air first."""
        return self.couplings[AIR, polarised], self.couplings[GEL, polarised]

    @property
    def scene_hashes(self) -> dict[str, str]:
        """SHA-256 of each scene that was used, at its defaults."""
        return {name: read_scene(scene_path(name)).content_hash for name in _SCENES}

    @property
    def versions(self) -> dict[str, str]:
        """Versions of what simulated."""
        return dict(self.thin.versions)


def simulate_article(*, run: Run = Run()) -> Simulated:
    """Run every simulation that the article's numbers need.

    Parameters
    ----------
    run : Run
        Its photons are those of each of the four surfaces; single benches get a tenth.

    Raises
    ------
    InputError
        If there are too few photons, or a scene cannot be used.
    KeyboardInterrupt
        If the user interrupts: half of the numbers are of no use.
    """
    photons = run.photons_or(DEFAULT_PHOTONS)
    if photons < FEWEST_PHOTONS:
        problem = f"{photons:,} photons are too few for the article"
        raise InputError(problem, f"give {FEWEST_PHOTONS:,} or more")
    couplings = _couplings(replace(run, photons=photons, precision=None))
    run = replace(run, photons=round(_SINGLE_SHARE * photons), precision=None)
    clear = {ALPHA_SCAT: 0.0, ALPHA_ABS: 0.0, "n_gap": 1.0}
    polarised = {"polarization": True}
    return Simulated(
        couplings=couplings,
        bare={
            n: _single(
                BENCH,
                {**clear, "n_crystal": n},
                f"bare crystal, n = {n:.4g}",
                run,
                max_depth=_BARE_MAX_DEPTH,
            )
            for n in (p.N_CRYSTAL.value, p.N_CRYSTAL.value / p.N_GEL.value)
        },
        thin=_single(_THIN, polarised, "thin sample", run),
        thin_clear=_single(_THIN, {**polarised, ALPHA_ABS: 0.0}, "thin sample, clear", run),
        cawo4=_single(_CAWO4, polarised, "CaWO4", run),
        wrapped={
            reflectance: _single(
                _WRAPPED,
                {**polarised, "wrap_reflectance": reflectance},
                f"wrapped cube, reflectance {reflectance:g}",
                run,
            )
            for reflectance in WRAP_REFLECTANCES
        },
        parameters=dict(read_scene(scene_path(BENCH)).parameters),
    )


def _couplings(run: Run) -> dict[tuple[str, bool], Coupling]:
    """All couplings, polarised and not."""
    file = read_scene(scene_path(BENCH))
    scanned = p.SCANNED_FROM.value, p.SCANNED_TO.value
    absorptions = [line.alpha_abs_per_cm.value for line in p.TABLE_1]
    points = [(scattering, absorption) for absorption in absorptions for scattering in scanned]
    wishes = {
        (name, polarised): EtaRequest(
            f"{name}, {'polarised' if polarised else 'unpolarised'}",
            file.with_overrides({"n_gap": n_gap, "polarization": polarised}),
            points,
            replace(run, seed=run.seed + number),
            alpha_abs_range_per_cm=_ABSORPTION_PER_CM,
        )
        for polarised in (True, False)
        for number, (name, n_gap) in enumerate(COUPLINGS.items())
    }
    surfaces = record_surfaces(list(wishes.values()))
    return {
        key: Coupling(*key, surface) for key, (surface, _) in zip(wishes, surfaces, strict=True)
    }


def _single(
    scene: str, overrides: Mapping[str, Value], what: str, run: Run, max_depth: int | None = None
) -> SimulationResult:
    """A bench of its own; KeyboardInterrupt if the user interrupts."""
    from mcrim_mitsuba.transport.simulation import Simulation

    simulation = Simulation(scene_path(scene), overrides, variant=run.variant, threads=run.threads)
    result = collect(simulation, run=run, what=what, max_depth=max_depth)
    if result.interrupted:
        raise KeyboardInterrupt
    return result


# The curves of Figs. 3 and 4.

#: Points of a curve, equally spaced in log(alpha_scat).
_POINTS = 25


@dataclass(frozen=True)
class EtaCurve:
    """Light collection efficiency against scattering: one curve of Fig. 3.

    It has `_POINTS` values of alpha_scat, which share photons, at the absorption of a line of
    Table 1.
    """

    coupling: Coupling
    line: Table1Line

    @cached_property
    def alpha_scat_per_cm(self) -> Array:
        """(points,) where the curve is shown."""
        return np.geomspace(p.SCANNED_FROM.value, p.SCANNED_TO.value, _POINTS)

    @cached_property
    def etas(self) -> Array:
        """(points,)"""
        return self.smooth(self.alpha_scat_per_cm)

    @cached_property
    def sigmas(self) -> Array:
        """(points,) Monte Carlo standard errors."""
        points = self._points(self.alpha_scat_per_cm)
        return self.etas * self.coupling.surface.relative_sigmas(points)

    def smooth(self, alpha_scat_per_cm: Array) -> Array:
        """Efficiencies at many values, for drawing."""
        return self.coupling.surface.etas(self._points(alpha_scat_per_cm))

    def _points(self, alpha_scat_per_cm: Array) -> list[Coefficients]:
        return [(float(a), self.line.alpha_abs_per_cm.value) for a in alpha_scat_per_cm]


@dataclass(frozen=True)
class RatioCurve:
    """R = eta_air / eta_gel against scattering: one curve of Fig. 4."""

    air: EtaCurve
    gel: EtaCurve

    @property
    def line(self) -> Table1Line:
        """The line of Table 1 whose absorption the curve has."""
        return self.air.line

    @property
    def polarised(self) -> bool:
        """Whether the photons carried their polarisation."""
        return self.air.coupling.polarised

    @property
    def ratio(self) -> Array:
        """(points,) eta of air over that of gel."""
        return self.air.etas / self.gel.etas

    @property
    def sigma(self) -> Array:
        """Monte Carlo error; the errors of the two couplings are independent."""
        of_air, of_gel = (curve.sigmas / curve.etas for curve in (self.air, self.gel))
        return self.ratio * np.hypot(of_air, of_gel)

    def smooth(self, alpha_scat_per_cm: Array) -> Array:
        """R at many values, for drawing."""
        return self.air.smooth(alpha_scat_per_cm) / self.gel.smooth(alpha_scat_per_cm)


def eta_curves(simulated: Simulated) -> tuple[EtaCurve, ...]:
    """Fig. 3: three transmittances, two couplings, polarisation followed or not."""
    return tuple(EtaCurve(c, line) for c in simulated.couplings.values() for line in p.TABLE_1)


def ratio_curves(curves: tuple[EtaCurve, ...]) -> tuple[RatioCurve, ...]:
    """Fig. 4 from the curves of Fig. 3, in their order."""
    by_coupling = {(c.coupling.name, c.coupling.polarised, c.line): c for c in curves}
    return tuple(
        RatioCurve(air, by_coupling[GEL, polarised, line])
        for (name, polarised, line), air in by_coupling.items()
        if name == AIR
    )
