"""The viewer in a browser: the served page and the written one."""

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from browser import Browser
from canvas import SIZE, TIMEOUT_SECONDS, Shown, blue, orange, red
from results_folder import write_results
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.expected_conditions import frame_to_be_available_and_switch_to_it
from selenium.webdriver.support.ui import WebDriverWait

from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer.contents import Contents, viewer_contents
from gsc_jax.cli.viewer.controls import add_viewer
from gsc_jax.cli.viewer.server import serving, write_page
from gsc_jax.scene import Gaussians

if TYPE_CHECKING:
    import viser

pytest.importorskip("viser")

KNOWN_ERROR = "computeBoundingSphere(): Computed radius is NaN"
"""viser 1.1 reports this error for every scene with splats."""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[Contents, Gaussians]:
    folder = tmp_path_factory.mktemp("page") / "found"
    write_results(folder)
    found = read_results(folder)
    return viewer_contents(found, most=10**6)[0], found.gaussians


def opened(browser: Browser, address: str, results: tuple[Contents, Gaussians]) -> Shown:
    browser.get("about:blank")
    browser.errors()
    browser.requests()
    browser.set_window_size(*SIZE)
    browser.get(address)
    return Shown(browser=browser, contents=results[0], gaussians=results[1])


def check_console(browser: Browser) -> None:
    assert [message for message in browser.errors() if KNOWN_ERROR not in message] == []
    assert browser.foreign_requests() == []


class TestWrittenPage:
    @pytest.fixture(scope="class")
    @staticmethod
    def address(tmp_path_factory, results) -> str:
        path = tmp_path_factory.mktemp("written") / "page.html"
        write_page(path, results[0])
        return path.as_uri()

    @pytest.fixture
    def page(self, browser, address, results) -> Iterator[Shown]:
        """The page, inside its frame."""
        page = opened(browser, address, results)
        self.enter_frame(page)
        yield page
        browser.switch_to.default_content()

    def enter_frame(self, page: Shown) -> None:
        wait = WebDriverWait(page.browser, TIMEOUT_SECONDS)
        wait.until(frame_to_be_available_and_switch_to_it((By.TAG_NAME, "iframe")))
        page.becomes(lambda picture: blue(picture) > 0.05)

    def toggle(self, page: Shown, node: str) -> None:
        """Click the eye of a node in viser's scene tree."""
        place = f"//*[normalize-space(text())='{node}']/preceding::*[name()='svg'][1]"
        page.browser.find_element(By.XPATH, place).click()

    def test_layers_are_shown_and_hidden(self, page):
        assert red(page.picture()) > 0.005
        page.browser.find_element(By.CSS_SELECTOR, "[aria-label='Show scene tree']").click()
        self.toggle(page, "authentic")
        page.becomes(lambda picture: red(picture) > 0.005 and blue(picture) < 0.001)
        self.toggle(page, "tampered")
        page.becomes(lambda picture: red(picture) < 0.001)
        self.toggle(page, "heat map")
        page.becomes(lambda picture: np.mean(picture.max(axis=-1) > 0.2) > 0.05)
        assert red(page.picture()) < 0.001
        self.toggle(page, "cameras")
        page.becomes(lambda picture: orange(picture) == 0)

    def test_cameras_are_selected(self, page):
        browser = page.browser
        for button, index in (("next", 1), ("previous", 0), ("previous", 2)):
            browser.switch_to.default_content()
            browser.find_element(By.ID, button).click()
            self.enter_frame(page)
            page.shows_camera(index, error=0.06)

    def test_console_is_clean_and_nothing_leaves_the_machine(self, page):
        time.sleep(1)  # the workers of the client start after the first frame
        check_console(page.browser)


class TestServedPage:
    @pytest.fixture(scope="class")
    @staticmethod
    def server(results) -> Iterator["viser.ViserServer"]:
        with serving(host="localhost", port=0) as server:
            add_viewer(server, results[0])
            yield server

    @pytest.fixture
    def page(self, browser, server, results) -> Shown:
        page = opened(browser, f"http://localhost:{server.get_port()}", results)
        page.becomes(lambda picture: blue(picture) > 0.05)
        return page

    def entry(self, page: Shown, label: str) -> WebElement:
        """The input that belongs to a label of viser's panel."""
        place = f"//label[normalize-space()='{label}']/following::input[1]"
        return page.browser.find_element(By.XPATH, place)

    def select(self, page: Shown, label: str, option: str) -> None:
        self.entry(page, label).click()
        place = (By.XPATH, f"//*[@role='option'][normalize-space()='{option}']")
        wait = WebDriverWait(page.browser, TIMEOUT_SECONDS)
        wait.until(lambda browser: browser.find_element(*place)).click()

    def wait_for_value(self, page: Shown, label: str, value: str) -> None:
        wait = WebDriverWait(page.browser, TIMEOUT_SECONDS)
        wait.until(lambda _: self.entry(page, label).get_attribute("value") == value)

    def test_picture_follows_layer_and_threshold(self, page):
        text = page.browser.find_element(By.TAG_NAME, "body").text
        assert page.contents.sentences[0] in text
        assert "1,998 Gaussians" in text
        assert red(page.picture()) > 0.005
        self.select(page, "show", "tampered only")
        page.becomes(lambda picture: red(picture) > 0.005 and blue(picture) < 0.001)
        slider = page.browser.find_element(By.CSS_SELECTOR, "[role=slider]")
        slider.send_keys(Keys.HOME)
        page.becomes(lambda picture: blue(picture) > 0.05)
        slider.send_keys(Keys.END)
        page.becomes(lambda picture: red(picture) == 0)
        self.select(page, "show", "original")
        page.becomes(lambda picture: blue(picture) > 0.05)

    def test_cameras_are_selected_by_buttons_and_clicks(self, page, server):
        names = [pose.name for pose in page.contents.poses]
        for index, button in ((1, "next"), (0, "previous")):
            place = f"//button[normalize-space()='{button}']"
            page.browser.find_element(By.XPATH, place).click()
            self.wait_for_value(page, "camera", names[index])
            page.shows_camera(index, error=0.06)
        before = page.picture()
        # From behind a camera, its apex is in the middle of the canvas.
        *_, client = server.get_clients().values()
        pose = page.contents.poses[1]
        with client.atomic():
            client.camera.position = pose.position + 0.5 * (pose.position - pose.look_at)
            client.camera.look_at = pose.look_at
        page.becomes(lambda picture: abs(picture - before).mean() > 0.01)
        canvas = page.browser.find_element(By.CSS_SELECTOR, "canvas[data-engine]")
        ActionChains(page.browser).move_to_element(canvas).pause(0.5).click().perform()
        self.wait_for_value(page, "camera", names[1])
        np.testing.assert_allclose(client.camera.position, pose.position, atol=1e-3)

    def test_console_is_clean_and_nothing_leaves_the_machine(self, page):
        check_console(page.browser)
