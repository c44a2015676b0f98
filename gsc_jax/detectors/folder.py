"""A folder of masks as a 2D detector; the name of a camera determines the file of its mask.

Names can contain dots and folders ("left/img.0001.JPG"). A file matches by one of these rules:

1. The file is the camera name plus a suffix (left/img.0001.JPG.png).
2. The file is the camera name with another image suffix (left/img.0001.png).
3. Both are equal without any image suffix (camera "img", file img.JPG.png).
4. to 6. The same for the last path component, if the file or the camera has no folder.

The most exact match counts, two equally exact ones are an error. Suffixes have no case.
"""

import contextlib
import functools
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsc_jax.evidence.detector import same_view
from gsc_jax.io import masks
from gsc_jax.io.validation import naming
from gsc_jax.scene import Camera, InputError


class FolderDetector:
    """Masks that another program wrote into a folder.

    Attributes:
        path: The folder.
        needs_image: False, so the views are not rendered.
    """

    needs_image = False

    def __init__(self, path: str | Path, *, max_bytes: int | None = None):
        """List the images of a folder and its subfolders; InputError if there are none.

        Read later; larger ones than `max_bytes` in memory are refused; see `memory_limit`.
        """
        self.path = Path(path)
        self._limit = max_bytes
        self._dim: set[str] = set()
        if not self.path.is_dir():
            found = "is a file" if self.path.exists() else "does not exist"
            raise InputError(f"{self.path}: {found}, expected a folder with a mask per camera")
        inside = (file.relative_to(self.path) for file in self.path.rglob("*"))
        self._files = sorted(
            file.as_posix()
            for file in inside
            if file.suffix.lower() in masks.IMAGE_SUFFIXES
            and (self.path / file).is_file()
            and not any(part.startswith((".", "__MACOSX")) for part in file.parts)  # hidden
        )
        if not self._files:
            found = f"no images, expected a mask per camera ({', '.join(masks.IMAGE_SUFFIXES)})"
            raise InputError(f"{self.path}: contains {found}; name the folder that holds them")
        self._index: dict[tuple[str, str], list[str]] = defaultdict(list)
        for file in self._files:
            stem = file.rpartition(".")[0]
            for kind, name in (("stem", stem), ("bare", _without_suffixes(stem))):
                self._index[kind, name].append(file)
                self._index[f"{kind} base", name.rpartition("/")[2]].append(file)

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """Cameras that have a mask, in their order; InputError if there is none."""
        if matched := self._matched(cameras):
            return [camera for camera in cameras if camera.name in matched]
        if not cameras:
            raise InputError(f"{self.path}: there are no cameras to find masks for")
        raise InputError(
            f"{self.path}: none of its {len(self._files)} images, such as {self._files[0]!r}, is "
            f"named after one of the {len(cameras)} cameras; name the mask of camera "
            f"{cameras[0].name!r} {cameras[0].name + '.png'!r}"
        )

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:  # noqa: ARG002
        """Probability of tampering in a view at the size of its file, shape (h, w) float32.

        InputError if the camera has no mask, or the file is not a mask or has another aspect.
        """
        if (match := self._best_match(camera.name)) is None:
            file = f"{camera.name}.png"
            raise InputError(f"{self.path}: no mask for camera {camera.name!r}, expected {file!r}")
        path = self.path / match[1]
        probability = masks.read_probability(path, zero_one=self.zero_one, max_bytes=self._limit)
        high = probability.max()  # level 1 of 255 may be a map without anything tampered
        dim = probability.min() == 0 < high <= 0.5 and high * 255 != 1
        if dim and np.isin(probability, (0, high)).all():
            self._dim.add(match[1])
        with naming(path):
            return same_view(probability, camera)

    @functools.cached_property
    def zero_one(self) -> bool:
        """Whether the 8-bit images of the folder are masks with levels 0 and 1.

        True if level 1 occurs in the folder and no level above it. A single file does not decide
        this: the map of a view without tampering can have no level above 1, too.
        """
        largest = 0
        for file in self._files:
            with contextlib.suppress(InputError):  # `__call__` reports it
                grey = masks.read_grey(self.path / file, max_bytes=self._limit)
                largest = max(largest, int(grey.max()) if grey.dtype == np.uint8 else 0)
            if largest > 1:
                break
        return largest == 1

    @property
    def warnings(self) -> tuple[str, ...]:
        """How grey levels were understood, and which of the masks read so far have no white."""
        found = ["no level above 1 in any image, read as 0/1 masks"] * self.zero_one
        if self._dim:
            names = ", ".join(map(repr, sorted(self._dim)[:5]))
            found.append(f"masks without white flag nothing ({names}); write them with 0 and 255")
        return tuple(f"{self.path}: {text}" for text in found)

    def _matched(self, cameras: Sequence[Camera]) -> set[str]:
        """Names of the cameras that have a mask, each file given to its most exact match."""
        candidates: dict[str, list[tuple[int, str]]] = defaultdict(list)
        for camera in cameras:
            if match := self._best_match(camera.name):
                candidates[match[1]].append((match[0], camera.name))
        for file, ranked in candidates.items():
            ranked.sort()
            if len(ranked) > 1 and ranked[0][0] == ranked[1][0]:
                raise InputError(
                    f"{self.path}: {file!r} fits the cameras {ranked[0][1]!r} and "
                    f"{ranked[1][1]!r} equally well; name masks by the full camera name, as in "
                    f"{ranked[0][1] + '.png'!r}"
                )
        return {ranked[0][1] for ranked in candidates.values()}

    def _best_match(self, name: str) -> tuple[int, str] | None:
        """Rank of the most exact match of a camera name (0 is best) and its file."""
        name = name.replace("\\", "/")
        bare = _without_suffixes(name)
        exact = (("stem", name), ("stem", bare), ("bare", bare))
        loose = ((f"{kind} base", path.rpartition("/")[2]) for kind, path in exact)
        for rank, key in enumerate((*exact, *loose)):
            files = self._index.get(key, [])
            if rank >= len(exact):
                files = [file for file in files if "/" not in file or "/" not in name]
            if len(files) > 1:
                raise InputError(
                    f"{self.path}: {files[0]!r} and {files[1]!r} fit camera {name!r} equally "
                    "well; keep one of them, or give the subfolder"
                )
            if files:
                return rank, files[0]
        return None


def _without_suffixes(name: str) -> str:
    """Name without its image suffixes; other dots stay."""
    while name.lower().endswith(masks.IMAGE_SUFFIXES):
        name = name.rpartition(".")[0]
    return name
