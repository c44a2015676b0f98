"""An ONNX network whose inputs and outputs are checked, and the base class of its detectors."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from gsc_jax.detectors.session import CPU, open_session
from gsc_jax.io.validation import reported
from gsc_jax.scene import Camera, InputError

Shape = Sequence[int | str | None]

FLOATS: Mapping[str, type] = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
NUMBERS: Mapping[str, type] = {**FLOATS, "tensor(int32)": np.int32, "tensor(int64)": np.int64}


@dataclasses.dataclass(frozen=True)
class TensorSpec:
    """Expected type and shape of an input or output, whose name in error messages is `role`.

    A side is None where any length is valid; a name stands for a length that is the same in all
    tensors of the network. `types` holds the NumPy type of each valid ONNX type. None stands for
    any shape, or, of outputs only, for any type.
    """

    role: str
    shape: tuple[int | str | None, ...] | None
    types: Mapping[str, type] | None = dataclasses.field(default_factory=lambda: FLOATS)


class Network:
    """An ONNX model that is checked when it is loaded, as far as it declares shapes, and when run.

    Attributes:
        providers: Execution providers in use.
        inputs: The inputs, with `name`, `type` and declared `shape`; a free side is a name or None.
        outputs: The computed outputs, likewise; the shape is empty if the model declares none.
        sides: Declared lengths of the named sides of the specs.
    """

    def __init__(
        self,
        path: Path,
        inputs: Sequence[TensorSpec],
        outputs: Mapping[int | str, TensorSpec],
        *,
        providers: Sequence[str] = CPU,
        threads: int = 0,
    ):
        """Load a model with `open_session`; raise InputError if its tensors differ from the specs.

        `inputs` are all inputs in order, `outputs` those to compute, by position or name.
        """
        self.path = path
        self._session = open_session(path, providers=providers, threads=threads)
        self.providers = self._session.get_providers()
        self.inputs = self._session.get_inputs()
        computed = self._session.get_outputs()
        known = {tensor.name: tensor for tensor in computed} | dict(enumerate(computed))
        if missing := [key for key in outputs if key not in known]:
            names = ", ".join(tensor.name for tensor in computed)
            raise InputError(f"{path}: has no output {missing[0]!r}, expected one of {names}")
        self.outputs = [known[key] for key in outputs]
        self.sides: dict[str, int] = {}
        if len(self.inputs) != len(inputs):
            found = ", ".join(tensor.name for tensor in self.inputs)
            expected = ", ".join(spec.role for spec in inputs)
            raise InputError(
                f"{path}: has {len(self.inputs)} inputs ({found}), expected {len(inputs)} "
                f"({expected}); export it with these, in this order"
            )
        tensors, specs = (*self.inputs, *self.outputs), (*inputs, *outputs.values())
        self._checks = list(zip(tensors, specs, strict=True))
        for tensor, spec in self._checks:
            # onnxruntime returns an empty shape if the model declares none.
            self._check(tensor, tensor.shape or spec.shape or (), spec, self.sides)

    def run(self, *arrays: np.ndarray, view: str) -> list[np.ndarray]:
        """Compute the outputs, float32; arrays are converted to the types of the inputs.

        Raises InputError, with the name of the view, if it fails or an output has another shape.
        """
        pairs = list(zip(self.inputs, arrays, strict=True))
        feed = {tensor.name: array.astype(NUMBERS[tensor.type]) for tensor, array in pairs}
        given = ", ".join(f"{tensor.name} {shape_text(array.shape)}" for tensor, array in pairs)
        failure = f"{self.path}: the model fails on view {view!r} with {given}"
        with reported(failure, "; export the model for this shape"):
            found = self._session.run([tensor.name for tensor in self.outputs], feed)
        outputs = [np.asarray(array, np.float32) for array in found]
        sides = dict(self.sides)
        for (tensor, spec), array in zip(self._checks, (*arrays, *outputs), strict=True):
            self._check(tensor, array.shape, spec, sides)
        return outputs

    def _check(self, tensor, shape: Shape, spec: TensorSpec, sides: dict[str, int]) -> None:
        """Compare a tensor with its spec, and add the lengths of its named sides to `sides`."""
        number = tensor.type.startswith("tensor(") and tensor.type != "tensor(string)"
        type_fits = number if spec.types is None else tensor.type in spec.types
        if type_fits and (spec.shape is None or fits(shape, spec.shape, sides)):
            return
        types = " or ".join(FLOATS if spec.types is None else spec.types)
        expected = "" if spec.shape is None else f" of shape {shape_text(spec.shape, sides)}"
        raise InputError(
            f"{self.path}: {tensor.name!r} is {tensor.type} of shape {shape_text(shape)}, expected "
            f"the {spec.role}, {types}{expected}; export the model with this type and shape"
        )


def fits(shape: Shape, expected: Shape, sides: dict[str, int]) -> bool:
    """Whether a shape, whose free sides are names or None, can be the expected one.

    There, names stand for the lengths in `sides`, to which those of the shape are added.
    """
    for found, side in zip(shape, expected, strict=False):
        wanted = sides.get(side) if isinstance(side, str) else side
        if isinstance(found, int) and wanted not in (None, found):
            return False
        if isinstance(found, int) and isinstance(side, str):
            sides[side] = found
    return len(shape) == len(expected)


def shape_text(shape: Shape, sides: Mapping[str, int] | None = None) -> str:
    """Text of a shape with "?" for a free side and the lengths of named sides."""
    known = {None: "?", **(sides or {})}
    return "[" + ", ".join(str(known.get(side, side)) for side in shape) + "]"


class NetworkDetector(ABC):
    """A detector that computes a probability map from the image alone.

    Attributes:
        model: The model, for messages.
        anomalies: Warning text for each anomaly in the output, with its "{count}".
        diagnostics: Counts of the anomalies by view.
    """

    needs_image = True
    anomalies: ClassVar[Mapping[str, str]] = {}

    def __init__(self, model: Path):
        self.model = model
        self.diagnostics: dict[str, dict[str, int]] = {}

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """All cameras, since a network accepts any image; raises InputError if there are none."""
        if not cameras:
            raise InputError(f"{self.model}: there are no cameras to run the detector on")
        return list(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """Probability of tampering in a view at the resolution of the network, (h, w) float32.

        Raises InputError if the network fails on the image (H, W, 3) or its output is invalid.
        """
        if image is None:
            raise ValueError(f"{type(self).__name__} needs the rendered image")
        probability, self.diagnostics[camera.name] = self.detect(image, camera.name)
        return probability

    @abstractmethod
    def detect(self, image: np.ndarray, view: str) -> tuple[np.ndarray, dict[str, int]]:
        """Probability of tampering in the image of a view, and counts of anomalies."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Anomalies in the outputs of the views so far."""
        found = []
        for anomaly, text in self.anomalies.items():
            counts = {view: own[anomaly] for view, own in self.diagnostics.items() if own[anomaly]}
            if counts:
                views = f"{len(self.diagnostics)} views (first in {next(iter(counts))!r})"
                total = text.format(count=sum(counts.values()))
                found.append(f"{self.model}: {total} in {len(counts)} of {views}")
        return tuple(found)
