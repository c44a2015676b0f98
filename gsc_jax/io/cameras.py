"""Cameras from what trainers and structure from motion leave behind, and the INRIA cameras.json.

A path leads to one set of cameras or to an error, never to a guess: names are unique, because masks
and outputs go by them, and of several sets in a folder only a cameras.json is preferred, which the
trainer itself wrote beside its scene.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.io.colmap import MODEL_FILES, is_colmap, read_colmap
from gsc_jax.io.files import atomic
from gsc_jax.io.pinhole import numbers, pinhole, read_json
from gsc_jax.io.transforms import read_transforms
from gsc_jax.scene import Camera, InputError

TRANSFORMS_FILES = ("transforms.json", "transforms_train.json")
COLMAP_FOLDERS = (".", "sparse/0", "0", "sparse", "colmap/sparse/0")
"""Where a COLMAP model is looked for, below a folder; the first that holds one is it."""


def load_cameras(path: str | Path) -> list[Camera]:
    """Reads cameras.json, transforms.json or a COLMAP model, told apart by content.

    In a folder, a cameras.json is preferred; otherwise there must be either a transforms.json
    (or transforms_train.json) or a COLMAP model (there, in `sparse/0`, `0`, `sparse` or
    `colmap/sparse/0`).

    Args:
        path: A file, or a folder that holds one of them.

    Returns:
        Cameras in the order of the file, those of COLMAP by name, each with a unique name: the
        `img_name`, the `file_path`, or the COLMAP image name, as it is.

    Raises:
        InputError: if nothing or several sets are found, a file is damaged, a camera is distorted
            or its pose not rigid, or two cameras have one name.
    """
    source = _source(Path(path))
    cameras = _read(source)
    if not cameras:
        raise InputError(f"{source}: holds no cameras; export them again")
    _check_names(cameras, source)
    return cameras


def save_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Writes a cameras.json in the INRIA layout.

    The layout knows no principal point; where it is not the middle of the image, `cx` and `cy` are
    added, which `load_cameras` reads and others ignore.

    Args:
        path: The file to write or to replace.
        cameras: Cameras without skew.

    Raises:
        InputError: if the file cannot be written.
    """
    entries = [_entry(camera, index) for index, camera in enumerate(cameras)]
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(entries), encoding="utf-8")


def camera_files(path: str | Path) -> list[Path]:
    """The files that `load_cameras` reads cameras from.

    Args:
        path: A file, or a folder that holds one, or a COLMAP model.

    Raises:
        InputError: if nothing or several sets are found.
    """
    source = _source(Path(path))
    if source.is_dir():
        return [source / name for name in MODEL_FILES if (source / name).is_file()]
    return [source]


def _source(path: Path) -> Path:
    """The file, or the folder of a COLMAP model."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder, expected cameras; check the path")
    return _find(path) if path.is_dir() else path


def _find(folder: Path) -> Path:
    if (folder / "cameras.json").is_file():
        return folder / "cameras.json"
    found = [folder / name for name in TRANSFORMS_FILES if (folder / name).is_file()]
    found += [folder / name for name in COLMAP_FOLDERS if is_colmap(folder / name)][:1]
    if len(found) != 1:
        several = f"several sets of cameras ({', '.join(map(str, found))}); name one of them"
        none = "no cameras.json, transforms.json or COLMAP model (sparse/0); name where it is"
        raise InputError(f"{folder}: holds {several if found else none}")
    return found[0]


def _read(source: Path) -> list[Camera]:
    if source.is_dir():
        return read_colmap(source)
    if source.name in MODEL_FILES:
        return read_colmap(source.parent)
    if source.suffix.lower() != ".json":
        raise InputError(
            f"{source}: expected a cameras.json, a transforms.json or a COLMAP folder; name one"
        )
    data = read_json(source)
    if isinstance(data, list):
        return [_camera(entry, source, index) for index, entry in enumerate(data)]
    if isinstance(data, dict) and "frames" in data:
        return read_transforms(data, source)
    raise InputError(
        f"{source}: neither a cameras.json (a list of cameras) nor a transforms.json (frames); "
        "name one of these"
    )


def _camera(entry: Any, path: Path, index: int) -> Camera:
    where = f"{path}: camera {index}"
    if not isinstance(entry, dict) or not isinstance(entry.get("img_name"), str):
        raise InputError(f"{where}: lacks 'img_name'; export the cameras again")
    where = f"{where} ('{entry['img_name']}')"
    width, height, fx, fy = (
        float(numbers(entry, key, (), where)) for key in ("width", "height", "fx", "fy")
    )
    cx = float(numbers(entry, "cx", (), where)) if "cx" in entry else width / 2
    cy = float(numbers(entry, "cy", (), where)) if "cy" in entry else height / 2
    rotation = numbers(entry, "rotation", (3, 3), where)
    position = numbers(entry, "position", (3,), where)
    return pinhole(
        camera_to_world=np.column_stack([rotation, position]),
        focal=(fx, fy),
        center=(cx, cy),
        size=(width, height),
        name=entry["img_name"],
        where=where,
    )


def _entry(camera: Camera, index: int) -> dict[str, Any]:
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    # Files round rotations, so that the transpose, as which it is read, is not quite the inverse.
    rotation, position = viewmat[:3, :3].T, -np.linalg.solve(viewmat[:3, :3], viewmat[:3, 3])
    entry = {
        "id": index,
        "img_name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "position": position.tolist(),
        "rotation": rotation.tolist(),
        "fy": float(K[1, 1]),
        "fx": float(K[0, 0]),
    }
    if (K[0, 2], K[1, 2]) != (camera.width / 2, camera.height / 2):
        entry |= {"cx": float(K[0, 2]), "cy": float(K[1, 2])}
    return entry


def _check_names(cameras: Sequence[Camera], source: Path) -> None:
    seen: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        if camera.name in seen:
            raise InputError(
                f"{source}: cameras {seen[camera.name]} and {index} are both called "
                f"'{camera.name}', but masks and outputs go by the name; rename one"
            )
        seen[camera.name] = index
