"""Files of web viewers, by the layouts that their authors publish, give what they quantise."""

import dataclasses
import gzip
import json
import struct
import tempfile
from pathlib import Path

import numpy as np
import pytest
from ply_files import assert_same
from scipy.spatial import KDTree
from scipy.special import expit
from strategies import random_scene
from web_files import WRITERS, glb_tree, write_glb, write_ksplat, write_splat

from gsc_jax.io.ply import load_ply, read_ply, save_tampered
from gsc_jax.scene import Gaussians, InputError

COUNT = 300
TOLERANCES = {
    "s.splat": {"quats": 0.01, "sh": 0.02},
    "s.ksplat": {"quats": 1e-3, "sh": 0.02, "means": 3e-4, "log_scales": 1e-3},
    "s.glb": {"quats": 1e-6, "sh": 1e-5},
}


def scene(degree: int) -> Gaussians:
    made = random_scene(COUNT, degree=degree)
    sh = np.clip(made.sh, -1.4, 1.4)
    return dataclasses.replace(made, quats=np.array(made.rotations), sh=sh.astype(np.float32))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("name", TOLERANCES)
def test_scenes_are_read_within_their_quantisation(tmp_path, name, degree):
    expected = scene(degree)
    found = read_ply(WRITERS[Path(name).suffix](tmp_path / name, expected))
    assert found.total == COUNT
    actual = found.gaussians
    kept = {"s.splat": 1, "s.ksplat": 9}.get(name, 16)  # degree 0 and 2
    expected = dataclasses.replace(expected, sh=expected.sh[:, :kept])
    for field in ("means", "log_scales", "quats", "sh"):
        tolerance = TOLERANCES[name].get(field, 1e-6)
        np.testing.assert_allclose(
            getattr(actual, field), getattr(expected, field), atol=tolerance, rtol=1e-6
        )
    np.testing.assert_allclose(actual.opacities, expected.opacities, atol=0.5 / 255 + 1e-5)
    save_tampered(tmp_path / "out.ply", found, np.linspace(0, 1, COUNT))
    assert_same(load_ply(tmp_path / "out.ply"), actual)


def waves(*shape: int, start: float, size: float = 1.0) -> np.ndarray:
    return (size * np.sin(start + np.arange(np.prod(shape)).reshape(shape))).astype(np.float32)


@pytest.mark.parametrize(("level", "steps"), [(0, 0), (1, 1 / 2048), (2, 1 / 255)])
def test_files_that_the_viewer_has_written_are_read(tmp_path, level, steps):
    """Made with GaussianSplats3D 0.4.7 (npm) from these Gaussians, in three sections of buckets."""
    packed = Path(__file__).parent / "ksplat" / f"level{level}.ksplat.gz"
    (tmp_path / "s.ksplat").write_bytes(gzip.decompress(packed.read_bytes()))
    found = load_ply(tmp_path / "s.ksplat")
    means, sh = waves(40, 3, size=4, start=0), waves(40, 9, 3, start=4)
    distances, rows = KDTree(means).query(found.means)
    np.testing.assert_array_equal(np.sort(rows), np.arange(40))
    assert distances.max() < (2e-4 if level else 1e-6)
    quats = waves(40, 4, start=2)[rows]
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    np.testing.assert_allclose(found.quats, quats, atol=1e-3 if level else 1e-6)
    np.testing.assert_allclose(found.log_scales, waves(40, 3, start=1)[rows] - 3, atol=2e-3)
    np.testing.assert_allclose(found.sh[:, 1:], sh[rows, 1:], atol=2 * steps + 1e-6)
    np.testing.assert_allclose(found.sh[:, 0], sh[rows, 0], atol=1.01 / 255 / 0.282)
    opacities = expit(waves(40, size=3, start=3))[rows]
    np.testing.assert_allclose(found.opacities, opacities, atol=1.01 / 255)


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("sections", [1, 3])
def test_levels_and_sections_of_a_ksplat(tmp_path, level, sections):
    expected = scene(1)
    path = write_ksplat(tmp_path / "s.ksplat", expected, level=level, sections=sections)
    found = load_ply(path)
    np.testing.assert_allclose(found.means, expected.means, atol=3e-4)
    np.testing.assert_allclose(found.sh, expected.sh, atol=0.02)


def test_sections_of_different_degrees_are_filled_with_zeros(tmp_path):
    parts = [write_ksplat(tmp_path / f"{d}.ksplat", scene(d), sections=1) for d in (0, 2)]
    first, second = (path.read_bytes() for path in parts)
    header = bytearray(first[:4096])
    header[4:12] = struct.pack("<2I", 2, 2)
    both = bytes(header) + first[4096:5120] + second[4096:5120] + first[5120:] + second[5120:]
    (tmp_path / "s.ksplat").write_bytes(both)
    found = load_ply(tmp_path / "s.ksplat")
    assert found.sh.shape == (2 * COUNT, 9, 3)
    assert not found.sh[:COUNT, 1:].any()
    assert found.sh[COUNT:, 1:].any()


def test_opacities_of_0_and_255_are_finite(tmp_path):
    opaque = dataclasses.replace(
        scene(0), logit_opacities=np.repeat([90, -90], 150).astype(np.float32)
    )
    found = load_ply(write_splat(tmp_path / "s.splat", opaque))
    assert np.isfinite(found.logit_opacities).all()
    np.testing.assert_allclose(found.opacities, [254.5 / 255] * 150 + [0.5 / 255] * 150, atol=1e-6)


def test_a_colour_of_a_splat_is_its_base_colour(tmp_path):
    row = struct.pack("<6f8B", 1, 2, 3, 0.1, 0.2, 0.3, 255, 0, 51, 255, 255, 128, 128, 128)
    (tmp_path / "s.splat").write_bytes(row)
    one = load_ply(tmp_path / "s.splat")
    np.testing.assert_allclose(0.5 + 0.28209479 * one.sh[0, 0], [1, 0, 0.2], atol=1e-6)
    np.testing.assert_allclose(one.scales[0], [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(one.quats[0], [127 / 128, 0, 0, 0])


def test_normalised_integers_and_strides_of_a_glb(tmp_path):
    made = scene(1)
    tree, data = glb_tree(made)
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    accessor = tree["accessors"][attributes["KHR_gaussian_splatting:ROTATION"]]
    quats = np.rint(32767 * made.quats[:, [1, 2, 3, 0]]).astype("<i2")
    padded = np.concatenate([quats, np.full((COUNT, 2), 99, "<i2")], axis=1)
    view = {"buffer": 0, "byteOffset": len(data), "byteLength": padded.nbytes, "byteStride": 12}
    accessor |= {"componentType": 5122, "normalized": True, "bufferView": len(tree["bufferViews"])}
    tree["bufferViews"].append(view)
    path = write_glb(tmp_path / "s.glb", made, tree=tree, data=data + padded.tobytes())
    np.testing.assert_allclose(load_ply(path).quats, made.quats, atol=1e-4)


def ksplat_bytes(place: int, kind: str, number: int) -> bytes:
    """A file with another number in a header."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_ksplat(Path(folder) / "s.ksplat", random_scene(50, degree=1), sections=1)
        data = bytearray(path.read_bytes())
    struct.pack_into(kind, data, place, number)
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("s.splat", bytes(33), "no whole number of rows of 32 bytes; is it cut off"),
        ("s.glb", b"glTF" + bytes(20), "no binary glTF"),
        ("s.ksplat", bytes(4096), "empty"),
        ("s.ksplat", b"\1" + bytes(4095), "version 1"),
        ("s.ksplat", ksplat_bytes(20, "<H", 3), "compression level 3"),
        ("s.ksplat", ksplat_bytes(4096 + 4, "<I", 2**31), "buffer is smaller"),
        ("s.ksplat", ksplat_bytes(4096 + 32, "<I", 2**31), "buckets full"),
        ("s.ksplat", ksplat_bytes(4096 + 8, "<I", 15), "buckets of 47 rows, expected 50"),
        ("s.ksplat", ksplat_bytes(4096 + 40, "<H", 3), "degree 3"),
    ],
)
def test_damaged_files_are_refused(tmp_path, name, data, reason):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=rf"{name}: damaged or unknown .*{reason}.*npx") as error:
        read_ply(tmp_path / name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda t: t["accessors"][0].update(count=2**40), "more numbers"),
        (lambda t: t["bufferViews"][0].update(byteStride=0), "more numbers"),
        (lambda t: t["accessors"][0].update(sparse={}), "sparse"),
        (lambda t: t["accessors"][0].update(count=0), "different lengths"),
        (lambda t: t["accessors"][3].update(count=2), "different lengths"),
        (lambda t: t["meshes"][0]["primitives"][0].pop("extensions"), "no primitive with KHR"),
        (
            lambda t: (
                t.update(nodes=[{"mesh": 0, "scale": [2, 2, 2]}, {"mesh": 1}]),
                t["meshes"].append(t["meshes"][0]),
            ),
            "several primitives",
        ),
    ],
)
def test_what_a_glb_leaves_open_is_refused(tmp_path, change, reason):
    tree, data = glb_tree(scene(0))
    change(tree)
    with pytest.raises(InputError, match=reason):
        read_ply(write_glb(tmp_path / "s.glb", scene(0), tree=tree, data=data))


def test_json_in_a_glb_may_not_take_more_memory(tmp_path):
    text = json.dumps({"meshes": [], "extras": "x" * 10**6}).encode()
    header = struct.pack("<4sIIII", b"glTF", 2, 0, len(text), 0x4E4F534A)
    (tmp_path / "s.glb").write_bytes(header + text + bytes(8))
    with pytest.raises(InputError, match="of memory"):
        read_ply(tmp_path / "s.glb", max_bytes=2 * 10**7)
