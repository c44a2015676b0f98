"""Looking no longer than it takes: which views, how many, and that nothing depends on it."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import blobs, camera

from gsc_jax import RobustConfig, locate
from gsc_jax.estimators.robust.early_stopping import FIRST, batches, changed, spread
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.masks import rendered_share

GRID = [[x, y, 3] for x in np.linspace(-1.5, 1.5, 7) for y in np.linspace(-0.8, 0.8, 5)]
SCENE = blobs(GRID, opacity=0.95, scale=0.2)
TRUTH = np.array([x > 0.8 for x, _, _ in GRID])
VIEWS = 30


def cameras():
    found = []
    for index in range(VIEWS):
        viewmat = np.eye(4)
        viewmat[0, 3] = 0.02 * (index - VIEWS / 2)
        found.append(dataclasses.replace(camera(24, 16, viewmat=viewmat), name=f"view_{index}"))
    return found


CAMERAS = cameras()
MASKS = {c.name: rendered_share(SCENE, c, TRUTH) for c in CAMERAS}


class Network:
    """A detector that has to be shown the images."""

    needs_image = True

    def __init__(self, first: int = 0):
        self.first = first

    def select(self, cameras):
        return list(cameras)

    def __call__(self, image, camera):
        """The truth, in the views that are looked at after the first ones."""
        del image
        late = LATER.index(camera.name) >= self.first
        return MASKS[camera.name] if late else np.zeros_like(MASKS[camera.name])


LATER = [f"view_{k}" for k in spread(VIEWS)]


def test_masks_that_are_there_are_all_used():
    assert len(locate(SCENE, CAMERAS, MASKS).detections) == VIEWS


def test_views_are_added_until_something_is_found():
    result = locate(SCENE, CAMERAS, Network(first=18))
    assert len(result.detections) == VIEWS, "it stopped before anything could be found"


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
    assert len(ends) == 1 or ends[0] == FIRST


def test_views_are_added_until_the_labels_stay():
    result = locate(SCENE, CAMERAS, Network())
    assert result.effort is not None
    assert result.effort.views < result.effort.available == VIEWS
    assert result.effort.changes[-1] < 0.02
    assert "changed" in result.effort.reason
    assert len(result.detections) == len(result.reliability) == result.effort.views
    assert len(result.masks) == VIEWS, "the final masks are those of every view"
    assert np.array_equal(result.labels, TRUTH)


def test_progress_counts_on_over_the_batches():
    told = []
    locate(SCENE, CAMERAS, Network(), progress=lambda *args: told.append(args))
    looked = [(done, total) for stage, done, total in told if stage == "look"]
    assert {total for _, total in looked} == {VIEWS}
    done = [done for done, _ in looked]
    assert done == sorted(done)
    assert set(done) == set(range(done[-1] + 1))


def test_without_tolerance_every_view_is_looked_at():
    result = locate(SCENE, CAMERAS, Network(), config=RobustConfig(tolerance=0.0))
    assert result.effort is None
    assert len(result.detections) == VIEWS


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
