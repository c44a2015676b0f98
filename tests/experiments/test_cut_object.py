import jax
import numpy as np
import pytest
from cut_object import ROUGH, cut_object
from edited_room import room

from gsc_jax.benchmark.incorporation import extent


def test_a_cut_object_is_upright_and_stands_at_the_origin():
    gaussians, cameras = room()
    donor = cut_object(gaussians, cameras, seed=0)
    low, high = extent(donor)
    assert 10 < len(donor) < len(gaussians) / 2
    assert high[1] == pytest.approx(0, abs=1e-4)
    np.testing.assert_allclose((low + high)[[0, 2]], 0, atol=1e-4)
    jax.tree.map(np.testing.assert_array_equal, donor, cut_object(gaussians, cameras, seed=0))


def test_a_rough_cut_leaves_some_of_the_surroundings_on_the_object():
    gaussians, cameras = room()
    well, rough = (cut_object(gaussians, cameras, seed=0, rough=rough) for rough in (False, True))
    assert len(well) < len(rough) <= len(well) * (1 + ROUGH)
