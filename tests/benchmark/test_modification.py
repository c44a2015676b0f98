import dataclasses

import jax
import numpy as np
import pytest
from edited_room import UP, edited, grown, room
from strategies import camera, random_scene

from gsc_jax.benchmark import modification
from gsc_jax.benchmark.incorporation import transformed
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.splat import render


def test_a_modification_changes_the_tampered_pixels():
    found, (original, cameras) = edited("modification"), room()
    view = cameras[int(np.argmax(found.visible))]
    inside = truth_mask(found.gaussians, view, found.labels)
    images = (np.asarray(render(g, view)[0]) for g in (found.gaussians, original))
    difference = np.abs(np.subtract(*images)).mean(axis=-1)
    assert difference[inside].mean() > 0.03
    assert difference[inside].mean() > 3 * difference[~inside].mean()


def test_a_uniform_scaling_is_a_similarity():
    scene = random_scene(30, degree=0)
    axis = np.array([0.6, 0.0, 0.8])
    region = dataclasses.replace(grown(), center=np.zeros(3), radius=0.0, towards=axis)
    scaled = modification.warp_gaussians(scene, lambda x: modification.scaling(x, region, 2.0))
    np.testing.assert_allclose(scaled.means, 2 * scene.means, rtol=1e-5)
    # Axes keep their order and sign; otherwise the stored numbers would reveal the edit.
    np.testing.assert_allclose(scaled.log_scales, scene.log_scales + np.log(2), atol=1e-4)
    np.testing.assert_allclose(scaled.quats, scene.quats, atol=1e-3)
    expected, _ = render(transformed(scene, np.eye(3), 2, np.zeros(3)), camera())
    np.testing.assert_allclose(render(scaled, camera())[0], expected, atol=2e-3)


@pytest.mark.parametrize("warp", [modification.twist, modification.bulge])
def test_a_warp_moves_the_middle_and_not_the_border(warp):
    region = dataclasses.replace(grown(), center=np.array([0.0, 0, 3]), radius=0.5, towards=UP)
    scene = random_scene(400)
    after = modification.warp_gaussians(scene, lambda x: warp(x, region, 0.7))
    across = np.linalg.norm((scene.means - region.center)[:, [0, 2]], axis=1)
    moved = np.linalg.norm(after.means - scene.means, axis=1)
    middle = (across < 0.4) & (across > 0.1)
    assert moved[across > 0.61].max() < 1e-5
    assert moved[middle].min() > 1e-3
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after))
    changed = modification.changed_rows(scene, after, region.radius)
    assert not changed[across > 0.61].any()
    assert changed[middle].all()
