"""Reading scenes and cameras."""

import dataclasses
import json

import imageio.v3 as iio
import numpy as np
import pytest
from cli_case import FIXTURES, refused, run
from strategies import random_scene

from gsc_jax.cli.scene_input import check_names, evenly_spaced
from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.masks import image_path
from gsc_jax.io.ply import save_ply

case, found, own_cache = FIXTURES


@pytest.mark.parametrize(("count", "total"), [(1, 3), (2, 5), (4, 24), (9, 3), (3, 3)])
def test_cameras_are_evenly_spaced(case, count, total):
    cameras = load_cameras(case / "cameras.json")
    many = [dataclasses.replace(cameras[0], name=str(i)) for i in range(total)]
    places = [int(camera.name) for camera in evenly_spaced(many, count)]
    assert len(places) == min(count, total)
    assert places[0] == 0
    gaps = np.diff([*places, total])
    assert gaps.min() >= 1
    assert np.ptp(gaps) <= 1


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (["a\0b"], "cannot name a file"),
        (["x" * 300], "cannot name a file"),
        (["\ud800"], "cannot name a file"),
        (["a", "a.png/b"], "'a.png' would be a file and a folder"),
        (["a.jpg/b/c", "a"], "'a.jpg' would be a file and a folder"),
        (["a/b", "a\\b"], "differ only in slashes"),
    ],
)
@pytest.mark.parametrize("command", ["locate", "render", "tamper"])
def test_names_that_cannot_be_written_are_refused_before_anything_is_computed(
    case, tmp_path, command, names, problem
):
    items = json.loads((case / "cameras.json").read_text())
    items = [item | {"img_name": name} for item, name in zip(items, names, strict=False)]
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps(items))
    message = refused(command, case / "scene.ply", "--cameras", cameras, "--out", tmp_path / "out")
    assert problem in message
    assert str(cameras) in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "size", [{"width": 3}, {"width": 100_000, "height": 90_000}, {"width": 3200, "height": 10}]
)
def test_absurd_sizes_are_blamed_on_the_file(case, tmp_path, size):
    cameras = tmp_path / "cameras.json"
    items = json.loads((case / "cameras.json").read_text())
    cameras.write_text(json.dumps([item | size for item in items]))
    message = refused("render", case / "scene.ply", "--cameras", cameras, "--out", tmp_path / "out")
    assert f"{cameras}: camera " in message
    assert "at least 8 and at most 50,000,000 pixels; correct the size" in message


def test_names_that_differ_in_case_or_share_a_folder_are_accepted(case):
    camera = load_cameras(case / "cameras.json")[0]
    names = ("a", "A", "a.png", "b/a", "b/c", "b")
    check_names([dataclasses.replace(camera, name=name) for name in names])


@pytest.mark.parametrize(("memory", "problem"), [("0", "--memory 0"), ("1e-6", "of memory")])
def test_memory_is_bounded_by_an_option(case, tmp_path, memory, problem):
    arguments = ("locate", case / "scene.ply", "--memory", memory, "--out", tmp_path / "out")
    assert problem in refused(*arguments)


def test_wide_views_are_computed_at_the_width_of_the_trainer(case, tmp_path):
    cameras = tmp_path / "cameras.json"
    items = json.loads((case / "cameras.json").read_text())
    sizes = [{"width": width, "height": 40} for width in (3200, 1600, 64)]
    cameras.write_text(json.dumps([item | size for item, size in zip(items, sizes, strict=True)]))
    for options, shapes in {
        (): ((20, 1600), (40, 1600), (40, 64)),
        ("--scale", 1): ((40, 3200), (40, 1600), (40, 64)),
    }.items():
        out = tmp_path / f"views{len(options)}"
        answer = run("render", case / "scene.ply", "--cameras", cameras, "--out", out, *options)
        told = "1 of 3 cameras are scaled down to a width of 1600 pixels" in answer.err
        assert told == (not options)
        images = [iio.imread(image_path(out, item["img_name"])) for item in items]
        assert tuple(image.shape[:2] for image in images) == shapes


def test_a_scene_that_is_too_large_for_placed_cameras_is_refused_before_any_work(tmp_path):
    scene = random_scene(50)
    far = np.linspace(-9e8, 9e8, 150, dtype=np.float32).reshape(50, 3)
    save_ply(tmp_path / "large.ply", dataclasses.replace(scene, means=far))
    message = refused("locate", tmp_path / "large.ply", "--out", tmp_path / "out")
    assert "large.ply: too large to place cameras around; scale it down" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("factor", [1.0, 0.05, 1e-4])
def test_placed_cameras_see_a_small_scene_behind_the_near_plane(tmp_path, factor):
    scene = random_scene(50)
    log_scales = scene.log_scales + np.float32(np.log(factor))
    small = dataclasses.replace(
        scene, means=scene.means * np.float32(factor), log_scales=log_scales
    )
    save_ply(tmp_path / "scene.ply", small)
    out = tmp_path / "views"
    answer = run("render", tmp_path / "scene.ply", "--views", 3, "--scale", 0.1, "--out", out)
    assert answer.code == 0
    assert "near plane" not in answer.err
    shown = [iio.imread(path).max(axis=-1) > 0 for path in sorted(out.glob("*.png"))]
    assert len(shown) == 3
    assert np.mean(shown) > 0.05
