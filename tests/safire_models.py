"""Stand-ins for the networks of SAFIRE.

The embedding of a cell is its mean colour. The mask of a point contains the cells with a similar
colour.
"""

from pathlib import Path

import numpy as np
from onnx import helper
from onnx_models import FLOAT, save

from gsc_jax.detectors.safire import SafireDetector

SIDE, CELLS = 32, 8
ODD = (slice(8, 16), slice(20, 28))
"""Square of another colour in `IMAGE`, a sixteenth of it."""

IMAGE = np.full((SIDE, SIDE, 3), 0.5, np.float32)
IMAGE[ODD] = (0.9, 0.1, 0.1)


def encoder(folder: Path, *, shape: tuple = (1, 3, SIDE, SIDE)) -> Path:
    pool = helper.make_node(
        "AveragePool", ["pixels"], ["colours"], kernel_shape=[4, 4], strides=[4, 4]
    )
    inputs, outputs = {"pixels": (FLOAT, shape)}, {"colours": (FLOAT, None)}
    return save(folder / "encoder.onnx", [pool], inputs, outputs, {})


def decoder(
    folder: Path,
    *,
    prompts: int | str = "P",
    label_dtype: int = FLOAT,
    confidence: float = 0.9,
    steepness: float = 40.0,
    shift: float = 0.0,
    mask_shape: tuple = (-1, 1, CELLS, CELLS),
    scale: float = 2.0,
) -> Path:
    """Mask logits `steepness * (cosine - 0.9) + shift`, where the cosine compares colours.

    The confidence is the given one, plus a little for larger masks.
    """

    def node(kind, inputs, output, **attributes):
        return helper.make_node(kind, inputs.split(" "), [output], **attributes)

    nodes = [
        node("Cast", "point_labels", "foreground", to=FLOAT),
        node("Mul", "point_coords to_unit", "unit"),
        node("Sub", "unit one", "centred"),
        node("Unsqueeze", "centred first", "places"),
        node("GridSample", "embeddings places", "picked", mode="nearest", align_corners=0),
        node("Reshape", "picked by_channel", "columns"),
        node("Transpose", "columns", "points", perm=[1, 0]),
        node("LpNormalization", "points", "point_directions", axis=1, p=2),
        node("Reshape", "embeddings by_channel", "cells"),
        node("LpNormalization", "cells", "cell_directions", axis=0, p=2),
        node("MatMul", "point_directions cell_directions", "cosine"),
        node("Sub", "cosine border", "above"),
        node("Mul", "above steepness", "steep"),
        node("Mul", "steep foreground", "prompted"),
        node("Add", "prompted shift", "logits"),
        node("Reshape", "logits mask_shape", "coarse"),
        node("Resize", "coarse  scales", "masks", mode="nearest"),
        node("ReduceMean", "cosine", "mean_cosine", axes=[1], keepdims=1),
        node("Mul", "mean_cosine slight", "extra"),
        node("Add", "extra confidence", "confidences"),
    ]
    constants = {
        "to_unit": np.float32(2 / SIDE),
        "one": np.float32(1),
        "first": np.array([0]),
        "by_channel": np.array([3, -1]),
        "border": np.float32(0.9),
        "steepness": np.float32(steepness),
        "shift": np.float32(shift),
        "mask_shape": np.array(mask_shape),
        "scales": np.array([1, 1, scale, scale], np.float32),
        "slight": np.float32(0.01),
        "confidence": np.float32(confidence),
    }
    inputs = {
        "embeddings": (FLOAT, (1, "C", "H", "W")),
        "point_coords": (FLOAT, (prompts, 1, 2)),
        "point_labels": (label_dtype, (prompts, 1)),
    }
    outputs = {"masks": (FLOAT, None), "confidences": (FLOAT, None)}
    return save(folder / "decoder.onnx", nodes, inputs, outputs, constants)


def detector(folder: Path, *, grid: int = 8, seed: int = 0, **options) -> SafireDetector:
    encoder(folder)
    decoder(folder, **options)
    return SafireDetector(folder, grid=grid, seed=seed, threads=1)
