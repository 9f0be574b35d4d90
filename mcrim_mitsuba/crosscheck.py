"""Mitsuba against the independent NumPy tracer, on one scene, fate by fate."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from scipy.stats import norm

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.tracer import Bench, trace

#: A fate that fewer photons of the tracer met than this has no normal distribution yet.
FEWEST_COUNTS = 25
#: False-alarm level of the test of all rows together.
FAMILY_LEVEL = 0.01


@dataclass(frozen=True)
class CrosscheckRow:
    """One quantity from both programs.

    Attributes
    ----------
    quantity : str
        ``eta`` or a fate; fractions of the emitted energy.
    mitsuba, mitsuba_sigma, numpy, numpy_sigma : float
    z : float or None
        Difference over its standard error; ``None`` where too few photons met the fate.
    """

    quantity: str
    mitsuba: float
    mitsuba_sigma: float
    numpy: float
    numpy_sigma: float
    z: float | None


@dataclass(frozen=True)
class Crosscheck:
    """Result of `crosscheck`.

    Attributes
    ----------
    rows : tuple of CrosscheckRow
    family_p_value : float
        Probability that the largest abs(z) of as many normal rows is at least this large
        (Bonferroni's bound, valid although the fates are correlated).
    agrees : bool
        Whether that is at least `FAMILY_LEVEL`.
    mitsuba_photons, numpy_photons : int
    """

    rows: tuple[CrosscheckRow, ...]
    family_p_value: float
    mitsuba_photons: int
    numpy_photons: int

    @property
    def agrees(self) -> bool:
        return self.family_p_value >= FAMILY_LEVEL


def crosscheck(
    scene: str | Path,
    overrides: Mapping[str, object] | None = None,
    *,
    photons: int = 1_000_000,
    mitsuba_photons: int | None = None,
    seed: int = 0,
    variant: str = "llvm_ad_rgb",
    threads: int | None = None,
    general: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Crosscheck:
    """Run a scene in Mitsuba and in the NumPy tracer and compare every fate.

    Parameters
    ----------
    scene : str or Path
    overrides : mapping, optional
        Scene parameters that differ from the file's.
    photons : int
        Of the NumPy tracer.
    mitsuba_photons : int, optional
        Four times as many when not given: they are cheap.
    seed : int
        The two programs draw unrelated numbers from it.
    general : bool
        Compare Mitsuba's general path even where the fast one would do.
    progress : callable, optional
        ``progress(program, done, total)``.

    Raises
    ------
    InputError
        If the scene cannot be read, or has parameters that the tracer does not know.
    """
    from mcrim_mitsuba.kernel.simulation import Simulation

    simulation = Simulation(scene, overrides, variant=variant, threads=threads)
    try:
        bench = Bench.from_parameters(simulation.file.parameters)
    except InputError as error:
        raise InputError(error.problem, error.mend, path=simulation.file.path) from None
    report = progress or (lambda *_: None)
    ours = simulation.collect(
        mitsuba_photons or 4 * photons,
        seed=seed,
        general=general,
        progress=lambda done, total, *_: report("Mitsuba", done, total),
    )
    reference = trace(
        bench,
        photons,
        seed,
        max_depth=simulation.integrator.max_depth,
        progress=lambda done: report("NumPy", done, photons),
    )
    rows = [_row("eta", "detected", ours, reference)]
    fates = [name for name in {**ours.budget, **reference.budget} if name != "detected"]
    for name in fates:
        if ours.budget.get(name, 0.0) or reference.counts.get(name, 0):
            rows.append(_row(name, name, ours, reference))
    scores = [abs(row.z) for row in rows if row.z is not None]
    return Crosscheck(
        rows=tuple(rows),
        family_p_value=min(1.0, len(scores) * 2.0 * float(norm.sf(max(scores)))),
        mitsuba_photons=ours.photons,
        numpy_photons=reference.photons,
    )


def _row(quantity, fate, ours, reference) -> CrosscheckRow:
    a, sigma_a = ours.budget.get(fate, 0.0), ours.budget_sigma.get(fate, 1.0 / ours.photons)
    b, sigma_b = reference.budget.get(fate, 0.0), reference.budget_sigma.get(fate, 0.0)
    few = max(a * reference.photons, reference.counts.get(fate, 0)) < FEWEST_COUNTS
    z = None if few else (a - b) / math.hypot(sigma_a, sigma_b)
    return CrosscheckRow(quantity, a, sigma_a, b, sigma_b, z)
