"""Rows that fill up a scene: nothing changes but the number of programs that JAX compiles."""

import numpy as np
import pytest
from strategies import cameras_in_a_row, random_scene

from gsc_jax import observe, render, rendered_share
from gsc_jax.scene.gaussians import MAX_FILLED, filled_up, transparent_rows

CAMERAS = cameras_in_a_row(3, 48, 32, step=0.1)


@pytest.mark.parametrize("count", [1, 15, 51, 257])
def test_views_change_by_rounding_only(count):
    """The last rows of a matrix are rounded otherwise than those that fill a vector register."""
    scene = random_scene(count, seed=count)
    filled, more = filled_up(scene), transparent_rows(count)
    assert len(filled) == count + more
    feature = np.random.default_rng(0).random(count).astype(np.float32)
    for camera in CAMERAS:
        for one, other in zip(render(filled, camera), render(scene, camera), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-6)
        np.testing.assert_allclose(
            rendered_share(filled, camera, np.pad(feature, (0, more))),
            rendered_share(scene, camera, feature),
            atol=1e-6,
        )


def test_the_views_of_a_scene_of_a_similar_size_compile_nothing(count_compilations):
    masks = {camera.name: np.eye(32, 48, dtype=np.float32) for camera in CAMERAS}
    observe(random_scene(53, seed=1), CAMERAS, masks)
    with count_compilations() as compiled:
        observation = observe(random_scene(56, seed=2), CAMERAS, masks)
    assert observation.evidence.shape == (len(CAMERAS), 56)
    assert not compiled


@pytest.mark.parametrize("count", [1, 7, 8, 9, 1000, MAX_FILLED, MAX_FILLED + 1, 10**7 + 1])
def test_few_sizes_remain_and_large_scenes_stay(count):
    more = transparent_rows(count)
    assert 0 <= more <= count / 4
    assert not (more and count > MAX_FILLED)
    assert transparent_rows(count + more) == 0
    octave = {n + transparent_rows(n) for n in range(1024, 2048)}
    assert octave == {1024, 1280, 1536, 1792, 2048}
