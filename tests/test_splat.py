"""Compositing and its adjoint: the float64 reference, laws, and edge cases."""

import dataclasses
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from data import SCENES, cropped, load_scene, needs_data
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, needles, random_scene, with_row
from tolerances import ROUNDING, assert_same_image, assert_same_sums

import gsc_jax
from gsc_jax.render.tiles import make_view
from gsc_jax.splat import accumulate, composite

SIZES = [(1, 1), (15, 17), (33, 15), (17, 33)]
VIEW = camera(17, 15)
MAPS = np.random.default_rng(0).random((15, 17, 2)).astype(np.float32)


def one_pixel(gaussians):
    """Weights and alpha of the only pixel of a camera that looks along the z axis."""
    image, alpha = gsc_jax.render_features(gaussians, camera(1, 1), np.eye(len(gaussians)))
    return np.asarray(image[0, 0]), float(alpha[0, 0])


def assert_agrees(gaussians, view, *, background=(0.2, 0.4, 0.6)) -> reference.Blending:
    """Compare image, alpha and accumulated maps with the reference."""
    image, alpha = gsc_jax.render(gaussians, view, background=background)
    rgb, opaque, blend = reference.render(gaussians, view, background=background)
    assert image.dtype == alpha.dtype == jnp.float32
    colors = reference.colors(gaussians, reference.camera_center(view))
    brightest = colors.max(initial=1.0)
    assert_same_image(image, rgb, brightest * blend.jump)
    assert_same_image(alpha[..., None], opaque[..., None], blend.jump)
    maps = np.random.default_rng(1).normal(size=(view.height, view.width, 2)).astype(np.float32)
    maps *= blend.clear[..., None]
    assert_same_sums(gsc_jax.accumulate(gaussians, view, maps), blend.accumulate(maps))
    return blend


@pytest.mark.parametrize("size", SIZES)
def test_random_scenes_agree_with_the_reference(size):
    blend = assert_agrees(random_scene(200, degree=2), camera(*size))
    assert (blend.weights > 0.01).sum() > size[0] * size[1], "the scene is almost empty"


@needs_data
@pytest.mark.parametrize("name", SCENES)
def test_real_scenes_agree_with_the_reference(name):
    gaussians, cameras = load_scene(name)
    for view in cameras[1::11]:
        blend = assert_agrees(gaussians, cropped(view, 220, 160, 33, 17))
        assert len(blend.ids) > 50, "the crop is almost empty"


@needs_data
def test_windows_of_a_whole_image_agree_with_the_reference():
    gaussians, cameras = load_scene("kitchen")
    image, _ = gsc_jax.render(gaussians, cameras[5])
    for left, top in [(0, 0), (301, 155), (447, 343)]:
        rgb, _, blend = reference.render(gaussians, cameras[5], window=(left, top, 33, 17))
        assert rgb.max() > 0.1, "the window is black"
        assert_same_image(image[top : top + 17, left : left + 33], rgb, blend.jump)


def test_lists_longer_than_many_chunks_agree_with_the_reference():
    places = np.random.default_rng(2).normal([0, 0, 2], 0.05, (200, 3))
    blend = assert_agrees(blobs(places, opacity=0.02), VIEW)
    assert (blend.weights > 0).sum(axis=1).max() > 100


def test_the_nearer_splat_occludes_the_farther_one_in_any_row_order():
    near_last = blobs([[0, 0, 3], [0, 0, 2]], opacity=0.9)
    weights, alpha = one_pixel(near_last)
    np.testing.assert_allclose(weights, [0.1 * 0.9, 0.9], rtol=1e-4)
    assert alpha == pytest.approx(0.99, rel=1e-4)


def test_alpha_is_capped_at_99_percent_and_dropped_below_1_in_255():
    weights, _ = one_pixel(with_row(blobs([0, 0, 2]), "logit_opacities", np.inf))
    assert weights[0] == pytest.approx(0.99)
    below, above = (one_pixel(blobs([0, 0, 2], opacity=o, scale=9))[0] for o in (0.0039, 0.0040))
    assert below[0] == 0
    assert above[0] == pytest.approx(0.0040, rel=1e-3)


def test_a_pixel_stops_before_its_transmittance_falls_under_the_limit():
    # The transmittance is 0.1, 0.01, 0.001 and 1.1e-4 behind the first four splats.
    row = blobs([[0, 0, 1 + 0.1 * i] for i in range(6)], opacity=0.9, scale=5)
    row = with_row(row, "logit_opacities", np.log(0.89 / 0.11), row=3)
    weights, alpha = one_pixel(row)
    np.testing.assert_allclose(weights[:4], [0.9, 0.09, 0.009, 0.00089], rtol=1e-3)
    assert not weights[4:].any(), "a splat contributes although the pixel has stopped"
    assert alpha == pytest.approx(1 - 1.1e-4, abs=2e-6)


def test_a_stopped_pixel_ignores_fainter_splats_behind():
    row = blobs([[0, 0, 1], [0, 0, 1.2], [0, 0, 1.4], [0, 0, 1.6]], opacity=0.98, scale=5)
    row = with_row(row, "logit_opacities", np.log(0.01 / 0.99), row=3)
    weights, _ = one_pixel(row)
    assert weights[1] > 0.019
    assert weights[2:].tolist() == [0, 0]


def test_two_alphas_of_99_percent_reach_the_limit_within_the_slack_of_the_reference():
    opaque = blobs([[0, 0, 2], [0, 0, 3], [0, 0, 4]])
    opaque = dataclasses.replace(opaque, logit_opacities=np.full(3, np.inf, np.float32))
    weights, _ = one_pixel(opaque)
    blend = reference.blending(opaque, camera(1, 1))
    assert weights[0] == pytest.approx(0.99)
    assert weights[2] == 0, "the third is visible through two opaque ones"
    assert blend.jump[0, 0] == pytest.approx(0.01 * 0.99)
    assert abs(weights[1] - blend.composite(np.eye(3))[0, 0, 1]) <= blend.jump[0, 0] + 1e-6


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("places", [np.zeros((0, 3)), [[0, 0, -2], [0, 0, 0.1], [90, 0, 2]]])
def test_a_view_without_visible_gaussians_shows_the_background(places):
    behind = blobs(places)
    image, alpha = gsc_jax.render(behind, VIEW, background=(0.25, 0.5, 1))
    assert (np.asarray(image) == [0.25, 0.5, 1]).all()
    assert not alpha.any()
    assert not gsc_jax.accumulate(behind, VIEW, MAPS).any()


def test_every_renderer_has_a_near_plane():
    close = blobs([0, 0, 0.1], opacity=0.9)
    assert not gsc_jax.render(close, VIEW)[1].any()
    assert gsc_jax.render(close, VIEW, near=0.01)[1].any(), "the splat is invisible"
    assert gsc_jax.render_features(close, VIEW, np.ones((1, 1)), near=0.01)[1].any()
    assert gsc_jax.accumulate(close, VIEW, MAPS, near=0.01).any()


INSIDE_A_GAUSSIAN = [
    blobs([where, [0.1, 0, 3]], opacity=0.8, scale=2)
    for where in ([0, 0, 0], [0, 0, 0.201], [0.3, 0, 0.3])
]
NEEDLES = [needles(200, length=length, width=length / 1e4) for length in (1.0, 10.0, 1e4)]


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("gaussians", [blobs([0.1, 0.1, 2]), *INSIDE_A_GAUSSIAN, *NEEDLES])
def test_unusual_scenes_agree_with_the_reference(gaussians):
    assert assert_agrees(gaussians, VIEW).weights.any(), "the splats are invisible"


BROKEN = [
    (field, value)
    for field in ("means", "log_scales", "quats", "logit_opacities")
    for value in (np.nan, np.inf, -np.inf)
    if (field, value) not in [("log_scales", -np.inf), ("logit_opacities", np.inf)]
]


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize(("field", "value"), BROKEN)
def test_a_row_that_is_not_finite_changes_nothing(field, value):
    gaussians = random_scene(20)
    row = int(np.argmax(gsc_jax.accumulate(gaussians, VIEW, MAPS)[:, 0]))
    broken = with_row(gaussians, field, value, row=row)
    without = with_row(gaussians, "logit_opacities", -np.inf, row=row)
    for image, expected in zip(
        gsc_jax.render(broken, VIEW), gsc_jax.render(without, VIEW), strict=True
    ):
        np.testing.assert_array_equal(image, expected)
    lifted = gsc_jax.accumulate(broken, VIEW, MAPS)
    np.testing.assert_array_equal(lifted, gsc_jax.accumulate(without, VIEW, MAPS))
    assert not lifted[row].any()


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize(
    ("field", "value"),
    [("logit_opacities", np.inf), ("log_scales", -np.inf), ("log_scales", 40.0), ("means", 3e30)],
)
def test_extreme_but_valid_rows_give_finite_images(field, value):
    gaussians = with_row(random_scene(20), field, value)
    for image in gsc_jax.render(gaussians, VIEW):
        assert np.isfinite(image).all()
        assert float(image.min()) >= 0
        assert float(image.max()) <= 1
    assert np.isfinite(gsc_jax.accumulate(gaussians, VIEW, MAPS)).all()


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_the_gradient_of_a_loss_on_an_image_is_accumulate(transform):
    gaussians = random_scene(200)
    view, blend = make_view(gaussians, VIEW), reference.blending(gaussians, VIEW)
    features = np.random.default_rng(3).random((200, 2)).astype(np.float32)

    def loss(features):
        return jnp.sum(MAPS * blend.clear[..., None] * composite(view, features) ** 2)

    gradient = transform(jax.grad(loss))(jnp.asarray(features))
    residual = 2 * MAPS * blend.clear[..., None] * blend.composite(features)
    assert_same_sums(gradient, blend.accumulate(residual))
    lifted = accumulate(view, jnp.asarray(residual, jnp.float32))
    np.testing.assert_allclose(gradient, lifted, rtol=1e-4, atol=1e-5)
    assert float(jnp.abs(gradient).max()) > 0.1


@pytest.mark.parametrize("lockstep", [1, 7, 999])
def test_the_size_of_a_group_changes_nothing(lockstep):
    gaussians, view = random_scene(200), camera(33, 15)
    usual, other = make_view(gaussians, view), make_view(gaussians, view, lockstep=lockstep)
    assert len(other.tiles) % other.lockstep == 0
    assert other.lockstep <= 10, "a group has more tiles than there are"
    colors = jnp.asarray(gaussians.sh[:, 0])
    maps = jnp.asarray(np.random.default_rng(4).random((15, 33, 2)), jnp.float32)
    np.testing.assert_allclose(composite(other, colors), composite(usual, colors), atol=ROUNDING)
    np.testing.assert_allclose(
        accumulate(other, maps), accumulate(usual, maps), rtol=1e-5, atol=ROUNDING
    )


def test_the_second_view_of_a_size_compiles_nothing(count_compilations):
    gaussians = random_scene(90)
    features, maps = np.ones((90, 3), np.float32), np.ones((19, 21, 3), np.float32)

    def render_all(angle: float):
        viewmat = np.eye(4)
        viewmat[:3, :3] = Rotation.from_rotvec([0, angle, 0]).as_matrix()
        view = dataclasses.replace(camera(21, 19, viewmat=viewmat), name=f"view {angle}")
        gsc_jax.render_features(gaussians, view, features)
        gsc_jax.accumulate(gaussians, view, maps)
        return gsc_jax.render(gaussians, view)[0]

    with count_compilations() as first:
        before = render_all(0.0)
    with count_compilations() as second:
        after = render_all(0.1)
    assert first, "the counter counts nothing"
    assert not second
    assert not jnp.allclose(before, after), "the camera has not moved"


def test_images_of_similar_sizes_share_the_compiled_walk(caplog, monkeypatch):
    # `jax.log_compiles` holds for this thread only.
    monkeypatch.setattr(threading, "main_thread", lambda: None)
    gaussians, features = random_scene(90), np.ones((90, 3), np.float32)

    def render_all(width: int, height: int) -> None:
        view = gsc_jax.make_view(gaussians, camera(width, height))
        composite(view, features)
        accumulate(view, np.ones((height, width, 3), np.float32))
        jax.grad(
            lambda splats: composite(dataclasses.replace(view, splats=splats), features).sum()
        )(view.splats)

    render_all(160, 120)  # 20 x 15 tiles
    with jax.log_compiles(), caplog.at_level("WARNING"):
        render_all(151, 127)  # 19 x 16 tiles
    assert "Finished XLA compilation of jit(join_tiles)" in caplog.text
    for name in ("_project", "_ellipses", "_blended", "in_row_major_order", "_lifted", "_moments"):
        assert f"XLA compilation of jit({name})" not in caplog.text


@pytest.mark.parametrize("shape", [(7, 3), (17, 15, 1), (15, 17), (8,), (8, 0)])
def test_features_and_maps_of_another_shape_are_refused(shape):
    gaussians, values = random_scene(8), jnp.ones(shape)
    with pytest.raises(ValueError, match=r"\(8, D\) with D > 0, got"):
        gsc_jax.render_features(gaussians, VIEW, values)
    with pytest.raises(ValueError, match=r"\(8, D\) with D > 0, got"):
        composite(make_view(gaussians, VIEW), values)
    with pytest.raises(ValueError, match=r"\(15, 17, D\), got"):
        gsc_jax.accumulate(gaussians, VIEW, values)


PAIR = [
    VIEW,
    dataclasses.replace(VIEW, viewmat=np.diag([-1, 1, 1, 1]).astype(np.float32), name="b"),
]


def test_several_cameras_of_one_size_are_stacked_and_accumulate_stays_the_adjoint():
    gaussians, features = random_scene(20), jnp.ones((20, 2))
    together = [
        gsc_jax.render(gaussians, PAIR),
        gsc_jax.render_features(gaussians, PAIR, features),
        gsc_jax.render_depth(gaussians, PAIR),
    ]
    for index, one in enumerate(PAIR):
        alone = [
            gsc_jax.render(gaussians, one),
            gsc_jax.render_features(gaussians, one, features),
            gsc_jax.render_depth(gaussians, one),
        ]
        jax.tree.map(
            lambda all_, own, i=index: np.testing.assert_array_equal(all_[i], own), together, alone
        )
    lifted = gsc_jax.accumulate(gaussians, PAIR, np.stack([MAPS, MAPS]))
    product = np.vdot(together[1][0], np.stack([MAPS, MAPS]))
    assert np.vdot(features, lifted) == pytest.approx(product, rel=1e-4)


def test_cameras_that_cannot_be_stacked_are_refused():
    gaussians = random_scene(5)
    with pytest.raises(ValueError, match="one image size to stack, got images of 17 x 15 and 3 x"):
        gsc_jax.render(gaussians, [VIEW, camera(3, 3)])
    with pytest.raises(ValueError, match="to stack, got none"):
        gsc_jax.render_depth(gaussians, [])
    with pytest.raises(ValueError, match="expected V cameras and V maps, got 2 and 1"):
        gsc_jax.accumulate(gaussians, PAIR, [MAPS])
    with pytest.raises(ValueError, match="expected V cameras and V maps, got 0 and 0"):
        gsc_jax.accumulate(gaussians, [], [])


def test_the_expected_depth_is_the_mean_over_the_weights():
    two = blobs([[0, 0, 2], [0, 0, 4]], opacity=0.5)
    depth, alpha = gsc_jax.render_depth(two, camera(1, 1))
    assert alpha[0, 0] == pytest.approx(0.75, rel=1e-3)
    assert depth[0, 0] == pytest.approx((0.5 * 2 + 0.25 * 4) / 0.75, rel=1e-3)
    assert gsc_jax.render_depth(blobs([0, 0, -1]), camera(1, 1))[0].tolist() == [[0]]
    slope = jax.grad(lambda g: gsc_jax.render_depth(g, camera(1, 1))[0].sum())(two)
    assert slope.means[0, 2] > 0


def test_a_scene_from_outside_is_a_constant_under_jit():
    gaussians, features = random_scene(20), jnp.linspace(0, 1, 40).reshape(20, 2)

    def loss(features):
        return (gsc_jax.render_features(gaussians, VIEW, features)[0] ** 2).sum()

    compiled = jax.jit(jax.grad(loss))(features)
    np.testing.assert_allclose(compiled, jax.grad(loss)(features), rtol=1e-4, atol=1e-5)
    backgrounds = jnp.array([[0.0, 0, 0], [1, 0, 0]])
    black, red = jax.vmap(lambda b: gsc_jax.render(gaussians, VIEW, background=b)[0])(backgrounds)
    assert (red[..., 0] > black[..., 0]).any()
    with pytest.raises(TypeError, match="not known under"):
        jax.jit(lambda near: gsc_jax.render(gaussians, VIEW, near=near))(0.2)


def test_the_gradient_of_accumulate_is_composite_and_that_of_its_adjoint_by_the_scene():
    gaussians, maps = random_scene(20), jnp.asarray(MAPS)
    along = jnp.linspace(-1, 1, 40).reshape(20, 2)
    by_maps = jax.grad(lambda m: jnp.vdot(along, gsc_jax.accumulate(gaussians, VIEW, m)))(maps)
    image, _ = gsc_jax.render_features(gaussians, VIEW, along)
    np.testing.assert_allclose(by_maps, image, atol=1e-5)
    lifted = jax.grad(lambda g: jnp.vdot(along, gsc_jax.accumulate(g, VIEW, maps)))(gaussians)
    rendered = jax.grad(lambda g: jnp.vdot(maps, gsc_jax.render_features(g, VIEW, along)[0]))(
        gaussians
    )
    assert float(jnp.abs(lifted.means).max()) > 0
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4), lifted, rendered
    )
