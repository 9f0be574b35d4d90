"""Report a campaign: one page that tells what was measured, what it means and how to repeat it."""

from __future__ import annotations

import base64
import hashlib
import io
import itertools
import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape
from matplotlib import rc_context
from numpy.typing import NDArray
from PIL import Image

from mcrim_mitsuba import __version__
from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import read_text, refuse_outputs, write_text
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.rounding import number, pdg, short_text
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.diagnose import final_step
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.inference.repair import repair
from mcrim_mitsuba.output import describe_campaign, describe_laboratory, sentences
from mcrim_mitsuba.output import figure_style as style
from mcrim_mitsuba.output.budget_figures import draw_budget
from mcrim_mitsuba.output.describe_scene import FACES
from mcrim_mitsuba.output.description import records
from mcrim_mitsuba.output.diagnosis_figures import draw_next, draw_ranking, draw_staircase
from mcrim_mitsuba.output.fit_figures import draw_comparison, draw_profiles
from mcrim_mitsuba.output.laboratory_figures import draw_raw_data
from mcrim_mitsuba.output.light_figures import Lights, draw_arrival, draw_fates
from mcrim_mitsuba.output.pages import environment
from mcrim_mitsuba.output.report_sections import RatioOfSignals, Sections, gather

# matplotlib writes texts into comments and a date into the metadata; a page needs neither
_COMMENTS = re.compile(r"<!--.*?-->\n?|<metadata>.*?</metadata>\n?|<!DOCTYPE.*?>\n?", re.DOTALL)
# a hundredth of a point is not seen
_PATHS = re.compile(r' d="[^"]*"')
_FURTHER_DIGITS = re.compile(r"(\.\d\d)\d+")
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_PIXELS_PER_INCH = 96
_COLOURS = 256


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure of the report."""

    #: Of the file that its numbers are saved as.
    name: str
    #: What it shows, for those who do not see it.
    alt: str
    #: ``data:`` URI.
    source: str
    #: Natural size, pixels.
    width: int
    height: int
    #: Of every CSV with what is behind it: what it holds, its name, and its ``data:`` URI.
    numbers: tuple[tuple[str, str, str], ...] = ()


def of_drawing(name: str, drawing: style.Drawing, alt: str, **further: style.Numbers) -> Picture:
    """A figure as vector graphics, its texts as outlines: it looks the same everywhere.

    `further` tables behind it, besides the drawing's own, come by what they hold.
    """
    figure = drawing.figure
    if (layout := figure.get_layout_engine()) is not None:
        # once, by metrics that are quicker than those of outlines
        layout.execute(figure)
        figure.set_layout_engine("none")
    with rc_context({"svg.fonttype": "path", "svg.hashsalt": name}):
        svg = style.content_of(figure, "svg", dpi="figure", metadata={"Date": None})
    text = _NOT_XML.sub("", _COMMENTS.sub("", svg.decode()))
    text = _PATHS.sub(lambda path: _FURTHER_DIGITS.sub(r"\1", path[0]), text)
    wide, high = (round(side * _PIXELS_PER_INCH) for side in figure.get_size_inches())
    tables = {"numbers": (drawing.columns, drawing.rows)} if drawing.columns else {}
    numbers = []
    for content, table in (tables | further).items():
        csv = data_uri(style.numbers_text(*table).encode(), "text/csv")
        numbers.append((content, f"{name}-{content}" if further else name, csv))
    source = data_uri(text.encode(), "image/svg+xml")
    size = {"width": wide, "height": high}
    return Picture(name=name, alt=alt, source=source, numbers=tuple(numbers), **size)


def of_pixels(name: str, pixels: NDArray[np.uint8], alt: str) -> Picture:
    """A photograph, in so few colours that it is easy to mail."""
    stream = io.BytesIO()
    few = Image.fromarray(pixels).quantize(_COLOURS, dither=Image.Dither.NONE)
    few.save(stream, format="png", optimize=True)
    height, width = pixels.shape[:2]
    source = data_uri(stream.getvalue(), "image/png")
    return Picture(name=name, alt=alt, source=source, width=width, height=height)


def data_uri(data: bytes, kind: str = "text/plain") -> str:
    """An address that is the data itself; of text, in UTF-8."""
    charset = ";charset=utf-8" if kind.startswith("text/") else ""
    return f"data:{kind}{charset};base64,{base64.b64encode(data).decode()}"


def efficiencies_csv(sections: Sections) -> bytes:
    """The light collection efficiency of every reading, with its configuration."""
    columns = sections.campaign.cells(sections.campaign.measurements.readings[0])
    both = zip(sections.efficiencies, sections.fit.rows, strict=True)
    rows = [(e.label, *map(e.parameters.get, columns), e.eta, e.sigma, row.pull) for e, row in both]
    return style.numbers_text(("label", *columns, "eta", "eta_sigma", "pull"), rows).encode()


# The report's own: how a ratio of readings gives the scattering, and the bench for its beginning.


@style.styled
def _draw_ratio(curve: RatioOfSignals) -> style.Drawing:
    """Efficiencies of two configurations against scattering, and the ratio of their signals."""
    figure, (left, right) = style.axes_of(8.4, 3.9, 1, 2)
    looks = ({"color": style.WARM, "ls": "--"}, {"color": style.DARK, "ls": "-"})
    names = style.shortened_apart(curve.labels, 24)
    for eta, name, look in zip(curve.eta.T, names, looks, strict=True):
        left.plot(curve.alpha_scat_per_cm, eta, lw=2, label=name, **look)
    left.set(ylabel="light collection efficiency η", ylim=(0, None))
    style.legend(left)
    low, high = (curve.measured + sign * curve.measured_sigma for sign in (-1, 1))
    right.axhspan(low, high, color="#f2cdb9", lw=0, label="measured, ± 1 standard error")
    right.axhline(curve.measured, color=style.WARM, lw=1.2)
    right.plot(curve.alpha_scat_per_cm, curve.ratio, color=style.DARK, lw=2, label="simulated")
    right.set_ylabel("ratio of the two signals")
    style.legend(right)
    for axes in (left, right):
        axes.axvline(curve.solution_per_cm, color=style.GREY, lw=1.2, ls=":")
        axes.set(xscale="log", xlabel=r"$α_\mathrm{scat}$ (1/cm); dotted: fitted")
    columns = {"alpha_scat_per_cm": curve.alpha_scat_per_cm}
    columns |= {"eta_first": curve.eta[:, 0], "eta_second": curve.eta[:, 1], "ratio": curve.ratio}
    measured = {"measured_ratio": curve.measured, "measured_ratio_sigma": curve.measured_sigma}
    return style.Drawing(figure, *style.numbers_in(columns | measured))


# All pictures of a report; those that a campaign has no use for are left out.

_SHOWN = {
    "cross-section": "vertical cut through the bench, to scale",
    "comparison": "readings beside what the model predicts, and the differences in standard errors",
    "histograms": "histograms of photons per event with their peaks",
    "calibration": "channels of the digitiser: single photoelectrons, pedestal, background",
    "detector-efficiency": "emission and quantum efficiency",
    "transmittance": "transmittance and absorption coefficient",
    "ranking": "effects by how much of the misfit each would explain",
    "staircase": "how the misfit falls as effects are added",
    "before-and-after": "readings beside the model before and after the effects were added",
    "ratio": "the ratio of two signals against scattering, simulated and measured",
    "profiles": "how the misfit rises as each parameter leaves its best value",
    "error-budget": "parts of each parameter's error by origin",
    "next": "the light yield's error now and after each proposed measurement",
    "next-bench": "the bench of the first proposed reading, cut open, to scale",
    "fates": "what becomes of the light in each coupling",
    "arrival": "where and under which angle light reaches the detector",
    "bench": "picture of the bench, whole, taken apart and cut open",
    "view": "the bench as it stands",
}


def album_of(sections: Sections) -> dict[str, Picture]:
    """The pictures by name; they are kept in the cache, so that they are drawn once."""
    if sections.drawn is not None:
        kept = json.loads(sections.drawn.arrays["pictures"].tobytes())
        return {name: Picture(**fields) for name, fields in kept.items()}
    drawings = _drawings(sections).items()
    pictures = {name: of_drawing(name, drawn, _SHOWN[name]) for name, drawn in drawings}
    if sections.lights:
        arrival = draw_arrival(sections.lights)
        # light along radius and angle; the map's cells, a row each, would make the page heavy
        part = arrival.columns.index("part")
        arrival = replace(arrival, rows=[row for row in arrival.rows if row[part] != "map"])
        of_map = _map(sections.lights)
        pictures["arrival"] = of_drawing("arrival", arrival, _SHOWN["arrival"], map=of_map)
    # last: it may have to be waited for
    photograph = sections.bench.photograph
    if photograph is not None and photograph.picture is not None:
        for name, pixels in zip(("bench", "view"), photograph.picture, strict=True):
            pictures[name] = of_pixels(name, pixels, _SHOWN[name])
        # without a photograph, which may come another time, they are not kept
        content = json.dumps({name: asdict(picture) for name, picture in pictures.items()}).encode()
        sections.album.write(0, {"pictures": np.frombuffer(content, np.uint8)}, {})
    return pictures


def _drawings(sections: Sections) -> dict[str, style.Drawing]:
    """Figures by their names in `_SHOWN`, those that the campaign has a use for."""
    diagnosis, fit, baseline = sections.diagnosis, sections.fit, sections.diagnosis.baseline
    unit = sections.campaign.unit
    drawings = {}
    if sections.bench.cross_section is not None:
        drawings["cross-section"] = style.Drawing(sections.bench.cross_section)
    if sections.campaign.raw is not None:
        for kind in sections.campaign.raw.kinds:
            drawing = draw_raw_data(sections.campaign.raw, kind)
            drawings["detector-efficiency" if kind == "spectra" else kind] = drawing
    if diagnosis.candidates:
        drawings["ranking"] = draw_ranking(diagnosis, brief=True)
    if (drawing := draw_next(diagnosis)).rows:
        drawings["next"] = drawing
    if sections.next_bench is not None:
        drawings["next-bench"] = style.Drawing(sections.next_bench)
    if sections.effects:
        if not sections.chosen_by_hand:
            drawings["staircase"] = draw_staircase(diagnosis.repair, fit)
        added = sentences.in_words(diagnosis, sections.effects)
        drawings["before-and-after"] = draw_comparison(baseline, fit, added=added, unit=unit)
    else:
        drawings["comparison"] = draw_comparison(baseline, unit=unit)
    if sections.ratio is not None:
        drawings["ratio"] = _draw_ratio(sections.ratio)
    if sections.profiles:
        drawings["profiles"] = draw_profiles(sections.profiles)
    if fit.parameters:
        drawings["error-budget"] = draw_budget(fit)
    if sections.lights:
        drawings["fates"] = draw_fates(sections.lights)
    return drawings


def _map(lights: Lights) -> style.Numbers:
    """Light per mm2 and emitted photon on the detector: below a row of x, a row for each y."""
    rows: list[tuple[object, ...]] = []
    for name, light in lights:
        middles = ((edges[1:] + edges[:-1]) / 2 for edges in (light.x_edges_mm, light.y_edges_mm))
        x, y = ([float(f"{middle:.5g}") for middle in along] for along in middles)
        rows.append((name, "x (mm)", *x))
        lines = zip(y, light.map.density, strict=True)
        rows += [(name, y_mm, *(float(f"{cell:.4g}") for cell in line)) for y_mm, line in lines]
    widest = max((len(row) for row in rows), default=2) - 2
    return ("configuration", "y (mm)", *(f"light_per_mm2_{i + 1}" for i in range(widest))), rows


#: Characters of a text in a table or a sentence; files are shown in full.
MOST_IN_A_TABLE = 80

_RIGHT_TO_LEFT = (
    r"[\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefe\U00010800-\U00010fff\U0001e800-\U0001efff]"
)
_RUN = re.compile(rf"{_RIGHT_TO_LEFT}+(?:[ ]+{_RIGHT_TO_LEFT}+)*")


def brief(text: object, most: int = MOST_IN_A_TABLE) -> str:
    """A text for a table, an attribute or a sentence: in one line, visible and not too long."""
    return style.shortened(str(text), most)


def said(text: object, most: int = MOST_IN_A_TABLE) -> Markup:
    """A text in one line as markup: isolated, so that its direction of writing stays its own."""
    return Markup("<bdi>{}</bdi>").format(brief(text, most))


def in_full(text: object) -> Markup:
    """A file's text for ``<pre>``: what runs from right to left is isolated word by word."""
    return Markup(_RUN.sub(r"<bdi>\g<0></bdi>", str(escape(visible(text, keep="\n\t")))))


# The page: it loads nothing, runs nothing and shows texts of users as texts.

#: Rows of a table that are printed: the page as a file has more.
MOST_ROWS = 30
#: Rows of effects that are printed.
MOST_PRINTED = 8


def render(sections: Sections) -> str:
    """The whole page of a report as HTML."""
    style = (resources.files("mcrim_mitsuba.output") / "style.css").read_text(encoding="utf-8")
    pages = environment()
    pages.filters |= {"said": said, "brief": brief, "in_full": in_full, "number": number}
    pages.filters |= {"estimate": sentences.estimate_text, "value": short_text}
    pages.filters |= {"data_uri": data_uri}
    parameters = sections.fit.parameters
    raw, steps = sections.campaign.raw, sections.diagnosis.repair
    if sections.effects:
        # effects that the user chose were not added one by one
        kept = steps[:1] if sections.chosen_by_hand else steps
        steps = (*(kept[:-1] or kept), final_step(kept[-1], sections.fit))
    notes = dict.fromkeys((*sections.fit.notes, *sections.provenance.notes))
    return pages.get_template("template.html").render(
        sections=sections,
        campaign=sections.campaign,
        diagnosis=sections.diagnosis,
        fit=sections.fit,
        pictures=album_of(sections),
        efficiencies=efficiencies_csv(sections),
        faces=records("", FACES, sections.bench.report.interfaces),
        steps=describe_campaign.steps_table(steps),
        meanings={n: sentences.parameter_words(sections.campaign, n)[0] for n in parameters},
        most_rows=MOST_ROWS,
        most_printed=MOST_PRINTED,
        leading=sentences.leading_candidates(sections.diagnosis),
        sentences=sentences,
        describe=describe_campaign,
        laboratory=describe_laboratory,
        pdg=pdg,
        # ours, and hashed as it stands
        style=Markup(style),
        style_hash=base64.b64encode(hashlib.sha256(style.encode()).digest()).decode(),
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


def report(
    campaign: str | Path | Campaign,
    output: str | Path,
    *,
    effects: Sequence[str] | None = None,
    run: Run = Run(),
) -> Sections:
    """Diagnose and mend a campaign, and write all that was found as one HTML file.

    The file needs nothing else: no network, no scripts. An HTML file that is there is replaced.
    Given back is what it tells. The campaign is mended with the effects, besides its own, by
    default with what `repair` adds.

    Raises InputError as `inference.repair.repair` does, or if the file cannot be written.
    """
    refuse_output(output, [campaign] if isinstance(campaign, (str, Path)) else [])
    campaign = as_campaign(campaign)
    # before all work: whatever cannot be added is refused
    chosen = campaign.with_effects(effects or ()).effects[len(campaign.effects) :]
    repaired = repair(campaign, run=run)
    if effects is not None and set(chosen) != set(repaired.effects):
        # the same campaign mended with other effects
        simulations, diagnosis = repaired.simulations, repaired.diagnosis
        candidate = diagnosis.candidate(chosen)
        # from where the diagnosis found them, if it tried them
        starts = {n: size.value for n, size in candidate.parameters.items()} if candidate else None
        # all effects as the diagnosis had them: those that are added in full, others at a look
        every_effect = tuple(dict.fromkeys((*diagnosis.titles, *chosen)))
        simulations.simulate(every_effect, look=set(every_effect) - {*chosen})
        fit, provenance = simulations.settled_fit(chosen, starts), simulations.provenance()
        repaired = replace(repaired, effects=chosen, fit=fit, provenance=provenance)
    done = itertools.count(1)

    def stage(what: str) -> None:
        run.tell(f"report: {what}", min(next(done), _STAGES), _STAGES)

    command = _command(repaired.simulations.campaign.path, output, run)
    now, by_hand = datetime.now(UTC), effects is not None
    sections = gather(repaired, command=command, made=now, chosen_by_hand=by_hand, stage=stage)
    stage("figures")
    write_text(output, render(sections))
    return sections


def refuse_output(output: str | Path, inputs: Sequence[str | Path]) -> None:
    """Refuse a place where the report cannot be written, or what is no page there.

    Raises InputError without touching a file.
    """
    path = Path(output)
    refuse_outputs({"--output": str(output)}, inputs, suffixes={"--output": SUFFIXES})
    if path.is_file() and path.stat().st_size:
        beginning = read_text(path, _LIMIT_MB)[:1000].lower()
        if "<html" not in beginning and "<!doctype html" not in beginning:
            problem = "--output would replace a file that is no HTML page"
            raise InputError(problem, "name another", path=path)


def _command(campaign: Path, output: str | Path, run: Run) -> str:
    """What to type for this report."""
    typed = ["mcrim", "report", str(campaign), "-o", str(output)]
    if run.photons is not None:
        typed += ["--photons", str(run.photons)]
    return shlex.join([*typed, "--seed", str(run.seed), "--variant", run.variant])
