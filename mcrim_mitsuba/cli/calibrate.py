"""``mcrim calibrate``: fit a campaign."""

from __future__ import annotations

import time
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.inference.calibration import LIGHT_YIELD

_ORIGINS = ("statistical", "prior", "monte_carlo", "detector_efficiency")


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@options.figure("readings with their pulls (and NAME_profiles, the profile likelihoods, and "
                "NAME_budget, the error budget)")  # fmt: skip
@options.photons("2.7e7 for all configurations together", at_most=True)
@options.precision
@options.seed
@options.machine
@work_options
@options.json_output
def calibrate(
    campaign, figure, photons, precision, seed, variant, threads, json_file, work
) -> None:
    """Fit CAMPAIGN (TOML): scattering coefficient (1/cm), light yield (photons per keV).

    A short first look of 262,144 photons per configuration is added to --photons: it shows
    where in alpha_scat, and on which configurations, to spend them. --precision is that of the
    light collection efficiency of every configuration.
    """
    from mcrim_mitsuba.inference.calibrate import calibrate as run

    figures = (figure, *(showing.further_picture(figure, name) for name in ("profiles", "budget")))
    showing.refuse_places(json_file, [campaign], *figures)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, files, *figures)
    start = time.perf_counter()
    with work.begin() as report:
        result = run(
            read, photons=photons, precision=precision, seed=seed, variant=variant,
            threads=threads, progress=report,
        )  # fmt: skip
    seconds = time.perf_counter() - start
    found = result.calibration
    terminal.write_json(
        json_file,
        found.to_json()
        | {
            "seconds": seconds,
            "photons": result.photons,
            "spent": result.spent,
            "seed": seed,
            "scene_hash": result.scene_hash,
            "versions": result.versions,
            "notes": [*found.notes, *result.notes],
        },
    )
    drawn = _draw(figures, result) if figure else ()
    screen = terminal.console(json_file)
    shown = terminal.table("parameters", "parameter", "value", "68.3 % interval")
    budget = terminal.table(
        "where the errors come from", "parameter", *(name.replace("_", " ") for name in _ORIGINS)
    )
    for name, estimate in found.parameters.items():
        ends = (
            "" if estimate.lower is None or estimate.upper is None
            else f"{estimate.lower:.4g} to {estimate.upper:.4g}"
        )  # fmt: skip
        if estimate.at_bound is None:
            shown.add_row(name, pdg(estimate.value, estimate.sigma), ends)
            parts = [estimate.contributions.get(origin) for origin in _ORIGINS]
        else:
            # sigma and its parts are no error there: they know nothing of the bound
            shown.add_row(name, f"{estimate.value:.4g}, at its bound", ends)
            parts = [None] * len(_ORIGINS)
        budget.add_row(name, *("" if part is None else f"{part:.2g}" for part in parts))
    screen.print(shown)
    screen.print(budget)
    _show_efficiency(screen, found)
    rows = terminal.table("readings", "reading", "measured", "model", "pull", "eta")
    for row in found.rows:
        label = row.label if row.use else f"{row.label} (not used)"
        rows.add_row(label, pdg(row.measured, row.sigma), pdg(row.model, row.model_sigma),
                     f"{row.pull:+.2f}", pdg(row.eta, row.eta_sigma))  # fmt: skip
    screen.print(rows)
    effort = terminal.table("photons spent", "configuration", "photons", "of the cache", "eta to")
    for each in result.spent:
        name = ", ".join(f"{n} = {v}" for n, v in each.parameters.items()) or "the scene's own"
        effort.add_row(name, f"{each.photons:,}", f"{each.cached_photons:,}",
                       f"{100 * each.eta_relative_sigma:.2g} %")  # fmt: skip
    if result.spent:
        screen.print(effort)
    chance = "no p-value without degrees of freedom" if found.p_value is None else (
        f"p = {found.p_value:.3g}"
    )  # fmt: skip
    screen.print(
        f"chi2 = {found.chi2:.3g}, ndf = {found.ndf}, {chance}; {result.photons:,} photons in "
        f"{len(found.rows)} readings, seed {seed}, {seconds:.1f} s"
    )
    showing.say_drawn(screen, drawn)
    screen.say_notes((*found.notes, *result.notes))


def _show_efficiency(screen, found) -> None:
    """The detector efficiency's part of the light yield's error by its own origins."""
    light = found.parameters.get(LIGHT_YIELD)
    if light is not None and light.efficiency_contributions:
        parts = (f"{name} {part:.2g}" for name, part in light.efficiency_contributions.items())
        screen.line(f"detector efficiency in {LIGHT_YIELD}: {', '.join(parts)}")


def _draw(figures, result) -> tuple[Path, ...]:
    from mcrim_mitsuba.inference.profiles import profiles_of
    from mcrim_mitsuba.output.budget_figures import draw_budget
    from mcrim_mitsuba.output.fit_figures import draw_comparison, draw_profiles

    readings, profiles, budget = figures
    return (
        *draw_comparison(readings, result.calibration),
        *draw_profiles(profiles, profiles_of(result.model, result.calibration)),
        *draw_budget(budget, result.calibration),
    )
