"""All pictures of a report; those that a campaign has no use for are left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.figures.arrival import arrival_figure, arrival_numbers
from mcrim_mitsuba.figures.budget import budget_figure, budget_numbers
from mcrim_mitsuba.figures.comparison import comparison_figure, comparison_numbers
from mcrim_mitsuba.figures.fates import fates_figure, fates_numbers
from mcrim_mitsuba.figures.profiles import profiles_figure, profiles_numbers
from mcrim_mitsuba.figures.ranking import ranking_figure, ranking_numbers
from mcrim_mitsuba.figures.raw_data import (
    absorption_drawn,
    efficiency_drawn,
    histograms_drawn,
)
from mcrim_mitsuba.figures.staircase import staircase_figure, staircase_numbers
from mcrim_mitsuba.figures.style import Numbers
from mcrim_mitsuba.findings import together
from mcrim_mitsuba.laboratory.raw_data import RawData
from mcrim_mitsuba.lighting import Light
from mcrim_mitsuba.report.charts import (
    ratio_figure,
    ratio_numbers,
    readings_figure,
    readings_numbers,
)
from mcrim_mitsuba.report.pictures import Picture, of_figure, of_pixels
from mcrim_mitsuba.report.story import Story


def album_of(story: Story) -> dict[str, Picture]:
    """The pictures by name."""
    diagnosis, fit, baseline = story.diagnosis, story.calibration, story.diagnosis.baseline
    measurements, bench = story.campaign.measurements, story.bench
    made = [
        of_figure(
            "readings", readings_figure(measurements),
            "every reading with its error", numbers=readings_numbers(measurements),
        ),
        of_figure("cross-section", bench.cross_section, "vertical cut through the bench, to scale"),
        of_figure(
            "comparison", comparison_figure(baseline),
            "readings beside what the model predicts, and the differences in standard errors",
            numbers=comparison_numbers(baseline),
        ),
    ]  # fmt: skip
    made += _of_raw_data(story.campaign.raw)
    if diagnosis.candidates:
        made.append(of_figure(
            "ranking", ranking_figure(diagnosis, brief=True),
            "effects by how much of the misfit each would explain",
            numbers=ranking_numbers(diagnosis),
        ))  # fmt: skip
    if story.effects:
        if not story.chosen_by_hand:
            made.append(of_figure(
                "staircase", staircase_figure(diagnosis.repair, fit),
                "how the misfit falls as effects are added",
                numbers=staircase_numbers(diagnosis.repair, fit),
            ))  # fmt: skip
        made.append(of_figure(
            "before-and-after",
            comparison_figure(baseline, fit, added=together(story.effects)),
            "readings beside the model before and after the effects were added",
            numbers=comparison_numbers(baseline, fit),
        ))  # fmt: skip
    if story.ratio is not None:
        made.append(of_figure(
            "ratio", ratio_figure(story.ratio),
            "the ratio of two signals against scattering, simulated and measured",
            numbers=ratio_numbers(story.ratio),
        ))  # fmt: skip
    if story.profiles:
        made.append(of_figure(
            "profiles", profiles_figure(story.profiles),
            "how the misfit rises as each parameter leaves its best value",
            numbers=profiles_numbers(story.profiles),
        ))  # fmt: skip
    if fit.parameters:
        made.append(of_figure(
            "error-budget", budget_figure(fit),
            "parts of each parameter's error by origin", numbers=budget_numbers(fit),
        ))  # fmt: skip
    if story.lights:
        made += [
            of_figure(
                "fates", fates_figure(story.lights),
                "what becomes of the light in each coupling", numbers=fates_numbers(story.lights),
            ),
            of_figure(
                "arrival", arrival_figure(story.lights),
                "where and under which angle light reaches the detector",
                numbers=_profiles(story.lights), map=_map(story.lights),
            ),
        ]  # fmt: skip
    photograph = bench.photograph.picture  # last: it may have to be waited for
    if photograph is not None:
        made.append(of_pixels("bench", photograph, "picture of the bench"))
    return {picture.name: picture for picture in made}


def _of_raw_data(raw: RawData | None) -> Iterator[Picture]:
    """What readings and priors were made of."""
    if raw is None:
        return
    for name, drawn, alt in (
        ("histograms", histograms_drawn(raw), "histograms of photons per event with their peaks"),
        ("detector-efficiency", efficiency_drawn(raw), "emission and quantum efficiency"),
        ("transmittance", absorption_drawn(raw), "transmittance and absorption coefficient"),
    ):
        if drawn is not None:
            yield of_figure(name, drawn[0], alt, numbers=drawn[1])


def _profiles(lights: Sequence[tuple[str, Light]]) -> Numbers:
    """Light along radius and angle; the map's cells, a row each, would make the page heavy."""
    columns, rows = arrival_numbers(lights)
    part = columns.index("part")
    return columns, [row for row in rows if row[part] != "map"]


def _map(lights: Sequence[tuple[str, Light]]) -> Numbers:
    """Light per mm2 and emitted photon on the detector: a line of a map a row, x along it."""
    rows: list[tuple[object, ...]] = []
    for name, light in lights:
        x, y = (_middles(edges) for edges in (light.x_edges_mm, light.y_edges_mm))
        rows.append((name, "x (mm)", *x))
        rows += [
            (name, at, *(float(f"{cell:.4g}") for cell in line))
            for at, line in zip(y, light.map.density, strict=True)
        ]
    widest = max((len(row) for row in rows), default=2) - 2
    return ("configuration", "y (mm)", *(f"light_per_mm2_{i + 1}" for i in range(widest))), rows


def _middles(edges: NDArray[np.float64]) -> list[float]:
    return [float(f"{middle:.5g}") for middle in (edges[1:] + edges[:-1]) / 2]
