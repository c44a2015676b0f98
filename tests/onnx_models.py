"""Small ONNX models and cameras for tests of detectors."""

import dataclasses
from pathlib import Path

import numpy as np
import onnx
from onnx import AttributeProto, NodeProto, TensorProto, helper, numpy_helper
from strategies import camera

from gsc_jax.scene import Camera

FLOAT = TensorProto.FLOAT
FREE = (1, 3, "H", "W")


def view(name: str = "view", width: int = 8, height: int = 6) -> Camera:
    return dataclasses.replace(camera(width, height), name=name)


def save(path: Path, nodes: list, inputs: dict, outputs: dict, constants: dict) -> Path:
    """Write a model with inputs and outputs given as (type, shape) by name."""
    graph = helper.make_graph(
        nodes,
        "test",
        [helper.make_tensor_value_info(name, *facts) for name, facts in inputs.items()],
        [helper.make_tensor_value_info(name, *facts) for name, facts in outputs.items()],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    opset = [helper.make_opsetid("", 17)]
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)
    return path


def network(
    folder: Path,
    *nodes: NodeProto,
    shape: tuple = FREE,
    map_shape: tuple | None = None,
    dtype: int = FLOAT,
    constants: dict | None = None,
    inputs: tuple[str, ...] = ("image",),
    outputs: tuple[str, ...] = ("map",),
) -> Path:
    """Write net.onnx, by default with the first channel of its input as its map."""
    return save(
        folder / "net.onnx",
        list(nodes or first_channel()),
        dict.fromkeys(inputs, (dtype, shape)),
        dict.fromkeys(outputs, (dtype, map_shape)),
        {"zero": np.array([0]), **(constants or {})},
    )


def first_channel(output: str = "map") -> tuple[NodeProto, ...]:
    return (helper.make_node("Gather", ["image", "zero"], [output], axis=1),)


def identity(output: str = "map") -> NodeProto:
    return helper.make_node("Identity", ["image"], [output])


WEIGHTS = np.full((4, 4), 7, np.float32)


def external_model(folder: Path, location: str, *, place: str = "initializer") -> Path:
    """Write net.onnx, which adds `WEIGHTS` from another file to its input.

    The tensor is an initializer, a sparse one, or a constant of the graph, of a branch, or of a
    function.
    """
    tensor = TensorProto(name="w", data_type=FLOAT, dims=(4, 4), data_location="EXTERNAL")
    for key, value in {"offset": "0", "location": location, "length": "64"}.items():
        entry = tensor.external_data.add()
        entry.key, entry.value = key, value
    x, y = (helper.make_tensor_value_info(name, FLOAT, (4, 4)) for name in "xy")
    constant = helper.make_node("Constant", [], ["w"])
    constant.attribute.add(name="value", type=AttributeProto.TENSOR).t.CopyFrom(tensor)
    nodes, functions = [helper.make_node("Add", ["x", "w"], ["y"])], []
    opset = [helper.make_opsetid("", 17), helper.make_opsetid("test", 1)]
    initializers = {"branch": [numpy_helper.from_array(np.array(True), "yes")]}
    initializers["initializer"] = [tensor]
    if place == "constant":
        nodes = [constant, *nodes]
    elif place == "function":
        body = [constant, *nodes]
        functions = [helper.make_function("test", "F", ["x"], ["y"], body, opset[:1])]
        nodes = [helper.make_node("F", ["x"], ["y"], domain="test")]
    elif place == "branch":
        branch = helper.make_graph([constant, *nodes], "branch", [], [y])
        nodes = [helper.make_node("If", ["yes"], ["y"], then_branch=branch, else_branch=branch)]
    graph = helper.make_graph(nodes, "test", [x], [y], initializer=initializers.get(place, []))
    if place == "sparse":
        sparse = graph.sparse_initializer.add(dims=(4, 4), values=tensor)
        sparse.values.dims[:] = [16]
        sparse.indices.CopyFrom(numpy_helper.from_array(np.arange(16)))
    proto = helper.make_model(graph, opset_imports=opset, ir_version=8, functions=functions)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "net.onnx").write_bytes(proto.SerializeToString())
    return folder / "net.onnx"


def external_data(path: Path) -> Path:
    """Write the file of `WEIGHTS`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(WEIGHTS.tobytes())
    return path


def slow_network(path: Path, steps: int) -> Path:
    """An ONNX model that flags bright pixels, after a loop that signals cannot interrupt."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["on"]),
            helper.make_node("Add", ["sum", "nothing"], ["more"]),
        ],
        "step",
        [
            helper.make_tensor_value_info("step", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("sum", FLOAT, [1]),
        ],
        [
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("more", FLOAT, [1]),
        ],
    )
    nodes = [
        helper.make_node("Loop", ["steps", "", "nothing"], ["late"], body=body),
        helper.make_node("ReduceMax", ["image"], ["high"], axes=[1], keepdims=1),
        helper.make_node("Add", ["high", "late"], ["map"]),
    ]
    constants = {"steps": np.array(steps, np.int64), "nothing": np.zeros(1, np.float32)}
    tensors = {name: (FLOAT, [1, n, "h", "w"]) for name, n in (("image", 3), ("map", 1))}
    return save(path, nodes, {"image": tensors["image"]}, {"map": tensors["map"]}, constants)
