"""The votes: cases worked by hand, and laws."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from strategies import camera

from gsc_jax.render.projection import project_centers
from gsc_jax.vote import cast_votes, official_consensus, paper_consensus, tally

MASK = np.zeros((4, 6), bool)
MASK[1, 2] = True

votes_of_views = hnp.arrays(np.int32, (7, 9), elements=st.integers(-1, 1))


def test_a_center_votes_by_the_pixel_that_it_falls_into():
    centers = np.array(
        [
            [2.0, 1.0],
            [2.99, 1.99],
            [3.0, 1.5],
            [1.99, 1.5],
            [-0.01, 0],
            [0, 0],
            [6.0, 1],
            [5.99, 3.99],
        ],
        np.float32,
    )
    votes = cast_votes(centers, np.ones(8, np.float32), MASK)
    assert votes.tolist() == [1, 1, 0, 0, -1, 0, -1, 0]


def test_behind_the_camera_and_not_finite_abstain():
    centers = np.array([[2.5, 1.5], [2.5, 1.5], [np.nan, 1.5], [np.inf, 1.5]], np.float32)
    depths = np.array([-1, 0, 1, 1], np.float32)
    assert cast_votes(centers, depths, MASK).tolist() == [-1, -1, -1, -1]


def test_centers_land_where_the_pinhole_puts_them():
    view = camera(20, 10, focal=30.0)
    centers, depths = project_centers(
        np.array([[0, 0, 2], [0.1, -0.2, 3], [0, 0, -1]], np.float32), view.viewmat, view.K
    )
    np.testing.assert_allclose(centers[:2], [[10, 5], [11, 3]], rtol=1e-6)
    assert depths.tolist() == [2, 3, -1]


def test_the_two_readings_of_a_majority():
    #                      3 of 5      2 to 1 of 5     tie       nothing     2 to 0, 3 abstain
    votes = np.array(
        [[1, 1, 1, 0, 0], [1, 1, 0, -1, -1], [1, 0, -1, -1, -1], [-1] * 5, [1, 1, -1, -1, -1]]
    )
    counts = tally(votes.T)
    assert paper_consensus(counts).tolist() == [3, 2, 0, 0, 2]
    assert official_consensus(counts).tolist() == [3, 0, 0, 0, 0]


@given(votes_of_views)
def test_a_tally_counts_every_view_once_and_adds_up(votes):
    counts = tally(votes)
    assert np.all(counts.tampered + counts.authentic + counts.abstained == len(votes))
    parts = tally(votes[:3]) + tally(votes[3:])
    assert np.array_equal(parts.tampered, counts.tampered)
    assert np.array_equal(parts.abstained, counts.abstained)


@given(votes_of_views, st.permutations(range(9)))
def test_votes_follow_the_gaussians_when_they_are_permuted(votes, order):
    permuted = np.asarray(order)
    for consensus in (paper_consensus, official_consensus):
        expected = np.asarray(consensus(tally(votes)))[permuted]
        assert np.array_equal(consensus(tally(votes[:, permuted])), expected)


@given(
    hnp.arrays(bool, (4, 6)), hnp.arrays(np.float32, (5, 2), elements=st.floats(-2, 8, width=32))
)
def test_a_mask_and_its_complement_swap_roles(mask, centers):
    depths = np.ones(5, np.float32)
    counts = tally(cast_votes(centers, depths, mask)[None])
    swapped = tally(cast_votes(centers, depths, ~mask)[None])
    assert np.array_equal(counts.tampered, swapped.authentic)
    assert np.array_equal(counts.authentic, swapped.tampered)
    assert np.array_equal(counts.abstained, swapped.abstained)


@given(votes_of_views)
def test_the_official_majority_is_the_stricter_one(votes):
    counts = tally(votes)
    official, paper = official_consensus(counts), paper_consensus(counts)
    assert jnp.all((official == 0) | (official == paper))
