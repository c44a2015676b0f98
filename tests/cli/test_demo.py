"""`gsc-jax demo`: the files, and that the printed scores equal those of the files."""

import json
import re
from pathlib import Path
from typing import get_args

import imageio.v3 as iio
import numpy as np
import pytest

from gsc_jax.benchmark.metrics import confusion
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.cli import demo
from gsc_jax.cli.options import Demo
from gsc_jax.estimators import Method
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.masks import image_path, read_probability
from gsc_jax.io.ply import read_ply
from gsc_jax.scene import InputError

COUNT, VIEWS, HELDOUT = 6_000, 6, 2


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    made = tampered_room(seed=1, count=COUNT, views=VIEWS, heldout=HELDOUT, width=96, height=72)
    return out, demo.run_demo(Demo(out=out, seed=1), monitor=Monitor(), made=made)[0]


def test_the_input_files_hold_the_scene(finished):
    out, _ = finished
    scene = read_ply(out / "input" / "scene.ply")
    labels = np.load(out / "input" / "labels.npy")
    assert len(scene.gaussians) == len(labels) == COUNT
    cameras = load_cameras(out / "input" / "cameras.json")
    heldout = load_cameras(out / "input" / "heldout_cameras.json")
    assert (len(cameras), len(heldout)) == (VIEWS, HELDOUT)
    truths = [image_path(out / "input" / "truth", camera.name) for camera in [*cameras, *heldout]]
    assert any(read_probability(truth).any() for truth in truths)
    masks = {path.stem for path in (out / "input" / "masks").iterdir()}
    assert masks == {camera.name for camera in cameras}, "held-out views have masks"


@pytest.mark.parametrize("method", get_args(Method))
def test_every_method_ran_on_the_files(finished, method):
    out, _ = finished
    result = json.loads((out / method / "result.json").read_text())
    assert result["method"] == method
    assert result["command"]["masks"] == str(out / "input" / "masks")
    assert result["counts"]["rows"] == COUNT
    assert result["seed"] == 1


@pytest.mark.parametrize("method", get_args(Method))
def test_the_printed_scores_are_those_of_the_files(finished, method):
    out, lines = finished
    labels = np.load(out / method / "labels.npy")
    score = confusion(labels, np.load(out / "input" / "labels.npy"))
    line = next(line for line in lines if line.startswith(f"{method}  ")).replace(",", "")
    expected = [labels.sum(), score.precision, score.recall, score.f1]
    assert [float(x) for x in line.split()[1:5]] == pytest.approx(expected, abs=5e-4)


def test_the_introduction_states_the_score_of_the_masks(finished):
    out, lines = finished
    introduction = " ".join(lines[:5])
    assert demo.REGIME in introduction
    (printed,) = re.findall(r"mean F1 of ([\d.]+)", introduction)
    scores = []
    for camera in load_cameras(out / "input" / "cameras.json"):
        truth = read_probability(image_path(out / "input" / "truth", camera.name))
        if truth.any():
            result = read_probability(image_path(out / "input" / "masks", camera.name))
            scores.append(confusion(result, truth).f1)
    assert float(printed) == pytest.approx(np.mean(scores), abs=6e-3)


def test_the_printed_paths_exist(finished):
    out, lines = finished
    paths = re.findall(rf"{re.escape(str(out))}\S*\.(?:png|html)", "\n".join(lines))
    picture, *reports = paths
    assert iio.imread(picture)[..., :3].std() > 10, "the picture is empty"
    assert len(reports) == len(demo.RUNS)
    assert all("</html>" in Path(report).read_text(encoding="utf-8") for report in reports)


def test_the_first_run_uses_the_attributes_only(finished):
    out, _ = finished
    result = json.loads((out / demo.ATTRIBUTES_ONLY / "result.json").read_text())
    assert result["command"]["masks"] is None
    assert result["attributes"]["verdict"] == result["verdict"]


def test_input_of_another_origin_is_kept(tmp_path):
    (tmp_path / "input").mkdir()
    (tmp_path / "input" / "scene.ply").write_bytes(b"mine")
    with pytest.raises(InputError, match="is not from `demo`"):
        demo.run_demo(Demo(out=tmp_path), monitor=Monitor())
    assert (tmp_path / "input" / "scene.ply").read_bytes() == b"mine"
