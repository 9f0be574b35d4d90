"""The documentation: it builds without a warning, leaves nothing out, and its notebooks run."""

import dataclasses
import io
import json
import logging
import re
import shutil
import tomllib
from pathlib import Path
from urllib.parse import unquote, urldefrag

import click
import lxml.html
import pytest
from places import ROOT
from write_pages import WRITERS, written

from mcrim_mitsuba.cli.main import mcrim
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.output.describe_campaign import not_modelled
from mcrim_mitsuba.transport.variants import use_variant

sphinx_application = pytest.importorskip("sphinx.application", reason="extra docs")
nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")


class Site:
    """The pages as ``python -m sphinx -W docs docs/_build`` makes them, notebooks left out.

    These run in tests of their own.
    """

    def __init__(self, folder: Path) -> None:
        source = folder / "docs"
        shutil.copytree(
            ROOT / "docs", source, ignore=shutil.ignore_patterns("_build", "api", "__pycache__")
        )
        for name in ("scenes", "README.md", "CHANGELOG.md"):
            (folder / name).symlink_to(ROOT / name)
        complaints = io.StringIO()
        self.folder = folder / "site"
        application = sphinx_application.Sphinx(
            source,
            source,
            self.folder,
            folder / "doctrees",
            "html",
            status=None,
            warning=complaints,
            # every page would list all objects of all modules in its margin: a third of the time
            confoverrides={"nb_execution_mode": "off", "toc_object_entries": False},
        )
        application.builder.search = False  # an index of all words: nothing here asks it
        with pytest.MonkeyPatch.context() as patch:
            # on which lines definitions end: pages of code would ask, and it takes a while
            patch.setattr("sphinx.pycode.parser.Parser.parse_definition", lambda self: None)
            patch.setattr(logging.root.manager, "disable", logging.DEBUG)
            application.build()
        stubs = "\n".join(path.read_text() for path in (source / "api").glob("*.rst"))
        self.modules = set(re.findall(r"automodule:: (\S+)", stubs))
        self.complaints = complaints.getvalue()

    def page(self, name: str) -> lxml.html.HtmlElement:
        return lxml.html.parse(str(self.folder / name)).getroot()

    @property
    def pages(self) -> list[str]:
        found = self.folder.rglob("*.html")
        return sorted(path.relative_to(self.folder).as_posix() for path in found)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Site:
    return Site(tmp_path_factory.mktemp("docs"))


def test_every_field_of_an_effect_is_explained():
    """Who writes a file of one's own reads this page."""
    use_variant()
    from mcrim_mitsuba.transport.record_store import COLUMNS

    text = (ROOT / "docs" / "effects.md").read_text()
    for owner in (Effect, EffectParameter):
        (told,) = re.findall(rf"\| field of `{owner.__name__}` .*?\n\n", text, re.DOTALL)
        for each in dataclasses.fields(owner):
            assert f"`{each.name}`" in told, each.name
    (told,) = re.findall(r"\| column \| .*?\n\n", text, re.DOTALL)
    assert {f"`{name}`" for name in COLUMNS} <= set(re.findall("`[^`]+`", told))


def test_what_pages_say_of_the_package_is_what_it_says_of_itself():
    """In a clone, without a built site; ``python scripts/write_pages.py`` writes them anew."""
    for page, _ in WRITERS:
        text = (ROOT / "docs" / page).read_text()
        assert written(page, text) == text, page


def test_the_site_builds_without_a_warning(site):
    assert site.complaints == ""


def test_no_link_leads_nowhere_and_nothing_comes_from_the_network(site):
    names = {name: set(site.page(name).xpath("//@id")) for name in site.pages}
    for name in site.pages:
        page = site.page(name)
        for link in page.xpath("//a/@href"):
            if link.startswith(("http:", "https:", "mailto:")):
                continue
            path, anchor = urldefrag(link)
            target = (site.folder / name).parent / unquote(path) if path else site.folder / name
            assert target.is_file(), f"{name}: {link}"
            known = names.get(target.resolve().relative_to(site.folder.resolve()).as_posix())
            assert not anchor or known is None or unquote(anchor) in known, f"{name}: {link}"
        loaded = page.xpath("//script/@src | //link[@rel='stylesheet']/@href | //img/@src")
        assert not [source for source in loaded if "//" in source], name
    for style in site.folder.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//|@import", style.read_text()), style.name


def test_equations_are_mathml(site):
    page = site.page("theory.html")
    numbered = page.xpath("//div[contains(@class, 'equation')]")
    assert len(numbered) > 25
    assert all(block.xpath(".//*[local-name() = 'math']") for block in numbered)
    for name in site.pages:
        if name.startswith("api/"):
            continue
        for text in site.page(name).xpath("//article//text()[not(ancestor::pre|ancestor::code)]"):
            assert not re.search(r"\\[a-z]+|\$\$", text), f"{name}: {text}"


def test_the_reference_has_every_module(site):
    files = (ROOT / "mcrim_mitsuba").rglob("*.py")
    names = {path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".") for path in files}
    public = {
        name.removesuffix(".__init__")
        for name in names
        if "._" not in name.replace(".__init__", "")
    }
    assert site.modules == public


def test_the_reference_shows_docstrings(site):
    text = " ".join(site.page("api/mcrim_mitsuba.optics.html").text_content().split())
    assert "Complex amplitude reflection coefficients" in text
    assert "Cosine of the angle of incidence, in [0, 1]." in text


def test_every_command_and_option_is_listed(site):
    page = site.page("commands.html")

    def look(command: click.Command, name: str) -> None:
        (section,) = page.xpath("//section[@id=$id]", id=name.replace(" ", "-"))
        shown = section.text_content()
        for option in command.params:
            if isinstance(option, click.Option) and not option.hidden:
                assert option.opts[0] in shown, f"{name} {option.opts[0]}"
        for verb, one in getattr(command, "commands", {}).items():
            look(one, f"{name} {verb}")

    look(mcrim, "mcrim")


def test_every_effect_is_listed(site):
    page = site.page("effects.html")
    rows = [" ".join(row.text_content().split()) for row in page.xpath("//table//tr")]
    for effect in catalogue().values():
        assert any(row.startswith(effect.name) for row in rows), effect.name
        assert page.xpath("//section[@id=$id]", id=effect.name.replace("_", "-")), effect.name
        for parameter in effect.parameters:
            assert any(parameter.name in row for row in rows), parameter.name


def test_what_no_model_has_is_the_table_that_a_budget_prints(site):
    page = " ".join(site.page("theory.html").text_content().split())
    for words in (words for cause in not_modelled() for words in cause):
        assert words in page.replace("’", "'"), words


def test_modules_and_files_that_pages_name_exist():
    named = 0
    for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        text = path.read_text()
        for module in re.findall(r"\{py:mod\}`(?:[\w.]+ <)?(mcrim_mitsuba[\w.]*)", text):
            stem = ROOT / module.replace(".", "/")
            assert stem.is_dir() or stem.with_suffix(".py").is_file(), f"{path.name}: {module}"
            named += 1
        for name in re.findall(r"\b(?:scenes|scripts)/[\w./]*\w", text):
            assert (ROOT / name).exists(), f"{path.name}: {name}"
    assert named > 30


def test_the_architecture_names_what_there_is():
    text = (ROOT / "docs" / "architecture.md").read_text()
    rooms = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    assert rooms == contracts["contracts"][0]["layers"][::-1]
    # `room/module.py` (`Class.method`, `function`)
    named = re.findall(r"`([\w/]+/[a-z_0-9]+\.py)`(?:\s\((`[\w.`,\s]+`)\))?", text)
    for path, insides in named:
        outside = path.startswith(("tests/", "scripts/"))
        file = ROOT / (path if outside else f"mcrim_mitsuba/{path}")
        assert file.is_file(), path
        for name in re.findall(r"`([\w.]+)`", insides):
            for part in name.split("."):
                defined = rf"^\s*(?:def |class )?{part}\b(?:[(:]| =)"
                assert re.search(defined, file.read_text(), re.MULTILINE), f"{path}: {name}"
    assert len(named) > 100


def test_the_readme_is_short_and_its_links_lead_somewhere():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 160
    assert len(text.split()) <= 1100
    for link in re.findall(r"\]\(([^)#]+)", text):
        assert link.startswith("https:") or (ROOT / link).exists(), link
    # a command of one line under each mark, for those who paste and for .ci/run
    marked = (
        r"^<!-- (\w+) command -->\n```sh\npython3 -m venv (?:--upgrade-deps )?\.venv && (.+)\n```$"
    )
    assert re.findall(marked, text, re.MULTILINE) == [
        ("article", ".venv/bin/pip install . && .venv/bin/mcrim paper"),
        ("test", ".venv/bin/pip install -e '.[test]' && .venv/bin/python -m pytest"),
    ]


def test_every_page_of_the_docs_is_in_the_contents():
    contents = (ROOT / "docs" / "index.md").read_text()
    docs = ROOT / "docs"
    pages = {path.stem for kind in ("md", "ipynb") for path in docs.glob(f"*.{kind}")} - {"index"}
    assert pages <= set(contents.split())


@pytest.fixture(scope="module")
def run(kept_records):
    """Runs a notebook: numbers that it ends with, a Python expression each, and all that it said.

    With a cache, as users have one, and all in one process, where each finds no other's names.
    """
    empty = nbformat.v4.new_notebook()
    client = nbclient.NotebookClient(
        empty, timeout=600, kernel_name="python3", resources={"metadata": {"path": ROOT}}
    )

    def run(name: str, numbers: str) -> tuple[dict, str]:
        notebook = nbformat.read(ROOT / "docs" / f"{name}.ipynb", 4)
        assert not any(cell.get("outputs") for cell in notebook.cells), "keep it without outputs"
        for place, code in (
            (0, f"%reset -f\n%cd -q {ROOT}"),
            (len(notebook.cells) + 1, f"import json\nprint(json.dumps({numbers}))"),
        ):
            notebook.cells.insert(place, nbformat.v4.new_code_cell(code))
        client.nb = notebook
        client.reset_execution_trackers()
        for place, cell in enumerate(notebook.cells):
            client.execute_cell(cell, place)
        *cells, last = (cell.outputs for cell in notebook.cells if cell.cell_type == "code")
        return json.loads(last[0].text), str(cells)

    with client.setup_kernel():
        yield run


def test_the_notebook_of_the_optics_staff(run):
    found, said = run("optics_staff", "[light.eta, mirror.eta]")
    assert found == pytest.approx([0.319, 0.361], abs=0.004)
    # of what is wrong a notebook shows one line
    line = "wrong.xml, line 2: crystal_height_mm = '20,5' has a decimal comma"
    assert f"InputError: {line}" in said and "Traceback" not in said
    assert said.count("image/png") == 4


def test_the_notebook_of_the_analyst(run):
    names = "bubble_fraction", "light_yield_ph_per_keV"
    values = ", ".join(f"repaired.{name}.value" for name in names)
    ratio = "float(ratio.interp(alpha_scat_per_cm=0.54, alpha_abs_per_cm=0.039))"
    fitted = "fit.alpha_scat_per_cm.value, fit.light_yield_ph_per_keV.value"
    found, said = run("analyst", f"[repaired.leading, {ratio}, {fitted}, {values}]")
    assert found[0] == ["gap_bubble"]
    # of an independent exact calculation
    assert found[1] == pytest.approx(0.5813, abs=0.006)
    assert found[2:4] == [pytest.approx(0.58, abs=0.06), pytest.approx(7.7, abs=0.15)]
    # what was hidden: 0.30 and 7.68 ph/keV
    assert found[4:] == [pytest.approx(0.30, abs=0.12), pytest.approx(7.68, abs=0.5)]
    assert said.count("image/png") == 5


def test_the_notebook_of_the_planner(run):
    found, said = run(
        "planner",
        "[doubt.leading, averaged.sigma / best['sigma'],"
        " [reading.parameters for reading in doubt.next_measurements[:3]]]",
    )
    # of four seeds 1.4 to 1.8: it takes few photons
    assert found[0][:2] == ["ground_top", "edge_chamfer"] and 1.0 < found[1] < 2.0
    assert found[2][0] == {"n_gap": 1.333, "aperture_radius_mm": 7.0}
    assert "A light yield to 8.0 % cannot be reached" in said and "image/png" in said
