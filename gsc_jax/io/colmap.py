"""COLMAP models, binary or text: the poses and intrinsics of their registered images.

The two files with cameras are read here and not by COLMAP's own library, which trusts the counts
in a file and aborts the process on some of the damaged ones. Points are not read.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gsc_jax.io.files import check_allocation, existing_file
from gsc_jax.io.json_cameras import pinhole
from gsc_jax.io.validation import naming, reported, shown
from gsc_jax.scene import Camera, InputError

MODEL_FILES = ("cameras.bin", "cameras.txt", "images.bin", "images.txt")
EXPECTED = "cameras and images of a COLMAP model, as .bin or as .txt"
MODELS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8}
MODELS |= {"OPENCV_FISHEYE": 8, "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4}
MODELS |= {"RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12}
"""Number of parameters of the camera models, in the order of their numbers in binary files."""
FOCAL_LENGTHS = {"SIMPLE_PINHOLE": 1, "PINHOLE": 2, "SIMPLE_RADIAL": 1, "RADIAL": 1, "OPENCV": 2}
"""Focal lengths of each camera model that is a pinhole where its distortion is 0: one or two."""
BYTES_PER_BYTE = {True: 2, False: 8}
"""Memory per byte of a binary file, and of a text: lines, and the images of the shortest lines."""
_Intrinsics = tuple[str, tuple[int, int], tuple[float, ...]]
"""Model, width and height, and parameters."""
_Image = tuple[str, int, tuple[float, ...]]
"""Name, id of the camera, and world to camera as a quaternion wxyz and a translation."""


def is_colmap(folder: Path) -> bool:
    """Return whether a folder directly holds a COLMAP model."""
    return any((folder / name).is_file() for name in MODEL_FILES)


def read_colmap(folder: Path, *, max_bytes: int | None = None) -> list[Camera]:
    """Read the registered images of a COLMAP model with their full intrinsics, sorted by name.

    Binary files are preferred. A bad or too large file, or a distorted camera, raises InputError.
    """
    binary = all((folder / f"{kind}.bin").exists() for kind in ("cameras", "images"))
    readers = (_binary_cameras, _binary_images) if binary else (_text_cameras, _text_images)
    files = [folder / f"{kind}.{'bin' if binary else 'txt'}" for kind in ("cameras", "images")]
    size = sum(existing_file(file, expected=EXPECTED).stat().st_size for file in files)
    check_allocation(folder, BYTES_PER_BYTE[binary] * size, max_bytes)
    remedy = f", expected {EXPECTED}; export it again"
    with reported(f"{files[0]}: missing or damaged", remedy):
        intrinsics = dict(readers[0](files[0]))
    with reported(f"{files[1]}: missing or damaged", remedy):
        images = sorted(readers[1](files[1]))
    return [_camera(image, intrinsics.get(image[1], ("", (0, 0), ())), folder) for image in images]


def _binary_cameras(path: Path) -> Iterator[tuple[int, _Intrinsics]]:
    data = path.read_bytes()
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(count):  # a wrong count ends with an error at the end of the data
        camera_id, model, width, height = struct.unpack_from("<iiQQ", data, at)
        if not 0 <= model < len(MODELS):
            raise ValueError(f"camera model number {model}")
        name = list(MODELS)[model]
        layout = f"<{MODELS[name]}d"
        yield camera_id, (name, (width, height), struct.unpack_from(layout, data, at + 24))
        at += 24 + struct.calcsize(layout)


def _binary_images(path: Path) -> Iterator[_Image]:
    data = path.read_bytes()
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(count):
        _, *pose, camera_id = struct.unpack_from("<i7di", data, at)
        end = data.index(b"\0", at + 64)
        (points,) = struct.unpack_from("<Q", data, end + 1)
        yield data[at + 64 : end].decode(), camera_id, tuple(pose)
        at = end + 9 + 24 * points
    if at > len(data):
        raise ValueError("cut short")


def _text_cameras(path: Path) -> Iterator[tuple[int, _Intrinsics]]:
    for line in filter(str.strip, _lines(path)):
        camera_id, model, width, height, *params = line.split()
        values = tuple(map(float, params))
        if len(values) != MODELS.get(model, len(values)):
            raise ValueError(f"{model} camera with {len(values)} parameters")
        yield int(camera_id), (model, (int(width), int(height)), values)


def _text_images(path: Path) -> Iterator[_Image]:
    image = False  # whether the line before is an image: after it, some programs omit the points
    for line in _lines(path):
        *others, last = line.split() or [""]
        points = image and len(others) % 3 == 2 and last.lstrip("-").isdigit()
        if image := bool(last) and not points:
            _, *pose, camera_id, name = line.strip().split(maxsplit=9)
            if len(pose) != 7:
                raise ValueError(f"image {name} has {len(pose)} numbers of a pose")
            yield name, int(camera_id), tuple(map(float, pose))


def _lines(path: Path) -> Iterator[str]:
    """Lines that are not comments."""
    with path.open(encoding="utf-8-sig") as file:
        yield from (line for line in file if not line.startswith("#"))


def _camera(image: _Image, intrinsics: _Intrinsics, folder: Path) -> Camera:
    (name, _, pose), (model, size, params) = image, intrinsics
    where = f"{folder}: image {shown(name)}"
    count = FOCAL_LENGTHS.get(model, 0)
    if not count or any(params[count + 2 :]):
        found = f"a {shown(model)[1:-1]} camera" if model else "no camera"
        raise InputError(
            f"{where} has {found}{' with distortion' * bool(count)}, expected PINHOLE or "
            "SIMPLE_PINHOLE; undistort images and model first (colmap image_undistorter)"
        )
    if not any(pose[:4]):
        raise InputError(f"{where}: the quaternion of its pose is 0, not a rotation; export again")
    with naming(where, errors=ValueError):
        with np.errstate(all="ignore"):  # `pinhole` refuses what is not finite
            rotation = Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()
            world = np.column_stack([rotation.T, -rotation.T @ pose[4:]])
        focal = params[0], params[count - 1]
        return pinhole(name, world, focal=focal, center=params[count : count + 2], size=size)
