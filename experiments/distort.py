"""What happens to a render or a model on its way to the method: noise and blur, as in Table 2.

The paper distorts the images that the 2D detector sees (Gaussian noise, blur) and the tampered
model (noise on scales and on opacities). It states no strengths; ours stand in `DISTORTIONS`, where
each is a row to loop over:

    for name, distortion in DISTORTIONS.items():
        model = distortion.of_model(gaussians, seed=seed)
        result = locate(model, cameras, distortion.of_detector(detector, seed=seed))

No Gaussian is added, dropped or moved to another row, so the truth per Gaussian stays what it was.
"""

import dataclasses
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from gsc_jax.evidence.detector import Detector, as_detector
from gsc_jax.scene import Camera, Gaussians

OPACITY_MARGIN = 1e-6
"""Noisy opacities keep this distance from 0 and 1, so that their logits are finite."""


def image_noise(image: np.ndarray, *, sigma: float, seed: int) -> np.ndarray:
    """Gaussian noise, independent between pixels and channels.

    Args:
        image: In [0, 1], shape (H, W, 3).
        sigma: Standard deviation, in units of the full range.
        seed: What chance follows.

    Returns:
        The noisy image, clipped to [0, 1], shape (H, W, 3) float32.
    """
    from skimage.util import random_noise

    noisy = random_noise(np.asarray(image), mode="gaussian", rng=seed, var=sigma**2)
    return np.asarray(noisy, np.float32)


def image_blur(image: np.ndarray, *, sigma: float) -> np.ndarray:
    """A Gaussian blur of each channel.

    Args:
        image: In [0, 1], shape (H, W, 3).
        sigma: Standard deviation of the kernel in pixels.

    Returns:
        The blurred image, shape (H, W, 3) float32.
    """
    from skimage.filters import gaussian

    return np.asarray(gaussian(np.asarray(image), sigma, channel_axis=-1), np.float32)


def scale_noise(gaussians: Gaussians, *, sigma: float, seed: int) -> Gaussians:
    """Multiplies the scales by log-normal noise, independent between axes.

    Args:
        gaussians: N Gaussians.
        sigma: Standard deviation of what is added to the log scales.
        seed: What chance follows.

    Returns:
        N Gaussians that differ in `log_scales`; a scale of 0 stays 0.
    """
    noise = np.random.default_rng(seed).normal(0, sigma, gaussians.log_scales.shape)
    noisy = np.asarray(gaussians.log_scales, np.float64) + noise
    return dataclasses.replace(gaussians, log_scales=noisy.astype(np.float32))


def opacity_noise(gaussians: Gaussians, *, sigma: float, seed: int) -> Gaussians:
    """Adds Gaussian noise to the opacities, not to their logits.

    Args:
        gaussians: N Gaussians; infinite logits are opacities of 0 and 1.
        sigma: Standard deviation of what is added to the opacities in [0, 1].
        seed: What chance follows.

    Returns:
        N Gaussians that differ in `logit_opacities`, which are finite; opacities that the noise
        drives out of [0, 1] end just inside it. What is not a number stays so.
    """
    from scipy.special import expit, logit

    opacities = expit(np.asarray(gaussians.logit_opacities, np.float64))
    noisy = opacities + np.random.default_rng(seed).normal(0, sigma, opacities.shape)
    noisy = logit(np.clip(noisy, OPACITY_MARGIN, 1 - OPACITY_MARGIN))
    return dataclasses.replace(gaussians, logit_opacities=noisy.astype(np.float32))


class Distorted:
    """A 2D detector that is shown distorted images."""

    needs_image = True

    def __init__(self, detector: Any, distort: Callable[..., np.ndarray], *, seed: int = 0) -> None:
        """Wraps a detector.

        Args:
            detector: What `locate` accepts: a detector, a function or masks by camera name.
            distort: Called as `distort(image, seed=...)`, with another seed for each camera.
            seed: What chance follows, with the name of the camera: the order of the views and
                which of them are looked at do not matter.
        """
        self.detector: Detector = as_detector(detector)
        self.distort = distort
        self.seed = seed

    @property
    def warnings(self) -> Sequence[str]:
        """What the wrapped detector warns of."""
        return getattr(self.detector, "warnings", ())

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """The cameras that the wrapped detector has something to say on."""
        return self.detector.select(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """What the wrapped detector says of the distorted image.

        Args:
            image: In [0, 1], shape (H, W, 3).
            camera: The view.

        Returns:
            Probability of tampering, as the wrapped detector gives it.

        Raises:
            ValueError: if there is no image.
        """
        if image is None:
            raise ValueError(f"view {camera.name!r}: there is no image to distort")
        # Python's own hash of a string differs from process to process.
        own = np.random.SeedSequence([self.seed, zlib.crc32(camera.name.encode())])
        return self.detector(self.distort(image, seed=int(own.generate_state(1)[0])), camera)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Distortion:
    """What is distorted, and how; nothing by default.

    Attributes:
        image: Called as `image(pixels, seed=...)` on what the detector is shown.
        model: Called as `model(gaussians, seed=...)` on the scene.
    """

    image: Callable[..., np.ndarray] | None = None
    model: Callable[..., Gaussians] | None = None

    def of_model(self, gaussians: Gaussians, *, seed: int) -> Gaussians:
        """The distorted scene, of as many Gaussians in the same order."""
        return gaussians if self.model is None else self.model(gaussians, seed=seed)

    def of_detector(self, detector: Any, *, seed: int) -> Detector:
        """The detector, shown distorted images if there is something to distort in them."""
        if self.image is None:
            return as_detector(detector)
        return Distorted(detector, self.image, seed=seed)


def _blur(image: np.ndarray, *, sigma: float, seed: int) -> np.ndarray:
    del seed
    return image_blur(image, sigma=sigma)


DISTORTIONS: Mapping[str, Distortion] = {
    "none": Distortion(),
    "noise": Distortion(image=partial(image_noise, sigma=0.05)),
    "blur": Distortion(image=partial(_blur, sigma=1.5)),
    "scales": Distortion(model=partial(scale_noise, sigma=0.1)),
    "opacities": Distortion(model=partial(opacity_noise, sigma=0.1)),
}
"""The rows of Table 2: images with noise of 0.05 or blurred by 1.5 pixels, log scales with noise of
0.1, opacities with noise of 0.1."""
