"""Loading models: external tensors, execution providers, threads and refused files."""

import numpy as np
import onnxruntime
import pytest
from onnx_models import WEIGHTS, external_data, external_model, network

from gsc_jax.detectors.session import open_session, provider_names
from gsc_jax.scene import InputError


def refused(path) -> str:
    with pytest.raises(InputError) as caught:
        open_session(path, threads=1)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("location", ["w.bin", "sub/w.bin", "sub/../w.bin"])
def test_external_data_beside_the_model_are_read(tmp_path, location):
    external_data(tmp_path / "sub" / "w.bin")
    external_data(tmp_path / "w.bin")
    session = open_session(external_model(tmp_path, location), threads=1)
    (found,) = session.run(None, {"x": WEIGHTS})
    np.testing.assert_array_equal(found, 2 * WEIGHTS)


@pytest.mark.parametrize(
    "location",
    ["{secret}", "../secret.bin", "link.bin", "linked/secret.bin", "loop.bin", "C:secret.bin"],
)
def test_external_data_outside_the_folder_are_refused(tmp_path, location):
    """Onnxruntime refuses them from version 1.27, the minimum in pyproject.toml."""
    secret, folder = external_data(tmp_path / "secret.bin"), tmp_path / "model"
    folder.mkdir()
    (folder / "link.bin").symlink_to(secret)
    (folder / "linked").symlink_to(tmp_path)
    (folder / "loop.bin").symlink_to(folder / "loop.bin")
    path = external_model(folder, location.format(secret=secret))
    assert "external tensors in the same folder" in refused(path)


@pytest.mark.parametrize("location", ["{secret}", "../secret.bin", "link.bin"])
@pytest.mark.parametrize("place", ["sparse", "constant", "branch", "function"])
def test_external_data_of_other_tensors_are_refused(tmp_path, place, location):
    """All places of a tensor other than the initializers of the main graph."""
    secret, folder = external_data(tmp_path / "secret.bin"), tmp_path / "model"
    folder.mkdir()
    (folder / "link.bin").symlink_to(secret)
    path = external_model(folder, location.format(secret=secret), place=place)
    assert "external tensors in the same folder" in refused(path)
    external_data(folder / "inside.bin")
    session = open_session(external_model(folder, "inside.bin", place=place), threads=1)
    np.testing.assert_array_equal(session.run(None, {"x": WEIGHTS})[0], 2 * WEIGHTS)


@pytest.mark.parametrize("location", ["nope.bin", "", "sub", "short.bin", "*/_ORT_MEM_ADDR_/*"])
def test_invalid_external_data_are_refused(tmp_path, location):
    (tmp_path / "sub").mkdir()
    (tmp_path / "short.bin").write_bytes(b"short")
    assert "cannot load" in refused(external_model(tmp_path, location))


def test_linked_model_has_its_data_beside_the_link_or_its_target(tmp_path):
    """The cache of a model hub consists of links into one folder."""
    blobs, snapshot = tmp_path / "blobs", tmp_path / "snapshot"
    external_data(blobs / "abc")
    external_model(blobs, "w.bin").rename(blobs / "def")
    snapshot.mkdir()
    (snapshot / "net.onnx").symlink_to(blobs / "def")
    (snapshot / "w.bin").symlink_to(blobs / "abc")
    assert open_session(snapshot / "net.onnx", threads=1).get_inputs()[0].name == "x"


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("missing.onnx", None, "no such file"),
        (".", None, "is a folder"),
        ("empty.onnx", b"", "cannot load"),
        ("text.onnx", b"text", "cannot load"),
    ],
)
def test_invalid_files_are_refused(tmp_path, name, content, reason):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert reason in refused(tmp_path / name)


def test_suffix_does_not_select_another_format(tmp_path):
    path = network(tmp_path).rename(tmp_path / "net.ort")
    assert open_session(path, threads=1).get_inputs()[0].name == "image"


def test_unavailable_provider_is_refused(monkeypatch):
    names = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: names)
    assert provider_names(["cuda", "CPUExecutionProvider"]) == names
    with pytest.raises(InputError, match="no provider 'tpu' here, expected one of cuda, cpu;"):
        provider_names(["cuda", "tpu"])


def test_provider_that_does_not_start_is_refused(tmp_path, monkeypatch, capfd):
    """A CUDA build of onnxruntime without a driver uses the CPU silently."""
    names = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    original = onnxruntime.InferenceSession

    def on_the_cpu(path, options, providers, **kwargs):
        assert providers == names[:1]
        return original(path, options, providers=["CPUExecutionProvider"])

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: names)
    monkeypatch.setattr(onnxruntime, "InferenceSession", on_the_cpu)
    with pytest.raises(InputError, match=r"could not start CUDAExecutionProvider.*CPUExec"):
        open_session(network(tmp_path), providers=["cuda"])
    assert capfd.readouterr() == ("", "")


def test_negative_threads_are_refused(tmp_path):
    with pytest.raises(InputError, match="-1 threads"):
        open_session(network(tmp_path), threads=-1)
