"""The votes: cases worked by hand, and laws."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsc_jax.vote import cast_votes, no_votes, official_consensus, paper_consensus, tally

MASK = np.zeros((4, 6), bool)
MASK[1, 2] = True

votes_of_views = hnp.arrays(np.int32, (7, 9), elements=st.integers(-1, 1))


def test_a_center_votes_by_the_pixel_that_contains_it_or_abstains():
    inside = [[2.0, 1.0], [2.99, 1.99], [3.0, 1.5], [1.99, 1.5], [0, 0], [5.99, 3.99]]
    outside = [[-0.01, 0], [6.0, 1]]
    votes = cast_votes(np.array(inside + outside, np.float32), np.ones(8, np.float32), MASK)
    assert votes.tolist() == [1, 1, 0, 0, 0, 0, -1, -1]
    centers = np.array([[2.5, 1.5], [2.5, 1.5], [np.nan, 1.5], [np.inf, 1.5]], np.float32)
    depths = np.array([-1, 0, 1, 1], np.float32)
    assert cast_votes(centers, depths, MASK).tolist() == [-1, -1, -1, -1]


def test_maps_vote_tampered_above_one_half():
    centers, depths = np.full((1, 2), 0.5, np.float32), np.ones(1, np.float32)
    for level, vote in ((np.uint8(255), 1), (np.float32(0.7), 1), (np.float32(0.5), 0)):
        assert cast_votes(centers, depths, np.full((2, 2), level)).tolist() == [vote]


def test_abstentions_compete_only_in_the_official_consensus():
    votes = {
        "3 of 5": [1, 1, 1, 0, 0],
        "2 to 1": [1, 1, 0, -1, -1],
        "1 to 2": [1, 0, 0, -1, -1],
        "tie": [1, 0, -1, -1, -1],
        "nothing": [-1] * 5,
        "2 to 0": [1, 1, -1, -1, -1],
    }
    counts = tally(np.array([*votes.values()]).T)
    assert paper_consensus(counts).tolist() == [3, 2, 0, 0, 0, 2]
    assert official_consensus(counts).tolist() == [3, 0, 0, 0, 0, 0]


@given(votes_of_views)
def test_tallies_add_up_and_the_official_consensus_implies_that_of_the_paper(votes):
    counts = tally(votes)
    official, paper = official_consensus(counts), paper_consensus(counts)
    assert jnp.all((official == 0) | (official == paper)), "the official consensus is stricter"
    assert np.all(counts.tampered + counts.authentic + counts.abstained == len(votes))
    both = tally(votes[:3]) + tally(votes[3:])
    assert np.array_equal(both.tampered, counts.tampered)
    assert np.array_equal(both.abstained, counts.abstained)


def test_no_votes_change_no_tally():
    counts = tally(np.array([[1, 0], [1, -1]])) + no_votes(2)
    assert counts.tampered.tolist() == [2, 0]
    assert counts.authentic.tolist() == [0, 1]
    assert counts.abstained.tolist() == [0, 1]


@given(votes_of_views, st.permutations(range(9)))
def test_permuting_gaussians_permutes_the_consensus(votes, order):
    for consensus in (paper_consensus, official_consensus):
        expected = np.asarray(consensus(tally(votes)))[order]
        assert np.array_equal(consensus(tally(votes[:, order])), expected)


@given(
    hnp.arrays(bool, (4, 6)), hnp.arrays(np.float32, (5, 2), elements=st.floats(-2, 8, width=32))
)
def test_a_mask_and_its_complement_swap_roles(mask, centers):
    depths = np.ones(5, np.float32)
    counts = tally(cast_votes(centers, depths, mask)[None])
    swapped = tally(cast_votes(centers, depths, ~mask)[None])
    assert np.array_equal(counts.tampered, swapped.authentic)
    assert np.array_equal(counts.authentic, swapped.tampered)
