"""What a detector said of an image, kept in a folder: the same image is not judged again.

The network is the slowest part of a run, and what it says depends on the network and the image
alone, so a run with another lifting, or the same again, need not wait for it. An entry is found by
a digest of the key, which stands for the network and all its options, and of the image, bit by bit:
on one machine, rendering repeats itself exactly (measured, in several processes, with and without
the compilation cache). Probabilities are kept as they are, in float32, so a run that finds them
ends as the run that made them.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.evidence.detector import Detector
from gsc_jax.io.files import atomic
from gsc_jax.scene import Camera, InputError

LIMIT = 2 * 2**30
"""Bytes: some 500 maps of a megapixel."""
LEFT_AFTER_CLEANING = 0.9
"""Share of the limit that is filled again, so that not every new entry makes room for itself."""


class CachedDetector:
    """A detector that remembers, between runs, what it said of an image.

    The `notes` of a detector on its views, where it has them, are kept with its outputs, so that
    its `warnings` are those of a run in which it looked at every view.

    Attributes:
        detector: The detector that is asked where nothing is remembered.
        folder: Where its outputs are.
        needs_image: Whether the detector looks at the render; if not, nothing is kept.
    """

    def __init__(self, detector: Detector, folder: str | Path, key: str, *, limit: int = LIMIT):
        """Looks at nothing yet.

        Args:
            detector: What to ask.
            folder: Where to keep what it says; of the cache alone, made where missing.
            key: Stands for the detector with all its options, as `OnnxDetector.fingerprint` does.
            limit: Bytes of the folder; what was not used for longest goes first.
        """
        self.detector = detector
        self.folder = Path(folder)
        self.needs_image = detector.needs_image
        self._key = key
        self._limit = limit
        self._room = 0
        self._damaged = 0
        self._unwritable = ""

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """The cameras that the detector has something to say on.

        Raises:
            InputError: If there are none.
        """
        return self.detector.select(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """The probability of tampering in a view, as the detector says or said it.

        Args:
            image: The rendered view, shape (H, W, 3).
            camera: Its camera, which the detector is given.

        Returns:
            Probability in [0, 1], shape (h, w) float32.

        Raises:
            InputError: If the detector raises it. A cache that fails is a warning.
        """
        if image is None:
            return self.detector(image, camera)
        path = self._path(image)
        found = self._read(path)
        if found is None:
            probability = np.asarray(self.detector(image, camera), np.float32)
            self._write(path, probability, self._notes.get(camera.name))
            return probability
        probability, note = found
        if note is not None:
            self._notes[camera.name] = note
        return probability

    def holds(self, image: np.ndarray) -> bool:
        """Whether the detector need not be asked about a view.

        Args:
            image: The rendered view, shape (H, W, 3).
        """
        return self._path(image).exists()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the detector, and what is wrong with the cache."""
        found = [*getattr(self.detector, "warnings", ())]
        if self._damaged:
            found.append(
                f"{self.folder}: {self._damaged} damaged outputs of the detector were computed anew"
            )
        if self._unwritable:
            found.append(f"{self._unwritable}; the next run asks the detector again")
        return tuple(found)

    @property
    def _notes(self) -> dict[str, Any]:
        """The detector's notes by view, or nobody's."""
        return getattr(self.detector, "notes", {})

    def _path(self, image: np.ndarray) -> Path:
        """Where the answer to an image is, or will be."""
        facts = f"{self._key} {image.shape} {image.dtype}"
        digest = hashlib.blake2b(facts.encode(), digest_size=16)
        digest.update(np.ascontiguousarray(image).data)
        return self.folder / f"{digest.hexdigest()}.npz"

    def _read(self, path: Path) -> tuple[np.ndarray, Any] | None:
        """A probability and the note on it, None if there is none that can be read."""
        try:
            with path.open("rb") as file, np.load(file) as entry:
                found = entry["probability"], json.loads(str(entry["note"]))
            os.utime(path)  # it was used
            return found
        except FileNotFoundError:
            return None
        except Exception:  # a damaged archive fails in many ways
            self._damaged += 1
            return None

    def _write(self, path: Path, probability: np.ndarray, note: Any) -> None:
        try:
            with atomic(path) as temporary:
                np.savez_compressed(temporary, probability=probability, note=json.dumps(note))
        except InputError as error:
            self._unwritable = str(error)
            return
        with contextlib.suppress(OSError):  # another process may be cleaning, too
            self._room -= path.stat().st_size
            if self._room < 0:
                self._room = _make_room(self.folder, self._limit)


def _make_room(folder: Path, limit: int) -> int:
    """Removes what was not used for longest, if all is too much; the bytes that are left."""
    facts = [(path.stat(), path) for path in folder.glob("*.npz")]
    size = sum(stat.st_size for stat, _ in facts)
    if size > limit:
        for stat, path in sorted(facts, key=lambda fact: fact[0].st_mtime_ns):
            if size <= limit * LEFT_AFTER_CLEANING:
                break
            path.unlink(missing_ok=True)
            size -= stat.st_size
    return limit - size
