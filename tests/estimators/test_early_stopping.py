"""Early stopping over views: which views, how many, and the same labels."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import blobs, cameras_in_a_row

from gsc_jax import Monitor, RobustEstimator, locate
from gsc_jax.estimators.robust.early_stopping import (
    FIRST_BATCH,
    EarlyStopping,
    batches,
    changed,
    observe_until_stable,
    spread,
)
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.masks import rendered_share

GRID = [[x, y, 3] for x in np.linspace(-1.5, 1.5, 7) for y in np.linspace(-0.8, 0.8, 5)]
SCENE = blobs(GRID, opacity=0.95, scale=0.2)
TRUTH = np.array([x > 0.8 for x, _, _ in GRID])
VIEWS = 30
CAMERAS = cameras_in_a_row(VIEWS, 24, 16, step=0.02)
MASKS = {c.name: rendered_share(SCENE, c, TRUTH) for c in CAMERAS}


class Network:
    """A detector that needs images."""

    needs_image = True

    def __init__(self, first: int = 0):
        self.first = first

    def select(self, cameras):
        return list(cameras)

    def __call__(self, image, camera):
        """Return the truth, except in the first views."""
        del image
        late = LATER.index(camera.name) >= self.first
        return MASKS[camera.name] if late else np.zeros_like(MASKS[camera.name])


LATER = [f"view_{k}" for k in spread(VIEWS)]


def test_views_are_added_until_something_is_labelled():
    result = locate(SCENE, CAMERAS, Network(first=18))
    assert len(result.probabilities) == VIEWS, "stopped before anything was labelled"


def test_the_last_change_decides_and_not_the_first():
    """12 and 18 views label nothing, 27 something, which the next 13 do not change."""
    labels = {12: TRUTH & False, 18: TRUTH & False, 27: TRUTH, 40: TRUTH, 60: TRUTH}
    evidence = Evidence(total=np.ones((1, len(TRUTH))), tampered=np.ones((1, len(TRUTH))))

    def observe(cameras) -> Any:
        return SimpleNamespace(evidence=evidence, views=len(cameras))

    estimator: Any = SimpleNamespace(
        estimate=lambda seen, _: SimpleNamespace(labels=labels[seen.views]), tolerance=0.01
    )
    _, _, stop = observe_until_stable(observe, CAMERAS * 2, estimator, None, Monitor())
    assert (stop.views, stop.changes) == (40, (0, 1, 0))


@given(st.integers(1, 300))
def test_every_view_comes_once_and_early_ones_lie_far_apart(count):
    order = spread(count)
    assert sorted(order) == list(range(count))
    if count >= 16:
        gaps = np.diff(sorted(order[:8]))
        assert gaps.min() >= count // 16


@given(st.integers(1, 1000))
def test_batches_grow_and_end_with_all(count):
    ends = list(batches(count))
    assert ends[-1] == count
    assert ends == sorted(set(ends))
    assert len(ends) == 1 or ends[0] == FIRST_BATCH


def test_the_number_of_views_grows_by_half_and_the_last_batch_is_no_small_one():
    assert list(batches(11)) == [11]
    assert list(batches(17)) == [17]
    assert list(batches(18)) == [12, 18]
    assert list(batches(60)) == [12, 18, 27, 40, 60]


def test_the_reason_names_the_last_change():
    stop = EarlyStopping(views=18, available=30, changes=(0.5, 0.01))
    assert stop.reason == "The last views changed 1.0% of the labelled weight."
    assert dataclasses.replace(stop, views=30).reason == "All views were used."


def test_views_are_added_until_the_labels_are_stable():
    result = locate(SCENE, CAMERAS, Network())
    assert result.early_stopping is not None
    assert result.early_stopping.views < result.early_stopping.available == VIEWS
    assert result.early_stopping.changes[-1] < 0.02
    assert "changed" in result.early_stopping.reason
    assert len(result.probabilities) == len(result.reliability) == result.early_stopping.views
    assert len(result.masks) == VIEWS, "a view has no final mask"
    assert np.array_equal(result.labels, TRUTH)


def test_progress_counts_across_batches():
    calls = []
    locate(SCENE, CAMERAS, Network(), monitor=Monitor(progress=lambda *args: calls.append(args)))
    views = [(done, total) for stage, done, total in calls if stage == "views"]
    assert {total for _, total in views} == {VIEWS}
    done = [done for done, _ in views]
    assert done == sorted(done)
    assert set(done) == set(range(done[-1] + 1))


@pytest.mark.parametrize(("detector", "tolerance"), [(Network(), 0.0), (MASKS, 0.02)])
def test_tolerance_0_and_given_masks_use_every_view(detector, tolerance):
    result = locate(SCENE, CAMERAS, detector, config=RobustEstimator(tolerance=tolerance))
    assert result.early_stopping is None
    assert len(result.probabilities) == VIEWS


@pytest.mark.parametrize(
    ("after", "expected"),
    [([1, 1, 0], 0.0), ([1, 0, 0], 0.5), ([0, 0, 1], 1.0), ([1, 1, 1], 1 / 3)],
)
def test_change_is_a_share_of_the_labelled_weight(after, expected):
    evidence = Evidence(total=np.ones((2, 3)), tampered=np.zeros((2, 3)))
    before = np.array([True, True, False])
    assert changed(before, np.array(after, bool), evidence) == pytest.approx(expected)
    nobody = np.zeros(3, bool)
    assert changed(nobody, nobody, evidence) == 0
