"""The command line: its outputs, its exit codes, and one line for every bad input."""

import contextlib
import dataclasses
import io
import json
import shutil
import subprocess
import sys
import typing
from pathlib import Path
from typing import NamedTuple

import imageio.v3 as iio
import numpy as np
import onnx
import pytest
from numpy.lib import recfunctions
from onnx import TensorProto, helper, numpy_helper
from plyfile import PlyData, PlyElement

from gsc_jax.app import cli, options, outputs
from gsc_jax.app import run as app_run
from gsc_jax.app.pictures import overlay
from gsc_jax.app.progress import Bars
from gsc_jax.benchmark.metrics import f1_score, truth_mask
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.detectors.onnx import OnnxDetector
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.layout import encode
from gsc_jax.io.masks import image_path, read_probability, write_mask
from gsc_jax.scene import Gaussians
from gsc_jax.views import orbit_cameras

NAMES = ("left/img.0001.JPG", "view.b", "c")
COUNT, OBJECT, BROKEN = 300, 60, (5, 17)
"""Gaussians in the file, red ones among them, and rows that cannot be rendered."""

RED, BLUE = (1.2, -1.5, -1.5), (-1.5, -1.5, 1.2)


class Run(NamedTuple):
    code: int
    out: str
    err: str


def run(*argv: object) -> Run:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main([str(arg) for arg in argv])
    return Run(code, out.getvalue(), err.getvalue())


def refused(*argv: object) -> str:
    """What bad input is answered with: one line, exit code 2 and nothing else."""
    answer = run(*argv)
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    assert answer.err.startswith("gsc-jax: ")
    return answer.err


@pytest.fixture(scope="module")
def case(tmp_path_factory) -> Path:
    """A red ball over a blue floor, three cameras and their true masks."""
    folder = tmp_path_factory.mktemp("case")
    rng = np.random.default_rng(0)
    labels = np.arange(COUNT) % (COUNT // OBJECT) == 0
    floor = rng.uniform(-1, 1, (COUNT, 3)) * [1, 0.02, 1] + [0, 0.4, 0]
    ball = rng.normal(size=(COUNT, 3))
    ball *= 0.3 / np.linalg.norm(ball, axis=1, keepdims=True)
    means = np.where(labels[:, None], ball, floor)
    colors = np.where(labels[:, None], RED, BLUE)
    gaussians = Gaussians(
        means=means.astype(np.float32),
        log_scales=np.full((COUNT, 3), -2.6, np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (COUNT, 1)),
        logit_opacities=np.full(COUNT, 3, np.float32),
        sh=colors[:, None].astype(np.float32),
    )
    cameras = [
        dataclasses.replace(camera, name=name)
        for camera, name in zip(
            orbit_cameras(gaussians, 3, width=48, height=40), NAMES, strict=True
        )
    ]
    save_cameras(folder / "cameras.json", cameras)
    for camera in cameras:
        write_mask(image_path(folder / "masks", camera.name), truth_mask(gaussians, camera, labels))
    np.save(folder / "truth.npy", labels)
    write_scene(folder / "scene.ply", gaussians)
    return folder


def write_scene(path: Path, gaussians: Gaussians) -> None:
    """The scene with properties of other people, one of them in the middle, and broken rows."""
    plain = encode(gaussians)["vertex"].data
    kinds = [(name, plain.dtype[name]) for name in plain.dtype.names]
    data = np.empty(COUNT, [*kinds[:3], ("mask", "u1"), *kinds[3:], ("time", "<f8")])
    for name in plain.dtype.names:
        data[name] = plain[name]
    data["mask"], data["time"] = np.arange(COUNT) % 7, np.arange(COUNT) / 3
    data["x"][BROKEN[0]] = np.nan
    for axis in range(4):
        data[f"rot_{axis}"][BROKEN[1]] = 0
    PlyData([PlyElement.describe(data, "vertex")], byte_order="<").write(str(path))


def given(case: Path, **changes: object) -> list[object]:
    """Arguments of a good `locate` but for the output, with some of them replaced or left out."""
    named = {"cameras": case / "cameras.json", "masks": case / "masks"} | changes
    scene = named.pop("scene", case / "scene.ply")
    flags = [(f"--{name.replace('_', '-')}", value) for name, value in named.items()]
    return ["locate", scene, *(x for flag in flags if flag[1] is not None for x in flag)]


@pytest.fixture(scope="module")
def found(case, tmp_path_factory) -> tuple[Path, Run]:
    out = tmp_path_factory.mktemp("found") / "new" / "out"
    return out, run(*given(case), "--out", out)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch) -> Path:
    """What networks said in earlier tests, and in earlier runs of this one, is not known."""
    monkeypatch.setattr(app_run, "default_cache", lambda: tmp_path / "cache")
    return tmp_path / "cache"


def report(out: Path) -> dict:
    def refuse(constant: str):
        raise AssertionError(f"{constant} is no JSON")

    return json.loads((out / "result.json").read_text(), parse_constant=refuse)


# What a run leaves


def test_a_run_succeeds_and_sums_up(found):
    out, answer = found
    assert answer.code == 0
    first = answer.out.splitlines()[0]
    labels = np.load(out / "labels.npy")
    assert first.startswith(f"{labels.sum():,} of {COUNT - len(BROKEN)} Gaussians are tampered")
    assert "of what 3 views show" in first
    for name in ("overview.png", "tamper.ply", "result.json"):
        assert str(out / name) in answer.out
    assert "most work" in answer.out
    assert answer.err.startswith("warning: ")
    assert "left out 2 of 300 Gaussians" in answer.err


def test_all_files_are_there_and_no_others(found):
    out, _ = found
    per_camera = [f"{kind}/{name}.png" for kind in outputs.BY_CAMERA for name in NAMES]
    plain = ["tamper.ply", "highlight.ply", "labels.npy", "tamper.npy", "result.json"]
    files = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert files == {*per_camera, *plain, "overview.png"}
    assert [path for path in out.iterdir() if path.name.startswith(".")] == []
    assert report(out)["outputs"] == sorted(files)


def test_the_object_is_found(case, found):
    out, _ = found
    truth = np.load(case / "truth.npy")
    truth[list(BROKEN)] = False
    assert f1_score(np.load(out / "labels.npy"), truth) > 0.8
    for name in NAMES:
        mask = read_probability(image_path(out / "masks", name))
        assert f1_score(mask, read_probability(image_path(case / "masks", name))) > 0.8


def test_tamper_ply_is_the_scene_plus_one_property(case, found):
    out, _ = found
    before = PlyData.read(case / "scene.ply")["vertex"]
    after = PlyData.read(out / "tamper.ply")["vertex"]
    names = [prop.name for prop in before.properties]
    assert [prop.name for prop in after.properties] == [*names, "tamper"]
    assert after.data.dtype["tamper"] == np.dtype("<f4")
    for name in names:
        assert after.data.dtype[name] == before.data.dtype[name]
        np.testing.assert_array_equal(after[name], before[name])
    np.testing.assert_array_equal(after["tamper"], np.load(out / "tamper.npy"))


def test_arrays_have_an_entry_per_row_of_the_file(found):
    out, _ = found
    labels, tamper = np.load(out / "labels.npy"), np.load(out / "tamper.npy")
    assert (labels.dtype, labels.shape) == (np.dtype(bool), (COUNT,))
    assert (tamper.dtype, tamper.shape) == (np.dtype(np.float32), (COUNT,))
    assert not labels[list(BROKEN)].any()
    assert not tamper[list(BROKEN)].any()
    assert ((tamper >= 0) & (tamper <= 1)).all()
    np.testing.assert_array_equal(labels, tamper > 0.5)


def test_highlight_shows_what_can_be_rendered(found):
    out, _ = found
    vertex = PlyData.read(out / "highlight.ply")["vertex"]
    labels = np.delete(np.load(out / "labels.npy"), BROKEN)
    assert len(vertex) == COUNT - len(BROKEN)
    np.testing.assert_array_equal(vertex["f_dc_0"] > vertex["f_dc_1"] + 0.1, labels)


def test_pictures_have_the_size_of_the_views(case, found):
    out, _ = found
    for name in NAMES:
        final = iio.imread(image_path(out / "masks", name))
        assert (final.shape, final.dtype) == ((40, 48), np.dtype(np.uint8))
        assert set(np.unique(final)) == {0, 255}
        assert iio.imread(image_path(out / "overlay", name)).shape == (40, 48, 3)
        np.testing.assert_array_equal(
            read_probability(image_path(out / "detector", name)),
            read_probability(image_path(case / "masks", name)),
        )
    sheet = iio.imread(out / "overview.png")
    assert sheet.shape[0] > 300
    assert sheet[..., :3].std() > 10, "the overview is empty"


def test_result_json_says_what_was_done(case, found):
    out, _ = found
    said = report(out)
    labels = np.load(out / "labels.npy")
    assert said["command"] | {"scene": None, "out": None} == {
        "scene": None,
        "out": None,
        "cameras": str(case / "cameras.json"),
        "masks": str(case / "masks"),
        "detector": [],
        "preset": None,
        "spec": None,
        "provider": None,
        "threads": None,
        "method": "robust",
        "all_views": False,
        "mask_rule": None,
        "lambda2": None,
        "epochs": None,
        "threshold": None,
        "no_cache": False,
        "views": None,
        "scale": 1.0,
        "near": 0.2,
        "seed": 0,
    }
    assert said["method"] == "robust"
    assert said["config"]["threshold"] == 0.5
    assert 0 < said["verdict"] < 1
    assert {view["reliability"] for view in said["per_view"]} <= {"finds", "misses", "inverted"}
    assert said["seed"] == 0
    counts = said["counts"]
    assert counts["rows"] == COUNT
    assert counts["dropped"] == {"position not finite": 1, "rotation zero": 1}
    assert counts["gaussians"] == COUNT - 2 == counts["seen"] + counts["unseen"]
    assert counts["tampered"] == labels.sum()
    assert said["views"] == said["judged_views"] == 3
    areas = [view["tampered_share"] for view in said["per_view"]]
    assert [view["name"] for view in said["per_view"]] == list(NAMES)
    assert said["tampered_share_of_views"] == pytest.approx(np.mean(areas))
    assert areas[0] == pytest.approx(iio.imread(image_path(out / "masks", NAMES[0])).mean() / 255)
    stages = list(said["stages"])
    assert (stages[0], stages[-1]) == ("load", "write")
    assert {"lift", "optimise", "masks"} < set(stages)
    assert all(stage["seconds"] >= 0 for stage in said["stages"].values())
    assert {"gsc_jax", "python", "numpy", "jax", "jaxlib", "optax", "device"} < set(
        said["versions"]
    )
    assert len(said["warnings"]) == 1


# Choices


def test_a_second_run_replaces_the_first_and_nothing_else(case, tmp_path):
    out = tmp_path / "out"
    assert run(*given(case), "--out", out).code == 0
    (out / "masks" / "mine.png").write_bytes(b"mine")
    (out / "notes.txt").write_text("mine")
    again = run(*given(case, views=1, scale=0.5, method="paper", seed=3), "--out", out)
    assert again.code == 0
    assert [p.name for p in sorted((out / "masks").rglob("*.png"))] == [
        "img.0001.JPG.png",
        "mine.png",
    ]
    assert (out / "notes.txt").read_text() == "mine"
    assert iio.imread(image_path(out / "masks", NAMES[0])).shape == (20, 24)
    said = report(out)
    assert (said["method"], said["seed"], said["config"]["seed"]) == ("paper", 3, 3)
    assert said["views"] == 1


def test_what_a_run_is_given_is_never_removed(case, tmp_path):
    # An earlier run placed cameras and wrote them; this one is given them.
    shutil.copy(case / "cameras.json", tmp_path)
    (tmp_path / "result.json").write_text(json.dumps({"outputs": ["cameras.json"]}))
    assert run(*given(case, cameras=tmp_path / "cameras.json"), "--out", tmp_path).code == 0
    assert (tmp_path / "cameras.json").is_file()
    assert run(*given(case), "--out", tmp_path).code == 0
    assert report(tmp_path)["views"] == 3


def test_the_scene_may_be_an_earlier_result(case, found, tmp_path):
    answer = run(*given(case, scene=found[0] / "tamper.ply"), "--out", tmp_path)
    assert answer.code == 0
    assert "has a property tamper already" in answer.err
    np.testing.assert_array_equal(
        np.load(tmp_path / "tamper.npy"), np.load(found[0] / "tamper.npy")
    )
    assert "another --out" in refused(
        *given(case, scene=found[0] / "tamper.ply"), "--out", found[0]
    )


def test_cameras_without_a_mask_get_one(case, tmp_path):
    shutil.copytree(case / "masks", tmp_path / "masks")
    (tmp_path / "masks" / "c.png").unlink()
    answer = run(*given(case, masks=tmp_path / "masks"), "--out", tmp_path / "out")
    assert "1 of 3 cameras have no mask" in answer.err
    said = report(tmp_path / "out")
    assert (said["views"], said["judged_views"]) == (3, 2)
    assert (tmp_path / "out" / "masks" / "c.png").is_file()
    assert not (tmp_path / "out" / "detector" / "c.png").exists()


def test_more_views_than_cameras_is_said(case, tmp_path):
    answer = run(*given(case, views=9), "--out", tmp_path)
    assert answer.code == 0
    assert "--views 9" in answer.err


def test_nothing_tampered_is_said(case, tmp_path):
    for name in NAMES:
        write_mask(image_path(tmp_path / "masks", name), np.zeros((40, 48), bool))
    answer = run(*given(case, masks=tmp_path / "masks"), "--out", tmp_path / "out")
    assert answer.out.startswith("No tampered Gaussian was found")
    assert "No view says" in answer.err
    assert not np.load(tmp_path / "out" / "labels.npy").any()


@pytest.mark.parametrize(("count", "total"), [(1, 3), (2, 5), (4, 24), (9, 3), (3, 3)])
def test_views_are_spread_evenly(case, count, total):
    cameras = load_cameras(case / "cameras.json")
    many = [dataclasses.replace(cameras[0], name=str(i)) for i in range(total)]
    places = [int(camera.name) for camera in outputs.evenly(many, count)]
    assert len(places) == min(count, total)
    assert places[0] == 0
    gaps = np.diff([*places, total])
    assert gaps.min() >= 1
    assert np.ptp(gaps) <= 1


def test_without_cameras_an_orbit_is_made_and_written(case, tmp_path):
    views = tmp_path / "views"
    answer = run("render", case / "scene.ply", "--out", views, "--views", 2, "--scale", 0.1)
    assert answer.code == 0
    assert answer.out == f"2 images in {views}\n"
    assert "cameras were placed around the scene" in answer.err
    cameras = load_cameras(views / "cameras.json")
    assert [camera.name for camera in cameras] == ["orbit_000", "orbit_001"]
    for camera in cameras:
        assert iio.imread(views / f"{camera.name}.png").shape == (48, 64, 3)
        write_mask(tmp_path / "masks" / f"{camera.name}.png", np.ones((48, 64), bool))
    argv = given(case, cameras=views / "cameras.json", masks=tmp_path / "masks")
    assert run(*argv, "--out", tmp_path / "out").code == 0


def test_render_writes_an_image_per_camera(case, tmp_path):
    argv = ["render", case / "scene.ply", "--cameras", case, "--out", tmp_path]
    assert run(*argv, "--background", 0, 1, 0).code == 0
    image = iio.imread(image_path(tmp_path, NAMES[0])).astype(int)
    assert image.shape == (40, 48, 3)
    assert (image[0, 0] == [0, 255, 0]).all(), "the corner is not background"
    assert image[..., 2].max() > 100, "the scene is invisible"


# A network


def network(path: Path, channels: int = 3) -> Path:
    """A model that flags what is red and not blue, as a network would."""
    weights = np.array([20, 0, -20] if channels == 3 else [20] * channels, np.float32)
    graph = helper.make_graph(
        [
            helper.make_node("Conv", ["image", "weights", "bias"], ["logit"]),
            helper.make_node("Sigmoid", ["logit"], ["map"]),
        ],
        "red",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, channels, "h", "w"])],
        [helper.make_tensor_value_info("map", TensorProto.FLOAT, [1, 1, "h", "w"])],
        [
            numpy_helper.from_array(weights.reshape(1, channels, 1, 1), "weights"),
            numpy_helper.from_array(np.array([-2], np.float32), "bias"),
        ],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)
    return path


def test_a_network_looks_at_the_renders(case, tmp_path):
    argv = given(case, masks=None, detector=network(tmp_path / "red.onnx"))
    assert run(*argv, "--out", tmp_path / "out").code == 0
    truth = np.load(case / "truth.npy")
    truth[list(BROKEN)] = False
    assert f1_score(np.load(tmp_path / "out" / "labels.npy"), truth) > 0.8
    assert "render" in report(tmp_path / "out")["stages"]


def test_a_spec_says_how_to_feed_the_network(case, tmp_path):
    model = network(tmp_path / "red.onnx")
    spec = tmp_path / "net.toml"
    spec.write_text('channels = "bgr"\n')
    argv = given(case, masks=None, detector=model, spec=spec)
    assert run(*argv, "--out", tmp_path / "out", "--method", "official").code == 0
    truth = np.load(case / "truth.npy")
    assert f1_score(np.load(tmp_path / "out" / "labels.npy"), truth) < 0.5, "colours not swapped"
    spec.write_text("size = 0\n")
    assert f"{spec}: detector spec: size is 0" in refused(*argv, "--out", tmp_path / "no")
    spec.write_text("size = \n")
    assert f"{spec}: no TOML" in refused(*argv, "--out", tmp_path / "no")
    assert "one of them" in refused(*argv, "--preset", "trufor", "--out", tmp_path / "no")


def test_the_spec_beside_a_model_is_taken_and_named(case, tmp_path):
    model = network(tmp_path / "red.onnx")
    beside, other = tmp_path / "red.toml", tmp_path / "other.toml"
    beside.write_text('chanels = "bgr"\n')
    argv = given(case, masks=None, detector=model, method="official")
    message = refused(*argv, "--out", tmp_path / "no")
    assert f"{beside}: detector spec: unknown field 'chanels' (did you mean 'channels'?)" in message
    beside.write_text('channels = "bgr"\n')
    assert run(*argv, "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["command"]["spec"] == str(beside)
    truth = np.load(case / "truth.npy")
    assert f1_score(np.load(tmp_path / "out" / "labels.npy"), truth) < 0.5, "colours not swapped"
    other.write_text("")
    assert run(*argv, "--spec", other, "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["command"]["spec"] == str(other)
    assert f1_score(np.load(tmp_path / "out" / "labels.npy"), truth) > 0.8
    # A preset is asked for; what lies beside the model is not.
    beside.write_text("size = 0\n")
    assert run(*argv, "--preset", "pscc-net", "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["command"]["spec"] is None


def test_a_second_run_asks_no_network(case, tmp_path, monkeypatch, own_cache):
    asked = []
    judged = OnnxDetector.__call__

    def counting(self, image, camera):
        asked.append(camera.name)
        return judged(self, image, camera)

    monkeypatch.setattr(OnnxDetector, "__call__", counting)
    argv = given(case, masks=None, detector=network(tmp_path / "red.onnx"))
    assert run(*argv, "--no-cache", "--out", tmp_path / "never").code == 0
    assert not own_cache.exists()
    assert run(*argv, "--out", tmp_path / "first").code == 0
    assert len(asked) == 2 * len(NAMES)
    assert run(*argv, "--out", tmp_path / "again", "--threads", 1).code == 0
    assert run(*argv, "--out", tmp_path / "lifted", "--method", "official").code == 0
    assert len(asked) == 2 * len(NAMES), "a network was run again"
    for name in ("first", "again"):
        for file in ("tamper.npy", "labels.npy"):
            np.testing.assert_array_equal(
                np.load(tmp_path / name / file), np.load(tmp_path / "never" / file)
            )
    assert run(*argv, "--out", tmp_path / "smaller", "--scale", 0.5).code == 0
    assert len(asked) == 3 * len(NAMES), "another image, the same output"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"provider": "abacus"}, ("no provider 'abacus'", "one of", "cpu")),
        ({"threads": -1}, ("-1 threads",)),
        ({"threads": "all"}, ("--threads", "all")),
    ],
)
def test_providers_and_threads_that_are_none(case, tmp_path, changes, expected):
    model = network(tmp_path / "red.onnx")
    argv = given(case, masks=None, detector=model, **changes)
    message = refused(*argv, "--out", tmp_path / "out")
    assert all(part in message for part in expected)


def test_a_network_of_the_wrong_shape(case, tmp_path):
    model = network(tmp_path / "wide.onnx", channels=6)
    message = refused(*given(case, masks=None, detector=model), "--out", tmp_path / "out")
    assert str(model) in message
    assert "[1, 6, ?, ?]" in message or "[1, 6, h, w]" in message
    assert not (tmp_path / "out").exists()


# Bad input


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
    assert "locate, render, tamper, demo" in refused()
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


# When something fails


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


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


@pytest.mark.parametrize("listed", ["no list", ["../mine.png", "/mine.png", "", 3, "notes/x.png"]])
def test_a_foreign_result_json_removes_nothing(case, tmp_path, listed):
    out = tmp_path / "out"
    (out / "notes").mkdir(parents=True)
    for mine in (tmp_path / "mine.png", out / "notes" / "x.png"):
        mine.write_bytes(b"mine")
    (out / "result.json").write_text(json.dumps({"outputs": listed}))
    assert run(*given(case), "--out", out).code == 0
    assert (tmp_path / "mine.png").exists()
    assert (out / "notes" / "x.png").exists()


# What people see


@pytest.mark.parametrize("command", ["locate", "render", "tamper", "demo"])
def test_help_teaches(command, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main([command, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert f"gsc-jax {command}" in text
    assert "for example:" in text
    assert "--out DIR" in text
    if command == "locate":
        assert "{robust,paper,official}" in text
        assert "0.2" in text
        assert "world units" in text


def test_the_masks_of_tamper_are_the_regimes():
    assert typing.get_args(options.Regime) == ("none", *REGIMES)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_bars_show_every_stage_on_a_terminal_only():
    for stream, drawn in ((Terminal(), True), (io.StringIO(), False)):
        with Bars(stream) as bars:
            for done in range(3):
                bars("look", done, 2)
            bars("masks", 1, 1)
        assert ("look" in stream.getvalue()) == drawn
        assert ("masks" in stream.getvalue()) == drawn
        assert ("2/2" in stream.getvalue()) == drawn


def test_bars_tell_the_rate_of_the_views_and_what_is_left(monkeypatch):
    """What was done when the bar began, at a time that it does not know, does not count."""
    now = [1000.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    stream = Terminal()
    monkeypatch.setenv("COLUMNS", "100")
    with Bars(stream) as bars:
        for done in range(1, 5):
            bars("look", done, 10)
            now[0] += 8.0
        bars("look", 10, 10)
        now[0] += 100.0
    assert "10/10 [00:32<00:00" in stream.getvalue().split("\r")[-1]
    last = next(line for line in stream.getvalue().split("\r") if "4/10" in line)
    assert "[00:24<00:48,  8.00s/view]" in last


def test_overlay_marks_the_mask_and_nothing_far_from_it():
    image = np.random.default_rng(0).random((60, 80, 3)).astype(np.float32)
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    marked = overlay(image, mask)
    changed = (marked != image).any(axis=-1)
    assert changed[mask].all()
    assert not changed[:17].any()
    assert changed.sum() < 1.6 * mask.sum()
    np.testing.assert_array_equal(overlay(image, ~np.ones_like(mask)), image)
    assert ((marked >= 0) & (marked <= 1)).all()


def test_the_console_script_runs():
    script = Path(sys.executable).parent / "gsc-jax"
    command = [str(script)] if script.exists() else [sys.executable, "-m", "gsc_jax.app.cli"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("gsc-jax ")
    done = subprocess.run([*command, "locate"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1


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
