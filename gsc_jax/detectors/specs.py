"""Configuration of a forgery network: input size, channel statistics, output and activation.

`read_spec` reads an `OnnxSpec` from a TOML file with the same fields. A file net.toml beside
net.onnx is its spec. `PRESETS` holds published networks, with values from their inference code.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import pydantic
from pydantic import Field

from gsc_jax.io.files import existing_file
from gsc_jax.io.tables import read_table
from gsc_jax.io.validation import one_line
from gsc_jax.scene import InputError

MAX_COUNT = 65_536
"""Largest side of an input, number of outputs or channels: far beyond any network."""
Count = Annotated[int, Field(strict=True, gt=0, le=MAX_COUNT)]
Position = Annotated[int, Field(strict=True, ge=0, le=MAX_COUNT)]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e9, le=1e9)]
PositiveNumber = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-9, le=1e9)]
"""The normalisation is computed in float32."""
Probability = Annotated[float, Field(strict=True, gt=0, lt=1)]
Size = Count | tuple[Count, Count] | None


@pydantic.dataclasses.dataclass(frozen=True, kw_only=True, config={"extra": "forbid"})
class OnnxSpec:
    """Input and output conventions of a network; its input is `(scale * image - mean) / std`.

    An invalid value raises `pydantic.ValidationError`, which is a ValueError.

    Attributes:
        size: Input height and width, or one number; None for that of the model, or of the image.
        fit: "resize" does not keep the aspect ratio. "pad" shrinks a larger image and adds black at
            the bottom and right, before the normalisation; the map is cropped. "none" does nothing.
        multiple_of: Divisor of a free size, rounded to the nearest ("resize") or up ("pad").
        low_pass: Whether "resize" filters an image that shrinks, as Pillow does and cv2 does not.
        channels: Order of the input channels, and of `mean` and `std`.
        layout: Layout of input and output.
        scale: Factor of the image, whose values are in [0, 1].
        mean: Offset of each channel.
        std: Divisor of each channel.
        input: Expected name of the only input; None for any.
        output: Name or position of the output that holds the map.
        activation: Function to apply to the output; "softmax" is over the channels.
        channel: Output channel of the tampered class; None if there is only one channel.
        threshold: Decision threshold of the network; becomes 0.5 in the map.
    """

    size: Annotated[
        Size, pydantic.AfterValidator(lambda size: (size, size) if isinstance(size, int) else size)
    ] = None
    fit: Literal["resize", "pad", "none"] = "resize"
    multiple_of: Count = 1
    low_pass: bool = True
    channels: Literal["rgb", "bgr"] = "rgb"
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    scale: PositiveNumber = 1.0
    mean: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    std: tuple[PositiveNumber, PositiveNumber, PositiveNumber] = (1.0, 1.0, 1.0)
    input: Annotated[str, Field(min_length=1)] | None = None
    output: Position | str = 0
    activation: Literal["none", "sigmoid", "softmax"] = "none"
    channel: Position | None = None
    threshold: Probability = 0.5

    @pydantic.model_validator(mode="after")
    def _check_size(self) -> Self:
        if self.fit == "none" and (self.size is not None or self.multiple_of != 1):
            raise ValueError('size and multiple_of: expected none with fit = "none"')
        if isinstance(self.size, tuple) and any(side % self.multiple_of for side in self.size):
            raise ValueError(f"size: expected multiples of {self.multiple_of}, found {self.size}")
        return self

    @classmethod
    def from_table(cls, table: Mapping[str, Any], *, where: str = "detector spec") -> Self:
        """Create a spec from values by field name; an invalid one raises InputError of `where`."""
        try:
            return cls(**table)
        except pydantic.ValidationError as error:
            known = [field.name for field in dataclasses.fields(cls)]
            raise InputError(one_line(error, where, table, known=known)) from error


IMAGENET: Any = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}

PLAIN = OnnxSpec()
"""RGB in [0, 1], resized to the input size of the model, and a probability map as output."""

PRESETS = {
    # The network includes the sigmoid. Its loader pads before the normalisation.
    "iml-vit": OnnxSpec(size=1024, fit="pad", **IMAGENET),
    "trufor": OnnxSpec(fit="none", scale=255 / 256, activation="softmax", channel=1),
    # The inference code reads BGR, but applies the RGB statistics. Outputs: edges, map.
    "mvss-net": OnnxSpec(
        size=512, low_pass=False, channels="bgr", **IMAGENET, output=1, activation="sigmoid"
    ),
    # The localisation head includes the sigmoid.
    "pscc-net": OnnxSpec(fit="none"),
}
"""Published networks, for exports of the whole network with its outputs in the original order."""


def read_spec(path: str | Path) -> OnnxSpec:
    """Read a spec from a TOML file, whose fields are optional; an invalid one raises InputError."""
    path = existing_file(path, expected="a detector spec (.toml)")
    table = read_table(path, remedy="expected fields of OnnxSpec, such as size = 512")
    return OnnxSpec.from_table(table, where=str(path))


def spec_beside(model: str | Path) -> Path | None:
    """Path of net.toml beside net.onnx, or None if there is no such file."""
    path = Path(model).parent / f"{Path(model).stem}.toml"
    return path if path.is_file() else None


def preset(name: str) -> OnnxSpec:
    """Spec of a published network; raises InputError if `PRESETS` has no such name."""
    if name not in PRESETS:
        raise InputError(f"no detector preset {name!r}, expected one of {', '.join(PRESETS)}")
    return PRESETS[name]
