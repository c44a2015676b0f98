"""The actor of a worker: it reads and identifies scenes, and a process of its own judges them.

The process keeps compiled code and the network. It is the one that is killed, by the timeout or by
the kernel for memory, and the actor starts another. While it judges a scene, another thread of the
actor reads and identifies the next one, so that its content is in the page cache by then.
"""

import contextlib
import hashlib
import importlib.metadata
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from gsc_jax.collection.ledger import Claim
from gsc_jax.collection.record import Row, complete, write_row
from gsc_jax.collection.settings import ScanSettings, content_digest

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
                places = self._within_timeout(_fetched, entry, Path(folder))
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

    def _within_timeout(self, function: Callable[..., Any], *args: Any) -> Any:
        pool = ThreadPoolExecutor(1)
        try:
            return pool.submit(function, *args).result(self._settings.timeout)
        finally:
            pool.shutdown(wait=False)

    def _judged(self, row: Row, places: dict[str, Path | None], first: int) -> Row:
        """Judge a scene as often as allowed, and name it in errors as the manifest does."""
        from gsc_jax.cli.options import Locate
        from gsc_jax.collection.judge import judge

        settings, found = self._settings, {}
        reports = (settings.out or Path(tempfile.gettempdir())) / "reports"
        given = {name: place for name, place in places.items() if place and name != "path"}
        memory = settings.worker_bytes / 2**30
        command = {**settings.command, **given, "memory": memory, "dry_run": False, "config": None}
        command |= {"scene": places["path"], "out": reports / row["key"][:32]}
        above = settings.report_above if settings.out else None
        for attempt in range(first, settings.retries + 2):
            found = {"attempts": attempt}
            try:
                with self._busy:
                    return found | self._process.run(
                        judge, Locate(**command), above, timeout=settings.timeout
                    )
            except TimeoutError:
                text = f"took longer than {settings.timeout:g} s; allow more with --timeout"
                found |= _failure(text, row, "TimeoutError")
            except BrokenExecutor:
                text = "its process was killed, most likely for memory; use fewer --workers"
                found |= _failure(text, row, "WorkerLost")
        return found or _failure("its worker was lost, with its node", row, "WorkerLost")


class SceneProcess:
    """A process that is started when it is needed, and killed if a call takes too long.

    Args:
        cores: Cores that it may use: the threads of XLA, NumPy and onnxruntime stay on them.
        cache: Folder of the persistent compilation cache; None for none.
    """

    def __init__(self, cores: Sequence[int], cache: Path | None) -> None:
        self._cores, self._cache = cores, cache
        self._pool: ProcessPoolExecutor | None = None
        self._pid = 0

    def run(self, function: Callable[..., Row], *args: Any, timeout: float) -> Row:
        """Call a function in the process; the time to start it does not count.

        Raises:
            TimeoutError: after `timeout` seconds.
            BrokenExecutor: if the process died.
        """
        try:
            if self._pool is None:
                self._start()
            assert self._pool is not None
            return self._pool.submit(function, *args).result(timeout)
        except (TimeoutError, BrokenExecutor):
            self.kill()
            raise

    def kill(self) -> None:
        """Kill the process; the next call starts another."""
        if self._pool is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = None

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, _begin, (self._cache,))
        with _on_cores(self._cores):  # the process inherits them
            started = self._pool.submit(os.getpid)
        self._pid = started.result()


@contextlib.contextmanager
def _on_cores(cores: Sequence[int]) -> Iterator[None]:
    if not hasattr(os, "sched_setaffinity"):  # Linux only
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _begin(cache: Path | None) -> None:
    """Prepare the process: it ends with its actor, and the kernel kills it rather than the actor."""
    from gsc_jax.cli.cache import enable_compilation_cache

    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", "ascii")
    if cache is not None:
        enable_compilation_cache(cache)
    import gsc_jax.collection.judge  # noqa: F401


def _cores(slot: int, count: int) -> list[int]:
    """The cores of a worker: its own as long as there are enough."""
    affinity = getattr(os, "sched_getaffinity", None)
    known = sorted(affinity(0)) if affinity else list(range(os.cpu_count() or 1))
    return [known[(slot * count + index) % len(known)] for index in range(min(count, len(known)))]


def _fetched(entry: Row, folder: Path) -> dict[str, Path | None]:
    """The scene, cameras and masks of an entry as local files; an address is downloaded."""
    return {name: _local(entry.get(name), folder / name) for name in ("path", "cameras", "masks")}


def _local(place: str | None, folder: Path) -> Path | None:
    if not place or "://" not in place:
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
