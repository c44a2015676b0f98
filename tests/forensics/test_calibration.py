"""Calibration: bounds, scenes unlike the training data, and the level of labelling."""

import dataclasses

import numpy as np
import pytest
from forensics_cases import BASE, classified
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage import filters

from gsc_jax.forensics.calibration import (
    MAX_LOG_ODDS,
    calibrate,
    label_level,
    without_weak_islands,
)
from gsc_jax.forensics.classifier import default_classifier

MEANS = np.random.default_rng(0).normal(size=(300, 3))
ALL = np.ones(300, bool)
NEAR = (np.arange(300)[:, None] + [1, 2]) % 300


def test_log_odds_are_bounded():
    steep = dataclasses.replace(default_classifier(), calibration=(40.0, 0.0))
    raw = np.linspace(-20, 20, 300, dtype=np.float32)
    assert np.abs(calibrate(raw, MEANS, NEAR, ALL, steep).log_odds).max() == pytest.approx(
        MAX_LOG_ODDS
    )


def test_median_of_a_scene_unlike_the_training_data_is_at_most_the_base_rate():
    output = calibrate(np.full(300, 20, np.float32), MEANS, NEAR, ALL, default_classifier())
    assert np.median(output.log_odds) <= output.base + 1e-4


def test_unknown_gaussians_do_not_change_the_level():
    # No known log odds are near the base rate, where the unknown ones are.
    output = classified(np.append(np.full(5_000, -6.0), np.linspace(-2, 7, 2_000)))
    padded = dataclasses.replace(
        output,
        known=np.append(output.known, np.zeros(5_000, bool)),
        log_odds=np.append(output.log_odds, np.full(5_000, BASE, np.float32)),
    )
    assert label_level(padded) == label_level(output)


def test_level_without_a_peak_is_the_base_rate():
    assert label_level(classified(np.full(50, BASE), peak=BASE)) == BASE


def grid_neighbours(height: int, width: int) -> np.ndarray:
    """The four neighbours of each pixel, shape (N, 4); a pixel itself where there is none."""
    y, x = (index.ravel()[:, None] for index in np.indices((height, width)))
    down, right = np.array([[1, -1, 0, 0]]), np.array([[0, 0, 1, -1]])
    return np.clip(y + down, 0, height - 1) * width + np.clip(x + right, 0, width - 1)


@given(
    st.integers(0, 999), st.integers(2, 30), st.integers(2, 30), st.floats(-1, 1), st.floats(0, 2)
)
@settings(max_examples=50, deadline=None)
def test_islands_are_those_of_hysteresis_thresholding(seed, height, width, edge, apart):
    log_odds = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    kept = without_weak_islands(
        log_odds.ravel(), grid_neighbours(height, width), edge, edge + apart
    ).reshape(height, width)
    expected = filters.apply_hysteresis_threshold(log_odds, edge, edge + apart)
    np.testing.assert_array_equal(kept > np.float32(edge), expected)
    np.testing.assert_array_equal(kept, np.where(expected, log_odds, np.minimum(log_odds, edge)))


def test_a_weak_island_is_not_labelled_and_a_connected_slope_is():
    log_odds = np.full(300, -8, np.float32)
    log_odds[10:80], log_odds[80:120] = 2, np.linspace(2, -8, 40)
    log_odds[240:260] = -1
    same = dataclasses.replace(default_classifier(), calibration=(1.0, 0.0), base=-4.0)
    means = np.column_stack([np.arange(300.0), np.zeros(300), np.zeros(300)])
    output = calibrate(log_odds, means, NEAR, ALL, same)
    level = label_level(output)
    assert level == pytest.approx(-4 + 0.25 * (output.peak + 4))
    assert level < -1
    np.testing.assert_array_equal(
        np.flatnonzero(output.log_odds > level),
        np.arange(10, 10 + (log_odds[10:120] > level).sum()),
    )
