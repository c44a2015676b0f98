"""Masks of labels: the absolute threshold, and the rule of the released code."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import blobs, camera, cameras_in_a_row, floats, random_scene, with_row

from gsc_jax.evidence.masks import (
    MIN_COVERAGE,
    Labelled,
    filled_scores,
    normalise,
    pictures,
    rendered_share,
    stored_masks,
    view_mask,
)
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.storage import ArrayStore
from gsc_jax.scene.gaussians import transparent_rows
from gsc_jax.splat import render

CAMERA = camera(33, 17)
LEFT, RIGHT = [-0.5, 0, 2], [0.5, 0, 2]


def mask_of(scene, labels, rule, *, attribute=None, view=CAMERA) -> np.ndarray:
    labels = np.array(labels, bool)
    attribute = np.array(labels if attribute is None else attribute, np.float32)
    return view_mask(scene, view, Labelled(attribute, labels), rule=rule)


@given(floats(8, -20, 20))
def test_scores_lie_in_the_unit_interval_and_keep_the_order(attribute):
    scores = np.asarray(normalise(attribute))
    assert scores.min() >= 0
    assert scores.max() == pytest.approx(float(attribute.max() > 0))
    assert np.all(np.diff(scores[np.argsort(attribute)]) >= 0)


@pytest.mark.parametrize("unit", [1e-6, 0.5, 1e6])
def test_scores_do_not_depend_on_the_unit_of_the_attribute(unit):
    attribute = np.array([4.0, 1.0, 0.0, -2.0], np.float32)
    np.testing.assert_allclose(normalise(unit * attribute), [1, 0.25, 0, 0], rtol=1e-6)


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("attribute", [np.zeros(3), -np.ones(3), np.array([-2.0, -1, 0])])
def test_scores_without_a_positive_attribute_are_0(attribute):
    assert normalise(attribute.astype(np.float32)).tolist() == [0, 0, 0]


@pytest.mark.parametrize("rule", ["share", "attribute", "per-view"])
def test_the_mask_shows_the_tampered_gaussian_and_not_the_other(rule):
    scene = blobs([LEFT, RIGHT], opacity=0.9)
    mask = mask_of(scene, [True, False], rule)
    assert mask[8, :16].any(), "the tampered Gaussian is invisible"
    assert not mask[8, 20:].any(), "the authentic Gaussian is in the mask"


def test_only_the_released_rule_ignores_occlusion():
    scene = blobs([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 3]], opacity=0.99, scale=0.5)
    assert mask_of(scene, [0, 0, 0, 1], "per-view").any()
    assert not mask_of(scene, [0, 0, 0, 1], "share").any()
    large, hidden = blobs([[0, 0, 3]], opacity=0.9, scale=0.5), blobs([LEFT, [0, 0, 3]], scale=0.5)
    hidden.log_scales[0] -= 1
    hidden.logit_opacities[:] = [5, large.logit_opacities[0]]
    alone = mask_of(large, [True], "per-view")
    assert alone.sum() > 50
    assert np.array_equal(mask_of(hidden, [False, True], "per-view"), alone)


def test_only_the_released_rule_lifts_noise_to_1_in_views_without_the_object():
    scene = blobs([RIGHT, LEFT], opacity=0.9)
    right_is_outside = dataclasses.replace(CAMERA, width=16)
    options = {"attribute": [1.0, 0.005], "view": right_is_outside}
    assert mask_of(scene, [True, True], "per-view", **options).any()
    assert not mask_of(scene, [True, True], "attribute", **options).any()


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("rule", ["share", "attribute", "per-view"])
def test_without_labels_the_mask_is_empty(rule):
    mask = mask_of(blobs([LEFT]), [False], rule)
    assert mask.shape == (17, 33)
    assert mask.dtype == bool
    assert not mask.any()


@pytest.mark.usefixtures("nan_is_an_error")
def test_the_share_is_relative_to_alpha_and_0_on_empty_pixels():
    scene = blobs([LEFT, LEFT], opacity=0.5)
    share = rendered_share(scene, CAMERA, np.array([1.0, 0.0]))
    assert share[8, 11] == pytest.approx(1 / (1 + 0.5), rel=0.05)
    assert share[0, 32] == 0
    assert jnp.all(share <= 1 + 1e-6)


@given(st.integers(0, 2**16), st.floats(0, 0.9))
@settings(max_examples=20, deadline=None)
def test_a_mask_is_where_the_share_exceeds_the_threshold(seed, threshold):
    scene, scores = random_scene(40), np.random.default_rng(seed).random(40, np.float32) ** 3
    scored = Labelled(scores, scores > threshold)
    share = rendered_share(scene, CAMERA, scores)
    mask = view_mask(scene, CAMERA, scored, threshold=threshold)
    assert np.array_equal(mask, share > threshold)
    above = rendered_share(scene, CAMERA, scores, above=threshold)
    np.testing.assert_array_equal(above[mask], share[mask])


def test_a_pixel_exactly_at_the_threshold_is_not_in_the_mask():
    scene = blobs([LEFT, RIGHT], opacity=0.9)
    scores = Labelled(np.array([0.8, 0.3], np.float32), np.array([True, True]))
    share = rendered_share(scene, CAMERA, scores.tamper)
    threshold = float(share[8, 11])
    assert threshold > 0
    mask = view_mask(scene, CAMERA, scores, threshold=threshold)
    assert np.array_equal(mask, share > threshold)
    assert not mask[8, 11]


def test_a_pixel_with_little_alpha_has_no_share():
    alpha = float(np.float32(MIN_COVERAGE))
    for opacity, shown in ((0.5 * alpha, False), (1.5 * alpha, True)):
        share = rendered_share(blobs([LEFT], opacity=opacity), CAMERA, np.ones(1))
        assert share.max() == pytest.approx(float(shown), rel=1e-5)


def test_a_feature_may_be_negative():
    share = rendered_share(blobs([LEFT], opacity=0.9), CAMERA, np.full(1, -1))
    assert share.min() == pytest.approx(-1, rel=1e-5)


@pytest.mark.parametrize("count", [1, 3])
def test_a_feature_has_one_number_per_gaussian(count):
    with pytest.raises(ValueError, match=rf"shape \(2,\), got \({count},\)"):
        rendered_share(blobs([LEFT, RIGHT]), CAMERA, np.ones(count))


def test_a_pixel_at_half_of_the_largest_score_of_the_view_is_not_above_half():
    scene, labels = blobs([LEFT, RIGHT], opacity=0.9), np.array([True, True])
    for score, shown in ((0.5, False), (0.51, True)):
        scores = Labelled(np.array([1.0, score], np.float32), labels)
        mask = view_mask(scene, CAMERA, scores, rule="per-view", threshold=0.5)
        assert mask[8, 11]
        assert mask[8, 21] == shown


def test_a_rendered_share_has_gradients():
    scene, feature = random_scene(30), np.linspace(0, 1, 30, dtype=np.float32)
    by_scene, by_feature = jax.grad(
        lambda scene, feature: jnp.sum(rendered_share(scene, CAMERA, feature)), argnums=(0, 1)
    )(scene, feature)
    step = np.zeros(30, np.float32)
    step[np.argmax(np.abs(by_feature))] = 0.1
    low, high = (rendered_share(scene, CAMERA, feature + sign * step).sum() for sign in (-1, 1))
    assert float(jnp.vdot(by_feature, step)) == pytest.approx(0.5 * (high - low), rel=1e-3)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(by_scene))
    assert np.abs(by_scene.logit_opacities).max() > 0.01


@pytest.mark.parametrize("wrong", [-0.1, 1.0, 1.5, np.nan])
def test_thresholds_are_at_least_0_and_below_1(wrong):
    scene, scores = blobs([LEFT]), Labelled(np.full(1, 0.5, np.float32), np.ones(1, bool))
    with pytest.raises(ValueError, match=r"\[0, 1\)"):
        view_mask(scene, CAMERA, scores, threshold=wrong)
    assert view_mask(scene, CAMERA, scores, threshold=0.0).any()
    assert not view_mask(scene, CAMERA, scores, threshold=0.99).any()
    with pytest.raises(ValueError, match="share, attribute, per-view"):
        view_mask(scene, CAMERA, scores, rule="shares")  # type: ignore[arg-type]


@pytest.mark.parametrize("rule", ["share", "attribute", "per-view"])
def test_mask_render_and_scores_are_those_of_their_functions(rule):
    scene = random_scene(60)
    scores = Labelled(np.linspace(0, 1, 60, dtype=np.float32), np.arange(60) >= 30)
    options = {"rule": rule, "threshold": 0.4, "near": 0.2}
    mask, image, score = pictures(scene, CAMERA, scores, **options)
    assert np.array_equal(mask, view_mask(scene, CAMERA, scores, **options))
    assert mask.any()
    assert not mask.all()
    assert image.dtype == np.uint8
    expected = 255 * np.asarray(render(scene, CAMERA)[0])
    assert expected.max() > 100
    np.testing.assert_allclose(image, expected, atol=0.501)
    np.testing.assert_allclose(score, rendered_share(scene, CAMERA, scores.tamper), atol=1e-6)


def test_bright_renders_are_clipped():
    scene = with_row(blobs([LEFT], opacity=0.9), "sh", 9.0)
    scores = Labelled(np.ones(1, np.float32), np.ones(1, bool))
    _, image, _ = pictures(scene, CAMERA, scores, rule="share", threshold=0.5, near=0.2)
    assert image.max() == 255


@pytest.mark.parametrize("with_pictures", [False, True])
def test_masks_and_pictures_are_stored_by_the_name_of_their_view(with_pictures):
    cameras, calls, store = cameras_in_a_row(3, 4, 3, step=0.1), [], ArrayStore()
    masks = {camera.name: np.full((3, 4), k % 2 == 0) for k, camera in enumerate(cameras)}
    image, score = np.ones((3, 4, 3), np.uint8), np.ones((3, 4), np.float32)

    def compute(camera):
        mask = masks[camera.name]
        return (mask, image, score) if with_pictures else mask

    monitor = Monitor(progress=lambda *step: calls.append(step))
    stored = stored_masks(compute, cameras, store, monitor)
    assert list(stored) == list(masks)
    assert all(np.array_equal(stored[name], mask) for name, mask in masks.items())
    assert calls == [("masks", done, 3) for done in (1, 2, 3)]
    for kind in ("render", "score"):
        assert [store.has(kind, name) for name in masks] == [with_pictures] * 3


def test_transparent_rows_have_no_score_and_no_label():
    filled = filled_scores(Labelled(np.full(17, 0.5, np.float32), np.ones(17, bool)))
    assert len(filled.tamper) == len(filled.labels) == 17 + transparent_rows(17) > 17
    assert filled.tamper[:17].tolist() == [0.5] * 17
    assert filled.labels[:17].all()
    assert not filled.tamper[17:].any()
    assert not filled.labels[17:].any()
