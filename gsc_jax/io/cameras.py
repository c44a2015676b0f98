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
from gsc_jax.io.inria import inria_item, read_inria
from gsc_jax.io.json_cameras import read_json
from gsc_jax.io.transforms import read_transforms
from gsc_jax.scene import Camera, InputError

TRANSFORMS_FILES = ("transforms.json", "transforms_train.json")
COLMAP_FOLDERS = (".", "sparse/0", "0", "sparse", "colmap/sparse/0")
"""Subfolders that may hold a COLMAP model; the first that does is used."""


def load_cameras(path: str | Path) -> list[Camera]:
    """Read cameras from a cameras.json, a transforms.json or a COLMAP model.

    Args:
        path: A file, or a folder that holds a cameras.json, or else either a transforms.json (or
            transforms_train.json) or a COLMAP model (directly or in `sparse/0`).

    Returns:
        Cameras in the order of the file, those of COLMAP by name, each with a unique name: the
        `img_name`, the `file_path`, or the COLMAP image name.

    Raises:
        InputError: If no or several sets are found, a file is damaged, a camera is distorted or
            its pose not rigid, or two cameras have the same name.
    """
    source = _find(Path(path))
    cameras = _read(source)
    if not cameras:
        raise InputError(f"{source}: holds no cameras; export them again")
    _check_unique_names(cameras, source)
    return cameras


def save_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Write a cameras.json in the INRIA layout, with `cx` and `cy` if they are not the centre.

    Args:
        path: The file to write or to replace.
        cameras: Cameras without skew.

    Raises:
        InputError: If the file cannot be written.
    """
    items = [inria_item(camera, index) for index, camera in enumerate(cameras)]
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
        return path
    if (path / "cameras.json").is_file():
        return path / "cameras.json"
    found = [path / name for name in TRANSFORMS_FILES if (path / name).is_file()]
    found += [path / name for name in COLMAP_FOLDERS if is_colmap(path / name)][:1]
    if len(found) != 1:
        several = f"several sets of cameras ({', '.join(map(str, found))}); name one of them"
        none = "no cameras.json, transforms.json or COLMAP model (sparse/0); name where it is"
        raise InputError(f"{path}: holds {several if found else none}")
    return found[0]


def _read(source: Path) -> list[Camera]:
    if source.is_dir():
        return read_colmap(source)
    if source.name in MODEL_FILES:
        return read_colmap(source.parent)
    data = read_json(source) if source.suffix.lower() == ".json" else None
    if isinstance(data, list):
        return read_inria(data, source)
    if isinstance(data, dict) and "frames" in data:
        return read_transforms(data, source)
    raise InputError(
        f"{source}: expected a cameras.json (a list of cameras), a transforms.json (with frames) "
        "or a COLMAP model; name one of these"
    )


def _check_unique_names(cameras: Sequence[Camera], source: Path) -> None:
    first: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        if first.setdefault(camera.name, index) != index:
            raise InputError(
                f"{source}: cameras {first[camera.name]} and {index} are both called "
                f"'{camera.name}', but masks and outputs are matched by name; rename one"
            )
