"""Compressed scenes are decoded by gsply, which never reads a plain or an unknown .ply."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
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


def test_gsply_is_imported_for_compressed_scenes_only(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsply", None)
    (tmp_path / "scene.spz").write_bytes(b"")
    with pytest.raises(InputError, match=r"pip install 'gsc_jax\[formats\]', or convert it: npx"):
        read_ply(tmp_path / "scene.spz")
    save_ply(tmp_path / "plain.ply", random_scene(7))
    assert len(load_ply(tmp_path / "plain.ply")) == 7
