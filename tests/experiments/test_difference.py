import dataclasses

import numpy as np
import pytest
from difference import DifferenceDetector
from distort import DISTORTIONS, Distorted, image_noise
from strategies import blobs, camera

from gsc_jax.splat import render

CAMERA = camera(64, 48, focal=60.0)
WALL = [[x, y, 4.0] for x in np.linspace(-3, 3, 25) for y in np.linspace(-2.4, 2.4, 19)]


def painted(ball_at):
    """A grey wall, and a small white ball in front of it."""
    scene = blobs([*WALL, ball_at], opacity=0.95, scale=0.12)
    sh = np.array(scene.sh)
    sh[:-1] += np.random.default_rng(0).normal(0, 0.3, sh[:-1].shape)
    sh[-1] = 1.7
    return dataclasses.replace(scene, sh=sh.astype(np.float32))


AUTHENTIC, TAMPERED = painted([-0.8, 0, 3]), painted([0.8, 0, 3])
DETECTOR = DifferenceDetector(AUTHENTIC)


def picture(scene):
    return np.asarray(render(scene, CAMERA)[0])


def test_nothing_is_flagged_in_the_authentic_scene():
    assert (DETECTOR(picture(AUTHENTIC), CAMERA) < 0.5).all()


def test_the_old_and_the_new_place_are_flagged_and_nothing_else():
    probability = DETECTOR(picture(TAMPERED), CAMERA)
    assert probability.dtype == np.float32
    assert probability.shape == (48, 64)
    places = np.zeros((48, 64), bool)
    for column in (16, 48):
        assert probability[24, column] > 0.5, "the moved ball is missed"
        places[14:34, column - 10 : column + 10] = True
    assert not (probability > 0.5)[~places].any()


def f1(detector):
    flagged = detector(picture(TAMPERED), CAMERA) > 0.5
    truth = DETECTOR(picture(TAMPERED), CAMERA) > 0.5
    return 2 * (flagged & truth).sum() / (flagged.sum() + truth.sum())


def test_noise_and_blur_reduce_f1():
    found = {name: f1(row.of_detector(DETECTOR, seed=0)) for name, row in DISTORTIONS.items()}
    assert found["none"] == 1
    assert found["noise"] < 0.99
    assert found["blur"] < 0.99
    strong = Distorted(DETECTOR, lambda image, seed: image_noise(image, sigma=0.2, seed=seed))
    assert f1(strong) < 0.5


@pytest.mark.parametrize("level", [0.01, 0.06, 0.3])
def test_level_is_where_probability_passes_one_half(level):
    original = picture(AUTHENTIC)
    brighter = (original * 0.5 + 0.5 * np.minimum(original + 0.4, 1)).astype(np.float32)
    sharp = DifferenceDetector(AUTHENTIC, level=level, smooth=0.0)
    difference = np.abs(brighter.astype(np.float64) - original).mean(axis=-1)
    probability, clear = sharp(brighter, CAMERA), np.abs(difference - level) > 1e-6
    np.testing.assert_array_equal((probability > 0.5)[clear], (difference > level)[clear])
