"""Cache of the probability maps of a detector, on disk, by the rendered image.

The key is a digest of the detector's options and of all bits of the image: rendering is
reproducible to the bit on one machine. Maps are stored as float32, so a cached run has the same
results. diskcache bounds the size and writes atomically. Entries are archives of NumPy, never
pickles. If the cache fails, there is a warning and the detector runs.
"""

import hashlib
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import diskcache
import numpy as np

from gsc_jax.evidence.detector import Detector
from gsc_jax.io.validation import brief
from gsc_jax.scene import Camera

MAX_BYTES = 2 * 2**30
"""About 500 uncompressed maps of a megapixel, 4 MiB each."""


class CachedDetector:
    """A detector whose outputs are stored between runs, with its `diagnostics` of each view.

    Nothing is cached if the detector does not need the image.
    """

    def __init__(
        self, detector: Detector, folder: str | Path, key: str, *, max_bytes: int = MAX_BYTES
    ):
        """Configure a cache in a folder of its own, which is created when it is first used.

        The key identifies the detector with all its options, such as `OnnxDetector.fingerprint`.
        Above `max_bytes`, the least recently used outputs are removed.
        """
        self.detector = detector
        self.folder = Path(folder)
        self.needs_image = detector.needs_image
        self.fingerprint = key
        self._max_bytes = max_bytes
        self._failures: list[str] = []

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """Cameras that the detector selects; raises InputError if there are none."""
        return self.detector.select(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """Stored or computed probability of tampering in a view, shape (h, w) float32.

        The camera must not influence the output of the detector.
        """
        if image is None:
            return self.detector(image, camera)
        diagnostics = self.diagnostics
        entry = self._read(image)
        if entry is None:
            probability = np.asarray(self.detector(image, camera), np.float32)
            self._write(image, probability, diagnostics.get(camera.name))
            return probability
        probability, counts = entry
        if counts is not None:
            diagnostics[camera.name] = counts
        return probability

    @property
    def diagnostics(self) -> dict[str, Any]:
        """Those of the detector."""
        return getattr(self.detector, "diagnostics", {})

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the detector and of the cache."""
        found = tuple(getattr(self.detector, "warnings", ()))
        if not self._failures:
            return found
        return (
            *found,
            f"{self.folder}: the cache failed {len(self._failures)} times "
            f"({self._failures[0]}), so the detector ran again; if this repeats, delete the folder",
        )

    def _open(self) -> diskcache.Cache:
        return _ClosedIfBroken(
            str(self.folder),
            disk=_WithoutPickles,
            size_limit=self._max_bytes,
            eviction_policy="least-recently-used",
        )

    def _digest(self, image: np.ndarray) -> str:
        facts = f"{self.fingerprint} {image.shape} {image.dtype}".encode()
        return hashlib.blake2b(facts + image.tobytes(), digest_size=16).hexdigest()

    def _read(self, image: np.ndarray) -> tuple[np.ndarray, Any] | None:
        """Stored output and diagnostics, or None if there are none or they are damaged."""
        try:
            with self._open() as cache:
                stored = cache.get(self._digest(image))
            if not isinstance(stored, bytes):
                return None
            with np.load(io.BytesIO(stored), allow_pickle=False) as entry:
                return entry["probability"], json.loads(str(entry["diagnostics"]))
        except Exception as error:  # of the file system, SQLite, diskcache, a damaged archive
            self._failures.append(brief(error))
            return None

    def _write(self, image: np.ndarray, probability: np.ndarray, diagnostics: Any) -> None:
        buffer = io.BytesIO()
        np.savez_compressed(buffer, probability=probability, diagnostics=json.dumps(diagnostics))
        try:
            with self._open() as cache:
                cache.set(self._digest(image), buffer.getvalue())
        except Exception as error:  # of the file system, SQLite, diskcache
            self._failures.append(brief(error))


class _ClosedIfBroken(diskcache.Cache):
    """A cache that does not leave the connection to a damaged database open."""

    def __init__(self, *args: Any, **options: Any):
        try:
            super().__init__(*args, **options)
        except Exception:
            self.close()
            raise


class _WithoutPickles(diskcache.Disk):
    """Storage of bytes; a pickle in the database counts as missing."""

    def fetch(self, mode: int, filename: str, value: Any, read: bool) -> Any:
        if mode == diskcache.core.MODE_PICKLE:
            return None
        return super().fetch(mode, filename, value, read)
