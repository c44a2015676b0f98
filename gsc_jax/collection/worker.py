"""The actors of a scan: its ledger, and two of a worker, which reads and which judges scenes.

The one that judges has a process of its own, which keeps compiled code and the network. It may be
killed by the timeout or by the kernel for memory; the next scene then starts another. While it
judges a scene, the other reads and identifies the next one, which is then in the page cache.
"""

import ctypes
import hashlib
import os
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from gsc_jax.cli.cache import enable_compilation_cache
from gsc_jax.cli.options import Locate
from gsc_jax.cli.outputs import jsonable
from gsc_jax.collection.judge import judge
from gsc_jax.collection.manifest import PLACES
from gsc_jax.collection.record import Row, complete, write_row
from gsc_jax.collection.settings import ScanSettings
from gsc_jax.io.files import GIB, content_bytes, content_digest
from gsc_jax.scene.parallel import compute_in_calling_thread, usable_cores

MAX_SCENES = 50
"""Scenes after which another process takes over, so that what libraries keep does not add up."""
# glibc returns large arrays to the system at once; else its arenas keep 50 MiB of each scene.
MALLOC = {"env_vars": {"MALLOC_MMAP_THRESHOLD_": str(2**20), "MALLOC_ARENA_MAX": "2"}}


class Claim(NamedTuple):
    """Answer to a claim: the number of the attempt, from 1, or who has this content already."""

    owner: str | None = None
    attempt: int = 1


class Ledger:
    """Actor that grants each content to one scene, and counts how often its judging has begun.

    One for the whole scan, so that a content is computed once wherever its copies are. It counts
    attempts that no worker has survived, such as those on a node that disappeared. `finished` are
    the ids of finished scenes by key, of an earlier scan, the first one for each.
    """

    def __init__(self, finished: Mapping[str, list[str]]) -> None:
        self._finished = {key: set(ids) for key, ids in finished.items()}
        self._owners = {key: ids[0] for key, ids in finished.items()}
        self._begun: Counter[str] = Counter()
        self._slots: dict[str, dict[str, int]] = {}

    def claim(self, key: str, scene: str) -> Claim:
        """Claim a content for a scene; the same scene may claim again, as after a lost node."""
        if scene in self._finished.get(key, ()):
            return Claim(owner=scene)
        if (owner := self._owners.setdefault(key, scene)) != scene:
            return Claim(owner=owner)
        self._begun[key] += 1
        return Claim(attempt=self._begun[key])

    def slot(self, node: str, worker: str) -> int:
        """Number of a worker on its node, from 0; a restarted worker keeps it."""
        slots = self._slots.setdefault(node, {})
        return slots.setdefault(worker, len(slots))


class SceneWorker:
    """Callable class for `ray.data.Dataset.map`: an entry of a manifest to the row of its scene.

    `configuration` is the digest of the settings, and `ledger` the handle of the actor of the scan.
    """

    def __init__(self, settings: ScanSettings, configuration: str, ledger: Any) -> None:
        import ray

        self._ray: Any = ray
        self._settings, self._configuration = settings, configuration
        self._ledger, self._busy = ledger, threading.Lock()
        context = ray.get_runtime_context()
        node, worker = context.get_node_id(), context.get_actor_id()
        known, count = usable_cores(), settings.cpus
        first = self._ray.get(ledger.slot.remote(node, worker)) * count
        # Its own cores, as long as there are enough.
        cores = [known[(first + i) % len(known)] for i in range(min(count, len(known)))]
        strategy = self._ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy
        actor = self._ray.remote(_Judge).options(
            num_cpus=0, scheduling_strategy=strategy(node, soft=False), runtime_env=MALLOC
        )
        self._started: Callable[[], Any] = lambda: actor.remote(cores, settings.cache)
        self._judge: Any = None
        self._scenes = 0

    def __call__(self, entry: Row) -> Row:
        """The row of a scene, which is written to the folder of results if there is one."""
        row = jsonable({k: None if v is None else str(v) for k, v in entry.items()})
        row |= {"id": row.get("id") or row["path"], "status": "judged", "key": "", "attempts": 1}
        row |= {"configuration": self._configuration, "version": metadata.version("gsc_jax")}
        with tempfile.TemporaryDirectory(prefix="gsc-jax-") as folder:
            try:
                places = self._fetched(entry, Path(folder))
                row |= _identified(places)
            except Exception as error:  # missing, unreadable, or an address without an answer
                row |= _failure(error, entry, type(error).__name__)
            else:
                claim = self._ray.get(self._ledger.claim.remote(row["key"], row["id"]))
                if claim.owner is None:
                    row |= self._judged(row, places, claim.attempt)
                elif claim.owner == row["id"]:
                    row["status"] = "finished"
                else:
                    row |= {"status": "duplicate", "duplicate_of": claim.owner}
        row = complete(jsonable(row))
        if self._settings.out is not None and row["status"] != "finished":
            write_row(self._settings.out, row)
        return row

    def _fetched(self, entry: Row, folder: Path) -> dict[str, Path | None]:
        """Scene, cameras and masks as local files; what an entry lacks is that of all scenes."""
        given = [entry.get(name) or self._settings.command.get(name) for name in PLACES]
        folders = [folder / name for name in PLACES]
        pool = ThreadPoolExecutor(1)
        try:
            places = pool.map(_local, given, folders, timeout=self._settings.timeout)
            return dict(zip(PLACES, places, strict=True))
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
                    return found | self._judged_once(command, above)
            except self._ray.exceptions.GetTimeoutError:
                text = f"took longer than {settings.timeout:g} s; allow more with --timeout"
                found |= _failure(text, row, "TimeoutError")
            except self._ray.exceptions.RayActorError:
                text = "its process was killed, most likely for memory; use fewer --workers"
                found |= _failure(text, row, "WorkerLost")
        return found or _failure("its worker was lost, with its node", row, "WorkerLost")

    def _judged_once(self, command: Row, above: float | None) -> Row:
        """Judge a scene in the process, which the next scene replaces if it is lost."""
        process, self._judge = self._judge or self._started(), None
        self._ray.get(process.__ray_ready__.remote())  # its start does not count
        judged = process.judge.remote(command, above)
        try:
            row = self._ray.get(judged, timeout=self._settings.timeout)
        except self._ray.exceptions.GetTimeoutError:
            self._ray.kill(process)
            raise
        self._scenes += 1
        if self._scenes % MAX_SCENES:  # else Ray ends the process, which nothing refers to
            self._judge = process
        return row


class _Judge:
    """Judges scenes on given cores, and stores compiled code in a folder if there is one."""

    def __init__(self, cores: Sequence[int], cache: Path | None) -> None:
        # The set of cores bounds the pool of onnxruntime, and `OMP_NUM_THREADS` those of NumPy.
        if hasattr(os, "sched_setaffinity"):  # Linux
            os.sched_setaffinity(0, cores)
        compute_in_calling_thread()
        if cache is not None:
            enable_compilation_cache(cache)

    def judge(self, command: Mapping[str, Any], above: float | None) -> Row:
        """Judge a scene, as `judge` does, by the options of `locate` under their names."""
        row = judge(Locate(**command), above)
        getattr(ctypes.CDLL(None), "malloc_trim", lambda _: None)(0)
        return row


def _local(place: str | Path | None, folder: Path) -> Path | None:
    """A path as it is; an address is downloaded into a folder."""
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
    suffixes = "".join(path.suffixes[-2:]).lower().lstrip(".")
    return {
        "key": hashlib.sha256(repr(sorted(digests.items())).encode()).hexdigest(),
        "sha256": digests["path"],
        "bytes": content_bytes(path),
        "format": "sog" if path.is_dir() else suffixes.removeprefix("point_cloud."),
    }


def _failure(error: Exception | str, entry: Row, kind: str) -> Row:
    late = "took longer than --timeout to fetch" if kind == "TimeoutError" else kind
    text = " ".join(str(getattr(error, "strerror", None) or error).split()) or late
    return {"error_class": kind, "error": f"{entry['path']}: {text}"}
