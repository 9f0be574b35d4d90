"""``mcrim lab``: from a laboratory's raw data to readings, priors and light yields."""

from __future__ import annotations

import click


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
def lab() -> None:
    """Raw data: peaks of histograms, detector efficiency, absorption, indices, light yields."""


for verb in ():
    lab.add_command(verb)
