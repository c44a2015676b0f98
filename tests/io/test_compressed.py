"""Compressed scenes are decoded by gsply, which never reads a plain or an unknown .ply."""

import dataclasses
import gzip
import json
import struct
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from ply_files import assert_same
from plyfile import PlyData
from strategies import random_scene

from gsc_jax.io.ply import load_ply, read_ply, save_ply, save_tampered
from gsc_jax.scene import Gaussians, InputError


def write_compressed(path: Path, gaussians: Gaussians) -> Path:
    gsply = pytest.importorskip("gsply")
    data = gsply.GSData.from_arrays(
        means=gaussians.means,
        scales=gaussians.log_scales,
        quats=np.array(gaussians.rotations),
        opacities=gaussians.logit_opacities,
        sh0=gaussians.sh[:, 0],
        shN=np.ascontiguousarray(gaussians.sh[:, 1:]) if gaussians.sh.shape[1] > 1 else None,
        format="ply",
    )
    if path.suffix == ".spz":
        gsply.write_spz(path, data)
    else:
        path.write_bytes(gsply.compress_to_bytes(data))
    return path


def by_position(gaussians: Gaussians) -> Gaussians:
    return gaussians.take(np.lexsort(np.round(np.asarray(gaussians.means), 1).T))


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize("name", ["scene.compressed.ply", "scene.spz"])
def test_scenes_are_read_within_their_quantisation(tmp_path, name, degree):
    cells = np.stack(np.unravel_index(np.arange(300), (10, 10, 3)), axis=1)
    expected = random_scene(300, degree=degree)
    expected = dataclasses.replace(
        expected,
        means=cells.astype(np.float32),
        quats=np.array(expected.rotations),
        sh=0.5 * expected.sh,
    )
    scene = read_ply(write_compressed(tmp_path / name, expected))
    assert scene.total == 300
    actual, expected = by_position(scene.gaussians), by_position(expected)
    for field, tolerance in {"means": 0.01, "log_scales": 0.04, "sh": 0.04}.items():
        np.testing.assert_allclose(
            getattr(actual, field), getattr(expected, field), atol=tolerance, rtol=0
        )
    np.testing.assert_allclose(actual.opacities, expected.opacities, atol=0.005)
    cosines = np.abs(np.sum(np.array(actual.rotations) * expected.quats, axis=1))
    np.testing.assert_allclose(cosines, 1, atol=1e-4)

    save_tampered(tmp_path / "out.ply", scene, np.linspace(0, 1, 300))
    assert_same(load_ply(tmp_path / "out.ply"), scene.gaussians)


def test_compressed_ply_of_an_unknown_layout_is_refused(tmp_path):
    path = write_compressed(tmp_path / "scene.compressed.ply", random_scene(300))
    chunk, vertex, sh = PlyData.read(path).elements
    chunk.data = chunk.data[:1]  # 300 Gaussians need two
    PlyData([chunk, vertex, sh], byte_order="<").write(str(tmp_path / "short.ply"))
    with pytest.raises(InputError, match=r"unknown layout.*npx @playcanvas/splat-transform"):
        read_ply(tmp_path / "short.ply")


@pytest.mark.parametrize("name", ["scene.spz", "scene.sog", "scene.splat"])
def test_unreadable_files_are_refused_with_a_command_that_converts(tmp_path, name):
    (tmp_path / name).write_bytes(b"not this")
    command = rf"npx @playcanvas/splat-transform {name} scene\.ply"
    with pytest.raises(InputError, match=command) as error:
        read_ply(tmp_path / name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", [".splat", ".ksplat", ".spz", ".sog", ".glb"])
def test_a_ply_of_another_name_is_not_read_as_its_suffix_says(tmp_path, suffix):
    save_ply(tmp_path / "scene.ply", random_scene(7))
    data = (tmp_path / "scene.ply").read_bytes()
    path = tmp_path / f"scene{suffix}"
    path.write_bytes(data + bytes(-len(data) % 32))  # as many bytes as rows of a .splat
    with pytest.raises(InputError, match=rf"scene{suffix}: is a PLY file; rename it to scene\.ply"):
        read_ply(path)


def test_gsply_is_imported_for_compressed_scenes_only(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsply", None)
    (tmp_path / "scene.spz").write_bytes(b"")
    with pytest.raises(InputError, match=r"pip install 'gsc_jax\[formats\]', or convert it: npx"):
        read_ply(tmp_path / "scene.spz")
    save_ply(tmp_path / "plain.ply", random_scene(7))
    assert len(load_ply(tmp_path / "plain.ply")) == 7


def read_and_measure(path: Path, match: str, *, max_bytes: int = 2**26) -> None:
    """Reading is refused, and has not taken more memory than it may."""
    tracemalloc.start()
    with pytest.raises(InputError, match=match):
        read_ply(path, max_bytes=max_bytes)
    assert tracemalloc.get_traced_memory()[1] < 2 * max_bytes
    tracemalloc.stop()


@pytest.mark.parametrize("count", [1, 2**32 - 1])
def test_a_gzip_bomb_is_not_inflated(tmp_path, count):
    header = struct.pack("<4sIIBBBB", b"NGSP", 3, count, 0, 12, 0, 0)
    (tmp_path / "bomb.spz").write_bytes(gzip.compress(header + bytes(10**8)))
    read_and_measure(tmp_path / "bomb.spz", r"bomb\.spz: takes .* of memory")


def test_sizes_in_a_spz_of_version_4_are_checked(tmp_path):
    zstandard = pytest.importorskip("zstandard")
    frame = zstandard.ZstdCompressor().compress(bytes(10**8))
    for size, match in ((10**8, "of memory"), (9, "larger than the table")):
        header = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 1, 0, 12, 0, 5, 32)
        table = struct.pack("<QQ", len(frame), size) * 5
        (tmp_path / "bomb.spz").write_bytes(header + table + frame * 5)
        read_and_measure(tmp_path / "bomb.spz", match)


SOG_META = {"version": 2, "count": 1, "scales": {"codebook": [0] * 256}}


@pytest.mark.parametrize(
    ("meta", "size", "match"),
    [
        (json.dumps(SOG_META) + " " * 10**8, (2, 2), "of memory"),
        (json.dumps(SOG_META), (4000, 4000), "of memory"),
        (json.dumps(SOG_META | {"scales": {"codebook": [0] * 255}}), (2, 2), "255 entries"),
        (json.dumps(SOG_META | {"sh0": {"mins": [0] * 3}}), (2, 2), "sh0.mins has 3 entries"),
        (json.dumps(SOG_META | {"count": -1}), (2, 2), "no Gaussians"),
    ],
)
def test_what_a_sog_expands_to_is_checked(tmp_path, meta, size, match):
    pytest.importorskip("gsply")
    Image.new("RGBA", size).save(tmp_path / "means.webp", lossless=True)
    with zipfile.ZipFile(tmp_path / "bomb.sog", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", meta)
        archive.write(tmp_path / "means.webp", "means.webp")
    read_and_measure(tmp_path / "bomb.sog", match)


def test_the_name_of_an_unknown_element_is_shortened(tmp_path):
    path = tmp_path / "s.ply"
    header = f"ply\nformat binary_little_endian 1.0\nelement {'9' * 5000} 0\nproperty float x\n"
    chunk = (
        "element chunk 1\nproperty float min_x\nelement vertex 1\nproperty uint packed_position\n"
    )
    path.write_bytes(f"{header}{chunk}end_header\n".encode() + bytes(8))
    with pytest.raises(InputError) as refused:
        load_ply(path)
    assert len(str(refused.value)) < 1000
