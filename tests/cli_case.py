"""A small scene in files, and the command line as a function, for the tests of the command line.

Test modules import the fixtures with `case, found, own_cache = FIXTURES`.
"""

import contextlib
import dataclasses
import io
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from onnx import helper
from onnx_models import FLOAT, save
from plyfile import PlyData, PlyElement
from results_folder import ball_over_floor

from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.cli import detector_choice
from gsc_jax.cli import main as cli
from gsc_jax.cli.staging import UNFINISHED
from gsc_jax.detectors.onnx import OnnxDetector
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.layout import encode
from gsc_jax.io.masks import image_path, write_mask
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.scene import Gaussians

NAMES = ("left/img.0001.JPG", "view.b", "c")
COUNT, OBJECT, BROKEN = 300, 60, (5, 17)
"""Gaussians in the file, how many of them are red, and rows that cannot be rendered."""

BIAS = np.array([-2], np.float32)


class Run(NamedTuple):
    code: int
    out: str
    err: str


def run(*argv: object) -> Run:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main([str(arg) for arg in argv])
    return Run(code, out.getvalue(), err.getvalue())


def unparsable(*argv: object) -> str:
    """The message of tyro about arguments that it cannot parse, with exit code 2."""
    with contextlib.redirect_stderr(io.StringIO()) as err, pytest.raises(SystemExit) as stop:
        cli.main([str(arg) for arg in argv])
    assert stop.value.code == 2
    return err.getvalue()


def refused(*argv: object) -> str:
    """The message about bad input: one line, exit code 2 and no other output."""
    answer = run(*argv)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert answer.err.startswith("gsc-jax: ")
    return answer.err


@pytest.fixture(scope="module")
def case(tmp_path_factory) -> Path:
    """A red ball over a blue floor, three cameras and their true masks."""
    folder = tmp_path_factory.mktemp("case")
    gaussians, labels = ball_over_floor(COUNT, COUNT // OBJECT)
    cameras = [
        dataclasses.replace(camera, name=name)
        for camera, name in zip(orbit_cameras(gaussians, 3, size=(48, 40)), NAMES, strict=True)
    ]
    save_cameras(folder / "cameras.json", cameras)
    for camera in cameras:
        write_mask(image_path(folder / "masks", camera.name), truth_mask(gaussians, camera, labels))
    np.save(folder / "truth.npy", labels)
    write_scene(folder / "scene.ply", gaussians)
    return folder


def write_scene(path: Path, gaussians: Gaussians) -> None:
    """The scene with foreign properties, one of them in the middle, and broken rows."""
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
    """Valid arguments of `locate` without --out, with some replaced, or left out by None."""
    named = {"cameras": case / "cameras.json", "masks": case / "masks"} | changes
    scene = named.pop("scene", case / "scene.ply")
    flags = [(f"--{name.replace('_', '-')}", value) for name, value in named.items()]
    return ["locate", scene, *(x for flag in flags if flag[1] is not None for x in flag)]


@pytest.fixture(scope="module")
def found(case, tmp_path_factory) -> tuple[Path, Run]:
    out = tmp_path_factory.mktemp("found") / "new" / "out"
    return out, run(*given(case), "--out", out)


@pytest.fixture
def own_cache(tmp_path, monkeypatch) -> Path:
    """A new cache folder, without outputs of networks from other tests."""
    monkeypatch.setattr(detector_choice, "cache_folder", lambda: tmp_path / "cache")
    return tmp_path / "cache"


def report(out: Path) -> dict:
    text = (out / "result.json").read_text()
    assert "NaN" not in text
    return json.loads(text)


def network(path: Path, channels: int = 3) -> Path:
    """An ONNX model that flags red pixels."""
    weights = np.array([20, 0, -20] if channels == 3 else [20] * channels, np.float32)
    nodes = [
        helper.make_node("Conv", ["image", "weights", "bias"], ["logit"]),
        helper.make_node("Sigmoid", ["logit"], ["map"]),
    ]
    tensors = {name: (FLOAT, [1, n, "h", "w"]) for name, n in (("image", channels), ("map", 1))}
    constants = {"weights": weights.reshape(1, channels, 1, 1), "bias": BIAS}
    return save(path, nodes, {"image": tensors["image"]}, {"map": tensors["map"]}, constants)


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder but those of an unfinished run, by relative path."""
    below = folder.rglob("*")
    files = [path for path in below if path.is_file() and UNFINISHED not in path.parts]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


FIXTURES = case, found, own_cache


def record_network_views(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A list that receives the name of each view on which an ONNX model runs from now on."""
    views: list[str] = []
    run_model = OnnxDetector.__call__

    def recording(self, image, camera):
        views.append(camera.name)
        return run_model(self, image, camera)

    monkeypatch.setattr(OnnxDetector, "__call__", recording)
    return views
