"""Requantisation treats all rows alike and changes values little."""

import dataclasses

import numpy as np
import pytest
from export import COLOUR_STEP, SCALE_STEP, exported

from gsc_jax.benchmark.scenes import make_room

ROOM = make_room(count=1_000, seed=1)


def test_8_bits_leave_few_values_and_float_many():
    coarse, fine = exported(ROOM), exported(ROOM, as_="float")
    assert len(np.unique(coarse.log_scales)) < 200 < 2_000 < len(np.unique(fine.log_scales))
    assert len(np.unique(coarse.opacities)) <= 256


@pytest.mark.parametrize("as_", ["8 bits", "float"])
def test_values_change_by_a_step_at_most(as_):
    saved = exported(ROOM, as_=as_)
    assert np.abs(saved.log_scales - ROOM.log_scales).max() <= 1.5 * SCALE_STEP + 1e-5
    assert np.abs(saved.sh - ROOM.sh).max() <= 1.5 * COLOUR_STEP + 1e-5
    assert np.abs(np.asarray(saved.opacities) - np.asarray(ROOM.opacities)).max() <= 1.501 / 255
    turned = np.abs(np.sum(np.asarray(saved.rotations) * np.asarray(ROOM.rotations), axis=1))
    assert turned.min() > 0.998
    assert saved.log_scales.dtype == saved.quats.dtype == np.float32


def test_an_earlier_quantisation_of_some_rows_is_hidden():
    scales = np.array(ROOM.log_scales)
    scales[::2] = np.round(scales[::2] / SCALE_STEP) * SCALE_STEP
    saved = np.asarray(exported(dataclasses.replace(ROOM, log_scales=scales)).log_scales)
    moved = np.abs(saved - scales) > 1e-4
    assert 0.15 < moved[::2].mean() < 0.35, "a quarter of triangular noise exceeds half a step"
    assert np.abs(saved / SCALE_STEP - np.round(saved / SCALE_STEP)).max() < 1e-3


def test_the_seed_determines_the_noise():
    np.testing.assert_array_equal(exported(ROOM, seed=4).sh, exported(ROOM, seed=4).sh)
    assert (exported(ROOM, seed=4).sh != exported(ROOM, seed=5).sh).any()
