"""A headless browser for tests of pages: Debian's Chromium, driven by Selenium.

Tests request the fixture `browser`, which skips them if Chromium is missing; files that import this
module are skipped if Selenium is missing. The browser records console errors and requests.
"""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("selenium")

from selenium.webdriver import Chrome, ChromeOptions, ChromeService
from selenium.webdriver.support.wait import WebDriverWait

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
DRIVER = shutil.which("chromedriver")
SECONDS = 20
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1280,900",
)
LOCAL = ("file:", "data:", "blob:", "http://localhost:", "http://127.0.0.1:", "chrome", "about:")
"""Beginnings of addresses that do not leave the machine."""


class Browser(Chrome):
    """A browser with access to the console and the requests of its pages."""

    def get(self, url: str) -> None:
        """Open a page and wait until it is complete; the driver alone may return too early."""
        super().get(url)
        state = "return [document.readyState, document.URL === 'about:blank']"
        wanted = ["complete", url == "about:blank"]
        WebDriverWait(self, SECONDS).until(lambda _: self.execute_script(state) == wanted)

    def errors(self) -> list[str]:
        """Errors of the console since the last call."""
        return [entry["message"] for entry in self.get_log("browser") if entry["level"] == "SEVERE"]

    def requests(self) -> list[str]:
        """Addresses requested since the last call."""
        events = [json.loads(entry["message"])["message"] for entry in self.get_log("performance")]
        sent = [event for event in events if event["method"] == "Network.requestWillBeSent"]
        return [event["params"]["request"]["url"] for event in sent]

    def foreign_requests(self) -> list[str]:
        """Requests since the last call that left the machine."""
        return [url for url in self.requests() if not url.startswith(LOCAL)]


def opened(profile: Path) -> Iterator[Browser]:
    """Yield a browser with an empty profile, and close it at the end."""
    options = ChromeOptions()
    options.binary_location = CHROMIUM or ""
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = Browser(options, ChromeService(DRIVER))
    try:
        yield browser
    finally:
        browser.quit()
