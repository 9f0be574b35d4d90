"""``mcrim lab``: from a laboratory's raw data to readings, priors and light yields."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli.lab.absorption import absorption
from mcrim_mitsuba.cli.lab.efficiency import efficiency
from mcrim_mitsuba.cli.lab.gammas import gammas
from mcrim_mitsuba.cli.lab.histogram import histogram
from mcrim_mitsuba.cli.lab.index import index
from mcrim_mitsuba.cli.lab.light_yield import light_yield
from mcrim_mitsuba.cli.lab.peak import peak
from mcrim_mitsuba.cli.lab.plan import plan
from mcrim_mitsuba.cli.lab.relative import relative


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
def lab() -> None:
    """Raw data: peaks of histograms, detector efficiency, absorption, indices, light yields."""


for verb in (peak, histogram, efficiency, absorption, light_yield, relative, plan, index, gammas):
    lab.add_command(verb)
