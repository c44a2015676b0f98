"""Any 2D forgery network exported to ONNX, run on the rendered views.

`OnnxSpec` says how a network is fed and read; `OnnxDetector` checks that against the model when it
is loaded, so far as the model states its shapes, and against every output after that. The output is
a probability in which 0.5 stands for the network's own threshold.

An output that is not finite after the activation becomes 0.5, which is not above the threshold and
so says nothing; how many there were is in `OnnxDetector.warnings`.
"""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.detectors.fitting import crop_map, fit_image, remap, to_tensor
from gsc_jax.detectors.ports import FLOATS, shape_text
from gsc_jax.detectors.session import CPU, fingerprint, one_line, open_session, some
from gsc_jax.detectors.specs import PLAIN, PRESETS, OnnxSpec, preset
from gsc_jax.scene import Camera, InputError

__all__ = ["PRESETS", "OnnxDetector", "OnnxSpec"]

PROBABILITY_TOLERANCE = 1e-3
"""How far outside [0, 1] half-precision or resampling inside a network may put a probability."""


class OnnxDetector:
    """A 2D detector that runs an ONNX model on the rendered views.

    Attributes:
        path: The model.
        spec: How it is fed and read.
        needs_image: True.
        notes: By view, in counts, what is odd about its output; `warnings` sums them up.
    """

    needs_image = True

    def __init__(
        self,
        path: str | Path,
        spec: OnnxSpec | str = PLAIN,
        *,
        providers: Sequence[str] = CPU,
        threads: int = 0,
    ):
        """Loads a model and checks it against the spec.

        Args:
            path: The .onnx file.
            spec: How to feed and read it, or the name of one of `PRESETS`.
            providers: onnxruntime's execution providers, the preferred one first, by their names
                or as people say them ("cuda").
            threads: Threads of one inference, 0 for all the cores.

        Raises:
            InputError: If the file is no model that can be loaded, or its tensors do not fit.
        """
        self.path = Path(path)
        self.spec = preset(spec) if isinstance(spec, str) else spec
        self._session = open_session(self.path, providers=providers, threads=threads)
        self._input, self._dtype = self._checked_input()
        self._size = self._checked_size()
        self._output = self._checked_output()
        self.notes: dict[str, dict[str, int]] = {}

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """All the cameras: a network can speak on any image.

        Raises:
            InputError: If there are none.
        """
        return some(cameras, self.path)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """The probability of tampering in a view, remapped so that 0.5 is the spec's threshold.

        Args:
            image: The rendered view in [0, 1], shape (H, W, 3) float32.
            camera: Its camera; only the name is used, in messages.

        Returns:
            Probability in [0, 1], shape (h, w) float32, covering the whole view at the resolution
            of the network. 0.5 where the network's output is not finite.

        Raises:
            InputError: If the network fails on the image or its output is no probability map.
        """
        if image is None:
            raise ValueError("an OnnxDetector needs the rendered image")
        target = self._target(*image.shape[:2])
        canvas, content = fit_image(image, target, fit=self.spec.fit)
        planes = self._planes(self._run(to_tensor(canvas, self.spec), camera.name), target)
        probability = self._probability(planes, camera.name)
        return remap(crop_map(probability, target, content), threshold=self.spec.threshold)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What went wrong in the views so far without stopping the run."""
        found = []
        counts = {view: note["not_finite"] for view, note in self.notes.items()}
        views = [view for view, count in counts.items() if count]
        if views:
            found.append(
                f"{self.path}: {sum(counts.values())} outputs in {len(views)} of {len(counts)} "
                f"views are not finite and count as undecided (first in {views[0]!r})"
            )
        if self.notes and all(note["squashed"] for note in self.notes.values()):
            found.append(
                f"{self.path}: all outputs lie in [0, 1] before the sigmoid, so they look like "
                'probabilities already; try activation = "none"'
            )
        return tuple(found)

    @functools.cached_property
    def fingerprint(self) -> str:
        """What decides its output besides the image, as a key for `CachedDetector`.

        The model with all its files, the spec, the providers, onnxruntime's version and the code
        that feeds and reads the network; not the number of threads.
        """
        return fingerprint(self.path, self.spec, self._session.get_providers())

    def _checked_input(self) -> tuple[str, type]:
        inputs = self._session.get_inputs()
        names = ", ".join(tensor.name for tensor in inputs)
        if len(inputs) != 1:
            raise InputError(
                f"{self.path}: the model has {len(inputs)} inputs ({names}), expected one RGB "
                "image; export it with the image as its only input"
            )
        if self.spec.input not in (None, inputs[0].name):
            raise InputError(f"{self.path}: no input {self.spec.input!r}, the model has {names!r}")
        if inputs[0].type not in FLOATS:
            raise InputError(
                f"{self.path}: input {names!r} is {_described(inputs[0])}, expected "
                f"{' or '.join(FLOATS)}; export the model with float inputs"
            )
        return names, FLOATS[inputs[0].type]

    def _checked_size(self) -> tuple[int | None, int | None]:
        """Height and width that every image is brought to, None where they are free."""
        tensor = self._session.get_inputs()[0]
        shape = tensor.shape
        planar = self.spec.layout == "NCHW"
        size = self.spec.size if isinstance(self.spec.size, tuple) else (None, None)
        sides = [side or axis for axis, side in zip("HW", size, strict=True)]
        wanted = [1, 3, *sides] if planar else [1, *sides, 3]
        spatial = shape[2:] if planar else shape[1:3]
        # Open sides go with anything, but a side of 3 is the colours of the other layout.
        if len(shape) != 4 or 3 in spatial or any(map(_excludes, shape, wanted)):
            raise InputError(
                f"{self.path}: input {self._input!r} is {_described(tensor)}, the spec expects "
                f"{shape_text(wanted)}; change size or layout of the spec, or export it for that "
                "shape"
            )
        height, width = (
            found if isinstance(found, int) else side
            for found, side in zip(spatial, size, strict=True)
        )
        return height, width

    def _checked_output(self) -> str:
        outputs = {tensor.name: tensor for tensor in self._session.get_outputs()}
        names, output = list(outputs), self.spec.output
        wanted = names[output] if isinstance(output, int) and output < len(names) else output
        if not isinstance(wanted, str) or wanted not in outputs:
            raise InputError(
                f"{self.path}: no output {wanted!r}, the model has {', '.join(names)}; change "
                "output in the spec"
            )
        shape, kind = outputs[wanted].shape, outputs[wanted].type
        if not kind.startswith("tensor(") or kind == "tensor(string)":
            raise InputError(
                f"{self.path}: output {wanted!r} is {_described(outputs[wanted])}, expected "
                f"{' or '.join(FLOATS)}; change output in the spec"
            )
        if shape:  # an empty one is what onnxruntime says where the model says nothing
            self._check_map(wanted, shape)
        return wanted

    def _check_map(self, name: str, shape: Sequence[int | str | None]):
        """Whether a shape, of which some sides may be open, can hold the map that the spec says."""
        found = f"{self.path}: output {name!r} has shape {shape_text(shape)}"
        if len(shape) not in (2, 3, 4) or (len(shape) == 4 and _excludes(shape[0], 1)):
            raise InputError(f"{found}, expected one map: [1, channels, height, width]")
        axis = self._channel_axis(len(shape))
        count = 1 if axis is None else shape[axis]
        if not isinstance(count, int):
            return
        if self.spec.activation == "softmax" and count < 2:
            raise InputError(f"{found}: a softmax needs two channels; change activation")
        if self.spec.channel is None and count != 1:
            raise InputError(
                f"{found}: it has {count} channels; say in the spec by channel which of them "
                "means tampered, or change output or layout"
            )
        if self.spec.channel is not None and self.spec.channel >= count:
            raise InputError(
                f"{found}: it has {count} channels, so none of position {self.spec.channel}; "
                "change channel, output or layout of the spec"
            )

    def _channel_axis(self, rank: int) -> int | None:
        return {4: 1 if self.spec.layout == "NCHW" else 3, 3: 0, 2: None}[rank]

    def _target(self, height: int, width: int) -> tuple[int, int]:
        """The size at which an image of this size is fed."""
        target = [
            side or self._free(own) for side, own in zip(self._size, (height, width), strict=True)
        ]
        if self.spec.fit == "none" and target != [height, width]:
            raise InputError(
                f"{self.path}: input {self._input!r} takes images of {shape_text(target)}, found "
                f"{shape_text([height, width])}; set fit to resize or pad in the spec"
            )
        return target[0], target[1]

    def _free(self, side: int) -> int:
        multiple = self.spec.multiple_of
        if self.spec.fit == "pad":
            return -(-side // multiple) * multiple
        return max(1, round(side / multiple)) * multiple

    def _run(self, feed: np.ndarray, view: str) -> np.ndarray:
        try:
            (raw,) = self._session.run([self._output], {self._input: feed.astype(self._dtype)})
        except Exception as trouble:  # onnxruntime's errors have no common base class
            raise InputError(
                f"{self.path}: the model fails on view {view!r} with input "
                f"{shape_text(feed.shape)}: {one_line(trouble)}; change size, multiple_of or layout"
            ) from trouble
        return np.asarray(raw, np.float32)

    def _planes(self, raw: np.ndarray, target: tuple[int, int]) -> np.ndarray:
        """The output as channels of maps that cover the input, shape (C, h, w)."""
        self._check_map(self._output, raw.shape)
        if raw.ndim == 4:
            planes = np.moveaxis(raw[0], (self._channel_axis(4) or 0) - 1, 0)
        else:
            planes = raw if raw.ndim == 3 else raw[None]
        height, width = planes.shape[1:]
        # With fewer axes it may be tokens or scores: a map has the aspect of the input, to a cell.
        crooked = abs(height * target[1] - width * target[0]) > max(target)
        if not planes.size or (raw.ndim < 4 and crooked):
            raise InputError(
                f"{self.path}: output {self._output!r} has shape {shape_text(raw.shape)}, no map "
                f"of an input of {shape_text(target)}; change output in the spec"
            )
        return planes

    def _probability(self, planes: np.ndarray, view: str) -> np.ndarray:
        """The tampered channel after the activation, undecided where that is not finite."""
        from scipy.special import expit, softmax

        channel, squashed = self.spec.channel or 0, False
        probability = planes[channel]
        if self.spec.activation == "softmax":
            with np.errstate(invalid="ignore"):  # infinite ones are counted below
                probability = softmax(planes, axis=0)[channel]
        elif self.spec.activation == "sigmoid":
            squashed = bool(((probability >= 0) & (probability <= 1)).all())
            probability = expit(probability)
        finite = np.isfinite(probability)
        self.notes[view] = {"not_finite": int((~finite).sum()), "squashed": int(squashed)}
        # The threshold is what becomes 0.5.
        probability = np.where(finite, probability, np.float32(self.spec.threshold))
        low, high = float(probability.min()), float(probability.max())
        if low < -PROBABILITY_TOLERANCE or high > 1 + PROBABILITY_TOLERANCE:
            raise InputError(
                f"{self.path}: output {self._output!r} spans {low:.3g} to {high:.3g}, expected "
                "probabilities; set activation to sigmoid or softmax in the spec"
            )
        return np.clip(probability, 0, 1)


def _excludes(found: int | str | None, expected: int | str) -> bool:
    """Whether two sides are both fixed and differ; names and None are open."""
    return isinstance(found, int) and isinstance(expected, int) and found != expected


def _described(tensor: Any) -> str:
    """Type and shape of an input or output of a session."""
    return f"{tensor.type} of shape {shape_text(tensor.shape)}"
