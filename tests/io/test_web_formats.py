"""Files of web viewers, by the layouts that their authors publish, give what they quantise."""

import dataclasses
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from ply_files import assert_same
from strategies import random_scene
from web_files import WRITERS, glb_tree, write_glb, write_splat

from gsc_jax.io.ply import load_ply, read_ply, save_tampered
from gsc_jax.scene import Gaussians, InputError

COUNT = 300
TOLERANCES = {
    "s.splat": {"quats": 0.01, "sh": 0.02},
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
    if name == "s.splat":
        expected = dataclasses.replace(expected, sh=expected.sh[:, :1])
    for field in ("means", "log_scales", "quats", "sh"):
        tolerance = TOLERANCES[name].get(field, 1e-6)
        np.testing.assert_allclose(
            getattr(actual, field), getattr(expected, field), atol=tolerance, rtol=1e-6
        )
    np.testing.assert_allclose(actual.opacities, expected.opacities, atol=0.5 / 255 + 1e-5)
    save_tampered(tmp_path / "out.ply", found, np.linspace(0, 1, COUNT))
    assert_same(load_ply(tmp_path / "out.ply"), actual)


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


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("s.splat", bytes(33), "multiple"),
        ("s.glb", b"glTF" + bytes(20), "no binary glTF"),
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
