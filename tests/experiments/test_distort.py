import dataclasses

import jax
import numpy as np
import pytest
from distort import (
    DISTORTIONS,
    image_blur,
    image_noise,
    opacity_noise,
    scale_noise,
)
from hypothesis import given
from hypothesis import strategies as st
from strategies import camera, floats, random_scene, scenes

from gsc_jax.scene import invalid_rows

IMAGE = np.random.default_rng(0).random((40, 60, 3)).astype(np.float32)
CAMERA = camera(60, 40)


def named(name):
    return dataclasses.replace(CAMERA, name=name)


@given(floats((9, 7, 3), 0, 1), st.sampled_from([0.0, 0.05, 3.0]), st.integers(0, 9))
def test_distorted_images_are_images(image, sigma, seed):
    for distorted in (image_noise(image, sigma=sigma, seed=seed), image_blur(image, sigma=sigma)):
        assert distorted.dtype == np.float32
        assert distorted.shape == image.shape
        assert distorted.min() >= -1e-6
        assert distorted.max() <= 1 + 1e-6
        if sigma == 0:
            np.testing.assert_allclose(distorted, image, atol=1e-6)


def test_noise_has_its_strength_and_no_bias():
    grey = np.full((200, 200, 3), 0.5, np.float32)
    difference = image_noise(grey, sigma=0.05, seed=0) - grey
    assert difference.std() == pytest.approx(0.05, rel=0.02)
    assert abs(difference.mean()) < 1e-3
    correlation = np.asarray(np.corrcoef(difference.reshape(-1, 3).T))[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < 0.02, "the channels share their noise"


def test_blur_spreads_a_point_by_its_sigma_and_keeps_the_channels_apart():
    point = np.zeros((41, 41, 3), np.float32)
    point[20, 20, 0] = 1
    blurred = image_blur(point, sigma=1.5)
    y, x = np.indices((41, 41)) - 20
    assert blurred[..., 0].sum() == pytest.approx(1, abs=1e-3)
    assert (blurred[..., 0] * x**2).sum() == pytest.approx(1.5**2, rel=0.05)
    assert (blurred[..., 0] * y**2).sum() == pytest.approx(1.5**2, rel=0.05)
    assert not blurred[..., 1:].any()


@given(scenes(), st.sampled_from(["scales", "opacities"]), st.integers(0, 9))
def test_distorted_models_differ_in_one_field(scene, name, seed):
    model = DISTORTIONS[name].of_model(scene, seed=seed)
    field = {"scales": "log_scales", "opacities": "logit_opacities"}[name]
    for other in {f.name for f in dataclasses.fields(scene)} - {field}:
        np.testing.assert_array_equal(getattr(model, other), getattr(scene, other))
    assert getattr(model, field).dtype == np.float32
    assert getattr(model, field).shape == getattr(scene, field).shape
    assert not np.array_equal(getattr(model, field), getattr(scene, field))
    assert not any(rows.any() for rows in invalid_rows(model).values())


def test_model_noise_has_its_strength():
    scene = random_scene(20_000)
    factors = np.log(scale_noise(scene, sigma=0.1, seed=0).scales / scene.scales)
    assert factors.std() == pytest.approx(0.1, rel=0.03)
    assert np.abs(np.corrcoef(factors.T)[np.triu_indices(3, 1)]).max() < 0.03
    middling = np.abs(np.asarray(scene.opacities) - 0.5) < 0.1
    noisy = np.asarray(opacity_noise(scene, sigma=0.1, seed=0).opacities)
    assert (noisy - scene.opacities)[middling].std() == pytest.approx(0.1, rel=0.05)
    assert abs((noisy - scene.opacities)[middling].mean()) < 0.01


def test_infinite_logits_become_finite_and_nan_stays():
    scene = random_scene(4)
    logits = np.array([np.inf, -np.inf, np.nan, 0], np.float32)
    scene = dataclasses.replace(scene, logit_opacities=logits)
    noisy = [opacity_noise(scene, sigma=0.1, seed=s).logit_opacities for s in range(20)]
    assert np.isfinite(np.array(noisy)[:, [0, 1, 3]]).all()
    assert np.isnan(np.array(noisy)[:, 2]).all()
    opacities = np.asarray(jax.nn.sigmoid(np.array(noisy)))
    assert opacities[:, 0].min() > 0.5 > opacities[:, 1].max()
    assert opacities[:, 0].max() > 0.999 > 0.001 > opacities[:, 1].min()


def shown(name, *, seed=0):
    """The image that a detector gets under the noise of the table."""
    seen = []
    detector = DISTORTIONS["noise"].of_detector(
        lambda image: seen.append(image) or np.zeros((40, 60)), seed=seed
    )
    detector(IMAGE, named(name))
    return seen[0]


def test_noise_depends_on_camera_and_seed():
    assert np.std(shown("a") - IMAGE) == pytest.approx(0.05, rel=0.2)
    np.testing.assert_array_equal(shown("a"), shown("a"))
    assert not np.array_equal(shown("a"), shown("b")), "two cameras share their noise"
    assert not np.array_equal(shown("a"), shown("a", seed=1))
    assert shown("left/img.0001 ü").shape == IMAGE.shape
