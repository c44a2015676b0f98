"""Cameras of a path: recognises cameras.json, transforms.json and COLMAP models.

A path yields one set of cameras or an error. Names must be unique, because masks and outputs are
matched by name. If a folder holds several sets, only a cameras.json takes precedence, since the
trainer writes it beside its scene.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from gsc_jax.io.colmap import MODEL_FILES, is_colmap, read_colmap
from gsc_jax.io.files import atomic
from gsc_jax.io.json_cameras import inria_item, read_inria
from gsc_jax.io.tables import read_table
from gsc_jax.io.transforms import read_transforms
from gsc_jax.io.validation import shown
from gsc_jax.scene import Camera, InputError
from gsc_jax.scene.camera import check_camera

OTHER_FILES = ("transforms.json", "transforms_train.json", "views.json")
COLMAP_FOLDERS = (".", "sparse/0", "0", "sparse", "colmap/sparse/0")
"""Subfolders that may hold a COLMAP model; the first that does is used."""


def load_cameras(path: str | Path, *, max_bytes: int | None = None) -> list[Camera]:
    """Read cameras from a cameras.json, a transforms.json or a COLMAP model.

    Args:
        path: A file, or a folder that holds a cameras.json, or else either a transforms.json (or
            transforms_train.json) or a COLMAP model (directly or in `sparse/0`).
        max_bytes: Memory that may be allocated; see `memory_limit` for the default.

    Returns:
        Cameras in the order of the file, those of COLMAP by name, each with a unique name: the
        `img_name`, the `file_path`, or the COLMAP image name.

    Raises:
        InputError: If no or several sets are found, a file is damaged, a camera is distorted or
            its pose not rigid, or two cameras have the same name.
    """
    source = _find(Path(path))
    if source.is_dir():
        return _checked(read_colmap(source, max_bytes=max_bytes), source)
    data = None
    if source.suffix.lower() == ".json":
        data = read_table(source, remedy="export the cameras again", max_bytes=max_bytes)
    if isinstance(data, list):
        return _checked(read_inria(data, source), source)
    if isinstance(data, dict) and "frames" in data:
        return _checked(read_transforms(data, source), source)
    raise InputError(
        f"{source}: expected a cameras.json (a list of cameras), a transforms.json (with frames) "
        "or a COLMAP model; name one of these"
    )


def save_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Write a cameras.json in the INRIA layout, with `cx` and `cy` if they are not the centre.

    Args:
        path: The file to write or to replace, a .json.
        cameras: Cameras without skew.

    Raises:
        InputError: If the file cannot be written, or could not be read again: there are no
            cameras, two have the same name, or one has a pose or intrinsics that are invalid.
    """
    if Path(path).suffix.lower() != ".json":
        raise InputError(f"{path}: not written: cameras are read from a .json; rename it")
    try:
        items = [inria_item(camera, index) for index, camera in enumerate(cameras)]
        _checked(read_inria(items, Path(path)), path)
        any(map(check_camera, cameras))  # also of what the file has no place for
    except ValueError as error:
        raise InputError(f"{path}: not written: {str(error).removeprefix(f'{path}: ')}") from error
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(items), encoding="utf-8")


def camera_files(path: str | Path) -> list[Path]:
    """List the files from which `load_cameras` reads; raise InputError if it finds none."""
    source = _find(Path(path))
    if source.is_dir():
        return [source / name for name in MODEL_FILES if (source / name).is_file()]
    return [source]


def _find(path: Path) -> Path:
    """File of the cameras, or folder of the COLMAP model."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder, expected cameras; check the path")
    if not path.is_dir():
        return path.parent if path.name in MODEL_FILES else path
    if (path / "cameras.json").is_file():
        return path / "cameras.json"
    found = [path / name for name in OTHER_FILES if (path / name).is_file()]
    found += [path / name for name in COLMAP_FOLDERS if is_colmap(path / name)][:1]
    if len(found) != 1:
        several = f"several sets of cameras ({', '.join(map(str, found))}); name one of them"
        none = "no cameras.json, transforms.json or COLMAP model (sparse/0); name where it is"
        raise InputError(f"{path}: holds {several if found else none}")
    return found[0]


def _checked(cameras: list[Camera], source: str | Path) -> list[Camera]:
    """The cameras, if there are any and their names are unique."""
    if not cameras:
        raise InputError(f"{source}: holds no cameras; export them again")
    first: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        if first.setdefault(camera.name, index) != index:
            raise InputError(
                f"{source}: cameras {first[camera.name]} and {index} are both called "
                f"{shown(camera.name)}, but masks and outputs are matched by name; rename one"
            )
    return cameras
