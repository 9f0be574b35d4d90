"""``mcrim lab``: from a laboratory's raw data to readings, priors and light yields."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli.lab.counting import histogram, peak
from mcrim_mitsuba.cli.lab.light_yield import light_yield, plan, relative
from mcrim_mitsuba.cli.lab.material import absorption, efficiency, gammas, index


@click.group(
    short_help="Raw data: peaks, efficiencies, absorption, light yields.",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
def lab() -> None:
    """Raw data: peaks of histograms, detector efficiency, absorption, indices, light yields."""


for verb in (peak, histogram, efficiency, absorption, light_yield, relative, plan, index, gammas):
    lab.add_command(verb)
