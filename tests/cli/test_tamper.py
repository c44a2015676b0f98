"""`gsc-jax tamper`: the edited scene, its truth, and input for `locate`."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_case import refused, run, unparsable

from gsc_jax import load_cameras, load_ply, save_ply
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.masks import image_path, read_probability


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    save_ply(folder / "scene.ply", make_room(count=6_000))
    save_cameras(folder / "cameras.json", room_cameras(6, width=96, height=72))
    return folder


@pytest.fixture(scope="module", params=["incorporation", "modification", "removal"])
def edited(request, room, tmp_path_factory):
    out = tmp_path_factory.mktemp("edited") / "out"
    cameras = ["--cameras", room / "cameras.json", "--out", out, "--edit", request.param]
    return request.param, out, run("tamper", room / "scene.ply", *cameras)


def test_the_truth_is_that_of_the_scene_written(edited):
    edit, out, answer = edited
    assert answer.code == 0
    assert answer.out.startswith(edit.capitalize())
    gaussians, labels = load_ply(out / "scene.ply"), np.load(out / "labels.npy")
    assert labels.dtype == bool
    assert 0 < labels.sum() < len(labels) == len(gaussians)
    description = json.loads((out / "edit.json").read_text())
    assert description["tampered"] == labels.sum()
    for camera in load_cameras(out / "cameras.json"):
        written = read_probability(image_path(out / "truth", camera.name)) > 0.5
        differs = np.mean(written != truth_mask(gaussians, camera, labels))
        assert differs < 0.002  # the file rounds quaternions to unit length
        assert description["visible"][camera.name] == pytest.approx(written.mean(), abs=0.01)


def test_locate_reads_what_tamper_writes(edited, tmp_path):
    _, out, answer = edited
    command = answer.out.splitlines()[-1].split()
    assert command[:4] == ["find", "it", "gsc-jax", "locate"]
    assert "its truth" in refused(*command[3:-1], out)
    assert run(*command[3:-1], tmp_path / "found").code == 0
    assert len(np.load(tmp_path / "found" / "labels.npy")) == len(np.load(out / "labels.npy"))


def test_a_vase_is_pasted_by_default_and_any_object_on_request(room, tmp_path):
    cameras = ["--cameras", room / "cameras.json", "--masks", "none"]
    answer = run("tamper", room / "scene.ply", *cameras, "--out", tmp_path / "own", "--object",
                 room / "scene.ply")  # fmt: skip
    assert answer.code == 0
    assert "find it" not in answer.out
    assert not (tmp_path / "own" / "masks").exists()
    description = json.loads((tmp_path / "own" / "edit.json").read_text())
    assert description["command"]["object"] == str(room / "scene.ply")


def test_a_second_edit_leaves_nothing_of_the_first(room, tmp_path):
    cameras = ["--cameras", room / "cameras.json", "--edit", "modification", "--out", tmp_path]
    assert run("tamper", room / "scene.ply", *cameras).code == 0
    assert len(list((tmp_path / "masks").glob("*.png"))) == 6
    answer = run("tamper", room / "scene.ply", *cameras, "--views", 4, "--masks", "none")
    assert answer.code == 0
    assert not list((tmp_path / "masks").glob("*.png"))
    assert len(list((tmp_path / "truth").glob("*.png"))) == 4
    listed = json.loads((tmp_path / "edit.json").read_text())["outputs"]
    files = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert set(listed) == files


def test_the_near_plane_counts(room, tmp_path):
    cameras = ["--cameras", room / "cameras.json", "--edit", "modification"]
    message = refused("tamper", room / "scene.ply", *cameras, "--near", 50, "--out", tmp_path / "o")
    assert str(room / "cameras.json") in message
    assert not (tmp_path / "o").exists()


def test_inputs_and_results_of_locate_are_kept(room, tmp_path):
    shutil.copytree(room, tmp_path / "mine")
    before = (tmp_path / "mine" / "cameras.json").read_bytes()
    message = refused(
        "tamper", room / "scene.ply", "--cameras", tmp_path / "mine", "--out", tmp_path / "mine"
    )
    assert "another --out" in message
    assert (tmp_path / "mine" / "cameras.json").read_bytes() == before
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / "result.json").write_text("{}")
    cameras = ["--cameras", room / "cameras.json", "--out", tmp_path / "found"]
    assert "results of `locate`" in refused("tamper", room / "scene.ply", *cameras)


def test_foreign_files_are_not_overwritten(room, tmp_path):
    (tmp_path / "scene.ply").write_text("mine")
    cameras = ["--cameras", room / "cameras.json", "--out", tmp_path]
    assert "scene.ply: exists" in refused("tamper", room / "scene.ply", *cameras)
    assert (tmp_path / "scene.ply").read_text() == "mine"


def test_an_object_without_extent_is_refused(room, tmp_path):
    save_ply(tmp_path / "speck.ply", make_room(count=6_000).take(np.arange(3)))
    message = refused(
        "tamper", room / "scene.ply", "--cameras", room / "cameras.json", "--out", tmp_path / "o",
        "--object", tmp_path / "speck.ply",
    )  # fmt: skip
    assert "speck.ply" in message
    assert "expected a .ply of one object" in message


def test_invalid_options(room, tmp_path):
    scene, out = room / "scene.ply", tmp_path / "out"
    cameras = ["--cameras", room / "cameras.json"]
    assert "--object" in refused(
        "tamper", scene, *cameras, "--out", out, "--edit", "removal", "--object", scene
    )
    assert "--size" in refused("tamper", scene, *cameras, "--out", out, "--size", 0.9)
    assert "--edit" in unparsable("tamper", scene, *cameras, "--out", out, "--edit", "addition")
    assert not out.exists()
    shutil.copy(scene, tmp_path / "scene.ply")
    message = refused("tamper", tmp_path / "scene.ply", *cameras, "--out", tmp_path)
    assert "another --out" in message
