"""The viewer in a browser: the served page and the written one."""

import base64
import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import imageio.v3 as iio
import numpy as np
import pytest
from browser import Browser
from results_folder import write_results
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.expected_conditions import frame_to_be_available_and_switch_to_it
from selenium.webdriver.support.ui import Select, WebDriverWait

from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer.access import Access
from gsc_jax.cli.viewer.contents import Contents, Pose, viewer_contents
from gsc_jax.cli.viewer.controls import add_viewer
from gsc_jax.cli.viewer.server import serving, write_page
from gsc_jax.render.orbit import look_at
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics
from gsc_jax.splat import render

if TYPE_CHECKING:
    import viser

pytest.importorskip("viser")

KNOWN_ERROR = "computeBoundingSphere(): Computed radius is NaN"
"""viser 1.1 reports this error for every scene with splats."""
TIMEOUT_SECONDS = 30.0
WIDTH = 300
MAX_ERROR = 0.06
"""Mean difference between viser's picture and a render of gsc_jax from the same camera."""
PICTURE = """
const canvas = document.querySelector("canvas[data-engine]");
if (!canvas || !canvas.clientWidth) return null;
const small = document.createElement("canvas");
small.width = arguments[0];
small.height = Math.round((arguments[0] * canvas.clientHeight) / canvas.clientWidth);
small.getContext("2d").drawImage(canvas, 0, 0, small.width, small.height);
return small.toDataURL();
"""
"""The canvas of three.js at one size: viser draws fewer pixels on slow machines."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shown:
    """A page that is open in the browser, and what it should show."""

    browser: Browser
    contents: Contents
    gaussians: Gaussians

    def open(self, address: str) -> "Shown":
        self.browser.get("about:blank")
        self.browser.errors()
        self.browser.requests()
        self.browser.set_window_size(700, 480)
        self.browser.get(address)
        return self

    def picture(self) -> np.ndarray:
        """The canvas, (H, W, 3) in [0, 1]; black as long as there is none."""
        url = self.browser.execute_script(PICTURE, WIDTH)
        if url is None:
            return np.zeros((WIDTH, WIDTH, 3))
        return iio.imread(base64.b64decode(url.split(",")[1]), extension=".png")[..., :3] / 255

    def becomes(self, expected: Callable[[np.ndarray], bool]) -> None:
        """Wait until the picture is as expected."""
        end = time.monotonic() + TIMEOUT_SECONDS
        while not expected(picture := self.picture()):
            time.sleep(0.2)
            assert time.monotonic() < end, (red(picture), blue(picture))

    def shows_camera(self, index: int) -> None:
        """Wait until the picture is that of a camera, and of no other."""
        references = [self._rendered(pose) for pose in self.contents.poses]

        def is_closest(picture: np.ndarray) -> bool:
            errors = [float(abs(picture - reference).mean()) for reference in references]
            return errors[index] == min(errors) < MAX_ERROR

        self.becomes(is_closest)

    def _rendered(self, pose: Pose) -> np.ndarray:
        """A render of gsc_jax from a camera, at the size of the canvas."""
        height, width = self.picture().shape[:2]
        K = intrinsics(height / 2 / np.tan(pose.fov / 2), width, height)
        viewmat = look_at(pose.position, pose.look_at, pose.up)
        camera = Camera(viewmat=viewmat, K=K, width=width, height=height)
        return np.clip(np.asarray(render(self.gaussians, camera)[0]), 0, 1)

    def until(self, condition: Callable) -> WebElement:
        return WebDriverWait(self.browser, TIMEOUT_SECONDS).until(condition)

    def check_console(self) -> None:
        assert [error for error in self.browser.errors() if KNOWN_ERROR not in error] == []
        assert self.browser.foreign_requests() == []


def red(picture: np.ndarray) -> float:
    """Share of the pixels that show the ball."""
    return float(np.mean((picture[..., 0] > 0.5) & (picture[..., 1:] < 0.3).all(axis=-1)))


def blue(picture: np.ndarray) -> float:
    """Share of the pixels that show the floor."""
    return float(np.mean((picture[..., 2] > 0.5) & (picture[..., :2] < 0.3).all(axis=-1)))


def yellow(picture: np.ndarray) -> float:
    """Share of the pixels that show selected Gaussians."""
    return float(np.mean((picture[..., :2] > 0.5).all(axis=-1) & (picture[..., 2] < 0.4)))


def floor_is_shown(picture: np.ndarray) -> bool:
    return blue(picture) > 0.05


def only_ball_is_shown(picture: np.ndarray) -> bool:
    return red(picture) > 0.005 and blue(picture) < 0.001


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory, browser: Browser) -> Shown:
    folder = tmp_path_factory.mktemp("page") / "found"
    write_results(folder)
    found = read_results(folder)
    contents, _ = viewer_contents(found, most=10**6)
    return Shown(browser=browser, contents=contents, gaussians=found.scene.gaussians)


class TestWrittenPage:
    @pytest.fixture
    def page(self, shown, tmp_path) -> Iterator[Shown]:
        """The page, inside its frame."""
        write_page(tmp_path / "page.html", shown.contents)
        self.enter_frame(shown.open((tmp_path / "page.html").as_uri()))
        yield shown
        shown.check_console()
        shown.browser.switch_to.default_content()

    def enter_frame(self, page: Shown) -> None:
        page.until(frame_to_be_available_and_switch_to_it((By.TAG_NAME, "iframe")))
        page.becomes(floor_is_shown)

    def toggle(self, page: Shown, node: str) -> None:
        """Click the eye of a node in viser's scene tree."""
        place = f"//*[normalize-space(text())='{node}']/preceding::*[name()='svg'][1]"
        page.browser.find_element(By.XPATH, place).click()

    def test_a_browser_without_webgl_is_told_so(self, shown, tmp_path):
        write_page(tmp_path / "page.html", shown.contents)
        source = {"source": "HTMLCanvasElement.prototype.getContext = () => null"}
        run_before = "Page.addScriptToEvaluateOnNewDocument"
        script = shown.browser.execute_cdp_cmd(run_before, source)
        try:
            shown.open((tmp_path / "page.html").as_uri())
            assert "no WebGL 2" in shown.browser.find_element(By.TAG_NAME, "header").text
        finally:
            shown.browser.execute_cdp_cmd(run_before.replace("add", "remove"), script)

    def test_without_a_graphics_card_few_gaussians_come_first(self, shown, tmp_path, monkeypatch):
        monkeypatch.setattr("gsc_jax.cli.viewer.server.WITHOUT_GPU", (300, 900))
        write_page(tmp_path / "page.html", shown.contents)
        shown.open((tmp_path / "page.html").as_uri())
        header, count = (shown.browser.find_element(By.TAG_NAME, "header"), "300 Gaussians")
        assert f"only {count}" in header.text
        frame = frame_to_be_available_and_switch_to_it((By.TAG_NAME, "iframe"))
        shown.until(frame)
        shown.becomes(lambda picture: red(picture) > 0.001 and blue(picture) < 0.6)
        few = shown.picture()
        shown.browser.switch_to.default_content()
        choice = Select(shown.browser.find_element(By.ID, "count"))
        assert choice.first_selected_option.text == count
        assert len(choice.options) == 3
        choice.select_by_index(2)
        shown.until(frame)
        shown.becomes(lambda picture: blue(picture) > blue(few) + 0.01)
        shown.browser.switch_to.default_content()

    def test_layers_are_shown_and_hidden(self, page):
        assert red(page.picture()) > 0.005
        page.browser.find_element(By.CSS_SELECTOR, "[aria-label='Show scene tree']").click()
        self.toggle(page, "authentic")
        page.becomes(only_ball_is_shown)
        self.toggle(page, "tampered")
        page.becomes(lambda picture: red(picture) < 0.001)
        self.toggle(page, "heat map")
        page.becomes(lambda picture: np.mean(picture.max(axis=-1) > 0.2) > 0.05)
        assert red(page.picture()) < 0.001

    def test_cameras_are_selected(self, page):
        for button, index in (("next", 1), ("previous", 0), ("previous", 2)):
            page.browser.switch_to.default_content()
            page.browser.find_element(By.ID, button).click()
            self.enter_frame(page)
            page.shows_camera(index)


class TestServedPage:
    @pytest.fixture(scope="class")
    @staticmethod
    def server(shown) -> Iterator["viser.ViserServer"]:
        with serving(Access(host="localhost", token="token"), port=0) as server:
            add_viewer(server, shown.contents)
            yield server

    @pytest.fixture
    def page(self, server, shown) -> Iterator[Shown]:
        shown.open(f"http://localhost:{server.get_port()}/token/").becomes(floor_is_shown)
        yield shown
        shown.check_console()

    def entry(self, page: Shown, label: str) -> WebElement:
        """The input that belongs to a label of viser's panel."""
        place = f"//label[normalize-space()='{label}']/following::input[1]"
        return page.browser.find_element(By.XPATH, place)

    def select_layer(self, page: Shown, layer: str) -> None:
        self.entry(page, "show").click()
        place = f"//*[@role='option'][normalize-space()='{layer}']"
        page.until(lambda browser: browser.find_element(By.XPATH, place)).click()

    def wait_for_camera(self, page: Shown, name: str) -> None:
        page.until(lambda _: self.entry(page, "camera").get_attribute("value") == name)

    def test_picture_follows_layer_and_threshold(self, page):
        text = page.browser.find_element(By.TAG_NAME, "body").text
        assert page.contents.sentences[0] in text
        self.select_layer(page, "tampered only")
        page.becomes(only_ball_is_shown)
        slider = page.browser.find_element(By.CSS_SELECTOR, "[role=slider]")
        slider.send_keys(Keys.HOME)
        page.becomes(floor_is_shown)
        slider.send_keys(Keys.END)
        page.becomes(lambda picture: red(picture) == 0)
        self.select_layer(page, "original")
        page.becomes(floor_is_shown)

    def test_cameras_are_selected_by_buttons(self, page):
        poses = page.contents.poses
        for index, button in ((1, "next"), (0, "previous")):
            place = f"//button[normalize-space()='{button}']"
            page.browser.find_element(By.XPATH, place).click()
            self.wait_for_camera(page, poses[index].name)
            page.shows_camera(index)

    def test_a_click_describes_and_a_box_selects(self, page):
        self.select_layer(page, "original")
        page.becomes(floor_is_shown)
        canvas = page.browser.find_element(By.CSS_SELECTOR, "canvas[data-engine]")
        actions = ActionChains(page.browser)
        actions.move_to_element(canvas).click().perform()
        page.until(lambda browser: "position" in browser.find_element(By.TAG_NAME, "body").text)
        actions = ActionChains(page.browser)
        actions.key_down(Keys.SHIFT).move_to_element_with_offset(canvas, -60, -60).click_and_hold()
        actions.move_by_offset(60, 60).move_by_offset(60, 60).release().key_up(Keys.SHIFT).perform()
        page.until(lambda browser: "are selected" in browser.find_element(By.TAG_NAME, "body").text)
        page.becomes(lambda picture: yellow(picture) > 0.01)
        clear = page.browser.find_element(By.XPATH, "//button[.='clear selection']")
        page.browser.execute_script("arguments[0].click()", clear)  # it may be scrolled away
        page.becomes(lambda picture: yellow(picture) < 0.001)
