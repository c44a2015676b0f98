"""Removal as the editors make it: delete, inpaint the views of the hole, train Gaussians on them.

SPIn-NeRF (Mirzaei et al. 2023) and Gaussian Grouping (Ye et al. 2024) inpaint images and depths of
the hole, put new Gaussians there, and train them for the images. Here colours and depths are
continued by a biharmonic function, and Gaussians start where one view sees the hole best.
"""

import numpy as np
from optimised import Refinement, refine, renders

from gsc_jax.benchmark import regions
from gsc_jax.benchmark.metrics import rendered_share
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.gaussians import concatenate, with_degree
from gsc_jax.splat import render_features

HOLE_SHARE = 0.2
"""Share of the removed Gaussians in a pixel from which it belongs to the hole."""
MIN_PIXELS = 12
"""Pixels of the hole in the view that sees it best, fewer are rejected."""
MAX_PER_PIXEL = 8
"""New Gaussians per pixel of the hole at most; otherwise as many as were removed."""
MIN_ALPHA = 0.3
"""Opacity of a pixel from which it has a depth."""
OPACITY_LOGIT = 1.0
"""Logit of the opacity that new Gaussians start with."""


def inpaint_region(
    gaussians: Gaussians, visibility: regions.Visibility, size: float, rng: np.random.Generator
) -> regions.ProposedEdit:
    """Remove a region that covers `size`, inpaint the hole, and train Gaussians that fill it.

    The arguments are those of `remove_region`; the views are those of the visibility.
    """
    seed = regions.draw_seeds(visibility, 1, rng)[0]
    region = regions.grow_region(gaussians, visibility, seed, size)
    removed = np.isin(np.arange(len(gaussians)), region.rows)
    cameras, near = visibility.cameras, visibility.near
    rest = gaussians.take(np.flatnonzero(~removed))
    shares = [rendered_share(gaussians, camera, removed, near=near) for camera in cameras]
    holes = np.stack(shares) > HOLE_SHARE
    best = int(holes.sum(axis=(1, 2)).argmax())
    if holes[best].sum() < MIN_PIXELS:
        raise regions.EditRejected(f"a hole of {holes[best].sum()} pixels")
    images = map(continued, renders(rest, cameras, near), holes)
    images = np.clip(np.stack(list(images)), 0, 1).astype(np.float32)
    depth = continued(_log_depth(rest, cameras[best], near), holes[best])
    fill = _unprojected(
        images[best], np.exp(depth), holes[best], cameras[best], int(removed.sum()), rng
    )
    filled = concatenate([rest, with_degree(fill, gaussians.sh_degree)])
    labels = np.arange(len(filled)) >= len(rest)
    options = Refinement(anchor=0.0, near=near, seed=int(rng.integers(2**31)))
    after = refine(filled, cameras, images, rows=labels, options=options)
    description = (
        f"{len(region.rows):,} Gaussians of a region taken away, the hole inpainted in "
        f"{len(cameras)} views, and {len(fill):,} Gaussians trained for them"
    )
    return regions.ProposedEdit(after, labels, description, gaussians)


def continued(values: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """Values (H, W, D) or (H, W) with a smooth continuation in the hole, (H, W) bool."""
    from skimage.restoration import inpaint_biharmonic

    if not hole.any() or hole.all():
        return values
    axis = 2 if values.ndim == 3 else None
    low, high = values[~hole].min(axis=0), values[~hole].max(axis=0)
    return np.clip(inpaint_biharmonic(values, hole, channel_axis=axis), low, high)


def _log_depth(gaussians: Gaussians, camera: Camera, near: float) -> np.ndarray:
    """Logarithm of the mean depth of each pixel, (H, W); the median where hardly any is."""
    viewmat = np.asarray(camera.viewmat)
    depths = np.asarray(gaussians.means) @ viewmat[2, :3] + viewmat[2, 3]
    sums, alpha = map(
        np.asarray, render_features(gaussians, camera, np.maximum(depths, near)[:, None], near=near)
    )
    covered = alpha > MIN_ALPHA
    logs = np.log(np.maximum(sums[..., 0], near) / np.maximum(alpha, MIN_ALPHA))
    return np.where(covered, logs, np.median(logs[covered]) if covered.any() else 0.0)


def _unprojected(
    image: np.ndarray,
    depth: np.ndarray,
    hole: np.ndarray,
    camera: Camera,
    count: int,
    rng: np.random.Generator,
) -> Gaussians:
    """Round Gaussians of the size of their share of a pixel, at the depths (H, W) of the hole."""
    rows, columns = np.nonzero(hole)
    chosen = rng.choice(len(rows), min(count, MAX_PER_PIXEL * len(rows)))
    rows, columns = rows[chosen], columns[chosen]
    K, viewmat = np.asarray(camera.K, np.float64), np.asarray(camera.viewmat, np.float64)
    pixels = np.column_stack([columns, rows]) + rng.random((len(chosen), 2))
    z = depth[rows, columns]
    points = np.column_stack([(pixels - K[:2, 2]) / np.diag(K)[:2], np.ones(len(z))]) * z[:, None]
    spacing = z / K[0, 0] * np.sqrt(len(np.unique(chosen)) / len(chosen))
    return Gaussians(
        means=((points - viewmat[:3, 3]) @ viewmat[:3, :3]).astype(np.float32),
        log_scales=np.log(spacing)[:, None].repeat(3, axis=1).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (len(z), 1)),
        logit_opacities=np.full(len(z), OPACITY_LOGIT, np.float32),
        sh=((image[rows, columns] - 0.5) / Y0)[:, None].astype(np.float32),
    )
