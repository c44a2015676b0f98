"""The two configurations of GS-Checker, and its warning about empty groups."""

import numpy as np
import pytest

from gsc_jax.estimators.gschecker import OFFICIAL, PAPER


def test_the_configurations_are_those_of_the_paper_and_of_the_released_code():
    assert (PAPER.epochs, PAPER.loop.per_feature) == (5, False)
    assert (OFFICIAL.epochs, OFFICIAL.shuffle, OFFICIAL.loop.per_feature) == (1, False, True)
    for config in (PAPER, OFFICIAL):
        loop = config.loop
        weights = (loop.lambda1, loop.lambda2, loop.beta, loop.gamma, loop.learning_rate)
        assert weights == (1, 10, 1, 10, 1)


@pytest.mark.parametrize(
    ("sizes", "empty"),
    [
        ([[1, 0, 1], [1, 0, 1], [1, 1, 1]], None),
        ([[1, 1, 1], [1, 0, 1], [0, 0, 1]], "G_m empty"),
        ([[1, 1, 1], [1, 0, 1], [0, 1, 1]], "always one of them empty"),
        ([], None),
    ],
)
def test_groups_that_are_empty_in_every_contrastive_iteration_are_a_warning(sizes, empty):
    found = OFFICIAL._empty_groups(np.array(sizes, int).reshape(-1, 3))
    assert len(found) == (empty is not None)
    assert all(f"({empty})" in warning for warning in found)
