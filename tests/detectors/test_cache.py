"""Cached maps equal the computed ones, and a broken cache does not stop the detector."""

import pickle
import sqlite3
from pathlib import Path

import diskcache
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import camera

from gsc_jax.detectors.cache import CachedDetector

VIEW = camera()
IMAGE = np.random.default_rng(0).uniform(size=(120, 100, 3)).astype(np.float32)
"""Large enough for diskcache to store its map in a file of its own (32 KiB)."""

PICKLE = b"cbuiltins\nexec\n(Vraise SystemExit('unpickled')\ntR."


class RedChannel:
    """A detector that counts its calls; its map is the red channel."""

    needs_image = True

    def __init__(self):
        self.calls = 0
        self.diagnostics: dict[str, dict[str, int]] = {}

    def select(self, cameras):
        return list(cameras)

    def __call__(self, image, camera):
        self.calls += 1
        self.diagnostics[camera.name] = {"bright": int((image > 0.5).sum())}
        return image[..., 0]

    @property
    def warnings(self):
        return tuple(f"{name}: {counts['bright']}" for name, counts in self.diagnostics.items())


def value_files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.val"))


def test_second_call_returns_the_stored_map(tmp_path):
    detector = RedChannel()
    for _ in range(3):
        found = CachedDetector(detector, tmp_path, "key")(IMAGE, VIEW)
        np.testing.assert_array_equal(found, IMAGE[..., 0], strict=True)
    assert detector.calls == 1


def test_another_image_or_key_is_computed(tmp_path):
    detector = RedChannel()
    cached = CachedDetector(detector, tmp_path, "key")
    cached(IMAGE, VIEW)
    almost = IMAGE.copy()
    almost[0, 0, 0] = np.nextafter(almost[0, 0, 0], np.float32(1))
    for image in (almost, IMAGE.reshape(100, 120, 3), IMAGE[::-1]):
        np.testing.assert_array_equal(cached(image, VIEW), image[..., 0])
    assert detector.calls == 4
    CachedDetector(detector, tmp_path, "other key")(IMAGE, VIEW)
    assert detector.calls == 5
    cached(IMAGE.copy(), camera(width=3))
    assert detector.calls == 5, "the camera is part of the key"


def test_warnings_are_those_of_the_computing_run(tmp_path):
    detectors = RedChannel(), RedChannel()
    first, second = (CachedDetector(detector, tmp_path, "key") for detector in detectors)
    first(IMAGE, VIEW)
    second(IMAGE, VIEW)
    assert [detector.calls for detector in detectors] == [1, 0]
    assert first.warnings == second.warnings
    assert len(second.warnings) == 1


def test_detector_without_an_image_is_not_cached(tmp_path):
    class Masks(RedChannel):
        needs_image = False

        def __call__(self, image, camera):  # noqa: ARG002
            assert image is None
            return np.ones((2, 2), np.float32)

    cached = CachedDetector(Masks(), tmp_path / "cache", "key")
    assert cached.needs_image is False
    assert cached.select([VIEW]) == [VIEW]
    assert cached(None, VIEW).shape == (2, 2)
    assert not (tmp_path / "cache").exists()


@given(cut=st.integers(0, 50_000), at=st.integers(0, 50_000), byte=st.integers(0, 255))
def test_damaged_entry_is_computed_again(tmp_path_factory, cut, at, byte):
    folder, detector = tmp_path_factory.mktemp("cache"), RedChannel()
    CachedDetector(detector, folder, "key")(IMAGE, VIEW)
    (path,) = value_files(folder)
    damaged = bytearray(path.read_bytes())
    damaged = damaged[: len(damaged) - cut] if at % 2 else damaged
    if at < len(damaged):
        damaged[at] = byte
    path.write_bytes(damaged)
    cached = CachedDetector(detector, folder, "key")
    np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    assert len(cached.warnings) == detector.calls, "the failure is not a warning"
    CachedDetector(detector, folder, "key")(IMAGE, VIEW)
    assert detector.calls <= 2, "the entry was not replaced"


def test_pickles_are_never_loaded(tmp_path):
    with pytest.raises(SystemExit):
        pickle.loads(PICKLE)
    detector = RedChannel()
    cached = CachedDetector(detector, tmp_path, "key")
    cached(IMAGE, VIEW)
    value_files(tmp_path)[0].write_bytes(PICKLE)
    with sqlite3.connect(tmp_path / "cache.db") as database:
        database.execute("UPDATE Cache SET mode = ?", [diskcache.core.MODE_PICKLE])
    database.close()
    np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    assert detector.calls == 2


@pytest.mark.parametrize("broken", ["file", "database", "folder"])
def test_broken_cache_is_a_warning(tmp_path, broken):
    folder = tmp_path / "cache"
    if broken == "file":
        folder.touch()
    else:
        folder.mkdir()
        (folder / "cache.db").mkdir() if broken == "folder" else (folder / "cache.db").write_bytes(
            b"no database" * 100
        )
    detector = RedChannel()
    cached = CachedDetector(detector, folder, "key")
    for _ in range(2):
        np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    assert detector.calls == 2
    assert f"{folder}: the cache failed" in cached.warnings[-1]


def test_no_connection_to_a_damaged_database_stays_open(tmp_path, monkeypatch):
    """From Python 3.13 on, it is a ResourceWarning at a random later time."""
    connections, connect = [], sqlite3.connect

    def recorded(*args, **options) -> sqlite3.Connection:
        connections.append(connect(*args, **options))
        return connections[-1]

    monkeypatch.setattr(sqlite3, "connect", recorded)
    (tmp_path / "cache.db").write_bytes(b"no database" * 100)
    CachedDetector(RedChannel(), tmp_path, "key")(IMAGE, VIEW)
    assert connections
    for connection in connections:
        with pytest.raises(sqlite3.ProgrammingError, match="closed"):
            connection.execute("SELECT 1")


def test_least_recently_used_entries_are_evicted(tmp_path):
    images = np.random.default_rng(1).uniform(size=(30, 100, 100, 3)).astype(np.float32)
    detector = RedChannel()
    limit = 12 * images[0, ..., 0].nbytes
    cached = CachedDetector(detector, tmp_path, "key", max_bytes=limit)
    for image in images:
        cached(image, VIEW)
        cached(images[0], VIEW)
    size = sum(path.stat().st_size for path in value_files(tmp_path))
    assert size <= limit
    assert detector.calls == len(images), "a recently used entry was evicted"
    cached(images[-1], VIEW)
    assert detector.calls == len(images), "the newest entry was evicted"
    cached(images[1], VIEW)
    assert detector.calls == len(images) + 1, "no entry was evicted"
