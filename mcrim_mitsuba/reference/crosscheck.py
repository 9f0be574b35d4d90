"""Mitsuba against the independent tracer, and where it can the solver without photons."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.noise_free import bench_of
from mcrim_mitsuba.efficiency.polished_box import BoxEfficiency, solve_box
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.simulation import Simulation, SimulationResult

if TYPE_CHECKING:
    from mcrim_mitsuba.reference.tracer import TracerResult

#: A fate that fewer photons of the tracer met than this has no normal distribution yet.
FEWEST_COUNTS = 25
#: False-alarm level of the test of all rows together.
FAMILY_LEVEL = 0.01


@dataclass(frozen=True, kw_only=True)
class CrosscheckRow:
    """One quantity from the programs."""

    #: ``eta`` or a fate; fractions of the emitted energy.
    quantity: str
    mitsuba: float
    mitsuba_sigma: float
    numpy: float
    numpy_sigma: float
    #: Difference over its standard error; ``None`` where too few photons met the fate.
    z: float | None
    #: From the solver without photons, its error, and Mitsuba's difference to it over the standard
    #: error; ``None`` where it does not know the bench or the fate.
    modes: float | None = None
    modes_sigma: float | None = None
    modes_z: float | None = None


@dataclass(frozen=True)
class Crosscheck:
    """Result of `crosscheck`."""

    rows: tuple[CrosscheckRow, ...]
    #: Probability that the largest abs(z) of as many normal rows is at least this large
    #: (Bonferroni's bound, valid although the fates are correlated).
    family_p_value: float
    mitsuba_photons: int
    numpy_photons: int

    @property
    def agrees(self) -> bool:
        """Whether all comparisons together are as chance would have them."""
        return self.family_p_value >= FAMILY_LEVEL


def crosscheck(
    scene: str | Path | SceneFile, overrides: Mapping[str, Value] | None = None, *, run: Run = Run()
) -> Crosscheck:
    """Run a scene in Mitsuba and in the independent tracer and compare every fate.

    Where the bench is a polished box, eta and the absorbed part are compared with the solver
    without photons too.

    The run's photons are the tracer's, a million if nothing is said; Mitsuba's, which are cheap,
    are four times as many. The two draw unrelated numbers from its seed; its precision does not
    matter. Where light may be cut off, Mitsuba flies from reflection to reflection, as the tracer.

    Raises InputError if the scene is unreadable or unsound, or has a part unknown to the tracer.
    """
    from mcrim_mitsuba.reference.scene_bench import read_bench
    from mcrim_mitsuba.reference.tracer import trace

    simulation = Simulation(
        scene, overrides, variant=run.variant, threads=run.threads, check=run.check
    )
    bench, photons = read_bench(simulation.file), run.photons_or(1_000_000)
    ours = simulation.collect(
        4 * photons,
        seed=run.seed,
        fold=simulation.crystal.scatters and simulation.integrator.max_depth is None,
        progress=lambda done, total, *_: run.tell("Mitsuba", done, total),
    )
    if ours.interrupted:
        raise KeyboardInterrupt  # a part of the photons is no comparison
    reference = trace(
        bench,
        photons,
        run.seed,
        max_depth=simulation.depth_limit,
        threads=run.threads,
        progress=lambda done: run.tell("independent tracer", done, photons),
    )
    solved = _solved(simulation)
    # that photons of either program met; eta is of those that are detected
    fates = [f for f in {**ours.budget, **reference.budget} if f != "detected"]
    fates = [f for f in fates if ours.budget.get(f, 0.0) or reference.counts.get(f, 0)]
    rows = tuple(_row(quantity, ours, reference, solved) for quantity in ("eta", *fates))
    scores = [abs(z) for row in rows for z in (row.z, row.modes_z) if z is not None]
    if not scores:
        problem = f"{photons} photons are too few to compare a single fate"
        raise InputError(problem, "give more --photons")
    return Crosscheck(
        rows=rows,
        family_p_value=min(1.0, len(scores) * math.erfc(max(scores) / math.sqrt(2.0))),
        mitsuba_photons=ours.photons,
        numpy_photons=reference.photons,
    )


def _solved(simulation: Simulation) -> BoxEfficiency | None:
    """The solver's answer, where it knows such a bench and light is not trapped for ever."""
    try:
        solved = solve_box(bench_of(simulation))
    except InputError:
        return None
    return None if solved.fates["trapped"] else solved


def _row(
    quantity: str, ours: SimulationResult, reference: TracerResult, solved: BoxEfficiency | None
) -> CrosscheckRow:
    """Eta or a fate by both programs, with the difference in standard errors."""
    if quantity == "eta":
        a, sigma_a = ours.eta, ours.eta_sigma
        b, sigma_b = reference.eta, reference.eta_sigma
    else:
        a = ours.budget.get(quantity, 0.0)
        sigma_a = ours.budget_sigma.get(quantity, 1.0 / ours.photons)
        b = reference.budget.get(quantity, 0.0)
        sigma_b = reference.budget_sigma.get(quantity, 0.0)
    counted = reference.counts.get("detected" if quantity == "eta" else quantity, 0)
    few = max(a * reference.photons, counted) < FEWEST_COUNTS
    z = None if few else (a - b) / math.hypot(sigma_a, sigma_b)
    row = CrosscheckRow(
        quantity=quantity, mitsuba=a, mitsuba_sigma=sigma_a, numpy=b, numpy_sigma=sigma_b, z=z
    )
    # what all programs call the same
    if solved is None or quantity not in ("eta", "absorbed_crystal"):
        return row
    c = float(solved.eta if quantity == "eta" else solved.fates[quantity])
    sigma_c = float(solved.error)
    modes_z = None if few else (a - c) / math.hypot(sigma_a, sigma_c)
    return replace(row, modes=c, modes_sigma=sigma_c, modes_z=modes_z)
