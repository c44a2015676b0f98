"""Reading folders of results, and refusing damaged ones in one line."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from results_folder import BROKEN, COUNT, rewrite_report, write_results
from scipy.spatial.transform import Rotation
from strategies import random_scene, with_row

from gsc_jax.cli.locate import run_locate
from gsc_jax.cli.locate_options import Locate
from gsc_jax.cli.results import read_results
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.masks import image_path, write_mask
from gsc_jax.io.ply import save_ply
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.scene import Camera, InputError


@pytest.fixture
def folder(tmp_path) -> Path:
    write_results(tmp_path / "found")
    return tmp_path / "found"


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as refused:
        read_results(folder)
    message = str(refused.value)
    assert "\n" not in message
    assert str(folder) in message
    return message


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A run with some of the cameras, at half their size, on a scene with a broken row."""
    folder = tmp_path_factory.mktemp("run")
    gaussians = with_row(random_scene(200, degree=0), "means", np.nan, row=3)
    save_ply(folder / "scene.ply", gaussians)
    cameras = orbit_cameras(random_scene(200, degree=0), 4, size=(64, 48))
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


class TestResultsOfLocate:
    def test_the_scene_and_its_scores_are_those_of_the_run(self, found):
        located, results = found
        np.testing.assert_array_equal(results.gaussians.means, located.scene.gaussians.means)
        np.testing.assert_array_equal(results.rows, located.scene.rows)
        np.testing.assert_array_equal(results.tamper, located.result.tamper)
        np.testing.assert_array_equal(results.labels, located.result.labels)
        assert results.total == len(results.rows) + 1 == 200

    def test_the_cameras_are_those_of_the_run_at_its_scale(self, found):
        located, results = found
        assert [c.name for c in results.cameras] == [c.name for c in located.cameras]
        for read, used in zip(results.cameras, located.cameras, strict=True):
            assert (read.width, read.height) == (used.width, used.height) == (32, 24)
            np.testing.assert_allclose(read.viewmat, used.viewmat, atol=1e-6)
            np.testing.assert_allclose(read.K, used.K, rtol=1e-6)
            assert image_path(results.folder / "masks", read.name).is_file()

    def test_labels_are_the_scores_above_the_threshold(self, found):
        _, results = found
        np.testing.assert_array_equal(results.labels, results.tamper > results.threshold)


class TestFolder:
    def test_rows_that_cannot_be_rendered_are_left_out(self, folder):
        results = read_results(folder)
        expected = np.setdiff1d(np.arange(COUNT), BROKEN)
        np.testing.assert_array_equal(results.rows, expected)
        assert results.total == COUNT
        assert len(results.gaussians) == len(results.tamper) == len(results.labels)
        assert results.tamper.dtype == np.float32
        assert results.labels.dtype == bool

    def test_nothing_outside_the_folder_is_read(self, found, tmp_path, monkeypatch):
        """Other cameras of the same names exist at the path in the report."""
        located, results = found
        moved = shutil.copytree(results.folder, tmp_path / "moved")
        others = orbit_cameras(random_scene(200, degree=0), 4, size=(64, 48), seed=1)
        save_cameras(tmp_path / "cameras.json", others)
        rewrite_report(moved, command=results.report["command"] | {"cameras": "cameras.json"})
        monkeypatch.chdir(tmp_path)
        for read, used in zip(read_results("moved").cameras, located.cameras, strict=True):
            np.testing.assert_allclose(read.viewmat, used.viewmat, atol=1e-6)

    def test_cameras_keep_their_principal_point_and_a_rotation_that_was_rounded(self, tmp_path):
        """Three decimals, as some files have, and far from the origin."""
        turned = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix().round(3)
        viewmat = np.eye(4, dtype=np.float32)
        viewmat[:3, :3], viewmat[:3, 3] = turned, (100, -50, 20)
        K = np.array([[61.5, 0, 17.25], [0, 60, 12.75], [0, 0, 1]], np.float32)
        camera = Camera(viewmat=viewmat, K=K, width=32, height=24, name="a/ü.JPG")
        save_cameras(tmp_path / "views.json", [camera])
        (read,) = load_cameras(tmp_path / "views.json")
        np.testing.assert_allclose(read.viewmat, viewmat, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(read.K, K)
        assert (read.width, read.height, read.name) == (32, 24, "a/ü.JPG")


class TestRefusals:
    def test_no_folder(self, tmp_path):
        assert "no such folder" in refusal(tmp_path / "nothing")

    def test_a_folder_of_something_else(self, tmp_path):
        assert "holds no results of gsc-jax locate" in refusal(tmp_path)

    @pytest.mark.parametrize("text", ["", "{", "[1, 2"])
    def test_a_damaged_report(self, folder, text):
        (folder / "result.json").write_text(text)
        assert "damaged" in refusal(folder)

    @pytest.mark.parametrize("key", ["config", "counts", "per_view"])
    def test_a_report_of_another_version(self, folder, key):
        rewrite_report(folder, **{key: None})
        assert key in refusal(folder)

    @pytest.mark.parametrize("name", ["tamper.ply", "tamper.npy", "labels.npy", "views.json"])
    def test_a_missing_file(self, folder, name):
        (folder / name).unlink()
        assert f"{folder / name}: no such file" in refusal(folder)

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

    def test_labels_of_another_type(self, folder):
        np.save(folder / "labels.npy", np.zeros(COUNT, np.float32))
        assert "labels.npy" in refusal(folder)

    @pytest.mark.parametrize("change", [{"img_name": "other"}, {"width": 81}])
    def test_cameras_of_another_run(self, folder, change):
        stored = json.loads((folder / "views.json").read_text())
        (folder / "views.json").write_text(json.dumps([stored[0] | change, *stored[1:]]))
        assert "different runs" in refusal(folder)
        (folder / "views.json").write_text(json.dumps(stored[1:]))
        assert "different runs" in refusal(folder)

    def test_labels_of_another_run(self, folder):
        np.save(folder / "labels.npy", np.zeros(COUNT, bool))
        assert "different runs" in refusal(folder)
