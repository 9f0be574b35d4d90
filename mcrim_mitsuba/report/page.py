"""The report as an HTML page that loads nothing, runs nothing and shows user texts as texts."""

from __future__ import annotations

import base64
import hashlib
from importlib import resources

import jinja2
from markupsafe import Markup

from mcrim_mitsuba import __version__, findings
from mcrim_mitsuba.files.campaign_parameter import SCALE
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.fit.surface import ALPHA_SCAT
from mcrim_mitsuba.physics.rounding import pdg
from mcrim_mitsuba.report import safe_text, words
from mcrim_mitsuba.report.album import album_of
from mcrim_mitsuba.report.story import Story

#: Effects that a candidate could be mistaken for; so many are named.
_MIMICS = 3


def render(story: Story) -> str:
    """The page of a story, complete."""
    folder = resources.files("mcrim_mitsuba.report")
    style = (folder / "style.css").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text(encoding="utf-8")),
    )  # fmt: skip
    environment.filters |= {
        "said": safe_text.said,
        "brief": safe_text.brief,
        "in_full": safe_text.in_full,
        "p": findings.p_text,
        "number": findings.number,
        "estimate": findings.estimate_text,
        "together": findings.together,
        "value": findings.value_text,
    }
    template = environment.get_template("template.html")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    return template.render(
        story=story,
        campaign=story.campaign,
        diagnosis=story.diagnosis,
        fit=story.calibration,
        pictures=album_of(story),
        leading=findings.leading_candidates(story.diagnosis),
        findings=findings,
        words=words,
        pdg=pdg,
        # ours, and hashed as it stands
        style=Markup(style),
        style_hash=digest,
        version=__version__,
        names={"light_yield": LIGHT_YIELD, "scale": SCALE, "alpha_scat": ALPHA_SCAT},
        mimics_shown=_MIMICS,
        notes=_notes(story),
    )


def _notes(story: Story) -> tuple[str, ...]:
    """Notes of the simulation and the fit; those on raw data stand beside these."""
    notes = dict.fromkeys((*story.calibration.notes, *story.repaired.provenance.notes))
    return tuple(note for note in notes if note not in story.campaign.notes)
