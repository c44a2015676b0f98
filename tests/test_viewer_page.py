"""What the viewer shows, in a real browser: the page that is served and the one that is written."""

import base64
import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import viser
from browser import Browser
from results_folder import write_results
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

from gsc_jax.app.results import read_results
from gsc_jax.app.viewer import serving, write_page
from gsc_jax.app.viewing.exhibit import Exhibit, exhibit
from gsc_jax.app.viewing.panel import SPLATS
from gsc_jax.app.viewing.poses import Pose
from gsc_jax.app.viewing.splats import Mode, shown
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import render
from gsc_jax.views import look_at

SIZE = (700, 480)
PATIENCE = 30.0
KNOWN = "computeBoundingSphere(): Computed radius is NaN"
"""What viser 1.1 itself complains of where there are splats: their corners have no third axis."""
WIDTH = 300
PICTURE = """
const seen = window.__viserMutable.canvas;
const small = document.createElement("canvas");
small.width = arguments[0];
small.height = Math.round((arguments[0] * seen.clientHeight) / seen.clientWidth);
small.getContext("2d").drawImage(seen, 0, 0, small.width, small.height);
return small.toDataURL();
"""
"""The canvas at one size: viser draws with fewer pixels where the machine is slow."""
BUFFER = f"return Array.from(window.__viserSceneTree.getState()['{SPLATS}'].message.props.buffer)"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shown:
    """A page that is open in the browser, and what it ought to show."""

    browser: Browser
    exhibit: Exhibit
    gaussians: Gaussians

    def picture(self) -> np.ndarray:
        """What the canvas shows once it has come to rest, shape (H, W, 3) in [0, 1]."""
        seen = [self._canvas(), self._canvas()]
        end = time.monotonic() + PATIENCE
        while not (np.array_equal(seen[-1], seen[-2]) and seen[-1].std() > 0):
            assert time.monotonic() < end, "the picture never comes to rest, or is blank"
            time.sleep(0.4)
            seen = [seen[-1], self._canvas()]
        return seen[-1]

    def becomes(self, right: Callable[[np.ndarray], bool]) -> np.ndarray:
        """The picture, once it is as it should be."""
        end = time.monotonic() + PATIENCE
        while not right(picture := self._canvas()):
            time.sleep(0.2)
            assert time.monotonic() < end, f"red {red(picture):.4f}, blue {blue(picture):.4f}"
        return picture

    def buffer(self) -> np.ndarray:
        """Red, green, blue and opacity of each splat, shape (N, 4) uint8."""
        words = np.array(self.browser.execute_script(BUFFER), np.uint32).reshape(-1, 8)
        return np.ascontiguousarray(words[:, 7:]).view(np.uint8)

    def rendered(self, pose: Pose) -> np.ndarray:
        """What gsc_jax renders from there at the size of the canvas."""
        height, width = self._canvas().shape[:2]
        focal = height / 2 / np.tan(pose.fov / 2)
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
        viewmat = look_at(pose.position, pose.look_at, pose.up)
        camera = Camera(viewmat=viewmat, K=K, width=width, height=height)
        return np.clip(np.asarray(render(self.gaussians, camera)[0]), 0, 1)

    def _canvas(self) -> np.ndarray:
        url = self.browser.execute_script(PICTURE, WIDTH)
        return iio.imread(base64.b64decode(url.split(",")[1]), extension=".png")[..., :3] / 255


def red(picture: np.ndarray) -> float:
    """Share of the picture that is of the ball."""
    return float(np.mean((picture[..., 0] > 0.5) & (picture[..., 1:] < 0.3).all(axis=-1)))


def blue(picture: np.ndarray) -> float:
    """Share of the picture that is of the floor."""
    return float(np.mean((picture[..., 2] > 0.5) & (picture[..., :2] < 0.3).all(axis=-1)))


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("page") / "found"
    write_results(folder)
    return folder


@pytest.fixture(scope="module")
def shown_results(found) -> tuple[Exhibit, Gaussians]:
    results = read_results(found)
    return exhibit(results, most=10**6)[0], results.gaussians


def opened(browser: Browser, address: str, results: tuple[Exhibit, Gaussians]) -> Shown:
    browser.set_window_size(*SIZE)
    browser.get(address)
    page = Shown(browser=browser, exhibit=results[0], gaussians=results[1])
    end = time.monotonic() + PATIENCE
    present = f"return !!window.__viserSceneTree?.getState()['{SPLATS}']"
    while not browser.execute_script(present):
        assert time.monotonic() < end, "the scene never arrives"
        time.sleep(0.2)
    page.becomes(lambda picture: blue(picture) > 0.05)
    return page


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
        while browser.find_element(By.ID, "gsc-controls").get_property("disabled"):
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
        assert count.text.startswith("0 of 1,998 Gaussians (0.0%)")
        find(By.CSS_SELECTOR, "#gsc summary").send_keys(Keys.ENTER)
        assert not slider.is_displayed()

    def test_cameras_are_hidden_and_jumped_to(self, page):
        find, poses = page.browser.find_element, page.exhibit.poses
        with_cameras = page.picture()
        find(By.ID, "gsc-cameras").click()
        page.becomes(lambda seen: not np.array_equal(seen, with_cameras))
        for button, index in (("next", 1), ("previous", 0), ("previous", len(poses) - 1)):
            find(By.ID, f"gsc-{button}").click()
            rendered = page.rendered(poses[index])
            page.becomes(lambda seen, rendered=rendered: abs(seen - rendered).mean() < 0.04)
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


class TestServedPage:
    @pytest.fixture(scope="module")
    @staticmethod
    def server(shown_results) -> Iterator[viser.ViserServer]:
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
        names, pictures = [pose.name for pose in page.exhibit.poses], [page.picture()]
        for name, button in ((names[1], "next"), (names[0], "previous")):
            self.press(page, button)
            self.becomes(page, "camera", name)
            pictures.append(page.picture())
        assert abs(pictures[1] - pictures[0]).mean() > 0.01
        assert abs(pictures[2] - pictures[0]).mean() < 0.005
        rendered = page.rendered(page.exhibit.poses[0])
        assert abs(pictures[2] - rendered).mean() < 0.06
        # From behind a camera, its apex is in the middle of the canvas.
        *_, client = server.get_clients().values()
        pose = page.exhibit.poses[1]
        with client.atomic():
            client.camera.position = pose.position + 0.5 * (pose.position - pose.look_at)
            client.camera.look_at = pose.look_at
        page.becomes(lambda picture: abs(picture - pictures[2]).mean() > 0.01)
        canvas = page.browser.execute_script("return window.__viserMutable.canvas")
        ActionChains(page.browser).move_to_element(canvas).pause(0.5).click().perform()
        self.becomes(page, "camera", names[1])
        np.testing.assert_allclose(client.camera.position, pose.position, atol=1e-3)

    def test_cameras_are_hidden_and_the_background_is_painted(self, page):
        before = page.picture()
        self.entry(page, "visible").click()
        page.becomes(lambda picture: not np.array_equal(picture, before))
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
