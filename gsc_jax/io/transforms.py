"""Cameras of a transforms.json, as nerfstudio, instant-ngp and the Blender scenes write it.

Poses are camera-to-world with OpenGL axes (x right, y up, z backward), so columns 1 and 2 change
their sign. Intrinsics stand at the top, or in a frame, which then counts.
"""

from collections import ChainMap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.io.pinhole import numbers, pinhole
from gsc_jax.scene import Camera, InputError

DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
PINHOLE_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
"""Camera models that are pinholes once all distortion is zero."""

OPENGL_TO_OPENCV = np.array([1.0, -1.0, -1.0, 1.0])
IMAGE_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")


def read_transforms(data: Mapping[str, Any], path: Path) -> list[Camera]:
    """The cameras of a transforms.json, in its order.

    The focal length is `fl_x` (and `fl_y`), or follows from `camera_angle_x` (and
    `camera_angle_y`); the principal point is the middle unless `cx` and `cy` are given; without
    `w` and `h` the image beside the file is asked for its size.

    Args:
        data: What the file holds.
        path: The file.

    Returns:
        Cameras, each named by its `file_path` without a leading "./".

    Raises:
        InputError: if something is missing, distorted, or no rigid pose.
    """
    frames = data.get("frames")
    if not isinstance(frames, list):
        raise InputError(f"{path}: holds no list of frames; export the cameras again")
    return [_camera(frame, data, path, i) for i, frame in enumerate(frames)]


def _camera(frame: Any, shared: Mapping[str, Any], path: Path, index: int) -> Camera:
    where = f"{path}: frame {index}"
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise InputError(f"{where}: lacks 'file_path'; export the cameras again")
    where = f"{where} ('{frame['file_path']}')"
    fields = ChainMap(frame, dict(shared))
    _refuse_distortion(fields, where)
    size = _size(fields, path, where)
    return pinhole(
        camera_to_world=_pose(fields, where) * OPENGL_TO_OPENCV,
        focal=_focal(fields, size, where),
        center=_pair(fields, "cx", "cy", where) if "cx" in fields or "cy" in fields else None,
        size=size,
        name=frame["file_path"].removeprefix("./"),
        where=where,
    )


def _pose(fields: Mapping[str, Any], where: str) -> np.ndarray:
    matrix = fields.get("transform_matrix")
    rows = 3 if isinstance(matrix, list) and len(matrix) == 3 else 4
    return numbers(fields, "transform_matrix", (rows, 4), where)


def _refuse_distortion(fields: Mapping[str, Any], where: str) -> None:
    model = fields.get("camera_model", "PINHOLE")
    distorted = [key for key in DISTORTION if fields.get(key)]
    if model not in PINHOLE_MODELS or fields.get("is_fisheye") or distorted:
        found = ", ".join(distorted) or ("fisheye" if fields.get("is_fisheye") else model)
        raise InputError(
            f"{where}: the camera is distorted ({found}), expected a pinhole camera; undistort "
            "images and cameras first (colmap image_undistorter)"
        )


def _size(fields: Mapping[str, Any], path: Path, where: str) -> tuple[float, float]:
    if "w" in fields and "h" in fields:
        return _pair(fields, "w", "h", where)
    stem = path.parent / fields["file_path"]
    for suffix in IMAGE_SUFFIXES:
        image = stem.with_name(stem.name + suffix)
        if image.is_file():
            return _image_size(image)
    raise InputError(f"{where}: lacks 'w' and 'h', and {stem} is no image to ask; add them")


def _image_size(image: Path) -> tuple[float, float]:
    import imageio.v3 as iio

    try:
        height, width = iio.improps(image).shape[:2]
    except (OSError, ValueError) as error:
        raise InputError(f"{image}: not an image that can be read ({error})") from error
    return width, height


def _focal(fields: Mapping[str, Any], size: tuple[float, float], where: str) -> tuple[float, float]:
    x = _focal_along(fields, "x", size[0], where)
    y = _focal_along(fields, "y", size[1], where)
    if x is None:
        x = y
    if x is None:
        raise InputError(f"{where}: lacks 'fl_x' and 'camera_angle_x'; export the cameras again")
    return x, (x if y is None else y)


def _focal_along(fields: Mapping[str, Any], axis: str, pixels: float, where: str) -> float | None:
    if f"fl_{axis}" in fields:
        return float(numbers(fields, f"fl_{axis}", (), where))
    if f"camera_angle_{axis}" not in fields:
        return None
    angle = float(numbers(fields, f"camera_angle_{axis}", (), where))
    if not 0 < angle < np.pi:
        raise InputError(f"{where}: field of view {angle}, expected radians in (0, pi); correct it")
    return 0.5 * pixels / np.tan(0.5 * angle)


def _pair(fields: Mapping[str, Any], x: str, y: str, where: str) -> tuple[float, float]:
    return float(numbers(fields, x, (), where)), float(numbers(fields, y, (), where))
