"""Cameras in JSON files: field types, poses, and errors that name file, camera and field.

A pose that contains a scale or a reflection renders a plausible but wrong image, so it is refused.
The cameras.json of the INRIA trainer has camera-to-world poses with OpenCV axes. It has no
principal point: it is the centre of the image unless the item has `cx` and `cy`, as ours have.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from pydantic import BeforeValidator, Field, FiniteFloat

from gsc_jax.io.validation import one_line, shown
from gsc_jax.scene import Camera, InputError
from gsc_jax.scene.gaussians import MAX_MAGNITUDE

MAX_SIDE_PIXELS = 1_000_000
"""No camera and no panorama has more pixels along a side."""


def _no_boolean(value: Any) -> Any:
    """Refuse true and false, which pydantic takes for 1 and 0."""
    if isinstance(value, bool):
        raise ValueError("expected a number")
    return value


Number = Annotated[FiniteFloat, BeforeValidator(_no_boolean)]
Pixels = Annotated[int, Field(ge=1, le=MAX_SIDE_PIXELS), BeforeValidator(_no_boolean)]
FocalLength = Annotated[Number, Field(gt=0)]
Vector3 = Annotated[list[Number], Field(min_length=3, max_length=3)]
Vector4 = Annotated[list[Number], Field(min_length=4, max_length=4)]
ORTHONORMAL_TOLERANCE = 5e-3
"""Largest accepted entry of |R^T R - I|: some files round rotations to three decimals."""


def construct_cameras(
    items: list[Any], construct: Callable[[Any], Camera], *, place: str, name_key: str
) -> list[Camera]:
    """Convert each item of a JSON list; raise errors as InputError of `place`, index and name."""
    cameras = []
    for index, item in enumerate(items):
        where = f"{place} {index}"
        if not isinstance(item, dict):
            raise InputError(f"{where}: expected a JSON object, found {shown(item)}")
        if isinstance(name := item.get(name_key), str):
            where += f" ({shown(name)})"
        try:
            cameras.append(construct(item))
        except pydantic.ValidationError as error:
            raise InputError(f"{one_line(error, where, item)}; export the cameras again") from error
        except (OSError, ValueError) as error:
            raise InputError(f"{where}: {error}") from error
    return cameras


def pinhole(
    name: str,
    camera_to_world: np.ndarray,
    *,
    focal: tuple[float, float],
    center: Sequence[float | None],
    size: tuple[int, int],
) -> Camera:
    """Construct a camera, NumPy float32, from a pose with OpenCV axes, shape (3, 4) or (4, 4).

    Focal lengths, principal point and size are in pixels, along x and y; a `center` of None is that
    of the image. A pose that is not rigid, or numbers beyond float32, raise ValueError.
    """
    rotation, position = camera_to_world[:3, :3], camera_to_world[:3, 3]
    if np.abs(camera_to_world[3:] - [0, 0, 0, 1]).max(initial=0) > 1e-4:
        raise ValueError("the last row of the pose is not 0, 0, 0, 1; is it transposed?")
    center = [n / 2 if x is None else x for x, n in zip(center, size, strict=True)]
    largest = np.abs([*rotation.flat, *position, *focal, *center]).max()
    if not (largest <= MAX_MAGNITUDE and min(focal) >= 1 / MAX_MAGNITUDE):  # also of NaN
        raise ValueError(
            f"a number of the pose or the intrinsics is not finite or out of all bounds (beyond "
            f"{MAX_MAGNITUDE:.0e}, or a focal length of 0); export the cameras again"
        )
    if not 1 <= min(size) <= max(size) <= MAX_SIDE_PIXELS:
        raise ValueError(f"an image of {size[0]} x {size[1]} pixels; export the cameras again")
    if problem := _rotation_problem(rotation):
        raise ValueError(
            f"the camera-to-world rotation {problem}, expected an orthonormal matrix of "
            "determinant 1; export the poses again without it"
        )
    viewmat, K = np.eye(4, dtype=np.float32), np.diag([*focal, 1.0]).astype(np.float32)
    viewmat[:3] = np.column_stack([rotation.T, -rotation.T @ position])
    K[:2, 2] = center
    return Camera(viewmat=viewmat, K=K, width=size[0], height=size[1], name=name)


def _rotation_problem(rotation: np.ndarray) -> str:
    """Reason why a matrix is not a rotation; empty if it is one."""
    gram = rotation.T @ rotation
    scale = np.sqrt(np.trace(gram) / 3)
    if np.abs(gram - scale**2 * np.eye(3)).max() > ORTHONORMAL_TOLERANCE * max(1.0, scale**2):
        return "is skewed or scaled unevenly"
    if abs(scale**2 - 1) > ORTHONORMAL_TOLERANCE:
        return f"contains a scale of {scale:.4g}"
    return "contains a reflection" if np.linalg.det(rotation) < 0 else ""


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
    pose, size = np.column_stack([fields.rotation, fields.position]), (fields.width, fields.height)
    focal, center = (fields.fx, fields.fy), (fields.cx, fields.cy)
    return pinhole(fields.img_name, pose, focal=focal, center=center, size=size)


def inria_item(camera: Camera, index: int) -> dict[str, Any]:
    """Convert a camera without skew to an item of a cameras.json."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    rotation, translation = viewmat[:3, :3], viewmat[:3, 3]
    item = {
        "id": index,
        "img_name": camera.name,
        "width": int(camera.width),
        "height": int(camera.height),
        # Files round rotations, so that the transpose is not exactly the inverse.
        "position": (-np.linalg.solve(rotation, translation)).tolist(),
        "rotation": rotation.T.tolist(),
        "fy": float(K[1, 1]),
        "fx": float(K[0, 0]),
    }
    if (K[0, 2], K[1, 2]) != (camera.width / 2, camera.height / 2):
        item |= {"cx": float(K[0, 2]), "cy": float(K[1, 2])}
    return item
