"""The curves of Figs. 3 and 4, and their numbers as CSV."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import Table1Line
from mcrim_mitsuba.article.simulated import AIR, GEL, Coupling, Simulated
from mcrim_mitsuba.files.writing import write_text
from mcrim_mitsuba.fit.surface import ALPHA_SCAT, EtaPoint, Surface

#: Points of a curve, equally spaced in log(alpha_scat).
_POINTS = 25

ETA_COLUMNS = (
    "polarised", "n_gap", "transmittance_percent", "alpha_abs_per_cm", "alpha_scat_per_cm",
    "eta", "eta_sigma",
)  # fmt: skip
RATIO_COLUMNS = (
    "polarised", "transmittance_percent", "alpha_abs_per_cm", "alpha_scat_per_cm", "ratio",
    "ratio_sigma",
)  # fmt: skip


class EtaCurve(Surface):
    """Light collection efficiency against scattering: one curve of Fig. 3.

    A surface at the one absorption of a line of Table 1: it is simulated at `_POINTS` values
    of alpha_scat, values and slopes, and interpolated in log(alpha_scat) between them. That
    costs some 1e-6 in eta and spares the search for alpha_scat thousands of evaluations.

    Parameters
    ----------
    coupling : Coupling
    line : Table1Line

    Attributes
    ----------
    alpha_scat_per_cm, etas, sigmas : ndarray of float64, shape (points,)
        `sigmas` are Monte Carlo standard errors; neighbouring points share photons.
    """

    parameters = (ALPHA_SCAT,)

    def __init__(self, coupling: Coupling, line: Table1Line) -> None:
        self.coupling, self.line = coupling, line
        grid = np.geomspace(p.SCANNED_FROM.value, p.SCANNED_TO.value, _POINTS)
        points = [coupling.at(a, line.alpha_abs_per_cm.value) for a in grid]
        self.alpha_scat_per_cm = grid
        self.etas = np.array([point.eta for point in points])
        self.sigmas = np.array([point.sigma for point in points])
        self._samples = np.array([point.effective_sample_size for point in points])
        slopes = np.array([point.gradient[ALPHA_SCAT] for point in points])
        self._spline = CubicHermiteSpline(np.log(grid), self.etas, slopes * grid)

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        return float(self.alpha_scat_per_cm[0]), float(self.alpha_scat_per_cm[-1])

    def evaluate(  # type: ignore[override]  # two parameters are all that it has
        self,
        alpha_scat_per_cm: float,
        alpha_abs_per_cm: float,
        *,
        check: bool = True,
        errors: bool = True,
    ) -> EtaPoint:
        """Efficiency on the curve; ValueError at another absorption than the curve's."""
        if alpha_abs_per_cm != self.line.alpha_abs_per_cm.value:
            raise ValueError(f"the curve is not that of alpha_abs = {alpha_abs_per_cm:g} /cm")
        x, known = math.log(alpha_scat_per_cm), np.log(self.alpha_scat_per_cm)
        return EtaPoint(
            eta=float(self._spline(x)),
            sigma=float(np.interp(x, known, self.sigmas)),
            gradient={ALPHA_SCAT: float(self._spline(x, 1)) / alpha_scat_per_cm},
            effective_sample_size=float(np.interp(x, known, self._samples)),
        )

    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        return self.coupling.surface.covariance(first, second)

    def smooth(self, alpha_scat_per_cm: NDArray[np.float64]) -> NDArray[np.float64]:
        """eta at many values, for drawing."""
        return self._spline(np.log(alpha_scat_per_cm))


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
    def alpha_scat_per_cm(self) -> NDArray[np.float64]:
        """(points,) where the curve was computed, 1/cm."""
        return self.air.alpha_scat_per_cm

    @property
    def ratio(self) -> NDArray[np.float64]:
        """(points,) eta of air over that of gel."""
        return self.air.etas / self.gel.etas

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Monte Carlo error; the errors of the two couplings are independent."""
        of_air, of_gel = (each.sigmas / each.etas for each in (self.air, self.gel))
        return self.ratio * np.hypot(of_air, of_gel)

    def smooth(self, alpha_scat_per_cm: NDArray[np.float64]) -> NDArray[np.float64]:
        """R at many values, for drawing."""
        return self.air.smooth(alpha_scat_per_cm) / self.gel.smooth(alpha_scat_per_cm)


def eta_curves(simulated: Simulated, threads: int | None = None) -> tuple[EtaCurve, ...]:
    """Fig. 3: three transmittances, two couplings, polarisation followed or not."""
    tasks = [(c, line) for c in simulated.couplings.values() for line in p.TABLE_1]
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        return tuple(pool.map(lambda task: EtaCurve(*task), tasks))


def ratio_curves(curves: tuple[EtaCurve, ...]) -> tuple[RatioCurve, ...]:
    """Fig. 4 from the curves of Fig. 3, in their order."""
    found = {(c.coupling.name, c.coupling.polarised, c.line): c for c in curves}
    return tuple(
        RatioCurve(air, found[GEL, polarised, line])
        for (name, polarised, line), air in found.items()
        if name == AIR
    )


def write_eta_csv(path: str | Path, curves: tuple[EtaCurve, ...]) -> None:
    """Write the curves of Fig. 3, one point a line; InputError if that fails."""
    _write(path, ETA_COLUMNS, [
        (int(c.coupling.polarised), c.coupling.n_gap, *_line(c.line), *point)
        for c in curves
        for point in zip(c.alpha_scat_per_cm, c.etas, c.sigmas, strict=True)
    ])  # fmt: skip


def write_ratio_csv(path: str | Path, curves: tuple[RatioCurve, ...]) -> None:
    """Write the curves of Fig. 4, one point a line; InputError if that fails."""
    _write(path, RATIO_COLUMNS, [
        (int(c.polarised), *_line(c.line), *point)
        for c in curves
        for point in zip(c.alpha_scat_per_cm, c.ratio, c.sigma, strict=True)
    ])  # fmt: skip


def _line(line: Table1Line) -> tuple[float, float]:
    return line.transmittance_percent.value, line.alpha_abs_per_cm.value


def _write(path: str | Path, columns: tuple[str, ...], rows: list[tuple[float, ...]]) -> None:
    lines = [",".join(columns), *(",".join(f"{value:.7g}" for value in row) for row in rows)]
    write_text(path, "\n".join(lines) + "\n")
