"""Distortions of images and models, as in the paper's Table 2: noise and blur.

The paper distorts the images that the 2D detector gets (Gaussian noise, blur) and the tampered
model (noise on scales and on opacities). It states no strengths; `DISTORTIONS` has ours. No
Gaussian is added, removed or moved to another row, so the truth per Gaussian stays the same.
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
"""Least distance of noisy opacities from 0 and 1, so that their logits are finite."""


def image_noise(image: np.ndarray, *, sigma: float, seed: int) -> np.ndarray:
    """Add Gaussian noise, independent per pixel and channel, to an image (H, W, 3) in [0, 1]."""
    from skimage.util import random_noise

    noisy = random_noise(np.asarray(image), mode="gaussian", rng=seed, var=sigma**2)
    return np.asarray(noisy, np.float32)


def image_blur(image: np.ndarray, *, sigma: float) -> np.ndarray:
    """Blur the channels of an image (H, W, 3) by a Gaussian of `sigma` pixels."""
    from skimage.filters import gaussian

    return np.asarray(gaussian(np.asarray(image), sigma, channel_axis=-1), np.float32)


def scale_noise(gaussians: Gaussians, *, sigma: float, seed: int) -> Gaussians:
    """Add Gaussian noise, independent per axis, to the log scales; a scale of 0 stays 0."""
    noise = np.random.default_rng(seed).normal(0, sigma, gaussians.log_scales.shape)
    noisy = np.asarray(gaussians.log_scales, np.float64) + noise
    return dataclasses.replace(gaussians, log_scales=noisy.astype(np.float32))


def opacity_noise(gaussians: Gaussians, *, sigma: float, seed: int) -> Gaussians:
    """Add Gaussian noise to the opacities in [0, 1], clipped to finite logits; NaN stays NaN."""
    from scipy.special import expit, logit

    opacities = expit(np.asarray(gaussians.logit_opacities, np.float64))
    noisy = opacities + np.random.default_rng(seed).normal(0, sigma, opacities.shape)
    noisy = logit(np.clip(noisy, OPACITY_MARGIN, 1 - OPACITY_MARGIN))
    return dataclasses.replace(gaussians, logit_opacities=noisy.astype(np.float32))


class Distorted:
    """A 2D detector that gets distorted images."""

    needs_image = True

    def __init__(self, detector: Any, distort: Callable[..., np.ndarray], *, seed: int = 0) -> None:
        """Wrap a detector.

        Args:
            detector: A detector, a function of the image, or probability maps by camera name.
            distort: Called as `distort(image, seed=...)`, with another seed for each camera.
            seed: Seed, combined with the name of the camera, so that the order and the choice of
                the views do not matter.
        """
        self.detector: Detector = as_detector(detector)
        self.distort = distort
        self.seed = seed

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings of the wrapped detector."""
        return getattr(self.detector, "warnings", ())

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """Cameras that the wrapped detector selects."""
        return self.detector.select(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """Probability map of the wrapped detector for the distorted image (H, W, 3)."""
        if image is None:
            raise ValueError(f"view {camera.name!r}: there is no image to distort")
        # Not `hash`, which differs between processes.
        own = np.random.SeedSequence([self.seed, zlib.crc32(camera.name.encode())])
        return self.detector(self.distort(image, seed=int(own.generate_state(1)[0])), camera)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Distortion:
    """A distortion of the images of the detector or of the model; none by default.

    Attributes:
        image: Called as `image(pixels, seed=...)` on the images of the detector.
        model: Called as `model(gaussians, seed=...)` on the scene.
    """

    image: Callable[..., np.ndarray] | None = None
    model: Callable[..., Gaussians] | None = None

    def of_model(self, gaussians: Gaussians, *, seed: int) -> Gaussians:
        """Distort a scene; rows keep their order."""
        return gaussians if self.model is None else self.model(gaussians, seed=seed)

    def of_detector(self, detector: Any, *, seed: int) -> Detector:
        """Wrap a detector so that it gets distorted images."""
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
"""Rows of Table 2: noise of 0.05 on images, blur by 1.5 pixels, noise of 0.1 on log scales and on
opacities."""
