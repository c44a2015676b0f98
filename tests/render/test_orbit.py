"""Orbits look at the scene, and cameras that do not belong to it are found out."""

import dataclasses
import re
import time
from pathlib import Path

import numpy as np
import pytest
import strategies
from hypothesis import given, settings
from hypothesis import strategies as st

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.ply import load_ply
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import Camera, Gaussians, InputError

SCENES = Path(__file__).parents[2] / "../shared/data/scenes"
needs_scenes = pytest.mark.skipif(not SCENES.is_dir(), reason="needs the scenes of ../shared/data")
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def blob(
    n: int = 2000, *, center=(1.0, -2.0, 5.0), radius: float = 2.0, seed: int = 0
) -> Gaussians:
    """An opaque ball, in which every tenth Gaussian is a faint floater far away."""
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = radius * rng.uniform(0, 1, (n, 1)) ** (1 / 3) * directions
    means[::10] *= 1e4
    logits = np.where(np.arange(n) % 10 == 0, -3.0, 3.0)
    return Gaussians(
        means=(means + center).astype(np.float32),
        log_scales=np.full((n, 3), -4, np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        logit_opacities=logits.astype(np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )


def changed(cameras: list[Camera], mend) -> list[Camera]:
    return [dataclasses.replace(camera, viewmat=mend(camera.viewmat)) for camera in cameras]


def verdict(scene: Gaussians, cameras: list[Camera]) -> str:
    """The last thing that the check says, as an error or as a warning."""
    try:
        return check_views(scene, cameras)[-1]
    except InputError as error:
        return str(error)


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    viewmat = np.asarray(camera.viewmat)
    pixels = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ np.asarray(camera.K).T
    return np.concatenate([pixels[:, :2] / pixels[:, 2:], pixels[:, 2:]], axis=1)


@settings(deadline=None, max_examples=30)
@given(
    n=st.sampled_from([1, 2, 7]),
    seed=st.integers(0, 99),
    fov=st.sampled_from([20.0, 60.0, 100.0]),
    size=st.sampled_from([(640, 480), (100, 300)]),
    up=st.sampled_from([None, (0, 0, 5), (1, 1, 0)]),
)
def test_orbits_look_at_the_centre_from_above(n, seed, fov, size, up):
    scene = blob()
    width, height = size
    cameras = orbit_cameras(scene, n, width=width, height=height, fov_degrees=fov, up=up, seed=seed)
    assert [camera.name for camera in cameras] == [f"orbit_{i:03d}" for i in range(n)]
    upward = np.array((0, -1, 0) if up is None else up) / np.linalg.norm(up or 1)
    solid = np.asarray(scene.means)[np.asarray(scene.logit_opacities) > 0]
    for camera in cameras:
        rotation = np.asarray(camera.viewmat)[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(rotation) > 0
        middle = project(camera, np.median(solid, axis=0)[None])[0, :2]
        np.testing.assert_allclose(middle, [width / 2, height / 2], atol=0.01)
        assert (camera.center - np.median(solid, axis=0)) @ upward > 0, "it looks from below"
        assert rotation[1] @ upward < 0, "the image is upside down"
        u, v, z = project(camera, solid).T
        inside = (u > 0) & (u < width) & (v > 0) & (v < height) & (z > 0)
        assert inside.mean() > 0.9, "floaters pushed the camera away or it is too close"
        assert np.ptp(u) > 0.4 * width or np.ptp(v) > 0.4 * height, "the scene is tiny"
    assert check_views(scene, cameras) == []


def test_orbits_are_reproducible_and_spread():
    scene = blob()
    first, again, other = (orbit_cameras(scene, 6, seed=seed) for seed in (1, 1, 2))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.viewmat, b.viewmat)
    assert not np.allclose(first[0].viewmat, other[0].viewmat)
    heights = {round(-float(camera.center[1]), 3) for camera in first}
    assert len(heights) == 3, "three elevations"
    flat = np.array([camera.center[::2] for camera in first]) - [1, 5]
    azimuths = np.sort(np.arctan2(*flat.T))
    np.testing.assert_allclose(np.diff(azimuths), np.pi / 3, atol=0.05)


def test_a_single_gaussian_gets_an_orbit():
    scene = blob(2).take(np.array([1]))
    for camera in orbit_cameras(scene, 3):
        depth = project(camera, np.asarray(scene.means))[0, 2]
        assert 0 < depth < 1
    faint = dataclasses.replace(scene, logit_opacities=np.full(1, -5, np.float32))
    assert len(orbit_cameras(faint, 2)) == 2


@pytest.mark.parametrize(
    "options", [{"n": 0}, {"fov_degrees": 180.0}, {"up": (0, 0, 0)}, {"up": (0, 1)}]
)
def test_orbits_that_cannot_be(options):
    with pytest.raises(InputError, match="expected at least one camera"):
        orbit_cameras(blob(20), **{"n": 3} | options)


@pytest.mark.parametrize(
    ("mend", "reading"),
    [
        (lambda viewmat: FLIP @ viewmat, r"with OpenGL axes \(y up, z backward\)"),
        (np.linalg.inv, "as world-to-camera"),
        (lambda viewmat: np.linalg.inv(FLIP @ viewmat), "as world-to-camera with OpenGL axes"),
    ],
)
def test_another_convention_is_recognised(mend, reading):
    scene = blob()
    cameras = changed(orbit_cameras(scene, 8), mend)
    message = verdict(scene, cameras)
    assert re.search(f"read {reading}: a camera would then typically see", message), message
    assert "\n" not in message


def test_a_normalised_scene_is_not_seen():
    cameras = orbit_cameras(blob(center=(200.0, 0.0, 0.0)), 5)
    with pytest.raises(InputError, match=r"see 0\.00% of the Gaussians; do they belong together"):
        check_views(blob(radius=0.1), cameras)


def test_a_scene_too_small_for_the_near_plane_gets_one_that_fits():
    scene = blob(radius=0.01)
    cameras = orbit_cameras(scene, 6)
    with pytest.raises(InputError, match=r"near plane at 0\.2 cuts away 100%") as error:
        check_views(scene, cameras)
    near = float(str(error.value).split("near=")[1].split()[0])
    assert check_views(scene, cameras, near=near) == []


def test_a_near_plane_in_the_middle_is_warned_of():
    scene = blob()
    cameras = orbit_cameras(scene, 6)
    middle = float(np.linalg.norm(cameras[0].center - [1, -2, 5]))
    (warning,) = check_views(scene, cameras, near=middle + 0.5)
    assert warning.startswith("the near plane at")


def test_blind_cameras_are_named():
    scene = blob()
    cameras = orbit_cameras(scene, 10)
    cameras[3:5] = changed(cameras[3:5], lambda viewmat: FLIP @ viewmat)
    assert check_views(scene, cameras) == ["2 of 10 cameras see nothing: orbit_003, orbit_004"]


def test_a_low_share_is_warned_of():
    scene = blob()
    narrow = orbit_cameras(scene, 1)[0].scaled(1.0)
    K = np.diag([6.0, 6.0, 1.0]) @ narrow.K
    K[:2, 2] = narrow.K[:2, 2]
    (warning,) = check_views(scene, [dataclasses.replace(narrow, K=K)])
    assert warning.startswith("the cameras together see only")


def test_no_cameras():
    with pytest.raises(InputError, match="no cameras"):
        check_views(blob(20), [])


def test_large_scenes_are_cheap():
    scene = blob(300_000)
    cameras = orbit_cameras(scene, 100)
    start = time.perf_counter()
    assert check_views(scene, cameras) == []
    assert time.perf_counter() - start < 2


@needs_scenes
@pytest.mark.parametrize("name", ["kitchen", "playbot", "flowers"])
def test_real_cameras_see_real_scenes_and_so_do_orbits(name):
    scene = load_ply(SCENES / f"{name}.ply")
    cameras = load_cameras(SCENES / f"{name}.cameras.json")
    assert check_views(scene, cameras) == []
    assert check_views(scene, orbit_cameras(scene, 12)) == []
    flipped = changed(cameras, lambda viewmat: FLIP @ viewmat)
    assert "read with OpenGL axes" in verdict(scene, flipped)


def test_scales_that_are_no_logarithms_are_told():
    scene, cameras = strategies.random_scene(400), orbit_cameras(strategies.random_scene(400), 4)
    assert not any("logarithm" in warning for warning in check_views(scene, cameras))
    linear = dataclasses.replace(scene, log_scales=np.exp(scene.log_scales))
    assert any("logarithm" in warning for warning in check_views(linear, cameras))


def test_a_scene_without_gaussians_is_refused():
    with pytest.raises(InputError, match="no Gaussians"):
        check_views(strategies.random_scene(0), [strategies.camera()])
