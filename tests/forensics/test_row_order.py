"""Row order: an appended object is found in an unsorted file, and only there."""

import numpy as np
from forensics_cases import assert_matches, room

from gsc_jax.benchmark.scenes import concatenate, make_object
from gsc_jax.forensics.row_order import row_order


def test_object_at_the_end_of_an_unsorted_file_is_found():
    shuffled = room().take(np.random.default_rng(0).permutation(len(room())))
    edited = concatenate([shuffled, make_object(count=600)])
    assert_matches(row_order(edited), np.arange(len(edited)) >= len(room()), precision=0.8)
    order = np.random.default_rng(1).permutation(len(edited))
    assert not row_order(edited.take(order)).found, "a shuffled file has no informative order"
    by_x = np.argsort(np.asarray(edited.means)[:, 0])
    assert not row_order(edited.take(by_x)).found, "a sorted file has no informative order"
