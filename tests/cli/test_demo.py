"""The demo: a case is made, both methods run on its files, and the story is told in numbers."""

import json
import re
from pathlib import Path
from typing import get_args

import imageio.v3 as iio
import numpy as np
import pytest

from gsc_jax.benchmark.metrics import confusion, f1_score
from gsc_jax.cli import demo
from gsc_jax.cli.options import Demo
from gsc_jax.estimators.gschecker import Method
from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.masks import image_path, read_probability
from gsc_jax.io.ply import read_ply

COUNT, VIEWS, HELDOUT = 6_000, 6, 2
CONTESTANTS = ("inverse projection", *demo.RUNS)


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    stages = []
    lines = demo.run_demo(
        Demo(out=out, seed=1),
        count=COUNT,
        views=VIEWS,
        heldout=HELDOUT,
        width=96,
        height=72,
        progress=lambda *told: stages.append(told[0]),
    )
    return out, lines, set(stages)


def numbers(lines: list[str], begin: str) -> list[float]:
    """The numbers of the line that begins so."""
    line = next(line for line in lines if line.startswith(f"{begin}  "))
    return [float(x) for x in re.findall(r"[\d.]+", line.removeprefix(begin).replace(",", ""))]


def test_the_files_are_what_locate_is_given(told):
    out, _, _ = told
    scene = read_ply(out / "input" / "scene.ply")
    labels = np.load(out / "input" / "labels.npy")
    assert len(scene.gaussians) == len(labels) == COUNT
    cameras = load_cameras(out / "input" / "cameras.json")
    heldout = load_cameras(out / "input" / "heldout_cameras.json")
    assert (len(cameras), len(heldout)) == (VIEWS, HELDOUT)
    truths = [image_path(out / "input" / "truth", camera.name) for camera in [*cameras, *heldout]]
    assert any(read_probability(truth).any() for truth in truths)
    masks = {path.stem for path in (out / "input" / "masks").iterdir()}
    assert masks == {camera.name for camera in cameras}, "held-out views are given away"


@pytest.mark.parametrize("method", get_args(Method))
def test_every_method_ran_on_the_files(told, method):
    out, _, _ = told
    said = json.loads((out / method / "result.json").read_text())
    assert said["method"] == method
    assert said["command"]["masks"] == str(out / "input" / "masks")
    assert said["counts"]["rows"] == COUNT
    assert said["seed"] == 1


@pytest.mark.parametrize("method", get_args(Method))
def test_the_printed_scores_are_those_of_the_files(told, method):
    out, lines, _ = told
    labels = np.load(out / method / "labels.npy")
    score = confusion(labels, np.load(out / "input" / "labels.npy"))
    assert numbers(lines, method) == [
        labels.sum(),
        *(pytest.approx(x, abs=5e-4) for x in (score.precision, score.recall, score.f1)),
    ]


def test_every_heldout_view_has_a_score_of_every_contestant(told):
    out, lines, _ = told
    begin = next(k for k, line in enumerate(lines) if line.startswith("F1 of held-out view"))
    *views, _, _ = lines[begin].split()[4:]
    assert views
    for view in views:
        name = f"heldout_{view}"
        assert read_probability(image_path(out / "input" / "truth", name)).any()
    for name, line in zip(("detector alone", *CONTESTANTS), lines[begin + 1 :], strict=False):
        *f1, mean, iou = numbers([line], name)
        assert len(f1) == len(views)
        assert mean == pytest.approx(np.mean(f1), abs=0.011)
        assert iou <= mean


def test_the_story_names_the_regime_and_its_masks_score(told):
    out, lines, _ = told
    story = " ".join(lines[:5])
    assert demo.REGIME in story
    (printed,) = re.findall(r"mean F1 of ([\d.]+)", story)
    scores = []
    for camera in load_cameras(out / "input" / "cameras.json"):
        truth = read_probability(image_path(out / "input" / "truth", camera.name))
        if truth.any():
            said = read_probability(image_path(out / "input" / "masks", camera.name))
            scores.append(f1_score(said, truth))
    assert float(printed) == pytest.approx(np.mean(scores), abs=6e-3)


def test_pictures_are_written_where_the_story_says(told):
    out, lines, _ = told
    told_of = re.findall(rf"{re.escape(str(out))}\S*\.(?:png|html)", "\n".join(lines))
    picture, *reports = told_of
    assert iio.imread(picture)[..., :3].std() > 10, "the picture is empty"
    assert len(reports) == len(demo.RUNS) + 2
    assert all("</html>" in Path(report).read_text(encoding="utf-8") for report in reports)


def test_the_scene_before_the_edit_lies_beside_it(told):
    out, lines, _ = told
    before = np.load(out / "input" / "untouched" / "labels.npy")
    assert not before.any()
    assert len(before) == COUNT - np.load(out / "input" / "labels.npy").sum()
    for name in (demo.ALONE, demo.BOTH):
        said = json.loads((out / f"untouched-{name}" / "result.json").read_text())
        edited = json.loads((out / name / "result.json").read_text())
        (line,) = [line for line in lines if line.startswith(name) and "%" in line]
        assert f"{edited['verdict']:.0%}" in line
        assert f"{said['verdict']:.0%}" in line
        assert line.endswith(f"{said['counts']['tampered']:,}")


def test_nobody_gave_masks_to_the_gaussians(told):
    out, _, _ = told
    said = json.loads((out / demo.ALONE / "result.json").read_text())
    assert said["command"]["masks"] is None
    assert said["native"]["verdict"] == said["verdict"]


def test_the_inverse_projection_finds_all_and_much_else(told):
    _, lines, _ = told
    count, precision, recall, _ = numbers(lines, "inverse projection")
    assert recall > 0.5
    assert precision < 0.5
    assert count < COUNT


def test_progress_tells_every_stage(told):
    assert told[2] >= {"make", "load", "look", "masks", "write"}
