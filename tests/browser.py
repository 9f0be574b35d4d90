"""Drives Chromium: what a user sees, what the page complains of, what it asks the network for."""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

SCREENSHOTS = "MCRIM_SCREENSHOTS"
"""Environment variable with the folder for `Browser.screenshot`; without it none are kept."""

LONGEST_WAIT_S = 60
#: Root has no sandbox.
_FLAGS = (
    "--headless --no-sandbox --disable-dev-shm-usage --disable-gpu --disable-quic "
    "--no-first-run --no-proxy-server --disable-background-networking --disable-component-update "
    "--disable-sync --disable-features=HttpsUpgrades"
).split()


class Browser:
    """A Chromium with an empty profile, driven by Selenium, and where its downloads go."""

    def __init__(self, driver, downloads: Path) -> None:
        self.driver, self.downloads = driver, downloads

    def renewed(self) -> None:
        """A new window, with nothing of what other tests left."""
        left = self.driver.window_handles
        self.driver.switch_to.new_window("window")
        mine = self.driver.current_window_handle
        for handle in left:
            self.driver.switch_to.window(handle)
            self.driver.close()
        self.driver.switch_to.window(mine)
        for command in ("Network.clearBrowserCookies", "Network.clearBrowserCache"):
            self.driver.execute_cdp_cmd(command, {})
        for log in ("browser", "performance"):
            self.driver.get_log(log)
        for file in self.downloads.iterdir():
            file.unlink()

    def wait_for(self, found: Callable[[], object], what: str, seconds: float = LONGEST_WAIT_S):
        """What `found` returns, as soon as that is true; fails naming `what`."""
        from selenium.common.exceptions import WebDriverException

        end, pause = time.monotonic() + seconds, 0.02
        while True:
            try:
                if result := found():
                    return result
            except WebDriverException:  # an element that is replaced meanwhile
                if time.monotonic() > end:
                    raise
            if time.monotonic() > end:
                self.screenshot("waiting")
                raise AssertionError(f"no {what} within {seconds} s")
            # what takes long is looked at seldom: looking takes time from what is waited for
            time.sleep(pause := min(1.2 * pause, 0.5))

    def find(self, selector: str, seconds: float = LONGEST_WAIT_S):
        """The first element of a CSS selector, waited for."""
        return self.wait_for(lambda: self.all(selector), selector, seconds)[0]

    def click(self, selector: str) -> None:
        """Click an element; a driver scrolls it below what sticks to the window's upper edge."""
        element = self.find(selector)
        self.run("arguments[0].scrollIntoView({block: 'nearest'})", element)
        element.click()

    def all(self, selector: str) -> list:
        return self.driver.find_elements("css selector", selector)

    def text(self, selector: str = "body") -> str:
        """Text of an element, as it is seen."""
        return self.find(selector).text

    def run(self, script: str, *arguments):
        """What a script returns; a promise is waited for."""
        return self.driver.execute_script(script, *arguments)

    def downloaded(self, suffix: str, seconds: float = LONGEST_WAIT_S) -> Path:
        """The newest complete download whose name ends with `suffix`, waited for."""

        def newest() -> Path | None:
            files = [f for f in self.downloads.iterdir() if f.name.endswith(suffix)]
            return max(files, key=lambda f: f.stat().st_mtime_ns, default=None)

        return self.wait_for(newest, f"download *{suffix}", seconds)

    def complaints(self) -> list[str]:
        """Errors and warnings of the page's console since the last call."""
        return [
            entry["message"]
            for entry in self.driver.get_log("browser")
            if entry["level"] in ("SEVERE", "WARNING")
        ]

    def requests(self) -> list[str]:
        """Addresses that pages asked for since the last call, the browser's own left out."""
        messages = (
            json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")
        )
        addresses = (
            message["params"]["request"]["url"]
            for message in messages
            if message["method"] == "Network.requestWillBeSent"
        )
        inner = ("data:", "blob:", "chrome:", "chrome-untrusted:")
        return [address for address in addresses if not address.startswith(inner)]

    def screenshot(self, name: str) -> None:
        """Keep a picture of the window, where the environment names a folder for it."""
        if folder := os.environ.get(SCREENSHOTS):
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.driver.save_screenshot(str(Path(folder) / f"{name}.png"))

    def screenshot_whole(self, name: str) -> None:
        """The same of the whole page, below the window's edge too."""
        if SCREENSHOTS not in os.environ:  # charts would be drawn twice for nobody
            return
        width, height = self.run("return [innerWidth, innerHeight]")
        self.resize(width, self.run("return document.documentElement.scrollHeight"))
        time.sleep(0.5)  # charts draw themselves anew
        self.screenshot(name)
        self.resize(width, height)

    def resize(self, width: int, height: int) -> None:
        """Size of the page's view, in CSS pixels: windows cannot be narrower than some 500."""
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
        )


def why_no_browser() -> str | None:
    """What lacks for tests in a browser, or None."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is not installed"
    if not _chromium():
        return "no Chromium is installed"
    return None if shutil.which("chromedriver") else "no chromedriver is installed"


def _chromium() -> str | None:
    # What draws no window takes less time. Debian's command for it is a script, which ends alone
    # where a driver ends it.
    shell = shutil.which("chromium-headless-shell", path="/usr/lib/chromium")
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((found for found in (shell, *map(shutil.which, names)) if found), None)


@contextmanager
def open_browser(folder: Path, *flags: str, width=1280, height=900) -> Iterator[Browser]:
    """A browser with an empty profile, whose downloads lie in `folder`, with further `flags`."""
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    downloads = folder / "downloads"
    downloads.mkdir(parents=True)
    options = Options()
    options.binary_location = _chromium()
    for flag in (*_FLAGS, f"--window-size={width},{height}", *flags):
        options.add_argument(flag)
    options.add_experimental_option(
        "prefs",
        {"download.default_directory": str(downloads), "download.prompt_for_download": False},
    )
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, Service(shutil.which("chromedriver")))
    try:
        driver.set_script_timeout(LONGEST_WAIT_S)
        yield Browser(driver, downloads)
    finally:
        driver.quit()


@pytest.fixture(scope="session")
def chromium(tmp_path_factory) -> Iterator[Browser]:
    """The one that tests of this process share: it takes a second of two processors to start."""
    if lacking := why_no_browser():
        pytest.skip(f"{lacking}: nothing is tested in a browser")
    with open_browser(tmp_path_factory.mktemp("browser")) as opened:
        yield opened


@pytest.fixture
def browser(chromium) -> Browser:
    """A browser as if it were fresh; the test is skipped, and says why, where there is none."""
    chromium.renewed()
    return chromium
