"""The edge of what stands out moves to where the attributes of the Gaussians change."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
from forensics_cases import classified
from hypothesis import given, settings
from hypothesis import strategies as st

from gsc_jax.benchmark.metrics import confusion
from gsc_jax.benchmark.scenes import make_room
from gsc_jax.forensics.calibration import MAX_LOG_ODDS, Classification
from gsc_jax.forensics.edge import BEYOND, sharpened
from gsc_jax.forensics.features import Features, compute_features
from gsc_jax.forensics.places import Places, find_places
from gsc_jax.scene import Gaussians

ROOM = make_room(count=12_000, seed=5)
APART = np.linalg.norm(np.asarray(ROOM.means) - np.asarray(ROOM.means[0]), axis=1)
PART = np.sort(APART)[1_000] > APART


def measured(gaussians: Gaussians) -> tuple[Features, Places]:
    features = compute_features(gaussians)
    return features, find_places(features, np.asarray(gaussians.means, np.float32))


@pytest.fixture(scope="module")
def edited() -> tuple[Features, Places]:
    """A room in which the Gaussians of one region were made smaller."""
    log_scales = np.asarray(ROOM.log_scales) - PART[:, None]
    return measured(dataclasses.replace(ROOM, log_scales=log_scales.astype(np.float32)))


def blurred(center: float) -> Classification:
    """Log odds that fall with the distance, and pass the level at `center` radii of the part."""
    distance = APART / APART[PART].max()
    log_odds = np.clip(4 - 6 * (distance - center), -6, 9)
    one = classified(log_odds, peak=9.0)
    return dataclasses.replace(one, log_odds=log_odds - (4 - one.level))


@pytest.mark.parametrize("center", [0.85, 1.15])
def test_edge_moves_to_where_the_attributes_change(edited, center):
    before = blurred(center)
    after = sharpened(before, *edited)
    scores = [confusion(one.log_odds > one.level, PART).f1 for one in (before, after)]
    assert after.level == before.level
    assert scores[0] < 0.85
    assert scores[1] > 0.9


def test_gaussians_farther_away_keep_their_order(edited):
    before = blurred(1.0)
    after = sharpened(before, *edited)
    far = np.argsort(APART)[-3_000:]
    lowered = np.maximum(before.log_odds[far] - BEYOND * before.span, -MAX_LOG_ODDS)
    np.testing.assert_allclose(after.log_odds[far], lowered, atol=1e-4)


@pytest.mark.parametrize("log_odds", [-3.0, 9.0])
def test_nothing_changes_where_all_or_none_are_above_the_level(edited, log_odds):
    one = classified(np.full(len(PART), log_odds))
    assert sharpened(one, *edited) is one


def test_equal_gaussians_have_finite_log_odds():
    means = np.random.default_rng(2).normal(size=(2_000, 3)).astype(np.float32)
    same = dataclasses.replace(ROOM.take(np.zeros(2_000, int)), means=means)
    above = np.linalg.norm(means, axis=1) < 0.8
    after = sharpened(classified(np.where(above, 7.0, -4.0)), *measured(same))
    assert np.isfinite(after.log_odds).all()


@given(st.integers(0, 2**16), st.floats(-8, 4), st.floats(0.1, 12))
@settings(max_examples=20, deadline=None)
def test_log_odds_are_bounded_and_move_with_their_factor_and_shift(edited, seed, shift, factor):
    before = blurred(float(np.random.default_rng(seed).uniform(0.6, 1.4)))
    other = dataclasses.replace(
        before,
        log_odds=(factor * before.log_odds + shift).astype(np.float32),
        middle=factor * before.middle + shift,
        peak=factor * before.peak + shift,
        top=factor * before.top + shift,
    )
    after, moved = sharpened(before, *edited), sharpened(other, *edited)
    assert np.abs(moved.log_odds).max() <= MAX_LOG_ODDS
    free = np.abs(moved.log_odds) < MAX_LOG_ODDS
    free &= np.abs(after.log_odds) < MAX_LOG_ODDS
    expected = factor * after.log_odds + shift
    np.testing.assert_allclose(moved.log_odds[free], expected[free], atol=0.05 * factor)


def test_memory_does_not_grow_with_the_number_of_columns(edited, monkeypatch):
    """It took 260 bytes per Gaussian when the features around the edge were copied all at once."""
    monkeypatch.setattr("gsc_jax.forensics.edge.SAMPLE", 2**8)
    before = blurred(2.0)
    tracemalloc.start()
    after = sharpened(before, *edited)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert after is not before
    assert peak < 130 * len(PART), f"{peak / len(PART):.0f} bytes per Gaussian"
