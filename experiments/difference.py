"""A 2D detector that compares renders with those of the authentic scene.

No forensic detector has the authentic scene. This one exists because simulated detectors read the
truth, so that noise and blur of the image cannot affect them; they do affect this one, since
distortions look like tampering to it and hide it.
"""

from collections.abc import Sequence

import numpy as np

from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import render


class DifferenceDetector:
    """Flags pixels where a render differs from that of the authentic scene.

    Use it where a detector must depend on the pixels, not to measure how well tampering is found:
    no forensic detector has the authentic scene.
    """

    needs_image = True

    def __init__(
        self,
        authentic: Gaussians,
        *,
        level: float = 0.05,
        smooth: float = 2.0,
        width: float = 0.015,
        near: float = NEAR,
    ) -> None:
        """Initialise the detector.

        Args:
            authentic: The scene before the edit.
            level: Smoothed difference in [0, 1] above which a pixel is flagged. Noise of standard
                deviation sigma alone causes a difference of 0.8 sigma.
            smooth: Standard deviation in pixels over which differences are averaged.
            width: Scale of the logistic function of the difference.
            near: Near plane of the images in world units.

        Raises:
            ValueError: if an option is out of its range.
        """
        if not (level >= 0 and smooth >= 0 and width > 0):
            raise ValueError(
                "expected level and smooth of at least 0 and width above 0, got "
                f"{level}, {smooth} and {width}"
            )
        self.authentic = authentic
        self.level, self.smooth, self.width, self.near = level, smooth, width, near

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """All cameras."""
        return list(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """Compute a probability map from the difference to the authentic scene.

        Args:
            image: Render of the scene in question, in [0, 1], shape (H, W, 3).
            camera: The view.

        Returns:
            Probability map, above 0.5 where the smoothed mean absolute difference of the channels
            is above `level`, shape (H, W) float32.

        Raises:
            ValueError: if there is no image, or its size is not that of the view.
        """
        from scipy.ndimage import gaussian_filter
        from scipy.special import expit

        size = (camera.height, camera.width, 3)
        if image is None or image.shape != size:
            found = None if image is None else image.shape
            raise ValueError(f"view {camera.name!r}: expected an image {size}, got {found}")
        original = np.asarray(render(self.authentic, camera, near=self.near)[0])
        difference = np.abs(np.asarray(image, np.float64) - original).mean(axis=-1)
        smoothed = gaussian_filter(difference, self.smooth)
        return expit((smoothed - self.level) / self.width).astype(np.float32)
