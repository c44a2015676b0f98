"""ONNX models with an external tensor: their output is the sum of the input and the tensor."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper

WEIGHTS = np.full((4, 4), 7, np.float32)


def _value(name: str) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, WEIGHTS.shape)


def _graph(*nodes: onnx.NodeProto, inputs: list, tensors=()) -> onnx.GraphProto:
    return helper.make_graph(list(nodes), "g", inputs, [_value("y")], initializer=list(tensors))


def as_initializer(tensor: TensorProto) -> onnx.GraphProto:
    add = helper.make_node("Add", ["x", "w"], ["y"])
    return _graph(add, inputs=[_value("x")], tensors=[tensor])


def as_constant(tensor: TensorProto) -> onnx.GraphProto:
    constant = helper.make_node("Constant", [], ["w"], value=tensor)
    return _graph(constant, helper.make_node("Add", ["x", "w"], ["y"]), inputs=[_value("x")])


def in_a_branch(tensor: TensorProto) -> onnx.GraphProto:
    branch = _graph(helper.make_node("Add", ["x", "w"], ["y"]), inputs=[], tensors=[tensor])
    condition = helper.make_tensor("c", TensorProto.BOOL, [], [True])
    node = helper.make_node("If", ["c"], ["y"], then_branch=branch, else_branch=branch)
    return _graph(node, inputs=[_value("x")], tensors=[condition])


PLACES = (as_initializer, as_constant, in_a_branch)


def model(folder: Path, location: str, *, place=as_initializer) -> Path:
    """Write net.onnx with the data of a tensor in another file."""
    tensor = TensorProto(
        name="w", data_type=TensorProto.FLOAT, dims=WEIGHTS.shape, data_location="EXTERNAL"
    )
    for key, value in {"offset": "0", "location": location, "length": "64"}.items():
        entry = tensor.external_data.add()
        entry.key, entry.value = key, value
    folder.mkdir(parents=True, exist_ok=True)
    opset = [helper.make_opsetid("", 17)]
    proto = helper.make_model(place(tensor), opset_imports=opset, ir_version=8)
    (folder / "net.onnx").write_bytes(proto.SerializeToString())
    return folder / "net.onnx"


def data(path: Path) -> Path:
    """Write the data of the tensor."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(WEIGHTS.tobytes())
    return path
