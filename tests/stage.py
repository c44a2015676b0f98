"""The report in a browser: its stage (the large image), its strip of views, and its keys."""

import base64
import io
from pathlib import Path

import numpy as np
from browser import Browser
from PIL import Image
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

LARGE = 640
"""Width of the full images."""
CONTRAST = """
const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
const light = (c) => c.slice(0, 3).map((v) => v / 255)
  .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
  .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const behind = (e) => {
  for (; e; e = e.parentElement) {
    const c = rgb(getComputedStyle(e).backgroundColor);
    if (c.length < 4 || c[3] > 0) return c;
  }
};
const found = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const e = walker.currentNode.parentElement;
  if (!walker.currentNode.data.trim() || !e.checkVisibility()) continue;
  if (e.closest("script")) continue;
  const text = light(rgb(getComputedStyle(e).color));
  const paper = light(behind(e));
  found.push([(Math.max(text, paper) + 0.05) / (Math.min(text, paper) + 0.05), e.outerHTML]);
}
return found;
"""
"""Contrast ratio (WCAG) and HTML of every visible text."""


def show(browser: Browser, folder: Path, *, width: int = 1280, scheme: str = "light") -> None:
    browser.get("about:blank")
    browser.errors()
    browser.requests()
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    browser.get((folder / "report.html").as_uri())


def on_stage(browser: Browser) -> WebElement:
    return browser.find_element(By.CSS_SELECTOR, "#stage .frame img")


def settled(browser: Browser, width: int = LARGE) -> WebElement:
    """The image on the stage, once it has this width."""

    def is_loaded(_: object) -> bool:
        return on_stage(browser).get_property("naturalWidth") == width

    WebDriverWait(browser, 10, poll_frequency=0.02).until(is_loaded)
    return on_stage(browser)


def text_property(element: WebElement, name: str) -> str:
    """A property of an element as text."""
    return str(element.get_property(name))


def colour(element: WebElement, x: float = 0.5, y: float = 0.5) -> np.ndarray:
    """Colour on the screen at a relative position of an element."""
    with Image.open(io.BytesIO(base64.b64decode(element.screenshot_as_base64))) as picture:
        place = int(x * picture.width), int(y * picture.height)
        return np.array(picture.convert("RGB").getpixel(place)) / 255


def selected_name(browser: Browser) -> str:
    return browser.find_element(By.CSS_SELECTOR, "#stage .name").text


def press(browser: Browser, *keys: str) -> None:
    ActionChains(browser).send_keys(*keys).perform()


def order(browser: Browser) -> list[str]:
    return [name.text for name in browser.find_elements(By.CSS_SELECTOR, "#strip .name")]


def items(browser: Browser) -> list[WebElement]:
    return browser.find_elements(By.CSS_SELECTOR, "#strip li")
