"""Cached maps equal the computed ones, and a broken cache does not stop the detector."""

import hashlib
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from strategies import camera

from gsc_jax.detectors.cache import CachedDetector

VIEW = camera()
IMAGE = np.random.default_rng(0).uniform(size=(120, 100, 3)).astype(np.float32)


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
    return sorted(folder.glob("*.npy"))


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
    path = value_files(folder)[at % 3 == 0]
    damaged = bytearray(path.read_bytes())
    damaged = damaged[: len(damaged) - cut] if at % 2 else damaged
    if at < len(damaged):
        damaged[at] = byte
    path.write_bytes(damaged)
    cached = CachedDetector(detector, folder, "key")
    np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    CachedDetector(detector, folder, "key")(IMAGE, VIEW)
    assert detector.calls <= 2, "the entry was not replaced"


def test_pickles_are_never_loaded(tmp_path):
    detector = RedChannel()
    cached = CachedDetector(detector, tmp_path, "key")
    cached(IMAGE, VIEW)
    for path in value_files(tmp_path):  # with a valid digest at its end
        np.save(path, np.array([{}]), allow_pickle=True)
        path.write_bytes(path.read_bytes() + hashlib.blake2b(path.read_bytes()).digest())
    np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    assert detector.calls == 2


def test_broken_cache_is_a_warning(tmp_path):
    folder, detector = tmp_path / "cache", RedChannel()
    folder.touch()
    cached = CachedDetector(detector, folder, "key")
    for _ in range(2):
        np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    assert detector.calls == 2
    assert f"{folder}: the cache failed 2 times" in cached.warnings[-1]


def test_the_oldest_entries_are_evicted(tmp_path):
    images = np.random.default_rng(1).uniform(size=(30, 100, 100, 3)).astype(np.float32)
    detector = RedChannel()
    limit = 12 * images[0, ..., 0].nbytes
    cached = CachedDetector(detector, tmp_path, "key", max_bytes=limit)
    for image in images:
        cached(image, VIEW)
    assert sum(path.stat().st_size for path in value_files(tmp_path)) <= limit
    for image in images[-9:]:
        cached(image, VIEW)
    assert detector.calls == len(images), "a new entry was evicted"
    cached(images[1], VIEW)
    assert detector.calls == len(images) + 1, "no entry was evicted"
