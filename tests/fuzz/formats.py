"""The formats that this package reads: how an input is damaged, and what a valid result is."""

import dataclasses
import functools
import io
import json
import math
import re
import shutil
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import jax
import numpy as np
from camera_files import inria_item, opengl_frame, opengl_intrinsics, random_camera
from fuzz.harness import Format
from fuzz.mutate import damaged_bytes, damaged_text, damaged_tree, json_text, toml_text
from PIL import Image
from ply_files import columns_of, write_columns
from plyfile import PlyData, PlyElement
from results_folder import write_results
from strategies import random_scene
from web_files import glb_tree, write_chunks, write_ksplat, write_splat

from gsc_jax.cli.config_file import read_config_file
from gsc_jax.cli.report.wording import headline, labels_sentence
from gsc_jax.cli.results import read_results
from gsc_jax.cli.scene_input import check_names
from gsc_jax.detectors.specs import read_spec
from gsc_jax.estimators import METHODS
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.masks import image_path, read_probability
from gsc_jax.io.ply import read_ply, save_tampered
from gsc_jax.io.validation import naming
from gsc_jax.scene import Camera
from gsc_jax.scene.gaussians import usable_rows

MAX_BYTES = 2**29
"""Memory that the readers may allocate: half of what the process has."""
COUNT = 3
Damage = Callable[[Random, bytes], bytes]


# --- Scenes ---


@functools.cache
def _plain(text: bool) -> list[bytes]:
    """Files of degree 0 and 1, with an element of lists, and with foreign properties."""
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


def _damaged_header(rng: Random, data: bytes, end: bytes = b"end_header\n") -> bytes:
    """Damage the words of a header, the bytes after the header, or both."""
    header, found, body = data.partition(end)
    if rng.random() < 0.7:
        text = damaged_text(rng, (header + found).decode("latin-1"))
        header, found = text.encode("utf-8", "replace"), b""
    if rng.random() < 0.4:
        body = damaged_bytes(rng, body)
    return header + found + body


def _check_scene(path: Path) -> None:
    """Read a scene; what is written after a run must be the same scene."""
    scene = read_ply(path, max_bytes=MAX_BYTES)
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


def _make_spz(rng: Random | None, folder: Path) -> Path:
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


def _make_sog(rng: Random | None, folder: Path) -> Path:
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


def _make_streamed(rng: Random | None, folder: Path) -> Path:
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


def _check_sog(path: Path) -> None:
    """Without the decoder of the images, which the extra installs, only what precedes it."""
    try:
        _check_scene(path)
    except ValueError as error:
        if "requires imagecodecs" not in str(error):
            raise


@functools.cache
def _splats() -> list[bytes]:
    with tempfile.TemporaryDirectory() as name:
        return [write_splat(Path(name) / "s.splat", random_scene(COUNT)).read_bytes()]


@functools.cache
def _ksplats() -> list[bytes]:
    made = random_scene(40, degree=2)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "s.ksplat"
        return [write_ksplat(path, made, level=level).read_bytes() for level in range(3)]


def _damaged_ksplat(rng: Random, data: bytes) -> bytes:
    """Damage the fields of the headers, nearly all of whose bytes are unused, or any bytes."""
    if rng.random() < 0.3:
        return damaged_bytes(rng, data)
    start = rng.choice((0, 4096, 5120))
    fields = damaged_bytes(rng, data[start : start + 44])
    return data[:start] + fields + data[start + 44 :]


def _make_glb(rng: Random | None, folder: Path) -> Path:
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


# --- Cameras ---


def _cameras_tree() -> Any:
    return [inria_item(random_camera(i, name=f"left/{i}.png")) | {"cx": 300.5} for i in range(2)]


def _transforms_tree() -> Any:
    first, second = (random_camera(i, name=f"{i}.png") for i in range(2))
    return opengl_intrinsics(first) | {"frames": [opengl_frame(first), opengl_frame(second)]}


def _make_colmap(rng: Random | None, folder: Path, *, text: bool) -> Path:
    files = _colmap_text() if text else _colmap_binary()
    if rng is not None:
        name = rng.choice(list(files))
        damage = _damaged_utf8 if text and rng.random() < 0.8 else damaged_bytes
        files = files | {name: damage(rng, files[name])}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def _colmap_binary() -> dict[str, bytes]:
    cameras, images = struct.pack("<Q", 2), struct.pack("<Q", 2)
    for i in (1, 2):
        cameras += struct.pack("<iiQQ4d", i, 1, 640, 400, 500, 500, 320, 200)
        images += struct.pack("<i7di", i, 0.5, 0.5, -0.5, 0.5, 1, 2, 3, i)
        images += f"left/{i}.png\0".encode() + struct.pack("<Q2dq", 1, 3.0, 4.0, -1)
    return {"cameras.bin": cameras, "images.bin": images}


def _colmap_text() -> dict[str, bytes]:
    cameras = "# comment\n1 PINHOLE 640 400 500 500 320 200\n2 SIMPLE_PINHOLE 640 400 500 320 200\n"
    images = (
        "# comment\n1 .5 .5 -.5 .5 1 2 3 1 left/1.png\n3.0 4.0 -1\n2 1 0 0 0 1 2 3 2 b c.png\n\n"
    )
    return {"cameras.txt": cameras.encode(), "images.txt": images.encode()}


def _check_cameras(path: Path) -> None:
    """Read cameras; their names must name files, and what is written must be the same cameras."""
    cameras = load_cameras(path, max_bytes=MAX_BYTES)
    _check_numbers(cameras)
    with naming(path):
        check_names(cameras)
    for camera in cameras:
        place = image_path(path.parent / "masks", camera.name)
        place.parent.mkdir(parents=True, exist_ok=True)
        for suffix in (".png", ".jpg"):
            place.with_suffix(suffix).touch()
    shutil.rmtree(path.parent / "masks")
    save_cameras(path.parent / "written.json", cameras)
    again = load_cameras(path.parent / "written.json")
    assert [camera.name for camera in again] == [camera.name for camera in cameras]
    for one, other in zip(again, cameras, strict=True):
        np.testing.assert_allclose(one.K, other.K, rtol=1e-6)


def _check_numbers(cameras: list[Camera]) -> None:
    assert len({camera.name for camera in cameras}) == len(cameras) > 0
    for camera in cameras:
        viewmat, K = np.asarray(camera.viewmat), np.asarray(camera.K)
        assert viewmat.dtype == K.dtype == np.float32
        assert np.isfinite(viewmat).all()
        assert np.isfinite(K).all()
        assert min(K[0, 0], K[1, 1], camera.width, camera.height) > 0
        np.testing.assert_allclose(viewmat[:3, :3] @ viewmat[:3, :3].T, np.eye(3), atol=0.02)


# --- Masks ---


@functools.cache
def _masks() -> list[tuple[str, bytes]]:
    levels = (np.arange(12, dtype=np.uint8) * 20).reshape(3, 4)
    grey = Image.fromarray(levels)
    palette = grey.convert("P")
    images = {
        "png": [grey, grey.convert("RGBA"), palette, Image.fromarray(levels * np.uint16(257))],
        "jpg": [grey],
        "tif": [grey, Image.fromarray(levels / np.float32(255))],
        "bmp": [grey],
        "webp": [grey.convert("RGB")],
    }
    files = []
    for suffix, kinds in images.items():
        for image in kinds:
            stream = io.BytesIO()
            image.save(stream, {"jpg": "JPEG", "tif": "TIFF"}.get(suffix, suffix.upper()))
            files.append((f"mask.{suffix}", stream.getvalue()))
    return files


def _make_mask(rng: Random | None, folder: Path) -> Path:
    name, data = _masks()[0] if rng is None else rng.choice(_masks())
    if rng is not None:
        data = damaged_bytes(rng, data)
        if name.endswith("png") and rng.random() < 0.7:
            data = _with_checksums(data)
    (folder / name).write_bytes(data)
    return folder / name


def _with_checksums(png: bytes) -> bytes:
    """Correct the checksums of the chunks, without which a decoder looks no further."""
    content, at = bytearray(png), 8
    while at + 12 <= len(content):
        end = at + 8 + int.from_bytes(content[at : at + 4], "big")
        if end + 4 > len(content):
            break
        content[end : end + 4] = zlib.crc32(content[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    return bytes(content)


def _check_mask(path: Path) -> None:
    mask = read_probability(path, max_bytes=MAX_BYTES)
    assert mask.ndim == 2
    assert mask.dtype == np.float32
    assert ((mask >= 0) & (mask <= 1)).all()


# --- Configurations and results ---


def _spec_tree() -> Any:
    tree = {"size": [64, 32], "fit": "pad", "multiple_of": 2, "channels": "bgr", "layout": "NHWC"}
    tree |= {"scale": 0.5, "mean": [0.1, 0.2, 0.3], "std": [1.0, 2.0, 3.0], "input": "image"}
    return tree | {"output": 1, "activation": "softmax", "channel": 1, "threshold": 0.4}


@functools.cache
def _config_trees() -> list[Any]:
    """Of the kind that people write, and as in the result.json of every method."""
    own = {"command": {"scene": "a.ply", "views": 3, "scale": 0.5, "masks": "m", "near": 0.1}}
    trees: list[Any] = [own | {"config": {"classes": [4, 8], "smoothing": 3.0}}]
    for method, estimator in METHODS.items():
        config = json.loads(json.dumps(dataclasses.asdict(estimator)))  # pyright: ignore[reportArgumentType]
        command = {"method": method, "detector": ["native"], "seed": config["seed"]}
        report = {"versions": {}, "outputs": [], "judged_views": 7, "verdict": 0.5}
        trees.append({"command": command, "config": config} | report)
    return trees


def _make_config(rng: Random | None, folder: Path) -> Path:
    if rng is None:
        return _write(folder / "run.json", json.dumps(_config_trees()[1]))
    tree = damaged_tree(rng, rng.choice(_config_trees()))
    if rng.random() < 0.5:
        return _write(folder / "run.json", json_text(rng, tree))
    text = toml_text(rng, tree)
    return _write(folder / "run.toml", damaged_text(rng, text) if rng.random() < 0.3 else text)


def _check_config(path: Path) -> None:
    content = read_config_file(path)
    content.options()
    for method in METHODS:
        _check_finite(dataclasses.asdict(content.for_method(method).estimator))  # pyright: ignore[reportArgumentType]


def _check_spec(path: Path) -> None:
    _check_finite(dataclasses.asdict(read_spec(path)))


def _check_finite(value: Any) -> None:
    if isinstance(value, dict | list | tuple):
        for entry in value.values() if isinstance(value, dict) else value:
            _check_finite(entry)
    elif isinstance(value, int | float):
        assert math.isfinite(value)
        assert abs(value) < 2**63


@functools.cache
def _results() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        write_results(Path(name), count=16)
        names = ("tamper.ply", "tamper.npy", "labels.npy", "views.json", "result.json")
        return {file: (Path(name) / file).read_bytes() for file in names}


def _make_results(rng: Random | None, folder: Path) -> Path:
    files = _results()
    if rng is not None:
        name = rng.choice(list(files))
        files = files | {name: _RESULTS[name](rng, files[name])}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def _check_results(path: Path) -> None:
    """Read results and state what the viewer says about them."""
    results = read_results(path)
    assert len(results.tamper) == len(results.labels) == len(results.scene.gaussians)
    assert ((results.tamper >= 0) & (results.tamper <= 1)).all()
    assert math.isfinite(results.report["config"]["threshold"])
    _check_numbers(results.cameras)
    counts, verdict = results.report["counts"], results.report.get("verdict")
    assert "nan" not in headline(verdict, counts["tampered"]) + labels_sentence(
        counts["tampered"],
        counts["gaussians"],
        verdict=verdict,
        views=len(results.cameras),
        covered=results.report["tampered_share_of_views"],
    )


# --- Their parts ---


def _write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", errors="replace")
    return path


def _damaged_utf8(rng: Random, data: bytes) -> bytes:
    return damaged_text(rng, data.decode()).encode("utf-8", "replace")


def _damaged_json(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.2:
        return _damaged_utf8(rng, data)
    return json_text(rng, damaged_tree(rng, json.loads(data))).encode("utf-8", "replace")


def _damaged_npy(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.5:
        return damaged_bytes(rng, data)
    header, _, body = data.partition(b"}")
    numbers = (
        "'<f4'",
        "'|O'",
        "'<U9'",
        "(3,)",
        "(16, -1)",
        "(9**99,)",
        "99999999999",
        "None",
        "((",
    )
    text = re.sub(
        r"'<?f4'|'\|b1'|\(16,\)|False", lambda _: rng.choice(numbers), header.decode("latin-1")
    )
    return text.encode("latin-1") + b"}" + body


_RESULTS: dict[str, Damage] = {
    "tamper.ply": _damaged_header,
    "tamper.npy": _damaged_npy,
    "labels.npy": _damaged_npy,
    "views.json": _damaged_json,
    "result.json": _damaged_json,
}


def _make_file(
    rng: Random | None, folder: Path, *, name: str, seeds: Callable[[], list[bytes]], damage: Damage
) -> Path:
    data = seeds()[0] if rng is None else damage(rng, rng.choice(seeds()))
    (folder / name).write_bytes(data)
    return folder / name


def _file(
    kind: str, name: str, seeds: Callable[[], list[bytes]], damage: Damage, read: Callable
) -> Format:
    make = functools.partial(_make_file, name=name, seeds=seeds, damage=damage)
    return Format(name=kind, make=make, read=read)


def _spec_seeds() -> list[bytes]:
    return [toml_text(Random(0), _spec_tree()).encode()]


def _damaged_spec(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.3:
        return _damaged_utf8(rng, data)
    return toml_text(rng, damaged_tree(rng, _spec_tree())).encode("utf-8", "replace")


def _json_seeds(tree: Callable[[], Any]) -> list[bytes]:
    return [json.dumps(tree()).encode()]


def _compressed_seeds() -> list[bytes]:
    return [_compressed(0)]


_FORMATS = (
    _file("ply-binary", "s.ply", functools.partial(_plain, False), _damaged_header, _check_scene),
    _file("ply-ascii", "s.ply", functools.partial(_plain, True), _damaged_header, _check_scene),
    _file("ply-compressed", "s.ply", _compressed_seeds, _damaged_header, _check_scene),
    Format(name="spz", make=_make_spz, read=_check_scene),
    Format(name="sog", make=_make_sog, read=_check_sog),
    Format(name="streamed", make=_make_streamed, read=_check_sog),
    _file("splat", "s.splat", _splats, damaged_bytes, _check_scene),
    _file("ksplat", "s.ksplat", _ksplats, _damaged_ksplat, _check_scene),
    Format(name="glb", make=_make_glb, read=_check_scene),
    _file(
        "cameras",
        "cameras.json",
        functools.partial(_json_seeds, _cameras_tree),
        _damaged_json,
        _check_cameras,
    ),
    _file(
        "transforms",
        "transforms.json",
        functools.partial(_json_seeds, _transforms_tree),
        _damaged_json,
        _check_cameras,
    ),
    *(
        Format(
            name=f"colmap-{'text' if text else 'binary'}",
            make=functools.partial(_make_colmap, text=text),
            read=_check_cameras,
        )
        for text in (False, True)
    ),
    Format(name="mask", make=_make_mask, read=_check_mask),
    _file("spec", "net.toml", _spec_seeds, _damaged_spec, _check_spec),
    Format(name="config", make=_make_config, read=_check_config),
    Format(name="results", make=_make_results, read=_check_results),
)
FORMATS = {kind.name: kind for kind in _FORMATS}
"""All formats, by name."""
