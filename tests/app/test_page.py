"""What goes on in the page: jobs, what is typed, and what is said of both."""

import itertools
import json
import signal
import time

import pytest
from app_page import ELEVEN, KEYS, LONGEST_SIMULATION_S, misfit, running, some_of_misfit

from mcrim_mitsuba.app.bench_picture import bench_words
from mcrim_mitsuba.campaign.measurements import Reading

MANY_PHOTONS = 524_288


@pytest.fixture
def campaign(tmp_path):
    """The misfit's campaign with four readings."""
    return misfit(tmp_path, (2, 3, 7, 15, 18), exact=True)


def test_a_reading_tells_its_treatment_and_line():
    row = Reading("bare", 1.0, 0.1, {"source_z_mm": 5.0}, without=("top", "sides"), energy_keV=511)
    assert bench_words(row, {"gap_mm": 0.05}, ("source_z_mm",)) == [
        ("without", "top, sides"),
        ("line", "511 keV"),
        ("source z", "5 mm"),
        ("gap", "0.05 mm"),
    ]


def test_jobs_wait_and_stop(browser, campaign, scenes):
    # with so many photons that the bench is not simulated before the page is there, when nothing
    # would be left to be stopped: some seconds of all processors; in five mountings, of one number
    lines = (scenes / "camoo4_misfit.csv").read_text().splitlines()
    rows = [lines[i] for i in (2, 3, 5, 7, 9, 15)]
    (campaign.parent / "few.csv").write_text("\n".join(rows) + "\n")
    with campaign.open("a") as file:
        file.write("n_crystal = 0.01\n")
    with running(campaign, "off", browser, MANY_PHOTONS, settled=False) as app:
        status = lambda: browser.text("#status")  # noqa: E731
        browser.wait_for(lambda: status().startswith("simulating the bench"), "simulation")
        browser.click("#stop")
        browser.wait_for(lambda: status() == "ready", "end of the job")
        assert (
            browser.text("#stopped") == "simulating the bench: stopped; what was simulated is kept"
        )
        assert browser.text("#chi2-words") == "nothing is simulated yet: press Fit"

        # whatever is asked for next simulates what it needs
        browser.click("#fit")
        browser.wait_for(lambda: status().startswith("fitting"), "fit")
        assert not browser.text("#error") and browser.text("#chi2-words") == "being simulated"
        # what is asked for meanwhile waits; all of it stays in sight; an index is simulated at two
        # values, a bubble at seven
        for effect in ("wrong:n_crystal", "edge_chamfer", "background"):
            app.control("effect", effect).click()
        browser.wait_for(
            lambda: "; then fitting with wrong crystal index and 2 more" in status(), "queue"
        )
        fit, box = browser.find("#fit"), app.control("effect", "edge_chamfer")
        assert fit.text == "Stop" and fit.get_attribute("aria-label") == "Stop: Fit"
        browser.screenshot("jobs wait")
        browser.run("window.scrollTo(0, document.documentElement.scrollHeight)")
        top = browser.run("return document.querySelector('#bar').getBoundingClientRect().top")
        assert top == 0 and browser.find("#stop").is_displayed()
        browser.run("window.scrollTo(0, 0)")
        # one that waits is taken back by its own button
        browser.click('[data-key="effect edge_chamfer"]')
        browser.wait_for(lambda: not box.is_selected(), "switch")
        browser.wait_for(app.is_idle, "all of them", LONGEST_SIMULATION_S)
        assert not browser.text("#error") and not browser.text("#pending")
        rest = [
            app.control("effect", name).is_selected() for name in ("wrong:n_crystal", "background")
        ]
        assert rest == [True, True] and "as it came" in browser.text("#fitted")
        assert fit.text == "Fit" and browser.complaints() == []

        # what was stopped is off again, and its numbers are not said to be the model's
        app.control("effect", "edge_chamfer").click()
        words = browser.wait_for(lambda: browser.text("#pending"), "words")
        assert "without bevel of the edges" in words and browser.all("body.stale")
        browser.click('[data-key="effect edge_chamfer"]')
        browser.wait_for(lambda: not box.is_selected() and app.is_idle(), "switch", 30)
        # as they wished: no error
        assert "bevel of the edges: stopped" in browser.text("#stopped")
        assert not browser.text("#error")


#: The next question for predictions gets no answer.
ONE_IS_LOST = """
const real = window.fetch;
window.lost = 0;
window.fetch = function (address, options) {
    if (address === "predictions" && !window.lost) {
        window.lost += 1;
        return Promise.reject(new Error("too late"));
    }
    return real(address, options);
};
"""


def test_another_page_and_a_lost_connection_are_told_of(browser, campaign, shared_cache):
    with running(campaign, shared_cache, browser) as app:
        first, typing = browser.driver.current_window_handle, []
        browser.driver.switch_to.new_window("tab")
        browser.driver.get(app.address)
        app.settled()
        browser.run(ONE_IS_LOST)  # it stayed grey for good
        app.type(app.control("number", "alpha_abs_per_cm"), "0.03")
        browser.wait_for(lambda: "by hand" in browser.text("#answer"), "another model")
        app.settled()
        assert browser.run("return window.lost") == 1
        typing.append(app.control("number", "alpha_scat_per_cm"))
        typing[0].send_keys(KEYS["all"], "0.9")
        second = browser.driver.current_window_handle
        browser.driver.switch_to.window(first)
        browser.click("#fit")
        browser.wait_for(lambda: browser.text("#changed").startswith("Fit: χ²"), "the fit")
        browser.click("#get-session")
        browser.downloaded("_session.json")
        app.settled()
        browser.driver.switch_to.window(second)
        browser.wait_for(lambda: "Another page" in browser.text("#changed"), "its words")
        words = browser.text("#changed")
        assert "it moved absorption, 0.03 here: Undo leads back to it" in words
        assert typing[0].get_property("value") == "0.9"
        time.sleep(2)  # longer than the page's clock
        assert len(list(browser.downloads.iterdir())) == 1
        # a page of a mcrim that was started again is grey, as one is whose mcrim was ended
        browser.run("history.replaceState(null, '', '/another-key/')")
        browser.wait_for(lambda: "was ended or started again" in browser.text("#lost"), "words")
        browser.driver.switch_to.window(first)

        app.process.send_signal(signal.SIGKILL)
        browser.wait_for(lambda: browser.text("#lost"), "words", 10)
        assert "connection to mcrim is lost" in browser.text("#lost")
        assert browser.text("#status") == "not connected"
        assert browser.run("return document.querySelector('main').inert")
        opacity = "return Number(getComputedStyle(document.querySelector(arguments[0])).opacity)"
        for place in ("main", "#figures-of-merit"):
            browser.wait_for(lambda at=place: browser.run(opacity, at) < 0.5, f"grey {place}")
        browser.screenshot("connection lost")


TYPED = {
    "500": "500 is out of range: give a value from 0.05 to 5 1/cm",
    "-1": "-1 is out of range: give a value from 0.05 to 5 1/cm",
    "1,234": "1,234 can be read in two ways: write 1234 or 1.2340",
    "1.000,5": "1.000,5 is not a number: write for example 0.3",
    "much": "much is not a number: write for example 0.3",
    "": "the field is empty: write for example 0.3",
}


def test_what_is_typed_is_what_is_meant(browser, campaign, shared_cache):
    with running(campaign, shared_cache, browser) as app:
        name = "alpha_scat_per_cm"
        field, slider = app.control("number", name), app.control("slider", name)
        before = browser.text("#chi2")
        for text, said in TYPED.items():
            field.clear()
            app.type(field, text)
            browser.wait_for(lambda words=said: app.wrong(name) == words, said)
            # what is shown belongs to another value, and says so
            assert browser.all("body.stale") and "other values" in browser.text("#pending")
        browser.screenshot("typed wrongly")
        browser.click("#fit")
        browser.wait_for(lambda: "mend it first" in browser.text("#slip"), "refusal")
        for text, value in {"0,3": 0.3, ".7": 0.7, "7e-1": 0.7, " 2 ": 2}.items():
            app.type(field, text)
            browser.wait_for(app.is_idle, text)
            assert (app.wrong(name), float(field.get_property("value"))) == ("", value)
        assert browser.text("#chi2") != before
        assert 600 < int(slider.get_property("value")) < 900

        # a prior is one when both of its numbers are there
        choice = app.control("known", name)
        choice.send_keys("prior")
        words = "the prior needs a value; the prior needs an error"
        browser.wait_for(lambda: app.wrong(name) == words, words)
        assert browser.all("body.stale")
        freedom = browser.text("#chi2-words")
        for column, text in (("prior", "0,4"), ("prior_sigma", "0"), ("prior_sigma", "0.1")):
            app.type(browser.find(f'[data-name="{name}"] [data-of={column}]'), text)
            if text == "0":
                browser.wait_for(lambda: "above 0" in app.wrong(name), "refusal")
        browser.wait_for(lambda: app.is_idle() and browser.text("#chi2-words") != freedom, "ndf")
        choice.send_keys("free")
        browser.wait_for(lambda: app.is_idle() and browser.text("#chi2-words") == freedom, "ndf")

        # the scale that is shown is the one that counts
        scale, follows = app.control("number", "scale"), browser.find("#fit-scale input")
        before = float(scale.get_property("value"))
        app.type(field, "0.3")
        browser.wait_for(lambda: float(scale.get_property("value")) != before, "scale that follows")
        app.settled()
        followed, chi2 = browser.text("#light-yield"), app.chi2
        app.type(scale, "80")
        browser.wait_for(lambda: app.is_idle() and app.chi2 > chi2, "chi2 at another scale")
        assert not follows.is_selected() and browser.text("#light-yield") != followed
        assert browser.text("#light-yield-words") == "moved by hand: press Fit"
        follows.click()
        browser.wait_for(lambda: app.is_idle() and app.chi2 == chi2, "chi2 at the best scale")
        assert float(scale.get_property("value")) < 80
        browser.find("#fit").send_keys(KEYS["enter"])
        browser.wait_for(lambda: "±" in browser.text("#light-yield"), "the fit's error")
        assert browser.text("#light-yield-words") == "whole error of the fit"
        assert browser.text("#light-yield").endswith(" ph/keV")
        assert browser.complaints() == []


# All at once: a chart may be drawn anew between two questions.
TEXTS = """
return [...document.querySelectorAll(arguments[0])].map(function (e) {
    const box = e.getBoundingClientRect();
    return [e.textContent, box.x, box.y];
});
"""


def test_each_error_and_each_axis_says_what_it_is(browser, campaign, shared_cache):
    with running(campaign, shared_cache, browser) as app:
        assert not browser.find("#falling-chart").is_displayed()  # one fit would be a dot
        app.switch_on("gap_bubble")
        browser.click("#fit")
        browser.wait_for(lambda: "with air bubble in the gap" in browser.text("#fitted"), "fit")
        app.settled()
        assert "whole error" in browser.text("#fitted")
        assert browser.run(DANGLING) == []
        # from the page's head: a link to the answer, what takes back, and what is asked next
        for keys in ("tab", "tab"), ("enter", "tab"):
            browser.run("document.querySelector('.skip').focus()")
            assert (
                browser.run("return document.querySelector('a, button, input').className") == "skip"
            )
            app.press(*(KEYS[key] for key in keys))
            assert browser.run("return document.activeElement.id") == "diagnose"
        # dark where the user wants it
        dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
        browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
        colour = "return getComputedStyle(document.querySelector(arguments[0])).backgroundColor"
        assert [browser.run(colour, at) for at in ("body", "#model")] == [
            "rgb(21, 23, 26)",
            "rgb(30, 33, 37)",
        ]
        browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
        drawn = browser.run(TEXTS, "#falling-chart .tick")
        ticks = [float(text) for text, _, _ in drawn]
        rising = [b > a for a, b in itertools.pairwise(ticks)]
        higher = [b < a for (_, _, a), (_, _, b) in itertools.pairwise(drawn)]
        assert len(ticks) > 2 and all(rising) and all(higher), ticks
        time.sleep(0.5)
        browser.screenshot_whole("errors and axes")


def test_the_kind_of_a_reading_is_chosen(browser, shared_cache, scenes):
    with running(scenes / "camoo4_three.toml", shared_cache, browser) as app:
        browser.click("#table-details summary")
        kinds = browser.all("#rows select")
        assert [one.get_property("value") for one in kinds] == ["light", "light", "transmittance"]
        light, beam = kinds[0].find_elements("css selector", "option")
        beam.click()
        beside = "#rows tr:first-child td:has(select) .wrong"
        said = browser.wait_for(lambda: browser.text(beside), "refusal")
        assert said.startswith("signal = 14.3 of a transmittance") and browser.all("body.stale")
        browser.screenshot("kind refused")
        light.click()
        browser.wait_for(lambda: not browser.text(beside) and app.is_idle(), "what was before")
        app.type(browser.find("#rows [data-column=signal]"), "0.7")
        browser.wait_for(app.is_idle, "the signal")
        browser.click("#rows option:last-child")
        gap = lambda: browser.find("#rows [data-column=n_gap]").get_property("value")  # noqa: E731
        browser.wait_for(lambda: gap() == "" and app.is_idle(), "beam", LONGEST_SIMULATION_S)
        assert app.table()[0][1].endswith("%") and browser.complaints() == []


# References to elements that are not there; fields that say nothing of what is wrong with them.
DANGLING = """
const refers = ["aria-controls", "aria-labelledby", "aria-describedby", "for"];
const ids = refers.flatMap((name) => [...document.querySelectorAll(`[${name}]`)].flatMap(
    (one) => one.getAttribute(name).split(/\\s+/)));
return ids.filter((id) => !document.getElementById(id));
"""


# Numbers whose errors stand on the next line.
SPLIT = """
const split = [];
for (const one of document.querySelectorAll("#diagnosis *, #fitted *, .merits *")) {
  for (const node of one.childNodes) {
    if (node.nodeType !== Node.TEXT_NODE) { continue; }
    for (const found of node.data.matchAll(/\\S+\\s±\\s\\S+/g)) {
      const range = document.createRange();
      range.setStart(node, found.index);
      range.setEnd(node, found.index + found[0].length);
      const lines = new Set([...range.getClientRects()].map((box) => Math.round(box.top)));
      if (lines.size > 1) { split.push(found[0]); }
    }
  }
}
return split;
"""


def choose(browser, path) -> None:
    """Choose a file in the dialogue that a key has opened."""
    opened = []

    def is_open() -> bool:
        log = [json.loads(e["message"])["message"] for e in browser.driver.get_log("performance")]
        opened.extend(e["params"] for e in log if e["method"] == "Page.fileChooserOpened")
        return bool(opened)

    browser.wait_for(is_open, "file dialogue")
    node = opened[-1]["backendNodeId"]
    files = {"files": [str(path)], "backendNodeId": node}
    browser.driver.execute_cdp_cmd("DOM.setFileInputFiles", files)


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
def test_from_a_file_to_the_averaged_yield_by_keyboard(browser, tmp_path, shared_cache, size):
    campaign = misfit(tmp_path, (2, 3, 7, 15, 18), exact=True)
    browser.resize(*size)
    wide = f"keyboard {size[0]}"
    with running(campaign, shared_cache, browser, quick=True) as app:
        browser.driver.execute_cdp_cmd("Page.enable", {})
        browser.driver.execute_cdp_cmd("Page.setInterceptFileChooserDialog", {"enabled": True})
        app.tab_to("#upload-button")
        browser.driver.get_log("performance")
        app.press(KEYS["enter"])
        choose(browser, some_of_misfit(tmp_path / "measured.csv", ELEVEN))
        browser.wait_for(lambda: app.is_about("(11)"), "readings")
        app.settled()
        browser.screenshot(f"{wide} 1 readings")
        app.tab_to("#diagnose")
        app.press(KEYS["enter"])
        browser.wait_for(lambda: browser.text("#diagnose") == "Stop", "button that stops")
        browser.screenshot(f"{wide} 2 diagnosing")
        browser.wait_for(lambda: browser.all("#verdict"), "verdict", LONGEST_SIMULATION_S)
        app.settled()
        averaged = browser.find("#averaged").get_property("textContent")
        app.tab_to("#weighed summary")
        app.press(KEYS["enter"])
        assert f"Light yield: {averaged}" in browser.text("#averaged-text")
        ranked = browser.text("#diagnosis .ranking")
        assert "something that is in no catalogue" in ranked.lower()
        assert browser.run(
            "const one = document.querySelector('.ranking').parentNode;"
            "return one.scrollWidth <= one.clientWidth"
        )
        browser.screenshot(f"{wide} 3 averaged")
        browser.run("document.querySelector('.ranking').scrollIntoView({block: 'end'})")
        browser.screenshot(f"{wide} 3 ranking")

        # and on to the effect that is missing
        app.tab_to("#diagnosis button.main")
        app.press(KEYS["enter"])
        browser.wait_for(
            lambda: "with air bubble in the gap" in browser.text("#fitted"),
            "fit",
            LONGEST_SIMULATION_S,
        )
        app.settled()
        assert app.chi2 < 25 and app.control("effect", "gap_bubble").is_selected()
        assert " ± " in browser.text("#diagnosis td:nth-child(4)") and browser.run(SPLIT) == []
        app.tab_to("[data-do=remove]")
        browser.screenshot(f"{wide} 4 fits")
        app.press(KEYS["enter"])
        browser.wait_for(
            lambda: "with air bubble in the gap" not in browser.text("#fitted"), "removal"
        )
        app.tab_to("#undo")
        app.press(KEYS["enter"])
        browser.wait_for(
            lambda: "with air bubble in the gap" in browser.text("#fitted"), "what was removed"
        )
        for keys, there in (("redo", False), ("undo", True)):
            browser.driver.switch_to.active_element.send_keys(KEYS[keys])
            browser.wait_for(
                lambda is_=there: ("with air bubble" in browser.text("#fitted")) == is_, keys
            )

        # the reading under the pointer, without a pointer
        app.tab_to("#readings-chart")
        app.press(KEYS["end"])
        browser.wait_for(lambda: browser.text("#reading h3") == "gel hole 4", "reading")
        told = browser.text("#reading").split("\n")
        assert {"1.46, filled", "4 mm", "10 mm", "0.05 mm"} <= set(told), told
        assert len(browser.all("#reading rect.mask")) == 2
        browser.screenshot(f"{wide} 5 reading")
        app.press(KEYS["left"])
        browser.wait_for(lambda: browser.text("#reading h3") == "air hole 4", "its neighbour")

        # readings are changed in the table
        app.tab_to("#table-details summary")
        app.press(KEYS["enter"])
        freedom = browser.find("#chi2-words").get_property("textContent")
        app.tab_to("#rows [data-column=use]")
        app.press(KEYS["space"])
        browser.wait_for(
            lambda: browser.find("#chi2-words").get_property("textContent") != freedom, "ndf"
        )
        assert len(browser.all("tr.unused")) == 1 and not browser.text("#averaged")
        for column, wrong, said, right in (
            ("sigma", "-1", "sigma = -1 is not above 0", "0,2"),
            ("n_gap", "0.5", "n_gap = 0.5: this is no refractive index", "1,1"),
        ):
            app.tab_to(f"#rows [data-column={column}]")
            app.type(browser.driver.switch_to.active_element, wrong)
            beside = f"td:has([data-column={column}]) .wrong"
            browser.wait_for(lambda at=beside, it=said: it in browser.text(at), said)
            assert browser.all("body.stale")
            if column == "n_gap":
                browser.screenshot(f"{wide} 6 cell")
            app.type(browser.driver.switch_to.active_element, right)
            browser.wait_for(lambda at=beside: not browser.text(at), right)
            app.settled()
        eta = app.table()[0][-1]
        app.tab_to("#rows tr:first-child [data-do=copy]")
        app.press(KEYS["enter"])
        browser.wait_for(lambda: app.is_about("(12)"), "copy")
        app.settled()
        assert app.table()[11] == ["air (2)", *app.table()[0][1:]]
        app.press("new", KEYS["enter"])  # in the field of its name, all of which is chosen
        browser.wait_for(lambda: app.table()[11][0] == "new", "name")
        app.tab_to("#rows tr:last-child [data-do=drop]")
        app.press(KEYS["enter"])
        browser.wait_for(lambda: app.is_about("(11)"), "removal")
        for readings in (12, 12, 11, 11):  # removed, named, added, of another index
            app.tab_to("#undo")
            app.press(KEYS["enter"])
            browser.wait_for(lambda n=readings: app.is_about(f"({n})"), "undone")
            app.settled()
        browser.wait_for(lambda: app.is_idle() and app.table()[0][-1] != eta, "former index", 60)
        browser.screenshot(f"{wide} 6 table")

        # what is known of a parameter, and what it is
        app.tab_to(".control[data-name=alpha_scat_per_cm] .help")
        app.press(KEYS["enter"])
        assert "scattering coefficient" in browser.text("#meaning-alpha_scat_per_cm")
        app.tab_to(".control[data-name=alpha_scat_per_cm] select")
        freedom = browser.find("#chi2-words").get_property("textContent")
        app.press("held")
        browser.wait_for(
            lambda: browser.find("#chi2-words").get_property("textContent") != freedom, "ndf"
        )
        app.tab_to("#fit")
        app.press(KEYS["enter"])
        browser.wait_for(lambda: "held: scattering (1/cm)" in browser.text("#fitted"), "fit")
        app.settled()
        if size[0] == 390:  # the numbers that a slider moves are in sight beside it
            app.tab_to(".control[data-name=alpha_abs_per_cm] input[type=range]")
            bar = browser.run("return document.querySelector('#bar').getBoundingClientRect().top")
            assert bar == 0 and browser.find("#chi2").is_displayed()
            slider, field = (app.control(k, "alpha_abs_per_cm") for k in ("slider", "number"))
            assert abs(slider.rect["y"] - field.rect["y"]) < 20
            assert field.rect["x"] > slider.rect["x"] + 150
            browser.screenshot(f"{wide} 7 sliders")
        assert browser.run("return document.documentElement.scrollWidth") <= size[0]
        browser.screenshot_whole(f"{wide} 8 all")
        assert browser.complaints() == []


def test_small_signals_stand_whole_beside_their_axis(browser, campaign, shared_cache, scenes):
    lines = (scenes / "camoo4_misfit.csv").read_text().splitlines()
    cells = [lines[line].split(",") for line in (3, 4, 8, 16)]
    small = [[row[0], row[1] + "e-6", row[2] + "e-6", *row[3:]] for row in cells]
    table = campaign.parent / "few.csv"
    table.write_text("\n".join([lines[2], *map(",".join, small)]) + "\n")
    with running(campaign, shared_cache, browser):
        ticks = browser.run(TEXTS, "#readings-chart .tick")
        title = browser.find("#readings-chart .title").rect
        assert "1e\u22125" in [text for text, _, _ in ticks], ticks
        assert min(x for _, x, _ in ticks) > title["x"] + title["width"], ticks


def test_many_readings_are_told_apart(browser, campaign, shared_cache, scenes):
    lines = (scenes / "camoo4_misfit.csv").read_text().splitlines()
    rows = [lines[3 + place % 16].split(",", 1) for place in range(300)]
    many = [f"{label} no {place},{rest}" for place, (label, rest) in enumerate(rows)]
    (campaign.parent / "few.csv").write_text("\n".join([lines[2], *many]) + "\n")
    with running(campaign, shared_cache, browser) as app:
        assert app.is_about("(300)")
        chart = browser.find("#readings-chart")
        chart.send_keys(KEYS["end"])
        browser.wait_for(lambda: "no 299" in browser.text("#reading h3"), "last reading")
        boxes = browser.run(
            "return [...document.querySelectorAll('#readings-chart .label')].map("
            "e => e.getBoundingClientRect().right)"
        )
        apart = min(b - a for a, b in itertools.pairwise(boxes))
        assert apart > 12 and 100 < len(boxes) < 300  # labels do not run into each other
        mark = browser.find("#readings-chart .mark").rect
        assert mark["width"] > 8  # nor do readings
        area = chart.rect
        assert area["x"] + 70 < mark["x"] < area["x"] + area["width"]  # it was scrolled into sight
        heap = browser.run("return performance.memory.usedJSHeapSize") / 1e6
        assert heap < 100, heap
        browser.screenshot("many readings")
        browser.resize(390, 844)
        time.sleep(0.5)
        browser.run("document.querySelector('#model').scrollIntoView()")
        browser.screenshot("many readings 390")
        assert browser.run("return document.documentElement.scrollWidth") <= 390
        assert browser.complaints() == []
