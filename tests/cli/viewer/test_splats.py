"""Splats, their order, and cameras as poses."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, motions, random_scene, scenes

from gsc_jax.cli.viewer.contents import pose
from gsc_jax.cli.viewer.splats import (
    by_importance,
    fit_half_precision,
    half_precision_unit,
    splats,
)

UP = np.array([0.0, -1.0, 0.0])


class TestSplats:
    @given(scenes())
    def test_covariances_have_the_scales_along_the_axes(self, gaussians):
        made = splats(gaussians)
        turned = Rotation.from_quat(np.asarray(gaussians.quats), scalar_first=True).as_matrix()
        inside = np.einsum("nji,njk,nkl->nil", turned, made.covariances, turned)
        expected = np.exp(2 * gaussians.log_scales)[:, :, None] * np.eye(3)
        np.testing.assert_allclose(inside, expected, atol=1e-5)
        np.testing.assert_array_equal(made.covariances, made.covariances.swapaxes(1, 2))

    @given(st.floats(1e-4, 1e4))
    def test_covariances_survive_half_precision_in_any_unit(self, size):
        scene = random_scene(200)
        scene = dataclasses.replace(
            scene, log_scales=(scene.log_scales + np.log(size)).astype(np.float32)
        )
        covariances = splats(scene).covariances / half_precision_unit(splats(scene)) ** 2
        stored = fit_half_precision(covariances).astype(np.float16).astype(np.float32)
        largest_entry = np.abs(covariances).max(axis=(1, 2), keepdims=True)
        assert (np.abs(stored - covariances) <= 2e-3 * largest_entry).all()

    def test_covariances_of_extreme_sizes_stay_finite(self):
        huge = np.diag([1e9, 1e8, 1.0])[None].astype(np.float32)
        fitted = fit_half_precision(huge)
        assert np.isfinite(fitted.astype(np.float16)).all()
        np.testing.assert_allclose(fitted / fitted.max(), huge / huge.max(), rtol=1e-6)
        assert half_precision_unit(splats(blobs([[0, 0, 1]], scale=1e-30))) == 1

    def test_the_most_important_have_the_largest_opacity_times_area(self):
        scene = random_scene(20)
        none = np.zeros(20, bool)
        order = by_importance(scene, labelled=none)
        np.testing.assert_array_equal(order, np.argsort(-sizes(scene)))
        np.testing.assert_array_equal(order, by_importance(scene, labelled=~none))

    @given(st.integers(1, 20))
    def test_half_are_the_largest_labelled_ones_and_the_rest_the_largest_others(self, count):
        scene = random_scene(20)
        labelled = np.arange(20) % 4 == 0
        order = np.argsort(-sizes(scene))
        first = [row for row in order if labelled[row]][: count // 2]
        rest = [row for row in order if not labelled[row]]
        rest = (rest + [row for row in order if labelled[row]][len(first) :])[: count - len(first)]
        rows = by_importance(scene, labelled=labelled)
        assert sorted(rows[:count]) == sorted([*first, *rest])
        assert sorted(rows) == list(range(20))

    def test_what_cannot_be_seen_comes_last_even_if_labelled(self):
        scene = blobs(np.eye(4, 3))
        opacities = np.where([True, False, False, True], -200, 1).astype(np.float32)
        scene = dataclasses.replace(scene, logit_opacities=opacities)
        rows = by_importance(scene, labelled=np.array([True, True, False, False]))
        assert rows.tolist() == [2, 1, 0, 3]


def sizes(scene) -> np.ndarray:
    """Opacity times area of the two largest axes, (N,)."""
    axes = np.sort(np.asarray(scene.scales), axis=1)
    return np.asarray(scene.opacities) * axes[:, 1] * axes[:, 2]


class TestPoses:
    @given(motions())
    def test_pose_inverts_the_view_matrix(self, motion):
        quat, translation = motion
        viewmat = np.eye(4)
        viewmat[:3, :3] = Rotation.from_quat(quat, scalar_first=True).as_matrix()
        viewmat[:3, 3] = translation
        placed = pose(camera(viewmat=viewmat), np.zeros((1, 3)), up=UP)
        back = viewmat[:3, :3] @ placed.position + viewmat[:3, 3]
        np.testing.assert_allclose(back, 0, atol=1e-4)
        ahead = viewmat[:3, :3] @ placed.look_at + viewmat[:3, 3]
        np.testing.assert_allclose(ahead[:2], 0, atol=1e-4)
        assert ahead[2] > 0
        # Up points to neither side of the image, and not down.
        inside = viewmat[:3, :3] @ placed.up
        assert abs(inside[0]) < 1e-5
        assert inside[1] < 0
        assert np.linalg.norm(placed.up) == pytest.approx(1)

    def test_target_is_at_the_median_depth_of_visible_gaussians(self):
        means = np.array([[0, 0, 2], [0, 0, 3], [0, 0, 4], [0, 0, -9], [50, 0, 1]])
        placed = pose(camera(), means, up=UP)
        np.testing.assert_allclose(placed.look_at, [0, 0, 3])

    def test_field_of_view_is_that_of_the_image(self):
        placed = pose(camera(40, 30, focal=20), np.ones((1, 3)), up=UP)
        assert np.tan(placed.fov / 2) == pytest.approx(15 / 20)
