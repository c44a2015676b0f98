"""Edits of a scene at the level of Gaussians, with exact truth.

The three edits of the paper are incorporation, modification and removal. Edits lie where the
cameras look. One is accepted if enough views show it at about the requested size and, for a
modification or removal, if it changes the colour of pixels; otherwise another place is tried.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np

from gsc_jax.benchmark import regions
from gsc_jax.benchmark.incorporation import paste_object
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.modification import modify_region
from gsc_jax.benchmark.regions import VISIBLE_SHARE, EditRejected, ProposedEdit, Visibility
from gsc_jax.benchmark.removal import remove_region
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.scene.parallel import map_views
from gsc_jax.splat import render

Edit = Literal["incorporation", "modification", "removal"]
EDITS: tuple[Edit, ...] = get_args(Edit)
Proposal = Callable[[Gaussians, Visibility, float, np.random.Generator], ProposedEdit]
"""Proposes an edit of a size in a scene, or raises `EditRejected`."""

ATTEMPTS = 8
MIN_VISIBLE_VIEWS = 0.5
"""Least share of the views in which an edit must be visible."""
MIN_COLOUR_CHANGE = 0.03
"""Least mean absolute difference in RGB of a modification or removal where it is visible."""
SIZE_TOLERANCE = 2.5
"""Largest ratio of the size of an edit to the requested size, and of its inverse."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tampered:
    """A tampered scene of N Gaussians, rows shuffled, and its truth.

    `labels` (N,) bool are true where a Gaussian was pasted, changed or filled in, and `visible`
    (V,) is the share of the pixels of each camera that are tampered. `edit` is one of `EDITS`.
    """

    gaussians: Gaussians
    labels: np.ndarray
    edit: str
    description: str
    visible: np.ndarray


def tamper(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    edit: Edit | Gaussians | tuple[Edit, Proposal],
    *,
    size: float = 0.05,
    near: float = NEAR,
    seed: int = 0,
) -> Tampered:
    """Edit a scene where its cameras look.

    Authentic rows equal those of the original to the bit.

    Args:
        gaussians: The authentic scene.
        cameras: Its V cameras, mostly held level: the vertical is the mean of their up vectors.
        edit: "modification", "removal", or for an incorporation the object to paste, upright with
            up = -y; or a kind of edit and a function that proposes one.
        size: Median share of the pixels that the edit should cover in the views that see it.
        near: Near plane in world units.
        seed: Seed of the random choices.

    Raises:
        ValueError: if the edit is unknown, the size is not in (0, 0.5], or the object is unusable.
        InputError: if the cameras do not see the scene, or no attempt gave a visible edit.
    """
    if isinstance(edit, str) and edit not in PROPOSALS:
        raise ValueError(f"edit must be an object or one of {', '.join(PROPOSALS)}, got {edit!r}")
    if not 0 < size <= 0.5:
        raise ValueError(f"size is a share of the pixels in (0, 0.5], got {size}")
    if isinstance(edit, Gaussians):
        kind, make = "incorporation", functools.partial(paste_object, donor=edit)
    else:
        kind, make = (edit, PROPOSALS[edit]) if isinstance(edit, str) else edit
    # The count enters the seed, so that one seed gives different kinds of edit in each scene.
    rng = np.random.default_rng([seed, EDITS.index(kind), len(gaussians)])
    visibility = regions.measure_visibility(gaussians, cameras, near=near)
    reasons = []
    for _ in range(ATTEMPTS):
        try:
            proposed = make(gaussians, visibility, size, rng)
            return _shuffled(proposed, kind, _checked(proposed, cameras, visibility, size), rng)
        except EditRejected as reason:
            reasons.append(str(reason))
    raise InputError(
        f"no {kind} of {100 * size:.3g} % of the pixels came out in {ATTEMPTS} attempts "
        f"({'; '.join(list(dict.fromkeys(reasons))[:3])}); try another size, seed or set of cameras"
    )


PROPOSALS: dict[str, Proposal] = {"modification": modify_region, "removal": remove_region}


def _checked(
    proposed: ProposedEdit, cameras: Sequence[Camera], visibility: Visibility, size: float
) -> np.ndarray:
    """Share of the pixels of each camera that show the edit; raise if it is unsuitable."""
    small, near = [regions.scaled_down(camera) for camera in cameras], visibility.near
    visible = regions.visible_shares(proposed.gaussians, small, proposed.labels, near=near)
    if (seen := np.mean(visible >= VISIBLE_SHARE)) < MIN_VISIBLE_VIEWS:
        raise EditRejected(f"{proposed.description}: seen in {seen:.0%} of the views")
    covers = regions.median_visible_share(visible)
    if not 1 / SIZE_TOLERANCE < covers / size < SIZE_TOLERANCE:
        raise EditRejected(f"{proposed.description}: covers {covers:.1%} of the pixels")
    if proposed.original is not None:
        change = _colour_change(proposed, proposed.original, visibility)
        if change < MIN_COLOUR_CHANGE:
            raise EditRejected(f"{proposed.description}: changes the colours by {change:.3f} only")
    return visible


def _colour_change(proposed: ProposedEdit, original: Gaussians, visibility: Visibility) -> float:
    """Mean absolute difference in RGB inside the edit, over the views that see it."""

    def change(camera: Camera) -> float:
        near = visibility.near
        inside = truth_mask(proposed.gaussians, camera, proposed.labels, near=near)
        if inside.mean() < VISIBLE_SHARE:
            return np.nan
        scenes = proposed.gaussians, original
        images = (np.asarray(render(scene, camera, near=near)[0]) for scene in scenes)
        return float(np.abs(np.subtract(*images))[inside].mean())

    values = np.array([*map_views(change, visibility.cameras[::2])])
    return float(values[np.isfinite(values)].mean()) if np.isfinite(values).any() else 0.0


def _shuffled(
    proposed: ProposedEdit, edit: str, visible: np.ndarray, rng: np.random.Generator
) -> Tampered:
    order = rng.permutation(len(proposed.labels))
    views = f"{np.count_nonzero(visible >= VISIBLE_SHARE)} of {len(visible)} views that see it"
    size = f"{regions.median_visible_share(visible):.1%} of the pixels in the median of the {views}"
    text = f"{edit.capitalize()}: {proposed.description}; it covers {size}."
    scene, labels = proposed.gaussians.take(order), proposed.labels[order]
    return Tampered(gaussians=scene, labels=labels, edit=edit, description=text, visible=visible)
