"""Arrays of the views of a run: in memory up to a bound, in files beyond it.

A store in a given folder keeps everything in files, so that a run that was killed can be continued:
what is in the store is complete, and need not be computed again.
"""

import contextlib
import hashlib
import shutil
import tempfile
import threading
import uuid
import weakref
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from gsc_jax.scene import InputError

MAX_BYTES_IN_MEMORY = 2**30
"""Arrays up to this size in total are kept in memory: a small part of today's machines."""


class ArrayStore:
    """Arrays by kind and name of a view.

    A store serves one scene, its cameras and one detector. Threads may add arrays, each once.

    Args:
        folder: A folder for all arrays, created if missing; None for a temporary one (TMPDIR
            selects where), which is used only beyond `max_bytes` and removed with the store.
        max_bytes: Size of the arrays in memory, and of the evidence that `observe` may expand.
    """

    def __init__(self, folder: Path | None = None, *, max_bytes: int = MAX_BYTES_IN_MEMORY) -> None:
        self.max_bytes = max_bytes
        self._folder = folder
        self._in_memory: dict[str, np.ndarray] = {}
        self._free = max_bytes if folder is None else -1
        self._lock = threading.Lock()

    def has(self, kind: str, name: str) -> bool:
        """Whether the store holds an array; a file that is incomplete or damaged does not count.

        The digest at the end of a file is checked here, and not by `get`.
        """
        key, folder = _key(kind, name), self._folder
        with contextlib.suppress(OSError, ValueError):
            return key in self._in_memory or bool(folder and _intact(folder / f"{key}.npy"))
        return False

    def get(self, kind: str, name: str) -> np.ndarray:
        """An array, memory-mapped if it lies in a file; raises OSError if it is missing."""
        if (key := _key(kind, name)) in self._in_memory:
            return self._in_memory[key]
        assert self._folder is not None, f"nothing was stored as {key}"
        return np.load(self._folder / f"{key}.npy", mmap_mode="r", allow_pickle=False)

    def put(self, kind: str, name: str, array: np.ndarray) -> None:
        """Add an array, which must not change afterwards; raises InputError if a disk is full."""
        key = _key(kind, name)
        with self._lock:
            if array.nbytes <= self._free:
                self._free -= array.nbytes
                self._in_memory[key] = array
                return
        try:
            folder = self._open()
            partial = folder / f".{uuid.uuid4().hex}.npy"  # other runs may write the same array
            with partial.open("w+b") as file:
                np.save(file, array)
                file.seek(0)
                file.write(hashlib.file_digest(file, "blake2b").digest())
            partial.replace(folder / f"{key}.npy")
        except OSError as error:
            raise InputError(
                f"{self._folder or tempfile.gettempdir()}: cannot store the evidence and masks of "
                f"the views ({error.strerror or error}); free space, set TMPDIR or --out to "
                "another disk, or use fewer views"
            ) from error

    def release(self, kind: str) -> None:
        """Free the memory of all arrays of a kind, which are not needed any more."""
        with self._lock:
            for key in [key for key in self._in_memory if key.startswith(f"{kind}-")]:
                self._free += self._in_memory.pop(key).nbytes

    def _open(self) -> Path:
        """The folder, created when it is first needed."""
        with self._lock:
            if self._folder is None:
                self._folder = Path(tempfile.mkdtemp(prefix="gsc-jax-"))
                weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
            self._folder.mkdir(parents=True, exist_ok=True)
            return self._folder


def _intact(path: Path) -> bool:
    """Whether a file ends with the digest of all that is before it, which NumPy ignores."""
    content = np.memmap(path, np.uint8, mode="r")
    size = hashlib.blake2b().digest_size
    return hashlib.blake2b(content[:-size].data).digest() == content[-size:].tobytes()


def _key(kind: str, name: str) -> str:
    """A file name: names of views may be long, or differ only in case."""
    return f"{kind}-{hashlib.blake2b(name.encode(), digest_size=12).hexdigest()}"


class ByView(Mapping[str, np.ndarray]):
    """A read-only mapping from the name of a view to an array that is read when it is asked for."""

    def __init__(self, names: tuple[str, ...], read: Callable[[str], np.ndarray]) -> None:
        self._names = {name: name for name in names}
        self._read = read

    def __getitem__(self, name: str) -> np.ndarray:
        return self._read(self._names[name])

    def __reduce__(self) -> tuple[type, tuple[dict[str, np.ndarray]]]:
        """Pickled as a dictionary, since files may not last."""
        return dict, (dict(self),)

    def __iter__(self) -> Iterator[str]:
        """Names in the order of the views."""
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
