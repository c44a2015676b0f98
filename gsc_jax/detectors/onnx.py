"""A 2D forgery network as an ONNX model, run on the rendered views.

`OnnxSpec` describes the input and output of the network. The threshold of the network becomes 0.5
in the map. Outputs that are not finite become 0.5 and so are not flagged; `warnings` counts them.
"""

import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.special import expit, softmax

from gsc_jax.detectors.network import Network, NetworkDetector, Shape, TensorSpec, fits, shape_text
from gsc_jax.detectors.preprocessing import Size, crop_map, fit_image, remap_threshold, to_tensor
from gsc_jax.detectors.session import CPU, fingerprint
from gsc_jax.detectors.specs import PLAIN, PRESETS, OnnxSpec, preset
from gsc_jax.evidence.detector import ROUNDING
from gsc_jax.scene import InputError


class OnnxDetector(NetworkDetector):
    """A 2D detector that runs an ONNX model on the rendered views.

    Attributes:
        path: The model.
        spec: Its input and output conventions.
    """

    anomalies: ClassVar = {"not_finite": "{count} outputs are not finite and count as undecided"}

    def __init__(
        self,
        path: str | Path,
        spec: OnnxSpec | str = PLAIN,
        *,
        providers: Sequence[str] = CPU,
        threads: int = 0,
    ):
        """Load a model and compare it with the spec; InputError if its tensors contradict it.

        Args:
            path: The .onnx file.
            spec: Input and output conventions, or the name of one of `PRESETS`.
            providers: See `open_session`.
            threads: Threads of one inference, 0 for all cores.
        """
        self.path = Path(path)
        super().__init__(self.path)
        self.spec = preset(spec) if isinstance(spec, str) else spec
        inputs = [TensorSpec("RGB image", self._expected_input())]
        outputs = {self.spec.output: TensorSpec("map", None, types=None)}
        self._network = Network(self.path, inputs, outputs, providers=providers, threads=threads)
        self._size = self._input_size()
        (self._output,) = self._network.outputs
        if self._output.shape:
            self._check_map(self._output.shape)

    def detect(self, image: np.ndarray, view: str) -> tuple[np.ndarray, dict[str, int]]:
        """Probability map, and counts of the anomalies "not_finite" and "squashed"."""
        target = self._target(*image.shape[:2])
        canvas, content = fit_image(image, target, fit=self.spec.fit, low_pass=self.spec.low_pass)
        (output,) = self._network.run(to_tensor(canvas, self.spec), view=view)
        probability, counts = self._activate(self._channels(output, target))
        return remap_threshold(crop_map(probability, target, content), self.spec.threshold), counts

    @property
    def warnings(self) -> tuple[str, ...]:
        """Anomalies in the outputs of the views so far, and a preset that may be the wrong one."""
        found, views = super().warnings, self.diagnostics.values()
        free = not all(isinstance(side, int) for side in self._network.inputs[0].shape[2:])
        if free and self.spec.size and self.spec in PRESETS.values():
            text = "takes any size, unlike the network of the preset; is it the right preset?"
            found = (*found, f"{self.path}: {text}")
        if views and all(counts["squashed"] for counts in views):
            text = "all outputs lie in [0, 1] before the sigmoid, so they look like probabilities"
            found = (*found, f'{self.path}: {text} already; try activation = "none"')
        return found

    @functools.cached_property
    def fingerprint(self) -> str:
        """Key for `CachedDetector`: a digest of everything that determines the map of an image."""
        return fingerprint(self.path, self.spec, self._network.providers)

    def _expected_input(self) -> tuple[int | None, ...]:
        """Input shape of the spec, None for a free side."""
        height, width = self.spec.size if isinstance(self.spec.size, tuple) else (None, None)
        return (1, 3, height, width) if self.spec.layout == "NCHW" else (1, height, width, 3)

    def _input_size(self) -> list[int | None]:
        """Height and width to which every image is resized; None if the side is free."""
        name, shape = self._network.inputs[0].name, self._network.inputs[0].shape
        if self.spec.input not in (None, name):
            raise InputError(f"{self.path}: no input {self.spec.input!r}, the model has {name!r}")
        start = self.spec.layout.index("H")
        sides = shape[start : start + 2]
        if 3 in sides:  # the colour channels of the other layout
            raise InputError(
                f"{self.path}: input {name!r} has shape {shape_text(shape)}, the spec expects "
                f"{shape_text(self._expected_input())}; change layout in the spec"
            )
        pairs = zip(sides, self._expected_input()[start:], strict=False)
        return [side if isinstance(side, int) else wanted for side, wanted in pairs]

    def _check_map(self, shape: Shape) -> None:
        """Require a shape, with possibly free sides, of one map with the channel of the spec."""
        found = f"{self.path}: output {self._output.name!r} has shape {shape_text(shape)}"
        if len(shape) not in (2, 3, 4) or (len(shape) == 4 and not fits(shape[:1], (1,), {})):
            raise InputError(f"{found}, expected one map: [1, channels, height, width]")
        # With fewer than four axes, the channels are first or absent, whatever the layout.
        count = shape[self.spec.layout.index("C")] if len(shape) == 4 else (1, *shape)[-3]
        channel = self.spec.channel
        if not isinstance(count, int):
            return
        if self.spec.activation == "softmax" and count < 2:
            raise InputError(f"{found}: a softmax needs two channels; change activation")
        if count != 1 if channel is None else channel >= count:
            text = f"it has {count} channels, and channel is {channel} in the spec"
            raise InputError(f"{found}: {text}; change channel, output or layout")

    def _target(self, height: int, width: int) -> Size:
        """Input size of the network for an image of this size."""
        multiple = self.spec.multiple_of
        rounding = math.ceil if self.spec.fit == "pad" else round
        rows, columns = (
            fixed or max(1, rounding(side / multiple)) * multiple
            for fixed, side in zip(self._size, (height, width), strict=True)
        )
        if self.spec.fit == "none" and (rows, columns) != (height, width):
            raise InputError(
                f"{self.path}: input {self._network.inputs[0].name!r} takes images of "
                f"{shape_text([rows, columns])}, found {shape_text([height, width])}; set fit to "
                "resize or pad in the spec"
            )
        return rows, columns

    def _channels(self, output: np.ndarray, target: Size) -> np.ndarray:
        """Output as maps that cover the input, shape (channels, h, w)."""
        self._check_map(output.shape)
        channels = output[None] if output.ndim == 2 else output
        if output.ndim == 4:
            channels = np.moveaxis(output, self.spec.layout.index("C"), 1)[0]
        height, width = channels.shape[1:]
        # With fewer axes it can be tokens or scores; the aspect ratio distinguishes a map.
        distorted = abs(height * target[1] - width * target[0]) > max(target)
        if not channels.size or (output.ndim < 4 and distorted):
            raise InputError(
                f"{self.path}: output {self._output.name!r} has shape {shape_text(output.shape)}, "
                f"which is not a map of an input of {shape_text(target)}; change output in the spec"
            )
        return channels

    def _activate(self, channels: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
        """Probability of the tampered class, and the counts of anomalies."""
        channel = self.spec.channel or 0
        probability, squashed = channels[channel], False
        if self.spec.activation == "softmax":
            with np.errstate(invalid="ignore"):  # counted below
                probability = softmax(channels, axis=0)[channel]
        elif self.spec.activation == "sigmoid":
            squashed = bool(((probability >= 0) & (probability <= 1)).all())
            probability = expit(probability)
        finite = np.isfinite(probability)
        counts = {"not_finite": int((~finite).sum()), "squashed": int(squashed)}
        probability = np.where(finite, probability, np.float32(self.spec.threshold))
        low, high = float(probability.min()), float(probability.max())
        if low < -ROUNDING or high > 1 + ROUNDING:
            raise InputError(
                f"{self.path}: output {self._output.name!r} spans {low:.3g} to "
                f"{high:.3g}, expected probabilities; set activation to sigmoid or softmax"
            )
        return np.clip(probability, 0, 1), counts
