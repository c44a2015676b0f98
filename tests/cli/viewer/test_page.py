"""What the viewer shows, in a real browser: the page that is served and the one that is written."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from canvas import PATIENCE, Shown, blue, opened, orange, red
from results_folder import write_results
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer.exhibit import Exhibit, counted, exhibit
from gsc_jax.cli.viewer.page import page
from gsc_jax.cli.viewer.server import serving, write_page
from gsc_jax.cli.viewer.splats import Mode, shown
from gsc_jax.scene import Gaussians

if TYPE_CHECKING:
    import viser

pytest.importorskip("viser")

KNOWN = "computeBoundingSphere(): Computed radius is NaN"
"""What viser 1.1 itself complains of where there are splats: their corners have no third axis."""


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("page") / "found"
    write_results(folder)
    return folder


@pytest.fixture(scope="module")
def shown_results(found) -> tuple[Exhibit, Gaussians]:
    results = read_results(found)
    return exhibit(results, most=10**6)[0], results.gaussians


class TestWrittenPage:
    @pytest.fixture(scope="module")
    @staticmethod
    def address(tmp_path_factory, shown_results) -> str:
        path = tmp_path_factory.mktemp("written") / "page.html"
        write_page(path, shown_results[0])
        return path.as_uri()

    @pytest.fixture
    def page(self, browser, address, shown_results) -> Shown:
        page = opened(browser, address, shown_results)
        end = time.monotonic() + PATIENCE
        while browser.find_element(By.ID, "gsc-controls").get_property("disabled"):
            assert time.monotonic() < end, "the controls are never of use"
            time.sleep(0.1)
        return page

    def choose(self, page: Shown, mode: str) -> None:
        page.browser.find_element(By.CSS_SELECTOR, f"input[value='{mode}']").click()

    def test_modes_show_what_they_say(self, page):
        made, before = page.exhibit, page.buffer()
        assert red(page.picture()) > 0.005
        right: dict[Mode, Callable[[np.ndarray], bool]] = {
            "heat map": lambda picture: blue(picture) < 0.001,
            "tampered only": lambda picture: red(picture) > 0.005 and blue(picture) < 0.001,
            "authentic only": lambda picture: red(picture) < 0.001 and blue(picture) > 0.05,
            "original": lambda picture: red(picture) > 0.005 and blue(picture) > 0.05,
        }
        for mode in right:
            self.choose(page, mode)
            page.becomes(right[mode])
            rgbs, opacities = shown(made.splats, made.score, mode, made.threshold)
            expected = np.concatenate([rgbs, opacities], axis=1) * 255
            assert abs(page.buffer() - expected).max() < 3, mode
        np.testing.assert_array_equal(page.buffer(), before)

    def test_the_keyboard_moves_modes_and_threshold(self, page):
        find = page.browser.find_element
        find(By.CSS_SELECTOR, "input[value='original']").send_keys(
            Keys.ARROW_RIGHT, Keys.ARROW_RIGHT
        )
        few = page.becomes(lambda picture: red(picture) > 0.005 and blue(picture) < 0.001)
        slider, count = find(By.ID, "gsc-threshold"), find(By.ID, "gsc-count")
        found = int((page.exhibit.score > page.exhibit.threshold).sum())
        assert count.text.startswith(f"{found:,} of 1,998 Gaussians")
        slider.send_keys(Keys.HOME)
        page.becomes(lambda picture: abs(picture - few).mean() > 0.01)
        assert count.text.startswith("1,9")
        slider.send_keys(Keys.END)
        assert count.text.startswith("0 of 1,998 Gaussians (0%)")
        find(By.CSS_SELECTOR, "#gsc summary").send_keys(Keys.ENTER)
        assert not slider.is_displayed()

    def test_cameras_are_hidden_and_jumped_to(self, page):
        find, poses = page.browser.find_element, page.exhibit.poses
        page.becomes(lambda seen: orange(seen) > 0)
        find(By.ID, "gsc-cameras").click()
        page.becomes(lambda seen: orange(seen) == 0 and blue(seen) > 0.05)
        for button, index in (("next", 1), ("previous", 0), ("previous", len(poses) - 1)):
            find(By.ID, f"gsc-{button}").click()
            page.looks_from(index, error=0.04)
            assert find(By.ID, "gsc-camera").get_attribute("value") == str(index)

    def test_it_neither_complains_nor_asks_anyone(self, page, address):
        assert page.browser.requests()
        page.browser.complaints()
        opened(page.browser, address, (page.exhibit, page.gaussians))
        assert [said for said in page.browser.complaints() if KNOWN not in said] == []
        assert page.browser.strangers() == []

    def test_an_unknown_client_is_told_of(self, browser, address, tmp_path):
        path = tmp_path / "other.html"
        text = Path(address.removeprefix("file://")).read_text(encoding="utf-8")
        text = text.replace("window.__viserSceneTree?.", "window.nothing?.")
        path.write_text(text.replace("PATIENCE = 30000", "PATIENCE = 10"), encoding="utf-8")
        browser.get(path.as_uri())
        end = time.monotonic() + PATIENCE
        trouble = browser.find_element(By.ID, "gsc-trouble")
        while "do not fit" not in trouble.text:
            assert time.monotonic() < end, trouble.text
            time.sleep(0.2)
        assert browser.find_element(By.ID, "gsc-controls").get_property("disabled")


@pytest.mark.parametrize(
    ("above", "total"),
    [(0, 10), (1, 10_000), (5, 10_000), (1, 3), (9_995, 10_000), (9_999, 10_000), (10, 10)],
)
def test_the_page_counts_in_the_words_of_the_report(browser, shown_results, tmp_path, above, total):
    score = (np.arange(total) < above).astype(np.float32)
    made = dataclasses.replace(shown_results[0], score=score)
    path = tmp_path / "page.html"
    path.write_text(page("<html><head></head><body></body></html>", made), encoding="utf-8")
    browser.get(path.as_uri())
    said = browser.find_element(By.ID, "gsc-count").text
    assert said == f"{counted(score, made.threshold)}."


class TestServedPage:
    @pytest.fixture(scope="module")
    @staticmethod
    def server(shown_results) -> Iterator["viser.ViserServer"]:
        with serving(shown_results[0], host="localhost", port=0) as server:
            yield server

    @pytest.fixture
    def page(self, browser, server, shown_results) -> Shown:
        return opened(browser, f"http://localhost:{server.get_port()}", shown_results)

    def entry(self, page: Shown, label: str) -> WebElement:
        """The input that belongs to a label of viser's panel."""
        place = f"//label[normalize-space()='{label}']/following::input[1]"
        return page.browser.find_element(By.XPATH, place)

    def choose(self, page: Shown, label: str, option: str) -> None:
        self.entry(page, label).click()
        place = f"//*[@role='option'][normalize-space()='{option}']"
        end = time.monotonic() + PATIENCE
        while not (found := page.browser.find_elements(By.XPATH, place)):
            assert time.monotonic() < end, f"no option {option}"
            time.sleep(0.1)
        found[0].click()

    def press(self, page: Shown, name: str) -> None:
        page.browser.find_element(By.XPATH, f"//button[normalize-space()='{name}']").click()

    def becomes(self, page: Shown, label: str, value: str) -> None:
        """Waits until an entry says so."""
        end = time.monotonic() + PATIENCE
        while (said := self.entry(page, label).get_attribute("value")) != value:
            assert time.monotonic() < end, f"{label}: {said}"
            time.sleep(0.1)

    def test_what_is_shown_follows_mode_and_threshold(self, page):
        text = page.browser.find_element(By.TAG_NAME, "body").text
        assert page.exhibit.said[0] in text
        assert "1,998 Gaussians" in text
        assert red(page.picture()) > 0.005
        self.choose(page, "show", "tampered only")
        page.becomes(lambda picture: red(picture) > 0.005 and blue(picture) < 0.001)
        slider = page.browser.find_element(By.CSS_SELECTOR, "[role=slider]")
        slider.send_keys(Keys.HOME)
        page.becomes(lambda picture: blue(picture) > 0.05)
        slider.send_keys(Keys.END)
        page.becomes(lambda picture: red(picture) == 0)
        self.choose(page, "show", "original")
        page.becomes(lambda picture: blue(picture) > 0.05)

    def test_cameras_are_jumped_to(self, page, server):
        names = [pose.name for pose in page.exhibit.poses]
        for index, button in ((1, "next"), (0, "previous")):
            self.press(page, button)
            self.becomes(page, "camera", names[index])
            page.looks_from(index, error=0.06)
        before = page.picture()
        # From behind a camera, its apex is in the middle of the canvas.
        *_, client = server.get_clients().values()
        pose = page.exhibit.poses[1]
        with client.atomic():
            client.camera.position = pose.position + 0.5 * (pose.position - pose.look_at)
            client.camera.look_at = pose.look_at
        page.becomes(lambda picture: abs(picture - before).mean() > 0.01)
        canvas = page.browser.execute_script("return window.__viserMutable.canvas")
        ActionChains(page.browser).move_to_element(canvas).pause(0.5).click().perform()
        self.becomes(page, "camera", names[1])
        np.testing.assert_allclose(client.camera.position, pose.position, atol=1e-3)

    def test_cameras_are_hidden_and_the_background_is_painted(self, page):
        page.becomes(lambda picture: orange(picture) > 0)
        self.entry(page, "visible").click()
        page.becomes(lambda picture: orange(picture) == 0 and blue(picture) > 0.05)
        color = self.entry(page, "background")
        color.click()
        time.sleep(0.3)  # viser's panel forgets what is typed faster than anyone types
        color.send_keys(Keys.CONTROL, "a")
        color.send_keys("rgb(0, 200, 0)")
        page.becomes(lambda picture: np.allclose(picture[2, 2], [0, 200 / 255, 0], atol=0.05))

    def test_it_neither_complains_nor_asks_anyone(self, page, server):
        assert page.browser.requests()
        page.browser.complaints()
        address = f"http://localhost:{server.get_port()}"
        opened(page.browser, address, (page.exhibit, page.gaussians))
        assert [said for said in page.browser.complaints() if KNOWN not in said] == []
        assert page.browser.strangers() == []
