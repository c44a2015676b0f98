"""`gsc-jax render`: an image per camera."""

import dataclasses
import json
import shutil

import imageio.v3 as iio
import numpy as np
import pytest
from cli_case import FIXTURES, NAMES, contents, given, refused, run
from scipy.spatial.transform import Rotation
from strategies import random_scene
from web_files import WRITERS

from gsc_jax.benchmark.scenes import make_room
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.masks import image_path, write_mask
from gsc_jax.io.ply import save_ply

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


@pytest.mark.parametrize(("name", "up"), [("s.GLB", 1), ("s.splat", -1)])
def test_the_orbit_of_a_glb_has_y_upwards(tmp_path, name, up):
    write = WRITERS[f".{name.lower().split('.')[1]}"]
    scene = write(tmp_path / name, random_scene(50))
    answer = run("render", scene, "--out", tmp_path / "views", "--views", 3, "--scale", 0.1)
    assert answer.code == 0
    cameras = load_cameras(tmp_path / "views" / "cameras.json")
    assert all(up * -camera.viewmat[1, 1] > 0 for camera in cameras), "the scene is upside down"
    assert f"with {'-y'[up > 0 :]} as the up direction" in answer.err


def test_the_up_direction_is_estimated_or_given(tmp_path):
    room = make_room(count=3_000)
    turn = Rotation.from_euler("x", 90, degrees=True)
    quats = np.asarray(room.quats, np.float64)
    turned = dataclasses.replace(
        room,
        means=turn.apply(room.means).astype(np.float32),
        quats=(turn * Rotation.from_quat(quats, scalar_first=True)).as_quat(scalar_first=True),
    )
    save_ply(tmp_path / "scene.ply", turned)
    argv = ["render", tmp_path / "scene.ply", "--views", 3, "--scale", 0.1]
    for given_up, shown, up in (
        ([], "-z", [0, 0, -1]),
        (["--up", "x"], "x", [1, 0, 0]),
        (["--up", "-y"], "-y", [0, -1, 0]),
        (["--up", "0,3,4"], "0.00,0.60,0.80", [0, 0.6, 0.8]),
    ):
        answer = run(*argv, *given_up, "--out", tmp_path / shown.strip("-"))
        assert answer.code == 0
        assert f"with {shown} as the up direction" in answer.err
        for camera in load_cameras(tmp_path / shown.strip("-") / "cameras.json"):
            assert -camera.viewmat[1, :3] @ np.array(up) > 0.5, "the image is on its side"
    for text in ("up", ""):
        assert "expected one of x, y" in refused(*argv, f"--up={text}", "--out", tmp_path / "no")
    cameras = tmp_path / "x" / "cameras.json"
    both = refused(*argv, "--up", "x", "--cameras", cameras, "--out", tmp_path / "no")
    assert "leave out one" in both


def test_a_room_is_looked_at_from_inside(tmp_path):
    save_ply(tmp_path / "scene.ply", make_room(count=3_000))
    argv = ["--out", tmp_path / "views", "--views", 6, "--scale", 0.1]
    answer = run("render", tmp_path / "scene.ply", *argv)
    assert "6 cameras were placed in and around the room" in answer.err


def test_the_cameras_of_the_training_are_never_replaced(case, tmp_path):
    model = shutil.copytree(case, tmp_path / "model")
    before = contents(model)
    message = refused("render", model / "scene.ply", "--out", model, "--views", 2)
    assert str(model / "cameras.json") in message
    assert "give another --out" in message
    assert contents(model) == before


def test_only_images_of_an_earlier_run_are_replaced(case, tmp_path):
    out = tmp_path / "views"
    out.mkdir()
    photo = image_path(out, NAMES[1])
    photo.parent.mkdir(exist_ok=True)
    photo.write_bytes(b"a photo")
    argv = ["render", case / "scene.ply", "--cameras", case, "--out", out]
    assert f"{photo}: exists" in refused(*argv)
    assert photo.read_bytes() == b"a photo"
    photo.unlink()
    assert run(*argv).code == 0
    (out / "mine.png").write_bytes(b"kept")
    assert run(*argv, "--views", 1).code == 0
    images = {name for name in contents(out) if name.endswith(".png")}
    assert images == {image_path("", NAMES[0]).as_posix(), "mine.png"}
    listed = json.loads((out / "render.json").read_text())["outputs"]
    assert {*listed, "mine.png"} == contents(out).keys()


def test_an_image_never_replaces_an_input(case, tmp_path):
    camera = dataclasses.replace(load_cameras(case)[0], name="input")
    cameras = tmp_path / "input.png"
    save_cameras(tmp_path / "cameras.json", [camera])
    shutil.copy(case / "scene.ply", tmp_path / "scene.ply")
    (tmp_path / "input.png").symlink_to("scene.ply")
    argv = ["render", cameras, "--cameras", tmp_path / "cameras.json", "--out", tmp_path]
    before = contents(tmp_path)
    refused(*argv)
    assert contents(tmp_path) == before


def test_images_are_not_written_through_links(case, tmp_path):
    elsewhere, out = tmp_path / "elsewhere", tmp_path / "out"
    elsewhere.mkdir()
    out.mkdir()
    (out / "left").symlink_to(elsewhere)
    camera = dataclasses.replace(load_cameras(case)[0], name="left/0")
    save_cameras(tmp_path / "cameras.json", [camera])
    argv = ["render", case / "scene.ply", "--cameras", tmp_path / "cameras.json", "--out", out]
    assert "is a link" in refused(*argv)
    assert not contents(elsewhere)


@pytest.mark.parametrize("origin", ["written by others", "edited"])
def test_a_list_that_this_program_did_not_write_there_removes_nothing(case, tmp_path, origin):
    argv = ["render", case / "scene.ply", "--cameras", case, "--views", 1, "--out"]
    assert run(*argv, tmp_path).code == 0
    report = json.loads((tmp_path / "render.json").read_text())
    if origin == "written by others":
        report["outputs"] = {"render.json": None}
    report["outputs"]["c.png"] = "0" * 64
    (tmp_path / "render.json").write_text(json.dumps(report))
    (tmp_path / "c.png").write_bytes(b"mine")
    assert "another --out" in refused(*argv, tmp_path)
    assert (tmp_path / "c.png").read_bytes() == b"mine"


def test_a_copy_of_results_can_be_rendered_into(case, tmp_path):
    argv = ["render", case / "scene.ply", "--cameras", case, "--out"]
    assert run(*argv, tmp_path / "there").code == 0
    out = shutil.copytree(tmp_path / "there", tmp_path / "here")
    (out / "mine.png").write_bytes(b"mine")
    assert run(*argv, out, "--views", 1).code == 0
    assert contents(out).keys() == {image_path("", NAMES[0]).as_posix(), "mine.png", "render.json"}
