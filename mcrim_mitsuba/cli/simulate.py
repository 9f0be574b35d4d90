"""``mcrim simulate``: eta of one configuration."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.files.writing import refuse_outputs
from mcrim_mitsuba.physics.rounding import pdg


@click.command()
@options.scene_argument
@options.defines
@options.photons("2e6", at_most=True)
@options.precision
@options.seed
@options.machine
@options.json_output
def simulate(scene, overrides, photons, precision, seed, variant, threads, json_file) -> None:
    """Light collection efficiency of one configuration of SCENE, with every photon's fate."""
    from mcrim_mitsuba.kernel.simulation import DEFAULT_PHOTONS, Simulation

    refuse_outputs({"--json": json_file}, [scene])
    simulation = Simulation(scene, overrides, variant=variant, threads=threads)
    if photons is None:
        photons = DEFAULT_PHOTONS if precision is None else 10**10
    with output.photon_progress() as report:

        def progress(done, total, eta, sigma):
            if precision is not None and sigma > 0 and eta > 0:
                # photons needed for the precision, as known so far
                total = min(total, max(done, round(done * (sigma / eta / precision) ** 2)))
            report("simulating", done, total, output.photons_note(done, eta, sigma))

        result = simulation.collect(photons, precision=precision, seed=seed, progress=progress)
    output.write_json(
        json_file,
        {
            "eta": result.eta,
            "eta_sigma": result.eta_sigma,
            "photons": result.photons,
            "seed": result.seed,
            "seconds": result.seconds,
            "photons_per_second": result.photons_per_second,
            "budget": result.budget,
            "budget_sigma": result.budget_sigma,
            "parameters": result.parameters,
            "versions": result.versions,
            "scene_hash": result.scene_hash,
            "polarization": result.polarization,
            "transport": result.transport,
            "photons_requested": result.requested,
            "interrupted": result.interrupted,
            "notes": list(result.notes),
        },
    )
    screen = output.console(json_file)
    screen.print(
        f"eta = {pdg(result.eta, result.eta_sigma)}   ({result.photons:,} photons, seed {seed}, "
        f"{result.seconds:.1f} s, {result.photons_per_second / 1e6:.2f} million photons/s, "
        f"{result.transport})"
    )
    fates = output.table("where the light ends", "fate", "fraction", "error")
    for name, fraction in result.budget.items():
        if fraction > 0:
            fates.add_row(name, f"{fraction:.6f}", f"{result.budget_sigma[name]:.6f}")
    screen.print(fates)
    screen.say_notes(result.notes)
