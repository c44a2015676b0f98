"""What has to be known of a forgery network to run it, as plain values instead of code.

Networks differ in a few facts: the size they take and how an image is brought to it, the order and
statistics of the channels, and which output means tampered after which activation. `OnnxSpec` holds
them, and `read_spec` reads them from a TOML file with the same fields. Such a file stands beside
the model that it belongs to: net.toml for net.onnx. `PRESETS` are published networks, their values
taken from their own inference code.
"""

import dataclasses
import difflib
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from gsc_jax.io.files import existing_file
from gsc_jax.scene import InputError

CHOICES = {
    "fit": ("resize", "pad", "none"),
    "channels": ("rgb", "bgr"),
    "layout": ("NCHW", "NHWC"),
    "activation": ("none", "sigmoid", "softmax"),
}


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


def _is_real(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class OnnxSpec:
    """How to feed a network and how to read it.

    The network is fed `(scale * image - mean) / std`, with the image in [0, 1].

    Attributes:
        size: Input height and width, or one number for both; None takes what the model fixes, and
            where it fixes nothing the image's own size.
        fit: "resize" brings the image to the size without keeping its aspect; "pad" shrinks it if
            it is larger, then adds black at the bottom and the right (before the statistics), which
            is cropped from the output; "none" feeds it as it is.
        multiple_of: Where the size is free, make it a multiple of this ("resize" takes the nearest,
            "pad" the next).
        channels: Order in which the network takes the colours, "rgb" or "bgr".
        layout: "NCHW" or "NHWC", of input and output.
        scale: Multiplies the image.
        mean: Subtracted from each channel, in the order that the network takes them.
        std: Divides each channel, likewise.
        input: Name of the input, only checked; None is the only one.
        output: Name or position of the output that holds the map.
        activation: What is still to be applied, "none", "sigmoid" or "softmax" over channels.
        channel: Which channel of the output means tampered; None is the only one.
        threshold: Probability above which this network means tampered.
    """

    size: int | tuple[int, int] | None = None
    fit: Literal["resize", "pad", "none"] = "resize"
    multiple_of: int = 1
    channels: Literal["rgb", "bgr"] = "rgb"
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    scale: float = 1.0
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    input: str | None = None
    output: int | str = 0
    activation: Literal["none", "sigmoid", "softmax"] = "none"
    channel: int | None = None
    threshold: float = 0.5

    def __post_init__(self):
        """Normalises lists to tuples and one size to two.

        Raises:
            InputError: If a value is none of those documented, or two contradict each other.
        """
        for field in ("size", "mean", "std"):  # TOML knows lists only
            value = getattr(self, field)
            if isinstance(value, list):
                object.__setattr__(self, field, tuple(value))
        if _is_count(self.size):
            object.__setattr__(self, "size", (self.size, self.size))
        for field, allowed in CHOICES.items():
            self._require(field, getattr(self, field) in allowed, f"one of {', '.join(allowed)}")
        self._check_geometry()
        self._check_values()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "OnnxSpec":
        """The spec of a table of fields, such as a TOML file holds.

        Raises:
            InputError: If a field is unknown or its value does not fit.
        """
        known = [field.name for field in dataclasses.fields(cls)]
        unknown = sorted(set(table) - set(known))
        if unknown:
            close = difflib.get_close_matches(unknown[0].lower(), known, n=1)
            meant = f" (did you mean {close[0]!r}?)" if close else ""
            raise InputError(
                f"detector spec: unknown field {unknown[0]!r}{meant}, expected some of "
                f"{', '.join(known)}"
            )
        return cls(**table)

    def _check_geometry(self):
        size, multiple = self.size, self.multiple_of
        pair = isinstance(size, tuple) and len(size) == 2 and all(map(_is_count, size))
        self._require("size", size is None or pair, "a positive integer or a pair of them")
        self._require("multiple_of", _is_count(multiple), "a positive integer")
        if self.fit == "none":
            self._require("size", size is None, 'nothing with fit = "none" (or another fit)')
            self._require("multiple_of", multiple == 1, '1 with fit = "none" (or another fit)')
        if isinstance(size, tuple):
            fits = all(side % multiple == 0 for side in size)
            self._require("size", fits, f"multiples of multiple_of = {multiple}")

    def _check_values(self):
        for field in ("mean", "std"):
            value = getattr(self, field)
            triple = isinstance(value, tuple) and len(value) == 3 and all(map(_is_real, value))
            self._require(field, triple, "three finite numbers")
        self._require("std", all(value > 0 for value in self.std), "three positive numbers")
        self._require("scale", _is_real(self.scale) and self.scale > 0, "a positive number")
        name = self.input is None or (isinstance(self.input, str) and self.input)
        self._require("input", name, "the name of a tensor")
        output = self.output == 0 or _is_count(self.output) or isinstance(self.output, str)
        self._require("output", output, "a position from 0 or the name of a tensor")
        channel = self.channel is None or self.channel == 0 or _is_count(self.channel)
        self._require("channel", channel, "a position from 0")
        threshold = _is_real(self.threshold) and 0 < self.threshold < 1
        self._require("threshold", threshold, "a number between 0 and 1")

    def _require(self, field: str, fits: object, expected: str):
        if not fits:
            raise InputError(
                f"detector spec: {field} is {getattr(self, field)!r}, expected {expected}"
            )


IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

PLAIN = OnnxSpec()
"""RGB in [0, 1], resized to what the model fixes, and probabilities out."""

PRESETS = {
    # The sigmoid is part of the network; its own loader pads before the statistics.
    "iml-vit": OnnxSpec(size=1024, fit="pad", mean=IMAGENET_MEAN, std=IMAGENET_STD),
    "trufor": OnnxSpec(fit="none", scale=255 / 256, activation="softmax", channel=1),
    # Its inference reads BGR and applies the RGB statistics to it; it returns edges, then the map.
    "mvss-net": OnnxSpec(
        size=512,
        channels="bgr",
        mean=IMAGENET_MEAN,
        std=IMAGENET_STD,
        output=1,
        activation="sigmoid",
    ),
    # The sigmoid is part of the localisation head.
    "pscc-net": OnnxSpec(fit="none"),
}
"""Published networks, for exports of the whole network with its outputs in their own order."""


def read_spec(path: str | Path) -> OnnxSpec:
    """The spec that a TOML file holds.

    Args:
        path: A file with some of the fields of `OnnxSpec`.

    Returns:
        The spec; fields that the file leaves out are those of `PLAIN`.

    Raises:
        InputError: If there is no such file, it is no TOML, or it holds what makes no spec.
    """
    path = existing_file(path, expected="a detector spec (.toml)")
    try:
        return OnnxSpec.from_table(tomllib.loads(path.read_text(encoding="utf-8")))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except ValueError as error:
        raise InputError(
            f"{path}: no TOML ({error}), expected the fields of OnnxSpec, as in size = 512"
        ) from error


def spec_beside(model: str | Path) -> Path | None:
    """The file beside a model that says how to run it: net.toml for net.onnx, None without."""
    path = Path(model).parent / f"{Path(model).stem}.toml"
    return path if path.is_file() else None


def preset(name: str) -> OnnxSpec:
    """The spec of a published network.

    Raises:
        InputError: If `PRESETS` has no such name.
    """
    if name not in PRESETS:
        raise InputError(f"no detector preset {name!r}, expected one of {', '.join(PRESETS)}")
    return PRESETS[name]
