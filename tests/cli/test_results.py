"""Reading folders of results, and refusing damaged ones in one line."""

import json
import shutil
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from results_folder import BROKEN, COUNT, rewrite_report, write_results
from strategies import random_scene, with_row

from gsc_jax.cli.locate import run_locate
from gsc_jax.cli.options import Locate
from gsc_jax.cli.results import read_results
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.masks import image_path, write_mask
from gsc_jax.io.ply import read_ply, save_ply, save_tampered
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.scene import InputError

NPY = b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f4', 'fortran_order': False, 'shape': %-62b}\n"


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
    return run_locate(options, monitor=Monitor()), read_results(folder / "found")


class TestResultsOfLocate:
    def test_the_scene_and_its_scores_are_those_of_the_run(self, found):
        located, results = found
        np.testing.assert_array_equal(results.scene.gaussians.means, located.scene.gaussians.means)
        np.testing.assert_array_equal(results.scene.rows, located.scene.rows)
        np.testing.assert_array_equal(results.tamper, located.result.tamper)
        np.testing.assert_array_equal(results.labels, located.result.labels)
        threshold = results.report["config"]["threshold"]
        np.testing.assert_array_equal(results.labels, results.tamper > threshold)
        assert results.scene.total == len(results.scene.rows) + 1 == 200

    def test_the_cameras_are_those_of_the_run_at_its_scale(self, found):
        located, results = found
        assert [c.name for c in results.cameras] == [c.name for c in located.cameras]
        for read, used in zip(results.cameras, located.cameras, strict=True):
            assert (read.width, read.height) == (used.width, used.height) == (32, 24)
            np.testing.assert_allclose(read.viewmat, used.viewmat, atol=1e-6)
            np.testing.assert_allclose(read.K, used.K, rtol=1e-6)
            assert image_path(results.folder / "masks", read.name).is_file()


class TestFolder:
    def test_rows_that_cannot_be_rendered_are_left_out(self, folder):
        results = read_results(folder)
        expected = np.setdiff1d(np.arange(COUNT), BROKEN)
        np.testing.assert_array_equal(results.scene.rows, expected)
        assert results.scene.total == COUNT
        assert len(results.scene.gaussians) == len(results.tamper) == len(results.labels)
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


class TestRefusals:
    def test_folders_without_results(self, tmp_path):
        assert "no such folder" in refusal(tmp_path / "nothing")
        (tmp_path / "file").write_text("")
        assert "is a file, not a folder" in refusal(tmp_path / "file")
        assert "holds no results of gsc-jax locate" in refusal(tmp_path)

    @pytest.mark.parametrize("text", ["", "{", "[1, 2", "3", "[1]"])
    def test_a_damaged_report(self, folder, text):
        (folder / "result.json").write_text(text)
        assert refusal(folder).startswith(f"{folder / 'result.json'}: ")

    def test_cameras_whose_sizes_are_those_of_images_anywhere(self, folder, tmp_path):
        iio.imwrite(tmp_path / "image.png", np.zeros((8, 8), np.uint8))
        frame = {"file_path": f"{tmp_path}/image.png", "transform_matrix": np.eye(4).tolist()}
        (folder / "views.json").write_text(json.dumps({"frames": [frame], "fl_x": 8}))
        assert "views.json: expected a list of cameras" in refusal(folder)

    def test_a_list_instead_of_a_report(self, folder):
        (folder / "result.json").write_text("[1]")
        assert "result.json: expected an object with keys, found [1]; run" in refusal(folder)

    @pytest.mark.parametrize("value", [None, {}, [{}], 3, {"tampered": "many", "gaussians": 1}])
    @pytest.mark.parametrize("key", ["config", "counts", "per_view"])
    def test_a_report_of_another_version(self, folder, key, value):
        rewrite_report(folder, **{key: value})
        assert f"result.json: {key}" in refusal(folder).replace("'", "")

    @pytest.mark.parametrize(
        "changes",
        [
            {"verdict": "0.9"},
            {"verdict": -0.1},
            {"verdict": True},
            {"verdict": float("inf")},
            {"tampered_share_of_views": 1.5},
            {"counts": {"tampered": -1, "gaussians": 1}},
            {"counts": {"tampered": "1", "gaussians": 1}},
            {"config": {"threshold": float("nan"), "near": 0.2}},
            {"config": {"threshold": 0.5, "near": 0}},
            {"config": {"threshold": 5, "near": 0.2}},
            {"config": {"threshold": 1, "near": 0.2}},
            {"config": {"threshold": -1e308, "near": 0.2}},
            {"config": {"threshold": 0.5, "near": 1e308}},
            {"config": {"threshold": 0.5, "near": 1e-308}},
            {"config": {"threshold": 0.5, "near": "0.2"}},
            {"per_view": [{"name": 1, "width": 80, "height": 60}]},
        ],
    )
    def test_values_that_no_run_writes(self, folder, changes):
        rewrite_report(folder, **changes)
        assert refusal(folder).startswith(f"{folder / 'result.json'}: {next(iter(changes))}")

    def test_counts_of_another_run(self, folder):
        rewrite_report(folder, counts={"tampered": 500, "gaussians": 0})
        assert "tamper.ply: result.json is of a different run" in refusal(folder)

    def test_scores_of_another_run_of_as_many_rows(self, folder):
        scene, scores = read_ply(folder / "tamper.ply"), np.load(folder / "tamper.npy")
        save_tampered(folder / "tamper.ply", scene, scores[scene.rows][::-1])
        assert "tamper.ply: result.json is of a different run" in refusal(folder)
        shutil.copy(folder / "scene.ply", folder / "tamper.ply")
        assert "tamper.ply: result.json is of a different run" in refusal(folder)

    @pytest.mark.parametrize("changes", [{"judged_views": -1}, {"attributes": {"traces": [1]}}])
    def test_facts_that_the_viewer_states(self, folder, changes):
        rewrite_report(folder, **changes)
        assert refusal(folder).startswith(f"{folder / 'result.json'}: {next(iter(changes))}")

    @pytest.mark.parametrize("score", [np.nan, -0.1, 1e300])
    def test_scores_that_are_no_probabilities(self, folder, score):
        np.save(folder / "tamper.npy", np.full(COUNT, score))
        assert "tamper.npy: holds numbers outside [0, 1]" in refusal(folder)

    @pytest.mark.parametrize("name", ["tamper.ply", "tamper.npy", "labels.npy", "views.json"])
    def test_a_missing_file(self, folder, name):
        (folder / name).unlink()
        assert f"{folder / name}: no such file" in refusal(folder)

    @pytest.mark.parametrize(
        "content",
        [
            *(b"", b"\x93NUMPY\x01\x00", b"nonsense", b"PK\x03\x04 not a zip", b"PK\x05\x06"),
            *(NPY % shape for shape in (b"(9999999999999,)", b"(9**99,)", b"(", b"(-1,)")),
        ],
    )
    def test_a_damaged_array(self, folder, content):
        (folder / "tamper.npy").write_bytes(content)
        assert "tamper.npy" in refusal(folder)

    @pytest.mark.parametrize(
        "values", [np.array([None, 1]), np.zeros(COUNT - 1, np.float32), np.zeros(COUNT, bool)]
    )
    def test_labels_of_another_run(self, folder, values):
        np.save(folder / "labels.npy", values, allow_pickle=True)
        assert f"{folder / 'labels.npy'}: " in refusal(folder)

    @pytest.mark.parametrize("change", [{"img_name": "other"}, {"width": 81}])
    def test_cameras_of_another_run(self, folder, change):
        stored = json.loads((folder / "views.json").read_text())
        for cameras in ([stored[0] | change, *stored[1:]], stored[1:]):
            (folder / "views.json").write_text(json.dumps(cameras))
            assert "different run" in refusal(folder)
