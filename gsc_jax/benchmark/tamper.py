"""Real scenes tampered with at the level of Gaussians, so that the truth is exact.

The three edits of the paper: an object from elsewhere is stood into the scene (incorporation), a
compact region is given other colours, texture, size or shape (modification), a region is taken away
and the hole closed with copies of its surroundings, which then are the tampered part (removal).
Everything happens where the cameras look. An edit counts only if enough views show it at about the
size that was asked for, and a modification or removal only if the colours of pixels change;
otherwise another place is tried.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from gsc_jax.benchmark.changing import modified
from gsc_jax.benchmark.draft import Draft, Unsuitable, visible_shares
from gsc_jax.benchmark.filling import removed
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.pasting import incorporated, set_upright, transformed
from gsc_jax.benchmark.regions import (
    CONTRAST,
    VISIBLE,
    Sight,
    grow,
    look,
    over_views,
    pick,
    scaled_down,
    typical_share,
)
from gsc_jax.render.projection import NEAR
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import render

__all__ = ["EDITS", "Edit", "Tampered", "cut_object", "tamper", "transformed"]

Edit = Literal["incorporation", "modification", "removal"]
EDITS: tuple[Edit, ...] = get_args(Edit)

ATTEMPTS = 8
THINGS = 5
"""Regions from which an object to be cut is chosen, and how much of the views it fills."""
THING_SIZE = 0.06
MIN_VIEWS = 0.5
"""The share of the views that must see an edit."""
MIN_DIFFERENCE = 0.03
"""Mean absolute difference in RGB that a change or removal must make where it is seen."""
SIZE_FACTOR = 2.5
"""An edit may be larger or smaller than it was wanted by this factor."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tampered:
    """A tampered scene and the truth.

    Attributes:
        gaussians: N Gaussians, rows shuffled.
        labels: True where a Gaussian was pasted, changed or filled in, shape (N,) bool.
        edit: One of `EDITS`.
        description: What was done, in a sentence.
        visible: The share of the pixels of each camera that show something tampered, shape (V,).
    """

    gaussians: Gaussians
    labels: np.ndarray
    edit: str
    description: str
    visible: np.ndarray


def tamper(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    edit: Edit,
    *,
    donor: Gaussians | None = None,
    size: float = 0.05,
    near: float = NEAR,
    seed: int = 0,
) -> Tampered:
    """Tamper with a scene where its cameras look.

    Args:
        gaussians: The authentic scene.
        cameras: Its cameras, V of them, mostly held level: the vertical is taken from them.
        edit: One of `EDITS`.
        donor: The object to paste, upright with up = -y, of any place, scale and degree; for an
            incorporation, and only for it.
        size: Median share of the pixels that the edit is to cover in the views that see it.
        near: Near plane in world units.
        seed: What chance follows.

    Returns:
        The tampered scene. Authentic rows are those of the original, bit by bit.

    Raises:
        ValueError: if the edit is unknown, the size is not in (0, 0.5], or the donor is missing
            or of no use.
        InputError: if the cameras do not see the scene, or no attempt gave a visible edit.
    """
    if edit not in EDITS:
        raise ValueError(f"edit must be one of {', '.join(EDITS)}, got {edit!r}")
    if not 0 < size <= 0.5:
        raise ValueError(f"size is a share of the pixels in (0, 0.5], got {size}")
    if (donor is not None) != (edit == "incorporation"):
        need = "needs a donor to paste" if donor is None else "has no use for a donor"
        raise ValueError(f"{edit} {need}")
    check_views(gaussians, cameras, near=near)
    # With the count, so that one seed does not mean one kind of edit in all scenes.
    rng = np.random.default_rng([seed, EDITS.index(edit), len(gaussians)])
    sight = _looked(gaussians, cameras, near)
    tried = []
    for _ in range(ATTEMPTS):
        try:
            if donor is not None:
                draft = incorporated(gaussians, sight, donor, size, rng)
            else:
                make = modified if edit == "modification" else removed
                draft = make(gaussians, sight, size, rng)
            visible = _checked(draft, cameras, sight, size)
        except Unsuitable as reason:
            tried.append(str(reason))
            continue
        return _shuffled(draft, edit, visible, rng)
    raise InputError(
        f"no {edit} of {100 * size:.3g} % of the pixels came out in {ATTEMPTS} attempts "
        f"({'; '.join(list(dict.fromkeys(tried))[:3])}); try another size, seed or set of cameras"
    )


def cut_object(
    gaussians: Gaussians, cameras: Sequence[Camera], *, near: float = NEAR, seed: int = 0
) -> Gaussians:
    """Cut a compact thing out of a scene, to be pasted into another one.

    Args:
        gaussians: The scene.
        cameras: Its cameras, mostly held level.
        near: Near plane in world units.
        seed: What chance follows.

    Returns:
        Of a few regions that the cameras look at the one that is most of a body and least of a
        sheet; upright with up = -y, its foot at y = 0 and centred in x and z.

    Raises:
        InputError: if the cameras do not see the scene.
    """
    check_views(gaussians, cameras, near=near)
    rng = np.random.default_rng([seed, len(EDITS)])
    sight = _looked(gaussians, cameras, near)
    seeds = pick(sight, THINGS, rng)
    regions = [grow(gaussians, sight, row, THING_SIZE, contrast=CONTRAST) for row in seeds]
    things = [gaussians.take(np.sort(region.rows)) for region in regions]
    return set_upright(max(things, key=_bodiness), sight.up)


def _looked(gaussians: Gaussians, cameras: Sequence[Camera], near: float) -> Sight:
    sight = look(gaussians, cameras, near=near)
    if not sight.focus.any():
        raise InputError("the cameras see nothing opaque near the middle of their images")
    return sight


def _checked(draft: Draft, cameras: Sequence[Camera], sight: Sight, size: float) -> np.ndarray:
    """The share of each camera that shows the edit."""
    small = [scaled_down(camera) for camera in cameras]
    visible = visible_shares(draft.gaussians, small, draft.labels, near=sight.near)
    seen = np.mean(visible >= VISIBLE)
    if seen < MIN_VIEWS:
        raise Unsuitable(f"{draft.what}: seen in {seen:.0%} of the views")
    covers = typical_share(visible)
    if not 1 / SIZE_FACTOR < covers / size < SIZE_FACTOR:
        raise Unsuitable(f"{draft.what}: covers {covers:.1%} of the pixels")
    if draft.original is not None:
        differs = _difference(draft, draft.original, sight)
        if differs < MIN_DIFFERENCE:
            raise Unsuitable(f"{draft.what}: changes the colours by {differs:.3f} only")
    return visible


def _difference(draft: Draft, original: Gaussians, sight: Sight) -> float:
    """Mean absolute difference in RGB inside the edit, over the views that see it."""

    def differs(camera: Camera) -> float:
        inside = truth_mask(draft.gaussians, camera, draft.labels, near=sight.near)
        if inside.mean() < VISIBLE:
            return np.nan
        scenes = draft.gaussians, original
        images = (np.asarray(render(scene, camera, near=sight.near)[0]) for scene in scenes)
        return float(np.abs(np.subtract(*images))[inside].mean())

    values = np.array(over_views(differs, sight.cameras[::2]))
    return float(values[np.isfinite(values)].mean()) if np.isfinite(values).any() else 0.0


def _shuffled(draft: Draft, edit: str, visible: np.ndarray, rng: np.random.Generator) -> Tampered:
    order = rng.permutation(len(draft.labels))
    seeing = np.count_nonzero(visible >= VISIBLE)
    return Tampered(
        gaussians=draft.gaussians.take(order),
        labels=draft.labels[order],
        edit=edit,
        description=f"{edit.capitalize()}: {draft.what}; it covers {typical_share(visible):.1%} "
        f"of the pixels in the median of the {seeing} of {len(visible)} views that see it.",
        visible=visible,
    )


def _bodiness(thing: Gaussians) -> float:
    """How thick a thing is for its width: 0 for a sheet, 1 for a ball."""
    means = np.asarray(thing.means, np.float64)
    spread = np.linalg.svd(means - means.mean(axis=0), compute_uv=False)
    return float(spread[-1] / max(spread[0], 1e-12))
