"""A folder of masks as a 2D detector: one image per camera, found by the camera's name.

Camera names may hold dots and folders ("left/img.0001.JPG"), and people name masks in every way, so
a file can claim a camera with decreasing exactness:

1. it is the name plus a suffix (left/img.0001.JPG.png),
2. it is the name with its image suffix replaced (left/img.0001.png),
3. the two agree once all their image suffixes are dropped (a camera "img", a file img.JPG.png),
4. to 6. the same for the last path component only, where the file or the camera has no folder.

The most exact claim counts. Two files that are equally good for a camera, or two cameras for which
one file is equally good, are an error and never a guess; a camera whose file belongs more exactly
to another camera has none. The case of suffixes does not matter, that of names does.
"""

import functools
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsc_jax.io import masks
from gsc_jax.scene import Camera, InputError


class FolderDetector:
    """What another program said about each view, read from a folder of masks.

    Attributes:
        path: The folder.
        needs_image: False, so the views need not be rendered.
    """

    needs_image = False

    def __init__(self, path: str | Path):
        """Lists the images of a folder and its subfolders; reads none yet.

        Args:
            path: Folder with a mask per camera, see `gsc_jax.io.masks.read_probability`.

        Raises:
            InputError: If the path is no folder or holds no images.
        """
        self.path = Path(path)
        self._files = _image_files(self.path)
        self._index: dict[tuple[str, str], list[str]] = defaultdict(list)
        for file in self._files:
            stem = file.rpartition(".")[0]
            bare = _bare(stem)
            for key in (("stem", stem), ("bare", bare), ("base", _base(stem))):
                self._index[key].append(file)
            self._index["bare base", _base(bare)].append(file)

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """The cameras that have a mask, in their order.

        Args:
            cameras: All the cameras of the scene.

        Returns:
            At least one camera.

        Raises:
            InputError: If there is none, or a claim is ambiguous.
        """
        found = self._matches(cameras)
        if found:
            return [camera for camera in cameras if camera.name in found]
        if not cameras:
            raise InputError(f"{self.path}: there are no cameras to find masks for")
        name = cameras[0].name
        raise InputError(
            f"{self.path}: none of its {len(self._files)} images is named after one of the "
            f"{len(cameras)} cameras; the first camera is {name!r}, the first image "
            f"{self._files[0]!r}: name the mask of that camera {name + '.png'!r}"
        )

    def unmatched(self, cameras: Sequence[Camera]) -> list[str]:
        """Names of the cameras that have no mask, in their order.

        Raises:
            InputError: If a claim is ambiguous.
        """
        found = self._matches(cameras)
        return [camera.name for camera in cameras if camera.name not in found]

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:  # noqa: ARG002
        """The probability of tampering in a view, at the size of its file.

        Args:
            image: Not used.
            camera: One of those that `select` returned; its name finds the file.

        Returns:
            Probability in [0, 1], shape (h, w) float32.

        Raises:
            InputError: If the camera has no mask or the file is none.
        """
        best = self._best(camera.name)
        if best is None:
            raise InputError(
                f"{self.path}: no mask for camera {camera.name!r}, expected "
                f"{camera.name + '.png'!r}"
            )
        return masks.read_probability(self.path / best[1], zero_one=self.zero_one)

    @functools.cached_property
    def zero_one(self) -> bool:
        """Whether the folder's 8-bit images are masks of levels 0 and 1.

        So they are if level 1 occurs in the folder and none above it. One file could not tell:
        in a folder of probabilities, one that is dark all over has no level above 1 either.
        """
        largest = 0
        for file in self._files:
            largest = max(largest, _largest_level(self.path / file))
            if largest > 1:
                return False
        return largest == 1

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know about how the folder was read."""
        if not self.zero_one:
            return ()
        return (f"{self.path}: no level above 1 in any image, read as 0/1 masks",)

    def _matches(self, cameras: Sequence[Camera]) -> dict[str, str]:
        """Files by camera name, each file given to the camera that it fits best."""
        claims: dict[str, list[tuple[int, str]]] = defaultdict(list)
        for camera in cameras:
            best = self._best(camera.name)
            if best is not None:
                claims[best[1]].append((best[0], camera.name))
        owners = {}
        for file, claimants in claims.items():
            claimants.sort()
            if len(claimants) > 1 and claimants[0][0] == claimants[1][0]:
                raise InputError(
                    f"{self.path}: {file!r} fits the cameras {claimants[0][1]!r} and "
                    f"{claimants[1][1]!r} equally well; name masks by the full camera name, as in "
                    f"{claimants[0][1] + '.png'!r}"
                )
            owners[claimants[0][1]] = file
        return owners

    def _best(self, name: str) -> tuple[int, str] | None:
        """How exact the best file for this name is (0 is most) and which it is."""
        name = name.replace("\\", "/")
        bare = _bare(name)
        exact = (("stem", name), ("stem", bare), ("bare", bare))
        loose = (("base", _base(name)), ("base", _base(bare)), ("bare base", _base(bare)))
        for grade, key in enumerate(exact + loose):
            files = self._index.get(key, [])
            if grade >= len(exact):
                files = [file for file in files if "/" not in file or "/" not in name]
            if len(files) > 1:
                raise InputError(
                    f"{self.path}: {files[0]!r} and {files[1]!r} fit camera {name!r} equally "
                    "well; keep one of them, or give the subfolder"
                )
            if files:
                return grade, files[0]
        return None


def _image_files(folder: Path) -> list[str]:
    """Images below a folder by relative path with slashes, sorted, hidden ones left out."""
    if not folder.is_dir():
        found = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder}: {found}, expected a folder with a mask per camera")
    paths = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    images = [
        path.as_posix()
        for path in paths
        if path.suffix.lower() in masks.IMAGE_SUFFIXES
        and not any(part.startswith((".", "__MACOSX")) for part in path.parts)
    ]
    if not images:
        raise InputError(
            f"{folder}: holds no images ({len(paths)} other files), expected a mask per camera "
            f"({', '.join(masks.IMAGE_SUFFIXES)})"
        )
    return sorted(images)


def _largest_level(path: Path) -> int:
    """The largest 8-bit level of an image, 0 where it is no 8-bit mask."""
    try:
        grey = masks.read_grey(path)
    except InputError:  # reported when a camera asks for this file
        return 0
    return int(grey.max()) if grey.dtype == np.uint8 else 0


def _bare(name: str) -> str:
    """The name without image suffixes; other dots stay."""
    stem, dot, suffix = name.rpartition(".")
    return _bare(stem) if dot and f".{suffix.lower()}" in masks.IMAGE_SUFFIXES else name


def _base(name: str) -> str:
    """The last path component."""
    return name.rpartition("/")[2]
