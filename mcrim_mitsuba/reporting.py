"""Report a campaign: one page that tells what was measured, what it means and how to repeat it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from mcrim_mitsuba.diagnosing import Progress, Provenance
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.reading import read_text
from mcrim_mitsuba.files.writing import refuse_outputs, write_text
from mcrim_mitsuba.findings import leading_candidates
from mcrim_mitsuba.recording import DEFAULT_VARIANT
from mcrim_mitsuba.repairing import Repaired, repair
from mcrim_mitsuba.report.page import render
from mcrim_mitsuba.report.story import Story, tell

SUFFIXES = (".html",)
_LIMIT_MB = 50
#: Stages after the diagnosis: they are shown one by one.
_STAGES = 8


@dataclass(frozen=True)
class Reported:
    """A report that was written.

    Attributes
    ----------
    path : Path
    story : Story
        What it tells.
    provenance : Provenance
        Of everything.
    """

    path: Path
    story: Story
    provenance: Provenance


def report(
    campaign: str | Path | Campaign,
    output: str | Path,
    *,
    effects: Sequence[str] | None = None,
    photons: int | None = None,
    seed: int = 0,
    variant: str = DEFAULT_VARIANT,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Reported:
    """Diagnose and mend a campaign, and write all that was found as one HTML file.

    The file needs nothing else: no network, no scripts. An HTML file that is there is replaced.

    Parameters
    ----------
    campaign : str, Path or Campaign
    output : str or Path
        Ends in ``.html``.
    effects : sequence of str, optional
        What the campaign is mended with, besides its own effects; by default what `repair` adds.
    photons, seed, variant, threads, progress
        As for `diagnosing.diagnose`.

    Raises
    ------
    InputError
        As for `repairing.repair`, or if the file cannot be written.
    """
    refuse_output(output, [campaign] if isinstance(campaign, (str, Path)) else [])
    repaired = repair(
        campaign, photons=photons, seed=seed, variant=variant, threads=threads, progress=progress
    )
    if effects is not None and set(effects) != set(repaired.effects):
        repaired = _mended_with(repaired, tuple(effects))
    read, done = repaired.bench.campaign, 0

    def stage(what: str) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(f"report: {what}", min(done, _STAGES), _STAGES)

    story = tell(
        repaired,
        command=_command(read.path, output, photons, seed, variant),
        made=datetime.now(UTC),
        chosen_by_hand=effects is not None,
        stage=stage,
    )
    stage("figures")
    write_text(output, render(story))
    return Reported(Path(output), story, repaired.bench.provenance())


def refuse_output(output: str | Path, inputs: Sequence[str | Path]) -> None:
    """Refuse a place where the report cannot be written, or what is no page there.

    Raises
    ------
    InputError
        Without touching a file.
    """
    path = Path(output)
    refuse_outputs({"--output": str(output)}, inputs, suffixes={"--output": SUFFIXES})
    if path.is_file() and path.stat().st_size:
        beginning = read_text(path, _LIMIT_MB)[:1000].lower()
        if "<html" not in beginning and "<!doctype html" not in beginning:
            raise InputError(
                "--output would replace a file that is no HTML page", "name another", path=path
            )


def _mended_with(repaired: Repaired, effects: tuple[str, ...]) -> Repaired:
    """The same campaign mended with other effects."""
    bench, diagnosis = repaired.bench, repaired.diagnosed.diagnosis
    tried = (*leading_candidates(diagnosis), *diagnosis.candidates, *diagnosis.pairs)
    starts = next(
        (
            {name: known.value for name, known in candidate.parameters.items()}
            for candidate in tried
            if set(candidate.effects) == set(effects)
        ),
        None,
    )
    bench.simulate_with(tuple(dict.fromkeys((*bench.candidates, *effects))))
    model, calibration = bench.settled_model(effects, starts)
    return replace(
        repaired, effects=effects, calibration=calibration, model=model,
        provenance=bench.provenance(),
    )  # fmt: skip


def _command(
    campaign: Path, output: str | Path, photons: int | None, seed: int, variant: str
) -> str:
    """What to type for this report."""
    words = ["mcrim", "report", str(campaign), "-o", str(output)]
    if photons is not None:
        words += ["--photons", str(photons)]
    words += ["--seed", str(seed), "--variant", variant]
    return shlex.join(words)
