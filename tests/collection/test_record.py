"""Rows of a scan as files."""

import os

import pytest

pytest.importorskip("pyarrow", reason="needs the extra `cluster`")

from gsc_jax.cli.outputs import jsonable
from gsc_jax.collection.record import complete, finished_scenes, merge_rows, read_rows, write_row
from gsc_jax.collection.settings import ScanSettings
from gsc_jax.scene import InputError

ROW = complete({"id": "a.ply", "key": "ab12", "configuration": "c" * 64, "path": "a.ply"})


def test_what_a_killed_worker_left_is_neither_read_nor_kept(tmp_path):
    write_row(tmp_path, dict(ROW))
    (whole,) = tmp_path.rglob("*.parquet")
    left = whole.with_name(".5939fa361f06.parquet")
    left.write_bytes(whole.read_bytes()[:100])
    assert [row["id"] for row in read_rows(tmp_path, ROW["configuration"])] == ["a.ply"]
    merge_rows(tmp_path, ROW["configuration"], {"a.ply": "ab12"})
    assert [row["id"] for row in read_rows(tmp_path, ROW["configuration"])] == ["a.ply"]
    assert not left.exists()


def test_a_scene_whose_folder_is_wanted_now_is_not_finished(tmp_path):
    judged = {"scene_probability": 0.5, "labelled": 3}
    rows = {
        "probable": {**judged, "key": "aa"},
        "reported": {**judged, "key": "bb", "report": "x/report.html"},
        "improbable": {**judged, "key": "cc", "scene_probability": 0.1},
        "broken": {"key": "dd", "error_class": "InputError"},
        "late": {"key": "ee", "error_class": "TimeoutError"},
        "copy": {"key": "bb", "duplicate_of": "reported"},
        "copy of probable": {"key": "aa", "duplicate_of": "probable"},
        "labelled": {**judged, "key": "ff", "scene_probability": None},
    }
    for name, row in rows.items():
        write_row(tmp_path, {**ROW, "id": name, **row})
    configuration = ROW["configuration"]
    before = finished_scenes(tmp_path, configuration)
    assert set(before) == {"aa", "bb", "cc", "dd", "ff"}
    after = finished_scenes(tmp_path, configuration, report_above=0.4)
    assert after == {"bb": ["reported", "copy"], "cc": ["improbable"], "dd": ["broken"]}


def test_a_damaged_row_is_named(tmp_path):
    write_row(tmp_path, dict(ROW))
    (whole,) = tmp_path.rglob("*.parquet")
    whole.write_bytes(whole.read_bytes()[:100])
    with pytest.raises(InputError, match="damaged; remove it"):
        list(read_rows(tmp_path, ROW["configuration"]))


def test_names_that_are_not_utf8_and_other_columns_are_written(tmp_path):
    given = jsonable({"id": os.fsdecode(b"a\xff.ply"), "path": os.fsdecode(b"/in/a\xff.ply")})
    row = complete({**given, "year": "2020", "key": "ab", "configuration": "c" * 16})
    write_row(tmp_path, row)
    (found,) = read_rows(tmp_path, "c" * 16)
    assert (found["id"], found["year"]) == ("a\\xff.ply", "2020")


def test_a_configuration_changes_with_the_files_that_a_network_reads(tmp_path):
    model, tensors = tmp_path / "net.onnx", tmp_path / "w.bin"
    model.write_bytes(b"\n\x08location\x12\x05w.bin")
    tensors.write_bytes(b"one")
    settings = ScanSettings(command={"detector": (model,)})
    first = settings.digest()
    tensors.write_bytes(b"two")
    assert settings.digest() != first
