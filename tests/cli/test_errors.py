"""The command line: one line for every bad input, exit codes, and what a failed run leaves."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_case import FIXTURES, NAMES, contents, given, refused, report, run
from numpy.lib import recfunctions
from plyfile import PlyData, PlyElement

from gsc_jax.cli import outputs
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.masks import write_mask

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def scene_without(case: Path, path: Path, name: str) -> Path:
    vertex = PlyData.read(case / "scene.ply")["vertex"].data
    rest = recfunctions.drop_fields(vertex, name, usemask=False)
    PlyData([PlyElement.describe(rest, "vertex")]).write(str(path))
    return path


def test_a_missing_scene(case, tmp_path):
    scene = tmp_path / "missing.ply"
    assert f"{scene}: no such file" in refused(*given(case, scene=scene), "--out", tmp_path / "o")
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"these are not the bytes of a scene", "not a PLY"),
        (b"", "not a PLY"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nend_header\n", "no Gaussians"),
    ],
)
def test_a_scene_that_is_none(case, tmp_path, content, expected):
    scene = tmp_path / "scene.ply"
    scene.write_bytes(content)
    message = refused(*given(case, scene=scene), "--out", tmp_path / "out")
    assert f"{scene}: " in message
    assert expected in message


def test_a_truncated_scene(case, tmp_path):
    scene = tmp_path / "short.ply"
    scene.write_bytes((case / "scene.ply").read_bytes()[:-1000])
    message = refused(*given(case, scene=scene), "--out", tmp_path / "out")
    assert f"{scene}: damaged or cut short" in message
    assert "300" in message


def test_a_scene_without_a_property(case, tmp_path):
    scene = scene_without(case, tmp_path / "points.ply", "opacity")
    message = refused(*given(case, scene=scene), "--out", tmp_path / "out")
    assert f"{scene}: lacks" in message
    assert "opacity" in message


@pytest.mark.parametrize("content", ["{", "[]", '{"a": 1}', '[{"id": 0}]'])
def test_cameras_that_are_none(case, tmp_path, content):
    cameras = tmp_path / "cameras.json"
    cameras.write_text(content)
    message = refused(*given(case, cameras=cameras), "--out", tmp_path / "out")
    assert f"{cameras}" in message


def test_missing_cameras(case, tmp_path):
    cameras = tmp_path / "nothing"
    assert f"{cameras}: " in refused(*given(case, cameras=cameras), "--out", tmp_path / "out")


def test_cameras_of_another_scene(case, tmp_path):
    cameras = json.loads((case / "cameras.json").read_text())
    for camera in cameras:
        camera["position"] = [1000.0, 1000.0, 1000.0]
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(cameras))
    message = refused(*given(case, cameras=path), "--out", tmp_path / "out")
    assert f"{path}: the cameras see" in message


def test_a_near_plane_that_cuts_all_away(case, tmp_path):
    message = refused(*given(case, near=50), "--out", tmp_path / "out")
    assert f"{case / 'cameras.json'}: the near plane at 50" in message
    assert "near=" in message


@pytest.mark.parametrize(
    ("names", "expected"), [(("../a", "b"), "cannot name a file"), (("a/b", "a\\b"), "slashes")]
)
def test_camera_names_that_cannot_name_files(case, tmp_path, names, expected):
    cameras = load_cameras(case / "cameras.json")
    path = tmp_path / "cameras.json"
    pairs = zip(cameras, names, strict=False)
    save_cameras(path, [dataclasses.replace(camera, name=name) for camera, name in pairs])
    message = refused(*given(case, cameras=path), "--out", tmp_path / "out")
    assert f"{path}: " in message
    assert expected in message


def test_masks_of_other_cameras(case, tmp_path):
    write_mask(tmp_path / "masks" / "other.png", np.zeros((4, 4), bool))
    message = refused(*given(case, masks=tmp_path / "masks"), "--out", tmp_path / "out")
    assert f"{tmp_path / 'masks'}: none of its 1 images" in message
    assert repr(NAMES[0]) in message


def test_an_empty_folder_of_masks(case, tmp_path):
    (tmp_path / "masks").mkdir()
    message = refused(*given(case, masks=tmp_path / "masks"), "--out", tmp_path / "out")
    assert f"{tmp_path / 'masks'}: holds no images" in message


def test_nobody_to_ask_or_two_who_speak_of_the_same_views(case, tmp_path):
    out = "--out", tmp_path / "out"
    for changes in ({"detector": "none"}, {"method": "paper"}):
        message = refused(*given(case, masks=None, **changes), *out)
        assert "nothing to go by" in message
        assert "--masks" in message
        assert "--detector" in message
    assert "give one of the two" in refused(*given(case, detector="net.onnx"), *out)
    both = refused(*given(case, masks=None), "--detector", "a.onnx", "b.onnx", *out)
    assert "expected none, or native, one 2D network, or both" in both


def test_the_gaussians_alone(case, tmp_path):
    answer = run(*given(case, masks=None), "--out", tmp_path)
    assert answer.code == 0
    assert "probability that anything was tampered with" in answer.out
    said = report(tmp_path)
    assert said["verdict"] == said["native"]["verdict"]
    assert {path.name for path in (tmp_path / "masks").rglob("*.png")}
    assert not (tmp_path / "detector").exists()


def test_who_listens_to_masks_only_is_not_told_what_the_gaussians_say(case, tmp_path):
    argv = given(case, detector="native", method="official")
    assert "listens to masks only" in refused(*argv, "--out", tmp_path / "out")


def test_masks_without_the_gaussians(case, tmp_path):
    answer = run(*given(case, detector="none"), "--out", tmp_path)
    assert answer.code == 0
    assert report(tmp_path)["native"] is None


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"detector": "missing.onnx"}, "missing.onnx: does not exist"),
        ({"detector": "iml-vit"}, "--preset iml-vit"),
        ({"detector": "missing.onnx", "preset": "no-net"}, "no-net"),
        ({"detector": "missing.onnx", "spec": "missing.toml"}, "missing.toml: no such file"),
    ],
)
def test_a_detector_that_is_none(case, tmp_path, changes, expected):
    message = refused(*given(case, masks=None, **changes), "--out", tmp_path / "out")
    assert expected in message


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"method": "magic"}, ("magic", "--method", "paper", "official")),
        ({"mask_rule": "magic"}, ("magic", "--mask-rule", "share")),
        ({"views": 0}, ("--views 0",)),
        ({"views": "many"}, ("--views", "many")),
        ({"scale": 0}, ("--scale 0",)),
        ({"scale": "nan"}, ("--scale nan",)),
        ({"near": -1}, ("--near -1",)),
        ({"seed": -1}, ("--seed -1",)),
        ({"preset": "trufor"}, ("--preset", "--detector")),
        ({"provider": "cuda"}, ("--provider", "--detector")),
        ({"threads": 2}, ("--threads", "--detector")),
        ({"vews": 3}, ("--vews", "--views")),
    ],
)
def test_bad_options(case, tmp_path, changes, expected):
    message = refused(*given(case, **changes), "--out", tmp_path / "out")
    assert all(part in message for part in expected)


def test_bad_usage(case):
    assert "locate, render, tamper, evaluate, view, demo" in refused()
    assert "find" in refused("find")
    assert "--out" in refused(*given(case))
    background = ["--background", 0, 2, 0]
    assert "--background" in refused("render", case / "scene.ply", "--out", "o", *background)


@pytest.mark.parametrize("command", ["locate", "render", "tamper", "demo"])
def test_an_output_folder_that_cannot_be_written(case, tmp_path, command):
    (tmp_path / "file").write_text("in the way")
    out = tmp_path / "file" / "out"
    arguments = {
        "locate": given(case),
        "render": ["render", case / "scene.ply", "--cameras", case],
        "tamper": ["tamper", case / "scene.ply", "--cameras", case, "--size", 0.3],
        "demo": ["demo"],
    }
    message = refused(*arguments[command], "--out", out)
    assert str(out) in message
    assert "cannot be written" in message
    assert (tmp_path / "file").read_text() == "in the way"


@pytest.mark.parametrize("name", ["\udcff", "a\ud800.JPG"])
def test_a_camera_whose_name_is_no_text(case, tmp_path, name):
    cameras = load_cameras(case / "cameras.json")
    save_cameras(tmp_path / "cameras.json", [dataclasses.replace(cameras[0], name=name)])
    message = refused(*given(case, cameras=tmp_path / "cameras.json"), "--out", tmp_path / "out")
    assert f"{tmp_path / 'cameras.json'}: camera {name!r}: is no text" in message


@pytest.mark.parametrize("clash", ["masks", "detector"])
def test_results_never_overwrite_what_is_read(case, tmp_path, clash):
    shutil.copytree(case / "masks", tmp_path / clash)
    before = sorted(path.read_bytes() for path in (tmp_path / clash).rglob("*.png"))
    message = refused(*given(case, masks=tmp_path / clash), "--out", tmp_path)
    assert "another --out" in message
    assert before == sorted(path.read_bytes() for path in (tmp_path / clash).rglob("*.png"))


def test_masks_without_their_cameras_are_refused(case, tmp_path):
    scene, masks = case / "scene.ply", case / "masks"
    message = refused("locate", scene, "--masks", masks, "--out", tmp_path / "out")
    assert "--cameras" in message


@pytest.mark.parametrize("scale", [1000, 0.01])
def test_images_beyond_reason_are_refused(case, tmp_path, scale):
    assert "pixels" in refused(*given(case, scale=scale), "--out", tmp_path / "out")


# When something fails


def test_a_full_disk_leaves_the_earlier_results(case, found, tmp_path, monkeypatch):
    out = tmp_path / "out"
    shutil.copytree(found[0], out)
    before = contents(out)

    def full(self, stream):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(PlyData, "write", full)
    message = refused(*given(case, views=1), "--out", out)
    assert f"{out / 'tamper.ply'}: cannot be written (No space left on device)" in message
    assert contents(out) == before


@pytest.mark.parametrize("new", [True, False])
def test_an_interrupted_run_leaves_the_folder_as_it_was(case, tmp_path, monkeypatch, new):
    out = tmp_path / "out"
    if not new:
        out.mkdir()
        (out / "mine.txt").write_text("mine")

    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(outputs, "contact_sheet", interrupted)
    answer = run(*given(case), "--out", out)
    assert answer.code == 130
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    assert out.exists() != new
    if not new:
        assert contents(out) == {"mine.txt": b"mine"}


def test_our_own_faults_are_not_hidden(case, tmp_path, monkeypatch):
    def broken(*arguments, **options):
        raise ZeroDivisionError

    monkeypatch.setattr(outputs, "contact_sheet", broken)
    with pytest.raises(ZeroDivisionError):
        run(*given(case), "--out", tmp_path / "out")


@pytest.mark.parametrize(
    "listed",
    [
        *("no list", 3, [3], [""], ["result.json", "masks", "masks/a\0.png"]),
        ["../mine.png", "/mine.png", "masks/../../mine.png", ".png", "notes/x.png"],
    ],
)
def test_a_foreign_result_json_removes_nothing(case, tmp_path, listed):
    out = tmp_path / "out"
    (out / "notes").mkdir(parents=True)
    for mine in (tmp_path / "mine.png", out / "notes" / "x.png"):
        mine.write_bytes(b"mine")
    (out / "result.json").write_text(json.dumps({"outputs": listed}))
    assert run(*given(case), "--out", out).code == 0
    assert (tmp_path / "mine.png").exists()
    assert (out / "notes" / "x.png").exists()
