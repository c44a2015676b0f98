"""What the viewer is given of a scene: splats, their colours in each mode, cameras as poses."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, floats, motions, random_scene, scenes

from gsc_jax.cli.viewer.exhibit import counted, legend
from gsc_jax.cli.viewer.poses import pose, upward
from gsc_jax.cli.viewer.splats import MODES, fitting_half, half_unit, heat, largest, shown, splats

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

    def test_colours_and_opacities_are_those_of_the_file(self):
        made = splats(blobs([[0, 0, 1]], opacity=0.25))
        np.testing.assert_allclose(made.rgbs, 0.5)
        np.testing.assert_allclose(made.opacities, [[0.25]], rtol=1e-6)

    @given(st.floats(1e-4, 1e4))
    def test_covariances_survive_half_precision_in_any_unit(self, size):
        scene = random_scene(200)
        scene = dataclasses.replace(
            scene, log_scales=(scene.log_scales + np.log(size)).astype(np.float32)
        )
        covariances = splats(scene).covariances / half_unit(splats(scene)) ** 2
        stored = fitting_half(covariances).astype(np.float16).astype(np.float32)
        largest_entry = np.abs(covariances).max(axis=(1, 2), keepdims=True)
        assert (np.abs(stored - covariances) <= 2e-3 * largest_entry).all()

    def test_what_is_too_large_keeps_its_form(self):
        huge = np.diag([1e9, 1e8, 1.0])[None].astype(np.float32)
        fitted = fitting_half(huge)
        assert np.isfinite(fitted.astype(np.float16)).all()
        np.testing.assert_allclose(fitted / fitted.max(), huge / huge.max(), rtol=1e-6)

    def test_points_without_extent_have_a_unit(self):
        assert half_unit(splats(blobs([[0, 0, 1]], scale=1e-30))) == 1

    @given(st.integers(1, 30))
    def test_the_largest_are_those_of_most_opacity_times_area(self, count):
        scene = random_scene(20)
        axes = np.sort(np.asarray(scene.scales), axis=1)
        shows = np.asarray(scene.opacities) * axes[:, 1] * axes[:, 2]
        expected = np.sort(np.argsort(-shows)[:count])
        nobody = np.zeros(20, bool)
        np.testing.assert_array_equal(largest(scene, count, first=nobody), expected)

    @given(st.integers(1, 20))
    def test_what_is_tampered_is_not_left_out_for_what_is_large(self, count):
        scene = random_scene(20)
        first = np.arange(20) % 4 == 0
        rows = largest(scene, count, first=first)
        assert first[rows].sum() == min(count, first.sum())


class TestShown:
    SCORE = np.array([0, 0.3, 0.5, 0.7, 1], np.float32)
    SPLATS = splats(blobs(np.eye(5, 3)))

    @given(st.sampled_from([0.0, 0.3, 0.5, 0.9, 1.0]))
    def test_tampered_and_authentic_share_the_scene(self, threshold):
        _, tampered = shown(self.SPLATS, self.SCORE, "tampered only", threshold)
        _, authentic = shown(self.SPLATS, self.SCORE, "authentic only", threshold)
        np.testing.assert_array_equal(tampered + authentic, self.SPLATS.opacities)
        np.testing.assert_array_equal(tampered[:, 0] > 0, np.float32(threshold) < self.SCORE)

    def test_the_original_is_what_it_was(self):
        rgbs, opacities = shown(self.SPLATS, self.SCORE, "original", 0.5)
        np.testing.assert_array_equal(rgbs, self.SPLATS.rgbs)
        np.testing.assert_array_equal(opacities, self.SPLATS.opacities)

    def test_a_heat_map_gets_lighter_with_the_score(self):
        rgbs, opacities = shown(self.SPLATS, self.SCORE, "heat map", 0.5)
        assert (np.diff(rgbs @ [0.299, 0.587, 0.114]) > 0.03).all()
        np.testing.assert_array_equal(opacities, self.SPLATS.opacities)

    def test_colours_are_colours(self):
        colors = heat(np.linspace(0, 1, 50))
        assert colors.shape == (50, 3)
        assert colors.dtype == np.float32
        assert (colors >= 0).all()
        assert (colors <= 1).all()
        assert legend().count("rgb(") > 2

    def test_the_count_says_what_is_above(self):
        assert counted(self.SCORE, 0.5) == "2 of 5 Gaussians (40.0%) score above it"


class TestPoses:
    @given(motions())
    def test_a_pose_inverts_the_view_matrix(self, motion):
        quat, translation = motion
        viewmat = np.eye(4)
        viewmat[:3, :3] = Rotation.from_quat(quat, scalar_first=True).as_matrix()
        viewmat[:3, 3] = translation
        placed = pose(camera(viewmat=viewmat), np.zeros((1, 3)), up=UP)
        turned = Rotation.from_quat(placed.wxyz, scalar_first=True).as_matrix()
        np.testing.assert_allclose(viewmat[:3, :3] @ turned, np.eye(3), atol=1e-5)
        back = viewmat[:3, :3] @ placed.position + viewmat[:3, 3]
        np.testing.assert_allclose(back, 0, atol=1e-4)
        ahead = viewmat[:3, :3] @ placed.look_at + viewmat[:3, 3]
        np.testing.assert_allclose(ahead[:2], 0, atol=1e-4)
        assert ahead[2] > 0
        # Up in its image: to no side, and not down.
        inside = viewmat[:3, :3] @ placed.up
        assert abs(inside[0]) < 1e-5
        assert inside[1] < 0
        assert np.linalg.norm(placed.up) == pytest.approx(1)

    def test_it_looks_at_what_is_there(self):
        means = np.array([[0, 0, 2], [0, 0, 3], [0, 0, 4], [0, 0, -9], [50, 0, 1]])
        placed = pose(camera(), means, up=UP)
        np.testing.assert_allclose(placed.look_at, [0, 0, 3])

    def test_its_angles_are_those_of_the_image(self):
        placed = pose(camera(40, 30, focal=20), np.ones((1, 3)), up=UP)
        assert np.tan(placed.fov / 2) == pytest.approx(15 / 20)
        assert placed.aspect == pytest.approx(40 / 30)

    @given(floats(3, -1, 1))
    def test_upright_cameras_tell_what_is_up(self, axis):
        turned = Rotation.from_rotvec([0, axis[1], 0]).as_matrix()
        viewmat = np.eye(4)
        viewmat[:3, :3] = turned
        np.testing.assert_allclose(upward([camera(viewmat=viewmat)]), UP, atol=1e-6)

    def test_nobody_to_tell_what_is_up(self):
        flipped = np.diag([-1.0, -1.0, 1.0, 1.0])
        np.testing.assert_array_equal(upward([camera(), camera(viewmat=flipped)]), UP)


def test_modes_are_four():
    assert MODES == ("original", "heat map", "tampered only", "authentic only")
