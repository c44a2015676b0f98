"""The adapters give the maps of the authors' own steps, on networks with random weights."""

import numpy as np
import pytest
import reference_detectors as reference
from onnx import helper
from onnx_models import FREE, network, view
from onnxruntime import InferenceSession
from safire_models import decoder, encoder

from gsc_jax.detectors.onnx import PRESETS, OnnxDetector
from gsc_jax.detectors.safire import SafireDetector

ROUNDING = 0.6 / 255
"""Largest change of a map by the rounding of a resized image to 8 bits, which only theirs have."""
SIDES = {"iml-vit": 1024, "mvss-net": 512}


def levels(height: int, width: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:height, :width]
    smooth = 128 + 60 * np.sin(rows / 7)[..., None] + 60 * np.cos(columns / 5)[..., None]
    return np.clip(smooth + rng.normal(0, 20, (height, width, 3)), 0, 255).astype(np.uint8)


def random_network(folder, name: str):
    """A convolution with random weights of the inputs and outputs of a published network."""
    rng = np.random.default_rng(1)
    count = 2 if name == "trufor" else 1
    activation = "Sigmoid" if PRESETS[name].activation == "none" else "Identity"
    side = SIDES.get(name)
    outputs = ("edges", "map") if name == "mvss-net" else ("map",)
    nodes = [
        helper.make_node("Conv", ["image", "weights"], ["logits"], pads=[1, 1, 1, 1]),
        helper.make_node(activation, ["logits"], ["map"]),
        helper.make_node("Neg", ["logits"], ["edges"]),
    ]
    return network(
        folder,
        *nodes[: 1 + len(outputs)],
        shape=FREE if side is None else (1, 3, side, side),
        constants={"weights": (0.3 * rng.normal(size=(count, 3, 3, 3))).astype(np.float32)},
        outputs=outputs,
    )


def computed(path):
    """A function that computes all outputs of a network."""
    session = InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [tensor.name for tensor in session.get_inputs()]

    def run(*arrays):
        feed = {name: np.asarray(a, np.float32) for name, a in zip(names, arrays, strict=True)}
        return session.run(None, feed)

    return run


@pytest.mark.parametrize("size", [(60, 80), (45, 33)])
@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_the_steps_of_the_authors(tmp_path, name, size):
    path, image = random_network(tmp_path, name), levels(*size)
    steps = getattr(reference, name.replace("-", "_"))
    found = OnnxDetector(path, name)((image / 255).astype(np.float32), view())
    bound = ROUNDING * 3 if name == "mvss-net" else 1e-4
    np.testing.assert_allclose(found, steps(image, computed(path)), atol=bound)


def test_mvss_net_shrinks_without_a_low_pass(tmp_path):
    path, image = random_network(tmp_path, "mvss-net"), levels(700, 900)
    found = OnnxDetector(path, "mvss-net")((image / 255).astype(np.float32), view())
    expected = reference.mvss_net(image, computed(path))
    np.testing.assert_allclose(found, expected, atol=ROUNDING * 3)


def test_safire_is_that_of_its_authors(tmp_path):
    first, second = encoder(tmp_path), decoder(tmp_path, steepness=4.0)
    image = (100 + levels(24, 40) // 8).astype(np.uint8)  # every mask has cells inside
    image[6:14, 20:30] = (220, 30, 40)
    expected = reference.safire(image, computed(first), computed(second), side=32, grid=4)
    found = SafireDetector(tmp_path, grid=4)((image / 255).astype(np.float32), view())
    assert expected.std() > 0.1
    np.testing.assert_allclose(found, expected, atol=1e-4)
