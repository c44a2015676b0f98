"""The report in a browser: layers, keys, sorting, widths and colour schemes."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from reports import GREEN, HOSTILE, run, write
from selenium.webdriver import Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select, WebDriverWait
from stage import (
    CONTRAST,
    LARGE,
    colour,
    items,
    order,
    press,
    selected_name,
    settled,
    show,
    text_property,
)

NAMES = [f"room {i:02}" for i in range(8)]
SMALL = 320
"""Width of the thumbnails."""
LAYERS = ("render", "detector", "masks", "overlay")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write(folder, run(tmp_path_factory.mktemp("scene"), NAMES, size=(LARGE, 420)))
    return folder


@pytest.fixture
def page(browser: Browser, folder: Path) -> Iterator[Browser]:
    """The report beside its folder; neither console errors nor network requests are allowed."""
    show(browser, folder)
    yield browser
    assert browser.errors() == []
    assert browser.foreign_requests() == []


def test_layer_buttons_change_the_images(page: Browser):
    green, black, white = np.array(GREEN), np.zeros(3), np.ones(3)
    middle = {"render": green, "masks": white, "detector": np.full(3, 0.8)}
    corner = {"render": green, "masks": black, "detector": np.full(3, 0.1), "overlay": green}
    for layer in (*LAYERS, "render"):
        page.find_element(By.CSS_SELECTOR, f"label:has(#layer-{layer})").click()
        picture = settled(page)
        assert f"/{layer}/" in text_property(picture, "src")
        np.testing.assert_allclose(colour(picture, 0.02, 0.5), corner[layer], atol=0.03)
        if layer in middle:
            np.testing.assert_allclose(colour(picture), middle[layer], atol=0.03)
        else:
            assert np.abs(colour(picture) - green).max() > 0.2, "the overlay has no tint"
        shown = page.find_elements(By.CSS_SELECTOR, "#strip li:first-child img")
        assert [one.get_dom_attribute("data-layer") for one in shown if one.is_displayed()] == [
            layer
        ]
        assert NAMES[6] in text_property(picture, "alt")


def test_page_opens_at_its_top_with_the_most_tampered_view(page: Browser):
    assert selected_name(page) == NAMES[6]
    assert page.find_element(By.ID, "place").text == "7 of 8"
    assert page.execute_script("return scrollY") == 0
    assert page.find_element(By.ID, "layer-overlay").is_selected()


def test_buttons_thumbnails_and_arrows_select_the_view(page: Browser):
    page.find_element(By.ID, "next").click()
    assert selected_name(page) == NAMES[7]
    page.find_element(By.ID, "next").click()
    assert selected_name(page) == NAMES[0]
    page.find_element(By.ID, "previous").click()
    assert selected_name(page) == NAMES[7]
    page.find_elements(By.CSS_SELECTOR, "#strip a")[2].click()
    assert selected_name(page) == NAMES[2]
    settled(page)
    press(page, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert selected_name(page) == NAMES[3]
    assert "room%2003" in text_property(settled(page), "src")
    chosen = page.find_elements(By.CSS_SELECTOR, "#strip [aria-current]")
    assert [one.find_element(By.CLASS_NAME, "name").text for one in chosen] == [NAMES[3]]
    assert page.switch_to.active_element == chosen[0]


def test_digits_and_arrows_select_the_layer(page: Browser):
    for digit, layer in enumerate(LAYERS, start=1):
        press(page, str(digit))
        assert f"/{layer}/" in text_property(settled(page), "src")
    press(page, "5", "0")
    assert page.find_element(By.ID, "layer-overlay").is_selected()
    page.execute_script("document.getElementById('layer-overlay').focus()")
    press(page, Keys.ARROW_LEFT)
    assert page.find_element(By.ID, "layer-masks").is_selected()
    assert "/masks/" in text_property(settled(page), "src")
    assert selected_name(page) == NAMES[6]


def test_sorting_changes_the_order_and_the_next_view(page: Browser):
    sort = Select(page.find_element(By.ID, "sort"))
    tampered = [float(x.get_dom_attribute("data-tampered") or 0) for x in items(page)]
    sort.select_by_value("tampered")
    assert order(page) == [NAMES[i] for i in np.argsort(-np.array(tampered), kind="stable")]
    sort.select_by_value("reliability")
    kinds = [x.text.split()[-1] for x in page.find_elements(By.CSS_SELECTOR, "#strip .reliability")]
    assert kinds == [k for k in ("reliable", "inverted", "uninformative", "view") for _ in (0, 1)]
    assert order(page)[:4] == [NAMES[i] for i in (0, 4, 2, 6)]
    assert selected_name(page) == NAMES[6]
    page.find_element(By.ID, "next").click()
    assert selected_name(page) == NAMES[1]
    sort.select_by_value("order")
    assert order(page) == NAMES


def test_every_control_is_reached_by_tab_with_a_visible_focus(page: Browser):
    reached: list[str] = []
    body = page.find_element(By.TAG_NAME, "body")
    for _ in range(60):
        press(page, Keys.TAB)
        active = page.switch_to.active_element
        if active == body:
            break
        outline = page.execute_script(
            "const a = document.activeElement, s = getComputedStyle("
            "a.type == 'radio' ? a.nextElementSibling : a);"
            "return s.outlineStyle == 'none' ? 0 : parseFloat(s.outlineWidth)"
        )
        assert outline >= 2, active.get_attribute("outerHTML")
        label = active.get_attribute("id") or active.get_attribute("href") or active.tag_name
        reached.append((label or "").rsplit("/", 1)[-1])
    expected = ["#views", "layer-overlay", "sort", "previous", "next", "room%2000.jpg", "summary"]
    places = [next(i for i, x in enumerate(reached) if x.endswith(name)) for name in expected]
    assert places == sorted(places)
    assert reached.count("summary") == 4
    assert reached[-1] == "result.json"


def test_copy_without_its_folder_shows_thumbnails(browser: Browser, folder: Path, tmp_path: Path):
    shutil.copy(folder / "report.html", tmp_path)
    show(browser, tmp_path)
    for layer in LAYERS:
        browser.find_element(By.CSS_SELECTOR, f"label:has(#layer-{layer})").click()
        picture = settled(browser, SMALL)
        assert text_property(picture, "src").startswith("data:image/")
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
        assert order(page) == NAMES
        page.find_element(By.CSS_SELECTOR, "label:has(#layer-masks)").click()
        for item in items(page):
            shown = [x for x in item.find_elements(By.TAG_NAME, "img") if x.is_displayed()]
            assert [x.get_dom_attribute("data-layer") for x in shown] == ["masks"]
            assert shown[0].get_property("naturalWidth") == SMALL
    finally:
        page.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 400])
def test_text_is_legible_in_both_schemes_at_any_width(
    browser: Browser, folder: Path, scheme: str, width: int
):
    show(browser, folder, width=width, scheme=scheme)
    paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    brightness = np.mean([int(x) for x in paper[4:-1].split(",")])
    assert brightness > 200 if scheme == "light" else brightness < 60
    ratios = browser.execute_script(CONTRAST)
    assert len(ratios) > 100
    assert [html for ratio, html in ratios if ratio < 4.5] == []
    wide = browser.execute_script("return document.documentElement.scrollWidth")
    assert wide <= width
    assert browser.errors() == []


def test_accessible_names_and_roles(page: Browser):
    tree = page.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    nodes = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in tree
        if not node["ignored"]
    ]
    for role in ("image", "link", "button", "radio", "combobox", "region"):
        names = [name for kind, name in nodes if kind == role]
        assert names, role
        assert all(names), f"a {role} without a name"
    assert "Probability map" in [name.strip() for kind, name in nodes if kind == "radio"]
    assert all(image.get_property("alt") for image in page.find_elements(By.TAG_NAME, "img"))


def test_hostile_names_are_harmless(browser: Browser, tmp_path: Path):
    write(tmp_path / "out", run(tmp_path, HOSTILE, size=(LARGE, 420)))
    show(browser, tmp_path / "out")
    title = browser.title
    for _ in HOSTILE:
        settled(browser)
        assert selected_name(browser) in HOSTILE
        press(browser, Keys.ARROW_RIGHT)
    assert browser.title == title
    assert "pwned" not in title
    assert browser.errors() == []
    assert browser.foreign_requests() == []


def test_strip_of_two_hundred_views_follows_the_selection(browser: Browser, tmp_path: Path):
    names = [f"frame_{i:05}" for i in range(200)]
    write(tmp_path / "out", run(tmp_path, names, size=(240, 160)))
    show(browser, tmp_path / "out")
    assert len(items(browser)) == 200
    assert "frame_00006" in text_property(settled(browser, 240), "src")
    press(browser, *[Keys.ARROW_LEFT] * 10)
    assert selected_name(browser) == "frame_00196"
    chosen, strip = (
        browser.find_element(By.CSS_SELECTOR, x).rect for x in ("#strip [aria-current]", "#strip")
    )
    assert (
        strip["y"] <= chosen["y"] < chosen["y"] + chosen["height"] <= strip["y"] + strip["height"]
    )
    assert browser.errors() == []
