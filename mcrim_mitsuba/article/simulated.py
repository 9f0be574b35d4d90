"""The simulations behind the article's numbers: efficiency surfaces and single benches.

Main results follow the photons' polarisation, as the article's ZEMAX does; the surfaces exist
without it as well. The
couplings' seeds differ, so that their Monte Carlo errors are independent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.scenes import scene_path
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import read_scene
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.fit.surface import EtaPoint, Surface
from mcrim_mitsuba.recording import DEFAULT_VARIANT, RunOptions, SurfaceWish, record_surfaces
from mcrim_mitsuba.results import SimulationResult
from mcrim_mitsuba.simulating import collect
from mcrim_mitsuba.work import Progress

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.simulation import Simulation

AIR, GEL = "air", "gel"
COUPLINGS = {AIR: p.N_AIR.value, GEL: p.N_GEL.value}

#: Photons of each of the four surfaces. The Monte Carlo error of alpha_scat is then 0.005 /cm.
DEFAULT_PHOTONS = 8_000_000
FEWEST_PHOTONS = 200_000

#: Points of the article's range of alpha_scat at which a surface's shares are judged.
_SCANNED_POINTS = 12
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
    """The article's bench with one medium in the gap, at any coefficients of the crystal.

    Attributes
    ----------
    name : str
        ``air`` or ``gel``.
    polarised : bool
    surface : Surface
        Of alpha_scat and alpha_abs, over the article's range.
    """

    name: str
    polarised: bool
    surface: Surface

    @property
    def n_gap(self) -> float:
        """Refractive index of the gap."""
        return COUPLINGS[self.name]

    def at(self, alpha_scat_per_cm: float, alpha_abs_per_cm: float) -> EtaPoint:
        """Light collection efficiency at coefficients in 1/cm."""
        return self.surface.evaluate(alpha_scat_per_cm, alpha_abs_per_cm)


@dataclass(frozen=True)
class Simulated:
    """Everything that was simulated for the article.

    Attributes
    ----------
    couplings : dict
        `Coupling` by (``air`` or ``gel``, polarised).
    bare : dict of float to SimulationResult
        Eq. 6: crystals without scattering and absorption by their index relative to the
        surroundings; what is not ``truncated`` left the crystal.
    thin, thin_clear, cawo4 : SimulationResult
        ``thin_clear`` is the thin sample without absorption.
    wrapped : dict of float to SimulationResult
        By the reflectance of the wrapping.
    parameters : dict
        Scene parameters of the article's bench.
    scene_hashes : dict of str to str
        SHA-256 of each scene that was used, at its defaults.
    versions : dict of str to str
    """

    couplings: dict[tuple[str, bool], Coupling]
    bare: dict[float, SimulationResult]
    thin: SimulationResult
    thin_clear: SimulationResult
    cawo4: SimulationResult
    wrapped: dict[float, SimulationResult]
    parameters: dict[str, Value]
    scene_hashes: dict[str, str]
    versions: dict[str, str]

    def pair(self, polarised: bool) -> tuple[Coupling, Coupling]:
        """The two couplings, air first."""
        return self.couplings[AIR, polarised], self.couplings[GEL, polarised]


def simulate_article(
    *,
    photons: int = DEFAULT_PHOTONS,
    seed: int = 0,
    variant: str | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Simulated:
    """Run every simulation that the article's numbers need.

    Parameters
    ----------
    photons : int
        Of each of the four surfaces; single benches get a tenth.
    seed : int
    variant : str, optional
        Mitsuba variant; the package's default when not given.
    threads : int, optional
        Processor threads; all when not given.
    progress : callable, optional
        See `work.Progress`.

    Raises
    ------
    InputError
        If there are too few photons, or a scene cannot be used.
    KeyboardInterrupt
        If the user interrupts: half of the numbers are of no use.
    """
    if photons < FEWEST_PHOTONS:
        raise InputError(
            f"{photons:,} photons are too few for the article", f"give {FEWEST_PHOTONS:,} or more"
        )
    runner = _Runner(photons, seed, variant, threads, progress)
    couplings = runner.couplings()
    clear = {"alpha_scat_per_cm": 0.0, "alpha_abs_per_cm": 0.0, "n_gap": 1.0}
    indices = (p.N_CRYSTAL.value, p.N_CRYSTAL.value / p.N_GEL.value)
    polarised = {"polarization": True}
    return Simulated(
        couplings=couplings,
        bare={
            n: runner.single(
                "camoo4.xml", {**clear, "n_crystal": n}, f"bare crystal, n = {n:.4g}",
                max_depth=_BARE_MAX_DEPTH,
            )
            for n in indices
        },
        thin=runner.single("camoo4_thin.xml", polarised, "thin sample"),
        thin_clear=runner.single(
            "camoo4_thin.xml", {**polarised, "alpha_abs_per_cm": 0.0}, "thin sample, clear"
        ),
        cawo4=runner.single("cawo4.xml", polarised, "CaWO4"),
        wrapped={
            reflectance: runner.single(
                "camoo4_wrapped.xml", {**polarised, "wrap_reflectance": reflectance},
                f"wrapped cube, reflectance {reflectance:g}",
            )
            for reflectance in WRAP_REFLECTANCES
        },
        parameters=dict(read_scene(scene_path("camoo4.xml")).parameters),
        scene_hashes=runner.scene_hashes,
        versions=runner.versions,
    )  # fmt: skip


@dataclass
class _Runner:
    """Runs simulations with common settings and keeps their provenance."""

    photons: int
    seed: int
    variant: str | None
    threads: int | None
    progress: Progress | None
    scene_hashes: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    def couplings(self) -> dict[tuple[str, bool], Coupling]:
        """All couplings, polarised and not."""
        file = read_scene(scene_path("camoo4.xml"))
        self.scene_hashes["camoo4.xml"] = file.content_hash
        scanned = np.geomspace(p.SCANNED_FROM.value, p.SCANNED_TO.value, _SCANNED_POINTS)
        absorptions = [line.alpha_abs_per_cm.value for line in p.TABLE_1]
        points = [(scattering, absorption) for absorption in absorptions for scattering in scanned]
        wishes = {
            (name, polarised): SurfaceWish(
                f"{name}, {'polarised' if polarised else 'unpolarised'}",
                file.with_overrides({"n_gap": COUPLINGS[name], "polarization": polarised}),
                points,
                RunOptions(
                    self.seed + list(COUPLINGS).index(name),
                    self.variant or DEFAULT_VARIANT,
                    self.threads,
                ),
                self.photons,
            )
            for polarised in (True, False)
            for name in COUPLINGS
        }
        made = record_surfaces(list(wishes.values()), self.progress)
        return {
            key: Coupling(*key, surface) for key, (surface, _) in zip(wishes, made, strict=True)
        }

    def single(
        self, scene: str, overrides: Mapping[str, Value], what: str, max_depth: int | None = None
    ) -> SimulationResult:
        simulation = self._load(scene, overrides)
        if max_depth is not None:
            simulation.integrator.max_depth = max_depth
        result = collect(
            simulation, round(_SINGLE_SHARE * self.photons), seed=self.seed, threads=self.threads,
            progress=self.progress, what=what,
        )  # fmt: skip
        if result.interrupted:
            raise KeyboardInterrupt
        self.versions = dict(result.versions)
        return result

    def _load(self, scene: str, overrides: Mapping[str, Value]) -> Simulation:
        from mcrim_mitsuba.kernel.simulation import Simulation

        file = read_scene(scene_path(scene))
        self.scene_hashes[scene] = file.content_hash
        return Simulation(
            file, overrides, variant=self.variant or DEFAULT_VARIANT, threads=self.threads
        )
