"""The forged region that SAFIRE derives from the masks of many prompts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsc_jax.detectors.safire_regions import forged_region, mask_directions, point_grid, two_groups


def test_point_grid_has_cell_centres_with_x_first():
    np.testing.assert_array_equal(point_grid(2, side=8), [[2, 2], [6, 2], [2, 6], [6, 6]])
    points = point_grid(16, side=1024)
    assert points.shape == (256, 2)
    assert (points.min(), points.max()) == (32, 992)


def masks_of(*areas: int) -> np.ndarray:
    """Masks with these areas, side by side from the left, shape (P, 1, 16)."""
    logits, start = np.full((len(areas), 1, 16), -9.0, np.float32), 0
    for mask, area in zip(logits, areas, strict=True):
        mask[0, start : start + area] = 9.0
        start += area
    return logits


SIXTEEN = np.where(np.arange(16) < 4, 1.0, -1.0).astype(np.float32)[None, None]
"""Embeddings of one channel; the first four cells have the opposite direction."""


def test_map_is_the_mean_of_the_region_and_the_complement_of_the_rest():
    logits = masks_of(4, 12)
    logits[1, 0, 15] = -9.0  # in neither mask
    found, counts = forged_region(logits, np.array([0.9, 0.9]), SIXTEEN, side=16)
    np.testing.assert_allclose(found[0, :3], 1, atol=1e-3)
    np.testing.assert_allclose(found[0, 6:13], 0, atol=1e-3)
    assert found[0, 15] == pytest.approx(0.5, abs=1e-3)
    assert counts == {"unusable": 0, "one_source": 0}


def test_most_confident_mask_represents_its_group():
    logits = np.concatenate([masks_of(4, 12), masks_of(2, 12)[:1]])
    for confidences, width in (((0.9, 0.9, 0.8), 4), ((0.8, 0.9, 0.9), 2)):
        found, _ = forged_region(logits, np.array(confidences), SIXTEEN, side=16)
        assert found[0, 0] > 0.9
        assert (found[0, 3] > 0.9) == (width == 4)


def test_low_confidences_are_no_reason_to_flag_nothing():
    found, counts = forged_region(masks_of(4, 12), np.array([0.1, 0.2]), SIXTEEN, side=16)
    assert found[0, 0] > 0.9
    assert sum(counts.values()) == 0


def test_the_most_confident_mask_of_one_source_is_the_region():
    same = np.ones((1, 1, 16), np.float32)
    found, counts = forged_region(masks_of(4, 12), np.array([0.3, 0.2]), same, side=16)
    assert counts["one_source"] == 1
    np.testing.assert_allclose(found[0, [0, 15]], [1, 0], atol=1e-3)


def test_features_are_of_the_cells_whose_first_pixel_is_inside():
    logits = np.full((1, 2, 4), -1.0)
    logits[0, 0, :3] = 1.0  # the first pixels of both cells, and a part of the rest
    embeddings = np.eye(2)[:, None, :]
    (found,) = mask_directions(logits, embeddings, side=4)
    np.testing.assert_allclose(found, np.array([1, 1]) / np.sqrt(2))
    logits[0, 0, 2] = -1.0
    np.testing.assert_array_equal(mask_directions(logits, embeddings, side=4), [[1, 0]])


def test_a_mask_without_the_first_pixel_of_a_cell_has_no_feature():
    logits = np.full((1, 8, 8), -1.0)
    logits[0, 3, 3] = 1.0
    assert np.isnan(mask_directions(logits, np.ones((2, 2, 2)), side=8)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_masks_that_are_not_finite_are_ignored(bad):
    logits = np.concatenate([masks_of(4, 12), masks_of(9)])
    confidences = np.array([0.9, 0.9, bad])
    clean, _ = forged_region(logits[:2], confidences[:2], SIXTEEN, side=16)
    found, counts = forged_region(logits, confidences, SIXTEEN, side=16)
    np.testing.assert_array_equal(found, clean)
    assert counts["unusable"] == 1
    infinite = np.where(logits > 0, np.inf, -np.inf)[:2]
    found, _ = forged_region(infinite, confidences[:2], SIXTEEN, side=16)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found > 0.5, clean > 0.5)
    broken = np.where(np.arange(16) == 5, bad, SIXTEEN)
    found, counts = forged_region(logits[:2], confidences[:2], broken, side=16)
    assert counts["unusable"] == 2
    assert not found.any()


def spread(seed: int, sizes: tuple[int, int], noise: float) -> np.ndarray:
    """Random directions around two axes."""
    rng = np.random.default_rng(seed)
    around = np.repeat(np.eye(2, 5), sizes, axis=0) + noise * rng.normal(size=(sum(sizes), 5))
    return around / np.linalg.norm(around, axis=1, keepdims=True)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(1, 60), (3, 250), (30, 30)]),
    st.floats(0, 0.15),
    st.integers(0, 9),
)
def test_two_groups_do_not_depend_on_order_or_seed(seed, sizes, noise, other):
    directions = spread(seed, sizes, noise)
    truth = np.repeat([0, 1], sizes)
    order = np.random.default_rng(seed).permutation(len(truth))
    found = two_groups(directions[order], seed=other)
    assert found is not None
    agreement = (found == truth[order]).mean()
    assert agreement in (0, 1)
    np.testing.assert_array_equal(found, two_groups(directions[order], seed=other))


@given(st.integers(0, 99), st.sampled_from([4, 8]))
def test_two_groups_have_the_longest_sums_of_all_partitions(seed, count):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def length(groups: np.ndarray) -> float:
        return sum(float(np.linalg.norm(directions[groups == k].sum(axis=0))) for k in (0, 1))

    every = [(code >> np.arange(count)) & 1 for code in range(2**count)]
    found = two_groups(directions, seed=seed)
    assert found is not None
    assert length(found) == pytest.approx(max(map(length, every)), rel=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2, 60])
def test_equal_directions_are_one_group(count):
    equal = np.tile([[0.6, 0.8]], (count, 1))
    assert two_groups(equal) is None
    jitter = 1e-7 * np.random.default_rng(0).normal(size=equal.shape)
    assert two_groups(equal + jitter) is None
