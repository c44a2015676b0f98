"""A network of several inputs and outputs, held to what is expected of each of them.

`Port` says what a tensor has to be. `Network` checks its ports against the model when it is loaded,
so far as the model states types and shapes, and every output when it is run.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.detectors.session import CPU, one_line, open_session
from gsc_jax.scene import InputError

Shape = Sequence[int | str | None]

FLOATS: Mapping[str, type] = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
NUMBERS: Mapping[str, type] = {
    **FLOATS,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}


@dataclasses.dataclass(frozen=True)
class Port:
    """What an input or output of a network has to be.

    Attributes:
        role: What it is, in messages.
        shape: Its sides; those that are None may be anything.
        kinds: NumPy's types by those of ONNX that it may have.
    """

    role: str
    shape: tuple[int | None, ...]
    kinds: Mapping[str, type] = dataclasses.field(default_factory=lambda: FLOATS)


class Network:
    """An ONNX model with given inputs and, first of its outputs, given outputs.

    Attributes:
        path: The model.
    """

    def __init__(
        self,
        path: str | Path,
        inputs: Sequence[Port],
        outputs: Sequence[Port],
        *,
        providers: Sequence[str] = CPU,
        threads: int = 0,
    ):
        """Loads a model and checks it.

        Args:
            path: The .onnx file.
            inputs: What its inputs have to be, all of them, in their order.
            outputs: What its first outputs have to be, in their order.
            providers: onnxruntime's execution providers, the preferred one first.
            threads: Threads of one inference, 0 for all the cores.

        Raises:
            InputError: If the file is no model that can be loaded, or its tensors do not fit.
        """
        self.path = Path(path)
        self._session = open_session(self.path, providers=providers, threads=threads)
        self._outputs = tuple(outputs)
        self._fed = self._session.get_inputs()
        self._read = self._session.get_outputs()[: len(outputs)]
        if len(self._fed) != len(inputs) or len(self._read) < len(outputs):
            raise InputError(
                f"{self.path}: takes ({_names(self._fed)}) and gives ({_names(self._read)}), "
                f"expected to take ({_roles(inputs)}) and to give ({_roles(outputs)}); export it "
                "with these, in this order"
            )
        for tensor, port in zip(self._fed, inputs, strict=True):
            self._check(f"input {tensor.name!r}", tensor.type, tensor.shape, port)
        for tensor, port in zip(self._read, outputs, strict=True):
            # No shape is what onnxruntime says where the model says nothing.
            shape = tensor.shape or port.shape
            self._check(f"output {tensor.name!r}", tensor.type, shape, port)

    @property
    def providers(self) -> Sequence[str]:
        """The execution providers in use."""
        return self._session.get_providers()

    def takes(self, index: int) -> Shape:
        """The shape that the model states for an input; open sides are names or None."""
        return self._fed[index].shape

    def gives(self, index: int) -> Shape:
        """The shape that the model states for an output, empty where it states none."""
        return self._read[index].shape

    def run(self, *arrays: np.ndarray, view: str) -> list[np.ndarray]:
        """The outputs, float32.

        Args:
            arrays: An array per input, brought to its type.
            view: What it is run on, for messages.

        Raises:
            InputError: If the network fails, or an output is not what it has to be.
        """
        pairs = list(zip(self._fed, arrays, strict=True))
        feed = {tensor.name: array.astype(NUMBERS[tensor.type]) for tensor, array in pairs}
        try:
            found = self._session.run([tensor.name for tensor in self._read], feed)
        except Exception as trouble:  # onnxruntime's errors have no common base class
            fed = ", ".join(f"{tensor.name} {shape_text(array.shape)}" for tensor, array in pairs)
            raise InputError(
                f"{self.path}: the model fails on view {view!r} with {fed}: {one_line(trouble)}; "
                "export it again for these shapes"
            ) from trouble
        outputs = [np.asarray(array, np.float32) for array in found]
        for tensor, port, array in zip(self._read, self._outputs, outputs, strict=True):
            self._check(f"output {tensor.name!r}", tensor.type, array.shape, port)
        return outputs

    def _check(self, name: str, kind: str, shape: Shape, port: Port) -> None:
        if kind in port.kinds and compatible(shape, port.shape):
            return
        raise InputError(
            f"{self.path}: {name} is {kind} of shape {shape_text(shape)}, expected the "
            f"{port.role}, {' or '.join(port.kinds)} of shape {shape_text(port.shape)}; export the "
            "model with these"
        )


def compatible(shape: Shape, other: Shape) -> bool:
    """Whether two shapes, of which sides that are no number are open, can be the same."""
    return len(shape) == len(other) and all(
        one == two or not (isinstance(one, int) and isinstance(two, int))
        for one, two in zip(shape, other, strict=True)
    )


def shape_text(shape: Shape) -> str:
    """A shape for people, "?" where it is open."""
    return "[" + ", ".join("?" if side is None else str(side) for side in shape) + "]"


def _names(tensors: Sequence[Any]) -> str:
    return ", ".join(tensor.name for tensor in tensors)


def _roles(ports: Sequence[Port]) -> str:
    return ", ".join(port.role for port in ports)
