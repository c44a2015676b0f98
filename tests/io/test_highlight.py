"""`highlight.ply`, a copy of a scene with tampered Gaussians red and all others grey."""

import dataclasses

import numpy as np
from ply_files import assert_same
from strategies import random_scene

from gsc_jax.io.highlight import save_highlight
from gsc_jax.io.ply import load_ply
from gsc_jax.render.spherical_harmonics import Y0

SCENE = random_scene(7)


def test_highlight_is_red_where_tampered_and_grey_elsewhere(tmp_path):
    labels = np.arange(7) % 2 == 0
    save_highlight(tmp_path / "h.ply", SCENE, labels)
    written = load_ply(tmp_path / "h.ply")
    rgb = 0.5 + Y0 * written.sh[:, 0]
    assert (rgb[labels, 0] > 5 * rgb[labels, 1]).all()
    np.testing.assert_allclose(rgb[~labels], rgb[~labels, :1] * np.ones(3))
    assert not written.sh[:, 1:].any()
    assert_same(dataclasses.replace(written, sh=SCENE.sh), SCENE)


def test_highlight_keeps_the_luminance_in_half_of_the_range(tmp_path):
    bright = dataclasses.replace(SCENE, sh=np.zeros_like(SCENE.sh))
    bright.sh[:, 0] = np.array([-9, 0, 0.5 / Y0, 9, 0, 0, 0])[:, None]
    luminance = np.array([0, 0.5, 1, 1, 0.5, 0.5, 0.5])
    labels = np.array([False] * 4 + [True] * 3)
    save_highlight(tmp_path / "h.ply", bright, labels)
    rgb = 0.5 + Y0 * load_ply(tmp_path / "h.ply").sh[:, 0]
    np.testing.assert_allclose(rgb[:4, 0], 0.2 + 0.5 * luminance[:4], atol=1e-5)
    np.testing.assert_allclose(rgb[4:], np.tile([0.75, 0.075, 0.075], (3, 1)), atol=1e-5)
