"""Scene files of every format with damage, and the check of scenes that can be read."""

import dataclasses
import functools
import io
import json
import tempfile
import zipfile
import zlib
from pathlib import Path
from random import Random
from typing import Any

import jax
import numpy as np
from fuzz.harness import READER_BYTES
from fuzz.mutate import damaged_bytes, damaged_tree, json_text
from PIL import Image
from ply_files import columns_of, write_columns
from plyfile import PlyData, PlyElement
from strategies import random_scene
from web_files import glb_tree, write_chunks, write_ksplat, write_splat

from gsc_jax.io.ply import read_ply, save_tampered
from gsc_jax.scene.gaussians import usable_rows

COUNT = 3
"""Gaussians of most scenes."""


@functools.cache
def ply_seeds(text: bool) -> list[bytes]:
    """Scenes of SH degree 0 and 1, one with faces, one with a property of another program."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "scene.ply"
        degrees = [columns_of(random_scene(COUNT, degree=degree)) for degree in (0, 1)]
        files = [write_columns(path, columns, text=text).read_bytes() for columns in degrees]
        files.append(write_columns(path, degrees[0], byte_order=">").read_bytes())
        foreign = {"sem:class": np.arange(COUNT, dtype=np.uint8)} | degrees[0]
        data = np.empty(COUNT, [(key, column.dtype) for key, column in foreign.items()])
        for key, column in foreign.items():
            data[key] = column
        faces = np.empty(2, [("vertex_indices", "O")])
        faces["vertex_indices"] = [np.arange(3), np.arange(1)]
        elements = [PlyElement.describe(data[:0], "vertex"), PlyElement.describe(faces, "face")]
        PlyData(elements, text=True, comments=["made here"]).write(str(path))
        header, body = path.read_bytes().split(b"end_header\n")
        rows = [" ".join(str(row[key]) for key in foreign) for row in data]
        header = header.replace(b"vertex 0", b"vertex %d" % COUNT)
        files.append(header + b"end_header\n" + "\n".join(rows).encode() + b"\n" + body)
        if not text:
            path.write_bytes(files.pop())
            lists = PlyData.read(str(path))
            lists.text, lists.byte_order = False, "<"
            lists.elements = [lists["face"], lists["vertex"]]
            lists["vertex"].data = lists["vertex"].data  # plyfile cannot write a colon
            files.append(_binary(lists))
        return files


def _binary(ply: PlyData) -> bytes:
    stream = io.BytesIO()
    PlyData([ply["face"]], byte_order="<").write(stream)
    body = stream.getvalue().partition(b"end_header\n")[2]
    return ply.header.encode() + b"\n" + body + ply["vertex"].data.tobytes()


def check_scene(path: Path) -> None:
    """Read a scene, and require that it is the same after it was written as `locate` does."""
    scene = read_ply(path, max_bytes=READER_BYTES)
    assert len(scene.gaussians) == len(scene.rows) > 0
    assert usable_rows(scene.gaussians).all()
    written = path.with_name("written.ply")
    save_tampered(written, scene, np.zeros(len(scene.rows)))
    again = read_ply(written)
    np.testing.assert_array_equal(again.rows, scene.rows)
    for field in dataclasses.fields(again.gaussians):
        stored = getattr(scene.gaussians, field.name)
        assert stored.dtype == np.float32
        np.testing.assert_array_equal(getattr(again.gaussians, field.name), stored)


@functools.cache
def _compressed(version: int) -> bytes:
    """A .compressed.ply for 0, or a .spz of that version."""
    import gsply

    scene = jax.tree.map(np.array, random_scene(COUNT))
    data = gsply.GSData.from_arrays(
        means=scene.means,
        scales=scene.log_scales,
        quats=np.array(scene.rotations),
        opacities=scene.logit_opacities,
        sh0=scene.sh[:, 0].copy(),
        shN=scene.sh[:, 1:].copy(),
        format="ply",
    )
    if version == 0:
        return gsply.compress_to_bytes(data)
    with tempfile.TemporaryDirectory() as name:
        gsply.write_spz(Path(name) / "scene.spz", data, version=version)
        return (Path(name) / "scene.spz").read_bytes()


def make_spz(rng: Random | None, folder: Path) -> Path:
    """Damage the file, or what is in it before it is compressed."""
    path = folder / "scene.spz"
    data = _compressed(3 if rng is None else rng.choice((3, 3, 4)))
    if rng is not None:
        if data[:2] == b"\x1f\x8b" and rng.random() < 0.6:
            inner = damaged_bytes(rng, zlib.decompress(data, 31))
            inner += bytes(rng.choice((0, 0, 0, 10_000_000)) if rng.random() < 0.02 else 0)
            packer = zlib.compressobj(1, zlib.DEFLATED, 31)
            data = packer.compress(inner) + packer.flush()
        else:
            data = damaged_bytes(rng, data)
    path.write_bytes(data)
    return path


@functools.cache
def _sog_images() -> dict[str, bytes]:
    images = {}
    for name in ("means_l", "means_u", "quats", "scales", "sh0"):
        stream = io.BytesIO()
        Image.new("RGBA", (2, 2), (200, 100, 50, 255)).save(stream, "WEBP", lossless=True)
        images[f"{name}.webp"] = stream.getvalue()
    return images


def _sog_meta() -> dict[str, Any]:
    codebook = [x / 64 - 2 for x in range(256)]
    return {
        "version": 2,
        "count": COUNT,
        "means": {"mins": [-1] * 3, "maxs": [1] * 3, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": codebook, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": codebook, "files": ["sh0.webp"]},
    }


def make_sog(rng: Random | None, folder: Path) -> Path:
    path, kind = folder / "scene.sog", "" if rng is None else rng.choice(("meta", "image", "file"))
    meta, images = json.dumps(_sog_meta()), _sog_images()
    if rng is not None and kind == "meta":
        meta = json_text(rng, damaged_tree(rng, _sog_meta()))
    if rng is not None and kind == "image":
        name = rng.choice(list(images))
        images = images | {name: damaged_bytes(rng, images[name])}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {"meta.json": meta.encode("utf-8", "replace"), **images}.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    if rng is not None and kind == "file":
        path.write_bytes(damaged_bytes(rng, path.read_bytes()))
    return path


def make_streamed(rng: Random | None, folder: Path) -> Path:
    """A streamed scene of one chunk."""
    lods = {"0": {"file": 0, "offset": 0, "count": COUNT}}
    tree: Any = {"bound": {"min": [0] * 3, "max": [1] * 3}, "children": [{"lods": lods}]}
    index = {"version": 1, "lodLevels": 1, "filenames": ["0_0/meta.json"], "tree": tree}
    path, damage = (
        folder / "streamed",
        "" if rng is None else rng.choice(("index", "index", "meta")),
    )
    (path / "0_0").mkdir(parents=True, exist_ok=True)
    for name, data in _sog_images().items():
        (path / "0_0" / name).write_bytes(data)
    for kind, name, tree in (
        ("index", "lod-meta.json", index),
        ("meta", "0_0/meta.json", _sog_meta()),
    ):
        text = json_text(rng, damaged_tree(rng, tree)) if rng and kind == damage else ""
        (path / name).write_bytes((text or json.dumps(tree)).encode("utf-8", "replace"))
    return path


def check_sog(path: Path) -> None:
    """Without the decoder of the images, which the extra installs, only what precedes it."""
    try:
        check_scene(path)
    except ValueError as error:
        if "requires imagecodecs" not in str(error):
            raise


@functools.cache
def splat_seeds() -> list[bytes]:
    with tempfile.TemporaryDirectory() as name:
        return [write_splat(Path(name) / "s.splat", random_scene(COUNT)).read_bytes()]


@functools.cache
def ksplat_seeds() -> list[bytes]:
    made = random_scene(40, degree=2)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "s.ksplat"
        return [write_ksplat(path, made, level=level).read_bytes() for level in range(3)]


def damaged_ksplat(rng: Random, data: bytes) -> bytes:
    """Damage the fields of the headers, nearly all of whose bytes are unused, or any bytes."""
    if rng.random() < 0.3:
        return damaged_bytes(rng, data)
    start = rng.choice((0, 4096, 5120))
    fields = damaged_bytes(rng, data[start : start + 44])
    return data[:start] + fields + data[start + 44 :]


def make_glb(rng: Random | None, folder: Path) -> Path:
    """Damage the JSON, the numbers, or the bytes of the whole file."""
    tree, data = glb_tree(random_scene(COUNT, degree=1))
    text = json.dumps(tree)
    kind = "" if rng is None else rng.choice(("tree", "tree", "data", "file"))
    if rng is not None and kind == "tree":
        text = json_text(rng, damaged_tree(rng, tree))
    if rng is not None and kind == "data":
        data = damaged_bytes(rng, data)
    path = write_chunks(folder / "s.glb", text.encode("utf-8", "replace"), data)
    if rng is not None and kind == "file":
        path.write_bytes(damaged_bytes(rng, path.read_bytes()))
    return path


def compressed_seeds() -> list[bytes]:
    return [_compressed(0)]
