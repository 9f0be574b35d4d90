"""`mcrim app` as its user has it: in a browser, from the first look to the mended scene."""

import csv
import json
import time
import zipfile

import pytest
from app_page import ELEVEN, KEYS, LONGEST_SIMULATION_S, misfit, running, some_of_misfit

from mcrim_mitsuba.cli.main import main

READINGS = "camoo4_misfit.csv"
COLUMNS = ("n_gap", "aperture_radius_mm", "crystal_height_mm", "gap_mm")


@pytest.fixture
def campaign(tmp_path):
    """The misfit's campaign with two readings: the others are uploaded."""
    return misfit(tmp_path, (0, 1, 2, 3, 7), exact=True)


def mcrim(path, *arguments) -> dict:
    """The result of a command, written to `path`; in this process, which knows Mitsuba."""
    assert main([*map(str, arguments), "--json", str(path)]) == 0
    return json.loads(path.read_text())


def width_of_page(browser) -> int:
    return browser.run("return document.documentElement.scrollWidth")


def test_from_readings_to_the_mended_scene(browser, campaign, shared_cache, tmp_path):
    uploaded = some_of_misfit(tmp_path / "measured.csv", ELEVEN)
    with running(campaign, shared_cache, browser, quick=True) as app:
        assert app.is_about("bench.toml") and app.is_about("few.csv (2)")
        assert [row[0] for row in app.table()] == ["air", "gel"]
        app.take(uploaded, 11)
        misfit = app.chi2
        # 91 by many photons
        assert 65 < misfit < 115
        browser.screenshot_whole("1 as it came")

        browser.click("#diagnose")
        browser.find("#stop:not([hidden])")
        seen = set()

        def diagnosed() -> bool:
            seen.add(browser.text("#status"))
            assert not browser.text("#error") and not browser.text("#slip")
            assert app.process.poll() is None, "mcrim app has ended"
            return bool(browser.all("#verdict"))

        browser.wait_for(diagnosed, "verdict", LONGEST_SIMULATION_S)
        assert len([words for words in seen if words.startswith("diagnosing")]) > 1, seen
        assert "Air bubble in the gap explains" in browser.text("#verdict")
        app.settled()
        browser.screenshot_whole("2 diagnosed")

        leading = browser.find("#diagnosis button.main")
        assert leading.get_attribute("aria-label") == "add air bubble in the gap and fit"
        browser.click("#diagnosis button.main")
        browser.wait_for(
            lambda: "The last fit, with air bubble in the gap" in browser.text("#fitted"),
            "fit",
            LONGEST_SIMULATION_S,
        )
        app.settled()
        browser.wait_for(lambda: app.chi2 < 25, "fall of chi2")
        assert app.control("effect", "gap_bubble").is_selected()
        assert 0.2 < float(app.control("number", "bubble_fraction").get_property("value")) < 0.4
        browser.click("#fit")
        time.sleep(1)  # it may be over before anybody sees that it runs
        app.settled()
        assert app.chi2 < 25
        browser.click("#table-details summary")
        browser.screenshot_whole("3 mended")

        # the downloaded scene is what the page shows
        browser.click("#get-scene")
        scene = browser.downloaded(".xml", LONGEST_SIMULATION_S)
        app.settled()
        assert "bubble" in scene.read_text()
        rows = {row[0]: row for row in app.table()}
        with uploaded.open(encoding="utf-8") as lines:
            readings = list(csv.DictReader(lines))
        # half a per cent each, of the page as of these: an eta that is off by 3 % is seen
        z = []
        for reading in readings[::2]:
            given = [f"-D{name}={reading[name]}" for name in COLUMNS]
            found = mcrim(tmp_path / "eta.json", "simulate", scene, *given, "--photons=5e5")
            shown, error = map(float, rows[reading["label"]][-1].split(" ± "))
            z.append((found["eta"] - shown) / (found["eta_sigma"] ** 2 + error**2) ** 0.5)
        assert len(z) == 6 and max(map(abs, z)) < 3.5, z

        browser.click("#get-campaign")
        with zipfile.ZipFile(browser.downloaded(".zip", LONGEST_SIMULATION_S)) as packed:
            packed.extractall(tmp_path / "mended")
        app.settled()
        [mended] = (tmp_path / "mended").rglob("*.toml")
        fitted = mcrim(tmp_path / "fit.json", "calibrate", mended, "--photons=32768")
        assert fitted["chi2"] < 25

        browser.click("#get-report")
        report = browser.downloaded(".html", LONGEST_SIMULATION_S).read_text()
        app.settled()
        assert "gap_bubble" in report and "gel hole 4" in report

        browser.driver.refresh()  # another look at the same session
        app.settled()
        assert app.control("effect", "gap_bubble").is_selected() and app.chi2 < 25
        browser.resize(390, 844)
        browser.click("#table-details summary")
        time.sleep(1)
        browser.screenshot_whole("4 narrow")
        assert width_of_page(browser) <= 390
        assert browser.complaints() == []
        assert all(asked.startswith(app.address) for asked in browser.requests())


# Whether an element, or what is closely around it, shows that it has the focus.
OUTLINED = """
const one = arguments[0];
return [one, one.parentElement, one.parentElement.parentElement].some(
    each => getComputedStyle(each).outlineStyle !== 'none');
"""


def test_without_a_mouse(browser, campaign, shared_cache):
    from selenium.webdriver import ActionChains

    with running(campaign, shared_cache, browser) as app:
        focus = "const e = document.activeElement; return e === document.body ? null : e"
        reached = []
        browser.driver.execute_cdp_cmd("Page.enable", {})
        while True:
            ActionChains(browser.driver).send_keys(KEYS["tab"]).perform()
            element = browser.run(focus)
            if element is None or element in reached:
                break
            assert browser.run(OUTLINED, element), element.get_attribute("outerHTML")
            reached.append(element)
        wanted = browser.run(
            "return [...document.querySelectorAll('button, input, select, summary')].filter("
            "e => e.checkVisibility() && e.tabIndex >= 0 && !e.disabled)"
        )
        missed = [e.get_attribute("outerHTML") for e in wanted if e not in reached]
        assert missed == [] and len(reached) > 30

        before = browser.text("#chi2")
        app.control("slider", "alpha_abs_per_cm").send_keys(KEYS["right"] * 5)
        browser.wait_for(lambda: browser.text("#chi2") != before, "chi2 after the slider")
        number = app.control("number", "alpha_abs_per_cm")
        app.type(number, "0.03")
        moved = app.control("slider", "alpha_abs_per_cm")
        browser.wait_for(lambda: moved.get_property("value") != "", "slider")
        assert float(number.get_property("value")) == 0.03
        before = browser.wait_for(lambda: app.is_idle() and browser.text("#chi2"), "chi2")
        app.control("effect", "background").send_keys(KEYS["space"])
        size = app.control("number", "background")
        app.settled()
        app.type(size, "1.5")
        browser.wait_for(lambda: browser.text("#chi2") != before, "chi2 with a background")
        app.control("effect", "background").send_keys(KEYS["space"])
        browser.find("#fit").send_keys(KEYS["enter"])
        browser.wait_for(
            lambda: not app.control("number", "background").is_displayed(), "the background's end"
        )
        browser.find("#table-details summary").send_keys(KEYS["enter"])
        browser.wait_for(lambda: browser.find("#rows .name").is_displayed(), "table")
        app.settled()
        browser.find("#diagnose").send_keys(KEYS["enter"])
        browser.wait_for(lambda: "Too few readings" in browser.text("#diagnosis"), "verdict", 60)
        # Enter asks for a file
        browser.driver.execute_cdp_cmd("Page.setInterceptFileChooserDialog", {"enabled": True})
        browser.driver.get_log("performance")
        browser.find("#upload-button").send_keys(KEYS["enter"])
        browser.wait_for(
            lambda: any(
                "fileChooserOpened" in e["message"] for e in browser.driver.get_log("performance")
            ),
            "file dialogue",
        )
        browser.screenshot_whole("5 keyboard")
        assert browser.complaints() == []


HOSTILE = [
    "<img src=x onerror=window.hit=1>",
    "<script>window.hit = 1</script>",
    "<b>bold</b> &amp; <a href='javascript:window.hit=1'>link</a>",
    "$x^2$ [red]%{y}[/] \\frac",
    "\u202eevil\u202c and الضوء",
    "a label that goes on " * 12,
]


def test_texts_of_the_user_are_text(browser, campaign, shared_cache, tmp_path):
    other = tmp_path / "<img src=x onerror=window.hit=2>.csv"
    with other.open("w", newline="", encoding="utf-8") as file:
        written = csv.writer(file)
        written.writerow(["label", "signal", "sigma", "aperture_radius_mm"])
        for number, label in enumerate(HOSTILE):
            written.writerow([label, 12.9 - 0.2 * number, 0.1, 14 - number])
    with running(campaign, shared_cache, browser) as app:
        app.take(other, len(HOSTILE))
        assert app.is_about("onerror")  # file names are made harmless
        assert [row[0] for row in app.table()] == [label.strip() for label in HOSTILE]
        ticks = browser.run(
            "return [...document.querySelectorAll('#readings-chart .label')].map("
            "e => [e.textContent, e.querySelectorAll('a, b, image, [style*=bold]').length])"
        )
        assert len(ticks) == len(HOSTILE) and all(found == 0 for _, found in ticks)
        for (shown, _), label in zip(ticks, HOSTILE, strict=True):
            start = shown.split("…")[0].replace("<U+202E>", "\u202e")  # it would turn texts round
            assert start and label.startswith(start), (shown, label)
        browser.find("#readings-chart").send_keys(KEYS["right"] * 2)
        browser.wait_for(lambda: "<b>bold</b>" in browser.text("#reading h3"), "third reading")
        assert not browser.all("#reading h3 b")
        browser.resize(390, 844)
        time.sleep(1)
        browser.screenshot_whole("6 hostile labels")
        assert width_of_page(browser) <= 390
        assert browser.run("return window.hit") is None
        assert browser.complaints() == []


REFUSED = {
    "line 3": b"label,signal,sigma,n_gap\nair,14.3,0.2,1.00\ngel,much,0.4,1.46\n",
    "line 4": b"# mine\nlabel,signal,sigma,n_gap\nair,14.3,0.2,1.00\ngel,24,-1,1.46\n",
    "n_gapp": b"label,signal,sigma,n_gapp\nair,14.3,0.2,1.00\ngel,12,0.4,1.46\n",
    "empty": b"",
    "UTF-8": b"\xff\xfe\x00PNG\x00",
    "larger than 7 MB": b"x" * 8_000_000,
}


def test_readings_that_cannot_be_used(browser, campaign, shared_cache, scenes, tmp_path):
    with running(campaign, shared_cache, browser) as app:
        for number, (said, content) in enumerate(REFUSED.items()):
            bad = tmp_path / f"mine{number}.csv"
            bad.write_bytes(content)
            app.upload(bad)
            browser.wait_for(lambda name=bad.name: name in browser.text("#slip"), "refusal")
            line = browser.text("#slip")
            assert said in line and "\n" not in line and str(tmp_path) not in line, line
            # and the page goes on with what it had
            app.settled()
            assert app.is_about("few.csv (2)")
        time.sleep(5)  # longer than the page's clock: the refusal stays until it is mended
        assert browser.text("#slip") == line
        browser.screenshot("7 refused")
        app.take(scenes / READINGS, 16)
        assert not browser.text("#slip") and browser.complaints() == []
