"""Densification of a capture: adaptive density control, relocation (MCMC), and growth by error.

Adaptive density control (Kerbl et al. 2023, section 5) clones small Gaussians and splits large ones
whose centre has a large gradient in the image, and prunes transparent ones. 3DGS-MCMC (Kheradmand
et al. 2024) moves transparent Gaussians to opaque ones such that the image stays, adds 5 % at a
time up to the budget, and disturbs the centres of transparent ones. Growth by error (Rota Bulo et
al. 2024) copies the Gaussians that take part in the wrong pixels, shares their opacity, and lowers
all opacities a little instead of resetting them; it ends by pruning those with the least blending
weights, as LightGaussian does (Fan et al. 2024). Each leaves its own statistics. Rows that are not
in use have an opacity of 0 (a logit of minus infinity).

It departs from the code of these papers in this: large Gaussians are not pruned, all strategies
start with the same scene, and MCMC relocates and adds by one draw, until densification ends.
Growth by error measures errors and blending weights on a few random views, copies a given number
of Gaussians instead of all above a threshold, takes the absolute error of a pixel, and shares the
opacity of Gaussians that it splits, too.
"""

import jax
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import comb, expit, logit

from gsc_jax.scene import Array, Gaussians
from gsc_jax.scene.gaussians import IDENTITY_QUATERNION

RESET_OPACITY = 0.01
"""Largest opacity after a reset, as in the code of 3DGS."""
MIN_OPACITY = 0.005
"""Opacity below which a Gaussian counts as transparent, as in the code of 3DGS and of MCMC."""
MIN_GRADIENT = 2e-4
"""Mean length of the gradient by the centre, in normalised device coordinates, to densify."""
CLONED_SCALE = 0.01
"""Largest scale of a Gaussian that is cloned and not split, in units of the extent (3DGS)."""
SHRINK = 1.6
"""Divisor of the scales in a split (3DGS, section 5.2)."""
GROWTH = 0.05
"""Share of Gaussians that MCMC and growth by error add at a time; shorter trainings add more."""
MAX_COPIES = 51
"""Largest number of copies in eq. 9 of MCMC, as in its code."""
DECAY = 0.001
"""What growth by error takes from each opacity at a time, as in its paper."""
UNIMPORTANT = 0.3
"""Share of the Gaussians that growth by error prunes when densification ends: those with the least
sums of blending weights."""
NOISE = 5e5
"""Size of the noise of MCMC in units of the learning rate of the centres, as in its code."""
NOISY_OPACITY = 0.1
"""Opacity above which the noise of MCMC is below 1e-4 of its size and left out."""


def adapt_density(
    scene: Gaussians,
    gradient: np.ndarray,
    extent: float,
    rng: np.random.Generator,
    among: np.ndarray | None = None,
) -> np.ndarray:
    """Prune, then clone and split into the free rows, in place; the rows that changed, (N,) bool.

    The gradient is the mean length by the centre, shape (N,). Where rows are scarce, the largest
    gradients come first. Rows that are not `among` (N,) bool, by default all, stay as they are.
    """
    among = np.ones(len(scene), bool) if among is None else among
    opacities, scales = expit(scene.logit_opacities), np.exp(scene.log_scales).max(axis=1)
    scene.logit_opacities[among & (opacities < MIN_OPACITY)] = -np.inf
    free = np.flatnonzero(among & np.isneginf(scene.logit_opacities))
    wanted = among & (gradient >= MIN_GRADIENT) & np.isfinite(scene.logit_opacities)
    chosen = np.argsort(-np.where(wanted, gradient, 0), kind="stable")
    chosen = chosen[: min(int(wanted.sum()), len(free))]
    new = free[: len(chosen)]
    copy_rows(scene, chosen, new)
    split = scales[chosen] > CLONED_SCALE * extent
    both = np.concatenate([chosen[split], new[split]])
    _split(scene, both, rng)
    return np.isin(np.arange(len(scene)), np.concatenate([new, both]))


def _split(scene: Gaussians, rows: np.ndarray, rng: np.random.Generator) -> None:
    """Move Gaussians within themselves and shrink them, in place."""
    local = np.exp(scene.log_scales[rows]) * rng.normal(size=(len(rows), 3))
    scene.means[rows] += _rotated(scene.quats[rows], local)
    scene.log_scales[rows] -= np.log(SHRINK)


def grow_by_error(
    scene: Gaussians, error: np.ndarray, extent: float, rng: np.random.Generator, added: int
) -> np.ndarray:
    """Prune, then copy `added` Gaussians of the largest error (N,), in place.

    Two copies with the opacity 1 - sqrt(1 - o) cover together what one did, before large ones are
    split; nearly transparent ones may be pruned next time. Returns the copied rows, (N,) bool.
    """
    opacities, scales = expit(scene.logit_opacities), np.exp(scene.log_scales).max(axis=1)
    opacities = np.where(opacities < MIN_OPACITY, 0, np.maximum(opacities - DECAY, MIN_OPACITY))
    free = np.flatnonzero(opacities == 0)
    chosen = np.argsort(-np.where(opacities > 0, error, -1), kind="stable")
    chosen = chosen[: min(added, len(free), len(scene) - len(free))]
    new, split = free[: len(chosen)], scales[chosen] > CLONED_SCALE * extent
    opacities[chosen] = 1 - np.sqrt(1 - opacities[chosen])
    scene.logit_opacities[:] = logit(np.minimum(opacities, 1 - 1e-6))
    copy_rows(scene, chosen, new)
    _split(scene, np.concatenate([chosen[split], new[split]]), rng)
    return np.isin(np.arange(len(scene)), np.concatenate([chosen, new]))


def prune_unimportant(scene: Gaussians, importance: np.ndarray) -> None:
    """Give up the `UNIMPORTANT` share of the Gaussians in use with the least importance (N,)."""
    used = np.flatnonzero(np.isfinite(scene.logit_opacities))
    order = used[np.argsort(importance[used], kind="stable")]
    scene.logit_opacities[order[: int(UNIMPORTANT * len(used))]] = -np.inf


def relocate(scene: Gaussians, rng: np.random.Generator, added: int) -> np.ndarray:
    """Move transparent Gaussians to opaque ones and add some, in place; the changed rows, (N,)."""
    opacities = expit(scene.logit_opacities)
    used = np.isfinite(scene.logit_opacities)
    alive = opacities >= MIN_OPACITY
    unused = np.flatnonzero(~used)
    targets = np.concatenate([np.flatnonzero(used & ~alive), unused[:added]])
    sources = np.flatnonzero(alive)
    if not len(sources) or not len(targets):
        return np.zeros(len(scene), bool)
    drawn = rng.choice(sources, len(targets), p=opacities[sources] / opacities[sources].sum())
    copies = np.bincount(drawn, minlength=len(scene)) + 1
    rows = np.unique(drawn)
    fewer = np.minimum(copies[rows], MAX_COPIES)
    opacity, ratio = shared_opacity(opacities[rows], fewer)
    scene.logit_opacities[rows] = logit(np.clip(opacity, MIN_OPACITY, 1 - 1e-6))
    scene.log_scales[rows] += np.log(ratio)[:, None]
    copy_rows(scene, drawn, targets)
    return np.isin(np.arange(len(scene)), np.concatenate([rows, targets]))


def shared_opacity(opacity: np.ndarray, copies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Opacity of n copies that together look like one, and the ratio of their scales, both (M,).

    1 - (1 - o)^(1/n), and eq. 9 of Kheradmand et al. (2024), which keeps the sum along a ray.
    """
    new = 1 - (1 - opacity) ** (1 / copies)
    total = np.zeros_like(opacity)
    for i in range(1, int(copies.max(initial=0)) + 1):
        k = np.arange(i)
        terms = comb(i - 1, k) * (-1.0) ** k / np.sqrt(k + 1) * new[:, None] ** (k + 1)
        total += np.where(i <= copies, terms.sum(axis=1), 0)
    return new, opacity / total


def copy_rows(scene: Gaussians, sources: np.ndarray, targets: np.ndarray) -> None:
    """Give the rows `targets` all parameters of the rows `sources`, in place."""
    for leaf in jax.tree.leaves(scene):
        leaf[targets] = leaf[sources]


def reset_opacities(scene: Gaussians) -> np.ndarray:
    """Lower opacities to `RESET_OPACITY`, in place; the changed rows, (N,) bool."""
    high = expit(scene.logit_opacities) > RESET_OPACITY
    scene.logit_opacities[high] = logit(RESET_OPACITY)
    return high


def disturbance(scene: Gaussians, rate: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of MCMC for the centres, (N, 3): along the axes, for nearly transparent Gaussians."""
    opacities = expit(np.asarray(scene.logit_opacities))
    rows = np.flatnonzero((opacities > 0) & (opacities < NOISY_OPACITY))
    log_scales, quats = np.asarray(scene.log_scales)[rows], np.asarray(scene.quats)[rows]
    local = np.exp(2 * log_scales) * rng.normal(size=(len(rows), 3))
    sizes = NOISE * rate * expit(100 * (MIN_OPACITY - opacities[rows]))
    noise = np.zeros((len(scene), 3), np.float32)
    noise[rows] = sizes[:, None] * _rotated(quats, local)
    return noise


def _rotated(quats: Array, vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3), given along the axes of Gaussians, in the world."""
    if not len(vectors):
        return vectors
    quats = np.where(np.any(quats, axis=1, keepdims=True), quats, IDENTITY_QUATERNION)
    return Rotation.from_quat(quats, scalar_first=True).apply(vectors)
