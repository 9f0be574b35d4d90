"""The curves of Figs. 3 and 4, and their numbers as CSV."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import Table1Line
from mcrim_mitsuba.article.simulated import AIR, GEL, Simulated
from mcrim_mitsuba.files.writing import write_text

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


@dataclass(frozen=True)
class EtaCurve:
    """Light collection efficiency against scattering: one curve of Fig. 3.

    Attributes
    ----------
    coupling : str
        ``air`` or ``gel``.
    n_gap : float
    polarised : bool
    line : Table1Line
        Transmittance and absorption.
    alpha_scat_per_cm, eta, sigma : ndarray of float64
        `sigma` is the Monte Carlo standard error; neighbouring points share photons.
    """

    coupling: str
    n_gap: float
    polarised: bool
    line: Table1Line
    alpha_scat_per_cm: NDArray[np.float64]
    eta: NDArray[np.float64]
    sigma: NDArray[np.float64]


@dataclass(frozen=True)
class RatioCurve:
    """R = eta_air / eta_gel against scattering: one curve of Fig. 4; fields as `EtaCurve`."""

    polarised: bool
    line: Table1Line
    alpha_scat_per_cm: NDArray[np.float64]
    ratio: NDArray[np.float64]
    sigma: NDArray[np.float64]


def eta_curves(simulated: Simulated) -> tuple[EtaCurve, ...]:
    """Fig. 3: three transmittances, two couplings, polarisation followed or not."""
    grid = np.geomspace(p.SCANNED_FROM.value, p.SCANNED_TO.value, _POINTS)
    curves = []
    for coupling in simulated.couplings.values():
        for line in p.TABLE_1:
            points = [coupling.at(a, line.alpha_abs_per_cm.value) for a in grid]
            curves.append(EtaCurve(
                coupling.name, coupling.n_gap, coupling.polarised, line, grid,
                np.array([point.eta for point in points]),
                np.array([point.sigma for point in points]),
            ))  # fmt: skip
    return tuple(curves)


def ratio_curves(curves: tuple[EtaCurve, ...]) -> tuple[RatioCurve, ...]:
    """Fig. 4 from the curves of Fig. 3; the errors of the two couplings are independent."""
    found = {(c.coupling, c.polarised, c.line): c for c in curves}
    made = []
    for (coupling, polarised, line), air in found.items():
        if coupling != AIR:
            continue
        gel = found[GEL, polarised, line]
        ratio = air.eta / gel.eta
        relative = np.hypot(air.sigma / air.eta, gel.sigma / gel.eta)
        made.append(RatioCurve(polarised, line, air.alpha_scat_per_cm, ratio, ratio * relative))
    return tuple(made)


def write_eta_csv(path: str | Path, curves: tuple[EtaCurve, ...]) -> None:
    """Write the curves of Fig. 3, one point a line; InputError if that fails."""
    _write(path, ETA_COLUMNS, [
        (int(c.polarised), c.n_gap, *_line(c.line), *point)
        for c in curves
        for point in zip(c.alpha_scat_per_cm, c.eta, c.sigma, strict=True)
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
