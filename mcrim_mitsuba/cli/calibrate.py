"""``mcrim calibrate``: fit a campaign."""

from __future__ import annotations

import time
from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output import descriptions, documents


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
        result = run(read, run=Run(photons, precision, seed, threads, variant, report))
    seconds = time.perf_counter() - start
    terminal.write_json(json_file, documents.of_calibration(result, seconds=seconds))
    drawn = _draw(figures, result) if figure else ()
    described = descriptions.of_calibration(result, seconds=seconds)
    showing.show(terminal.console(json_file), described, drawn)


def _draw(figures, result) -> tuple[Path, ...]:
    from mcrim_mitsuba.inference.profiles import profiles_of
    from mcrim_mitsuba.output.budget_figures import draw_budget
    from mcrim_mitsuba.output.fit_figures import draw_comparison, draw_profiles

    readings, profiles, budget = figures
    return (
        *draw_comparison(result.calibration).save(readings),
        *draw_profiles(profiles_of(result.model, result.calibration)).save(profiles),
        *draw_budget(result.calibration).save(budget),
    )
