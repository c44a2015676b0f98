"""Folders of results: read back as they were found, or refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest
from results_folder import BROKEN, COUNT, rewrite_report, write_results
from strategies import random_scene, with_row

from gsc_jax.app.options import Locate
from gsc_jax.app.results import read_results
from gsc_jax.app.run import run_locate
from gsc_jax.errors import InputError
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.masks import image_path, write_mask
from gsc_jax.io.ply import save_ply
from gsc_jax.views import orbit_cameras


@pytest.fixture
def folder(tmp_path) -> Path:
    write_results(tmp_path / "found")
    return tmp_path / "found"


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as refused:
        read_results(folder)
    said = str(refused.value)
    assert "\n" not in said
    assert str(folder) in said
    return said


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A run from some of the cameras, at half their size, on a scene with a broken row."""
    folder = tmp_path_factory.mktemp("run")
    gaussians = with_row(random_scene(200, degree=0), "means", np.nan, row=3)
    save_ply(folder / "scene.ply", gaussians)
    cameras = orbit_cameras(random_scene(200, degree=0), 4, width=64, height=48)
    save_cameras(folder / "cameras.json", cameras)
    for camera in cameras:
        write_mask(image_path(folder / "masks", camera.name), np.eye(48, 64) > 0)
    options = Locate(
        scene=folder / "scene.ply",
        cameras=folder / "cameras.json",
        masks=folder / "masks",
        out=folder / "found",
        method="official",
        views=2,
        scale=0.5,
        no_cache=True,
    )
    return run_locate(options), read_results(folder / "found")


class TestWhatLocateWrote:
    def test_the_scene_and_its_scores_are_those_of_the_run(self, found):
        located, results = found
        np.testing.assert_array_equal(results.gaussians.means, located.scene.gaussians.means)
        np.testing.assert_array_equal(results.rows, located.scene.rows)
        np.testing.assert_array_equal(results.tamper, located.result.tamper)
        np.testing.assert_array_equal(results.labels, located.result.labels)
        assert results.total == len(results.rows) + 1 == 200
        assert results.notes == []

    def test_the_cameras_are_those_looked_from_at_their_size(self, found):
        located, results = found
        assert [c.name for c in results.cameras] == [c.name for c in located.cameras]
        for read, used in zip(results.cameras, located.cameras, strict=True):
            assert (read.width, read.height) == (used.width, used.height) == (32, 24)
            np.testing.assert_allclose(read.viewmat, used.viewmat, atol=1e-6)
            np.testing.assert_allclose(read.K, used.K, rtol=1e-6)
            assert results.mask_path(read.name).is_file()

    def test_labels_are_what_scores_above_the_threshold(self, found):
        _, results = found
        np.testing.assert_array_equal(results.labels, results.tamper > results.threshold)


class TestAFolder:
    def test_rows_that_cannot_be_rendered_are_left_out(self, folder):
        results = read_results(folder)
        expected = np.setdiff1d(np.arange(COUNT), BROKEN)
        np.testing.assert_array_equal(results.rows, expected)
        assert results.total == COUNT
        assert len(results.gaussians) == len(results.tamper) == len(results.labels)
        assert results.tamper.dtype == np.float32
        assert results.labels.dtype == bool

    def test_an_orbit_is_read_from_the_folder_itself(self, folder):
        cameras = write_results(folder)
        save_cameras(folder / "cameras.json", cameras)
        rewrite_report(folder, command={"cameras": None, "scale": 0.5})
        read = read_results(folder).cameras
        assert [(c.name, c.width) for c in read] == [(c.name, c.width) for c in cameras]

    def test_cameras_that_are_gone_leave_a_note(self, folder):
        (folder / "given.json").unlink()
        results = read_results(folder)
        assert results.cameras == []
        assert len(results.notes) == 1
        assert "given.json" in results.notes[0]

    def test_a_camera_that_is_gone_leaves_a_note(self, folder):
        stored = json.loads((folder / "given.json").read_text())
        (folder / "given.json").write_text(json.dumps(stored[1:]))
        results = read_results(folder)
        assert [camera.name for camera in results.cameras] == ["view/1.JPG", "view/2.JPG"]
        assert "lacks 1 of 3 cameras" in results.notes[0]


class TestRefusals:
    def test_no_folder(self, tmp_path):
        assert "no such folder" in refusal(tmp_path / "nothing")

    def test_a_folder_of_something_else(self, tmp_path):
        assert "holds no results of gsc-jax locate" in refusal(tmp_path)

    @pytest.mark.parametrize("text", ["", "{", "[1, 2"])
    def test_a_damaged_report(self, folder, text):
        (folder / "result.json").write_text(text)
        assert "damaged" in refusal(folder)

    @pytest.mark.parametrize("key", ["config", "counts", "command", "per_view"])
    def test_a_report_of_another_version(self, folder, key):
        rewrite_report(folder, **{key: None})
        assert key in refusal(folder)

    def test_a_report_of_another_kind(self, folder):
        (folder / "result.json").write_text("[]")
        assert "version" in refusal(folder)

    @pytest.mark.parametrize("name", ["tamper.ply", "tamper.npy", "labels.npy"])
    def test_a_missing_file(self, folder, name):
        (folder / name).unlink()
        assert name in refusal(folder)

    @pytest.mark.parametrize("content", [b"", b"\x93NUMPY\x01\x00", b"nonsense"])
    def test_a_damaged_array(self, folder, content):
        (folder / "tamper.npy").write_bytes(content)
        assert "tamper.npy" in refusal(folder)

    def test_an_array_of_objects(self, folder):
        np.save(folder / "labels.npy", np.array([None, 1]), allow_pickle=True)
        assert "labels.npy" in refusal(folder)

    def test_scores_of_another_scene(self, folder):
        np.save(folder / "tamper.npy", np.zeros(COUNT - 1, np.float32))
        assert "different runs" in refusal(folder)

    def test_labels_that_are_no_labels(self, folder):
        np.save(folder / "labels.npy", np.zeros(COUNT, np.float32))
        assert "labels.npy" in refusal(folder)

    def test_labels_of_another_run(self, folder):
        np.save(folder / "labels.npy", np.zeros(COUNT, bool))
        assert "different runs" in refusal(folder)
