"""The up direction is that of the floor, wherever it points; without a floor it is -y."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from strategies import ball, random_scene

from gsc_jax.benchmark.scenes import make_object, make_room
from gsc_jax.io.ply import load_ply
from gsc_jax.render.orbit import DEFAULT_UP
from gsc_jax.render.up import AXES, estimated_up, parse_up, up_text
from gsc_jax.scene import Gaussians, InputError

ROOM = make_room(count=6_000)
SCENES = Path(__file__).parents[3] / "shared" / "data" / "scenes"


def turned(gaussians: Gaussians, rotation: Rotation) -> Gaussians:
    quats = Rotation.from_quat(np.asarray(gaussians.quats, np.float64), scalar_first=True)
    return dataclasses.replace(
        gaussians,
        means=rotation.apply(gaussians.means).astype(np.float32),
        quats=(rotation * quats).as_quat(scalar_first=True).astype(np.float32),
    )


@pytest.mark.parametrize("seed", range(8))
def test_the_floor_gives_the_up_direction_of_a_turned_room(seed):
    rotation = Rotation.from_quat(np.random.default_rng(seed).normal(size=4))
    angle = np.degrees(np.arccos(estimated_up(turned(ROOM, rotation)) @ rotation.apply(DEFAULT_UP)))
    assert angle < 12


@pytest.mark.parametrize("axis", AXES)
def test_an_axis_is_taken_as_it_is(axis):
    rotation = Rotation.align_vectors(AXES[axis][None], DEFAULT_UP[None])[0]
    np.testing.assert_array_equal(estimated_up(turned(ROOM, rotation)), AXES[axis])


@pytest.mark.parametrize("name", ["flowers", "hexbox", "kitchen", "playbot", "seal"])
def test_real_scenes_that_were_turned(name):
    if not SCENES.exists():
        pytest.skip("shared/data is not here")
    rotation = Rotation.from_euler("x", 90, degrees=True)
    scene = load_ply(SCENES / f"{name}.ply")
    assert up_text(estimated_up(scene)) == "-y"
    assert up_text(estimated_up(turned(scene, rotation))) == "-z"


def flattened(axes: int) -> Gaussians:
    """The room, where most Gaussians have no extent along some axes."""
    log_scales = np.array(ROOM.log_scales)
    log_scales[5:, :axes] = -np.inf
    return dataclasses.replace(ROOM, log_scales=log_scales)


ROUND = dataclasses.replace(
    ROOM,
    log_scales=np.full_like(ROOM.log_scales, -3),
    quats=np.tile(np.array([1, 0, 0, 0], np.float32), (len(ROOM), 1)),
)


@pytest.mark.parametrize(
    "scene",
    [
        ball(),
        random_scene(1),
        random_scene(999),
        random_scene(4_000),
        make_object(),
        flattened(3),
        flattened(2),
        ROUND,
    ],
)
def test_without_a_floor_up_is_that_of_colmap(scene):
    np.testing.assert_array_equal(estimated_up(scene), DEFAULT_UP)


def test_directions_are_read_as_they_are_written():
    for text, vector in (
        ("z", [0, 0, 1]),
        ("-x", [-1, 0, 0]),
        ("0, -2, 0", [0, -1, 0]),
        ("1e200,0,0", [1, 0, 0]),
        ("0,0,-1e-200", [0, 0, -1]),
    ):
        np.testing.assert_array_equal(parse_up(text), vector)
        assert parse_up(up_text(parse_up(text))) @ np.array(vector) == 1
    for text in ("", "up", "1,2", "0,0,0", "nan,0,1", "inf,0,0", "1,2,3,4", "1e999,0,0"):
        with pytest.raises(InputError, match="expected one of"):
            parse_up(text)
