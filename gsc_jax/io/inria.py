"""cameras.json as the INRIA trainer writes it: camera-to-world poses with OpenCV axes.

The layout has no principal point: it is the centre of the image unless the item has `cx` and `cy`,
two keys that this package adds and other readers ignore.
"""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from pydantic import Field

from gsc_jax.io.json_cameras import (
    FocalLength,
    Number,
    Pixels,
    Vector3,
    construct_cameras,
    pinhole,
)
from gsc_jax.scene import Camera


class _Item(pydantic.BaseModel):
    """Keys of a cameras.json that describe one camera; others are ignored."""

    img_name: str
    width: Pixels
    height: Pixels
    position: Vector3
    rotation: Annotated[list[Vector3], Field(min_length=3, max_length=3)]
    fx: FocalLength
    fy: FocalLength
    cx: Number | None = None
    cy: Number | None = None


def read_inria(items: list[Any], path: Path) -> list[Camera]:
    """Convert the parsed items of a cameras.json; raise InputError if one is invalid."""
    return construct_cameras(items, _camera, place=f"{path}: camera", name_key="img_name")


def _camera(item: Any) -> Camera:
    fields = _Item.model_validate(item)
    return pinhole(
        fields.img_name,
        np.column_stack([fields.rotation, fields.position]),
        focal=(fields.fx, fields.fy),
        center=(fields.cx, fields.cy),
        size=(fields.width, fields.height),
    )


def inria_item(camera: Camera, index: int) -> dict[str, Any]:
    """Convert a camera without skew to an item of a cameras.json."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    rotation, translation = viewmat[:3, :3], viewmat[:3, 3]
    item = {
        "id": index,
        "img_name": camera.name,
        "width": camera.width,
        "height": camera.height,
        # Files round rotations, so that the transpose is not exactly the inverse.
        "position": (-np.linalg.solve(rotation, translation)).tolist(),
        "rotation": rotation.T.tolist(),
        "fy": float(K[1, 1]),
        "fx": float(K[0, 0]),
    }
    if (K[0, 2], K[1, 2]) != (camera.width / 2, camera.height / 2):
        item |= {"cx": float(K[0, 2]), "cy": float(K[1, 2])}
    return item
