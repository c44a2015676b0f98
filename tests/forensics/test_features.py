"""What the Gaussians are described by: it must not depend on what means nothing."""

import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gsc_jax.benchmark.pasting import transformed
from gsc_jax.benchmark.scenes import make_room
from gsc_jax.forensics.features import CLIP, copies, cues, select, standardised
from gsc_jax.scene.neighbours import neighbourhoods, parts

ROOM = make_room(count=2_000, seed=3)
CUES = cues(ROOM)


def test_cues_are_finite_bounded_and_named():
    assert CUES.values.shape == (len(ROOM), len(CUES.names))
    assert CUES.values.dtype == np.float32
    assert np.isfinite(CUES.values).all()
    assert np.abs(CUES.values).max() <= CLIP + 1e-5
    assert len(set(CUES.names)) == len(CUES.names)
    assert select(CUES.names, "size").sum() == 5 * 5


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_rows_does_not_matter(seed):
    order = np.random.default_rng(seed).permutation(len(ROOM))
    np.testing.assert_allclose(cues(ROOM.take(order)).values, CUES.values[order], atol=2e-3)


@pytest.mark.parametrize("scale", [0.01, 30.0])
def test_place_pose_and_unit_do_not_matter(scale):
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    moved = cues(transformed(ROOM, turn, scale, np.array([3.0, -2.0, 5.0]) * scale))
    # What a copy is like does depend on the rotation of both, which is the same; not on the frame.
    same = ~select(CUES.names, "copies")
    off = np.abs(moved.values - CUES.values)[:, same]
    assert np.quantile(off, 0.999) < 0.05


def test_what_is_unlike_its_surroundings_stands_out():
    near = np.argsort(np.linalg.norm(ROOM.means - ROOM.means[7], axis=1))[:100]
    sizes = np.array(ROOM.log_scales)
    sizes[near] += 2.0
    changed = cues(dataclasses.replace(ROOM, log_scales=sizes))
    column = changed.names.index("size.0.mean")
    others = np.setdiff1d(np.arange(len(ROOM)), near)
    assert np.median(changed.values[near, column]) > np.quantile(
        changed.values[others, column], 0.95
    )


def test_copies_are_seen_and_chance_is_not():
    rows = np.arange(50)
    pasted = jax.tree.map(lambda x: np.concatenate([x, x[rows]]), jax.tree.map(np.asarray, ROOM))
    means = pasted.means.copy()
    means[-50:] += 1.0
    close = copies(dataclasses.replace(pasted, means=means))
    assert close[-50:, 0].min() > 0.99
    assert close[:50, 0].min() > 0.99
    assert close[50:-50, 0].mean() < 0.2


def test_a_constant_is_nothing_special():
    assert not standardised(np.full((40, 2), 3.0)).any()


def test_neighbours_are_the_nearest_others():
    points = np.random.default_rng(0).random((300, 3)).astype(np.float32)
    around = neighbourhoods(points, 5)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    np.testing.assert_array_equal(np.sort(around.nearest), np.sort(np.argsort(apart)[:, :5]))
    values = points[:, :2]
    np.testing.assert_allclose(around.mean @ values, values[around.nearest].mean(1), atol=1e-6)
    spread = values[around.nearest].std(axis=1)
    np.testing.assert_allclose(around.spread(values, around.mean @ values), spread, atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 400), st.integers(1, 50), st.integers(0, 9))
def test_parts_are_a_partition_of_bounded_size(count, size, seed):
    points = np.random.default_rng(seed).random((count, 3))
    found = parts(points, size)
    assert max(map(len, found)) <= size
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), np.arange(count))
