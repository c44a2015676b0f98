"""Building a camera from what files store, and refusing what is no pinhole camera.

All readers of cameras end here, so that a pose with a scale or a reflection in it, which would
render a plausible but wrong image, is found whatever file it came from.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.scene import Camera, InputError

ORTHONORMAL_TOLERANCE = 5e-3
"""How far R^T R may be from the identity: files round to as few as three decimals."""


def pinhole(
    *,
    camera_to_world: np.ndarray,
    focal: tuple[float, float],
    center: tuple[float, float] | None,
    size: tuple[float, float],
    name: str,
    where: str,
) -> Camera:
    """A camera from a camera-to-world pose with OpenCV axes.

    Args:
        camera_to_world: Rotation and position, shape (3, 4) or (4, 4).
        focal: Focal lengths along x and y in pixels.
        center: Principal point in pixels; None for the middle of the image.
        size: Width and height in pixels, whole numbers.
        name: Name of the view.
        where: File and entry, the beginning of every message.

    Returns:
        The camera, NumPy float32.

    Raises:
        InputError: if the pose is not rigid or a number is out of its range.
    """
    width, height = size
    if not (width >= 1 and height >= 1 and width % 1 == 0 and height % 1 == 0):
        raise InputError(
            f"{where}: image size {width} x {height}, expected whole pixels; correct it"
        )
    center = (width / 2, height / 2) if center is None else center
    if not (np.isfinite([*focal, *center]).all() and min(focal) > 0):
        raise InputError(
            f"{where}: focal lengths {focal} and principal point {center}, expected finite "
            "numbers of pixels and positive focal lengths; correct them"
        )
    K = np.diag([*focal, 1.0])
    K[:2, 2] = center
    return Camera(
        viewmat=_rigid_inverse(camera_to_world, where).astype(np.float32),
        K=K.astype(np.float32),
        width=int(width),
        height=int(height),
        name=name,
    )


def numbers(entry: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> np.ndarray:
    """The finite numbers that an entry of a JSON file holds under a key.

    Args:
        entry: The entry.
        key: What to look up.
        shape: The shape that is expected; () for one number.
        where: File and entry, the beginning of the message.

    Raises:
        InputError: if the key is missing or holds anything else.
    """
    if key not in entry:
        raise InputError(f"{where}: lacks '{key}'; export the cameras again")
    try:
        values = np.asarray(entry[key], np.float64)
    except (TypeError, ValueError):
        values = np.asarray(np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        expected = f"finite numbers of shape {shape}" if shape else "a finite number"
        raise InputError(f"{where}: '{key}' is not {expected}; export the cameras again")
    return values


def read_json(path: Path) -> Any:
    """What a JSON file holds.

    Raises:
        InputError: if it is no JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error}); export the cameras again") from error


def _rigid_inverse(camera_to_world: np.ndarray, where: str) -> np.ndarray:
    rotation, position = camera_to_world[:3, :3], camera_to_world[:3, 3]
    if problem := _rotation_problem(rotation):
        raise InputError(
            f"{where}: the camera-to-world rotation {problem}, expected an orthonormal matrix of "
            "determinant 1; export the poses again without it"
        )
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.T
    viewmat[:3, 3] = -rotation.T @ position
    return viewmat


def _rotation_problem(rotation: np.ndarray) -> str:
    gram = rotation.T @ rotation
    scale = np.sqrt(np.trace(gram) / 3)
    if np.abs(gram - scale**2 * np.eye(3)).max() > ORTHONORMAL_TOLERANCE * max(1.0, scale**2):
        return "is skewed or scaled unevenly"
    if abs(scale**2 - 1) > ORTHONORMAL_TOLERANCE:
        return f"contains a scale of {scale:.4g}"
    return "contains a reflection" if np.linalg.det(rotation) < 0 else ""
