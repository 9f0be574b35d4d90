"""The light collection efficiency over the emission's wavelengths, from few simulations.

Coefficients of scattering and absorption only weight photons' histories, so that one simulation
answers every wavelength. Indices bend light and cannot be weighted: the bench is simulated at a few
nodes in 1 / wavelength^2, in which dispersion is nearly a line, with the same random numbers, and
eta is a polynomial between them.

Light of a wavelength counts as it is emitted, collected and detected: the signal is the integral of
emission, eta and quantum efficiency (Eqs. 2 and 3 of V. Alenkov et al., JINST 8 (2013) P06002, with
eta inside of the integral).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import COEFFICIENTS, Value, as_attributes
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.recording import SurfaceWish, record_surfaces
from mcrim_mitsuba.efficiency.surface import Lagrange, chebyshev_nodes
from mcrim_mitsuba.scene.emitted_light import EFFICIENCY, EMISSION, EmittedLight
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:
    import xarray

#: Photons of a simulation unless asked otherwise.
PHOTONS = 2_000_000
#: Simulations where an index varies.
NODES = 4


@dataclass(frozen=True, eq=False)
class EtaSpectrum:
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
    photons: int
    cached_photons: int
    seed: int
    #: Of the scene.
    parameters: Mapping[str, Value]
    scene_hash: str

    @property
    def detected_part(self) -> Array:
        """(wavelengths,) light that is detected, per nm; its integral by trapezoids is 1."""
        seen = self.light.emission * self.eta * self.light.efficiency
        area = float(np.trapezoid(seen, self.light.wavelength_nm))
        return np.asarray(seen / area, float)

    def to_xarray(self) -> xarray.Dataset:
        """Over wavelength_nm; attributes make it reproducible."""
        import xarray

        light, names = self.light, ("eta", "eta_sigma", "detected_part")
        made = xarray.Dataset(
            {name: ("wavelength_nm", getattr(self, name)) for name in names}
            | {name: ("wavelength_nm", getattr(light, name)) for name in (EMISSION, EFFICIENCY)}
            | {name: ("wavelength_nm", values) for name, values in light.parameters.items()},
            {"wavelength_nm": light.wavelength_nm},
            {"photons": self.photons, "seed": self.seed, "scene_hash": self.scene_hash}
            | as_attributes(self.parameters),
        )
        made.wavelength_nm.attrs["units"] = "nm"
        made.eta.attrs["long_name"] = "light collection efficiency"
        return made


#: ``solver(benches, scattering, absorption, run)`` gives the efficiency of every bench, and its
#: error, at (points,) coefficients, 1/cm.
Solver = Callable[[Sequence[SceneFile], Array, Array, Run], list[tuple[Array, Array]]]


def eta_over(
    scene: SceneFile, light: EmittedLight, *, solver: Solver | None = None, run: Run = Run()
) -> EtaSpectrum:
    """Efficiency at every wavelength.

    Parameters
    ----------
    scene : SceneFile
    light : EmittedLight
    solver : Solver, optional
        What answers in place of photons; its own errors, taken to change evenly over the band,
        stand for Monte Carlo's.
    run : Run
        `PHOTONS` of each simulation where it says nothing; with a precision, as many as it takes
        for every wavelength.

    Raises
    ------
    InputError
        If the scene is not sound or lacks coefficients, photons cannot answer a wavelength, a value
        is out of range, or the solver does not know such a bench.
    """
    at = light.wavelength_nm
    mean_nm = light.mean_nm
    asked = np.append(at, mean_nm)
    points = [_coefficients(scene, light, float(each)) for each in asked]
    bending = [name for name in light.parameters if name not in COEFFICIENTS]
    nodes = np.array([mean_nm])
    if bending:
        low, high = 1.0 / at[-1] ** 2, 1.0 / at[0] ** 2
        nodes = 1.0 / np.sqrt(chebyshev_nodes(low, high, NODES))
    benches = []
    for each in nodes.tolist():
        own = {name: value for name, value in light.at(each).items() if name in bending}
        benches.append(scene.with_overrides(own))
    photons = cached = 0
    if solver is not None:
        scattering, absorption = np.array(points).T
        solved = solver(benches, scattering, absorption, run)
        # as four batches, the mean of which has that error: all wavelengths off alike, and one end
        # of the band up with the other one down; a pair +-x adds x^2 / 6 to the mean's variance
        tilt = np.interp(asked, at[[0, -1]], (-1.0, 1.0))
        alike = np.ones_like(tilt)
        signs = math.sqrt(6.0) * np.array([tilt, -tilt, alike, -alike])
        batches = np.array([eta + signs * error for eta, error in solved])
    else:
        named = [f"{each:.0f} nm" for each in nodes]
        batches, photons, cached = _by_photons(benches, named, points, asked, run)
    weights, fewer = _between(nodes, asked)
    eta_batches = np.einsum("wn,nbw->bw", weights, batches)
    eta = eta_batches.mean(axis=0)
    off = np.abs(np.einsum("wn,nbw->w", fewer - weights, batches) / len(eta_batches) / eta)

    emitted = light.weights
    seen = emitted * light.efficiency
    per_batch = eta_batches[:, :-1]
    of_emitted, product, at_mean = per_batch @ emitted, per_batch @ seen, eta_batches[:, -1]
    efficiency = float(seen.sum())
    ratio = _with_error(
        product.mean() / of_emitted.mean(),
        product / product.mean() - of_emitted / of_emitted.mean(),
    )
    one = at_mean.mean() * efficiency / product.mean()
    one_off = _with_error(one, at_mean / at_mean.mean() - product / product.mean())
    return EtaSpectrum(
        light,
        eta[:-1],
        _error(per_batch),
        *_with_error(of_emitted.mean(), of_emitted / of_emitted.mean()),
        *_with_error(product.mean() / efficiency, product / product.mean()),
        efficiency,
        *ratio,
        float(at_mean.mean()),
        float(_error(at_mean)),
        one_off[0] - 1.0,
        one_off[1],
        float(off.max()),
        tuple(nodes.tolist()),
        photons,
        cached,
        run.seed,
        dict(scene.parameters),
        scene.content_hash,
    )


def _by_photons(
    benches: Sequence[SceneFile],
    named: Sequence[str],
    points: Sequence[tuple[float, float]],
    asked_nm: Array,
    run: Run,
) -> tuple[Array, int, int]:
    """(benches, batches, points) efficiencies; photons, and how many of them the cache had.

    Batches of one number belong together.
    """
    if run.photons is None and run.precision is None:
        run = replace(run, photons=PHOTONS)
    wishes = [
        SurfaceWish(name, held, points, run) for name, held in zip(named, benches, strict=True)
    ]
    found = record_surfaces(wishes)
    rows = []
    for surface, _ in found:
        for nm, point, known in zip(asked_nm, points, surface.evaluate_all(points), strict=True):
            if known is None:
                problem = f"too few photons tell eta at {nm:.0f} nm"
                mend = "follow more, or cut the spectrum there"
                raise InputError(problem, mend, path=benches[0].path)
            # sums by batch are of wide cells, and good enough for errors alone
            of_batches = surface.batches(*point)
            rows.append(known.eta * of_batches / of_batches.mean())
    photons, cached = (
        sum(getattr(each, name) for _, each in found) for name in ("photons", "cached_photons")
    )
    batches = np.array(rows).reshape(len(found), len(points), -1)
    return batches.transpose(0, 2, 1), photons, cached


def _coefficients(
    scene: SceneFile, light: EmittedLight, wavelength_nm: float
) -> tuple[float, float]:
    """Scattering and absorption at a wavelength, 1/cm."""
    own = light.at(wavelength_nm)
    values = []
    for name in COEFFICIENTS:
        value = own.get(name, scene.parameters.get(name))
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


def _error(batches: Array) -> Array:
    """Standard error of the mean of (batches, ...) values."""
    return np.asarray(batches.std(axis=0, ddof=1) / math.sqrt(len(batches)), float)


def _with_error(value: float, relative: Array) -> tuple[float, float]:
    """A value and its error, from what batches say of it, relative."""
    return float(value), float(value * _error(relative))
