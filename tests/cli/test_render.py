"""`gsc-jax render`: an image per camera."""

import imageio.v3 as iio
import numpy as np
from cli_case import FIXTURES, NAMES, given, run

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.masks import image_path, write_mask

case, found, own_cache = FIXTURES


def test_render_writes_an_image_per_camera(case, tmp_path):
    argv = ["render", case / "scene.ply", "--cameras", case, "--out", tmp_path]
    assert run(*argv, "--background", 0, 1, 0).code == 0
    image = iio.imread(image_path(tmp_path, NAMES[0])).astype(int)
    assert image.shape == (40, 48, 3)
    assert (image[0, 0] == [0, 255, 0]).all(), "the corner is not the background"
    assert image[..., 2].max() > 100, "the scene is invisible"


def test_without_cameras_an_orbit_is_created_and_written(case, tmp_path):
    views = tmp_path / "views"
    answer = run("render", case / "scene.ply", "--out", views, "--views", 2, "--scale", 0.1)
    assert answer.code == 0
    assert answer.out == f"2 images in {views}\n"
    assert "placed on an orbit" in answer.err
    cameras = load_cameras(views / "cameras.json")
    assert [camera.name for camera in cameras] == ["orbit_000", "orbit_001"]
    for camera in cameras:
        assert iio.imread(views / f"{camera.name}.png").shape == (48, 64, 3)
        write_mask(tmp_path / "masks" / f"{camera.name}.png", np.ones((48, 64), bool))
    argv = given(case, cameras=views / "cameras.json", masks=tmp_path / "masks")
    assert run(*argv, "--out", tmp_path / "out").code == 0
