"""Scenes of web viewers: `.splat` (of antimatter15), `.ksplat` (GaussianSplats3D), `.glb` (glTF).

They store scales and opacities themselves, a .ply their logarithms and log odds. A `.splat` has no
view-dependent colour. A `.ksplat` of level 1 or 2 has positions relative to the centre of a bucket
of rows. In a `.glb`, rotations are xyzw, and up is +y. The axes stay as they are in the file.
"""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.io.files import check_allocation
from gsc_jax.io.tables import BYTES_PER_CHARACTER
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians
from gsc_jax.scene.gaussians import concatenate

LEVELS = 255
SPLAT = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
_HEADER: Any = {"major": ("u1", 0), "sections": ("<u4", 4), "level": ("<u2", 20)}
_HEADER |= {"low": ("<f4", 36), "high": ("<f4", 40), "unused": ("V1", 4095)}
_SECTION: Any = {"rows": ("<u4", 4), "in_bucket": ("<u4", 8), "buckets": ("<u4", 12)}
_SECTION |= {"block": ("<f4", 16), "steps": ("<u4", 24), "full": ("<u4", 32)}
_SECTION |= {"partial": ("<u4", 36), "degree": ("<u2", 40), "unused": ("V1", 1023)}
KSPLAT_HEADER, KSPLAT_SECTION = np.dtype(_HEADER), np.dtype(_SECTION)
KSPLAT_TYPES = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))
"""NumPy types of positions, of scales and rotations, and of harmonics, by compression level."""
DEFAULT_STEPS, DEFAULT_BOUND = 32767, 1.5
GLTF = "KHR_gaussian_splatting"
GLTF_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
PLACES = {"matrix", "translation", "rotation", "scale"}


def read_splat(path: Path, _: int | None = None) -> Gaussians:
    """Read all rows of a .splat file, NumPy float32; ValueError if it is cut short."""
    if path.stat().st_size % SPLAT.itemsize:
        raise ValueError(f"no whole number of rows of {SPLAT.itemsize} bytes; is it cut off?")
    rows = np.frombuffer(path.read_bytes(), SPLAT)
    quats, shares = (rows["quat"] - np.float32(128)) / 128, rows["rgba"] / np.float32(LEVELS)
    sh = (shares[:, None, :3] - 0.5) / Y0
    return _gaussians(rows["mean"], rows["scale"], quats, shares[:, 3:], sh)


def read_ksplat(path: Path, _: int | None = None) -> Gaussians:
    """Read all rows of a .ksplat file, NumPy float32; ValueError if it is damaged or unknown."""
    data = path.read_bytes()
    major, sections, level, low, high, _ = np.frombuffer(data, KSPLAT_HEADER, 1)[0].tolist()
    if major or level >= len(KSPLAT_TYPES):
        raise ValueError(f"version {major}, compression level {level}")
    at, parts = KSPLAT_HEADER.itemsize + sections * KSPLAT_SECTION.itemsize, []
    bounds = low or -DEFAULT_BOUND, high or DEFAULT_BOUND
    for section in np.frombuffer(data, KSPLAT_SECTION, sections, KSPLAT_HEADER.itemsize).tolist():
        part, at = _ksplat_section(data, level, bounds, section, at)
        parts.append(part)
    return concatenate(parts)


def _ksplat_section(
    data: bytes, level: int, bounds: tuple[float, float], section: tuple[Any, ...], at: int
) -> tuple[Gaussians, int]:
    """Decode the section that begins at byte `at`, and return the byte behind its end."""
    count, in_bucket, buckets, block, steps, full, partial, degree, _ = section
    if degree > 2 or full > buckets:
        raise ValueError(f"degree {degree}, {full} of {buckets} buckets full")
    place, number, harmonic = KSPLAT_TYPES[level]
    layout: list[Any] = [("mean", place, 3), ("scale", number, 3), ("quat", number, 4)]
    layout += [("rgba", "u1", 4), ("rest", harmonic, (3 * (degree + 1) ** 2 - 3,))]
    lengths = np.frombuffer(data, "<u4", partial, at)
    centers = np.frombuffer(data, "<f4", 3 * buckets, at + lengths.nbytes).reshape(-1, 3)
    at += lengths.nbytes + centers.nbytes
    rows = np.frombuffer(data, layout, count, at)
    means, scales, quats, shares, values = (rows[name].astype(np.float32) for name, *_ in layout)
    shares /= LEVELS
    if level:
        lengths = np.array([*[in_bucket] * full, *lengths], int)
        if lengths.sum() != count:
            raise ValueError(f"buckets of {lengths.sum()} rows, expected {count}")
        steps = steps or DEFAULT_STEPS
        means = (means - steps) * (block / 2 / steps) + np.repeat(centers, lengths, axis=0)
    if harmonic == "u1":
        values = bounds[0] + values / LEVELS * (bounds[1] - bounds[0])
    sh = [(shares[:, None, :3] - 0.5) / Y0]
    for band in range(1, degree + 1):  # of a band, first all numbers of red
        part = values[:, 3 * band**2 - 3 : 3 * (band + 1) ** 2 - 3]
        sh.append(part.reshape(count, 3, 2 * band + 1).transpose(0, 2, 1))
    part = _gaussians(means, scales, quats, shares[:, 3:], np.concatenate(sh, axis=1))
    return part, at + rows.nbytes


def read_glb(path: Path, max_bytes: int | None = None) -> Gaussians:
    """Read all Gaussians of a .glb file; ValueError or KeyError if it is damaged or unknown.

    Where a node places the scene is ignored, and refused if there are several primitives.
    """
    data = path.read_bytes()
    magic, version, _, length, kind = struct.unpack_from("<4s2I I4s", data)
    if (magic, version, kind) != (b"glTF", 2, b"JSON"):
        raise ValueError("no binary glTF of version 2")
    check_allocation(path, BYTES_PER_CHARACTER * length, max_bytes)
    tree, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    primitives = [primitive for mesh in tree["meshes"] for primitive in mesh["primitives"]]
    found = [one for one in primitives if GLTF in one.get("extensions", {})]
    if not found:
        raise ValueError(f"no primitive with {GLTF}")
    if len(found) > 1 and any(PLACES & set(node) for node in tree.get("nodes", [])):
        raise ValueError("several primitives, and nodes that move them")
    return concatenate([_primitive(tree, binary, one["attributes"]) for one in found])


def _primitive(tree: dict[str, Any], binary: bytes, attributes: Mapping[str, int]) -> Gaussians:
    def column(name: str) -> np.ndarray:
        return _accessor(tree, binary, tree["accessors"][attributes[name]])

    terms = sorted(name for name in attributes if name.startswith(f"{GLTF}:SH_DEGREE_"))
    sh = np.stack([column(name) for name in terms], axis=1)
    quats, opacities = column(f"{GLTF}:ROTATION")[:, [3, 0, 1, 2]], column(f"{GLTF}:OPACITY")
    columns = column("POSITION"), column(f"{GLTF}:SCALE"), quats, opacities, sh
    if len(set(map(len, columns))) > 1:
        raise ValueError("columns of different lengths")
    return _gaussians(*columns)


def _accessor(tree: dict[str, Any], binary: bytes, accessor: dict[str, Any]) -> np.ndarray:
    """Numbers of an accessor, shape (count, width) float32; normalised integers are in [-1, 1]."""
    view = tree["bufferViews"][accessor["bufferView"]]
    if "sparse" in accessor or view["buffer"] or "uri" in tree["buffers"][0]:
        raise ValueError("sparse numbers, or numbers in another file")
    kind = np.dtype(GLTF_TYPES[accessor["componentType"]])
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    count, stride = accessor["count"], view.get("byteStride", kind.itemsize * width)
    if count * stride > len(binary) + stride or stride < kind.itemsize:
        raise ValueError("more numbers than the file holds")
    numbers = np.ndarray((count, width), kind, binary, start, (stride, kind.itemsize))
    values = numbers.astype(np.float32)
    return np.maximum(values / np.iinfo(kind).max, -1) if accessor.get("normalized") else values


def _gaussians(
    means: np.ndarray, scales: np.ndarray, quats: np.ndarray, opacities: np.ndarray, sh: np.ndarray
) -> Gaussians:
    """N Gaussians from linear scales (N, 3) and opacities from 0 to 1, shape (N, 1)."""
    # Half a step from 0 and 1, whose log odds are infinite.
    opacities = np.clip(opacities[:, 0], 0.5 / LEVELS, 1 - 0.5 / LEVELS)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales, logits = np.log(scales), np.log(opacities / (1 - opacities))
    columns = {"means": means, "log_scales": log_scales, "quats": quats}
    columns |= {"logit_opacities": logits, "sh": sh}
    return Gaussians(**{name: np.asarray(c, np.float32) for name, c in columns.items()})
