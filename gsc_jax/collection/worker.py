"""The actor of a worker: it reads and identifies scenes, and a process of its own judges them.

The process keeps compiled code and the network. It may be killed, by the timeout or by the kernel
for memory. While it judges a scene, the actor reads the next one into the page cache.
"""

import hashlib
import importlib.metadata
import os
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from gsc_jax.collection.ledger import Claim
from gsc_jax.collection.process import SceneProcess
from gsc_jax.collection.record import Row, complete, write_row
from gsc_jax.collection.settings import ScanSettings
from gsc_jax.io.files import GIB, content_digest

UNREAD = ""
"""Key of a scene that cannot be read."""


class SceneWorker:
    """Callable class for `ray.data.Dataset.map`: an entry of a manifest to the row of its scene.

    Args:
        settings: Those of the scan.
        configuration: Their digest.
        claim: Asks the ledger of the scan; see `Ledger.claim`.
        slot: Asks it for a number of this worker on its machine.
    """

    def __init__(
        self,
        settings: ScanSettings,
        configuration: str,
        claim: Callable[[str, str], Claim],
        slot: Callable[[], int],
    ) -> None:
        self._settings, self._configuration, self._claim = settings, configuration, claim
        self._process = SceneProcess(_cores(slot(), settings.cpus), settings.cache)
        self._busy = threading.Lock()

    def __call__(self, entry: Row) -> Row:
        """The row of a scene, which is written to the folder of results if there is one."""
        row = {**entry, "key": UNREAD, "attempts": 1}
        row |= {"configuration": self._configuration, "status": "judged"}
        row["version"] = importlib.metadata.version("gsc_jax")
        with tempfile.TemporaryDirectory(prefix="gsc-jax-") as folder:
            try:
                places = self._within_timeout(_fetched, self._completed(entry), Path(folder))
                row |= _identified(places)
            except Exception as error:  # missing, unreadable, or an address without an answer
                row |= _failure(error, entry, type(error).__name__)
                places = {}
            claim = self._claim(row["key"], row["id"]) if places else Claim()
            if claim.owner is not None:
                row |= {"status": "finished" if claim.owner == row["id"] else "duplicate"}
                row["duplicate_of"] = None if claim.owner == row["id"] else claim.owner
            elif places:
                row |= self._judged(row, places, claim.attempt)
        row = complete(row)
        if self._settings.out is not None and row["status"] != "finished":
            write_row(self._settings.out, row)
        return row

    def _completed(self, entry: Row) -> Row:
        """The entry with the cameras and masks that are given for all scenes."""
        common = self._settings.command
        return entry | {k: entry.get(k) or common.get(k) for k in ("cameras", "masks")}

    def _within_timeout(self, function: Callable[..., Any], *args: Any) -> Any:
        pool = ThreadPoolExecutor(1)
        try:
            return pool.submit(function, *args).result(self._settings.timeout)
        finally:
            pool.shutdown(wait=False)

    def _judged(self, row: Row, places: dict[str, Path | None], first: int) -> Row:
        """Judge a scene as often as allowed, and name it in errors as the manifest does."""
        settings, found = self._settings, {}
        reports = (settings.out or Path(tempfile.gettempdir())) / "reports"
        command = {**settings.command, "memory": settings.worker_bytes / GIB, "dry_run": False}
        command |= {"scene": places["path"], "out": reports / row["key"][:32]}
        command |= {name: places[name] for name in ("cameras", "masks")}
        above = settings.report_above if settings.out else None
        for attempt in range(first, settings.retries + 2):
            found = {"attempts": attempt}
            try:
                with self._busy:
                    return found | self._process.judge(command, above, timeout=settings.timeout)
            except TimeoutError:
                text = f"took longer than {settings.timeout:g} s; allow more with --timeout"
                found |= _failure(text, row, "TimeoutError")
            except EOFError:
                text = "its process was killed, most likely for memory; use fewer --workers"
                found |= _failure(text, row, "WorkerLost")
        return found or _failure("its worker was lost, with its node", row, "WorkerLost")


def _cores(slot: int, count: int) -> list[int]:
    """The cores of a worker: its own as long as there are enough."""
    affinity = getattr(os, "sched_getaffinity", None)
    known = sorted(affinity(0)) if affinity else list(range(os.cpu_count() or 1))
    return [known[(slot * count + index) % len(known)] for index in range(min(count, len(known)))]


def _fetched(entry: Row, folder: Path) -> dict[str, Path | None]:
    """The scene, cameras and masks of an entry as local files; an address is downloaded."""
    return {name: _local(entry.get(name), folder / name) for name in ("path", "cameras", "masks")}


def _local(place: str | Path | None, folder: Path) -> Path | None:
    if not isinstance(place, str) or "://" not in place:
        return Path(place) if place else None
    import fsspec

    folder.mkdir(exist_ok=True)
    path = folder / (place.split("?")[0].rstrip("/").rpartition("/")[2] or "scene.ply")
    filesystem, remote = fsspec.url_to_fs(place)
    filesystem.get(remote, str(path), recursive=filesystem.isdir(remote))
    return path


def _identified(places: dict[str, Path | None]) -> Row:
    """Digests, size and format; reading the scene brings it into the page cache."""
    digests = {name: content_digest(path) for name, path in places.items() if path}
    path = places["path"]
    assert path is not None
    return {
        "key": hashlib.sha256(repr(sorted(digests.items())).encode()).hexdigest(),
        "sha256": digests["path"],
        "bytes": path.stat().st_size,
        "format": "".join(path.suffixes[-2:]).lower().lstrip(".").removeprefix("point_cloud."),
    }


def _failure(error: Exception | str, entry: Row, kind: str) -> Row:
    text = " ".join(str(getattr(error, "strerror", None) or error).split()) or kind
    return {"error_class": kind, "error": f"{entry['path']}: {text}"}
