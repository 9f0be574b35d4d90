"""Closed forms of light collection: benches whose numbers need no simulation.

Light in a polished box keeps the absolute cosines of its direction, so that its path may be
unfolded: reflected in the faces it meets, it is a straight line (the method of mirror images), and
what is left of it is a product of Fresnel's reflectances and Beer and Lambert's law. A ball keeps
the angle at its surface in the same way. What remains are integrals over births and directions, in
up to five dimensions, done with a scrambled Sobol sequence; their errors count in the z-scores.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import qmc

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.optics.fresnel import reflectance

Array = NDArray[np.float64]

#: Scene of a ball in air, which takes the general path of the transport.
BALL = Path(__file__).parent / "ball.xml"
BALL_RADIUS_MM = 5.0
#: Name of the formula of light that a polished crystal transmits.
BEAM = "beam"
#: Points of one scrambled Sobol sequence, and how many sequences tell the integral's error.
_POINTS, _SEQUENCES = 2**16, 8
#: What a mirror image must be worth to be counted.
_LEAST_IMAGE = 1e-7
#: Widths of the article's crystal, and the thickness of its window.
_WIDTH_MM, _WINDOW_MM = 10.0, 1.0
#: Formula in words and its source, by name.
SOURCES = tomllib.loads(Path(__file__).with_name("sources.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Formula:
    """A bench and what a closed form of `SOURCES` says of it.

    The parameters differ from those of the scene: the article's bench, or `BALL`; of the form
    `BEAM`, the article's crystal in a spectrophotometer.
    """

    form: str
    parameters: dict[str, float]
    fate: str

    @property
    def ball(self) -> bool:
        return self.form == "ball"

    def exact(self) -> tuple[float, float]:
        """The fraction of the light that meets the fate, and its numerical error."""
        return _EXACT[self.form](self.parameters)

    @property
    def name(self) -> str:
        """The bench in words."""
        values = (f"{key} {value:g}" for key, value in self.parameters.items())
        return f"{self.form}: {', '.join(values)}"

    described = name


def formulas() -> list[Formula]:
    """All benches with a closed form."""
    benches = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return [
        Formula(form, parameters, known["fate"])
        for form, known in benches.items()
        for parameters in known["benches"]
    ]


def trapped_fraction(n: float, n_gap: float) -> tuple[float, float]:
    """Light that a clear polished box never lets out, one face of which borders another index.

    Valid for n_gap up to the window's index, and where the cones of two axes do not overlap.
    """
    side, below = math.sqrt(1 - 1 / n**2), math.sqrt(1 - (n_gap / n) ** 2)
    if math.acos(side) + math.acos(below) > math.pi / 2:
        raise ValueError(f"the cones overlap: n = {n}, n_gap = {n_gap}")
    return 1 - 2 * (1 - side) - (1 - below), 0.0


def absorbed_in_bare_box(n: float, sides_mm: tuple[float, float, float], alpha_per_cm: float):
    """Fraction absorbed in a polished box in air, without scattering, and its numerical error."""

    def integrand(point: Array) -> Array:
        cosines = _cosines(point[:, 0], point[:, 1])
        path = -np.log1p(-point[:, 2]) * MM_PER_CM / alpha_per_cm
        left = np.ones(len(point))
        for cosine, side in zip(cosines, sides_mm, strict=True):
            reflected = reflectance(cosine, n, 1.0)
            whole, rest = np.divmod(cosine * path / side, 1.0)
            left *= reflected**whole * (1 - rest * (1 - reflected))
        return left

    return _mean(integrand, 3)


def detected_at_black_foot(
    n: float, n_foot: float, width_mm: float, height_mm: float, foot_mm: float, alpha_per_cm: float
):
    """Fraction that reaches the black bottom of a box, and its numerical error.

    The foot below the crystal has the same width, its own thickness, and does not absorb; around
    both is air. The crystal's absorption is above 0, or n_foot = n.
    """

    def integrand(point: Array) -> Array:
        cosines = np.array(_cosines(point[:, 0], point[:, 1]))
        starts, height = point[:, 2:4].T, point[:, 4] * height_mm
        top, bottom = reflectance(cosines[2], n, 1.0), reflectance(cosines[2], n, n_foot)
        sides = reflectance(cosines[:2], n, 1.0)
        in_foot = np.minimum(n / n_foot * cosines[:2], 1.0)
        foot_sides = reflectance(in_foot, n_foot, 1.0)
        down_in_foot = np.sqrt(np.maximum(1 - np.sum(in_foot**2, axis=0), 1e-300))
        # widths of the box that light passes in the foot
        passed = in_foot / down_in_foot * foot_mm / width_mm

        def arrives(path: Array, i: NDArray[np.int64]) -> Array:
            """What is left of the light `i` at the black bottom, after this path to the step."""
            at_step = starts[:, i] + cosines[:2, i] * path / width_mm
            crossed = np.floor(at_step)
            in_foot = np.minimum(np.floor(at_step + passed[:, i]) - crossed, 1e6)
            left = np.prod(sides[:, i] ** crossed * foot_sides[:, i] ** in_foot, axis=0)
            return left * np.exp(-alpha_per_cm * path / MM_PER_CM)

        total, weight = np.zeros(len(point)), 0.5 * (1 - bottom)
        alive = np.flatnonzero(weight)
        further = 0.0
        while len(alive):
            downward = cosines[2, alive]
            of_image = arrives((height[alive] + further) / downward, alive)
            of_image += top[alive] * arrives(
                (2 * height_mm - height[alive] + further) / downward, alive
            )
            total[alive] += weight[alive] * of_image
            further += 2 * height_mm
            weight[alive] *= top[alive] * bottom[alive]
            fading = np.exp(-alpha_per_cm * further / downward / MM_PER_CM)
            alive = alive[weight[alive] * fading > _LEAST_IMAGE]
        return total

    return _mean(integrand, 5)


def solid_angle_fraction(
    width_mm: float, height_mm: float, depth_mm: float, plate_mm: float, order: int = 24
) -> tuple[float, float]:
    """Mean over a box of the solid angle of a square below it, over 4π, and the error (none)."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    nodes, weights = (nodes + 1) / 2, weights / 2
    x, y, z = np.meshgrid(nodes, nodes, nodes, indexing="ij")
    weight = weights[:, None, None] * weights[:, None] * weights
    h = z * height_mm + depth_mm
    # by symmetry births in a quarter of the box see what those in all of it see
    omega = np.zeros_like(h)
    for sign_x, sign_y in itertools.product((1, -1), repeat=2):
        a, b = plate_mm / 2 + sign_x * x * width_mm / 2, plate_mm / 2 + sign_y * y * width_mm / 2
        omega += np.arctan(a * b / (h * np.sqrt(a**2 + b**2 + h**2)))
    return float(np.sum(weight * omega) / (4 * np.pi)), 0.0


def escape_from_ball(n: float, radius_mm: float, alpha_per_cm: float) -> tuple[float, float]:
    """Fraction that leaves an absorbing ball in air, and its numerical error."""

    def integrand(mu: float) -> float:
        depth = 2 * radius_mm * mu * alpha_per_cm / MM_PER_CM
        through = math.exp(-depth)
        reflected = float(reflectance(mu, n, 1.0))
        inside = -math.expm1(-depth) / depth if depth else 1.0
        return 3 * mu**2 * inside * (1 - reflected) / (1 - reflected * through)

    # below the critical angle nothing leaves
    return quad(integrand, math.sqrt(1 - 1 / n**2), 1.0, epsabs=1e-10)


def transmitted_by_slab(n: float, alpha_per_cm: float, path_cm: float) -> tuple[float, float]:
    """Transmittance of a polished slab at normal incidence; what is scattered is lost."""
    face, inside = reflectance(1.0, n, 1.0), math.exp(-alpha_per_cm * path_cm)
    return float((1.0 - face) ** 2 * inside / (1.0 - (face * inside) ** 2)), 0.0


_EXACT: dict[str, Callable[[dict[str, float]], tuple[float, float]]] = {
    "trapped light": lambda p: trapped_fraction(p["n_crystal"], p["n_gap"]),
    "absorbed in a bare box": lambda p: absorbed_in_bare_box(
        p["n_crystal"],
        (p["crystal_width_mm"], p["crystal_width_mm"], p["crystal_height_mm"]),
        p["alpha_abs_per_cm"],
    ),
    "box on a black foot": lambda p: detected_at_black_foot(
        p["n_crystal"],
        p["n_gap"],
        _WIDTH_MM,
        p["crystal_height_mm"],
        p["gap_mm"] + _WINDOW_MM,
        p["alpha_abs_per_cm"],
    ),
    "solid angle": lambda p: solid_angle_fraction(
        _WIDTH_MM, p["crystal_height_mm"], p["gap_mm"] + _WINDOW_MM, p["window_width_mm"]
    ),
    BEAM: lambda p: transmitted_by_slab(
        p["n_crystal"], p["alpha_scat_per_cm"] + p["alpha_abs_per_cm"], _WIDTH_MM / 10.0
    ),
    "ball": lambda p: escape_from_ball(p["n_ball"], BALL_RADIUS_MM, p["alpha_abs_per_cm"]),
}


def _cosines(u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Absolute direction cosines, isotropic, from two uniform numbers."""
    downward = np.clip(u, 1e-12, 1.0)
    sine, angle = np.sqrt(1 - downward**2), v * np.pi / 2
    return sine * np.cos(angle), sine * np.sin(angle), downward


def _mean(integrand: Callable[[Array], Array], dimensions: int) -> tuple[float, float]:
    """Mean over the unit cube and its error, from the spread of scrambled sequences."""
    means = [
        float(np.mean(integrand(qmc.Sobol(dimensions, rng=sequence).random(_POINTS))))
        for sequence in range(_SEQUENCES)
    ]
    return float(np.mean(means)), float(np.std(means, ddof=1) / math.sqrt(_SEQUENCES))
