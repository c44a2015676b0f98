"""The tile lists against brute force: all pairs that contribute, no others, in depth order."""

import dataclasses
from typing import SupportsIndex

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from strategies import blobs, camera, needles, random_scene

from gsc_jax.render.projection import project
from gsc_jax.render.tiles import TILE, bin_splats, make_view
from gsc_jax.scene import InputError
from gsc_jax.splat import composite

SIZES = [(1, 1), (15, 17), (33, 1), (17, 33), (64, 48)]
MARGIN = 1e-3
"""Relative distance from alpha 1/255 within which rounding may decide."""


SCENES = {
    "blobs": random_scene(150),
    "faint": dataclasses.replace(random_scene(150), logit_opacities=np.full(150, -5.2, np.float32)),
    "needles": needles(150, length=10.0),
    "long needles": needles(150, length=1e6),
}


def listed(lists, tiles: int, count: int) -> np.ndarray:
    """The lists as a table, (tiles, N) bool."""
    table = np.zeros((tiles, count), bool)
    for tile, (start, length) in enumerate(zip(lists.starts, lists.counts, strict=True)):
        table[tile, lists.ids[start : start + length]] = True
    return table


def largest_alphas(gaussians, view) -> tuple[np.ndarray, np.ndarray]:
    """Largest alpha of every splat in every tile, (tiles, N).

    First over the pixel centres, then over the rectangle that the pixel centres span.
    """
    projection = reference.project(gaussians, view)
    columns, rows = -(-view.width // TILE), -(-view.height // TILE)
    at_pixels, anywhere = np.zeros((2, rows * columns, len(gaussians)))
    for tile in range(rows * columns):
        left, top = TILE * (tile % columns), TILE * (tile // columns)
        size = min(TILE, view.width - left), min(TILE, view.height - top)
        pixels = reference.pixel_centers(left, top, *size)
        low, high = np.array([left, top]) + 0.5, np.array([left, top]) + TILE - 0.5
        for i in np.flatnonzero(projection.in_front):
            at_pixels[tile, i] = reference.alphas(projection, i, pixels).max()
            nearest = _nearest_in_box(projection, i, low, high)
            anywhere[tile, i] = reference.alphas(projection, i, nearest).max()
    return at_pixels, anywhere


def _nearest_in_box(projection, i: SupportsIndex, low, high) -> np.ndarray:
    """Candidates for the point of a box with the largest alpha: the mean, or one per side."""
    mean = projection.means[i]
    if (low <= mean).all() and (mean <= high).all():
        return mean[None]
    (a, b), (_, c) = projection.covs[i]
    # On a side x = const the exponent is smallest at dy = dx b / a; similarly on y = const.
    points = [
        (x, np.clip(mean[1] + (x - mean[0]) * b / a, low[1], high[1])) for x in (low[0], high[0])
    ]
    points += [
        (np.clip(mean[0] + (y - mean[1]) * b / c, low[0], high[0]), y) for y in (low[1], high[1])
    ]
    return np.array(points)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scene", SCENES)
def test_lists_are_exact(scene, size):
    gaussians, view = SCENES[scene], camera(*size)
    lists = bin_splats(project(gaussians, view), *size)
    at_pixels, anywhere = largest_alphas(gaussians, view)
    table = listed(lists, *at_pixels.shape)
    assert lists.counts.sum() == table.sum(), "a splat is listed twice in a tile"
    missing = (at_pixels > reference.MIN_ALPHA * (1 + MARGIN)) & ~table
    assert not missing.any(), f"{missing.sum()} pairs that contribute are not listed"
    needless = (anywhere < reference.MIN_ALPHA * (1 - MARGIN)) & table
    assert not needless.any(), f"{needless.sum()} listed ellipses miss their tile"
    if scene == "blobs" and size == (64, 48):
        useless = table & (at_pixels < reference.MIN_ALPHA)
        assert useless.sum() < 0.02 * table.sum(), f"{useless.sum()} listed pairs cover no pixel"


@pytest.mark.parametrize("size", SIZES)
def test_lists_are_contiguous_and_in_depth_order(size):
    gaussians, view = SCENES["blobs"], camera(*size)
    splats = project(gaussians, view)
    lists, depths = bin_splats(splats, *size), np.asarray(splats.depths)
    assert len(lists.counts) == -(-size[0] // 8) * -(-size[1] // 8)
    np.testing.assert_array_equal(lists.starts, np.cumsum(lists.counts) - lists.counts)
    for start, count in zip(lists.starts, lists.counts, strict=True):
        assert (np.diff(depths[lists.ids[start : start + count]]) > 0).all()
    assert len(lists.ids) == lists.counts.sum() > 0
    assert {array.dtype for array in (lists.ids, lists.starts, lists.counts)} == {
        np.dtype(np.int32)
    }


def test_equal_depths_are_ordered_by_index():
    places = np.tile([0.0, 0, 2], (300, 1))
    places[::3, 2] = 1.5
    lists = bin_splats(project(blobs(places), camera(8, 8)), 8, 8)
    expected = np.concatenate([np.arange(0, 300, 3), np.flatnonzero(np.arange(300) % 3)])
    np.testing.assert_array_equal(lists.ids, expected)


def test_tile_ranges_beyond_the_integers_are_clipped():
    """The almost horizontal needle leaves a row of tiles only after some 1e13 pixels."""
    needle = dataclasses.replace(
        blobs([0, 0.1, 2.0], opacity=0.9),
        log_scales=np.array([[38, -7, -7]], np.float32),
        quats=np.array([[1, 0, 0, 1e-13]], np.float32),
    )
    lists = bin_splats(project(needle, camera(33, 17)), 33, 17)
    at_pixels, _ = largest_alphas(needle, camera(33, 17))
    np.testing.assert_array_equal(lists.counts, (at_pixels[:, 0] >= reference.MIN_ALPHA))
    assert lists.counts.sum() == 5, "the needle crosses one row of five tiles"


@pytest.mark.parametrize("places", [np.zeros((0, 3)), [[0, 0, -2], [50, 0, 2]]])
def test_a_view_without_visible_splats_has_empty_lists(places):
    lists = bin_splats(project(blobs(places), camera(17, 15)), 17, 15)
    assert lists.counts.tolist() == lists.starts.tolist() == [0] * 6
    assert len(lists.ids) == 0


def test_tiles_of_selected_splats_give_the_same_image_of_them():
    gaussians, view = random_scene(300, seed=4), camera(65, 47)
    selected = np.zeros(300, bool)
    selected[::60] = True
    features = jnp.asarray(selected, jnp.float32)[:, None]
    whole = make_view(gaussians, view)
    part = make_view(gaussians, view, touching=selected)
    image = composite(whole, features)
    assert image.any(), "the selected splats are invisible"
    np.testing.assert_array_equal(composite(part, features), image)
    assert np.count_nonzero(part.counts) < np.count_nonzero(whole.counts)
    assert not np.any(make_view(gaussians, view, touching=np.zeros(300, bool)).counts)
    everything = make_view(gaussians, view, touching=np.ones(300, bool))
    for leaf, other in zip(jax.tree.leaves(everything), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(leaf, other)


def test_views_of_no_and_of_all_selected_splats_share_compiled_code():
    gaussians, view = random_scene(3000), camera(160, 120)
    whole = make_view(gaussians, view)
    part = make_view(gaussians, view, touching=np.zeros(3000, bool))
    assert part.ids.shape == whole.ids.shape > (4096,), "4096 is the smallest size"


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scene", SCENES)
def test_tiles_of_selected_splats_have_their_whole_lists(scene, size):
    gaussians, view = SCENES[scene], camera(*size)
    splats, selected = project(gaussians, view), np.arange(len(gaussians)) % 50 == 7
    every, some = bin_splats(splats, *size), bin_splats(splats, *size, touching=selected)
    shape = len(every.counts), len(gaussians)
    table, part = listed(every, *shape), listed(some, *shape)
    expected = table & np.any(table[:, selected], axis=1, keepdims=True)
    np.testing.assert_array_equal(part, expected)
    if scene == "blobs" and size == (64, 48):
        assert len(some.ids) < len(every.ids) == some.total, "no part of a splat was left out"


def test_scenes_with_too_many_intersections_are_refused():
    everywhere = blobs(np.tile([[0.0, 0.0, 2.0]], (30_000, 1)), scale=1e3)
    with pytest.raises(InputError, match="scales right"):
        make_view(everywhere, camera(960, 720))


def test_padding_is_bounded_and_views_of_moderate_sizes_have_one_number_of_groups():
    scene = random_scene(5)
    sizes = [(640, 420), (560, 367), (736, 483), (800, 480)]
    views = [make_view(scene, camera(*size), lockstep=48) for size in sizes]
    assert {len(view.tiles) for view in views} == {128 * 48}
    for width, height in ((1200, 690), (1600, 1064), (1792, 1792)):
        tiles = -(-width // TILE) * -(-height // TILE)
        padded = len(make_view(scene, camera(width, height), lockstep=48).tiles)
        assert tiles <= padded <= 1.25 * tiles + 48
