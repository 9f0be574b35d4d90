"""Tables of docs/measured_elsewhere.md: what others measured, and what the package says of it.

    python scripts/measured_elsewhere.py fractions | finishes | pixel | draw [--photons N]

prints tables of Markdown. `fractions`: where light ends in a published Geant4 study, beside ours in
the same geometry. `finishes`: the GAGG bar in several geometries and with several errors. `pixel`:
the LSO pixel, step by step, with and without its second line. `draw` draws the page's picture.
`measured_blind.py` beside it hides causes in both.
"""

from __future__ import annotations

import math
import re
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import click
import tomlkit
from matplotlib.figure import Figure

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.output.figure_style import DARK, WARM
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

SCENES = Path(__file__).parents[1] / "scenes"
GAGG, PIXEL = SCENES / "gagg", SCENES / "lso_pixel"
#: Ground faces of the six finishes, by their label in gagg.csv.
FINISHES = {
    "all polished": (),
    "bottom ground": ("bottom",),
    "top ground": ("top",),
    "sides ground": ("side",),
    "top and sides ground": ("top", "side"),
    "bottom and sides ground": ("bottom", "side"),
}
#: Detected, absorbed by crystal and foil, black, of github.com/hu-yy211/GAGGSurfaceStudy, commit
#: c7a1260: docs/b6-findings.md (contact), and with gaps of 1.15 mm docs/b7_6-findings.md.
CONTACT = {
    "all polished": (0.3714, 0.2959, 0.0383, 0.2932),
    "bottom ground": (0.4458, 0.1343, 0.0143, 0.4032),
    "top ground": (0.4446, 0.1418, 0.0153, 0.3971),
    "sides ground": (0.2543, 0.0305, 0.0055, 0.7061),
    "top and sides ground": (0.2348, 0.0296, 0.0055, 0.7261),
    "bottom and sides ground": (0.2428, 0.0309, 0.0055, 0.7169),
}
CENTRE = (0.3816, 0.4562, 0.4522, 0.2070, 0.1916, 0.1968)
GAPS = {
    "all polished": (0.0955, 0.5630, 0.0017, 0.2943),
    "bottom ground": (0.1991, 0.1470, 0.0054, 0.5115),
    "top ground": (0.2926, 0.1327, 0.0038, 0.4469),
    "top and bottom ground": (0.1913, 0.1167, 0.0039, 0.5717),
    "sides ground": (0.0870, 0.0381, 0.0027, 0.8078),
}
#: No rough face of ours is steeper.
STEEPEST = 1.0


def replaced(text: str, pattern: str, by: str) -> str:
    """The text with the one thing that matches a pattern in another form."""
    text, count = re.subn(pattern, by, text, flags=re.DOTALL)
    assert count == 1, (pattern, count)
    return text


def in_place(text: str, **values: float) -> str:
    """The text of the bar's scene with other defaults."""
    editor = SceneEditor(read_scene(GAGG / "gagg.xml").edited(text), {})
    for name, value in values.items():
        editor.set_default(name, value)
    return editor.finished()


def with_open_foot(text: str) -> str:
    """The text of a scene in which light enters the window beside the crystal, too."""
    face = r'(id="window_beside_gap">(?:(?!</shape>).)*?)<bsdf type="twosided">.*?</bsdf>\s*</bsdf>'
    return replaced(text, face, r'\g<1><ref id="window_to_air"/>')


def ground(scene: SceneFile, faces: Iterable[str], alpha: float) -> SceneFile:
    """The scene with some faces of Beckmann's facets, as UNIFIED has them."""
    for face in faces:
        scene = scene.edited(add(f"ground_{face}", scene, {f"ground_{face}_alpha": 0.3}))
    text = scene.unwritten_text or scene.path.read_text()
    number = '<float name="roughness_alpha"'
    return scene.edited(
        text.replace(number, f'<string name="distribution" value="beckmann"/>{number}')
    ).with_overrides({f"ground_{face}_alpha": alpha for face in faces})


def simulated(text: str, faces: Iterable[str], sigma_alpha: float, photons: int) -> dict:
    """Fractions of ours by fate, of a scene's text with ground faces."""
    scene = read_scene(GAGG / "gagg.xml").edited(text)
    alpha = min(math.sqrt(2.0) * math.tan(sigma_alpha), STEEPEST)
    result = mcrim.simulate(ground(scene, faces, alpha), run=Run(photons=photons))
    return result.budget


def fractions(photons: int) -> None:
    """Theirs, ours and the difference, of three sets of rows."""
    plain = in_place((GAGG / "gagg.xml").read_text(), alpha_scat_per_cm=0)
    contact = in_place(plain, n_gap=1.52)
    # a foil that touches is on the polished face itself; a ground one it touches at its peaks
    touching = {True: in_place(contact, film_mm=0.01), False: in_place(contact, film_mm=0)}
    centre = {
        at_top: replaced(
            in_place(text, source_depth_mm=1e9, source_across_mm=0.1),
            r'<float name="source_across_mm"',
            '<float name="source_z_mm" value="10"/><float name="source_width_mm" value="0.1"/>'
            '<float name="source_across_mm"',
        )
        for at_top, text in touching.items()
    }
    gaps = with_open_foot(in_place(plain, film_mm=1.15, gap_mm=1.15, n_gap=1.0))
    # 11.5 mm wide at the distance of the film
    gaps = replaced(gaps, r'(id="foil">\s*<float name="width" value=")[^"]*"', r'\g<1>9.2"')
    print("| geometry | finish | detected: theirs, ours | crystal | foil and black | ratio |")
    print("|---|---|---|---|---|---|")
    for name, rows, sigma in (("contact", CONTACT, 0.2), ("gaps of 1.15 mm", GAPS, 0.7)):
        first: tuple[float, float] | None = None
        for finish, theirs in rows.items():
            faces = FINISHES.get(finish, ("top", "bottom"))
            text = gaps if rows is GAPS else touching["top" in faces]
            ours = simulated(text, faces, sigma, photons)
            # what is black beside the foot is a reflector of ours, as the foil is
            elsewhere = ours["escaped"] + ours["absorbed_reflector"]
            pairs = zip(
                (*theirs[:2], sum(theirs[2:])),
                (ours["detected"], ours["absorbed_crystal"], elsewhere),
                strict=True,
            )
            cells = [f"{first:.4f}, {second:.4f}" for first, second in pairs]
            first = first or (theirs[0], ours["detected"])
            ratio = f"{theirs[0] / first[0]:.3f}, {ours['detected'] / first[1]:.3f}"
            print(f"| {name} | {finish} | {' | '.join(cells)} | {ratio} |", flush=True)
    for (finish, faces), theirs_detected in zip(FINISHES.items(), CENTRE, strict=True):
        ours = simulated(centre["top" in faces], faces, 0.2, photons)
        line = f"| contact, from the centre | {finish} | {theirs_detected:.4f}, "
        print(f"{line}{ours['detected']:.4f} | | | |", flush=True)


def campaign_in(
    folder: Path, source: Path, scene: Mapping[str, float], *, seen: bool = False, **changes: str
) -> Path:
    """A campaign's files in a folder, with other numbers in its scene and other texts.

    `changes` replace, in all of its files but the scene, what matches their keys.
    """
    name = source.name
    for path in source.iterdir():
        text = path.read_text()
        if path.suffix == ".xml":
            text = in_place(text, **scene) if scene else text
            text = with_open_foot(text) if seen else text
        (folder / path.name).write_text(text)
    for file, text in changes.items():
        (folder / f"{name}.{file}").write_text(text)
    return folder / f"{name}.toml"


def with_errors(text: str, share: float) -> str:
    """The six readings with another relative error."""
    lines = []
    for line in text.splitlines():
        cells = line.split(",")
        if not line.startswith(("#", "label")):
            cells[2] = f"{share * float(cells[1]):.5g}"
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


#: Below and above the crystal, and whether the window is seen beside it.
GEOMETRIES = {
    "as shipped: film of air below, foil at 0.1 mm": ({}, False),
    "optical contact below": ({"n_gap": 1.52}, False),
    "1.15 mm of air below": ({"gap_mm": 1.15}, False),
    "foil touching (0.01 mm)": ({"film_mm": 0.01}, False),
    "foil at 1.15 mm": ({"film_mm": 1.15}, False),
    "window seen beside the crystal": ({}, True),
    "the same, optical contact": ({"n_gap": 1.52}, True),
}
ERRORS = 0.03, 0.10


def finishes(photons: int | None) -> None:
    """What the six finishes say, by geometry and by error."""
    titles = "bench | predicted, chi2 | fitted, chi2 | probabilities | alone, chi2 | verdict"
    print(f"| {titles} |\n|---|---|---|---|---|---|")
    readings = (GAGG / "gagg.csv").read_text()
    cases = [(name, *geometry, 0.05) for name, geometry in GEOMETRIES.items()]
    cases += [(f"as the first, errors of {100 * e:g} %", {}, False, e) for e in ERRORS]
    for name, values, seen, error in cases:
        with tempfile.TemporaryDirectory() as folder:
            path = campaign_in(
                Path(folder), GAGG, values, seen=seen, csv=with_errors(readings, error)
            )
            cells = predicted_cell(path, photons), *diagnosed(path, photons)
            print(f"| {name} | {' | '.join(cells)} |", flush=True)


def prediction(path: Path, photons: int | None) -> mcrim.CompareResult:
    """What the scene says without any fit but the scale's."""
    document = tomlkit.parse(path.read_text())
    for table in document["parameters"].values():
        if "same_as" not in table:
            start = table["start"]
            table.clear()
            table.update({"start": start, "fixed": True})
    held = path.with_name("held.toml")
    held.write_text(tomlkit.dumps(document))
    return mcrim.compare(held, photons=photons)


def sizes_of(candidate) -> str:
    """An effect's title, and its sizes with their errors."""
    sizes = ", ".join(f"{n} = {pdg(s.value, s.sigma)}" for n, s in candidate.sizes.items())
    return f"{candidate.effect} ({sizes})" if sizes else candidate.effect


def predicted_cell(path: Path, photons: int | None) -> str:
    """Ratios to the first reading, and chi2."""
    before = prediction(path, photons)
    first = before.rows[0].model
    ratios = ", ".join(f"{row.model / first:.2f}" for row in before.rows)
    return f"{ratios}: {before.chi2:.0f} of {before.ndf}"


def diagnosed(path: Path, photons: int | None) -> list[str]:
    """Cells of a diagnosis: fit, what is likely, what leads, what results."""
    diagnosis = mcrim.diagnose(path, photons=photons)
    fit = diagnosis.baseline
    likely = sorted(diagnosis.probabilities.items(), key=lambda item: -item[1])
    likely = [f"{name} {100 * part:.0f} %" for name, part in likely[:4] if part > 0.03]
    by_name = {each.effect: each for each in (*diagnosis.candidates, *diagnosis.pairs)}
    leading = [by_name[name] for name in diagnosis.leading if name in by_name]
    leading = leading or list(diagnosis.candidates[:2])
    alone = [f"{sizes_of(each)}: {each.chi2:.1f} of {each.ndf}" for each in leading]
    return [
        f"{fit.chi2:.1f} of {fit.ndf}",
        "; ".join(likely),
        "; ".join(alone),
        diagnosis.verdict,
    ]


def pixel(photons: int | None) -> None:
    """What explains the pixel's readings, step by step; and what its first line alone says."""
    table = (PIXEL / "lso_pixel.csv").read_text()
    first_line = "".join(x for x in table.splitlines(True) if not x.endswith(",1275\n"))
    named = 'scene = "lso_pixel.xml"'
    print("| readings | effects | chi2 | probabilities | alone, chi2 | verdict |")
    print("|---|---|---|---|---|---|")
    for title, csv, effects in (
        ("both lines", table, ()),
        ("both lines", table, ("nonlinearity",)),
        ("511 keV alone", first_line, ()),
    ):
        with tempfile.TemporaryDirectory() as folder:
            path = campaign_in(Path(folder), PIXEL, {}, csv=csv)
            switched_on = f"{named}\neffects = {list(effects)!r}".replace("'", '"')
            path.write_text(path.read_text().replace(named, switched_on))
            cells = diagnosed(path, photons)
            print(f"| {title} | {', '.join(effects) or 'none'} | {' | '.join(cells)} |", flush=True)


def draw(photons: int | None) -> None:
    """The picture: measured, first prediction, mended."""
    figure = Figure(figsize=(12.5, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
    fit = mcrim.compare(GAGG / "gagg.toml", photons=photons)
    with tempfile.TemporaryDirectory() as folder:
        before = prediction(campaign_in(Path(folder), GAGG, {}), photons)
    places = range(len(fit.rows))
    measured, errors = ([getattr(row, n) for row in fit.rows] for n in ("measured", "sigma"))
    left.errorbar(places, measured, errors, fmt="o", color="black", capsize=3, label="measured")
    theirs = [detected / CONTACT["all polished"][0] for detected, *_ in CONTACT.values()]
    left.plot(places, theirs, "v", color="0.6", label="published Geant4 (optical contact)")
    unfitted = [row.model / before.rows[0].model for row in before.rows]
    left.plot(places, unfitted, "s", mfc="none", color=WARM, label="dry, facets of 0.3, no fit")
    models = [row.model for row in fit.rows]
    label = f"dry, facets and coefficients fitted: chi2 {fit.chi2:.1f} of {fit.ndf}"
    left.hlines(
        models, [x - 0.3 for x in places], [x + 0.3 for x in places], color=DARK, label=label
    )
    left.set_xticks(
        places, ["\n".join(row.label.replace(" and ", " + ").rsplit(" ", 1)) for row in fit.rows]
    )
    left.tick_params(axis="x", labelsize=8)
    left.set(ylabel="light relative to all polished", title="GAGG bar, six finishes", ylim=(0, 2.1))
    left.legend(fontsize=9)
    with tempfile.TemporaryDirectory() as folder:
        path = campaign_in(Path(folder), PIXEL, {})
        plain = mcrim.compare(path, photons=photons)
        bent = path.read_text().replace(
            "[parameters", 'effects = ["nonlinearity"]\n\n[parameters', 1
        )
        path.write_text(bent)
        mended = mcrim.compare(path, photons=photons)
    readings = mcrim.read_campaign(PIXEL / "lso_pixel.toml").measurements.readings
    for number, treatment in enumerate(("wrapped", "sides", "bare")):
        for energy, marker in ((511, "o"), (1275, "^")):
            rows = [
                (reading.parameters["source_z_mm"], row, first)
                for reading, row, first in zip(readings, mended.rows, plain.rows, strict=True)
                if reading.label.startswith(treatment) and reading.energy_keV == energy
            ]
            depths = [z for z, *_ in rows]
            colour = f"C{number}"
            used = [(z, row) for z, row, _ in rows if row.use]
            right.errorbar(
                [z for z, _ in used],
                [row.measured for _, row in used],
                [row.sigma for _, row in used],
                fmt=marker,
                ms=4.5,
                color=colour,
                label=f"{treatment}, {energy} keV",
            )
            right.plot(depths, [row.model for _, row, _ in rows], color=colour)
            right.plot(depths, [first.model for *_, first in rows], color=colour, ls=":", lw=1)
    right.set(xlabel="depth (mm)", ylabel="pulse height (V)", ylim=(0, 1.35))
    right.set_title(
        f"LSO pixel: plain (dotted, chi2 {plain.chi2:.0f}), bent readout ({mended.chi2:.0f} of "
        f"{mended.ndf})"
    )
    right.legend(ncols=3, fontsize=8, loc="upper center")
    figure.savefig(SCENES.parent / "docs" / "measured_elsewhere.png", dpi=130)


OTHERS = {"finishes": finishes, "pixel": pixel, "draw": draw}


@click.command()
@click.argument("what", type=click.Choice(["fractions", *OTHERS]))
@options.photons("1e6 for fractions, else what each verb takes")
def main(what: str, photons: int | None) -> None:
    """Tables of docs/measured_elsewhere.md: what others measured, and what the package says of it.

    draw replaces the picture of that page.
    """
    if what == "fractions":
        fractions(photons or 1_000_000)
    else:
        OTHERS[what](photons)


if __name__ == "__main__":
    sys.exit(terminal.run(main, "measured_elsewhere"))
