"""A scene is the same after it was written and read, in every layout of .ply."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from data import DATA, needs_data
from hypothesis import given, settings
from hypothesis import strategies as st
from ply_files import assert_same, columns_of, write_columns
from plyfile import PlyData, PlyElement
from strategies import random_scene

from gsc_jax.io.layout import NORMAL, ROTATION
from gsc_jax.io.ply import load_ply, read_ply, save_ply, save_tampered
from gsc_jax.scene import InputError, parallel

SCENE = random_scene(7)
SMALL = columns_of(random_scene(7, degree=0))
quick = settings(deadline=None, max_examples=30)


@quick
@given(
    degree=st.integers(0, 3),
    kind=st.sampled_from(["f4", "f8"]),
    layout=st.sampled_from([{"text": True}, {"byte_order": "<"}, {"byte_order": ">"}]),
    normals=st.booleans(),
    shuffle=st.randoms(use_true_random=False),
)
def test_order_type_and_encoding_of_properties_are_irrelevant(
    tmp_path_factory, degree, kind, layout, normals, shuffle
):
    expected = random_scene(7, degree=degree)
    columns = {name: column.astype(kind) for name, column in columns_of(expected).items()}
    columns |= {"red": np.arange(7, dtype=np.uint8), "id": np.arange(7, dtype=np.int32)}
    names = [name for name in columns if normals or name not in NORMAL]
    shuffle.shuffle(names)
    path = tmp_path_factory.mktemp("any") / "scene.ply"
    write_columns(path, {name: columns[name] for name in names}, **layout)

    scene = read_ply(path)
    assert_same(scene.gaussians, expected)
    assert (scene.total, scene.dropped, scene.rows.dtype) == (7, {}, np.int64)

    save_tampered(path, scene, np.linspace(0, 1, 7))  # replaces the file that was read
    written = PlyData.read(path)
    assert (written.text, written.byte_order) == (False, "<")
    written = written["vertex"]
    assert [prop.name for prop in written.properties] == [*names, "tamper"]
    for name in names:
        np.testing.assert_array_equal(written[name], columns[name])
        assert written[name].dtype.newbyteorder("=") == columns[name].dtype
    np.testing.assert_array_equal(written["tamper"], np.linspace(0, 1, 7, dtype=np.float32))


@quick
@given(n=st.sampled_from([1, 2, 40]), degree=st.integers(0, 3), seed=st.integers(0, 9))
def test_saving_and_loading_is_the_identity(tmp_path_factory, n, degree, seed):
    path = tmp_path_factory.mktemp("save") / "scene.ply"
    expected = random_scene(n, degree=degree, seed=seed)
    save_ply(path, expected)
    assert_same(load_ply(path), expected)
    first = path.read_bytes()
    save_ply(path, load_ply(path))
    assert path.read_bytes() == first


@needs_data
@pytest.mark.parametrize(("name", "count"), [("kitchen", 213_944), ("playbot", 125_000)])
def test_real_scenes_survive_byte_for_byte(tmp_path, name, count):
    original = DATA / "scenes" / f"{name}.ply"
    scene = read_ply(original)
    assert (scene.total, scene.dropped) == (count, {})
    save_ply(tmp_path / "same.ply", scene.gaussians)
    assert (tmp_path / "same.ply").read_bytes() == original.read_bytes()


def test_other_elements_lists_and_comments_are_kept(tmp_path):
    columns = columns_of(random_scene(3))
    data = np.empty(3, [*((name, "f4") for name in columns), ("links", "O")])
    for name, column in columns.items():
        data[name] = column
    data["links"] = [np.array([1, 2], "u2"), np.array([], "u2"), np.array([7], "u2")]
    vertex = PlyElement.describe(
        data, "vertex", len_types={"links": "u4"}, val_types={"links": "u2"}, comments=["mine"]
    )
    empty = PlyElement.describe(np.empty(0, [("i", "i4")]), "nothing")
    extra = PlyElement.describe(np.array([(5, 2.5)], [("i", "u1"), ("d", "f8")]), "camera")
    path = tmp_path / "rich.ply"
    ply = PlyData([extra, vertex, empty], byte_order="<", comments=["top"], obj_info=["info"])
    ply.write(str(path))

    save_tampered(path, read_ply(path), np.ones(3))
    written = PlyData.read(path)
    before, after = ply.header.splitlines(), written.header.splitlines()
    before.insert(before.index("element nothing 0"), "property float tamper")
    assert after == before
    assert [row.tolist() for row in written["vertex"]["links"]] == [[1, 2], [], [7]]
    assert written["camera"].data.tolist() == [(5, 2.5)]


@pytest.mark.parametrize("layout", [{"text": True}, {"byte_order": "<"}, {"byte_order": ">"}])
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
@pytest.mark.parametrize(
    ("comment", "escaped"),
    [
        ("end_header by Zo\u00eb".encode(), r"end_header by Zo\xeb"),
        ("\u573a".encode("gbk"), r"\xb3\xa1"),
    ],
)
def test_comments_in_any_encoding_are_kept_in_ascii(
    tmp_path, monkeypatch, layout, end, comment, escaped
):
    columns = columns_of(random_scene(300, seed=1))
    path = write_columns(tmp_path / "scene.ply", columns, comments=["by"], **layout)
    expected = read_ply(path)
    header, mark, rows = path.read_bytes().partition(b"end_header\n")
    header = (header + mark).replace(b"comment by\n", b"comment " + comment + b"\n")
    path.write_bytes(header.replace(b"\n", end) + rows)
    with monkeypatch.context() as patch:  # value by value, 140 times as slow
        patch.setattr(PlyElement, "_read_bin", lambda *_: pytest.fail("not mapped"))
        scene = read_ply(path)
    assert_same(scene.gaussians, expected.gaussians)
    save_tampered(path, scene, np.zeros(300))
    assert PlyData.read(path).comments == [escaped]


def test_a_header_with_letters_may_be_followed_by_lists(tmp_path):
    path = write_columns(tmp_path / "scene.ply", SMALL, comments=["by"])
    faces = b"element face 2\nproperty list uchar int ids\nend_header\n"
    content = path.read_bytes().replace(b"end_header\n", faces).replace(b"by", "\u00eb".encode())
    path.write_bytes(content + b"\x01\xe9\x00\x00\x00\x00")
    faces = read_ply(path).ply["face"].data["ids"]
    assert [list(face) for face in faces] == [[0xE9], []]


def test_writing_in_blocks_changes_nothing(tmp_path, monkeypatch):
    gaussians, scores = random_scene(20, degree=2), np.linspace(0, 1, 20)
    for name in ("whole", "blocks"):
        save_ply(tmp_path / f"{name}.ply", gaussians, tamper=scores)
        save_tampered(tmp_path / f"{name}-again.ply", read_ply(tmp_path / "whole.ply"), 1 - scores)
        monkeypatch.setattr(parallel, "BLOCK", 7)
    for end in ("", "-again"):
        whole, parts = (tmp_path / f"{name}{end}.ply" for name in ("whole", "blocks"))
        assert whole.read_bytes() == parts.read_bytes()


def test_an_existing_tamper_is_replaced_and_moved_last(tmp_path):
    columns = {"tamper": np.full(7, 9.0)} | columns_of(SCENE)
    path = write_columns(tmp_path / "again.ply", columns, text=True)
    save_tampered(path, read_ply(path), np.arange(7))
    written = PlyData.read(path)["vertex"]
    assert [prop.name for prop in written.properties] == [*columns_of(SCENE), "tamper"]
    assert written["tamper"].tolist() == list(range(7))


def write_invalid_rows(folder: Path) -> Path:
    columns = {name: column.copy() for name, column in columns_of(random_scene(9)).items()}
    columns["x"][1] = np.nan
    columns["opacity"][1] = np.nan  # counted under its first reason only
    for name in ROTATION:
        columns[name][3] = 0
    columns["scale_1"][4] = 80
    columns["opacity"][[5, 6, 7]] = [np.inf, -np.inf, np.nan]
    return write_columns(folder / "invalid.ply", columns)


def test_rows_that_cannot_be_rendered_are_counted_once_and_kept(tmp_path):
    path = write_invalid_rows(tmp_path)
    scene = read_ply(path)
    assert scene.dropped == {
        "position not finite": 1,
        "scale too large (is it in log space?)": 1,
        "rotation zero": 1,
        "opacity not a number": 1,
    }
    assert scene.rows.tolist() == [0, 2, 5, 6, 8]
    assert len(scene.gaussians) == 5
    before = scene.ply["vertex"].data.copy()
    save_tampered(path, scene, np.full(5, 0.5))
    after = PlyData.read(path)["vertex"]
    assert after["tamper"].tolist() == [0.5, 0, 0.5, 0, 0, 0.5, 0.5, 0, 0.5]
    for name in before.dtype.names:
        np.testing.assert_array_equal(after[name], before[name])


def test_loading_warns_in_one_line(tmp_path):
    path = write_invalid_rows(tmp_path)
    with pytest.warns(UserWarning, match=r"invalid\.ply: left out 4 of 9 Gaussians \(.*\)$"):
        gaussians = load_ply(path)
    assert len(gaussians) == 5
    with pytest.warns(UserWarning, match="left out") as caught:
        load_ply(path)
    assert [warning.filename for warning in caught] == [__file__], "names the line of the caller"


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("lists", [False, True])
def test_names_with_a_colon_are_kept(tmp_path, text, lists):
    """The library plyfile itself cannot write them."""
    path, names = tmp_path / "scene.ply", ["sem:class", *SMALL]
    content = write_columns(path, {"sem_class": np.arange(7, dtype=np.uint8), **SMALL}, text=text)
    content = content.read_bytes().replace(b"sem_class", b"sem:class")
    if lists:
        faces = b"element face 1\nproperty list uchar int ids\nend_header\n"
        body = (
            b"2 4 5\n"
            if text
            else np.array([2], "u1").tobytes() + np.array([4, 5], "<i4").tobytes()
        )
        content = content.replace(b"end_header\n", faces) + body
    path.write_bytes(content)
    save_tampered(path, read_ply(path), np.linspace(0, 1, 7))
    scene = read_ply(path)
    vertex = scene.ply["vertex"]
    assert [prop.name for prop in vertex.properties] == [*names, "tamper"]
    np.testing.assert_array_equal(vertex["sem:class"], np.arange(7))
    np.testing.assert_array_equal(vertex["tamper"], np.linspace(0, 1, 7, dtype=np.float32))
    assert_same(scene.gaussians, random_scene(7, degree=0))
    if lists:
        assert scene.ply["face"]["ids"][0].tolist() == [4, 5]


@pytest.mark.parametrize(
    "scene",
    [
        dataclasses.replace(SCENE, sh=SCENE.sh[:, :2]),
        dataclasses.replace(SCENE, means=np.full((7, 3), np.nan, np.float32)),
        SCENE.take(np.arange(0)),
    ],
)
def test_scenes_that_could_not_be_read_again_are_not_written(tmp_path, scene):
    with pytest.raises(InputError, match=r"new\.ply: not written: expected Gaussians"):
        save_ply(tmp_path / "new.ply", scene)
    assert not list(tmp_path.iterdir())


SCORES = np.zeros(len(SCENE), np.float32)


@pytest.mark.parametrize(
    "scores",
    [SCORES + np.nan, SCORES - np.inf, SCORES[1:], SCORES[None], [1e300] * 7, ["a"] * 7],
)
def test_scores_that_are_not_one_number_per_gaussian_are_not_written(tmp_path, scores):
    save_ply(tmp_path / "old.ply", SCENE)
    for save in (
        lambda path: save_ply(path, SCENE, tamper=scores),
        lambda path: save_tampered(path, read_ply(tmp_path / "old.ply"), scores),
    ):
        with pytest.raises(InputError, match=r"new\.ply: not written: expected 7 finite scores"):
            save(tmp_path / "new.ply")
    assert [path.name for path in tmp_path.iterdir()] == ["old.ply"]


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_signalling_nans_are_left_out_without_a_warning(tmp_path, kind):
    bits = {"f4": np.uint32(0x7F800001), "f8": np.uint64(0x7FF0000000000001)}[kind]
    for name in SMALL.keys() - set(NORMAL):
        column = SMALL[name].astype(kind)
        column.view(bits.dtype)[2] = bits
        scene = read_ply(write_columns(tmp_path / "scene.ply", SMALL | {name: column}))
        assert (sum(scene.dropped.values()), len(scene.rows)) == (1, 6), name


def test_values_of_any_shape_are_distributed_to_the_rows_of_the_file(tmp_path):
    columns = {name: column.copy() for name, column in SMALL.items()}
    columns["x"][[1, 4]] = np.nan
    scene = read_ply(write_columns(tmp_path / "scene.ply", columns))
    values = np.arange(10).reshape(5, 2)
    expanded = scene.expand(values)
    assert expanded[[0, 2, 3, 5, 6]].tolist() == values.tolist()
    assert expanded[[1, 4]].tolist() == [[0, 0], [0, 0]]
    for count in (4, 6):
        with pytest.raises(ValueError, match="expected 5 values"):
            scene.expand(np.zeros(count))


def test_a_scene_does_not_change_with_its_file(tmp_path):
    path = write_columns(tmp_path / "scene.ply", SMALL)
    scene = read_ply(path)
    content = path.read_bytes()
    with path.open("r+b") as file:
        file.seek(content.index(b"end_header"))
        file.write(bytes(len(content) - content.index(b"end_header")))
    np.testing.assert_array_equal(scene.ply["vertex"]["x"], SMALL["x"])
    assert_same(scene.gaussians, random_scene(7, degree=0))
