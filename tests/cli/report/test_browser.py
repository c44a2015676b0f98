"""The report in a browser: layers, keys, sorting, widths and colour schemes."""

import base64
import io
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pypdf
import pytest
from browser import Browser
from PIL import Image
from reports import GREEN, HOSTILE, run, write
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import Select, WebDriverWait

NAMES = [f"room {i:02}" for i in range(8)]
LARGE, SMALL = 640, 320
"""Widths of the full images and of the thumbnails."""
LAYERS = ("render", "detector", "masks", "overlay")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write(folder, run(tmp_path_factory.mktemp("scene"), NAMES, size=(LARGE, 420)))
    return folder


@pytest.fixture
def page(browser: Browser, folder: Path) -> Iterator[Browser]:
    """The report beside its folder."""
    show(browser, folder)
    yield browser
    check_console(browser)


def show(browser: Browser, folder: Path, *, width: int = 1280, scheme: str = "light") -> None:
    browser.get("about:blank")
    browser.errors()
    browser.requests()
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    browser.get((folder / "report.html").as_uri())


def check_console(browser: Browser) -> None:
    assert browser.errors() == []
    assert browser.foreign_requests() == []


def settled(browser: Browser, width: int = LARGE) -> WebElement:
    """The large image, once it has this width."""

    def loaded(_: object) -> WebElement | None:
        image = browser.find_element(By.CSS_SELECTOR, "#stage .frame img")
        return image if image.get_property("naturalWidth") == width else None

    return WebDriverWait(browser, 10, poll_frequency=0.02).until(loaded)  # pyright: ignore


def source(element: WebElement) -> str:
    return str(element.get_property("src"))


def colour(element: WebElement, x: float = 0.5, y: float = 0.5) -> np.ndarray:
    """Colour on the screen at a relative position of an element."""
    with Image.open(io.BytesIO(base64.b64decode(element.screenshot_as_base64))) as picture:
        place = int(x * picture.width), int(y * picture.height)
        return np.array(picture.convert("RGB").getpixel(place)) / 255


def choose(browser: Browser, layer: str) -> None:
    browser.find_element(By.CSS_SELECTOR, f"label:has(#layer-{layer})").click()


def press(browser: Browser, *keys: str) -> None:
    ActionChains(browser).send_keys(*keys).perform()


def selected_name(browser: Browser) -> str:
    return browser.find_element(By.CSS_SELECTOR, "#stage .name").text


def order(browser: Browser) -> list[str]:
    return [name.text for name in browser.find_elements(By.CSS_SELECTOR, "#strip .name")]


def shown_layers(browser: Browser) -> list[str | None]:
    images = browser.find_elements(By.CSS_SELECTOR, "#strip img")
    return [image.get_dom_attribute("data-layer") for image in images if image.is_displayed()]


def test_layer_buttons_change_the_images(page: Browser):
    green, black, white = np.array(GREEN), np.zeros(3), np.ones(3)
    middle = {"render": green, "masks": white, "detector": np.full(3, 0.8)}
    corner = {"render": green, "masks": black, "detector": np.full(3, 0.1), "overlay": green}
    for layer in (*LAYERS, "render"):
        choose(page, layer)
        picture = settled(page)
        assert f"/{layer}/" in source(picture)
        np.testing.assert_allclose(colour(picture, 0.02, 0.5), corner[layer], atol=0.03)
        if layer in middle:
            np.testing.assert_allclose(colour(picture), middle[layer], atol=0.03)
        else:
            assert np.abs(colour(picture) - green).max() > 0.2, "the overlay has no tint"
        assert shown_layers(page) == [layer] * len(NAMES)


def share(item: WebElement) -> float:
    return float(item.get_dom_attribute("data-tampered") or 0)


def test_page_opens_at_its_top_with_the_most_tampered_view(page: Browser):
    assert selected_name(page) == NAMES[6]
    assert page.find_element(By.ID, "place").text == "1 of 8"
    shares = [share(item) for item in page.find_elements(By.CSS_SELECTOR, "#strip li")]
    assert shares == sorted(shares, reverse=True)
    assert page.execute_script("return scrollY") == 0


def test_buttons_thumbnails_and_arrows_select_the_view(page: Browser):
    Select(page.find_element(By.ID, "sort")).select_by_value("order")
    for button, index in (("next", 7), ("next", 0), ("previous", 7)):
        page.find_element(By.ID, button).click()
        assert selected_name(page) == NAMES[index]
    page.find_elements(By.CSS_SELECTOR, "#strip a")[2].click()
    assert selected_name(page) == NAMES[2]
    press(page, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert selected_name(page) == NAMES[3]
    assert "room%2003" in source(settled(page))
    chosen = page.find_elements(By.CSS_SELECTOR, "#strip [aria-current]")
    assert [one.find_element(By.CLASS_NAME, "name").text for one in chosen] == [NAMES[3]]
    assert page.switch_to.active_element == chosen[0]


def test_digits_and_arrows_select_the_layer(page: Browser):
    for digit, layer in enumerate(LAYERS, start=1):
        press(page, str(digit))
        assert f"/{layer}/" in source(settled(page))
    press(page, "5", "0")
    assert page.find_element(By.ID, "layer-overlay").is_selected()
    page.execute_script("document.getElementById('layer-overlay').focus()")
    press(page, Keys.ARROW_LEFT)
    assert "/masks/" in source(settled(page))
    assert selected_name(page) == NAMES[6]


def test_sorting_changes_the_order_and_the_next_view(page: Browser):
    sort = Select(page.find_element(By.ID, "sort"))
    items = page.find_elements(By.CSS_SELECTOR, "#strip li")
    tampered = {name: share(item) for name, item in zip(order(page), items, strict=True)}
    sort.select_by_value("order")
    sort.select_by_value("tampered")
    assert order(page) == sorted(NAMES, key=lambda name: -tampered[name])
    sort.select_by_value("reliability")
    assert order(page) == [NAMES[i] for i in (0, 4, 2, 6, 1, 5, 3, 7)]
    assert selected_name(page) == NAMES[6]
    page.find_element(By.ID, "next").click()
    assert selected_name(page) == NAMES[1]
    sort.select_by_value("order")
    assert order(page) == NAMES


def test_copy_without_its_folder_shows_thumbnails(browser: Browser, folder: Path, tmp_path: Path):
    shutil.copy(folder / "report.html", tmp_path)
    show(browser, tmp_path)
    for layer in LAYERS:
        choose(browser, layer)
        assert source(settled(browser, SMALL)).startswith("data:image/")
        WebDriverWait(browser, 5).until(
            lambda _: browser.find_element(By.ID, "small").is_displayed()
        )
    press(browser, "3", Keys.ARROW_LEFT)
    np.testing.assert_allclose(colour(settled(browser, SMALL)), np.ones(3), atol=0.03)
    assert all("ERR_FILE_NOT_FOUND" in message for message in browser.errors())
    assert browser.foreign_requests() == []


def test_layers_can_be_selected_without_scripts(page: Browser):
    page.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        page.refresh()
        assert not page.find_element(By.ID, "stage").is_displayed()
        assert not page.find_element(By.ID, "sort").is_displayed()
        assert sorted(order(page)) == NAMES
        choose(page, "masks")
        assert shown_layers(page) == ["masks"] * len(NAMES)
    finally:
        page.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 400])
def test_page_follows_the_colour_scheme_and_fits_the_width(
    browser: Browser, folder: Path, scheme: str, width: int
):
    show(browser, folder, width=width, scheme=scheme)
    paper, ink = browser.execute_script(
        "const s = getComputedStyle(document.body); return [s.backgroundColor, s.color]"
    )
    light, dark = (paper, ink) if scheme == "light" else (ink, paper)
    assert min(int(x) for x in light[4:-1].split(",")) > 200
    assert max(int(x) for x in dark[4:-1].split(",")) < 60
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    check_console(browser)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_printed_page_has_the_findings_and_the_large_view(
    browser: Browser, folder: Path, scheme: str
):
    """As a PDF of the browser on A4; folded parts, such as the SHA-256 of the inputs, are open."""
    show(browser, folder, scheme=scheme)
    settled(browser)
    paper = {"paperWidth": 8.27, "paperHeight": 11.69}
    printed = browser.execute_cdp_cmd("Page.printToPDF", paper)
    document = pypdf.PdfReader(io.BytesIO(base64.b64decode(printed["data"])))
    first, text = document.pages[0], " ".join(page.extract_text() for page in document.pages)
    heading = browser.find_element(By.TAG_NAME, "h1").text
    assert heading in " ".join(first.extract_text().split())
    for words in ("scene probability", "5a5a5a5a", "jaxlib", NAMES[6]):
        assert words.lower() in text.lower()
    images = [image.image for page in document.pages for image in page.images]
    assert max(image.width for image in images if image) >= LARGE, "the large view is missing"
    assert "Keys:" not in text
    assert len(document.pages) <= 9
    check_console(browser)


def test_controls_and_images_have_accessible_names(page: Browser):
    tree = page.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    nodes = [node for node in tree if not node["ignored"]]
    for role in ("image", "link", "button", "radio", "combobox", "region"):
        names = [node["name"]["value"] for node in nodes if node["role"]["value"] == role]
        assert names, role
        assert all(names), f"a {role} without a name"


def test_hostile_names_are_harmless(browser: Browser, tmp_path: Path):
    write(tmp_path / "out", run(tmp_path, HOSTILE, size=(LARGE, 420)))
    show(browser, tmp_path / "out")
    for _ in HOSTILE:
        settled(browser)
        assert selected_name(browser) in HOSTILE
        press(browser, Keys.ARROW_RIGHT)
    assert "pwned" not in browser.title
    check_console(browser)


def test_strip_of_two_hundred_views_follows_the_selection(browser: Browser, tmp_path: Path):
    names = [f"frame_{i:05}" for i in range(200)]
    write(tmp_path / "out", run(tmp_path, names, size=(240, 160)))
    show(browser, tmp_path / "out")
    assert "frame_00006" in source(settled(browser, 240))
    Select(browser.find_element(By.ID, "sort")).select_by_value("order")
    browser.execute_script("document.activeElement.blur()")
    press(browser, *[Keys.ARROW_LEFT] * 10)
    assert selected_name(browser) == "frame_00196"
    chosen, strip = (
        browser.find_element(By.CSS_SELECTOR, x).rect for x in ("#strip [aria-current]", "#strip")
    )
    assert strip["y"] <= chosen["y"]
    assert chosen["y"] + chosen["height"] <= strip["y"] + strip["height"]
    check_console(browser)
