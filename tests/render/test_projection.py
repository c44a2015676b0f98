"""The projection: the float64 reference, laws, and rows that cannot be rendered."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st
from strategies import blobs, camera, needles, random_scene, scenes, with_row

from gsc_jax.render.projection import MIN_ALPHA, project, project_centers
from gsc_jax.render.reprojection import reprojected
from gsc_jax.render.tiles import make_view
from gsc_jax.scene.gaussians import usable_rows
from gsc_jax.splat import render_view

SIZES = [(1, 1), (15, 17), (33, 1), (17, 33)]
CLOSE_TO_THE_BORDER = 1e-3
"""Distance in pixels within which rounding may decide whether a splat touches the image."""


def visible_in(expected: reference.Projection, width: int, height: int, *, margin: float):
    """Mask of the visible Gaussians of an image that is `margin` pixels larger on each side."""
    low, high = expected.means - expected.extents, expected.means + expected.extents
    touches = (high > -margin).all(axis=1) & (low < np.array([width, height]) + margin).all(axis=1)
    return expected.in_front & touches & (expected.opacities > MIN_ALPHA)


def tilted(width: int, height: int):
    """A rotated and moved camera with its principal point off the centre."""
    view = np.eye(4)
    view[:3, :3] = reference.rotations(np.array([[0.95, 0.15, -0.2, 0.1]]))[0]
    view[:3, 3] = [0.2, -0.1, 0.3]
    shift = np.array([[0, 0, 3.3], [0, 2, -2.1], [0, 0, 0]], np.float32)
    straight = camera(width, height, viewmat=view, focal=25)
    return dataclasses.replace(straight, K=straight.K + shift)


@pytest.mark.parametrize("size", SIZES)
def test_splats_agree_with_the_reference(size):
    gaussians, view = random_scene(200), tilted(*size)
    splats, expected = project(gaussians, view), reference.project(gaussians, view)
    seen = np.asarray(splats.visible)
    assert 5 < seen.sum() < 200, "the scene has both visible and invisible Gaussians"
    covs = expected.covs[:, [0, 0, 1], [0, 1, 1]]
    reach = 2 * np.log(np.maximum(expected.opacities, 1e-9) * 255)
    np.testing.assert_allclose(splats.means[seen], expected.means[seen], rtol=1e-5, atol=1e-5)
    scale = covs[seen].max(axis=1, keepdims=True)
    np.testing.assert_allclose(splats.covs[seen] / scale, covs[seen] / scale, atol=2e-6)
    np.testing.assert_allclose(splats.depths[seen], expected.depths[seen], rtol=1e-6)
    np.testing.assert_allclose(splats.opacities[seen], expected.opacities[seen], rtol=1e-6)
    np.testing.assert_allclose(splats.reach[seen], reach[seen], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("size", SIZES)
def test_visible_splats_are_those_that_touch_the_image(size):
    gaussians, view = random_scene(200, seed=1), tilted(*size)
    seen = np.asarray(project(gaussians, view).visible)
    expected = reference.project(gaussians, view)
    surely = visible_in(expected, *size, margin=-CLOSE_TO_THE_BORDER)
    perhaps = visible_in(expected, *size, margin=CLOSE_TO_THE_BORDER)
    assert not (surely & ~seen).any(), "a splat that touches the image is invisible"
    assert not (seen & ~perhaps).any(), "a splat is visible that cannot touch the image"


@pytest.mark.parametrize("aspect", [1, 1e2, 1e4, 1e6])
def test_whitening_gives_the_exponent_of_any_needle(aspect):
    gaussians, view = needles(200, length=aspect * 1e-3), tilted(17, 33)
    splats, expected = project(gaussians, view), reference.project(gaussians, view)
    seen = np.flatnonzero(splats.visible)
    a, b, c = np.asarray(splats.whitening, np.float64)[seen].T
    matrix = np.stack([np.stack([a, b], -1), np.stack([0 * c, c], -1)], axis=1)
    product = 2 * matrix.transpose(0, 2, 1) @ matrix @ expected.covs[seen]
    # The error is relative to the entries of the covariance, which reach aspect^2.
    size = np.linalg.norm(expected.covs[seen], axis=(1, 2))
    worst = np.abs(product - np.eye(2)).max(axis=(1, 2)) / np.maximum(size, 1)
    assert len(seen) > 5
    assert worst.max() < 1e-5


def test_gaussians_closer_than_the_near_plane_or_too_faint_are_invisible():
    gaussians = blobs([[0, 0, z] for z in (-1, 0, 0.1, 0.19, 0.21, 1)])
    assert project(gaussians, camera()).visible.tolist() == [False] * 4 + [True] * 2
    assert project(gaussians, camera(), near=0.05).visible.tolist() == [False] * 2 + [True] * 4
    assert project(gaussians, camera(), near=0.5).visible.tolist() == [False] * 5 + [True]
    faint, enough = (blobs([0, 0, 2], opacity=o) for o in (0.99 / 255, 1.01 / 255))
    assert not project(faint, camera()).visible[0]
    assert project(enough, camera()).visible[0]


ROWS = {
    "means": [np.nan, np.inf, -np.inf],
    "log_scales": [np.nan, np.inf, 89.0, 3e38],
    "quats": [np.nan, np.inf, -np.inf],
    "logit_opacities": [np.nan, -np.inf, -3e38],
}


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize(("field", "value"), [(f, v) for f, values in ROWS.items() for v in values])
def test_a_row_that_cannot_be_rendered_is_invisible_and_finite(field, value):
    gaussians = blobs([[0, 0, 2], [0, 0.1, 2]])
    assert project(gaussians, camera()).visible.all()
    broken = with_row(gaussians, field, value)
    splats = project(broken, camera())
    assert splats.visible.tolist() == [False, True]
    assert usable_rows(broken)[1], "a visible row counts as invalid"
    for leaf in jax.tree.leaves(splats):
        assert np.isfinite(leaf).all()
    assert not np.asarray(splats.reach)[0].any(), "the placeholder reaches somewhere"


@pytest.mark.usefixtures("nan_is_an_error")
def test_extreme_but_valid_rows_are_visible():
    ordinary = blobs([0, 0, 2], opacity=0.9)
    opaque = project(with_row(ordinary, "logit_opacities", np.inf), camera())
    assert opaque.visible[0]
    assert opaque.opacities[0] == 1
    point = project(with_row(ordinary, "log_scales", -np.inf), camera())
    assert point.visible[0]
    np.testing.assert_allclose(point.covs[0], [0.3, 0, 0.3], atol=1e-7)
    zero = project(with_row(ordinary, "quats", 0), camera())
    np.testing.assert_array_equal(zero.covs, project(ordinary, camera()).covs)
    assert zero.visible[0]
    for log_scale in (5.0, 20.0, 40.0):
        huge = project(with_row(ordinary, "log_scales", log_scale), camera())
        assert huge.visible[0], "the splat is invisible"
        assert np.isfinite(huge.whitening).all()


def test_the_jacobian_is_clamped_outside_the_field_of_view():
    """Far aside and close to the near plane, the linear map would spread over the image."""
    aside = blobs([[1.5, 0, 0.25], [3.0, 0, 0.25], [3.0, -2.0, 0.25]], opacity=0.9, scale=0.8)
    splats, expected = project(aside, camera()), reference.project(aside, camera())
    covs = expected.covs[:, [0, 0, 1], [0, 1, 1]]
    seen = np.asarray(splats.visible)
    assert seen[0]
    np.testing.assert_allclose(splats.covs[seen], covs[seen], rtol=1e-5)
    slope = (0.5 + 0.15) * 17 / 20
    unclamped = covs[0, 0] + (20 * 0.8 / 0.25) ** 2 * (6**2 - slope**2)
    assert unclamped > 5 * covs[0, 0], "the clamp makes no difference here"


@given(scenes(), st.sampled_from([-1.0, 1e-25, 0.5, -3.0, 1e6, 1e25]))
def test_scaling_or_negating_quaternions_changes_nothing(gaussians, factor):
    scaled = dataclasses.replace(gaussians, quats=gaussians.quats * np.float32(factor))
    before, after = project(gaussians, camera()), project(scaled, camera())
    np.testing.assert_allclose(after.covs, before.covs, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(after.whitening, before.whitening, rtol=1e-3, atol=1e-5)


def test_projected_centers_agree_with_the_reference():
    gaussians, view = random_scene(50), tilted(17, 33)
    means, depths = project_centers(jnp.asarray(gaussians.means), view.viewmat, view.K)
    expected = reference.project(gaussians, view)
    front = expected.in_front
    np.testing.assert_allclose(means[front], expected.means[front], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(depths[front], expected.depths[front], rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"viewmat": np.eye(4)[:3]}, r"viewmat must be an array \(4, 4\), got ndarray of shape"),
        ({"viewmat": np.eye(4).tolist()}, r"viewmat must be an array \(4, 4\), got list"),
        ({"viewmat": np.full((4, 4), np.nan)}, "viewmat must be finite"),
        ({"viewmat": np.tri(4)}, "last row"),
        ({"K": [20.0, 20.0, 8.0, 8.0]}, r"K must be an array \(3, 3\), got list"),
        ({"K": np.full((3, 3), np.inf)}, "K must be finite"),
    ],
)
def test_matrices_that_are_none_of_a_camera_are_refused(changes, message):
    broken = dataclasses.replace(camera(16, 16), **changes)
    with pytest.raises(ValueError, match=message):
        project(blobs([[0, 0, 3]]), broken)


def test_what_is_no_scene_is_refused_by_its_type():
    with pytest.raises(TypeError, match="expected Gaussians, as of load_ply, got str"):
        project("scene.ply", camera(16, 16))  # pyright: ignore[reportArgumentType]
    lists = jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), blobs([[0, 0, 3]]))
    with pytest.raises(ValueError, match=r"means of 0 Gaussians must be \(0, 3\), got list"):
        project(lists, camera(16, 16))


def test_what_is_no_camera_is_refused_by_its_type():
    with pytest.raises(TypeError, match="expected a Camera, got str"):
        project(blobs([[0, 0, 3]]), "camera")  # pyright: ignore[reportArgumentType]


def test_a_camera_on_the_device_may_come_from_outside_of_a_compiled_function():
    scene, view = blobs([[0, 0, 3]]), camera(16, 16)
    there = jax.tree.map(jnp.asarray, view)
    own = make_view(scene, there)

    @jax.jit
    def total(scene):
        return render_view(reprojected(own, scene, there), scene, there)[0].sum()

    assert total(scene) == pytest.approx(float(render_view(own, scene, view)[0].sum()))
    assert np.isfinite(jax.grad(total)(scene).means).all()
