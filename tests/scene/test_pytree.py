"""Scenes, cameras and results print as one short line, also with large arrays."""

import dataclasses

import jax
import numpy as np
from strategies import blobs, cameras_in_a_row, random_scene

from gsc_jax import locate
from gsc_jax.scene import Camera
from gsc_jax.scene.pytree import short_repr


@dataclasses.dataclass
class _Example:
    large: np.ndarray
    small: np.ndarray
    text: str

    __repr__ = short_repr


def test_arrays_are_shown_as_type_and_shape_unless_small():
    example = _Example(np.zeros((40, 3), np.float32), np.eye(2), "name")
    shown = "_Example(large=float32[40, 3], small=array([[1., 0.], [0., 1.]]), text='name')"
    assert repr(example) == shown


def test_scenes_cameras_and_traced_scenes_have_a_short_repr():
    scene = random_scene(300)
    assert "means=float32[300, 3]" in repr(scene)
    camera = cameras_in_a_row(1, 8, 8, step=0.1)[0]
    assert isinstance(camera, Camera)
    assert repr(camera.name) in repr(camera)
    jax.jit(lambda traced: [repr(traced), traced][1])(scene)
    assert repr(jax.tree.map(lambda _: None, scene)).startswith("Gaussians(means=None")


def test_a_result_is_a_short_line():
    scene = blobs([(0.0, 0.0, 2.0)] * 40)
    cameras = cameras_in_a_row(3, 24, 16, step=0.1)
    result = locate(scene, cameras, [np.zeros((16, 24), bool)] * 3)
    for value in (result, result.prior):
        assert "\n" not in repr(value)
        assert len(repr(value)) < 1500
