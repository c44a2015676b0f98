"""Novelty: high for what resembles nothing elsewhere, and independent of scale and row order."""

import dataclasses
import tracemalloc

import numpy as np
import pytest

from gsc_jax.benchmark.incorporation import transformed
from gsc_jax.benchmark.metrics import auc
from gsc_jax.benchmark.scenes import make_room
from gsc_jax.forensics.classifier import combined_log_odds, default_classifier
from gsc_jax.forensics.features import compute_features
from gsc_jax.forensics.novelty import novelty
from gsc_jax.forensics.places import find_places
from gsc_jax.scene import Gaussians

ROOM = make_room(count=12_000, seed=5)


def measured(gaussians: Gaussians) -> np.ndarray:
    """Novelty of each Gaussian, shape (N,)."""
    places = find_places(compute_features(gaussians), np.asarray(gaussians.means, np.float32))
    return places.spread_out(novelty(places))


def nearest(gaussians: Gaussians, count: int) -> np.ndarray:
    """Mask of the Gaussians nearest to the first, shape (N,) bool."""
    means = np.asarray(gaussians.means)
    apart = np.linalg.norm(means - means[0], axis=1)
    return apart <= np.sort(apart)[count]


def test_part_with_statistics_of_its_own_is_novel():
    part = nearest(ROOM, 700)
    rng = np.random.default_rng(0)
    log_scales = np.array(ROOM.log_scales)
    log_scales[part] += rng.normal(-1, 0.5, (part.sum(), 3))
    logits = np.where(part, rng.normal(0, 2, len(part)), ROOM.logit_opacities)
    edited = dataclasses.replace(
        ROOM, log_scales=log_scales.astype(np.float32), logit_opacities=logits.astype(np.float32)
    )
    after, before = measured(edited), measured(ROOM)
    assert auc(after, part) > 0.9
    assert after[part].mean() > before[part].mean() + 0.5


def test_order_scale_and_place_change_nothing():
    order = np.random.default_rng(1).permutation(len(ROOM))
    expected = measured(ROOM)
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(measured(ROOM.take(order)), expected[order], atol=0.05)
    moved = transformed(ROOM, np.eye(3), 20.0, np.array([3.0, -2, 7]))
    assert np.median(np.abs(measured(moved) - expected)) < 0.05


@pytest.mark.parametrize("count", [17, 40, 300])
def test_few_places_are_compared_with_fewer_others(count):
    few = ROOM.take(np.arange(count))
    features = compute_features(few)
    places = find_places(features, np.asarray(few.means, np.float32))
    assert places.around.nearest.shape[1] == min(16, len(places.starts) - 1)
    assert np.isfinite(novelty(places)).all()
    assert np.isfinite(combined_log_odds(features, places, default_classifier())).all()


def test_identical_gaussians_are_not_novel():
    same = ROOM.take(np.zeros(2_000, int))
    means = np.random.default_rng(2).normal(size=(2_000, 3)).astype(np.float32)
    values = measured(dataclasses.replace(same, means=means))
    assert np.isfinite(values).all()


def test_memory_does_not_grow_with_the_number_of_columns(monkeypatch):
    """All columns at once took 500 bytes per Gaussian, more than any other step."""
    monkeypatch.setattr("gsc_jax.forensics.places.MAX_PLACES", 2**8)  # few, as in a large scene
    gaussians = make_room(count=40_000, seed=5)
    features, means = compute_features(gaussians), np.asarray(gaussians.means, np.float32)
    tracemalloc.start()
    find_places(features, means)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200 * len(gaussians), f"{peak / len(gaussians):.0f} bytes per Gaussian"
