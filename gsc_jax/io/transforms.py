"""transforms.json as nerfstudio, instant-ngp and the Blender scenes write it.

Poses are camera-to-world with OpenGL axes (x right, y up, z backward), so columns 1 and 2 change
their sign. Intrinsics are stored once for all frames or per frame; those of the frame take
precedence. A focal length is `fl_x` or follows from `camera_angle_x`; without `w` and `h`, the size
is read from the image file if that lies in the folder of the transforms.json.
"""

import contextlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from pydantic import Field

from gsc_jax.io.json_cameras import FocalLength, Number, Pixels, Vector4, construct_cameras, pinhole
from gsc_jax.io.masks import open_image
from gsc_jax.io.validation import shown
from gsc_jax.scene import Camera, InputError

DISTORTION = (*(f"k{n}" for n in range(1, 7)), *(f"p{n}" for n in range(1, 5)), "skew")
DISTORTION += ("distortion_params", "is_fisheye")
PINHOLE_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
"""Camera models that are pinholes if all distortion is zero."""

FOCAL_X, FOCAL_Y = {"fl_x", "camera_angle_x"}, {"fl_y", "camera_angle_y"}
OPENGL_TO_OPENCV = np.array([1.0, -1.0, -1.0, 1.0])
IMAGE_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")

Radians = Annotated[Number, Field(gt=0, lt=np.pi)]


class _Frame(pydantic.BaseModel):
    """Keys of a transforms.json, of one frame or shared by all, that describe one camera."""

    file_path: str
    transform_matrix: Annotated[list[Vector4], Field(min_length=3, max_length=4)]
    w: Pixels | None = None
    h: Pixels | None = None
    fl_x: FocalLength | None = None
    fl_y: FocalLength | None = None
    camera_angle_x: Radians | None = None
    camera_angle_y: Radians | None = None
    cx: Number | None = None
    cy: Number | None = None


def read_transforms(data: Mapping[str, Any], path: Path) -> list[Camera]:
    """Convert a parsed transforms.json; raise InputError if it is invalid.

    Each camera is named by its `file_path` without a leading "./", "../" or "/".
    """
    frames = data.get("frames")
    if not isinstance(frames, list):
        raise InputError(f"{path}: holds no list of frames; export the cameras again")
    known = {*_Frame.model_fields, *DISTORTION, "camera_model"}
    shared = {key: data[key] for key in known & data.keys()}
    items = [_with_shared(frame, shared) if isinstance(frame, dict) else frame for frame in frames]
    return construct_cameras(
        items, lambda item: _camera(item, path.parent), place=f"{path}: frame", name_key="file_path"
    )


def _with_shared(frame: dict[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    """A frame with what all frames share.

    Its own focal length or angle replaces those that are shared; one along x, those along y, too.
    """
    frame = {key: value for key, value in frame.items() if value is not None}
    own = FOCAL_X | FOCAL_Y if FOCAL_X & frame.keys() else FOCAL_Y if FOCAL_Y & frame.keys() else ()
    return {**{key: value for key, value in shared.items() if key not in own}, **frame}


def _camera(item: Any, folder: Path) -> Camera:
    frame = _Frame.model_validate(item)
    found = [key for key in DISTORTION if np.any(item.get(key))]
    if (model := item.get("camera_model") or "PINHOLE") not in PINHOLE_MODELS:
        found.append(f"camera model {shown(model)}")
    if found:
        raise ValueError(
            f"the camera is distorted ({', '.join(found)}), expected a pinhole camera; undistort "
            "images and cameras first (colmap image_undistorter)"
        )
    size = (frame.w, frame.h) if frame.w and frame.h else _image_size(folder, frame.file_path)
    x = _focal(frame.fl_x, frame.camera_angle_x, size[0])
    y = _focal(frame.fl_y, frame.camera_angle_y, size[1])
    if not (x or y):
        raise ValueError("lacks 'fl_x' and 'camera_angle_x'; export the cameras again")
    name = re.sub(r"^([A-Za-z]:)?(\.{0,2}[\\/])+", "", frame.file_path)
    pose = np.array(frame.transform_matrix) * OPENGL_TO_OPENCV
    return pinhole(name, pose, focal=(x or y, y or x), center=(frame.cx, frame.cy), size=size)


def _image_size(folder: Path, name: str) -> tuple[int, int]:
    """Width and height in pixels of an image inside a folder; its suffix may be missing."""
    # Images elsewhere are not opened: the file with the cameras may come from a stranger.
    stem = folder / name
    with contextlib.suppress(Exception):  # the decoders have no common base class of their errors
        for path in (Path(f"{stem}{suffix}") for suffix in IMAGE_SUFFIXES):
            if path.resolve().is_relative_to(folder.resolve()) and path.is_file():
                with open_image(path) as image:
                    return image.size
    found = f"{shown(str(stem))} is not an image inside {folder}"
    raise ValueError(f"lacks 'w' and 'h', and {found}; add them")


def _focal(length: float | None, angle: float | None, pixels: int) -> float:
    """Focal length in pixels, as given or of a field of view in radians; 0 if both are missing."""
    return length or (0.5 * pixels / np.tan(0.5 * angle) if angle else 0.0)
