"""Calibration: bounds, scenes unlike the training data, and the level of labelling."""

import dataclasses

import numpy as np
import pytest
from forensics_cases import BASE, classified, room, two_groups
from hypothesis import given, settings
from hypothesis import strategies as st

from gsc_jax.forensics.calibration import MAX_LOG_ODDS, calibrate, label_level, nothing_known
from gsc_jax.forensics.classifier import default_classifier
from gsc_jax.forensics.features import compute_features
from gsc_jax.forensics.places import find_places

ROOM = room(1_000)
PLACES = find_places(compute_features(ROOM), np.asarray(ROOM.means))


def test_log_odds_are_bounded():
    steep = dataclasses.replace(default_classifier(), calibration=(40.0, 0.0))
    raw = np.linspace(-20, 20, len(ROOM), dtype=np.float32)
    assert np.abs(calibrate(raw, PLACES, steep).log_odds).max() == pytest.approx(MAX_LOG_ODDS)


def test_median_of_a_scene_unlike_the_training_data_is_at_most_the_base_rate():
    raw, classifier = np.full(len(ROOM), 20, np.float32), default_classifier()
    output = calibrate(raw, PLACES, classifier)
    assert np.median(output.log_odds) <= classifier.base + 1e-4


def test_unknown_gaussians_do_not_change_the_level():
    # No known log odds are near the base rate, where the unknown ones are.
    output = classified(np.append(np.full(5_000, -6.0), np.linspace(-2, 7, 2_000)))
    padded = dataclasses.replace(
        output,
        known=np.append(output.known, np.zeros(5_000, bool)),
        log_odds=np.append(output.log_odds, np.full(5_000, BASE, np.float32)),
    )
    assert label_level(padded) == label_level(output)


def test_without_gaussians_the_level_is_the_base_rate():
    output = nothing_known(default_classifier())
    assert output.level == default_classifier().base
    assert 0 < output.scene_probability < 0.2


def test_level_without_a_peak_is_the_base_rate():
    assert label_level(classified(np.full(50, BASE), peak=BASE)) == BASE


def test_a_small_part_of_an_edit_that_stands_out_most_does_not_hide_the_rest():
    scene = room(12_000)
    places = find_places(compute_features(scene), np.asarray(scene.means))
    distance = np.linalg.norm(np.asarray(scene.means) - np.asarray(scene.means)[0], axis=1)
    most, edit = (distance <= np.quantile(distance, share) for share in (0.02, 0.2))
    noise = np.random.default_rng(0).normal(0, np.where(edit, 2.0, 0.5))
    raw = (noise + np.select([most, edit], [14, 8])).astype(np.float32)
    output = calibrate(raw, places, default_classifier())
    labels = output.log_odds > label_level(output)
    assert labels[edit].mean() > 0.95 > 0.05 > labels[~edit].mean()
    halfway_to_the_peak = output.log_odds > output.middle + output.span / 2
    assert halfway_to_the_peak[edit].mean() < 0.85
    assert 0.25 <= (output.level - output.middle) / output.span < 0.4


@given(st.integers(0, 99), st.integers(50, 5_000), st.floats(-5, 0), st.floats(0.2, 5))
@settings(max_examples=20, deadline=None)
def test_level_lies_between_the_median_and_the_peak_and_moves_with_them(
    seed: int, edited: int, shift: float, factor: float
):
    log_odds = two_groups(seed, edited) - 5
    peak = float(log_odds.max())
    one = classified(log_odds, peak=peak)
    other = classified(factor * log_odds + shift, peak=factor * peak + shift)
    other = dataclasses.replace(other, middle=factor * one.middle + shift)
    level = label_level(one)
    assert np.median(log_odds) < level < peak
    assert label_level(other) == pytest.approx(factor * level + shift, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("shift", [-3.0, 2.0])
def test_the_scene_probability_does_not_depend_on_where_the_log_odds_are(shift):
    raw, classifier = np.random.default_rng(1).normal(-4, 1, len(ROOM)), default_classifier()
    one, other = (calibrate(values, PLACES, classifier) for values in (raw, raw + shift))
    assert one.scene_probability == pytest.approx(other.scene_probability, rel=1e-3)
