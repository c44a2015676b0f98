"""An independent float64 renderer in NumPy, written from the equations, as a reference for tests.

It shares no code with gsc_jax and follows the INRIA rasteriser (Kerbl et al. 2023; Zwicker et al.
2001): one Gaussian at a time over all pixels, with the matrix W of blending weights stored in full.
Harmonics come from associated Legendre functions.

Float32 and float64 may decide differently whether an alpha is below 1/255, whether a pixel stops,
and which of two nearly equal depths is first. `Blending.slack` bounds how far a pixel may change
when such a decision flips; it is 0 on pixels where no decision is close.
"""

import dataclasses
from math import factorial, pi, sqrt
from typing import SupportsIndex

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit, lpmv

MIN_ALPHA, MAX_ALPHA, STOP, LOW_PASS = 1 / 255, 0.99, 1e-4, 0.3
CLOSE_ALPHA = 3e-4
"""Relative distance of alpha from 1/255 within which rounding may flip the cut-off."""
CLOSE_STOP = 1e-3
"""Relative distance of the transmittance from 1e-4 within which rounding may flip the stop."""
CLOSE_DEPTH = 5e-7
"""Difference of depths, relative to the coordinates, within which rounding may flip the order."""


@dataclasses.dataclass(frozen=True)
class Projection:
    """N projected Gaussians: centres in pixels (N, 2), and factors J W R S (N, 2, 3).

    The covariance before the low-pass is the product of the factors with their transpose.
    """

    means: np.ndarray
    factors: np.ndarray
    depths: np.ndarray
    opacities: np.ndarray
    in_front: np.ndarray

    @property
    def covs(self) -> np.ndarray:
        """Covariances in square pixels, (N, 2, 2)."""
        return self.factors @ self.factors.transpose(0, 2, 1) + LOW_PASS * np.eye(2)

    @property
    def extents(self) -> np.ndarray:
        """Half the size of the box around the ellipse alpha = 1/255, (N, 2); 0 without one."""
        reach = 2 * np.log(np.maximum(self.opacities / MIN_ALPHA, 1))
        return np.sqrt(reach[:, None] * np.diagonal(self.covs, axis1=1, axis2=2))


@dataclasses.dataclass(frozen=True)
class Blending:
    """The matrix W (pixels, M) of the Gaussians `ids` that can touch a pixel, front to back.

    `slack` bounds the change of a pixel when rounding flips a decision, (pixels,).
    """

    weights: np.ndarray
    ids: np.ndarray
    slack: np.ndarray
    count: int
    shape: tuple[int, int]

    @property
    def clear(self) -> np.ndarray:
        """Mask of the pixels where no decision is close, (H, W)."""
        return (self.slack == 0).reshape(self.shape)

    @property
    def jump(self) -> np.ndarray:
        """The slack as an image, (H, W)."""
        return self.slack.reshape(self.shape)

    def composite(self, features) -> np.ndarray:
        """W c as an image, (H, W, D)."""
        image = self.weights @ np.asarray(features, np.float64)[self.ids]
        return image.reshape(*self.shape, -1)

    def accumulate(self, maps) -> np.ndarray:
        """W^T m, (N, D)."""
        maps = np.asarray(maps, np.float64)
        sums = np.zeros((self.count, maps.shape[-1]))
        sums[self.ids] = self.weights.T @ maps.reshape(-1, maps.shape[-1])
        return sums


def rotations(quats) -> np.ndarray:
    """Rotation matrices of wxyz quaternions of any length, (N, 3, 3)."""
    return Rotation.from_quat(np.asarray(quats, np.float64), scalar_first=True).as_matrix()


def project(gaussians, camera, *, near=0.2) -> Projection:
    """The EWA projection J W Sigma W^T J^T + 0.3 I."""
    view, K = (np.asarray(x, np.float64) for x in (camera.viewmat, camera.K))
    x, y, z = (np.asarray(gaussians.means, np.float64) @ view[:3, :3].T + view[:3, 3]).T
    in_front = z > near
    z = np.where(in_front, z, 1.0)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    # The ray of the Jacobian is clamped to the field of view plus 15 % of the image on each side.
    wide, high = 0.15 * camera.width / fx, 0.15 * camera.height / fy
    u = np.clip(x / z, -cx / fx - wide, (camera.width - cx) / fx + wide)
    v = np.clip(y / z, -cy / fy - high, (camera.height - cy) / fy + high)
    jacobian = np.zeros((len(z), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 2] = fx / z, -fx * u / z
    jacobian[:, 1, 1], jacobian[:, 1, 2] = fy / z, -fy * v / z
    axes = rotations(gaussians.quats) * np.exp(np.asarray(gaussians.log_scales, float))[:, None]
    return Projection(
        means=np.stack([fx * x / z + cx, fy * y / z + cy], axis=1),
        factors=jacobian @ view[:3, :3] @ axes,
        depths=z,
        opacities=expit(np.asarray(gaussians.logit_opacities, np.float64)),
        in_front=in_front,
    )


def pixel_centers(left: int, top: int, width: int, height: int) -> np.ndarray:
    """Centres of the pixels of a window, row by row, (pixels, 2)."""
    y, x = np.mgrid[top : top + height, left : left + width]
    return np.stack([x.ravel(), y.ravel()], axis=1) + 0.5


def alphas(projection: Projection, i: SupportsIndex, pixels: np.ndarray) -> np.ndarray:
    """min(0.99, o exp(-sigma)) of a Gaussian at every pixel, not cut off, (pixels,)."""
    # The low-pass is added to the squared singular values, so no needle is singular.
    axes, lengths, _ = np.linalg.svd(projection.factors[i])
    along = (pixels - projection.means[i]) @ axes
    sigma = 0.5 * (along**2 / (lengths**2 + LOW_PASS)).sum(axis=1)
    return np.minimum(MAX_ALPHA, projection.opacities[i] * np.exp(-sigma))


def blending(gaussians, camera, *, near=0.2, window=None) -> Blending:
    """The matrix W of a camera, or of a window (left, top, width, height) of its image."""
    left, top, width, height = window or (0, 0, camera.width, camera.height)
    pixels = pixel_centers(left, top, width, height)
    projection = project(gaussians, camera, near=near)
    ids = _front_to_back(projection, pixels)
    coordinates = np.abs(np.asarray(gaussians.means)[ids]).max(initial=0) + np.abs(
        np.asarray(camera.viewmat)[:3, 3]
    ).max(initial=0)
    pixel = _Pixels(len(pixels), close_depth=CLOSE_DEPTH * coordinates)
    weights = np.zeros((len(pixels), len(ids)))
    for column, i in enumerate(ids):
        weights[:, column] = pixel.blend(alphas(projection, i, pixels), float(projection.depths[i]))
    return Blending(weights, ids, pixel.slack, len(projection.depths), (height, width))


def _front_to_back(projection: Projection, pixels: np.ndarray) -> np.ndarray:
    low, high = projection.means - projection.extents, projection.means + projection.extents
    touching = ((low <= pixels.max(0) + 1e-3) & (high >= pixels.min(0) - 1e-3)).all(axis=1)
    opaque = projection.opacities > 0.999 * MIN_ALPHA
    ids = np.flatnonzero(projection.in_front & touching & opaque)
    return ids[np.argsort(projection.depths[ids], kind="stable")]


class _Pixels:
    """State of every pixel while Gaussians are blended one at a time, front to back."""

    def __init__(self, count: int, *, close_depth: float):
        self.transmittance = np.ones(count)
        self.stopped = np.zeros(count, bool)
        self.slack = np.zeros(count)
        self.last_depth = np.full(count, -np.inf)
        self.last_weight = np.zeros(count)
        self.close_depth = close_depth

    def blend(self, alpha: np.ndarray, depth: float) -> np.ndarray:
        """Blend the next Gaussian; return its weight at every pixel."""
        covers = alpha >= MIN_ALPHA
        behind = self.transmittance * (1 - alpha)
        self._note_close_decisions(alpha, behind, depth)
        self.stopped |= covers & (behind < STOP)
        takes = covers & ~self.stopped
        weight = np.where(takes, self.transmittance * alpha, 0.0)
        self.transmittance = np.where(takes, behind, self.transmittance)
        self.last_depth = np.where(takes, depth, self.last_depth)
        self.last_weight = np.where(takes, weight, self.last_weight)
        return weight

    def _note_close_decisions(self, alpha, behind, depth) -> None:
        cut = np.abs(alpha / MIN_ALPHA - 1) < CLOSE_ALPHA
        stop = (alpha >= MIN_ALPHA) & (np.abs(behind / STOP - 1) < CLOSE_STOP)
        swap = (alpha >= MIN_ALPHA) & (depth - self.last_depth < self.close_depth)
        jump = np.where(cut | stop, self.transmittance * alpha, 0.0)
        swapped = self.last_weight * alpha
        jump += np.where(swap & (swapped > 1e-5), swapped, 0.0)
        self.slack += np.where(self.stopped, 0.0, jump)


def harmonics(directions: np.ndarray, degree: int) -> np.ndarray:
    """Real orthonormal harmonics with the Condon-Shortley phase, ordered (l, m = -l..l), (N, K)."""
    x, y, z = directions.T
    azimuth = np.arctan2(y, x)
    values = []
    for band in range(degree + 1):
        for m in range(-band, band + 1):
            k = abs(m)
            norm = sqrt((2 * band + 1) / (4 * pi) * factorial(band - k) / factorial(band + k))
            turn = sqrt(2) * (np.sin(k * azimuth) if m < 0 else np.cos(k * azimuth)) if m else 1.0
            values.append(norm * turn * lpmv(k, band, z))
    return np.stack(values, axis=1)


def colors(gaussians, center) -> np.ndarray:
    """Colours as seen from a point, max(0, 1/2 + sum_k Y_k h_k), (N, 3)."""
    sh = np.asarray(gaussians.sh, np.float64)
    towards = np.asarray(gaussians.means, np.float64) - np.asarray(center, np.float64)
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-30)
    values = harmonics(towards, round(sqrt(sh.shape[1])) - 1)
    return np.maximum(0.5 + np.einsum("nk,nkc->nc", values, sh), 0.0)


def camera_center(camera) -> np.ndarray:
    """Position of the camera, the point that its viewmat maps to the origin, (3,)."""
    return np.linalg.inv(np.asarray(camera.viewmat, np.float64))[:3, 3]


def render(gaussians, camera, *, background=(0.0, 0.0, 0.0), near=0.2, window=None):
    """RGB (H, W, 3), alpha (H, W) and the blending they come from."""
    blend = blending(gaussians, camera, near=near, window=window)
    rgb = blend.composite(colors(gaussians, camera_center(camera)))
    alpha = blend.composite(np.ones((blend.count, 1)))[..., 0]
    rgb = rgb + (1 - alpha)[..., None] * np.asarray(background)
    return np.minimum(rgb, 1.0), alpha, blend
