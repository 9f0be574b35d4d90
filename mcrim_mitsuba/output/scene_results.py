"""What the public functions on scenes give: typed results that show and export themselves.

Each is what a function of `efficiency`, `reference` or `transport` computed, with what is needed
to show it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.numbers import said
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.arrival_times import ArrivalTimes
from mcrim_mitsuba.efficiency.attenuation import Attenuation
from mcrim_mitsuba.efficiency.eta_spectrum import EtaSpectrum
from mcrim_mitsuba.efficiency.lighting import EtaMap, Light, Spread, follow_light
from mcrim_mitsuba.efficiency.table import EtaTable
from mcrim_mitsuba.output.registry import Result
from mcrim_mitsuba.reference.crosscheck import Crosscheck
from mcrim_mitsuba.scene.check_text import CheckReport
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.simulation import Simulation, SimulationResult

#: Photons of figures, at most: more would not be seen.
MOST_FOR_FIGURES = 4_000_000


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LightResult(Result, SimulationResult):
    """Light collection efficiency of one configuration, with every photon's fate."""

    scene: SceneFile
    run: Run
    #: Loaded into Mitsuba; None in another process than its own.
    simulation: Simulation | None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "simulation": None}

    @property
    def of_detectors(self) -> dict[str, dict[str, float]]:
        """What `--json` writes of several detectors; empty where there is one."""
        names = ("eta_by_detector", "eta_by_detector_sigma")
        return {name: getattr(self, name) for name in names if self.eta_by_detector}

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of its figures; none without photons."""
        return super().pictures if self.photons else ()

    @cached_property
    def lights(self) -> list[tuple[str, Light]]:
        """Where its light arrives, under the scene's name: its photons are followed again."""
        run, scene = self.run, self.scene
        how: dict[str, Any] = {"variant": run.variant, "threads": run.threads, "check": False}
        simulation = self.simulation or Simulation(scene, **how)
        photons = min(self.photons, MOST_FOR_FIGURES)
        light = follow_light(simulation, run=replace(run, photons=photons))
        # with the run's own numbers: it may have more photons than are followed again
        names = ("eta", "eta_sigma", "budget", "budget_sigma", "photons")
        light = replace(light, **{name: getattr(self, name) for name in names})
        changed = [said(name, scene.parameters[name]) for name in scene.overrides]
        return [(", ".join([scene.path.name, *changed]), light)]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MapResult(Result, EtaMap):
    """Light collection efficiency by where light is born."""

    #: What eta varies by over where gammas stop.
    gamma_spreads: tuple[Spread, ...]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SpectrumResult(Result, EtaSpectrum):
    """Light collection efficiency over the emission's wavelengths."""

    @property
    def wavelengths(self) -> list[dict[str, float]]:
        """Eta, the light and the parameters that vary, of each wavelength."""
        columns = attributes(
            self,
            "wavelength_nm=light.wavelength_nm eta eta_sigma detected_part emission=light.emission "
            "efficiency=light.efficiency **light.parameters",
        )
        rows = zip(*columns.values(), strict=True)
        return [dict(zip(columns, map(float, row), strict=True)) for row in rows]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TimesResult(Result, ArrivalTimes):
    """When detected photons arrive."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TableResult(Result, EtaTable):
    """Light collection efficiency over parameters of a scene."""

    #: Wall time.
    seconds: float

    @property
    def of_attenuation(self) -> dict[str, tuple[Attenuation, ...]]:
        """What `--json` writes of attenuation lengths; empty where none were fitted."""
        return {"attenuation": self.attenuation} if self.attenuation else {}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class CheckResult(Result, CheckReport):
    """Whether a scene is sound, and what it means in words."""

    scene: str | Path | SceneFile
    overrides: Mapping[str, Any]
    run: Run


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class CrosscheckResult(Result, Crosscheck):
    """Mitsuba beside the independent tracer, fate by fate."""

    seed: int

    @property
    def photons(self) -> dict[str, int]:
        """Followed by each program."""
        return {"mitsuba": self.mitsuba_photons, "numpy": self.numpy_photons}
