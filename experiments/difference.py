"""A stand-in for a 2D tampering detector that truly looks at pixels: it remembers the original.

It flags where a render differs from the render of the authentic scene. No forensic detector has
that knowledge. It exists because the detectors of `simulate` read the truth and so cannot be
affected by noise or blur of the image; this one is, in the way that matters there: distortions look
like tampering to it, and hide it.
"""

from collections.abc import Sequence

import numpy as np

from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import render


class DifferenceDetector:
    """Flags where a render differs from what the authentic scene looks like from there.

    Not a forensic detector: it is given the authentic scene, which nobody has who needs one. Use it
    where a detector must depend on the pixels, and never to say how well tampering is found.

    Attributes:
        needs_image: True, it compares images.
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
        """Remembers the authentic scene.

        Args:
            authentic: The scene before it was tampered with.
            level: Smoothed difference in [0, 1] above which a pixel is flagged. Noise of standard
                deviation sigma alone amounts to 0.8 sigma, at which a level finds it everywhere.
            smooth: Standard deviation in pixels over which differences are averaged.
            width: Difference over which the probability changes: at `level + width` it is 0.73.
            near: Near plane in world units, that of the images it is shown.

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
        """All the cameras: it can judge any view."""
        return list(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """How surely a render is not one of the authentic scene.

        Args:
            image: Render of the scene in question, in [0, 1], shape (H, W, 3).
            camera: The view.

        Returns:
            Probability of tampering, above 0.5 where the smoothed mean absolute difference
            of the channels is above `level`, shape (H, W) float32.

        Raises:
            ValueError: if there is no image, or it has not the size of the view.
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
