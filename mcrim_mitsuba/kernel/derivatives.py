"""Derivatives of eta by Dr.Jit's automatic differentiation, through the simulation itself.

Photon records give the same derivatives at every point for nothing; these are here to hold them
against, and for scenes of which no records are wanted.
"""

from __future__ import annotations

from dataclasses import dataclass

from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.kernel import transport
from mcrim_mitsuba.kernel.collection import choose_path
from mcrim_mitsuba.kernel.lane_plan import plan_lanes
from mcrim_mitsuba.units import MM_PER_CM

_TANGENTS = {
    ALPHA_SCAT: transport.Tangent(alpha_scat_per_mm=1.0 / MM_PER_CM),
    ALPHA_ABS: transport.Tangent(alpha_abs_per_mm=1.0 / MM_PER_CM),
}


@dataclass(frozen=True)
class EtaSlope:
    """Eta and its derivative, each with its standard error; cm for the derivative."""

    eta: float
    eta_sigma: float
    slope: float
    slope_sigma: float


def eta_slope(simulation, name: str, *, photons: int, seed: int = 0) -> EtaSlope:
    """Derivative of eta with respect to a coefficient of the crystal.

    Photons' ways stay as they are drawn; their weights, and the probabilities with which
    they were drawn, are differentiated (Dr.Jit's forward mode through the transport loop).

    Parameters
    ----------
    simulation : kernel.simulation.Simulation
        Scattering: alpha_scat above 0.
    name : str
        ``alpha_scat_per_cm`` or ``alpha_abs_per_cm``.
    photons : int
        Followed in one launch: some millions at most.
    seed : int
    """
    found = transport.launch(
        choose_path(simulation.model, simulation.polarization),
        simulation.crystal,
        plan_lanes(photons),
        seed=seed,
        number=0,
        max_depth=simulation.depth_limit,
        tangent=_TANGENTS[name],
    )
    values = []
    for sums in (found.weights["detected"], found.detected_slope):
        each = sums / found.photons_per_batch
        values += [float(each.mean()), float(each.std(ddof=1) / len(each) ** 0.5)]
    return EtaSlope(*values)
