"""What a simulation hands back; knows nothing of Mitsuba."""

from __future__ import annotations

from dataclasses import dataclass

from mcrim_mitsuba.files.values import Value


@dataclass(frozen=True)
class SimulationResult:
    """The light collection efficiency of one configuration, with every photon accounted for.

    Attributes
    ----------
    eta, eta_sigma : float
        Energy that reaches the detector over energy emitted, and its standard error.
    photons : int
        Photons followed; fewer than `requested` after an interrupt.
    requested : int
    seed : int
    seconds : float
        Wall time of the transport, kernel compilation included.
    budget, budget_sigma : dict of str to float
        Fraction of the energy per fate (they sum to 1) and its standard error: ``detected``,
        ``absorbed_<medium>``, ``absorbed_aperture``, ``absorbed_reflector``,
        ``absorbed_surface`` (lost by a surface that is none of these), ``escaped``,
        ``truncated`` (still under way after the depth limit), ``lost`` (left a volume without
        crossing a face, by rounding).
    parameters : dict
        Effective scene parameters.
    polarization : bool
        Whether polarisation was followed.
    transport : str
        Which path of the transport was taken.
    versions : dict of str to str
    scene_hash : str
        SHA-256 of the scene after substitution.
    interrupted : bool
    cached_photons : int
        Photons of an earlier run that was kept; `seconds` is then the time that all took.
    notes : tuple of str
        What the reader must know before using the number.
    """

    eta: float
    eta_sigma: float
    photons: int
    requested: int
    seed: int
    seconds: float
    budget: dict[str, float]
    budget_sigma: dict[str, float]
    parameters: dict[str, Value]
    polarization: bool
    transport: str
    versions: dict[str, str]
    scene_hash: str
    interrupted: bool = False
    cached_photons: int = 0
    notes: tuple[str, ...] = ()

    @property
    def photons_per_second(self) -> float:
        """Photons followed per second of wall time."""
        return self.photons / self.seconds
