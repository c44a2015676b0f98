"""The cache of detector outputs: a second look costs no network run and changes nothing."""

import json
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper
from strategies import camera

from gsc_jax.detectors.cache import CachedDetector
from gsc_jax.detectors.onnx import OnnxDetector, OnnxSpec
from gsc_jax.scene import InputError

VIEW = camera()
IMAGE = np.random.default_rng(0).uniform(size=(6, 8, 3)).astype(np.float32)


class Counting:
    """A network that counts what it is shown; its map is the red channel."""

    needs_image = True

    def __init__(self):
        self.runs = 0
        self.notes: dict[str, dict[str, int]] = {}

    def select(self, cameras):
        return list(cameras)

    def __call__(self, image, camera):
        self.runs += 1
        self.notes[camera.name] = {"bright": int((image > 0.5).sum())}
        return image[..., 0]

    @property
    def warnings(self):
        return tuple(f"{name}: {note['bright']}" for name, note in self.notes.items())


def entries(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def test_a_second_run_asks_no_network_and_says_the_same(tmp_path):
    network = Counting()
    said = [CachedDetector(network, tmp_path, "key")(IMAGE, VIEW) for _ in range(3)]
    assert network.runs == 1
    for again in said:
        np.testing.assert_array_equal(again, IMAGE[..., 0], strict=True)


def test_another_image_key_or_camera(tmp_path):
    network = Counting()
    cached = CachedDetector(network, tmp_path, "key")
    cached(IMAGE, VIEW)
    almost = IMAGE.copy()
    almost[0, 0, 0] = np.nextafter(almost[0, 0, 0], np.float32(1))
    for image in (almost, IMAGE.reshape(8, 6, 3), IMAGE[::-1]):
        np.testing.assert_array_equal(cached(image, VIEW), image[..., 0])
    assert network.runs == 4
    CachedDetector(network, tmp_path, "other key")(IMAGE, VIEW)
    assert network.runs == 5
    cached(IMAGE.copy(), camera(width=3))
    assert network.runs == 5, "a camera says nothing that the image does not"


def test_warnings_are_those_of_a_run_that_looked(tmp_path):
    networks = Counting(), Counting()
    first, second = (CachedDetector(network, tmp_path, "key") for network in networks)
    first(IMAGE, VIEW)
    second(IMAGE, VIEW)
    assert [network.runs for network in networks] == [1, 0]
    assert first.warnings == second.warnings
    assert len(second.warnings) == 1


def test_what_looks_at_no_image_is_not_kept(tmp_path):
    class Masks(Counting):
        needs_image = False

        def __call__(self, image, camera):
            assert image is None, f"{camera.name} was rendered"
            return np.ones((2, 2), np.float32)

    cached = CachedDetector(Masks(), tmp_path / "cache", "key")
    assert cached.needs_image is False
    assert cached.select([VIEW]) == [VIEW]
    assert cached(None, VIEW).shape == (2, 2)
    assert not (tmp_path / "cache").exists()


@given(cut=st.integers(0, 700), at=st.integers(0, 700), byte=st.integers(0, 255))
def test_damaged_entries_are_computed_anew(tmp_path_factory, cut, at, byte):
    """Whatever was done to the file, the answer is that of the network."""
    folder, network = tmp_path_factory.mktemp("cache"), Counting()
    CachedDetector(network, folder, "key")(IMAGE, VIEW)
    (path,) = entries(folder)
    damaged = bytearray(path.read_bytes())
    damaged = damaged[: len(damaged) - cut] if at % 2 else damaged
    if at < len(damaged):
        damaged[at] = byte
    path.write_bytes(damaged)
    cached = CachedDetector(network, folder, "key")
    np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    assert len(cached.warnings) == network.runs
    CachedDetector(network, folder, "key")(IMAGE, VIEW)
    assert network.runs <= 2, "the entry was not replaced"


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04"])
def test_damage_is_counted(tmp_path, content):
    network = Counting()
    cached = CachedDetector(network, tmp_path, "key")
    cached(IMAGE, VIEW)
    entries(tmp_path)[0].write_bytes(content)
    cached(IMAGE, VIEW)
    assert network.runs == 2
    assert f"{tmp_path}: 1 damaged" in cached.warnings[-1]


def test_a_cache_that_cannot_be_written_stops_nobody(tmp_path):
    (tmp_path / "file").touch()
    network = Counting()
    cached = CachedDetector(network, tmp_path / "file", "key")
    for _ in range(2):
        np.testing.assert_array_equal(cached(IMAGE, VIEW), IMAGE[..., 0])
    assert network.runs == 2
    assert "cannot be written" in cached.warnings[-1]


def test_what_the_detector_refuses_is_not_kept(tmp_path):
    class Broken(Counting):
        def __call__(self, image, camera):
            raise InputError(f"no map of {camera.name} of {image.shape}")

    with pytest.raises(InputError, match="no map"):
        CachedDetector(Broken(), tmp_path, "key")(IMAGE, VIEW)
    assert entries(tmp_path) == []


def test_the_folder_is_bounded_and_keeps_what_was_used_last(tmp_path):
    images = np.random.default_rng(1).uniform(size=(40, 6, 8, 3)).astype(np.float32)
    network = Counting()
    CachedDetector(network, tmp_path, "key")(images[0], VIEW)
    size = entries(tmp_path)[0].stat().st_size
    cached = CachedDetector(network, tmp_path, "key", limit=10 * size)
    for image in images:
        cached(image, VIEW)
        cached(images[0], VIEW)
        assert sum(path.stat().st_size for path in entries(tmp_path)) <= 10 * size
    assert network.runs == len(images), "what is used all the time was dropped"
    cached(images[-1], VIEW)
    assert network.runs == len(images), "the last one was dropped"
    cached(images[1], VIEW)
    assert network.runs == len(images) + 1, "nothing was dropped"


def test_a_network_keeps_its_warnings(tmp_path):
    path = tmp_path / "net.onnx"
    values = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, channels, "H", "W"))
        for name, channels in (("image", 3), ("map", 3))
    ]
    graph = helper.make_graph(
        [helper.make_node("Log", ["image"], ["map"])], "g", values[:1], values[1:]
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)
    image = np.full((4, 4, 3), np.e, np.float32)
    image[0] = -1
    said = []
    for _ in range(2):
        detector = OnnxDetector(path, OnnxSpec(channel=0), threads=1)
        assert detector.fingerprint != OnnxDetector(path, OnnxSpec(channel=1)).fingerprint
        cached = CachedDetector(detector, tmp_path / "cache", detector.fingerprint)
        said.append((cached(image, VIEW).tolist(), cached.warnings))
    assert said[0] == said[1]
    assert "4 outputs in 1 of 1 views" in json.dumps(said[1][1])
