"""Cache of the probability maps of a detector, on disk, by the rendered image.

The key is a digest of the detector's options and of all bits of the image: rendering is
reproducible to the bit on one machine. Every file ends with a digest of its content; a damaged one
is computed again. If the cache fails, there is a warning and the detector runs.
"""

import contextlib
import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.evidence.detector import Detector
from gsc_jax.evidence.observation import DIAGNOSTICS, MAP
from gsc_jax.evidence.storage import ArrayStore
from gsc_jax.io.validation import brief
from gsc_jax.scene import Camera

MAX_BYTES = 2 * 2**30  # about 500 maps of a megapixel, 4 MiB each


class CachedDetector:
    """A detector whose outputs are stored between runs, with its `diagnostics` of each view.

    Nothing is cached if the detector does not need the image.
    """

    def __init__(
        self, detector: Detector, folder: str | Path, key: str, *, max_bytes: int = MAX_BYTES
    ):
        """Configure a cache in a folder of its own, which is created when it is first used.

        The key identifies the detector and its options; above `max_bytes`, the oldest are removed.
        """
        self.detector = detector
        self.folder = Path(folder)
        self.needs_image = detector.needs_image
        self.fingerprint = key
        self._store = ArrayStore(self.folder)
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
        facts = f"{self.fingerprint} {image.shape} {image.dtype}".encode()
        name = hashlib.blake2b(facts + image.tobytes(), digest_size=16).hexdigest()
        with self._failing_softly():
            if all(self._store.has(kind, name) for kind in (MAP, DIAGNOSTICS)):
                if (counts := json.loads(bytes(self._store.get(DIAGNOSTICS, name)))) is not None:
                    self.diagnostics[camera.name] = counts
                return np.array(self._store.get(MAP, name))
        probability = np.asarray(self.detector(image, camera), np.float32)
        counts = json.dumps(self.diagnostics.get(camera.name)).encode()
        with self._failing_softly():
            self._store.put(MAP, name, probability)
            self._store.put(DIAGNOSTICS, name, np.frombuffer(counts, np.uint8))
            with contextlib.suppress(FileNotFoundError):  # another run removes files, too
                files = [(path.stat(), path) for path in self.folder.glob("*.npy")]
                files.sort(key=lambda entry: -entry[0].st_mtime_ns)
                sizes = np.cumsum([stat.st_size for stat, _ in files])
                for (_, path), size in zip(files, sizes, strict=True):
                    if size > self._max_bytes:
                        path.unlink(missing_ok=True)
        return probability

    @property
    def diagnostics(self) -> dict[str, Any]:
        """The `diagnostics` of the detector, by camera name."""
        return getattr(self.detector, "diagnostics", {})

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the detector and of the cache."""
        found = tuple(getattr(self.detector, "warnings", ()))
        if self._failures:
            text = f"the cache failed {len(self._failures)} times ({self._failures[0]})"
            text += ", so the detector ran again; if this repeats, delete the folder"
            found = (*found, f"{self.folder}: {text}")
        return found

    @contextlib.contextmanager
    def _failing_softly(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:
            self._failures.append(brief(error))
