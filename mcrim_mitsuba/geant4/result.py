"""What a Geant4 run hands back."""

from __future__ import annotations

from dataclasses import dataclass


class Geant4Error(RuntimeError):
    """Geant4 ended without a result; one line says how."""


@dataclass(frozen=True)
class Geant4Result:
    """Photons that Geant4 detected.

    Attributes
    ----------
    photons, seed, threads : int
    detected : int
        Photons that ended at the detector.
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
    detected: int
    seconds: float
    start_up_seconds: float
    version: str

    @property
    def eta(self) -> float:
        """Light collection efficiency: detected over emitted."""
        return self.detected / self.photons

    @property
    def eta_sigma(self) -> float:
        """Standard deviation of `eta`: that of Beta(k + 1, n - k + 1), never 0."""
        n, k = self.photons, self.detected
        return ((k + 1) * (n - k + 1) / ((n + 2) ** 2 * (n + 3))) ** 0.5
