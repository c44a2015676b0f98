"""SAGD's boundary decomposition: cases worked by hand, and laws."""

import dataclasses

import numpy as np
import pytest
from boundary import sagd_boundary
from hypothesis import assume, given
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, motions, random_scene, with_row

# 8 pixels per unit at depth 4, so that a standard deviation of 0.5 along x is 4 pixels: the segment
# goes from column 26 to 38.
WIDE = camera(64, 64, focal=32.0)
NEEDLE = with_row(blobs([0, 0, 4], scale=0.05), "log_scales", np.log([0.5, 0.05, 0.05]))
LEFT = np.arange(64)[None].repeat(64, 0) < 35
"""Mask that contains 0.75 of the needle."""
SELECTED = np.array([True])


def assert_cut(cut, x: float, scale: float, *, depth: float = 4.0, tolerance: float = 0.012):
    np.testing.assert_allclose(cut.means[0], [x, 0, depth], atol=tolerance)
    np.testing.assert_allclose(np.exp(cut.log_scales[0, 0]), scale, atol=tolerance)


def test_a_boundary_gaussian_is_cut_back_by_hand():
    cut = sagd_boundary(NEEDLE, SELECTED, WIDE, LEFT)
    # rho 0.75: scaled by 0.6, moved by 0.5 * 0.25 * 3 * 0.5 = 0.1875 to the left.
    assert_cut(cut, -0.1875, 0.3)
    assert np.ptp(cut.log_scales - NEEDLE.log_scales) < 1e-6, "the axes shrink differently"
    # rho 0.25: scaled by 0.2, moved by 0.5 * 0.75 * 3 * 0.5 = 0.5625 to the right.
    assert_cut(sagd_boundary(NEEDLE, SELECTED, WIDE, ~LEFT), 0.5625, 0.1)
    for field in ("quats", "logit_opacities", "sh"):
        assert getattr(cut, field) is getattr(NEEDLE, field)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_turned_gaussian_is_cut_along_its_own_axis(sign):
    # A quarter turn about z lays the needle along y; either sign of the quaternion is that turn.
    quat = sign * np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    upright = with_row(NEEDLE, "quats", quat)
    cut = sagd_boundary(upright, SELECTED, WIDE, LEFT.T)
    np.testing.assert_allclose(cut.means[0], [0, -0.1875, 4], atol=0.01)
    # Half a quarter about y, away from the camera: the projection is sqrt(1/2) as long.
    slanted = with_row(
        NEEDLE, "quats", sign * np.array([np.cos(np.pi / 8), 0, -np.sin(np.pi / 8), 0])
    )
    cut = sagd_boundary(slanted, SELECTED, WIDE, np.arange(64)[None].repeat(64, 0) < 32)
    # rho 0.5: moved by 0.5 * 0.5 * 3 * 0.5 = 0.375 along (-1, 0, -1) / sqrt(2).
    assert_cut(cut, -0.265, 0.2, depth=4 - 0.265)


def test_off_the_optical_axis_a_receding_end_moves_to_the_image_centre():
    # At (2, 0, 4), in pixel 48, a needle along (0.2, 0, 0.98): its far end is to the right in space
    # but to the left in the image, since 0.2 - 0.98 * 2 / 4 < 0.
    quat = Rotation.from_euler("y", -np.arctan2(0.98, 0.2)).as_quat(scalar_first=True)
    receding = with_row(with_row(NEEDLE, "means", [2, 0, 4]), "quats", quat)
    cut = sagd_boundary(receding, SELECTED, WIDE, np.arange(64)[None].repeat(64, 0) < 48)
    np.testing.assert_allclose(
        cut.means[0] - np.array([2, 0, 4]), [0.375 * 0.2, 0, 0.375 * 0.98], atol=0.01
    )


@given(motions())
def test_cuts_are_equivariant_to_rigid_motions(motion):
    quat, shift = motion
    rotation = Rotation.from_quat(quat, scalar_first=True)
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.inv().as_matrix()
    viewmat[:3, 3] = -rotation.inv().apply(shift)

    def moved(scene):
        means = (rotation.apply(scene.means) + shift).astype(np.float32)
        quats = (rotation * Rotation.from_quat(scene.quats, scalar_first=True)).as_quat(
            scalar_first=True
        )
        return dataclasses.replace(scene, means=means, quats=quats.astype(np.float32))

    cut = sagd_boundary(moved(NEEDLE), SELECTED, dataclasses.replace(WIDE, viewmat=viewmat), LEFT)
    expected = moved(sagd_boundary(NEEDLE, SELECTED, WIDE, LEFT))
    np.testing.assert_allclose(cut.means, expected.means, atol=1e-5)
    np.testing.assert_allclose(cut.log_scales, expected.log_scales, atol=1e-5)


def test_gaussians_that_do_not_cross_the_border_stay():
    hole = np.ones((64, 64), bool)
    hole[:, 30:34] = False  # under the middle of the needle, whose ends are both inside
    behind = with_row(NEEDLE, "means", [0, 0, -4])
    for gaussians, labels, mask in (
        (NEEDLE, SELECTED, hole),
        (NEEDLE, SELECTED, ~hole),
        (NEEDLE, ~SELECTED, LEFT),
        (behind, SELECTED, LEFT),
    ):
        cut = sagd_boundary(gaussians, labels, WIDE, mask)
        assert np.array_equal(cut.means, gaussians.means)
        assert np.array_equal(cut.log_scales, gaussians.log_scales)


@pytest.mark.parametrize(("column", "cut"), [(33.4, False), (33.6, True)])
def test_the_segment_ignores_the_low_pass(column, cut):
    # A standard deviation of 1 pixel reaches 1.5; with the low-pass it would be 1.14 and 1.71. The
    # border is 1.6 or 1.4 pixels away.
    dot = blobs([(column - 32) / 8, 0, 4], scale=0.125)
    changed = sagd_boundary(dot, SELECTED, WIDE, LEFT).log_scales != dot.log_scales
    assert changed.all() == changed.any() == cut


@pytest.mark.usefixtures("nan_is_an_error")
def test_a_share_near_zero_leaves_a_small_gaussian():
    # The end at 38.001 is inside and next to nothing else.
    touching = with_row(NEEDLE, "means", [0.001 / 8, 0, 4])
    cut = sagd_boundary(touching, SELECTED, WIDE, np.arange(64)[None].repeat(64, 0) >= 38)
    assert np.isfinite(cut.log_scales).all()
    assert 0 < np.exp(cut.log_scales[0, 0]) < 0.02 * 0.5
    assert_cut(cut, 0.75, 0.0)


@given(hnp.arrays(bool, (15, 17)), hnp.arrays(bool, 40))
def test_only_selected_gaussians_shrink(mask, labels):
    scene = random_scene(40)
    cut = sagd_boundary(scene, labels, camera(17, 15), mask)
    shrunk = cut.log_scales - scene.log_scales
    assert np.isfinite(shrunk).all()
    assert np.all(shrunk <= 0)
    changed = shrunk[:, 0] < 0
    assert np.all(changed <= labels)
    np.testing.assert_array_equal(cut.means[~changed], scene.means[~changed])
    assume(changed.any())
    assert np.all(shrunk[changed] <= np.log(0.8) + 1e-5)
