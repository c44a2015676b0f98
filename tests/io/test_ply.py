"""Scenes survive every layout that exporters write, and bad files are named, not guessed at."""

import builtins
import contextlib
import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement

from gsc_jax.io.files import atomic
from gsc_jax.io.layout import DC, FLAT_LOG_SCALE, NORMAL, POSITION, ROTATION, SCALE
from gsc_jax.io.ply import load_ply, read_ply, save_highlight, save_ply, save_tampered
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians, InputError

FIELDS = ("means", "log_scales", "quats", "logit_opacities", "sh")
SCENES = Path(__file__).parents[2] / "../shared/data/scenes"
needs_scenes = pytest.mark.skipif(not SCENES.is_dir(), reason="needs the scenes of ../shared/data")
quick = settings(deadline=None, max_examples=30)


def random_gaussians(n: int = 7, *, degree: int = 1, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    draw = lambda *shape: rng.standard_normal(shape).astype(np.float32)  # noqa: E731
    return Gaussians(
        means=draw(n, 3),
        log_scales=draw(n, 3) - 3,
        quats=draw(n, 4),
        logit_opacities=draw(n),
        sh=draw(n, (degree + 1) ** 2, 3),
    )


def table_of(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Columns by property name, from the definition: f_rest_* runs over red, green, blue."""
    sh = np.asarray(gaussians.sh)
    columns = dict(zip(POSITION, np.asarray(gaussians.means).T, strict=True))
    columns |= dict.fromkeys(NORMAL, np.zeros(len(sh), np.float32))
    columns |= dict(zip(DC, sh[:, 0].T, strict=True))
    rest = [sh[:, k, channel] for channel in range(3) for k in range(1, sh.shape[1])]
    columns |= {f"f_rest_{i}": column for i, column in enumerate(rest)}
    columns |= {"opacity": np.asarray(gaussians.logit_opacities)}
    columns |= dict(zip(SCALE, np.asarray(gaussians.log_scales).T, strict=True))
    return columns | dict(zip(ROTATION, np.asarray(gaussians.quats).T, strict=True))


def element_of(columns: dict[str, np.ndarray]) -> PlyElement:
    data = np.empty(len(columns["x"]), [(name, col.dtype) for name, col in columns.items()])
    for name, column in columns.items():
        data[name] = column
    return PlyElement.describe(data, "vertex")


def write_columns(path: Path, columns: dict[str, np.ndarray], **layout) -> Path:
    PlyData([element_of(columns)], **layout).write(str(path))
    return path


def assert_same(actual: Gaussians, expected: Gaussians) -> None:
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(actual, field), getattr(expected, field))


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ply")


@quick
@given(
    degree=st.integers(0, 3),
    kind=st.sampled_from(["f4", "f8"]),
    layout=st.sampled_from([{"text": True}, {"byte_order": "<"}, {"byte_order": ">"}]),
    normals=st.booleans(),
    shuffle=st.randoms(use_true_random=False),
)
def test_layout_does_not_matter(tmp_path_factory, degree, kind, layout, normals, shuffle):
    expected = random_gaussians(degree=degree)
    columns = {name: column.astype(kind) for name, column in table_of(expected).items()}
    columns |= {"red": np.arange(7, dtype=np.uint8), "id": np.arange(7, dtype=np.int32)}
    names = [name for name in columns if normals or name not in NORMAL]
    shuffle.shuffle(names)
    path = tmp_path_factory.mktemp("any") / "scene.ply"
    write_columns(path, {name: columns[name] for name in names}, **layout)

    scene = read_ply(path)
    assert_same(scene.gaussians, expected)
    assert (scene.total, scene.dropped, scene.rows.dtype) == (7, {}, np.int64)

    save_tampered(path, scene, np.linspace(0, 1, 7))  # over the file that was read
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
    expected = random_gaussians(n, degree=degree, seed=seed)
    save_ply(path, expected)
    assert_same(load_ply(path), expected)
    first = path.read_bytes()
    save_ply(path, load_ply(path))
    assert path.read_bytes() == first


def test_saved_layout_is_that_of_the_inria_code(folder):
    gaussians = random_gaussians(2, degree=1)
    save_ply(folder / "a.ply", gaussians, tamper=np.array([0.25, 1.0]))
    header, _, body = (folder / "a.ply").read_bytes().partition(b"end_header\n")
    names = [*POSITION, *NORMAL, *DC, *(f"f_rest_{i}" for i in range(9)), "opacity", *SCALE]
    names += [*ROTATION, "tamper"]
    expected = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
    assert header.decode().splitlines() == expected + [f"property float {name}" for name in names]
    columns = table_of(gaussians) | {"tamper": np.array([0.25, 1.0], np.float32)}
    assert body == np.stack([columns[name] for name in names], axis=1).astype("<f4").tobytes()


def test_saving_a_tamper_of_another_length_is_refused(folder):
    with pytest.raises(ValueError, match="match exactly"):
        save_ply(folder / "a.ply", random_gaussians(3), tamper=np.zeros(2))
    assert list(folder.iterdir()) == []


def test_2dgs_discs_get_a_third_scale(folder):
    expected = random_gaussians()
    columns = {name: col for name, col in table_of(expected).items() if name != "scale_2"}
    actual = load_ply(write_columns(folder / "discs.ply", columns))
    np.testing.assert_array_equal(actual.log_scales[:, :2], expected.log_scales[:, :2])
    np.testing.assert_allclose(actual.log_scales[:, 2], FLAT_LOG_SCALE)
    assert np.exp(FLAT_LOG_SCALE) == pytest.approx(1e-6)


def test_gs_checker_mask_stays_after_z(folder):
    columns = table_of(random_gaussians())
    names = list(columns)
    columns["mask"] = np.linspace(0, 1, 7, dtype=np.float32)
    names.insert(3, "mask")
    path = write_columns(folder / "checked.ply", {name: columns[name] for name in names})
    scene = read_ply(path)
    save_tampered(path, scene, np.zeros(7))
    assert [prop.name for prop in read_ply(path).ply["vertex"].properties] == [*names, "tamper"]


def test_other_elements_lists_and_comments_are_kept(folder):
    columns = table_of(random_gaussians(3))
    data = np.empty(3, [*((name, "f4") for name in columns), ("links", "O")])
    for name, column in columns.items():
        data[name] = column
    data["links"] = [np.array([1, 2], "u2"), np.array([], "u2"), np.array([7], "u2")]
    vertex = PlyElement.describe(
        data, "vertex", len_types={"links": "u4"}, val_types={"links": "u2"}, comments=["mine"]
    )
    empty = PlyElement.describe(np.empty(0, [("i", "i4")]), "nothing")
    extra = PlyElement.describe(np.array([(5, 2.5)], [("i", "u1"), ("d", "f8")]), "camera")
    path = folder / "rich.ply"
    ply = PlyData([extra, vertex, empty], byte_order="<", comments=["top"], obj_info=["info"])
    ply.write(str(path))

    save_tampered(path, read_ply(path), np.ones(3))
    written = PlyData.read(path)
    assert written.header == ply.header.replace("links\n", "links\nproperty float tamper\n")
    assert [row.tolist() for row in written["vertex"]["links"]] == [[1, 2], [], [7]]
    assert written["camera"].data.tolist() == [(5, 2.5)]


def test_a_tamper_in_the_file_is_replaced_and_moved_last(folder):
    columns = {"tamper": np.full(7, 9.0)} | table_of(random_gaussians())
    path = write_columns(folder / "again.ply", columns, text=True)
    save_tampered(path, read_ply(path), np.arange(7))
    written = read_ply(path).ply
    assert [prop.name for prop in written["vertex"].properties][-1] == "tamper"
    assert written["vertex"]["tamper"].tolist() == list(range(7))


def spoiled(folder: Path) -> Path:
    columns = {name: col.copy() for name, col in table_of(random_gaussians(9)).items()}
    columns["x"][1] = np.nan
    columns["opacity"][1] = np.nan  # counted under its first reason only
    for name in ROTATION:
        columns[name][3] = 0
    columns["scale_1"][4] = 80
    columns["opacity"][[5, 6, 7]] = [np.inf, -np.inf, np.nan]
    return write_columns(folder / "spoiled.ply", columns)


def test_rows_that_cannot_be_rendered_are_counted_once_and_kept(folder):
    path = spoiled(folder)
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


def test_loading_warns_in_one_line(folder):
    path = spoiled(folder)
    with pytest.warns(UserWarning, match=r"spoiled\.ply: left out 4 of 9 Gaussians \(.*\)$"):
        gaussians = load_ply(path)
    assert len(gaussians) == 5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_ply(write_columns(folder / "good.ply", table_of(gaussians))).dropped == {}


def test_expand_fills_the_rows_left_out(folder):
    scene = read_ply(spoiled(folder))
    assert scene.expand(np.arange(1, 6)).tolist() == [1, 0, 2, 0, 0, 3, 4, 0, 5]
    assert scene.expand(np.ones((5, 2), bool), fill=False).shape == (9, 2)
    with pytest.raises(ValueError, match="expected 5 values"):
        scene.expand(np.zeros(9))


@pytest.mark.parametrize("text", [False, True])
def test_float64_beyond_float32_is_not_finite(folder, text):
    columns = {name: col.astype("f8") for name, col in table_of(random_gaussians()).items()}
    columns["y"][2] = 1e300
    columns["opacity"][3] = 1e300
    scene = read_ply(write_columns(folder / "huge.ply", columns, text=text))
    assert scene.dropped == {"position not finite": 1}
    assert np.isposinf(scene.gaussians.logit_opacities[2]), "fully opaque is legal"


def test_text_beyond_float32_is_not_finite(folder):
    path = write_columns(folder / "text.ply", table_of(random_gaussians(2)), text=True)
    lines = path.read_text().splitlines()
    lines[-1] = "1e39 " + lines[-1].split(maxsplit=1)[1]
    path.write_text("\n".join(lines))
    assert read_ply(path).dropped == {"position not finite": 1}


def without(*names: str, **changed: np.ndarray) -> dict[str, np.ndarray]:
    columns = table_of(random_gaussians()) | changed
    return {name: column for name, column in columns.items() if name not in names}


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (without("f_dc_1", "rot_3"), "lacks the numeric vertex properties f_dc_1, rot_3"),
        (without("scale_1"), "lacks the numeric vertex properties scale_1"),
        (without("f_rest_8"), "has 8 f_rest properties, expected 0, 9, 24 or 45"),
        (without(z=np.full(7, np.nan)), "no Gaussian can be rendered: left out 7 of 7"),
        ({name: col[:0] for name, col in without().items()}, r"holds no Gaussians \(no vertices\)"),
    ],
)
def test_incomplete_scenes_are_named(folder, columns, message):
    path = write_columns(folder / "bad.ply", columns)
    with pytest.raises(InputError, match=message) as error:
        read_ply(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_numbering_of_f_rest_must_be_complete(folder):
    columns = without("f_rest_4") | {"f_rest_9": np.zeros(7, "f4")}
    with pytest.raises(InputError, match="lacks the numeric vertex properties f_rest_4"):
        read_ply(write_columns(folder / "bad.ply", columns))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a PLY file"),
        (b"version https://git-lfs.github.com/spec/v1\n", "not a PLY file"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "not a PLY file"),
        (b"ply\nformat binary_little_endian 1.0\n", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n1\n", "half"),
        (b"ply\nformat ascii 1.0\nelement face 0\nproperty int i\nend_header\n", "no vertices"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty uchar x\nend_header\n300\n",
            "not a PLY file",
        ),
    ],
)
def test_files_that_are_no_scene(folder, content, message):
    path = folder / "bad.ply"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        read_ply(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_nothing_and_a_folder(folder):
    with pytest.raises(InputError, match=r"none\.ply: no such file, expected a scene"):
        read_ply(folder / "none.ply")
    with pytest.raises(InputError, match="is a folder, expected a scene"):
        load_ply(folder)


@quick
@given(text=st.booleans(), share=st.floats(0, 0.999))
def test_a_file_cut_short_is_damaged(tmp_path_factory, text, share):
    path = tmp_path_factory.mktemp("cut") / "cut.ply"
    whole = write_columns(path, table_of(random_gaussians(degree=0)), text=text).read_bytes()
    # A cut inside the last number of a text file cannot be seen: it is a shorter number.
    path.write_bytes(whole[: int(share * (len(whole) - 25))])
    with pytest.raises(InputError, match=r"damaged or cut short|not a PLY file"):
        read_ply(path)


def test_the_rows_that_are_promised_are_named(folder):
    path = write_columns(folder / "cut.ply", table_of(random_gaussians(degree=0)))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"row 5: early end-of-file; its header promises 7"):
        read_ply(path)


@settings(deadline=None, max_examples=100)
@given(data=st.data())
def test_a_damaged_header_is_an_error_or_a_scene(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("header") / "scene.ply"
    content = bytearray(write_columns(path, table_of(random_gaussians(degree=0))).read_bytes())
    position = data.draw(st.integers(0, content.index(b"end_header") + 10))
    content[position] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    with contextlib.suppress(InputError):
        read_ply(path)


def test_highlight_is_red_where_tampered_and_grey_elsewhere(folder):
    labels = np.arange(7) % 2 == 0
    save_highlight(folder / "h.ply", random_gaussians(degree=2), labels)
    shown = load_ply(folder / "h.ply")
    red, green, blue = (0.5 + Y0 * shown.sh[:, 0]).T
    assert (red[labels] > 0.49).all()
    assert (red[labels] > 5 * green[labels]).all()
    np.testing.assert_allclose(red[~labels], green[~labels])
    np.testing.assert_allclose(red[~labels], blue[~labels])
    assert (red[~labels] <= 0.71).all()
    assert not shown.sh[:, 1:].any()
    assert_same(
        dataclasses.replace(shown, sh=random_gaussians(degree=2).sh), random_gaussians(degree=2)
    )


def fail_half_way(path: Path) -> None:
    path.write_text("half")
    raise ValueError("exactly half")


def test_atomic_leaves_the_old_file_when_the_writing_fails(folder):
    path = folder / "new/deep/file.txt"
    with atomic(path) as temporary:
        temporary.write_text("old")
        assert not path.exists()
        assert temporary.suffix == ".txt"
    with pytest.raises(ValueError, match="exactly half"), atomic(path) as temporary:
        fail_half_way(temporary)
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


def test_atomic_names_what_cannot_be_written(folder):
    (folder / "file").write_text("")
    for path in (folder, folder / "file/scene.ply"):
        with pytest.raises(InputError, match="cannot be written"):
            save_ply(path, random_gaussians())
    assert [path.name for path in folder.iterdir()] == ["file"]


@needs_scenes
@pytest.mark.parametrize(("name", "count"), [("kitchen", 213_944), ("playbot", 125_000)])
def test_real_scenes_come_back_byte_for_byte(folder, name, count):
    scene = read_ply(SCENES / f"{name}.ply")
    assert (scene.total, scene.dropped) == (count, {})
    save_ply(folder / "same.ply", scene.gaussians)
    assert (folder / "same.ply").read_bytes() == (SCENES / f"{name}.ply").read_bytes()


def packed(gaussians: Gaussians):
    gsply = pytest.importorskip("gsply")
    return gsply.GSData.from_arrays(
        means=gaussians.means,
        scales=gaussians.log_scales,
        quats=np.array(gaussians.rotations),
        opacities=gaussians.logit_opacities,
        sh0=gaussians.sh[:, 0],
        shN=np.ascontiguousarray(gaussians.sh[:, 1:]) if gaussians.sh.shape[1] > 1 else None,
        format="ply",
    )


def write_compressed(path: Path, gaussians: Gaussians) -> Path:
    gsply = pytest.importorskip("gsply")
    if path.suffix == ".spz":
        gsply.write_spz(path, packed(gaussians))
    else:
        path.write_bytes(gsply.compress_to_bytes(packed(gaussians)))
    return path


def by_position(gaussians: Gaussians) -> Gaussians:
    return gaussians.take(np.lexsort(np.round(np.asarray(gaussians.means), 1).T))


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize("name", ["scene.compressed.ply", "scene.spz"])
def test_compressed_scenes_come_back_within_their_quantisation(folder, name, degree):
    expected = random_gaussians(300, degree=degree)
    cells = np.stack(np.unravel_index(np.arange(300), (10, 10, 3)), axis=1)
    expected = dataclasses.replace(
        expected,
        means=cells.astype(np.float32),
        quats=np.array(expected.rotations),
        sh=0.2 * expected.sh,
    )
    path = write_compressed(folder / name, expected)
    scene = read_ply(path)
    assert scene.total == 300
    actual, expected = by_position(scene.gaussians), by_position(expected)
    for field, tolerance in {"means": 0.01, "log_scales": 0.04, "sh": 0.04}.items():
        np.testing.assert_allclose(
            getattr(actual, field), getattr(expected, field), atol=tolerance, rtol=0
        )
    np.testing.assert_allclose(actual.opacities, expected.opacities, atol=0.005)
    cosines = np.abs(np.sum(np.array(actual.rotations) * expected.quats, axis=1))
    np.testing.assert_allclose(cosines, 1, atol=1e-4)

    save_tampered(folder / "out.ply", scene, np.linspace(0, 1, 300))
    assert_same(load_ply(folder / "out.ply"), scene.gaussians)


def test_compressed_ply_of_another_layout_is_never_given_to_gsply(folder):
    path = write_compressed(folder / "scene.compressed.ply", random_gaussians(300))
    chunk, vertex, sh = PlyData.read(path).elements
    chunk.data = chunk.data[:1]  # 300 Gaussians need two
    PlyData([chunk, vertex, sh], byte_order="<").write(str(folder / "short.ply"))
    with pytest.raises(InputError, match=r"unknown layout.*npx @playcanvas/splat-transform"):
        read_ply(folder / "short.ply")


@pytest.mark.parametrize("name", ["scene.spz", "scene.sog", "scene.splat"])
def test_what_gsply_cannot_read_is_told_with_the_converter(folder, name):
    (folder / name).write_bytes(b"not this")
    command = rf"npx @playcanvas/splat-transform {name} scene\.ply"
    with pytest.raises(InputError, match=command) as error:
        read_ply(folder / name)
    assert "\n" not in str(error.value)


def test_without_gsply_the_extra_is_named(folder, monkeypatch):
    path = folder / "scene.spz"
    path.write_bytes(b"")
    monkeypatch.setitem(__import__("sys").modules, "gsply", None)
    with pytest.raises(InputError, match=r"pip install 'gsc_jax\[formats\]', or convert it: npx"):
        read_ply(path)


def test_plain_ply_never_meets_gsply(folder, monkeypatch):
    def refuse(name, *args, **kwargs):
        assert not name.startswith("gsply")
        return original(name, *args, **kwargs)

    original = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", refuse)
    save_ply(folder / "plain.ply", random_gaussians())
    assert len(load_ply(folder / "plain.ply")) == 7
