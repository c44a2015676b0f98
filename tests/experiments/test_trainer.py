"""Captures: training improves views that it never saw, and densification keeps to its rules."""

import dataclasses
from typing import get_args

import numpy as np
import pytest
import trainer as module
from densification import (
    DECAY,
    MIN_OPACITY,
    RESET_OPACITY,
    UNIMPORTANT,
    adapt_density,
    disturbance,
    grow_by_error,
    prune_unimportant,
    relocate,
    reset_opacities,
    shared_opacity,
)
from scipy.spatial.transform import Rotation
from scipy.special import expit
from similarity import psnr, ssim
from skimage.metrics import structural_similarity
from strategies import random_scene
from trainer import CaptureConfig, _forgotten, capture, errors, initial_scene, learning_rates

import gsc_jax
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.render.spherical_harmonics import Y0

ROOM = tampered_room(count=2_000, views=13, heldout=0, width=48, height=36)
IMAGES = np.stack([gsc_jax.render(ROOM.gaussians, camera)[0] for camera in ROOM.cameras])
POINTS = np.random.default_rng(0).choice(2_000, 500, replace=False)
START = np.column_stack(
    [ROOM.gaussians.means[POINTS], np.clip(0.5 + Y0 * ROOM.gaussians.sh[POINTS, 0], 0, 1)]
)


def heldout_psnr(scene) -> float:
    return psnr(gsc_jax.render(scene, ROOM.cameras[-1])[0], IMAGES[-1])


@pytest.mark.slow
@pytest.mark.parametrize("strategy", get_args(module.Strategy))
def test_training_improves_a_view_that_it_never_saw(monkeypatch, strategy):
    monkeypatch.setattr(module, "INTERVAL", 20)
    config = CaptureConfig(iterations=120, budget=800, sh_degree=1, strategy=strategy)
    steps = []
    scene, again = (
        capture(ROOM.cameras[:-1], IMAGES[:-1], START, config=config, progress=progress)
        for progress in (lambda *done: steps.append(done), lambda *_: None)
    )
    assert steps[-1] == ("capture", 120, 120)
    least, most = {"adaptive": (401, 800), "mcmc": (800, 800), "error": (550, 560)}[strategy]
    assert least <= len(scene) <= most  # growth by error ends by pruning 30 % of 800
    assert scene.sh.shape[1:] == (4, 3)
    assert np.isfinite(scene.means).all()
    np.testing.assert_array_equal(scene.means, again.means)
    start = initial_scene(START, config, np.random.default_rng(0))
    before = heldout_psnr(start.take(np.isfinite(start.logit_opacities)))
    assert heldout_psnr(scene) > before + 2


def test_inputs_that_do_not_fit_together_are_errors():
    with pytest.raises(ValueError, match="2 cameras, 1 images"):
        capture(ROOM.cameras[:2], IMAGES[:1], START)
    with pytest.raises(ValueError, match="4 points"):
        capture(ROOM.cameras[:1], IMAGES[:1], START[:3])
    with pytest.raises(ValueError, match="48 x 36"):
        capture(ROOM.cameras[:1], IMAGES[:1, ::2], START)
    with pytest.raises(ValueError, match=r"in \[0, 1\] without NaN"):
        capture(ROOM.cameras[:1], np.full_like(IMAGES[:1], np.nan), START)
    with pytest.raises(ValueError, match="colours in"):
        capture(ROOM.cameras[:1], IMAGES[:1], 255 * START)


def test_similarity_is_that_of_scikit_image():
    one, other = np.random.default_rng(0).random((2, 36, 48, 3), np.float32)
    similarity = structural_similarity(
        one,
        (one + other) / 2,
        channel_axis=2,
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        truncate=3.5,
        use_sample_covariance=False,
        full=True,
    )
    inside = (slice(5, -5), slice(5, -5))
    found = np.asarray(ssim(one, (one + other) / 2))
    np.testing.assert_allclose(found[inside], np.asarray(similarity[1])[inside], atol=1e-4)
    np.testing.assert_allclose(ssim(one, one), 1, atol=1e-5)


@pytest.mark.parametrize(
    "wrong",
    [
        {"strategy": "MCMC"},
        {"budget": 4},
        {"budget": 100.5},
        {"iterations": 2.5},
        {"iterations": True},
        {"iterations": "100"},
        {"sh_degree": 4},
        {"sh_degree": 1.0},
        {"ssim_weight": 2},
        {"ssim_weight": float("nan")},
        {"reset_opacities": 3},
    ],
)
def test_options_out_of_range_are_errors(wrong):
    with pytest.raises(ValueError, match="got"):
        CaptureConfig(**wrong)


def test_only_the_moments_of_what_changed_are_forgotten():
    moments = random_scene(3)
    kept = _forgotten(moments, np.array([True, False, False]), np.array([False, True, False]))
    assert not np.any(kept.means[0])
    np.testing.assert_array_equal(kept.means[1:], moments.means[1:])
    assert (np.asarray(kept.logit_opacities) != 0).tolist() == [False, False, True]


def test_noise_follows_the_axes_and_spares_opaque_gaussians():
    scene = random_scene(20_000)
    for leaf in (scene.log_scales, scene.quats):
        leaf[:] = leaf[0]
    scene.logit_opacities[:] = -9
    scene.logit_opacities[:10] = 3
    noise = disturbance(scene, 1e-5, np.random.default_rng(0))
    assert not noise[:10].any()
    axes = Rotation.from_quat(scene.quats[0], scalar_first=True).as_matrix()
    covariance = axes.T @ np.cov(noise[10:].T) @ axes
    expected = (
        5e5 * 1e-5 * expit(100 * (0.005 - expit(-9))) * np.exp(2 * scene.log_scales[0])
    ) ** 2
    np.testing.assert_allclose(covariance, np.diag(expected), atol=0.05 * expected.max())


def test_a_zero_quaternion_counts_as_no_rotation():
    scene = random_scene(100)
    scene.quats[:] = 0
    scene.logit_opacities[:] = -9
    noise = disturbance(scene, 1e-5, np.random.default_rng(0))
    scene.quats[:] = [1, 0, 0, 0]
    np.testing.assert_array_equal(noise, disturbance(scene, 1e-5, np.random.default_rng(0)))


def test_rates_fall_and_harmonics_start_one_degree_after_the_other():
    config = CaptureConfig(sh_degree=3)
    first, later, last = (learning_rates(done, 2.0, config) for done in (0.0, 0.15, 1.0))
    assert float(last.means) == pytest.approx(float(first.means) / 100)
    for rates, active in ((first, 1), (later, 4), (last, 16)):
        assert np.count_nonzero(rates.sh) == active


def small_scene():
    """A small opaque, a large opaque and a transparent Gaussian, and four unused rows."""
    scene = random_scene(7)
    scene.log_scales[:] = np.log(0.001)
    scene.log_scales[1] = np.log(0.5)
    scene.logit_opacities[:] = [2, 2, -8, -np.inf, -np.inf, -np.inf, -np.inf]
    return scene


def test_small_gaussians_are_cloned_large_ones_split_and_transparent_ones_pruned():
    scene, before = small_scene(), small_scene()
    gradient = np.array([1e-3, 2e-3, 1e-3, 0, 0, 0, 0])
    changed = adapt_density(scene, gradient, 1.0, np.random.default_rng(0))
    assert changed.tolist() == [False, True, True, True, False, False, False]
    assert np.isfinite(scene.logit_opacities).sum() == 4
    clone = scene.take(np.array([3]))
    np.testing.assert_array_equal(clone.means, before.means[:1])
    np.testing.assert_allclose(scene.log_scales[1:3], np.log(0.5 / 1.6), rtol=1e-6)
    assert not np.any(scene.means[1:3] == before.means[1])


def test_without_free_rows_the_budget_holds():
    scene = random_scene(5)
    scene.logit_opacities[:] = 2
    assert not adapt_density(scene, np.ones(5), 1.0, np.random.default_rng(0)).any()


def test_transparent_gaussians_move_to_opaque_ones():
    scene = random_scene(40)
    scene.logit_opacities[:] = 1
    scene.logit_opacities[:4], scene.logit_opacities[-10:] = -9, -np.inf
    changed = relocate(scene, np.random.default_rng(0), 1)
    opacities = expit(scene.logit_opacities)
    assert np.isfinite(scene.logit_opacities).sum() == 31
    assert (opacities[:31] >= MIN_OPACITY).all()
    assert changed[:4].all()
    assert changed[30]
    assert not changed[31:].any()


@pytest.mark.parametrize("opacity", [0.05, 0.5, 0.9])
def test_copies_share_the_opacity_of_the_original(opacity):
    copies = np.array([1, 2, 5])
    new, ratio = shared_opacity(np.full(3, opacity), copies)
    np.testing.assert_allclose(1 - (1 - new) ** copies, opacity)
    # Along a ray through the centre, the blended mass of a Gaussian of scale s is its integral.
    x = np.linspace(-8, 8, 20_001)
    for n, o, scale in zip(copies, new, ratio, strict=True):
        alpha = o * np.exp(-0.5 * (x / scale) ** 2)
        mass = np.trapezoid(1 - (1 - alpha) ** n, x)
        assert mass == pytest.approx(opacity * np.sqrt(2 * np.pi), rel=1e-3)


def test_a_reset_lowers_opacities():
    scene = dataclasses.replace(random_scene(3), logit_opacities=np.array([-9.0, 0, 3], np.float32))
    assert reset_opacities(scene).tolist() == [False, True, True]
    np.testing.assert_allclose(expit(scene.logit_opacities)[1:], RESET_OPACITY, rtol=1e-5)


def test_what_takes_part_in_the_error_grows_and_its_copies_look_as_it_did():
    scene, before = small_scene(), small_scene()
    error = np.array([1.0, 2, 9, 9, 9, 9, 9])  # that of unused and transparent rows does not count
    changed = grow_by_error(scene, error, 1.0, np.random.default_rng(0), added=1)
    assert changed.tolist() == [False, True, True, False, False, False, False]
    assert np.isfinite(scene.logit_opacities).tolist() == [True] * 3 + [False] * 4
    decayed = expit(2.0) - DECAY
    np.testing.assert_allclose(expit(scene.logit_opacities[0]), decayed, rtol=1e-5)
    np.testing.assert_allclose((1 - expit(scene.logit_opacities[1:3])) ** 2, 1 - decayed, rtol=1e-4)
    np.testing.assert_allclose(scene.log_scales[1:3], np.log(0.5 / 1.6), rtol=1e-6)
    np.testing.assert_array_equal(scene.means[0], before.means[0])
    grow_by_error(scene, error, 1.0, np.random.default_rng(0), added=100)
    assert np.isfinite(scene.logit_opacities).sum() == 6  # each has one copy at a time


def test_the_least_important_are_given_up():
    scene = random_scene(40)
    scene.logit_opacities[:] = 1
    scene.logit_opacities[:20] = -np.inf
    prune_unimportant(scene, np.arange(40.0))
    pruned = int(20 * UNIMPORTANT)
    assert np.isfinite(scene.logit_opacities).tolist() == [False] * (20 + pruned) + [True] * (
        20 - pruned
    )


@pytest.mark.parametrize("iterations", [1000, 1115, 2000, 2500, 2999])
def test_growth_by_error_prunes_once_when_it_ends(monkeypatch, iterations):
    pruned = []
    monkeypatch.setattr(module, "errors", lambda scene, _: 2 * (np.zeros(len(scene)),))
    monkeypatch.setattr(module.densification, "prune_unimportant", lambda *_: pruned.append(step))
    config = CaptureConfig(iterations=iterations, budget=8, strategy="error")
    rng, training = np.random.default_rng(0), module.started(random_scene(8))
    for step in range(100, iterations + 1, 100):
        if 0.1 <= step / iterations <= 0.6:
            module._densified(training, step / iterations, 1.0, config, rng, [])
    assert pruned == [int(0.6 * iterations) // 100 * 100]


def test_a_full_budget_does_not_grow():
    scene = random_scene(6)
    scene.logit_opacities[:] = 2
    assert not grow_by_error(scene, np.ones(6), 1.0, np.random.default_rng(0), added=9).any()


def test_a_gaussian_of_the_wrong_colour_takes_part_in_the_largest_error():
    scene, cameras = ROOM.gaussians, ROOM.cameras[:3]
    _, importance = errors(scene, list(zip(cameras, IMAGES, strict=False)))
    wrong = int(np.argmax(importance))
    sh = np.array(scene.sh)
    sh[wrong, 0] = -sh[wrong, 0] + 2
    changed = dataclasses.replace(scene, sh=sh)
    error, again = errors(changed, list(zip(cameras, IMAGES, strict=False)))
    assert np.argmax(error) == wrong
    np.testing.assert_allclose(again, importance, rtol=1e-5)
    alone = [errors(changed, [(c, i)]) for c, i in zip(cameras, IMAGES, strict=False)]
    np.testing.assert_allclose(error, np.max([one for one, _ in alone], axis=0), rtol=1e-5)
    np.testing.assert_allclose(again, np.mean([one for _, one in alone], axis=0), rtol=1e-5)
