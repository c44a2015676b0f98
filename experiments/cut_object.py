"""Compact objects cut out of a scene, to be pasted into another one."""

from collections.abc import Sequence

import numpy as np

from gsc_jax.benchmark.incorporation import extent, foot_of, rotation_between, transformed
from gsc_jax.benchmark.regions import (
    OBJECT_CONTRAST,
    draw_seeds,
    grow_region,
    measure_visibility,
)
from gsc_jax.benchmark.tamper import EDITS
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Camera, Gaussians

CANDIDATES = 5
"""Regions of which the thickest for its width is cut."""
OBJECT_SIZE = 0.06
"""Median share of the pixels that a candidate covers."""
ROUGH = 0.3
"""Gaussians of the surroundings that a rough cut leaves on an object, relative to its own."""


def cut_object(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    *,
    near: float = NEAR,
    seed: int = 0,
    rough: bool = False,
) -> Gaussians:
    """Cut a compact object out of a scene.

    Args:
        gaussians: The scene.
        cameras: Its cameras, mostly held level.
        near: Near plane in world units.
        seed: Seed of the random choice of candidates.
        rough: Leave some of the surroundings on the object.

    Returns:
        The thickest of a few regions in view; upright with up = -y, its foot at y = 0 and centred
        in x and z.

    Raises:
        InputError: if the cameras do not see the scene, or only objects of a few Gaussians.
    """
    rng = np.random.default_rng([seed, len(EDITS)])
    visibility = measure_visibility(gaussians, cameras, near=near)
    regions = [
        grow_region(gaussians, visibility, row, OBJECT_SIZE, contrast=OBJECT_CONTRAST)
        for row in draw_seeds(visibility, CANDIDATES, rng)
    ]
    best = max(regions, key=lambda region: _thickness(gaussians.take(np.sort(region.rows))))
    # The ring begins with the Gaussians nearest to the seed of the region.
    more = best.ring[: int(rough * ROUGH * len(best.rows))]
    return set_upright(gaussians.take(np.sort(np.append(best.rows, more))), visibility.up)


def set_upright(donor: Gaussians, up: np.ndarray) -> Gaussians:
    """Rotate an object so that `up` becomes -y, and move the middle of its foot to the origin."""
    rotation = rotation_between(up, np.array([0, -1.0, 0]))
    upright = transformed(donor, rotation, 1.0, np.zeros(3))
    return transformed(upright, np.eye(3), 1.0, -foot_of(*extent(upright)))


def _thickness(donor: Gaussians) -> float:
    """Smallest over largest standard deviation of the centres: 0 for a sheet, 1 for a ball."""
    means = np.asarray(donor.means, np.float64)
    spread = np.linalg.svd(means - means.mean(axis=0), compute_uv=False)
    return float(spread[-1] / max(spread[0], 1e-12))
