"""`check` finds what is wrong with a file, and says what viewers make of it."""

import dataclasses
import json

import numpy as np
import pytest
from cli_case import refused, run
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.recfunctions import merge_arrays
from plyfile import PlyData, PlyElement
from web_files import WRITERS

from gsc_jax.benchmark.scenes import make_room
from gsc_jax.cli.check import layout_problems, row_problems
from gsc_jax.io.layout import encode
from gsc_jax.io.ply import read_ply, save_ply
from gsc_jax.scene import Gaussians

ROOM = make_room(count=400)
HARMLESS = {"rotations", "invisible"}
"""Notes about the made room: quaternions of any length, and a few faint Gaussians."""


def written(path, gaussians: Gaussians = ROOM):
    """The file of some Gaussians, with invalid ones."""
    encode(gaussians).write(path)
    return path


def names(scene) -> dict[str, int]:
    """Rows of each problem by name."""
    return {p.name: p.rows for p in [*layout_problems(scene.ply), *row_problems(scene)]}


def changed(**columns) -> Gaussians:
    """The room with other values in the first rows."""
    fields = {}
    for name, values in columns.items():
        fields[name] = np.array(getattr(ROOM, name))
        fields[name][: len(values)] = values
    return dataclasses.replace(ROOM, **fields)


def test_a_sound_file_has_no_warnings(tmp_path):
    answer = run("check", written(tmp_path / "scene.ply"))
    assert (answer.code, answer.err) == (0, "")
    first, form, *notes = answer.out.splitlines()
    assert first.startswith(f"{tmp_path / 'scene.ply'}: can be used; 0 warnings")
    assert form == "format   binary little endian .ply, 400 rows, degree 1"
    assert all(line.startswith("note ") for line in notes)


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("position not finite", {"means": [[np.nan] * 3]}),
        ("scale too large (is it in log space?)", {"log_scales": [[99.0] * 3]}),
        ("rotation zero", {"quats": [[0.0] * 4]}),
        ("opacity not a number", {"logit_opacities": [np.nan]}),
        ("colour not finite", {"sh": [np.full((4, 3), np.inf)]}),
        ("far", {"means": [[1e5, 0, 0]]}),
        ("huge", {"log_scales": [[9.0, 0, 0]]}),
        ("flat", {"log_scales": [[-40.0] * 3]}),
        ("needles", {"log_scales": [[-1.0, -20, -20]]}),
        ("colours", {"sh": [np.full((4, 3), 200.0)]}),
        ("invisible", {"logit_opacities": [-9.0] * 1}),
    ],
)
def test_each_problem_of_a_row_is_found_and_counted(tmp_path, name, columns):
    before = names(read_ply(written(tmp_path / "before.ply"))).get(name, 0)
    scene = read_ply(written(tmp_path / "after.ply", changed(**columns)))
    found = names(scene)
    assert found.pop(name) == before + 1
    assert set(found) <= HARMLESS


def test_copies_count_once_less_than_they_occur(tmp_path):
    rows = np.array([7, 7, 7, *range(400)])
    assert names(read_ply(written(tmp_path / "scene.ply", ROOM.take(rows))))["copies"] == 3


def test_activated_values_are_recognised(tmp_path):
    scales = np.exp(np.asarray(ROOM.log_scales)) + 1
    linear = dataclasses.replace(ROOM, log_scales=scales)
    assert "linear scales" in names(read_ply(written(tmp_path / "scales.ply", linear)))
    shares = 1 / (1 + np.exp(-np.asarray(ROOM.logit_opacities)))
    linear = dataclasses.replace(ROOM, logit_opacities=shares)
    assert "linear opacities" in names(read_ply(written(tmp_path / "opacities.ply", linear)))


def test_unusual_layouts_are_reported(tmp_path):
    ply, path = encode(ROOM), tmp_path / "scene.ply"

    def found(vertex: np.ndarray, **options) -> set[str]:
        PlyData([PlyElement.describe(vertex, "vertex")], **options).write(path)
        return set(names(read_ply(path))) - HARMLESS

    data = ply["vertex"].data
    columns = list(data.dtype.names)
    assert found(data, text=True) == {"encoding"}
    assert found(data, byte_order=">") == {"encoding"}
    assert found(data[columns[::-1]].astype([(n, "<f4") for n in columns[::-1]])) == {"order"}
    without = [name for name in columns if name not in ("nx", "ny", "nz")]
    assert found(data[without].astype([(name, "<f4") for name in without])) == {"normals"}
    discs = [name for name in columns if name != "scale_2"]
    assert found(data[discs].astype([(name, "<f4") for name in discs])) == {"discs"}
    double = [(name, "<f8" if name == "x" else "<f4") for name in columns]
    assert found(data.astype(double)) == {"types"}
    masked = np.zeros(len(data), [*[(name, "<f4") for name in columns[:3]], ("mask", "u1")])
    for name in columns[:3]:
        masked[name] = data[name]
    rest = merge_arrays([masked, data[columns[3:]]], flatten=True)
    assert found(rest) == {"unknown", "order"}


@pytest.mark.parametrize("order", ["<", ">"])
def test_bytes_after_the_last_row_are_counted(tmp_path, order):
    ply = encode(ROOM)
    ply.byte_order = order
    ply.comments = ["end_header is here"]
    ply.write(path := tmp_path / "scene.ply")
    assert "after the last row" not in run("check", path).out
    path.write_bytes(path.read_bytes() + bytes(1234))
    assert "warning  1,234 bytes after the last row" in run("check", path).out
    faces = np.zeros(3, [("vertex_indices", "i4", (3,))])
    PlyData([*ply.elements, PlyElement.describe(faces, "face")], byte_order=order).write(path)
    assert "after the last row" not in run("check", path).out


def test_json_has_the_same_problems(tmp_path):
    path = written(tmp_path / "scene.ply", changed(means=[[np.nan] * 3]))
    answer = run("check", path, "--json")
    report = json.loads(answer.out)
    assert (answer.code, answer.err) == (0, "")
    assert (report["usable"], report["rows"], report["gaussians"]) == (True, 400, 399)
    (nan,) = [p for p in report["problems"] if p["level"] == "warning"]
    assert (nan["name"], nan["rows"]) == ("position not finite", 1)
    assert f"warning  1 row: {nan['text']}" in run("check", path).out


def test_an_unusable_file_ends_with_code_2_and_the_reason(tmp_path):
    path = tmp_path / "scene.ply"
    path.write_bytes(b"no model")
    assert "not a PLY file" in refused("check", path)
    answer = run("check", path, "--json")
    report = json.loads(answer.out)
    assert (answer.code, report["usable"], report["problems"]) == (2, False, [])
    assert set(report) == set(json.loads(run("check", written(tmp_path / "s.ply"), "--json").out))
    assert run("check", tmp_path / "s.ply", "--json", "--memory", -1).out == ""
    assert report["error"] in answer.err
    assert "no such file" in refused("check", tmp_path / "missing.ply")


def test_labels_of_locate_are_an_unknown_property(tmp_path):
    save_ply(tmp_path / "scene.ply", ROOM, tamper=np.zeros(400))
    assert "more properties (tamper)" in run("check", tmp_path / "scene.ply").out


@pytest.mark.parametrize("suffix", WRITERS)
def test_other_formats_are_named(tmp_path, suffix):
    answer = run("check", WRITERS[suffix](tmp_path / f"scene{suffix}", ROOM.take(np.arange(50))))
    assert answer.code == 0
    assert f"format   {suffix}, 50 rows" in answer.out


def test_a_comment_is_no_compression(tmp_path):
    ply = encode(ROOM)
    ply.comments = ["packed_position"]
    ply.write(tmp_path / "scene.ply")
    assert "format   binary little endian .ply" in run("check", tmp_path / "scene.ply").out


@pytest.mark.parametrize("rows", [[0], [0] * 50])
def test_a_scene_without_extent_is_not_larger_than_itself(tmp_path, rows):
    found = names(read_ply(written(tmp_path / "scene.ply", ROOM.take(np.array(rows)))))
    assert set(found) <= {*HARMLESS, "copies"}


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_any_numbers_give_counts_within_the_file(tmp_path_factory, rows, seed):
    rng = np.random.default_rng(seed)
    wild = np.array([0, 1, -1, 1e-30, 1e30, -1e30, np.inf, -np.inf, np.nan], np.float32)
    scene = ROOM.take(np.arange(rows))
    fields = {name: rng.choice(wild, np.shape(values)) for name, values in vars(scene).items()}
    mixed = {
        name: np.where(rng.random(np.shape(values)) < 0.2, fields[name], values)
        for name, values in vars(scene).items()
    }
    path = written(tmp_path_factory.mktemp("wild") / "scene.ply", Gaussians(**mixed))
    answer = run("check", path, "--json")
    report = json.loads(answer.out)
    assert answer.code == (0 if report["usable"] else 2)
    assert all(0 <= problem["rows"] <= rows for problem in report["problems"])
