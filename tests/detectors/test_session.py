"""Opening models: what they read besides themselves, on what they run, and all that is refused."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper

from gsc_jax.detectors.external import LEADS_TO, external_files
from gsc_jax.detectors.session import fingerprint, open_session, provider_names
from gsc_jax.scene import InputError

WEIGHTS = np.full((4, 4), 7, np.float32)


def external_tensor(location: str) -> TensorProto:
    tensor = TensorProto(
        name="w", data_type=TensorProto.FLOAT, dims=WEIGHTS.shape, data_location="EXTERNAL"
    )
    for key, value in {"offset": "0", "location": location, "length": "64"}.items():
        entry = tensor.external_data.add()
        entry.key, entry.value = key, value
    return tensor


def value_info(name: str) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, WEIGHTS.shape)


def graph_of(*nodes: onnx.NodeProto, given: str, tensors=()) -> onnx.GraphProto:
    inputs = [value_info("x")] if given else []
    return helper.make_graph(list(nodes), "g", inputs, [value_info("y")], initializer=list(tensors))


def as_initializer(tensor: TensorProto) -> onnx.GraphProto:
    return graph_of(helper.make_node("Add", ["x", "w"], ["y"]), given="x", tensors=[tensor])


def as_constant(tensor: TensorProto) -> onnx.GraphProto:
    constant = helper.make_node("Constant", [], ["w"], value=tensor)
    return graph_of(constant, helper.make_node("Add", ["x", "w"], ["y"]), given="x")


def in_a_branch(tensor: TensorProto) -> onnx.GraphProto:
    branch = graph_of(helper.make_node("Add", ["x", "w"], ["y"]), given="", tensors=[tensor])
    yes = helper.make_tensor("c", TensorProto.BOOL, [], [True])
    node = helper.make_node("If", ["c"], ["y"], then_branch=branch, else_branch=branch)
    return graph_of(node, given="x", tensors=[yes])


PLACES = (as_initializer, as_constant, in_a_branch)


def model(folder: Path, location: str, *, place=as_initializer) -> Path:
    """A model that adds a tensor of another file to its input."""
    folder.mkdir(parents=True, exist_ok=True)
    opset = [helper.make_opsetid("", 17)]
    found = helper.make_model(place(external_tensor(location)), opset_imports=opset, ir_version=8)
    (folder / "net.onnx").write_bytes(found.SerializeToString())
    return folder / "net.onnx"


def data(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(WEIGHTS.tobytes())
    return path


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_session(path, threads=1)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


# Files beside the model


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("location", ["w.bin", "sub/w.bin", "sub/../w.bin"])
def test_data_beside_a_model_are_read(tmp_path, place, location):
    data(tmp_path / "sub" / "w.bin")
    data(tmp_path / "w.bin")
    path = model(tmp_path, location, place=place)
    assert external_files(path) == [(tmp_path / location).resolve()]
    (found,) = open_session(path, threads=1).run(None, {"x": WEIGHTS})
    np.testing.assert_array_equal(found, 2 * WEIGHTS)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["absolute", "up", "link", "linked folder", "loop", "drive"])
def test_data_outside_of_the_folder_are_refused(tmp_path, place, kind):
    secret, folder = data(tmp_path / "secret.bin"), tmp_path / "model"
    folder.mkdir()
    (folder / "link.bin").symlink_to(secret)
    (folder / "linked").symlink_to(tmp_path)
    (folder / "loop.bin").symlink_to(folder / "loop.bin")
    location = {
        "absolute": str(secret),
        "up": "../secret.bin",
        "link": "link.bin",
        "linked folder": "linked/secret.bin",
        "loop": "loop.bin",
        "drive": "C:secret.bin",
    }[kind]
    path = model(folder, location, place=place)
    message = refused(path)
    assert repr(location) in message
    assert ("in its own folder" if kind != "loop" else "tensors in") in message
    with pytest.raises(InputError):
        fingerprint(path)


def test_an_absolute_path_into_the_own_folder_is_refused(tmp_path):
    inside = data(tmp_path / "w.bin")
    assert "in its own folder" in refused(model(tmp_path, str(inside)))


def test_the_check_comes_before_the_runtime(tmp_path, monkeypatch):
    def opened(*args, **kwargs):
        raise AssertionError("the runtime was asked")

    monkeypatch.setattr(onnxruntime, "InferenceSession", opened)
    data(tmp_path / "secret.bin")
    refused(model(tmp_path / "model", "../secret.bin"))


@pytest.mark.parametrize("location", ["nope.bin", "", "sub", "*/_ORT_MEM_ADDR_/*"])
def test_missing_data_are_named(tmp_path, location):
    (tmp_path / "sub").mkdir()
    message = refused(model(tmp_path, location))
    assert f"tensors in {location!r}" in message
    assert "no such file beside it" in message


def test_data_that_are_cut_off_are_refused(tmp_path):
    (tmp_path / "w.bin").write_bytes(b"short")
    assert "cannot load" in refused(model(tmp_path, "w.bin"))


def test_a_model_that_is_a_link_has_its_data_beside_either(tmp_path):
    """As in the cache of a hub, whose files are links into one folder."""
    blobs, snapshot = tmp_path / "blobs", tmp_path / "snapshot"
    data(blobs / "abc")
    model(blobs, "w.bin").rename(blobs / "def")
    snapshot.mkdir()
    (snapshot / "net.onnx").symlink_to(blobs / "def")
    (snapshot / "w.bin").symlink_to(blobs / "abc")
    assert external_files(snapshot / "net.onnx") == [blobs.resolve() / "abc"]
    assert open_session(snapshot / "net.onnx", threads=1).get_inputs()[0].name == "x"


def test_the_walk_leads_along_every_field_that_can_hold_a_tensor():
    """Held against the definitions of the onnx package."""
    types = onnx.ModelProto.DESCRIPTOR.file.message_types_by_name
    leading = {"StringStringEntryProto"}
    found: dict[str, dict[int, str]] = {}
    wanted = {"TensorProto": {13: "StringStringEntryProto"}}
    while wanted != found:
        found, leading = wanted, {*wanted}
        wanted = {"TensorProto": found["TensorProto"]}
        for name, kind in types.items():
            fields = {
                field.number: field.message_type.name
                for field in kind.fields
                if field.message_type and field.message_type.name in leading
            }
            if fields:
                wanted[name] = fields
    assert found == LEADS_TO


@given(cut=st.integers(0, 200), at=st.integers(0, 200), byte=st.integers(0, 255))
def test_damaged_models_are_refused_or_lead_nowhere_else(tmp_path_factory, cut, at, byte):
    folder = tmp_path_factory.mktemp("damaged")
    data(folder / "w.bin")
    path = model(folder, "w.bin")
    damaged = bytearray(path.read_bytes()[:cut])
    if at < len(damaged):
        damaged[at] = byte
    path.write_bytes(damaged)
    try:
        found = external_files(path)
    except InputError:
        return
    assert found in ([], [(folder / "w.bin").resolve()])


def test_no_folder_is_needed_where_nothing_is_external(tmp_path):
    path = tmp_path / "net.onnx"
    node = helper.make_node("Identity", ["x"], ["y"])
    found = helper.make_model(
        graph_of(node, given="x"), opset_imports=[helper.make_opsetid("", 17)], ir_version=8
    )
    path.write_bytes(found.SerializeToString())
    assert external_files(path) == []
    # A suffix that onnxruntime takes for its own format.
    assert open_session(path.rename(tmp_path / "net.ort"), threads=1).get_inputs()[0].name == "x"


# Providers and threads


@pytest.mark.parametrize("name", ["cpu", "CPU", "CPUExecutionProvider", "cpuexecutionprovider"])
def test_providers_are_called_as_people_call_them(name):
    assert provider_names([name]) == ["CPUExecutionProvider"]


def test_providers_that_are_not_there_are_refused(monkeypatch):
    names = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: names)
    assert provider_names(["cuda", "cpu"]) == names
    with pytest.raises(InputError, match="no provider 'tpu' here, expected one of cuda, cpu;"):
        provider_names(["cuda", "tpu"])


def test_a_provider_that_does_not_start_is_no_silent_cpu(tmp_path, monkeypatch, capfd):
    """As a CUDA build of onnxruntime does where there is no driver."""
    names = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    started = onnxruntime.InferenceSession

    def on_the_cpu(path, options, providers, **kwargs):
        assert providers == names[:1]
        return started(path, options, providers=["CPUExecutionProvider"])

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: names)
    monkeypatch.setattr(onnxruntime, "InferenceSession", on_the_cpu)
    data(tmp_path / "w.bin")
    with pytest.raises(InputError, match=r"could not start CUDAExecutionProvider.*CPUExec"):
        open_session(model(tmp_path, "w.bin"), providers=["cuda"])
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("threads", [0, 1, 2])
def test_the_number_of_threads_is_passed_on(tmp_path, threads):
    data(tmp_path / "w.bin")
    session = open_session(model(tmp_path, "w.bin"), threads=threads)
    assert session.get_session_options().intra_op_num_threads == threads


def test_negative_threads_are_refused(tmp_path):
    data(tmp_path / "w.bin")
    with pytest.raises(InputError, match="-1 threads"):
        open_session(model(tmp_path, "w.bin"), threads=-1)


# Fingerprints


def test_a_fingerprint_follows_all_that_decides_the_output(tmp_path):
    weights = data(tmp_path / "w.bin")
    path = model(tmp_path, "w.bin")
    first = fingerprint(path, "spec")
    assert fingerprint(path, "spec") == first, "not the same twice"
    seen = {first, fingerprint(path, "other spec"), fingerprint(path, "spec", "cuda")}
    weights.write_bytes((2 * WEIGHTS).tobytes())
    seen.add(fingerprint(path, "spec"))
    (tmp_path / "sub").mkdir()
    data(tmp_path / "sub" / "w.bin")
    seen.add(fingerprint(model(tmp_path, "sub/w.bin"), "spec"))
    assert len(seen) == 5
