"""Nearest neighbours against all pairs, and the partition into parts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsc_jax.scene.neighbours import nearest_neighbours, neighbourhoods, parts


def distances_to_others(points: np.ndarray) -> np.ndarray:
    distances = np.linalg.norm(points[:, None] - points, axis=-1)
    np.fill_diagonal(distances, np.inf)
    return distances


@given(st.integers(0, 1000), st.sampled_from([1e-6, 1.0, 1e6]))
def test_nearest_neighbours_are_those_of_all_pairs(seed, scale):
    points = np.random.default_rng(seed).normal(size=(30, 3)) * scale
    distances, rows = distances_to_others(points), np.arange(0, 30, 2)
    found = nearest_neighbours(points, rows, 5)
    expected = np.sort(distances[rows], axis=1)[:, :5]
    np.testing.assert_allclose(np.take_along_axis(distances[rows], found, 1), expected)


def test_points_at_the_same_place_are_neighbours_of_each_other_only():
    found = nearest_neighbours(np.zeros((12, 3)), np.arange(12), 4)
    assert found.shape == (12, 4)
    assert all(k not in row and len(set(row)) == 4 for k, row in enumerate(found))


def test_neighbourhoods_average_over_the_nearest_points():
    points = np.random.default_rng(0).random((300, 3)).astype(np.float32)
    around, reach = neighbourhoods(points, 5)
    np.testing.assert_allclose(
        reach, np.sort(distances_to_others(points), axis=1)[:, :5], rtol=1e-5
    )
    values = points[:, :2]
    means = around.mean(values)
    np.testing.assert_allclose(means, values[around.nearest].mean(axis=1), atol=1e-6)
    spread = values[around.nearest].std(axis=1)
    np.testing.assert_allclose(around.spread(values, means), spread, atol=1e-3)


@pytest.mark.parametrize(("count", "size"), [(1, 1), (7, 50), (400, 1), (400, 37)])
def test_parts_are_a_partition_of_bounded_size(count, size):
    points = np.random.default_rng(0).random((count, 3))
    order, starts = parts(points, size)
    sizes = np.diff(starts, append=count)
    assert 0 < sizes.min() <= sizes.max() <= size
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
    around = (np.ptp(points[part], axis=0).max() for part in np.split(order, starts[1:]))
    assert count < 400 or np.mean(list(around)) < 2 * (size / count) ** (1 / 3)
