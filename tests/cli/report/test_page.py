"""The report in a real browser: what toggles, keys and sorting show, at any width and scheme."""

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
from stage import CONTRAST, LARGE, colour, items, named, order, press, settled, show, told

NAMES = [f"room {i:02}" for i in range(8)]
SMALL = 320
"""Width of the pictures in the page."""
LAYERS = ("render", "detector", "masks", "overlay")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write(folder, run(tmp_path_factory.mktemp("scene"), NAMES, size=(LARGE, 420)))
    return folder


@pytest.fixture
def page(browser: Browser, folder: Path) -> Iterator[Browser]:
    """The report beside its folder; nothing may be complained of or asked of the network."""
    show(browser, folder)
    yield browser
    assert browser.complaints() == []
    assert browser.strangers() == []


def test_the_toggles_change_what_is_drawn(page: Browser):
    green, black, white = np.array(GREEN), np.zeros(3), np.ones(3)
    middle = {"render": green, "masks": white, "detector": np.full(3, 0.8)}
    corner = {"render": green, "masks": black, "detector": np.full(3, 0.1), "overlay": green}
    for layer in (*LAYERS, "render"):
        page.find_element(By.CSS_SELECTOR, f"label:has(#layer-{layer})").click()
        picture = settled(page)
        assert f"/{layer}/" in told(picture, "src")
        np.testing.assert_allclose(colour(picture, 0.02, 0.5), corner[layer], atol=0.03)
        if layer in middle:
            np.testing.assert_allclose(colour(picture), middle[layer], atol=0.03)
        else:
            assert np.abs(colour(picture) - green).max() > 0.2, "nothing is tinted"
        shown = page.find_elements(By.CSS_SELECTOR, "#strip li:first-child img")
        assert [one.get_dom_attribute("data-layer") for one in shown if one.is_displayed()] == [
            layer
        ]
        assert NAMES[6] in told(picture, "alt")


def test_it_opens_with_the_view_that_shows_most_and_the_page_at_its_top(page: Browser):
    assert named(page) == NAMES[6]
    assert page.find_element(By.ID, "place").text == "7 of 8"
    assert page.execute_script("return scrollY") == 0
    assert page.find_element(By.ID, "layer-overlay").is_selected()


def test_buttons_thumbnails_and_arrows_choose_the_view(page: Browser):
    page.find_element(By.ID, "next").click()
    assert named(page) == NAMES[7]
    page.find_element(By.ID, "next").click()
    assert named(page) == NAMES[0]
    page.find_element(By.ID, "previous").click()
    assert named(page) == NAMES[7]
    page.find_elements(By.CSS_SELECTOR, "#strip a")[2].click()
    assert named(page) == NAMES[2]
    settled(page)
    press(page, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert named(page) == NAMES[3]
    assert "room%2003" in told(settled(page), "src")
    chosen = page.find_elements(By.CSS_SELECTOR, "#strip [aria-current]")
    assert [one.find_element(By.CLASS_NAME, "name").text for one in chosen] == [NAMES[3]]
    assert page.switch_to.active_element == chosen[0]


def test_digits_choose_the_layer_and_arrows_within_the_group_too(page: Browser):
    for digit, layer in enumerate(LAYERS, start=1):
        press(page, str(digit))
        assert f"/{layer}/" in told(settled(page), "src")
    press(page, "5", "0")
    assert page.find_element(By.ID, "layer-overlay").is_selected()
    page.execute_script("document.getElementById('layer-overlay').focus()")
    press(page, Keys.ARROW_LEFT)
    assert page.find_element(By.ID, "layer-masks").is_selected()
    assert "/masks/" in told(settled(page), "src")
    assert named(page) == NAMES[6]


def test_sorting_moves_the_views_and_what_comes_next(page: Browser):
    sort = Select(page.find_element(By.ID, "sort"))
    found = [float(x.get_dom_attribute("data-found") or 0) for x in items(page)]
    sort.select_by_value("found")
    assert order(page) == [NAMES[i] for i in np.argsort(-np.array(found), kind="stable")]
    sort.select_by_value("worth")
    worth = [x.text.split()[-1] for x in page.find_elements(By.CSS_SELECTOR, "#strip .worth")]
    assert worth == ["it", "it", "inverted", "inverted", "it", "it", "view", "view"]
    assert order(page)[:4] == [NAMES[i] for i in (0, 4, 2, 6)]
    assert named(page) == NAMES[6]
    page.find_element(By.ID, "next").click()
    assert named(page) == NAMES[1]
    sort.select_by_value("order")
    assert order(page) == NAMES


def test_everything_is_reached_by_tab_and_is_seen_to_be(page: Browser):
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
    wanted = ["#views", "layer-overlay", "sort", "previous", "next", "room%2000.jpg", "summary"]
    places = [next(i for i, x in enumerate(reached) if x.endswith(name)) for name in wanted]
    assert places == sorted(places)
    assert reached.count("summary") == 4
    assert reached[-1] == "result.json"


def test_a_copy_without_its_folder_shows_the_small_pictures(
    browser: Browser, folder: Path, tmp_path: Path
):
    shutil.copy(folder / "report.html", tmp_path)
    show(browser, tmp_path)
    for layer in LAYERS:
        browser.find_element(By.CSS_SELECTOR, f"label:has(#layer-{layer})").click()
        picture = settled(browser, SMALL)
        assert told(picture, "src").startswith("data:image/")
        WebDriverWait(browser, 5).until(
            lambda _: browser.find_element(By.ID, "small").is_displayed()
        )
    press(browser, "3", Keys.ARROW_LEFT)
    np.testing.assert_allclose(colour(settled(browser, SMALL)), np.ones(3), atol=0.03)
    assert all("ERR_FILE_NOT_FOUND" in said for said in browser.complaints())
    assert browser.strangers() == []


def test_without_scripts_all_views_are_there_and_the_layers_can_be_chosen(page: Browser):
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
def test_both_schemes_are_legible_at_any_width(
    browser: Browser, folder: Path, scheme: str, width: int
):
    show(browser, folder, width=width, scheme=scheme)
    paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    brightness = np.mean([int(x) for x in paper[4:-1].split(",")])
    assert brightness > 200 if scheme == "light" else brightness < 60
    ratios = browser.execute_script(CONTRAST)
    assert len(ratios) > 150
    assert any("<text" in html for _, html in ratios)
    assert [html for ratio, html in ratios if ratio < 4.5] == []
    wide = browser.execute_script("return document.documentElement.scrollWidth")
    assert wide <= width
    assert browser.complaints() == []


def test_alternative_texts_names_and_roles(page: Browser):
    tree = page.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    said = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in tree
        if not node["ignored"]
    ]
    for role in ("image", "link", "button", "radio", "combobox", "region"):
        names = [name for kind, name in said if kind == role]
        assert names, role
        assert all(names), f"a {role} without a name"
    assert ("radio", "Detector mask") in said
    assert all(image.get_property("alt") for image in page.find_elements(By.TAG_NAME, "img"))


def test_hostile_names_do_no_harm_and_have_their_pictures(browser: Browser, tmp_path: Path):
    write(tmp_path / "out", run(tmp_path, HOSTILE, size=(LARGE, 420)))
    show(browser, tmp_path / "out")
    title = browser.title
    for _ in HOSTILE:
        settled(browser)
        assert named(browser) in HOSTILE
        press(browser, Keys.ARROW_RIGHT)
    assert browser.title == title
    assert "pwned" not in title
    assert browser.complaints() == []
    assert browser.strangers() == []


def test_two_hundred_views_fit_into_a_page_and_their_strip_follows(
    browser: Browser, tmp_path: Path
):
    names = [f"frame_{i:05}" for i in range(200)]
    write(tmp_path / "out", run(tmp_path, names, size=(240, 160)))
    show(browser, tmp_path / "out")
    assert len(items(browser)) == 200
    assert "frame_00006" in told(settled(browser, 240), "src")
    press(browser, *[Keys.ARROW_LEFT] * 10)
    assert named(browser) == "frame_00196"
    chosen, strip = (
        browser.find_element(By.CSS_SELECTOR, x).rect for x in ("#strip [aria-current]", "#strip")
    )
    assert (
        strip["y"] <= chosen["y"] < chosen["y"] + chosen["height"] <= strip["y"] + strip["height"]
    )
    assert browser.complaints() == []
