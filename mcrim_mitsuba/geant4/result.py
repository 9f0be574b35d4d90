"""What a Geant4 run hands back."""

from __future__ import annotations

from dataclasses import dataclass

#: Volumes in which the light that ends is counted, and what the other programs call that fate.
DETECTOR, CRYSTAL, MASK = "detector", "crystal", "mask"
FATES = {DETECTOR: "detected", CRYSTAL: "absorbed_crystal", MASK: "absorbed_aperture"}
#: Escaped, or absorbed in the gap or the window.
ELSEWHERE = "elsewhere"


class Geant4Error(RuntimeError):
    """Geant4 ended without a result; one line says how."""


@dataclass(frozen=True)
class Geant4Result:
    """Every photon's fate, counted.

    Attributes
    ----------
    photons, seed, threads : int
    counts : dict of str to int
        Photons by fate; the values add up to ``photons``. The fates: detected, absorbed_crystal,
        absorbed_aperture and elsewhere (escaped, or absorbed in the gap or the window).
    seconds : float
        Wall time of the event loop.
    start_up_seconds : float
        Wall time of everything else: the process, Geant4's initialisation, its threads.
    version : str
        Geant4's, such as ``11.4.1``.
    """

    photons: int
    seed: int
    threads: int
    counts: dict[str, int]
    seconds: float
    start_up_seconds: float
    version: str

    @property
    def budget(self) -> dict[str, float]:
        """Fraction of the emitted photons by fate."""
        return {fate: count / self.photons for fate, count in self.counts.items()}

    @property
    def budget_sigma(self) -> dict[str, float]:
        """Standard deviation of each fraction: that of Beta(k + 1, n - k + 1), never 0."""
        n = self.photons
        return {
            fate: ((k + 1) * (n - k + 1) / ((n + 2) ** 2 * (n + 3))) ** 0.5
            for fate, k in self.counts.items()
        }

    @property
    def eta(self) -> float:
        """Light collection efficiency: detected over emitted."""
        return self.budget["detected"]

    @property
    def eta_sigma(self) -> float:
        """Standard deviation of `eta`."""
        return self.budget_sigma["detected"]
