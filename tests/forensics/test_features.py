"""Features: invariant to the order of rows and to position, scale and pose of the scene."""

import numpy as np
import pytest
from forensics_cases import with_copy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gsc_jax.benchmark.incorporation import transformed
from gsc_jax.benchmark.scenes import make_room
from gsc_jax.forensics.copy_move import nearest_duplicates
from gsc_jax.forensics.features import (
    MAX_DEVIATION,
    compute_features,
    duplicate_closeness,
    in_group,
)

ROOM = make_room(count=2_000, seed=3)
FEATURES = compute_features(ROOM)
VALUES = FEATURES.rows()


def test_features_are_finite_bounded_and_named():
    assert VALUES.shape == (len(ROOM), len(FEATURES.names))
    assert VALUES.dtype == np.float32
    assert np.isfinite(VALUES).all()
    assert np.abs(VALUES).max() <= MAX_DEVIATION + 1e-5
    assert len(set(FEATURES.names)) == len(FEATURES.names)
    assert in_group(FEATURES.names, "size").sum() == 5 * 5


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_permuting_rows_permutes_features(seed):
    order = np.random.default_rng(seed).permutation(len(ROOM))
    permuted = compute_features(ROOM.take(order)).rows()
    np.testing.assert_allclose(permuted, VALUES[order], atol=2e-3)


@pytest.mark.parametrize("scale", [0.01, 30.0])
def test_similarities_of_the_scene_change_nothing(scale):
    rotation = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    moved = compute_features(transformed(ROOM, rotation, scale, np.array([3, -2, 5.0]) * scale))
    # Duplicates compare stored rotations, which depend on the frame.
    same = ~in_group(FEATURES.names, "copies")
    difference = np.abs(moved.rows() - VALUES)[:, same]
    assert np.quantile(difference, 0.999) < 0.05


def test_copies_are_close_and_others_are_not():
    distances, rows = nearest_duplicates(with_copy(ROOM, np.arange(50)))
    assert (rows[-50:] == np.arange(50)).all()
    assert (rows[:50] == len(ROOM) + np.arange(50)).all()
    closeness = duplicate_closeness(distances)[:, 0]
    assert closeness[-50:].min() > 0.99
    assert closeness[:50].min() > 0.99
    assert closeness[50:-50].mean() < 0.2
