"""Report a campaign: one page that tells what was measured, what it means and how to repeat it."""

from __future__ import annotations

import base64
import hashlib
import itertools
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path

import jinja2
from markupsafe import Markup, escape

from mcrim_mitsuba import __version__
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import read_text, refuse_outputs, write_text
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.rounding import (
    capital,
    number,
    p_text,
    pdg,
    probability,
    short_text,
    unbroken,
)
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.inference.repair import Repaired, repair
from mcrim_mitsuba.output import sentences
from mcrim_mitsuba.output.figure_style import shortened
from mcrim_mitsuba.output.report_pictures import album_of, data_uri, efficiencies_csv
from mcrim_mitsuba.output.report_sections import Sections, gather
from mcrim_mitsuba.output.sentences import leading_candidates

#: Characters of a text in a table or a sentence; files are shown in full.
MOST_IN_A_TABLE = 80

_RIGHT_TO_LEFT = (
    r"[\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefe\U00010800-\U00010fff\U0001e800-\U0001efff]"
)
_RUN = re.compile(rf"{_RIGHT_TO_LEFT}+(?:[ ]+{_RIGHT_TO_LEFT}+)*")


def brief(text: object, most: int = MOST_IN_A_TABLE) -> str:
    """A text for a table, an attribute or a sentence: in one line, visible and not too long."""
    return shortened(str(text), most)


def said(text: object, most: int = MOST_IN_A_TABLE) -> Markup:
    """The same as markup: isolated, so that its direction of writing stays its own."""
    return Markup("<bdi>{}</bdi>").format(brief(text, most))


def in_full(text: object) -> Markup:
    """A file's text for ``<pre>``: what runs from right to left is isolated word by word."""
    shown = str(escape(visible(text, keep="\n\t")))
    return Markup(_RUN.sub(r"<bdi>\g<0></bdi>", shown))


# The page: it loads nothing, runs nothing and shows texts of users as texts.

#: Rows of a table that are printed: the page as a file has more.
MOST_ROWS = 30
#: Rows of effects that are printed.
MOST_PRINTED = 8


def render(sections: Sections) -> str:
    """The page of a sections, complete."""
    folder = resources.files("mcrim_mitsuba.output")
    style = (folder / "style.css").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=unbroken,
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text(encoding="utf-8")),
    )
    environment.filters |= {
        "said": said,
        "brief": brief,
        "capital": capital,
        "in_full": in_full,
        "p": p_text,
        "number": number,
        "estimate": sentences.estimate_text,
        "together": sentences.together,
        "value": short_text,
        "probability": probability,
        "data_uri": data_uri,
    }
    template = environment.get_template("template.html")
    raw = sections.campaign.raw
    notes = dict.fromkeys((*sections.calibration.notes, *sections.repaired.provenance.notes))
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    return template.render(
        sections=sections,
        campaign=sections.campaign,
        diagnosis=sections.diagnosis,
        fit=sections.calibration,
        pictures=album_of(sections),
        efficiencies=efficiencies_csv(sections),
        mountings=[
            (label, mounting)
            for label, reduced in (raw.readings if raw else {}).items()
            for mounting in reduced.mountings
        ],
        most_rows=MOST_ROWS,
        most_printed=MOST_PRINTED,
        leading=sentences.leading_candidates(sections.diagnosis),
        sentences=sentences,
        pdg=pdg,
        # ours, and hashed as it stands
        style=Markup(style),
        style_hash=digest,
        version=__version__,
        names={"light_yield": LIGHT_YIELD, "scale": SCALE, "alpha_scat": ALPHA_SCAT},
        # those on raw data stand beside these
        notes=[note for note in notes if raw is None or note not in raw.notes],
    )


# From a campaign to its report.

SUFFIXES = (".html",)
_LIMIT_MB = 50
#: Stages after the diagnosis: they are shown one by one.
_STAGES = 8


@dataclass(frozen=True)
class Reported:
    """A report that was written."""

    path: Path
    #: What it tells.
    sections: Sections
    #: Of everything.
    provenance: Provenance


def report(
    campaign: str | Path | Campaign,
    output: str | Path,
    *,
    effects: Sequence[str] | None = None,
    run: Run = Run(),
) -> Reported:
    """Diagnose and mend a campaign, and write all that was found as one HTML file.

    The file needs nothing else: no network, no scripts. An HTML file that is there is replaced.

    Parameters
    ----------
    output : str or Path
        Ends in ``.html``.
    effects : sequence of str, optional
        What the campaign is mended with, besides its own effects; by default what `repair` adds.
    run : Run
        As for `diagnose`.

    Raises
    ------
    InputError
        As for `repairing.repair`, or if the file cannot be written.
    """
    refuse_output(output, [campaign] if isinstance(campaign, (str, Path)) else [])
    repaired = repair(campaign, run=run)
    if effects is not None and set(effects) != set(repaired.effects):
        repaired = _mended_with(repaired, tuple(effects))
    done = itertools.count(1)

    def stage(what: str) -> None:
        run.tell(f"report: {what}", min(next(done), _STAGES), _STAGES)

    sections = gather(
        repaired,
        command=_command(repaired.simulations.campaign.path, output, run),
        made=datetime.now(UTC),
        chosen_by_hand=effects is not None,
        stage=stage,
    )
    stage("figures")
    write_text(output, render(sections))
    return Reported(Path(output), sections, repaired.simulations.provenance())


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
            problem = "--output would replace a file that is no HTML page"
            raise InputError(problem, "name another", path=path)


def _mended_with(repaired: Repaired, effects: tuple[str, ...]) -> Repaired:
    """The same campaign mended with other effects."""
    simulations, diagnosis = repaired.simulations, repaired.diagnosed.diagnosis
    tried = (*leading_candidates(diagnosis), *diagnosis.candidates, *diagnosis.pairs)
    starts = next(
        (
            {name: estimate.value for name, estimate in candidate.parameters.items()}
            for candidate in tried
            if set(candidate.effects) == set(effects)
        ),
        None,
    )
    everything = tuple(dict.fromkeys((*diagnosis.titles, *effects)))
    simulations.simulate(everything, look=set(everything) - {*effects})
    fit = simulations.settled_fit(effects, starts)
    return replace(repaired, effects=effects, fit=fit, provenance=simulations.provenance())


def _command(campaign: Path, output: str | Path, run: Run) -> str:
    """What to type for this report."""
    typed = ["mcrim", "report", str(campaign), "-o", str(output)]
    if run.photons is not None:
        typed += ["--photons", str(run.photons)]
    return shlex.join([*typed, "--seed", str(run.seed), "--variant", run.variant])
