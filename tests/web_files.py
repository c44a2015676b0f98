"""Writers of the files of web viewers, from the layouts that their authors publish."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.scene import Gaussians

C0 = 0.28209479177387814
GLTF = "KHR_gaussian_splatting"


def rgba(gaussians: Gaussians) -> np.ndarray:
    colours = np.column_stack([0.5 + C0 * gaussians.sh[:, 0], gaussians.opacities])
    return np.rint(255 * colours.clip(0, 1)).astype(np.uint8)


def write_splat(path: Path, gaussians: Gaussians) -> Path:
    quats = np.clip(np.rint(128 * np.asarray(gaussians.quats) + 128), 0, 255).astype(np.uint8)
    floats = np.concatenate([gaussians.means, gaussians.scales], axis=1).astype("<f4")
    parts = [floats.view(np.uint8).reshape(len(floats), 24), rgba(gaussians), quats]
    path.write_bytes(np.concatenate(parts, axis=1).tobytes())
    return path


def write_ksplat(path: Path, gaussians: Gaussians, *, level: int = 1, sections: int = 2) -> Path:
    """Sections of consecutive rows, in buckets of 16 rows, the last of which may have fewer."""
    bands = min(gaussians.sh.shape[1], 9)
    degree, largest = round(bands**0.5) - 1, float(np.abs(gaussians.sh[:, 1:]).max(initial=1))
    header = np.zeros(1024, "<u4")
    header[:5] = 256, sections, sections, len(gaussians), len(gaussians)
    header[5] = level
    header[9:11] = np.array([-largest, largest], "<f4").view("<u4")
    heads, bodies = [], []
    for rows in np.array_split(np.arange(len(gaussians)), sections):
        head, body = _ksplat_section(gaussians.take(rows), level, degree, largest)
        heads.append(head)
        bodies.append(body)
    path.write_bytes(b"".join([header.tobytes(), *heads, *bodies]))
    return path


def _ksplat_section(
    part: Gaussians, level: int, degree: int, largest: float
) -> tuple[bytes, bytes]:
    count, bucket, steps = len(part), 16, 32767
    lengths = np.diff([*range(0, count, bucket), count])
    full = int((lengths == bucket).sum())
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    centers = np.add.reduceat(part.means, starts) / lengths[:, None]
    offsets = part.means - np.repeat(centers, lengths, axis=0)
    block = max(2 * float(np.abs(offsets).max()), 1e-3)
    blocks = [
        np.asarray(part.sh)[:, d * d : (d + 1) ** 2].transpose(0, 2, 1).reshape(count, -1)
        for d in range(1, degree + 1)
    ]
    rest = np.concatenate([np.zeros((count, 0)), *blocks], axis=1)
    number = "<f2" if level else "<f4"
    columns = [part.means.astype("<f4"), part.scales.astype(number), part.quats.astype(number)]
    columns += [rgba(part), rest.astype(number)]
    head = np.zeros(256, "<u4")
    head[:2], head[10] = count, degree
    before = b""
    if level:
        columns[0] = np.rint(offsets / block * 2 * steps + steps).astype("<u2")
        head[2:6] = bucket, len(lengths), np.float32(block).view("<u4"), 12
        head[6], head[8:10] = steps, (full, len(lengths) - full)
        before = lengths[full:].astype("<u4").tobytes() + centers.astype("<f4").tobytes()
    if level == 2:
        columns[-1] = np.rint((rest / largest + 1) / 2 * 255).astype("u1")
    raw = [np.ascontiguousarray(column).view("u1").reshape(count, -1) for column in columns]
    return head.tobytes(), before + np.concatenate(raw, axis=1).tobytes()


def glb_tree(gaussians: Gaussians) -> tuple[dict[str, Any], bytes]:
    """The JSON of a .glb with one primitive, and its binary chunk."""
    columns = {
        "POSITION": gaussians.means,
        f"{GLTF}:SCALE": gaussians.scales,
        f"{GLTF}:ROTATION": np.asarray(gaussians.quats)[:, [1, 2, 3, 0]],
        f"{GLTF}:OPACITY": np.asarray(gaussians.opacities)[:, None],
    }
    degrees = ((0, 0), *((degree, k) for degree in (1, 2, 3) for k in range(2 * degree + 1)))
    for (degree, k), values in zip(
        degrees, np.moveaxis(np.asarray(gaussians.sh), 1, 0), strict=False
    ):
        columns[f"{GLTF}:SH_DEGREE_{degree}_COEF_{k}"] = values
    accessors, views, data = [], [], b""
    for values in columns.values():
        packed = np.asarray(values).astype("<f4")
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[packed.shape[1]]
        accessors.append(
            {"bufferView": len(views), "componentType": 5126, "count": len(packed), "type": kind}
        )
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": packed.nbytes})
        data += packed.tobytes()
    primitive = {
        "mode": 0,
        "attributes": {name: i for i, name in enumerate(columns)},
        "extensions": {GLTF: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    tree = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [GLTF],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    return tree, data


def write_glb(
    path: Path, gaussians: Gaussians, *, tree: dict | None = None, data: bytes | None = None
) -> Path:
    made, binary = glb_tree(gaussians)
    text = json.dumps(tree or made).encode()
    text += b" " * (-len(text) % 4)
    return write_chunks(path, text, data or binary)


def write_chunks(path: Path, text: bytes, data: bytes) -> Path:
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


WRITERS = {".splat": write_splat, ".ksplat": write_ksplat, ".glb": write_glb}
