"""Coarse to fine: what coarse evidence is, and that refined evidence is that of all pixels."""

import numpy as np
import pytest
from coarse_to_fine import (
    CoarseToFine,
    coarse_evidence,
    covered_tiles,
    labels_where_needed,
    reaching,
)
from hypothesis import given
from hypothesis import strategies as st
from strategies import blobs, cameras_in_a_row

from gsc_jax import RobustEstimator, observe
from gsc_jax.evidence.masks import rendered_share
from gsc_jax.render.projection import project

GRID = [[x, y, 3] for x in np.linspace(-1.5, 1.5, 15) for y in np.linspace(-0.8, 0.8, 9)]
SCENE = blobs(GRID, opacity=0.95, scale=0.08)
TRUTH = np.array([x > 1.4 for x, _, _ in GRID])
SCENE.log_scales[0], SCENE.means[0] = np.log(0.2), [1.65, 0, 3.3]
"""The first is a wall behind the edit, with its centre there, that mostly lies elsewhere."""
TRUTH[0], MEANS = False, np.asarray(SCENE.means)
CAMERAS = [c.resized(192, 128) for c in cameras_in_a_row(12, 24, 16, step=0.02)]
MASKS = {c.name: rendered_share(SCENE, c, TRUTH) > 0.5 for c in CAMERAS}


def coarse_to_fine() -> CoarseToFine:
    return CoarseToFine(SCENE, CAMERAS, MASKS)


def test_coarse_weights_of_a_view_add_up_to_its_pixels_and_splats_hide_each_other():
    scene = blobs([[0, 0, 3], [0, 0, 4], [0.5, 0, 4]], opacity=0.99, scale=0.1)
    mask = np.ones((128, 192), bool)
    rows, *bits = coarse_evidence(project(scene, CAMERAS[6]), mask)[:3]
    total, tampered = (part.view(np.float32) for part in bits)
    assert rows.tolist() == [0, 1, 2]
    assert total.sum() == pytest.approx(mask.size, rel=1e-4)
    assert np.array_equal(tampered, total)
    assert total[1] < 0.2 * total[2], "the Gaussian behind another one counts like a free one"


box = st.tuples(st.integers(0, 6), st.integers(0, 4), st.integers(0, 3), st.integers(0, 3))


@given(st.lists(box, max_size=4), st.lists(box, min_size=1, max_size=4))
def test_tiles_of_boxes_agree_with_a_loop_over_tiles(chosen, others):
    def boxes(some):
        return np.array([(x, y, x + w, y + h) for x, y, w, h in some], np.int32).reshape(-1, 4).T

    expected = np.zeros((8, 10), bool)
    for x, y, w, h in chosen:
        expected[y : y + h + 1, x : x + w + 1] = True
    tiles = covered_tiles(boxes(chosen), (8, 10))
    assert np.array_equal(tiles, expected)
    meets = [expected[y : y + h + 1, x : x + w + 1].any() for x, y, w, h in others]
    assert reaching(boxes(others), tiles).tolist() == meets


def test_the_evidence_of_chosen_gaussians_is_that_of_all_pixels_and_mends_the_coarse_one():
    views, full = coarse_to_fine(), observe(SCENE, CAMERAS, MASKS).evidence
    rows = views.candidates
    assert rows[TRUTH].all()
    assert rows[0], "the wall is flagged at its centre"
    refined, pixels = views.observe(rows, 1.0)
    assert refined is not None
    assert 0 < pixels < 0.6
    for fine, exact in zip(refined.of(rows), full.of(rows), strict=True):
        np.testing.assert_allclose(fine, exact, rtol=1e-5, atol=1e-5)
    coarse, _ = views.observe(rows & TRUTH, 1.0)
    assert coarse is not None
    shares = [
        float(tampered.sum() / total.sum())
        for total, tampered in (e.of(np.array([0])) for e in (coarse, refined))
    ]
    assert shares[0] > 0.9, "the coarse evidence of the wall is not wrong"
    assert shares[1] < 0.5, "it was not mended"


def test_more_pixels_than_allowed_are_not_observed():
    evidence, pixels = coarse_to_fine().observe(np.ones(len(TRUTH), bool), 0.6)
    assert evidence is None
    assert pixels > 0.6


def test_labels_from_the_needed_pixels_are_those_from_all_and_deterministic():
    (one, outside, pixels), (two, *_) = (
        labels_where_needed(coarse_to_fine(), MEANS, RobustEstimator()) for _ in range(2)
    )
    assert one is not None
    assert two is not None
    assert np.array_equal(one, TRUTH)
    assert np.array_equal(one, two)
    assert outside[-1] <= RobustEstimator().tolerance
    assert pixels < 0.6


@pytest.mark.parametrize("value", [False, True])
def test_masks_without_an_object_need_all_pixels(value):
    masks = {name: np.full(mask.shape, value) for name, mask in MASKS.items()}
    views = CoarseToFine(SCENE, CAMERAS, masks)
    assert labels_where_needed(views, MEANS, RobustEstimator())[0] is None
