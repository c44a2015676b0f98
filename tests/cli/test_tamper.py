"""`gsc-jax tamper`: the edited scene, its truth, and input for `locate`."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_case import contents, refused, run, unparsable

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
    cameras += ["--out", tmp_path / "own", "--object", room / "scene.ply"]
    answer = run("tamper", room / "scene.ply", *cameras)
    assert answer.code == 0
    assert "find it" not in answer.out
    assert not (tmp_path / "own" / "masks").exists()
    description = json.loads((tmp_path / "own" / "edit.json").read_text())
    assert description["command"]["object"] == str(room / "scene.ply")


def test_views_may_differ_in_size(room, tmp_path):
    cameras = load_cameras(room / "cameras.json")
    sizes = [(96, 72), (60, 80), (97, 33), (96, 72), (64, 48), (80, 60)]
    mixed = [camera.resized(*size) for camera, size in zip(cameras, sizes, strict=True)]
    save_cameras(tmp_path / "cameras.json", mixed)
    given = ["--cameras", tmp_path / "cameras.json", "--out", tmp_path / "out"]
    assert run("tamper", room / "scene.ply", *given).code == 0
    for camera in mixed:
        for kind in ("truth", "masks"):
            mask = read_probability(image_path(tmp_path / "out" / kind, camera.name))
            assert mask.shape == (camera.height, camera.width)


def test_a_second_edit_leaves_nothing_of_the_first(room, tmp_path):
    cameras = ["--cameras", room / "cameras.json", "--edit", "modification", "--out", tmp_path]
    assert run("tamper", room / "scene.ply", *cameras).code == 0
    assert len(list((tmp_path / "masks").glob("*.png"))) == 6
    answer = run("tamper", room / "scene.ply", *cameras, "--views", 4, "--masks", "none")
    assert answer.code == 0
    assert not list((tmp_path / "masks").glob("*.png"))
    assert len(list((tmp_path / "truth").glob("*.png"))) == 4
    listed = json.loads((tmp_path / "edit.json").read_text())["outputs"]
    assert set(listed) == contents(tmp_path).keys()


def test_inputs_results_of_locate_and_foreign_files_are_kept(room, tmp_path):
    mine = shutil.copytree(room, tmp_path / "mine")
    before = contents(mine)
    scene = ["tamper", room / "scene.ply", "--cameras"]
    assert "another --out" in refused(*scene, mine, "--out", mine)
    assert "another --out" in refused("tamper", mine / "scene.ply", "--out", mine)
    assert "scene.ply: exists" in refused(*scene, room, "--out", mine)
    assert contents(mine) == before
    (tmp_path / "result.json").write_text("{}")
    assert "results of `locate`" in refused(*scene, room, "--out", tmp_path)


def test_invalid_options(room, tmp_path):
    save_ply(tmp_path / "speck.ply", make_room(count=6_000).take(np.arange(3)))
    argv = ["tamper", room / "scene.ply", "--cameras", room / "cameras.json", "--out"]
    argv += [tmp_path / "out"]
    message = refused(*argv, "--object", tmp_path / "speck.ply")
    assert "speck.ply" in message
    assert "expected a .ply of one object" in message
    assert "--object" in refused(*argv, "--edit", "removal", "--object", room / "scene.ply")
    assert "--size" in refused(*argv, "--size", 0.9)
    assert str(room / "cameras.json") in refused(*argv, "--near", 50)
    assert "--edit" in unparsable(*argv, "--edit", "addition")
    assert not (tmp_path / "out").exists()


def test_a_picture_of_another_origin_is_kept(room, tmp_path):
    (tmp_path / "overview.png").write_bytes(b"mine")
    argv = ["tamper", room / "scene.ply", "--cameras", room, "--out", tmp_path]
    assert "overview.png: exists" in refused(*argv)
    (tmp_path / "edit.json").write_text('{"outputs": []}')
    assert "overview.png: exists" in refused(*argv)
    assert (tmp_path / "overview.png").read_bytes() == b"mine"


@pytest.mark.parametrize("name", ["edit.json", "masks/{}.png", "truth/{}.png", "labels.npy"])
def test_files_of_others_are_kept_beside_an_edit(room, tmp_path, name):
    """An edit without masks does not own the files that are put into masks/ later."""
    argv = ["tamper", room / "scene.ply", "--cameras", room, "--out", tmp_path, "--views", 2]
    if name.startswith("masks"):
        assert run(*argv, "--masks", "none").code == 0
    mine = tmp_path / name.format(load_cameras(room)[0].name)
    mine.parent.mkdir(exist_ok=True)
    mine.write_bytes(b"mine")
    assert f"{mine}: exists" in refused(*argv)
    assert mine.read_bytes() == b"mine"


def test_an_edit_never_replaces_its_cameras(room, tmp_path):
    cameras = tmp_path / "edit.json"
    shutil.copy(room / "cameras.json", cameras)
    argv = ["tamper", room / "scene.ply", "--cameras", cameras, "--out", tmp_path]
    assert "overwrite this input" in refused(*argv)
    assert load_cameras(cameras)
