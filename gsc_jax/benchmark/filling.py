"""Removal: a region taken away, and the hole closed by copies of what surrounds it.

A smooth surface is laid through the surroundings and across the hole, and the hole is covered as
densely as they are. They are mirrored inwards at its edge: what is t times as far from the middle
as the edge takes its attributes, and its height over the surface, from what lies nearest to
1 + 0.6 (1 - t) times. That continues colours and patterns without a seam. The copies are the
tampered part.
"""

import dataclasses

import numpy as np

from gsc_jax.benchmark.draft import Draft, Unsuitable
from gsc_jax.benchmark.regions import Region, Sight, grow, pick
from gsc_jax.benchmark.scenes import concatenate
from gsc_jax.scene import Gaussians

CANDIDATES = 8
"""Regions that an attempt chooses from."""
SECTORS = 24
"""Directions in which the edge of a hole is measured."""
REACH = 1.6
"""How far from the middle the farthest copies come from, in multiples of the edge."""
STEEP = 0.15
"""A height over the surface, in radii of the hole, that is as bad as any higher one."""
NOISE = 0.03
"""Standard deviation of what is added to the log scales and plain colours of copies."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Hole:
    """A region as it lies on a smooth surface through its surroundings.

    Coordinates are in radii of the region about its middle, the third across the surface.

    Attributes:
        region: What is to be taken away.
        frame: Axes of the coordinates as rows, shape (3, 3).
        surface: Coefficients of the height, a quadratic of the first two coordinates, shape (6,).
        ring: Coordinates of the ring, the third counted from the surface, shape (B, 3).
        rows: Those of the region, shape (M, 3).
    """

    region: Region
    frame: np.ndarray
    surface: np.ndarray
    ring: np.ndarray
    rows: np.ndarray

    @property
    def level(self) -> np.ndarray:
        """Members of the ring that lie in its surface rather than stand on it, shape (B,)."""
        heights = np.abs(self.ring[:, 2])
        return heights <= min(3 * _spread(heights), STEEP)

    @property
    def sides(self) -> tuple[np.ndarray, np.ndarray]:
        """How many level members of the ring lie on each side, inner and outer, and its area."""
        place, angles = _polar(self.ring[self.level])
        edge = _edge(self.rows, angles)
        rings = np.array([1, (1 + REACH) / 2, REACH])
        counts = np.histogram2d(place / edge, angles, bins=[rings, _bounds()])[0]
        middles = _bounds()[1:] - np.pi / SECTORS
        areas = np.outer(np.diff(rings**2), _edge(self.rows, middles) ** 2) * np.pi / SECTORS
        return counts, areas

    @property
    def cost(self) -> float:
        """Low where there is smooth ground on all sides and no other face is torn away with it.

        The mean height around, where heights are in units of `STEEP` and at most 1, plus half of
        that within, plus the share of the sides without ground.
        """
        around, within = (np.minimum(np.abs(x[:, 2]) / STEEP, 1) for x in (self.ring, self.rows))
        place, angles = _polar(self.ring)
        near = place < REACH * _edge(self.rows, angles)
        if not near.any():
            return np.inf
        return float(around[near].mean() + within.mean() / 2 + np.mean(self.sides[0] == 0))


def removed(gaussians: Gaussians, sight: Sight, size: float, rng: np.random.Generator) -> Draft:
    """Take a region out of a scene and close the hole.

    Args:
        gaussians: N Gaussians of the scene.
        sight: What the cameras see of them.
        size: Median share of the pixels that the region covers.
        rng: Source of randomness.

    Returns:
        The Gaussians that are left, then those that fill the hole.

    Raises:
        Unsuitable: if next to nothing surrounds any of the regions tried.
    """
    regions = [grow(gaussians, sight, row, size) for row in pick(sight, CANDIDATES, rng)]
    # What nobody sees, as the inside of a cupboard, is not to come to light in the fill.
    seen = np.any(sight.shares > 0, axis=0)
    regions = [dataclasses.replace(r, ring=r.ring[seen[r.ring]]) for r in regions]
    holes = [hole_of(gaussians, r) for r in regions if min(len(r.ring), len(r.rows)) >= 16]
    hole = min(holes, key=lambda hole: hole.cost, default=None)
    if hole is None or not hole.sides[0].any():
        raise Unsuitable("nothing surrounds the region")
    fill = filling(gaussians, hole, rng)
    rest = np.delete(np.arange(len(gaussians)), hole.region.rows)
    what = (
        f"{len(hole.rows):,} Gaussians of a region taken away and the hole filled with "
        f"{len(fill):,} copies of its surroundings"
    )
    scene = concatenate([gaussians.take(rest), fill])
    return Draft(scene, np.arange(len(scene)) >= len(rest), what, gaussians)


def hole_of(gaussians: Gaussians, region: Region) -> Hole:
    """Lay a smooth surface through the ring of a region, which must not be empty."""
    means = np.asarray(gaussians.means, np.float64)
    ring, rows = (means[index] - region.center for index in (region.ring, region.rows))
    opacities = np.asarray(gaussians.opacities)[region.ring]
    solid = opacities >= np.median(opacities)
    frame = _main_plane(ring[solid])
    ring, rows = ring @ frame.T / region.radius, rows @ frame.T / region.radius
    surface = _smooth_surface(ring[solid])
    for points in (ring, rows):
        points[:, 2] -= _quadratic(points[:, :2]) @ surface
    return Hole(region=region, frame=frame, surface=surface, ring=ring, rows=rows)


def filling(gaussians: Gaussians, hole: Hole, rng: np.random.Generator) -> Gaussians:
    """What closes a hole, as densely as its surroundings are.

    Args:
        gaussians: N Gaussians, the region among them.
        hole: What is to be closed.
        rng: Source of randomness.

    Returns:
        Copies of the ring, mirrored at the edge of the hole, with a little noise.
    """
    from scipy.spatial import KDTree

    source = np.flatnonzero(hole.level)
    flat = _even_places(hole, rng)
    place, angles = _polar(flat)
    edge = _edge(hole.rows, angles)
    mirrored = edge + (REACH - 1) * (edge - place)
    mirrored = flat * (mirrored / np.maximum(place, 1e-9))[:, None]
    # A little apart from the exact mirror image, or neighbours would all be the same one's copies.
    mirrored += 0.02 * rng.standard_normal(mirrored.shape)
    source = source[KDTree(hole.ring[source, :2]).query(mirrored)[1]]
    points = np.column_stack([flat, hole.ring[source, 2] + _quadratic(flat) @ hole.surface])
    copies = gaussians.take(hole.region.ring[source])
    noise = np.float32(NOISE) * rng.standard_normal((2, len(copies), 3), np.float32)
    sh = np.array(copies.sh)
    sh[:, 0] += noise[0]
    return dataclasses.replace(
        copies,
        means=(hole.region.center + hole.region.radius * points @ hole.frame).astype(np.float32),
        log_scales=np.asarray(copies.log_scales) + noise[1],
        sh=sh,
    )


def _even_places(hole: Hole, rng: np.random.Generator) -> np.ndarray:
    """Places all over the footprint of a hole, as dense as the ring, shape (P, 2)."""
    counts, areas = hole.sides
    density = counts.sum() / areas[counts > 0].sum()
    far = _edge(hole.rows, _bounds()).max()
    flat = rng.uniform(-far, far, (round(density * (2 * far) ** 2), 2))
    radius, angles = _polar(flat)
    return flat[radius < _edge(hole.rows, angles)]


def _polar(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the middle and angles, shapes (P,)."""
    u, v = points[:, 0], points[:, 1]
    return np.hypot(u, v), np.arctan2(v, u)


def _bounds() -> np.ndarray:
    """Angles between the sectors, shape (SECTORS + 1,)."""
    return np.linspace(-np.pi, np.pi, SECTORS + 1)


def _main_plane(points: np.ndarray) -> np.ndarray:
    """Axes in the plane that most points lie in, and across it, as rows, shape (3, 3)."""
    kept = np.ones(len(points), bool)
    frame = np.eye(3)
    for _ in range(8):
        middle = np.median(points[kept], axis=0)
        frame = np.linalg.svd(points[kept] - middle, full_matrices=False)[2]
        off = np.abs((points - middle) @ frame[2])
        kept = off <= max(np.median(off), 1e-9)
    return frame


def _quadratic(flat: np.ndarray) -> np.ndarray:
    u, v = flat.T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def _spread(heights: np.ndarray) -> float:
    """A standard deviation that things that stand on the surface do not move."""
    return float(1.48 * np.median(np.abs(heights))) + 1e-6


def _smooth_surface(points: np.ndarray) -> np.ndarray:
    """The quadratic height through points, robust and rather flat, shape (6,)."""
    rows, heights = _quadratic(points[:, :2]), points[:, 2]
    kept = np.ones(len(rows), bool)
    damping = 0.1 * np.sqrt(len(rows)) * np.diag([0, 0.1, 0.1, 1, 1, 1])
    surface = np.zeros(6)
    for _ in range(5):
        system = np.vstack([rows[kept], damping]), np.append(heights[kept], np.zeros(6))
        surface = np.linalg.lstsq(*system)[0]
        off = np.abs(heights - rows @ surface)
        kept = off < 2.5 * _spread(off)
    return surface


def _edge(points: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """How far points reach from the middle at these angles, smoothly."""
    radii, turns = _polar(points)
    centers = _bounds()[1:] - np.pi / SECTORS
    sector = np.digitize(turns, _bounds()[1:-1])
    middle = np.quantile(radii, 0.8)
    reach = np.array(
        [np.quantile(np.append(radii[sector == s], middle), 0.95) for s in range(SECTORS)]
    )
    smooth = (np.roll(reach, 1) + 2 * reach + np.roll(reach, -1)) / 4
    return np.interp(angles, centers, smooth, period=2 * np.pi)
