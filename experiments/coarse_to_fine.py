"""Coarse to fine: evidence from one blending step per tile, and from all pixels where it matters.

An image a quarter as wide does not take a sixteenth of the time to lift but half or more of it,
because its tiles have longer lists; its low-pass is also four times as wide. So the size of the
image stays. The coarse pass puts each splat into the tile of its centre only: its weight is its
area times its opacity times the transmittance of the splats before it, and the mask counts at
its centre. The fine pass walks all pixels of the tiles that chosen Gaussians touch, with only the
splats that reach these tiles: the evidence of the chosen ones is that of the full image.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np

from gsc_jax.estimators import RobustEstimator
from gsc_jax.estimators.robust.early_stopping import changed
from gsc_jax.evidence.lifting import EvidenceOfViews, SparseEvidence, sparse, view_evidence
from gsc_jax.render.projection import Splats, project
from gsc_jax.render.tiles import TILE, bin_view
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.gaussians import filled_up, transparent_rows
from gsc_jax.scene.parallel import ViewThreads, bounded_map

MIN_FLAGGED = 0.1
"""Flagged share of the coarse visibility of a Gaussian from which all its pixels are observed."""
HALF_WEIGHT = 8.0
"""Weight in pixels at which a view counts one half, as in `robust`."""
MAX_SHARE = 0.6
"""Share of the pixels beyond which all are lifted instead."""
MAX_BYTES = 2**30
"""Size of the evidence that is expanded."""
MAX_DEPTH = 4.0
"""Largest optical depth that one splat adds to its tile: large ones cover many others, too."""


def coarse_evidence(splats: Splats, mask: np.ndarray) -> np.ndarray:
    """Coarse evidence of a view from its splats and mask, (H, W) bool; shape (7, M) int32.

    For each visible Gaussian, as in `sparse`, its row and the bits of its total and its tampered
    weight, then left, top, right and bottom of the tiles that it may touch.
    """
    rows = np.flatnonzero(np.asarray(splats.visible))
    means, covs, whitening, opacities, reach, depths = (
        np.asarray(getattr(splats, name)).take(rows, axis=0)
        for name in ("means", "covs", "whitening", "opacities", "reach", "depths")
    )
    last = np.array(mask.shape[::-1]) - 1
    x, y = np.clip(means, 0, last).astype(np.int32).T
    # The determinant over c comes from the whitening, because a c - b^2 would cancel.
    area = opacities * (2 * np.pi) * np.sqrt(0.5 * covs[:, 2]) / whitening[:, 0]
    tile = y // TILE * (last[0] // TILE + 1) + x // TILE
    total = area * _transmittance(tile, depths, np.minimum(area / TILE**2, MAX_DEPTH))
    total *= mask.size / max(total.sum(), 1e-30)  # the weights of a pixel add up to 1
    extent = np.sqrt(reach[:, None] * covs[:, ::2])
    corners = [np.clip(means + side * extent, 0, last).T // TILE for side in (-1, 1)]
    weights = np.stack([total, total * mask[y, x]]).astype(np.float32)
    return np.concatenate([rows[None], weights.view(np.int32), *corners]).astype(np.int32)


def _transmittance(tile: np.ndarray, depths: np.ndarray, optical: np.ndarray) -> np.ndarray:
    """Transmittance before each splat (M,), behind those of its tile that are closer."""
    order = np.argsort((tile.astype(np.int64) << 32) + depths.view(np.int32))
    before = np.cumsum(optical[order], dtype=np.float64) - optical[order]
    starts = np.flatnonzero(np.diff(tile[order], prepend=-1))
    before -= np.repeat(before[starts], np.diff(starts, append=len(order)))
    result = np.empty(len(order))
    result[order] = np.exp(-before)
    return result


def covered_tiles(boxes: np.ndarray, grid: tuple[int, int]) -> np.ndarray:
    """Tiles, shape `grid` bool, in at least one of the boxes (4, M): left, top, right, bottom."""
    left, top, right, bottom = boxes
    edges = np.zeros((grid[0] + 1, grid[1] + 1), np.int32)
    for y, x, sign in ((top, left, 1), (top, right + 1, -1), (bottom + 1, left, -1)):
        np.add.at(edges, (y, x), sign)
    np.add.at(edges, (bottom + 1, right + 1), 1)
    return edges.cumsum(0).cumsum(1)[:-1, :-1] > 0


def reaching(boxes: np.ndarray, tiles: np.ndarray) -> np.ndarray:
    """Which of the boxes (4, M) contain at least one of the tiles, (rows, columns) bool."""
    sums = np.pad(tiles.cumsum(0, dtype=np.int32).cumsum(1, dtype=np.int32), ((1, 0), (1, 0)))
    left, top, right, bottom = boxes + np.array([[0], [0], [1], [1]], np.int32)
    return sums[bottom, right] - sums[top, right] > sums[bottom, left] - sums[top, left]


class CoarseToFine:
    """V views of N Gaussians, observed coarsely with masks (H, W) bool, by camera name.

    Attributes:
        candidates: Gaussians that the masks flag often enough to be labelled, shape (N,) bool.
    """

    def __init__(
        self, gaussians: Gaussians, cameras: Sequence[Camera], masks: Mapping[str, np.ndarray]
    ) -> None:
        self._cameras, self._masks = cameras, masks
        no_colours = np.zeros((len(gaussians), 1, 3), np.float32)
        self._bare = jax.tree.map(np.asarray, dataclasses.replace(gaussians, sh=no_colours))
        filled = filled_up(self._bare)

        def observe(camera: Camera) -> np.ndarray:
            splats = jax.block_until_ready(project(filled, camera))
            return coarse_evidence(splats, masks[camera.name])

        with ViewThreads(len(gaussians)) as pool:
            self._coarse = list(bounded_map(pool, observe, cameras))
        self.candidates = self._candidates()

    def _candidates(self) -> np.ndarray:
        seen, flagged = np.zeros((2, len(self._bare)), np.float32)
        for rows, *bits in (view[:3] for view in self._coarse):
            total, tampered = (part.view(np.float32) for part in bits)
            inverted = 2 * tampered.sum() > total.sum()
            seen[rows] += total / (total + HALF_WEIGHT)
            flagged[rows] += (total - tampered if inverted else tampered) / (total + HALF_WEIGHT)
        return (flagged > 0) & (flagged >= MIN_FLAGGED * seen)

    def observe(self, rows: np.ndarray, max_share: float) -> tuple[EvidenceOfViews | None, float]:
        """Observe all pixels of the tiles that may touch some Gaussians, (N,) bool.

        Returns the evidence, in which that of all others is coarse, and the share of the pixels; no
        evidence if the share is larger than `max_share`.
        """
        near_rows, covered = [], []
        for camera, view in zip(self._cameras, self._coarse, strict=True):
            grid = -(-camera.height // TILE), -(-camera.width // TILE)
            tiles = covered_tiles(view[3:, rows[view[0]]], grid)
            near_rows.append(view[0, reaching(view[3:], tiles)])
            covered.append((np.count_nonzero(tiles), tiles.size))
        share = float(np.divide(*np.sum(covered, axis=0)))
        if share > max_share:
            return None, share
        # JAX compiles once, since all views get the same number of Gaussians.
        size = max(map(len, near_rows))
        size += transparent_rows(size)

        def refine(index: int) -> np.ndarray:
            return self._refined(index, near_rows[index], rows, size)

        with ViewThreads(len(rows)) as pool:
            entries = list(bounded_map(pool, refine, range(len(near_rows))))
        thin = SparseEvidence(entry=entries.__getitem__, shape=(len(entries), len(rows)))
        return thin.expanded(MAX_BYTES), share

    def _refined(self, index: int, own: np.ndarray, rows: np.ndarray, size: int) -> np.ndarray:
        """Evidence of a view as of `sparse`: from all pixels for `rows`, (N,) bool, else coarse.

        `own` are the Gaussians that reach the tiles of `rows`; they are filled up to `size`.
        """
        camera, coarse = self._cameras[index], self._coarse[index][:3]
        splats = jax.block_until_ready(project(filled_to(self._bare.take(own), size), camera))
        chosen = np.pad(rows[own], (0, size - len(own)))
        view = bin_view(splats, camera, touching=chosen)
        fine = sparse(view_evidence(view, self._masks[camera.name]))
        fine[0] = own[fine[0]]
        joined = np.concatenate([fine[:, rows[fine[0]]], coarse[:, ~rows[coarse[0]]]], axis=1)
        return joined[:, np.argsort(joined[0])]


def filled_to(gaussians: Gaussians, size: int) -> Gaussians:
    """The scene with transparent rows at its end, to `size` Gaussians in total."""
    more = size - len(gaussians)
    filled = jax.tree.map(lambda x: np.pad(x, ((0, more), *[(0, 0)] * (x.ndim - 1))), gaussians)
    filled.logit_opacities[len(gaussians) :] = -np.inf
    return filled


def labels_where_needed(
    views: CoarseToFine, means: np.ndarray, estimator: RobustEstimator
) -> tuple[np.ndarray | None, list[float], float]:
    """Observe all pixels of growing parts of the views until they contain what is labelled.

    Returns labels (N,) bool, the share of the labelled weight outside of the pixels of each step
    (at most the `tolerance` of the estimator in the end), and the share of the pixels. No labels if
    all pixels are needed, because nothing is labelled or because the parts are large.
    """
    rows, outside = views.candidates, []
    while rows.any():
        evidence, pixels = views.observe(rows, MAX_SHARE)
        if evidence is None:
            break
        labels = estimator.estimate_from_evidence(evidence, means).labels
        outside.append(changed(labels & rows, labels, evidence))
        if labels.any() and outside[-1] <= estimator.tolerance:
            return labels, outside, pixels
        rows = rows | labels if labels.any() else np.zeros_like(rows)
    return None, outside, 1.0
