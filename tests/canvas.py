"""A page of the viewer in a browser: its canvas, and what the canvas should show."""

import base64
import dataclasses
import time
from collections.abc import Callable

import imageio.v3 as iio
import numpy as np
from browser import Browser

from gsc_jax.cli.viewer.contents import Contents
from gsc_jax.cli.viewer.poses import Pose
from gsc_jax.render.orbit import look_at
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics
from gsc_jax.splat import render

SIZE = (700, 480)
TIMEOUT_SECONDS = 30.0
WIDTH = 300
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

    def picture(self) -> np.ndarray:
        """The canvas, (H, W, 3) in [0, 1]; black as long as there is none."""
        url = self.browser.execute_script(PICTURE, WIDTH)
        if url is None:
            return np.zeros((WIDTH, WIDTH, 3))
        return iio.imread(base64.b64decode(url.split(",")[1]), extension=".png")[..., :3] / 255

    def becomes(self, expected: Callable[[np.ndarray], bool]) -> np.ndarray:
        """The picture, once it is as expected."""
        end = time.monotonic() + TIMEOUT_SECONDS
        while not expected(picture := self.picture()):
            time.sleep(0.2)
            shares = {share.__name__: share(picture) for share in (red, blue, orange)}
            assert time.monotonic() < end, shares
        return picture

    def shows_camera(self, index: int, error: float) -> None:
        """Wait until the picture is that of a camera, and of no other."""
        references = [self._rendered(pose) for pose in self.contents.poses]

        def is_closest(picture: np.ndarray) -> bool:
            errors = [float(abs(picture - reference).mean()) for reference in references]
            return errors[index] == min(errors) < error

        self.becomes(is_closest)

    def _rendered(self, pose: Pose) -> np.ndarray:
        """A render of gsc_jax from a camera, at the size of the canvas."""
        height, width = self.picture().shape[:2]
        K = intrinsics(height / 2 / np.tan(pose.fov / 2), width, height)
        viewmat = look_at(pose.position, pose.look_at, pose.up)
        camera = Camera(viewmat=viewmat, K=K, width=width, height=height)
        return np.clip(np.asarray(render(self.gaussians, camera)[0]), 0, 1)


def red(picture: np.ndarray) -> float:
    """Share of the pixels that show the ball."""
    return float(np.mean((picture[..., 0] > 0.5) & (picture[..., 1:] < 0.3).all(axis=-1)))


def blue(picture: np.ndarray) -> float:
    """Share of the pixels that show the floor."""
    return float(np.mean((picture[..., 2] > 0.5) & (picture[..., :2] < 0.3).all(axis=-1)))


def orange(picture: np.ndarray) -> float:
    """Share of the pixels that show the lines of cameras, however thin."""
    r, g, b = np.moveaxis(picture, -1, 0)
    return float(np.mean((r > 0.3) & (g > 0.5 * r) & (g < 0.8 * r) & (b < 0.3 * r)))
