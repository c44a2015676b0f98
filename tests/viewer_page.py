"""A page of the 3D viewer in a browser: its controls, and whether its picture shows the scene."""

import base64
import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from browser import Browser
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import Select, WebDriverWait

from gsc_jax.cli.viewer.contents import Contents
from gsc_jax.render.orbit import look_at
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics
from gsc_jax.splat import render

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
    folder: Path
    contents: Contents
    gaussians: Gaussians
    renders: dict[tuple[int, int, int], np.ndarray] = dataclasses.field(default_factory=dict)
    """Renders that were made before, by index of the camera, height and width."""

    def open(self, address: str, *, size: tuple[int, int] = (640, 400)) -> "Shown":
        self.browser.get("about:blank")
        self.browser.errors()
        self.browser.requests()
        self.browser.set_window_size(*size)
        self.browser.get(address)
        return self

    def ready(self) -> "Shown":
        """Wait for the panel and the picture."""
        self.until(lambda browser: browser.execute_script("return Boolean(globalThis.view)"))
        self.becomes(floor_is_shown)
        return self

    def input(self, name: str) -> WebElement:
        return self.browser.find_element(By.ID, name)

    def select(self, name: str, option: str) -> Select:
        choice = Select(self.input(name))
        choice.select_by_visible_text(option)
        return choice

    def canvas(self) -> WebElement:
        return self.browser.find_element(By.CSS_SELECTOR, "canvas[data-engine]")

    def message(self) -> str:
        return self.input("message").text

    def count(self) -> int:
        """Gaussians that are drawn."""
        return self.browser.execute_script("return view.motion.shown")

    def drag(self, start: int, end: int, *, shift: bool = False) -> None:
        """Drag across the middle of the canvas, pixels from the middle."""
        actions = ActionChains(self.browser)
        if shift:
            actions.key_down(Keys.SHIFT)
        actions.move_to_element_with_offset(self.canvas(), start, start).click_and_hold()
        actions.move_by_offset(end, end).move_by_offset(-start, -start).release()
        if shift:
            actions.key_up(Keys.SHIFT)
        actions.perform()

    def export(self, file: Path | None = None) -> None:
        """Export a part; a page that is opened from a file has to be given the scene."""
        if self.browser.execute_script("return location.protocol") == "file:":
            self.browser.execute_script("view.input('file').value = ''")  # as the button does
            self.input("file").send_keys(str(file or self.folder / "tamper.ply"))
        else:
            self.input("export").click()

    def picture(self) -> np.ndarray:
        """Picture of the canvas, (H, W, 3) in [0, 1]; black before the page has a canvas."""
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

        def is_closest(picture: np.ndarray) -> bool:
            errors = self.errors(picture)
            return errors[index] == min(errors) < MAX_ERROR

        self.becomes(is_closest)

    def errors(self, picture: np.ndarray) -> list[float]:
        """Mean difference of a picture from the render of each camera, at its size."""
        renders = (self._rendered(k, *picture.shape[:2]) for k in range(len(self.contents.poses)))
        return [float(abs(picture - render).mean()) for render in renders]

    def _rendered(self, index: int, height: int, width: int) -> np.ndarray:
        """A render of gsc_jax from a camera."""
        if (index, height, width) not in self.renders:
            pose = self.contents.poses[index]
            K = intrinsics(height / 2 / np.tan(pose.fov / 2), width, height)
            viewmat = look_at(pose.position, pose.look_at, pose.up)
            camera = Camera(viewmat=viewmat, K=K, width=width, height=height)
            picture = np.clip(np.asarray(render(self.gaussians, camera)[0]), 0, 1)
            self.renders[index, height, width] = picture
        return self.renders[index, height, width]

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


def shows_something(picture: np.ndarray) -> bool:
    return bool(np.mean(picture.max(axis=-1) > 0.2) > 0.05)
