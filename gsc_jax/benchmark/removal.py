"""Removal: delete a region and fill the hole with copies of its surroundings.

A quadratic surface is fitted through the surroundings and across the hole, and the hole is covered
at their density. The surroundings are mirrored at the edge of the hole: a point at t times the
distance of the edge from the centre copies its attributes, and its height over the surface, from
the Gaussian nearest to 1 + 0.6 (1 - t) times that distance. The copies are the tampered part.
"""

import dataclasses

import numpy as np
from scipy.spatial import KDTree

from gsc_jax.benchmark import regions
from gsc_jax.scene import Gaussians
from gsc_jax.scene.gaussians import concatenate

CANDIDATES = 8
"""Regions of which the one that is easiest to fill is removed."""
SECTORS = 24
"""Angular sectors in which the edge of a hole is measured: 15 degrees each."""
SECTOR_BOUNDS = np.linspace(-np.pi, np.pi, SECTORS + 1)
SECTOR_MIDDLES = SECTOR_BOUNDS[1:] - np.pi / SECTORS
MAX_SOURCE_DISTANCE = 1.6
"""Distance from the centre of the farthest Gaussian to copy, in multiples of that of the edge."""
MAX_HEIGHT = 0.15
"""Heights over the surface, in radii of the hole, are clipped here when holes are compared."""
NOISE = 0.03
"""Standard deviation of the noise on log scales and base colours of copies: no two are equal."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Hole:
    """A region in the coordinates of a smooth surface through its surroundings.

    Coordinates, with axes in the rows of `frame`, are in radii of the region about its centre; the
    third is normal to the surface, a quadratic of the others with coefficients (6,), and relative
    to it in the coordinates of the ring (B, 3) and of the region, `rows` (M, 3).
    """

    region: regions.Region
    frame: np.ndarray
    surface: np.ndarray
    ring: np.ndarray
    rows: np.ndarray

    @property
    def in_surface(self) -> np.ndarray:
        """Mask of the Gaussians of the ring that lie in the surface, shape (B,)."""
        heights = np.abs(self.ring[:, 2])
        return heights <= min(3 * _robust_deviation(heights), MAX_HEIGHT)

    @property
    def sector_counts(self) -> tuple[np.ndarray, np.ndarray]:
        """Gaussians in the surface per inner and outer sector of the ring, and sector areas."""
        radii, angles = _polar(self.ring[self.in_surface])
        edge = _edge_radius(self.rows, angles)
        bounds = np.array([1, (1 + MAX_SOURCE_DISTANCE) / 2, MAX_SOURCE_DISTANCE])
        counts = np.histogram2d(radii / edge, angles, bins=[bounds, SECTOR_BOUNDS])[0]
        edges = _edge_radius(self.rows, SECTOR_MIDDLES)
        return counts, np.outer(np.diff(bounds**2), edges**2) * np.pi / SECTORS

    @property
    def cost(self) -> float:
        """Difficulty of filling: low for smooth ground on all sides and a flat region."""
        around, within = (np.minimum(abs(x[:, 2]) / MAX_HEIGHT, 1) for x in (self.ring, self.rows))
        radii, angles = _polar(self.ring)
        near = radii < MAX_SOURCE_DISTANCE * _edge_radius(self.rows, angles)
        if not near.any():
            return np.inf
        return float(around[near].mean() + within.mean() / 2 + np.mean(self.sector_counts[0] == 0))


def remove_region(
    gaussians: Gaussians, visibility: regions.Visibility, size: float, rng: np.random.Generator
) -> regions.ProposedEdit:
    """Remove a region that covers `size`, a median share of the pixels, and fill the hole."""
    seeds = regions.draw_seeds(visibility, CANDIDATES, rng)
    grown = [regions.grow_region(gaussians, visibility, row, size) for row in seeds]
    # Gaussians that no view sees, as inside a cupboard, must not appear in the fill.
    seen = np.any(visibility.pixel_share > 0, axis=0)
    grown = [dataclasses.replace(r, ring=r.ring[seen[r.ring]]) for r in grown]
    holes = [fit_hole(gaussians, r) for r in grown if min(len(r.ring), len(r.rows)) >= 16]
    hole = min(holes, key=lambda hole: hole.cost, default=None)
    if hole is None or not hole.sector_counts[0].any():
        raise regions.EditRejected("nothing surrounds the region")
    fill = fill_hole(gaussians, hole, rng)
    rest = np.delete(np.arange(len(gaussians)), hole.region.rows)
    filled = f"the hole filled with {len(fill):,} copies of its surroundings"
    description = f"{len(hole.rows):,} Gaussians of a region taken away and {filled}"
    scene = concatenate([gaussians.take(rest), fill])
    return regions.ProposedEdit(scene, np.arange(len(scene)) >= len(rest), description, gaussians)


def fit_hole(gaussians: Gaussians, region: regions.Region) -> Hole:
    """Fit a smooth surface through the ring of a region, which must not be empty."""
    means = np.asarray(gaussians.means, np.float64)
    ring, rows = (means[index] - region.center for index in (region.ring, region.rows))
    opacities = np.asarray(gaussians.opacities)[region.ring]
    solid = opacities >= np.median(opacities)
    frame = _main_plane(ring[solid])
    ring, rows = ring @ frame.T / region.radius, rows @ frame.T / region.radius
    surface = _fit_quadratic(ring[solid])
    for points in (ring, rows):
        points[:, 2] -= _quadratic_terms(points[:, :2]) @ surface
    return Hole(region=region, frame=frame, surface=surface, ring=ring, rows=rows)


def fill_hole(gaussians: Gaussians, hole: Hole, rng: np.random.Generator) -> Gaussians:
    """Fill a hole with noisy copies of its ring, mirrored at the edge, at the same density."""
    counts, areas = hole.sector_counts
    density = counts.sum() / areas[counts > 0].sum()
    far = _edge_radius(hole.rows, SECTOR_BOUNDS).max()
    flat = rng.uniform(-far, far, (round(density * (2 * far) ** 2), 2))
    radii, angles = _polar(flat)
    edge = _edge_radius(hole.rows, angles)
    inside = radii < edge
    flat, radii, edge = flat[inside], radii[inside], edge[inside]
    mirrored = edge + (MAX_SOURCE_DISTANCE - 1) * (edge - radii)
    mirrored = flat * (mirrored / np.maximum(radii, 1e-9))[:, None]
    # Off the exact mirror image, so that neighbours do not copy the same Gaussian.
    mirrored += 0.02 * rng.standard_normal(mirrored.shape)
    source = np.flatnonzero(hole.in_surface)
    source = source[KDTree(hole.ring[source, :2]).query(mirrored)[1]]
    points = np.column_stack([flat, hole.ring[source, 2] + _quadratic_terms(flat) @ hole.surface])
    copies = gaussians.take(hole.region.ring[source])
    noise = np.float32(NOISE) * rng.standard_normal((2, len(copies), 3), np.float32)
    sh = np.array(copies.sh)
    sh[:, 0] += noise[0]
    log_scales = np.asarray(copies.log_scales) + noise[1]
    means = (hole.region.center + hole.region.radius * points @ hole.frame).astype(np.float32)
    return dataclasses.replace(copies, means=means, log_scales=log_scales, sh=sh)


def _polar(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the origin and angles in the first two coordinates, shapes (P,)."""
    u, v = points[:, 0], points[:, 1]
    return np.hypot(u, v), np.arctan2(v, u)


def _main_plane(points: np.ndarray) -> np.ndarray:
    """Axes of the plane that contains most points, and its normal last, as rows, shape (3, 3)."""
    kept = np.ones(len(points), bool)
    frame = np.eye(3)
    for _ in range(8):
        middle = np.median(points[kept], axis=0)
        frame = np.linalg.svd(points[kept] - middle, full_matrices=False)[2]
        distance = np.abs((points - middle) @ frame[2])
        kept = distance <= max(np.median(distance), 1e-9)
    return frame


def _quadratic_terms(flat: np.ndarray) -> np.ndarray:
    u, v = flat.T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def _robust_deviation(heights: np.ndarray) -> float:
    """Standard deviation from the median absolute value, positive."""
    return float(1.48 * np.median(np.abs(heights))) + 1e-6


def _fit_quadratic(points: np.ndarray) -> np.ndarray:
    """Coefficients of a quadratic height through points, robust and damped, shape (6,)."""
    rows, heights = _quadratic_terms(points[:, :2]), points[:, 2]
    kept = np.ones(len(rows), bool)
    damping = 0.1 * np.sqrt(len(rows)) * np.diag([0, 0.1, 0.1, 1, 1, 1])
    surface = np.zeros(6)
    for _ in range(5):
        system = np.vstack([rows[kept], damping]), np.append(heights[kept], np.zeros(6))
        surface = np.linalg.lstsq(*system)[0]
        residuals = np.abs(heights - rows @ surface)
        kept = residuals < 2.5 * _robust_deviation(residuals)
    return surface


def _edge_radius(points: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Radius of the edge of points at these angles, smoothed over sectors."""
    radii, directions = _polar(points)
    sector = np.digitize(directions, SECTOR_BOUNDS[1:-1])
    middle = np.quantile(radii, 0.8)
    near = [np.append(radii[sector == index], middle) for index in range(SECTORS)]
    edge = np.array([np.quantile(part, 0.95) for part in near])
    smooth = (np.roll(edge, 1) + 2 * edge + np.roll(edge, -1)) / 4
    return np.interp(angles, SECTOR_MIDDLES, smooth, period=2 * np.pi)
