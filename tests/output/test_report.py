"""The report: what users typed stays text, nothing is loaded, the numbers are those of the fit."""

import base64
import hashlib
import io
import json
import re
import subprocess
import sys
from contextlib import redirect_stdout
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from findings_by_hand import FIRST, MENDED, SECOND, calibration, diagnosis, estimate, quick_report
from lxml import html
from places import SCENES
from refusals import refusal

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.entries import LONGEST_REMARK, TO_QUOTE
from mcrim_mitsuba.cli.main import main
from mcrim_mitsuba.core.rounding import pdg_parts
from mcrim_mitsuba.inference.repair import remarks_on
from mcrim_mitsuba.output import photograph, public, report_sections
from mcrim_mitsuba.output import report as reporting
from mcrim_mitsuba.output.describe_campaign import others_table
from mcrim_mitsuba.output.report import in_full, said, visible
from mcrim_mitsuba.output.report_sections import changed
from mcrim_mitsuba.output.sentences import averaged_yield, headline

MB = 1_000_000
SCRIPT = "<script>window.hacked = 1</script>"
BREAKOUT = "{{7*7}}</pre></style></title>]]>--><svg onload=window.hacked=1> javascript:x"
BACKWARDS, LONG = "\u202egnp.exe", "A<" * 5000
LABELS = (f'{SCRIPT} "quoted"', BACKWARDS)
SECTIONS = "summary explanations next measured bench baseline repair result reproduce".split()
#: All that the page may hold: nothing that runs, loads or sends.
ELEMENTS = set(
    "html head meta title style body header main section nav h1 h2 h3 p a br ol ul li dl dt dd "
    "div table caption thead tbody tr th td figure figcaption img pre code details summary "
    "span strong small sub bdi".split()
)


def write_campaign(folder: Path, scenes: Path) -> Path:
    """The article's campaign, every text in it hostile."""
    scene = folder / "a<b>&'.xml"
    text = (scenes / "camoo4.xml").read_text()
    scene.write_text(text.replace("Width of the crystal along x", SCRIPT, 1))
    quoted = [label.replace('"', '""') for label in (*LABELS, LONG)]
    (folder / "mea'sured <i>.csv").write_text(
        f"# {BREAKOUT}\nlabel,signal,sigma,n_gap,use\n"
        f'"{quoted[0]}",14.3,0.2,1.00,1\n"{quoted[1]}",24.5,0.4,1.46,1\n"{quoted[2]}",20,1,1.46,0\n'
    )
    campaign = folder / f"camp{SCRIPT.replace('/', '-')}.toml"
    campaign.write_text(
        (scenes / "camoo4_campaign.toml")
        .read_text()
        .replace("camoo4.xml", scene.name)
        .replace("camoo4_measured.csv", "mea'sured <i>.csv")
        + f"\n# {BREAKOUT}\n"
    )
    return campaign


@pytest.fixture(scope="module")
def by_hand():
    return diagnosis("ambiguous", not_tried={"nonlinearity": BREAKOUT})


@pytest.fixture(scope="module")
def made(tmp_path_factory, scenes, by_hand):
    """A report of hostile files, its fit of few photons, its diagnosis made by hand."""
    folder = tmp_path_factory.mktemp("report")
    campaign = write_campaign(folder, scenes)

    with quick_report(by_hand) as patch:
        patch.setenv("MCRIM_CACHE", str(folder / "cache"))
        page, numbers = folder / "report.html", folder / "report.json"
        with redirect_stdout(io.StringIO()) as printed:
            assert main(["report", str(campaign), "-o", str(page), "--json", str(numbers)]) == 0
    page.with_suffix(".txt").write_text(printed.getvalue())
    return page, json.loads(numbers.read_text())


@pytest.fixture(scope="module")
def parsed(made):
    return html.fromstring(made[0].read_bytes())


def test_nothing_in_the_page_runs_or_is_loaded(made, parsed):
    page, _ = made
    assert page.stat().st_size < 5 * MB
    elements = [e for e in parsed.iter() if isinstance(e.tag, str)]
    assert {e.tag for e in elements} <= ELEMENTS
    names = {name for e in elements for name in e.attrib}
    assert not [name for name in names if name.startswith("on") or name == "style"]
    assert all(e.get("src").startswith("data:image/") for e in parsed.iter("img"))
    hrefs = {e.get("href").partition(",")[0] for e in parsed.iter("a")}
    kinds = {f"data:text/{kind};charset=utf-8;base64" for kind in ("csv", "plain")}
    assert {h for h in hrefs if h[0] != "#"} == kinds
    assert all(e.get("download") for e in parsed.iter("a") if e.get("href")[0] != "#")
    assert all(parsed.get_element_by_id(h[1:]) is not None for h in hrefs if h[0] == "#")
    policy = parsed.xpath("//meta[@http-equiv='Content-Security-Policy']/@content")[0]
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'sha256-")
    assert all(image.get("alt") for image in parsed.iter("img"))


def test_what_users_typed_is_shown_as_text(parsed):
    shown = " ".join(parsed.text_content().split())
    for typed in (SCRIPT, BREAKOUT, LABELS[0], "a<b>&'.xml", "mea'sured <i>.csv", LONG):
        assert typed in shown or typed.replace('"', '""') in shown, typed[:60]
    assert "<U+202E>gnp.exe" in shown and "\u202e" not in shown
    cells = [td.text_content() for td in parsed.iter("td")]
    assert LABELS[0] in cells and max(map(len, cells)) < 1000
    # each in an isolation of its own
    assert [b.text for b in parsed.xpath("//td/bdi") if b.text == LABELS[0]]


def test_the_story_is_told_in_order_with_the_numbers_of_the_fit(made, parsed):
    _, found = made
    assert [e.get("id") for e in parsed.xpath("//header | //section")] == SECTIONS
    assert [a.get("href")[1:] for a in parsed.xpath("//nav//a")] == SECTIONS[1:]
    for name, quantity in found["result"].items():
        known = found["calibration"]["parameters"][name]
        assert (quantity["value"], quantity["total"]) == (known["value"], known["sigma"])
        assert np.hypot(quantity["statistical"], quantity["systematic"]) == pytest.approx(
            known["sigma"], rel=1e-6
        )
    light = found["result"]["light_yield_ph_per_keV"]
    big = parsed.get_element_by_id("result-light-yield").text_content()
    parts = pdg_parts(light["value"], light["statistical"], light["systematic"])
    assert big.startswith(parts.replace(" ", "\xa0"))
    # a number is not split from its error where a line ends
    assert not [text for text in parsed.itertext() if re.search(r"[0-9] ± [0-9]", text)]
    for row, each in zip(found["calibration"]["rows"], found["efficiencies"], strict=True):
        assert each["eta"] == row["eta"] and each["sigma"] > row["eta_sigma"]
    shown = parsed.text_content()
    for digest in (*found["files"].values(), found["scene_hash"]):
        assert re.fullmatch("[0-9a-f]{64}", digest) and digest in shown
    assert f"{found['photons']:,}, seed 0" in shown
    assert found["verdict"] == "ambiguous" and f"Ambiguous: {found['reason']}" in shown
    # all that is proposed stands in the section of that name, not behind the repair
    following = parsed.get_element_by_id("next").xpath(".//table//tr")
    assert len(following) == 2 and "1 h" in following[1].text_content()
    pictures = {e.get("id") for e in parsed.iter("figure")}
    assert {
        f"figure-{n}"
        for n in (
            "view bench cross-section comparison ranking next next-bench ratio profiles "
            "error-budget fates arrival"
        ).split()
    } == pictures


def test_the_verdict_has_the_numbers_of_the_fit_that_is_quoted():
    """An effect's size and chi2 were those of a trial, beside others of its simulation."""
    simulated = calibration({**MENDED, "surface_loss": estimate(0.0131, 0.0008)}, chi2=11.7)
    words = headline(diagnosis("missing_effect"), simulated)
    assert "surface loss = 0.0131 ± 0.0008" in words and "64.2 -> 11.7 (ndf 12" in words
    reason = "A and B may: chi2 = 12.1 for 11 degrees of freedom (p = 0.36) with the first; more"
    words = headline(diagnosis("ambiguous", reason=reason), simulated)
    assert words == "Ambiguous: A and B may; more"
    (row, _) = others_table(diagnosis("ambiguous"), simulated, (FIRST,)).rows
    assert row.cells[1].text == "7.52 ± 0.22"
    # and the yield beside the one to quote
    light = {"light_yield_ph_per_keV": estimate(7.61, 0.22)}
    for effects, best in ((FIRST,), "7.61 ± 0.22"), ((SECOND,), "7.52 ± 0.20"):
        words = averaged_yield(diagnosis("ambiguous"), calibration(light), effects)
        assert words.endswith(f"gives {best} with absorbing crystal surface (70 %)"), words


def test_a_mended_campaign_keeps_its_remark_and_the_yield_to_quote():
    """A remark was lost, and a diagnosis of the mended file called its own yield that to quote."""
    own = replace(read_campaign(SCENES / "camoo4_campaign.toml"), remark="kept in the dark")
    explained = diagnosis("ambiguous")
    assert "readings allow: the one to quote; the best" in averaged_yield(explained)

    def of(campaign):
        statistic = SimpleNamespace(model=SimpleNamespace(campaign=campaign))
        minimum = SimpleNamespace(statistic=statistic)
        return replace(explained, baseline=replace(explained.baseline, minimum=minimum))

    first = remarks_on(of(own), (FIRST,))
    words = first["remark"]
    assert words.startswith("kept in the dark; absorbing crystal surface was added by repair (the ")
    assert first[TO_QUOTE] == str(explained.light_yield_averaged)
    surer = replace(of(own), probabilities={FIRST: 0.9952})
    assert ", probability 99.5 %): what" in remarks_on(surer, (FIRST,))["remark"]
    # the averaged yield of the mended file takes for granted what was added
    once = replace(own, **first)
    assert once.remarks[0] == words and first[TO_QUOTE] in once.remarks[1]
    mended = of(once)
    assert "what repair added; the one to quote is 7.7 ± 0.9 ph/keV (" in averaged_yield(mended)
    second = remarks_on(mended, (SECOND,))
    assert second.keys() == {"remark"} and second["remark"].startswith(f"{words}; ")
    whole = remarks_on(of(replace(own, remark="a" * LONGEST_REMARK)), (FIRST,))["remark"]
    assert len(whole) == LONGEST_REMARK and whole.endswith(words.partition("; ")[2])


def test_files_are_inside_as_they_were_read(made, parsed):
    page, found = made
    links = {a.get("download"): a.get("href") for a in parsed.iter("a") if a.get("download")}
    for path, digest in found["files"].items():
        attached = base64.b64decode(links[Path(path).name].partition(",")[2])
        assert attached == (page.parent / Path(path).name).read_bytes()
        assert hashlib.sha256(attached).hexdigest() == digest
    # listings are folded, and not printed; tables are folded and printed
    assert not parsed.xpath("//pre[contains(., '<scene')][not(ancestor::details)]")
    assert {e.get("class") for e in parsed.iter("details")} == {"onscreen", "fold"}
    assert not parsed.xpath("//details[@class='fold']//pre | //details[@open]")


def test_what_was_mended_is_told_as_a_difference():
    one = changed("scene", "a.xml", "same\n" * 50 + "old\n", "b.xml", "same\n" * 50 + "new\n")
    assert one.text.splitlines() == [
        "--- a.xml",
        "+++ b.xml",
        "@@ -50,2 +50,2 @@",
        " same",
        "-old",
        "+new",
    ]
    assert one.data is not None and one.data.endswith(b"new\n") and one.role == "mended scene"


def test_files_too_large_for_a_mail_are_left_out(campaign_here, monkeypatch):
    monkeypatch.setattr(report_sections, "MOST_BYTES", 2000)
    known = {f.role: f for f in report_sections.sources_of(read_campaign(campaign_here))}
    assert known["scene"].data is None and known["scene"].text.startswith("<?xml")
    assert known["measurements"].data == Path("camoo4_measured.csv").read_bytes()


def test_first_comes_what_was_found(made, parsed):
    """Title, date, verdict, a picture and the yield, with the effect that was added and without."""
    first = parsed.get_element_by_id("summary")
    assert "camp<script>" in first.find("h1").text_content()
    made_on = datetime.fromisoformat(made[1]["made"]).strftime("%d %B %Y").lstrip("0")
    assert made_on in first.find("p").text_content()
    assert first.xpath(".//figure//img/@src")[0].startswith("data:image/png")
    without = first.xpath(".//*[@id='light-yield-without']")
    assert bool(without) == bool(made[1]["effects"])
    # of two errors it is said what they are
    scattering = first.get_element_by_id("result-alpha-scat").text_content()
    assert "(± statistical\xa0±\xa0systematic)" in scattering and scattering.count("±") == 4
    # the terminal has the number to quote too, not that of one fit alone
    to_quote = first.get_element_by_id("averaged-light-yield").text_content()
    printed = " ".join(made[0].with_suffix(".txt").read_text().split())
    assert to_quote.startswith("7.7\xa0±\xa00.9") and "Light yield: 7.7 ± 0.9 ph/keV" in printed


def test_the_page_is_quiet_in_a_browser_and_prints_on_few_pages(made, browser):
    browser.driver.get(made[0].as_uri())
    assert browser.run("return window.hacked === undefined && document.scripts.length === 0")
    assert browser.run("return [...document.images].every(i => i.complete && i.naturalWidth > 0)")
    for width in (1280, 390):
        browser.resize(width, 900)
        assert browser.run("return document.documentElement.scrollWidth") <= width
        browser.screenshot(f"report-{width}")
    browser.resize(1440, 900)
    # what is not folded is read in a few screens
    assert browser.run("return document.documentElement.scrollHeight") <= 8000
    assert browser.complaints() == []
    assert browser.requests() == [made[0].as_uri()]
    # it prints on few pages, without listings
    printed = base64.b64decode(
        browser.driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"]
    )
    assert 3 < len(re.findall(rb"/Type\s*/Page\b", printed)) <= 10
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    seen = "return [...document.querySelectorAll('{}')].filter(e => e.getClientRects().length)"
    assert browser.run(seen.format("details.onscreen")) == []
    assert len(browser.run(seen.format(".fold table"))) > 5


def test_only_pages_are_replaced(mcrim, campaign_here):
    Path("notes.html").write_text("not a page")
    Path("folder.html").mkdir()
    for path, words in (
        ("notes.html", "no HTML page"),
        ("folder.html", "names a folder"),
        ("report.pdf", "let the name end in .html"),
        ("camoo4_campaign.toml", "let the name end in .html"),
        ("no/report.html", "does not exist"),
        ("-", "let the name end in .html"),
    ):
        assert words in mcrim.refused("report", campaign_here, "-o", path)
    assert Path("notes.html").read_text() == "not a page"
    assert "no HTML page" in refusal(reporting.report, campaign_here, "notes.html")


def test_texts_are_made_harmless():
    assert visible("a\u202eb\x00\u200b\udc80\n") == "a<U+202E>b<U+0000><U+200B><U+DC80><U+000A>"
    assert said("<b>\u2066") == "<bdi>&lt;b&gt;&lt;U+2066&gt;</bdi>"
    assert said("x" * 200, 9) == "<bdi>xxxx…xxxx</bdi>"
    assert in_full("אב גד,1\n<") == "<bdi>אב גד</bdi>,1\n&lt;"


def test_errors_are_rounded_together():
    assert pdg_parts(7.8123, 0.15, 0.79) == "7.8 ± 0.2 ± 0.8"
    assert pdg_parts(7.8123, 0.02, 0.79) == "7.81 ± 0.02 ± 0.79"
    assert pdg_parts(0.039, 0.0, 0.012) == "0.039 ± 0 ± 0.012"
    assert pdg_parts(1.2e7, 2e5, 3e4) == "(1.200 ± 0.020 ± 0.003)e7"
    with pytest.raises(ValueError):
        pdg_parts(1.0, -1.0)


def test_a_report_does_without_a_picture_that_cannot_be_drawn():
    for code, trouble in (
        ("sys.exit('Mitsuba starts\\nthe scene has no shapes')", "the scene has no shapes"),
        ("sys.exit(1)", "the process that draws it ended"),
    ):
        process = subprocess.Popen(
            [sys.executable, "-c", f"import sys; {code}"], stdout=-1, stderr=-1
        )
        drawn = photograph.Photograph(process)
        assert (drawn.picture, drawn.trouble) == (None, trouble)


def test_the_bench_to_build_is_drawn_without_what_is_suspected(made, by_hand, monkeypatch):
    """Its gap had the bubble in it that was found in the one that stands."""
    page, found = made
    campaign = next(path for path in found["files"] if path.endswith(".toml"))
    monkeypatch.setenv("MCRIM_CACHE", str(page.parent / "cache"))
    tried = {name: by_hand.titles[name] for c in by_hand.candidates for name in c.effects}
    with quick_report(replace(by_hand, titles=tried)) as patch:
        drawn = []
        patch.setattr(report_sections, "_drawn", lambda scene, *_: drawn.append(scene))
        patch.setattr(reporting, "render", lambda _: "<html>")
        sections = reporting.report(campaign, page.with_name("bubble.html"), effects=[SECOND])
    assert "bubble_fraction" in dict(p[:2] for p in sections.bench.parameters)
    (to_build,) = drawn
    assert "bubble_fraction" not in to_build.parameters


@pytest.mark.parametrize("name", ["gap_buble", "1e5", "gel_creep + gap_bubble"])
def test_effects_that_are_none_are_refused_before_all_work(name, tmp_path, monkeypatch):
    """It was a KeyError, after the whole diagnosis."""
    monkeypatch.setattr(reporting, "repair", None)
    page = tmp_path / "report.html"
    campaign = SCENES / "camoo4_misfit.toml"
    assert name in refusal(public.report, campaign, page, effects=[SECOND, name])
    assert not page.exists()


def test_pictures_are_drawn_once(made, parsed, by_hand, monkeypatch):
    page, found = made
    campaign = next(path for path in found["files"] if path.endswith(".toml"))
    monkeypatch.setenv("MCRIM_CACHE", str(page.parent / "cache"))
    again = page.with_name("again.html")
    # it takes another time, and could draw nothing
    with quick_report(replace(by_hand, seconds=by_hand.seconds + 1.0)) as patch:
        patch.setattr(photograph, "begin_photograph", None)
        patch.setattr(report_sections, "_lights", None)
        reporting.report(campaign, again)
    pictures = [[e.get("src") for e in t.iter("img")] for t in (parsed, html.parse(again))]
    assert len(pictures[0]) > 8 and pictures[0] == pictures[1]
    # of other files there would be others
    contents = [file.read_bytes() for file in page.parent.glob("cache/*/*.chunk")]
    # each says of itself what it depends on, after its digest and the length of what it says
    headers = (c[40 : 40 + int.from_bytes(c[32:40], "little")] for c in contents)
    keys = [json.loads(header)["key"] for header in headers]
    (known,) = (key for key in keys if key["what"] == "pictures of a report")
    assert {digest for *_, digest in known["files"]} == set(found["files"].values())
    # and of other figures: this module imports all of them
    assert known["versions"]["modules"] == "mcrim_mitsuba.output.report"
