"""A real headless browser for the pages that people see: Debian's Chromium, driven by Selenium.

Tests ask for the fixture `browser`, which is skipped where there is none; files that import this
module are skipped where Selenium is not installed. Of each page it is known what the console
complained of and what was asked of the network.
"""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("selenium")

from selenium.webdriver import Chrome, ChromeOptions, ChromeService

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
DRIVER = shutil.which("chromedriver")
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
OURS = ("file:", "data:", "blob:", "http://localhost:", "http://127.0.0.1:", "chrome", "about:")
"""How the addresses begin that do not leave this machine."""


class Browser(Chrome):
    """A browser that remembers what its pages did."""

    def complaints(self) -> list[str]:
        """What the console said since last asked, if it is an error."""
        return [said["message"] for said in self.get_log("browser") if said["level"] == "SEVERE"]

    def requests(self) -> list[str]:
        """The addresses asked for since last asked."""
        events = [json.loads(entry["message"])["message"] for entry in self.get_log("performance")]
        asked = [event for event in events if event["method"] == "Network.requestWillBeSent"]
        return [event["params"]["request"]["url"] for event in asked]

    def strangers(self) -> list[str]:
        """Those of the requests that left this machine."""
        return [url for url in self.requests() if not url.startswith(OURS)]


def opened(profile: Path) -> Iterator[Browser]:
    """A browser with an empty profile, closed in the end."""
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
