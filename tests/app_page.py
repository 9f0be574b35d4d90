"""`mcrim app` in a browser, as its user has it; for the tests of the page."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

from places import SCENES

#: With an effect; the bench as it is gets four times as many. All tests of the page take as many,
#: and share the records; by fewer, bevels may do as well as the bubble that is hidden.
PHOTONS = 49152
LONGEST_SIMULATION_S = 600
KEYS = {
    "tab": "\ue004",
    "enter": "\ue007",
    "left": "\ue012",
    "right": "\ue014",
    "end": "\ue010",
    "space": " ",
    "all": "\ue009a\ue000",
    "undo": "\ue009z\ue000",
    "redo": "\ue009\ue008z\ue000",
}

# Whether what has the focus can be seen: nothing lies above its middle, or its upper end.
IN_SIGHT = """
const one = document.activeElement, box = one.getBoundingClientRect();
const at = [box.left + box.width / 2, Math.max(box.top, 0) + Math.min(box.height, 40) / 2];
const there = document.elementFromPoint(...at);
return one !== document.body && (one.contains(there) || (there && there.contains(one)));
"""

# How many presses of Tab lead to an element, as far as the page's elements tell: what is scrolled
# takes a press of its own, and so does leaving the page; where nothing has the focus, one.
PRESSES = """
const at = document.activeElement;
if (at === document.body) { return 1; }
const isOther = e => e.type === 'radio' && !e.checked;  // the chosen one stands for all
const stops = [...document.querySelectorAll(
    'a[href], button, input, select, textarea, summary, [tabindex]')].filter(
    e => e.checkVisibility({visibilityProperty: true}) && e.tabIndex >= 0 && !e.disabled
        && !isOther(e));
const isAfter = e => at.compareDocumentPosition(e) & Node.DOCUMENT_POSITION_FOLLOWING;
const isWanted = e => e.matches(arguments[0]);
const after = stops.filter(isAfter);
const way = 1 + after.findIndex(isWanted) || 1 + after.length + stops.findIndex(isWanted);
return Math.max(way, 1);
"""


#: Lines of the misfit's table: eleven readings, which tell its effect apart as well as all.
ELEVEN = (2, 3, 4, 7, 8, 9, 11, 12, 15, 16, 17, 18)


def some_of_misfit(path: Path, lines: Sequence[int]) -> Path:
    """A file with these lines of the misfit's table of readings."""
    table = (SCENES / "camoo4_misfit.csv").read_text().splitlines()
    path.write_text("\n".join(table[i] for i in lines) + "\n")
    return path


def misfit(folder: Path, lines: Sequence[int], *, exact: bool = False) -> Path:
    """The misfit's campaign with readings of these lines of its table; an `exact` bench or not.

    Where all is diagnosed, numbers of the bench would take a third of the time.
    """
    text = (SCENES / "camoo4_misfit.toml").read_text()
    text = text.replace('scene = "camoo4.xml"', f"scene = '{SCENES / 'camoo4.xml'}'")
    some_of_misfit(folder / "few.csv", lines)
    path = folder / "bench.toml"
    tolerances = "\n[tolerances]\nnone = true\n" if exact else ""
    path.write_text(text.replace("camoo4_misfit.csv", "few.csv") + tolerances)
    return path


#: A page that tries seven effects, of which the misfit's explains it, and whose reports are without
#: a photograph; `mcrim diagnose` and `mcrim report` are tested with all of them.
QUICK = """
import sys
from types import SimpleNamespace
import numpy as np
from mcrim_mitsuba.cli.main import main
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.output import photograph, report_sections

tried = sys.argv.pop(1).split(",")
possible = CampaignSimulations.possible
CampaignSimulations.possible = lambda self: {n: possible(self)[n] for n in tried}
sheets = np.zeros((920, 1440, 3), np.uint8), np.zeros((472, 712, 3), np.uint8)
photograph.begin_photograph = lambda *_: SimpleNamespace(picture=sheets, trouble="")
report_sections.LIGHT_PHOTONS = 4000
sys.exit(main())
"""
TRIED = (
    "gap_bubble,edge_chamfer,surface_absorption,gap_absorption,detector_radius,background,"
    "nonlinearity"
)


class App:
    """The page of a campaign, open in a browser."""

    def __init__(self, browser, address: str, process: subprocess.Popen) -> None:
        self.browser, self.address, self.process = browser, address, process
        browser.driver.get(address)

    def settled(self) -> None:
        """Wait until nothing is simulated any more and everything is drawn."""
        self.browser.wait_for(self.is_idle, "end of the simulation", LONGEST_SIMULATION_S)

    def is_idle(self) -> bool:
        assert self.process.poll() is None, "mcrim app has ended"
        stop, status = self.browser.find("#stop"), self.browser.text("#status")
        quiet = status == "ready" and not stop.is_displayed()
        return quiet and not self.browser.all("body.stale") and self.browser.text("#chi2") != "…"

    def is_about(self, words: str) -> bool:
        return words in self.browser.text("header")

    @property
    def chi2(self) -> float:
        return float(self.browser.text("#chi2"))

    def upload(self, path) -> None:
        self.browser.find("#upload input[type=file]").send_keys(str(path))

    def take(self, path, readings: int) -> None:
        """Upload readings that are in order."""
        self.upload(path)
        self.browser.wait_for(lambda: self.is_about(f"({readings})"), f"{readings} readings")
        self.settled()

    def table(self) -> list[list[str]]:
        """The readings' rows, whether they are in sight or not: label, model, pull, eta."""
        return self.browser.run(
            "return [...document.querySelectorAll('#rows tbody tr')].map("
            "row => [row.querySelector('.name').value,"
            " ...[...row.querySelectorAll('.of-model')].map(cell => cell.textContent)])"
        )

    def control(self, kind: str, name: str):
        """A slider, number field or choice of a parameter, or an effect's box."""
        element = self.browser.run(
            "return document.getElementById(arguments[0])", f'{{"kind":"{kind}","name":"{name}"}}'
        )
        if kind == "effect":  # of a family that may be closed
            self.browser.run("arguments[0].closest('details').open = true", element)
            # a driver scrolls it below what sticks to the window's edge
            self.browser.run("arguments[0].scrollIntoView({block: 'center'})", element)
        return element.find_element("css selector", "input") if kind == "effect" else element

    def type(self, field, text: str) -> None:
        field.send_keys(KEYS["all"], text, KEYS["enter"])

    def tab_to(self, selector: str) -> None:
        """Press Tab until an element has the focus; it must be in sight then."""
        from selenium.webdriver import ActionChains

        has_focus = "return document.activeElement.matches(arguments[0])"
        left = 400
        while left > 0 and not self.browser.run(has_focus, selector):
            # many at once: to look after each of them takes longer than they do
            presses = min(self.browser.run(PRESSES, selector), left)
            ActionChains(self.browser.driver).send_keys(KEYS["tab"] * presses).perform()
            left -= presses
        assert self.browser.run(has_focus, selector), f"{selector} is not reached"
        assert self.browser.run(IN_SIGHT), f"{selector} is hidden"

    def press(self, *keys: str) -> None:
        """Press keys, wherever the focus is."""
        from selenium.webdriver import ActionChains

        ActionChains(self.browser.driver).send_keys(*keys).perform()

    def wrong(self, name: str) -> str:
        """What is said to be wrong with a parameter's field."""
        return self.browser.text(f'.control[data-name="{name}"] .wrong')

    def switch_on(self, effect: str) -> None:
        before = self.browser.text("#chi2")
        self.control("effect", effect).click()
        self.browser.wait_for(
            lambda: self.is_idle() and self.browser.text("#chi2") != before,
            f"model with {effect}",
            LONGEST_SIMULATION_S,
        )


@contextmanager
def running(campaign, cache, browser, photons=PHOTONS, *, settled=True, quick=False):
    """Start `mcrim app`, open what it prints, end it by Ctrl-C."""
    program = ["-c", QUICK, TRIED] if quick else ["-m", "mcrim_mitsuba"]
    words = ["app", str(campaign), "--no-browser", "--photons", str(photons)]
    process = subprocess.Popen(
        [sys.executable, *program, *words],
        text=True,
        stdout=-1,
        stderr=-1,
        env=os.environ | {"MCRIM_CACHE": str(cache)},
    )
    try:
        line = process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/\S+/", line)
        assert found, process.stderr.read()
        app = App(browser, found[0], process)
        if settled:
            app.settled()
        yield app
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=20)
            assert (process.returncode, err) == (0, "")
    finally:
        process.kill()
        process.communicate()
