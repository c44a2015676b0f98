"""`verify` recomputes the digests of results and of their inputs."""

import json

import pytest
from cli_case import refused, run

from gsc_jax.benchmark.scenes import make_room
from gsc_jax.io.ply import save_ply


@pytest.fixture
def found(tmp_path):
    save_ply(tmp_path / "scene.ply", make_room(count=1_500))
    out = tmp_path / "found"
    assert run("locate", tmp_path / "scene.ply", "--out", out, "--views", 3).code == 0
    return out


def test_files_that_changed_or_are_missing_are_named(found):
    answer = run("verify", found)
    assert answer.code == 0
    report = json.loads((found / "result.json").read_text())
    assert f"{len(report['outputs']) - 1} files are as they were written" in answer.out
    assert "inputs   1 are as they were read, 0 not compared" in answer.out
    labels = (found / "labels.npy").read_bytes()
    (found / "labels.npy").write_bytes(labels[:-1] + b"x")
    assert "labels.npy: has changed" in refused("verify", found)
    (found / "labels.npy").unlink()
    overview = (found / "overview.png").read_bytes()
    (found / "overview.png").write_bytes(overview + b"x")
    both = refused("verify", found)
    assert "labels.npy: is missing" in both
    assert "overview.png: has changed" in both
    (found / "overview.png").write_bytes(overview)
    (found / "labels.npy").write_bytes(labels)
    scene = found.parent / "scene.ply"
    scene.write_bytes(scene.read_bytes()[:-1] + b"x")
    assert "scene.ply: has changed" in refused("verify", found)
    scene.unlink()
    assert "is not there and was not compared" in run("verify", found).err


def test_a_folder_without_results_is_refused(tmp_path):
    assert f"{tmp_path}: holds no results" in refused("verify", tmp_path)
    missing = refused("verify", tmp_path / "no")
    assert "is no folder, and holds no results" in missing


def test_a_report_from_elsewhere_reads_no_device_and_raises_nothing(found):
    path = found / "result.json"
    report = json.loads(path.read_text())
    for inputs in ([1], {"/dev/zero": {"sha256": "0"}}, {"/dev/null\0": {}}):
        path.write_text(json.dumps(report | {"inputs": inputs}))
        assert run("verify", found).code == 0
    path.write_text(json.dumps(report | {"inputs": {str(found / "labels.npy"): 3}}))
    assert "has changed" in refused("verify", found)
