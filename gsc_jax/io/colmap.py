"""COLMAP reconstructions, binary or text, through pycolmap (the extra `colmap`)."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsc_jax.scene import Camera, InputError

if TYPE_CHECKING:
    import pycolmap

PINHOLE_MODELS = ("PINHOLE", "SIMPLE_PINHOLE")
MODEL_FILES = ("cameras.bin", "cameras.txt", "images.bin", "images.txt")


def is_colmap(folder: Path) -> bool:
    """Return whether a folder directly holds a COLMAP model."""
    return any((folder / name).is_file() for name in MODEL_FILES)


def read_colmap(folder: Path) -> list[Camera]:
    """Read the registered images of a COLMAP model with their full intrinsics, sorted by name.

    Raises:
        InputError: If pycolmap is missing or cannot read the model, or a camera is distorted.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise InputError(
            f"{folder}: COLMAP models need pycolmap: pip install 'gsc_jax[colmap]'"
        ) from error
    try:
        model = pycolmap.Reconstruction(folder)
    except Exception as error:  # pycolmap passes on C++ exceptions of any kind
        reason = " ".join(str(error).split())
        raise InputError(
            f"{folder}: pycolmap cannot read it ({reason}), expected cameras, images and points3D, "
            "as .bin or as .txt; copy or export the model again"
        ) from error
    registered = [image for image in model.images.values() if image.has_pose]
    return [_camera(image, folder) for image in sorted(registered, key=lambda image: image.name)]


def _camera(image: "pycolmap.Image", folder: Path) -> Camera:
    camera = image.camera
    if camera is None or camera.model.name not in PINHOLE_MODELS:
        found = "no camera" if camera is None else f"a {camera.model.name} camera"
        raise InputError(
            f"{folder}: image '{image.name}' has {found}, expected PINHOLE or SIMPLE_PINHOLE; "
            "undistort images and model first (colmap image_undistorter)"
        )
    pose = image.cam_from_world
    viewmat = np.eye(4, dtype=np.float32)
    # A method since pycolmap 3.12, a property before.
    viewmat[:3] = (pose() if callable(pose) else pose).matrix()
    return Camera(
        viewmat=viewmat,
        K=camera.calibration_matrix().astype(np.float32),
        width=camera.width,
        height=camera.height,
        name=image.name,
    )
