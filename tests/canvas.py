"""A viewer's page as somebody looks at it: what is drawn on its canvas, and what it ought to be."""

import base64
import dataclasses
import time
from collections.abc import Callable

import imageio.v3 as iio
import numpy as np
from browser import Browser

from gsc_jax.cli.viewer.exhibit import Exhibit
from gsc_jax.cli.viewer.panel import SPLATS
from gsc_jax.cli.viewer.poses import Pose
from gsc_jax.render.orbit import look_at
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import render

SIZE = (700, 480)
PATIENCE = 30.0
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
            shares = {part.__name__: part(picture) for part in (red, blue, orange)}
            assert time.monotonic() < end, shares
        return picture

    def buffer(self) -> np.ndarray:
        """Red, green, blue and opacity of each splat, shape (N, 4) uint8."""
        words = np.array(self.browser.execute_script(BUFFER), np.uint32).reshape(-1, 8)
        return np.ascontiguousarray(words[:, 7:]).view(np.uint8)

    def looks_from(self, index: int, error: float) -> None:
        """Waits until the picture is that of a camera, and of no other."""
        rendered = [self.rendered(pose) for pose in self.exhibit.poses]

        def right(picture: np.ndarray) -> bool:
            errors = [float(abs(picture - one).mean()) for one in rendered]
            return errors[index] == min(errors) < error

        self.becomes(right)

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


def orange(picture: np.ndarray) -> float:
    """Share of the picture that is of the lines that draw cameras, however thin."""
    r, g, b = np.moveaxis(picture, -1, 0)
    return float(np.mean((r > 0.3) & (g > 0.5 * r) & (g < 0.8 * r) & (b < 0.3 * r)))


def blue(picture: np.ndarray) -> float:
    """Share of the picture that is of the floor."""
    return float(np.mean((picture[..., 2] > 0.5) & (picture[..., :2] < 0.3).all(axis=-1)))


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
