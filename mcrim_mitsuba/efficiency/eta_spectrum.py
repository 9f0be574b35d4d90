"""The light collection efficiency over the emission's wavelengths, from few simulations.

Coefficients of scattering and absorption only weight photons' histories, so that one simulation
answers every wavelength. Indices bend light and cannot be weighted, nor can a photocathode's: the
bench is simulated at some nodes in 1 / wavelength^2, in which dispersion is nearly a line, with the
same random numbers, and eta is a polynomial between them.

Light of a wavelength counts as it is emitted, collected and detected: the signal is the integral of
emission, eta and quantum efficiency (Eqs. 2 and 3 of V. Alenkov et al., JINST 8 (2013) P06002, with
eta inside of the integral).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.numbers import COEFFICIENTS
from mcrim_mitsuba.core.run import OverAxes, Run
from mcrim_mitsuba.efficiency.eta_grid import standard_error
from mcrim_mitsuba.efficiency.eta_surface import EtaRequest, record_surfaces
from mcrim_mitsuba.efficiency.surface import Coefficients, Lagrange, chebyshev_nodes
from mcrim_mitsuba.scene.emitted_light import WAVELENGTH, EmittedLight
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:
    import xarray

#: Photons of a simulation unless asked otherwise.
PHOTONS = 2_000_000
#: Simulations where an index varies, and where the scene's wavelength is a photocathode's.
NODES = 4
_NODES_OF_FILM = 14


@dataclass(frozen=True, eq=False, kw_only=True)
class EtaSpectrum(OverAxes):
    """Efficiency by wavelength, and its means over the light; errors are Monte Carlo's.

    Of a solver there are 0 photons, and errors are its own.
    """

    light: EmittedLight
    #: (wavelengths,) float64
    eta: Array
    eta_sigma: Array
    #: Mean over the emitted light, and over the light as it is detected.
    eta_emitted: float
    eta_emitted_sigma: float
    eta_detected: float
    eta_detected_sigma: float
    #: Mean of the detector's efficiency over the emission (Eq. 3), which is that of the light that
    #: arrives only if eta is the same at all wavelengths; and over the light that arrives.
    efficiency_emitted: float
    efficiency_arriving: float
    efficiency_arriving_sigma: float
    #: Eta at the light's mean wavelength alone.
    eta_at_mean: float
    eta_at_mean_sigma: float
    #: What is detected at the mean wavelength, times Eq. 3, over what is, less 1.
    one_wavelength_off: float
    one_wavelength_off_sigma: float
    #: Largest relative error that the polynomial between nodes may make; 0 with one simulation.
    interpolation_error: float
    #: Wavelengths that were simulated; one where no index varies.
    nodes_nm: tuple[float, ...]
    cached_photons: int

    @property
    def detected_part(self) -> Array:
        """(wavelengths,) light that is detected, per nm; its integral by trapezoids is 1."""
        seen = self.light.emission * self.eta * self.light.efficiency
        return np.asarray(seen / np.trapezoid(seen, self.light.wavelength_nm), float)

    def to_xarray(self) -> xarray.Dataset:
        """A dataset over wavelength_nm, with attributes that make it reproducible."""
        columns = attributes(
            self,
            "eta eta_sigma detected_part emission=light.emission efficiency=light.efficiency "
            "**light.parameters",
        )
        values = {name: (WAVELENGTH, numbers) for name, numbers in columns.items()}
        dataset = self.dataset(values, {WAVELENGTH: self.light.wavelength_nm})
        dataset.eta.attrs["long_name"] = "light collection efficiency"
        return dataset


#: ``solver(benches, scattering, absorption, run)`` gives the efficiency of every bench, and its
#: error, at (points,) coefficients, 1/cm.
Solver = Callable[[Sequence[SceneFile], Array, Array, Run], list[tuple[Array, Array]]]


def eta_over(
    scene: SceneFile, light: EmittedLight, *, solver: Solver | None = None, run: Run = Run()
) -> EtaSpectrum:
    """Efficiency at every wavelength of light.

    A `solver` answers in place of photons; its own errors, taken to change evenly over the band,
    stand for Monte Carlo's. A run has `PHOTONS` for each simulation where it says nothing; with a
    precision, as many as it takes for every wavelength.

    Raises InputError if the scene is not sound or lacks coefficients, photons cannot answer a
    wavelength, a value is out of range, or the solver does not know such a bench.
    """
    plan = _Plan.of(scene, light)
    answer, photons, cached_photons = (
        _by_photons(plan, run) if solver is None else _by_solver(plan, solver, run)
    )
    weights, fewer = _between(plan.nodes_nm, plan.asked_nm)
    batches = np.einsum("wn,nbw->bw", weights, answer)
    eta = batches.mean(axis=0)
    # what the polynomial misses: without its farthest node, and of columns with edges between nodes
    off = np.einsum("wn,nbw->w", fewer - weights, answer) / len(batches) / eta
    for column in (c for name, c in light.parameters.items() if name not in COEFFICIENTS):
        missed = weights[:-1] @ np.interp(plan.nodes_nm, light.wavelength_nm, column) - column
        off = np.append(off, missed / np.abs(column).max(initial=1e-30))
    return EtaSpectrum(
        light=light,
        eta=eta[:-1],
        eta_sigma=standard_error(batches[:, :-1]),
        **_means(light, batches),
        interpolation_error=float(np.abs(off).max()),
        nodes_nm=tuple(plan.nodes_nm.tolist()),
        photons=photons,
        cached_photons=cached_photons,
        seed=run.seed,
        parameters=dict(scene.parameters),
        scene_hash=scene.content_hash,
    )


@dataclass(frozen=True, eq=False)
class _Plan:
    """The benches to simulate, and what they are asked."""

    #: (wavelengths + 1,) float64: Of the light, rising, and its mean at the end.
    asked_nm: Array
    #: Scattering and absorption there, 1/cm.
    points: list[Coefficients]
    #: (nodes,) float64: Wavelengths of the benches; the mean alone where no index varies.
    nodes_nm: Array
    benches: list[SceneFile]

    @classmethod
    def of(cls, scene: SceneFile, light: EmittedLight) -> _Plan:
        at, mean_nm = light.wavelength_nm, light.mean_nm
        asked = np.append(at, mean_nm)
        points = [_coefficients(scene, light, nm) for nm in asked.tolist()]
        bending = [name for name in light.parameters if name not in COEFFICIENTS]
        # that of a photocathode, or of fine roughness
        follows = [WAVELENGTH] if WAVELENGTH in scene.parameters else []
        nodes = np.array([mean_nm])
        if follows or any(np.ptp(light.parameters[name]) > 0.0 for name in bending):
            ends = 1.0 / at[-1] ** 2, 1.0 / at[0] ** 2
            nodes = 1.0 / np.sqrt(chebyshev_nodes(*ends, _NODES_OF_FILM if follows else NODES))
        values = [{**light.at(nm), WAVELENGTH: nm} for nm in nodes.tolist()]
        benches = [scene.with_overrides({n: at[n] for n in bending + follows}) for at in values]
        return cls(asked, points, nodes, benches)


#: (benches, batches, points) efficiencies whose spread over batches is their error, batches of one
#: number belonging together; photons, and those of them that are cached.
_Answer = tuple[Array, int, int]


def _by_solver(plan: _Plan, solver: Solver, run: Run) -> _Answer:
    """Four batches, the mean of which has the solver's error.

    All wavelengths are off alike, and one end of the band is up with the other one down; a pair
    +-x adds x^2 / 6 to the mean's variance.
    """
    scattering, absorption = np.array(plan.points).T
    tilt = np.interp(plan.asked_nm, plan.asked_nm[[0, -2]], (-1.0, 1.0))
    alike = np.ones_like(tilt)
    signs = math.sqrt(6.0) * np.array([tilt, -tilt, alike, -alike])
    solved = solver(plan.benches, scattering, absorption, run)
    return np.array([eta + signs * error for eta, error in solved]), 0, 0


def _by_photons(plan: _Plan, run: Run) -> _Answer:
    """Batches of photons; errors as `eta_over`."""
    if run.photons is None and run.precision is None:
        run = replace(run, photons=PHOTONS)
    benches = zip(plan.nodes_nm, plan.benches, strict=True)
    requests = [EtaRequest(f"{nm:.0f} nm", bench, plan.points, run) for nm, bench in benches]
    records = record_surfaces(requests)
    rows = []
    for surface, _ in records:
        for nm, point in zip(plan.asked_nm, plan.points, strict=True):
            if surface.answer(point) is None:
                problem = f"too few photons tell eta at {nm:.0f} nm"
                mend = "follow more, or cut the spectrum there"
                raise InputError(problem, mend, path=plan.benches[0].path)
        rows.append(surface.batches(plan.points))
    photons = sum(spent.photons for _, spent in records)
    return np.array(rows), photons, sum(spent.cached_photons for _, spent in records)


def _means(light: EmittedLight, batches: Array) -> dict[str, float]:
    """Means over the emission spectrum, and their errors, by the names of `EtaSpectrum`.

    `batches`, (batches, wavelengths + 1), are efficiencies; the last column is at the mean
    wavelength.
    """
    efficiency = float((light.weights * light.efficiency).sum())
    # (batches,): eta over the emission, eta times detector efficiency over it, eta at the mean
    eta = batches[:, :-1] @ light.weights
    detected = batches[:, :-1] @ (light.weights * light.efficiency)
    at_mean = batches[:, -1]
    # relative to their means, for the errors of quotients are those of the differences
    off_eta, off_detected, off_at_mean = (x / x.mean() for x in (eta, detected, at_mean))
    #: by name: the mean, and its batches' relative deviations
    means = {
        "eta_emitted": (eta.mean(), off_eta),
        "eta_detected": (detected.mean() / efficiency, off_detected),
        "efficiency_arriving": (detected.mean() / eta.mean(), off_detected - off_eta),
        "one_wavelength_off": (
            at_mean.mean() * efficiency / detected.mean(),
            off_at_mean - off_detected,
        ),
        "eta_at_mean": (at_mean.mean(), off_at_mean),
    }
    numbers = {"efficiency_emitted": efficiency}
    for name, (mean, off) in means.items():
        numbers[name], numbers[f"{name}_sigma"] = float(mean), float(mean * standard_error(off))
    # a quotient so far; by how much it is off is its difference to 1
    numbers["one_wavelength_off"] -= 1.0
    return numbers


def _coefficients(scene: SceneFile, light: EmittedLight, wavelength_nm: float) -> Coefficients:
    """Scattering and absorption at a wavelength, 1/cm."""
    varying, values = light.at(wavelength_nm), []
    for name in COEFFICIENTS:
        value = varying.get(name, scene.parameters.get(name))
        if not isinstance(value, float):
            problem = f"the scene has no parameter {name}"
            raise InputError(problem, "declare the crystal's coefficients", path=scene.path)
        values.append(value)
    return values[0], values[1]


def _between(nodes_nm: Array, wavelength_nm: Array) -> tuple[Array, Array]:
    """(wavelengths, nodes) weights of the nodes, and those without the farthest node of each."""
    x, at = 1.0 / nodes_nm**2, 1.0 / wavelength_nm**2
    if len(x) == 1:
        return np.ones((len(at), 1)), np.ones((len(at), 1))
    fewer = np.zeros((len(at), len(x)))
    for row, place in zip(fewer, at, strict=True):
        kept = np.sort(np.argsort(np.abs(x - place), kind="stable")[:-1])
        row[kept] = Lagrange(x[kept]).weights(float(place))[0]
    return Lagrange(x).weights_at(at), fewer
