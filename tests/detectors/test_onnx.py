"""A network receives the image and returns the map as its spec describes."""

import dataclasses

import numpy as np
import pytest
from onnx import TensorProto, helper
from onnx_models import FREE, first_channel, identity, network, view

from gsc_jax.detectors.onnx import PRESETS, OnnxDetector, OnnxSpec
from gsc_jax.scene import InputError

IMAGE = np.random.default_rng(3).uniform(size=(6, 8, 3)).astype(np.float32)
VIEW, OTHER = view(), view("other")


def test_plain_network_returns_its_map(tmp_path):
    detector = OnnxDetector(network(tmp_path), threads=1)
    found = detector(IMAGE, VIEW)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-6)
    assert detector.needs_image is True
    assert detector.select([VIEW]) == [VIEW]
    assert detector.warnings == ()


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("channels", ["rgb", "bgr"])
def test_channel_order(tmp_path, channels, channel):
    spec = OnnxSpec(channels=channels, channel=channel)
    found = OnnxDetector(network(tmp_path, identity()), spec)(IMAGE, VIEW)
    expected = IMAGE if channels == "rgb" else IMAGE[..., ::-1]
    np.testing.assert_allclose(found, expected[..., channel], atol=1e-6)


def test_statistics_apply_to_the_reordered_channels(tmp_path):
    mean, std = (0.1, 0.2, 0.3), (2.0, 4.0, 8.0)
    spec = OnnxSpec(channels="bgr", scale=2.0, mean=mean, std=std, channel=2, activation="sigmoid")
    found = OnnxDetector(network(tmp_path, identity()), spec)(IMAGE, VIEW)
    logit = (2 * IMAGE[..., 0] - 0.3) / 8
    np.testing.assert_allclose(found, 1 / (1 + np.exp(-logit)), atol=1e-6)


def test_nhwc_layout(tmp_path):
    path = network(tmp_path, identity(), shape=(1, "H", "W", 3))
    found = OnnxDetector(path, OnnxSpec(layout="NHWC", channel=1))(IMAGE, VIEW)
    np.testing.assert_allclose(found, IMAGE[..., 1], atol=1e-6)


def test_softmax_is_over_channels(tmp_path):
    spec = OnnxSpec(activation="softmax", channel=1)
    found = OnnxDetector(network(tmp_path, identity()), spec)(IMAGE, VIEW)
    weights = np.exp(IMAGE)
    np.testing.assert_allclose(found, weights[..., 1] / weights.sum(-1), atol=1e-6)


def test_half_precision(tmp_path):
    found = OnnxDetector(network(tmp_path, dtype=TensorProto.FLOAT16))(IMAGE, VIEW)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-3)


def test_threshold_becomes_one_half(tmp_path):
    image = np.full((6, 8, 3), 0.3, np.float32)
    image[0, 0], image[0, 1], image[0, 2] = 0.0, 1.0, 0.65
    found = OnnxDetector(network(tmp_path), OnnxSpec(threshold=0.3))(image, VIEW)
    np.testing.assert_allclose(found[0, :4], [0, 1, 0.75, 0.5], atol=1e-6)
    assert (found > 0.5).sum() == 2


@pytest.mark.parametrize(
    ("spec", "shape"),
    [
        (OnnxSpec(), (6, 8)),
        (OnnxSpec(fit="none"), (6, 8)),
        (OnnxSpec(size=16), (16, 16)),
        (OnnxSpec(size=(4, 12)), (4, 12)),
        (OnnxSpec(multiple_of=4), (8, 8)),
        (OnnxSpec(multiple_of=5), (5, 10)),
        (OnnxSpec(multiple_of=32), (32, 32)),
    ],
)
def test_image_is_resized_to_the_input_size(tmp_path, spec, shape):
    found = OnnxDetector(network(tmp_path), spec)(IMAGE, VIEW)
    assert found.shape == shape
    if shape == (6, 8):
        np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-6)
    assert found.mean() == pytest.approx(IMAGE[..., 0].mean(), abs=0.05)


@pytest.mark.parametrize(
    ("spec", "shape"),
    [
        (OnnxSpec(size=16, fit="pad"), (6, 8)),
        (OnnxSpec(multiple_of=5, fit="pad"), (6, 8)),
        (OnnxSpec(size=4, fit="pad"), (3, 4)),
        (OnnxSpec(size=(3, 9), fit="pad"), (3, 4)),
    ],
)
def test_padding_is_cropped_from_the_map(tmp_path, spec, shape):
    found = OnnxDetector(network(tmp_path), spec)(IMAGE, VIEW)
    assert found.shape == shape
    if shape == (6, 8):
        np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-6)
    else:
        assert found.min() > 0, "the map contains padding"


def test_padding_is_black_before_the_normalisation(tmp_path):
    mean = helper.make_node("ReduceMean", ["image"], ["average"], axes=[1, 2, 3])
    spread = helper.make_node("Mul", ["one", "average"], ["map"])
    path = network(tmp_path, mean, spread, constants={"one": np.ones((1, 1, 2, 2), np.float32)})
    spec = OnnxSpec(size=16, fit="pad", mean=(-0.25, -0.25, -0.25))
    found = OnnxDetector(path, spec)(np.ones((8, 16, 3), np.float32), VIEW)
    np.testing.assert_allclose(found, 0.75, atol=1e-6)
    assert found.shape == (1, 2)


@pytest.mark.parametrize(("stride", "shape"), [(2, (4, 8)), (4, (2, 4)), (16, (8, 16))])
def test_coarse_map_is_cropped_in_proportion(tmp_path, stride, shape):
    """A map with a cell that contains image and padding is upsampled first."""
    sides = [stride, stride]
    pool = helper.make_node("AveragePool", ["one"], ["map"], kernel_shape=sides, strides=sides)
    path = network(tmp_path, *first_channel("one"), pool)
    image = np.full((8, 16, 3), 0.25, np.float32)
    found = OnnxDetector(path, OnnxSpec(size=16, fit="pad"))(image, VIEW)
    assert found.shape == shape
    np.testing.assert_allclose(found, 0.25 if stride < 16 else 0.125, atol=1e-6)


def test_model_fixes_the_size_if_the_spec_has_none(tmp_path):
    path = network(tmp_path, shape=(1, 3, 10, 12))
    assert OnnxDetector(path)(IMAGE, VIEW).shape == (10, 12)
    assert OnnxDetector(path, OnnxSpec(fit="pad"))(IMAGE, VIEW).shape == (6, 8)
    assert OnnxDetector(path, OnnxSpec(size=(10, 12)))(IMAGE, VIEW).shape == (10, 12)
    unfit = OnnxDetector(path, OnnxSpec(fit="none"))
    assert unfit(np.zeros((10, 12, 3), np.float32), VIEW).shape == (10, 12)
    with pytest.raises(InputError, match=r"'image' takes images of \[10, 12\], found \[6, 8\]"):
        unfit(IMAGE, VIEW)


@pytest.mark.parametrize("output", [1, "map"])
def test_output_by_position_or_name(tmp_path, output):
    path = network(tmp_path, identity("edges"), *first_channel(), outputs=("edges", "map"))
    found = OnnxDetector(path, OnnxSpec(output=output))(IMAGE, VIEW)
    np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-6)


@pytest.mark.parametrize("axes", [[0], [0, 1]])
def test_map_without_batch_or_channel(tmp_path, axes):
    squeeze = helper.make_node("Squeeze", ["one", "axes"], ["map"])
    path = network(tmp_path, *first_channel("one"), squeeze, constants={"axes": np.array(axes)})
    np.testing.assert_allclose(OnnxDetector(path)(IMAGE, VIEW), IMAGE[..., 0], atol=1e-6)


@pytest.mark.parametrize("threshold", [0.5, 0.2, 0.8])
def test_outputs_that_are_not_finite_are_undecided_and_counted(tmp_path, threshold):
    log = helper.make_node("Log", ["one"], ["map"])
    path = network(tmp_path, *first_channel("one"), log)
    image = np.full((6, 8, 3), np.e, np.float32)
    detector = OnnxDetector(path, OnnxSpec(threshold=threshold))
    detector(image, OTHER)
    image[0, :3] = -1.0
    found = detector(image, VIEW)
    np.testing.assert_allclose(found[0, :3], 0.5, atol=1e-6)
    assert not (found[0, :3] > 0.5).any()
    np.testing.assert_allclose(found[1:], 1, atol=1e-5)
    (warning,) = detector.warnings
    assert "3 outputs" in warning
    assert "in 1 of 2 views (first in 'view')" in warning


def test_infinite_logits_are_decided(tmp_path):
    detector = OnnxDetector(network(tmp_path), OnnxSpec(activation="sigmoid"))
    image = np.full((2, 2, 3), np.inf, np.float32)
    image[0] = -np.inf
    np.testing.assert_array_equal(detector(image, VIEW), [[0, 0], [1, 1]])
    assert detector.warnings == ()


def test_sigmoid_of_probabilities_is_a_warning(tmp_path):
    detector = OnnxDetector(network(tmp_path), OnnxSpec(activation="sigmoid"))
    detector(IMAGE, VIEW)
    assert "probabilities already" in detector.warnings[0]
    detector(IMAGE * 8 - 4, OTHER)
    assert detector.warnings == ()


def test_logits_without_activation_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"'map' spans .* set activation to sigmoid"):
        OnnxDetector(network(tmp_path))(IMAGE * 8 - 4, VIEW)


@pytest.mark.parametrize(
    ("build", "spec", "reason"),
    [
        (
            {"shape": (1, 1, "H", "W")},
            OnnxSpec(),
            r"'image' is tensor\(float\) of shape \[1, 1, H, W\].*\[1, 3, \?, \?",
        ),
        ({"shape": (4, 3, "H", "W")}, OnnxSpec(), r"\[4, 3, H, W\]"),
        ({"shape": (1, 3, "N")}, OnnxSpec(), r"\[1, 3, N\]"),
        ({"shape": (1, "H", "W", 3)}, OnnxSpec(size=8), r"\[1, H, W, 3\].*\[1, 3, 8, 8\]"),
        ({}, OnnxSpec(layout="NHWC"), r"expects \[1, \?, \?, 3\]"),
        ({"shape": (1, 3, 10, 12)}, OnnxSpec(size=10), r"\[1, 3, 10, 12\].*\[1, 3, 10, 10\]"),
        (
            {"dtype": TensorProto.INT64},
            OnnxSpec(),
            r"'image' is tensor\(int64\) of shape \[1, 3, H, W\], expected .*tensor\(float\)",
        ),
        ({"inputs": ("image", "mask")}, OnnxSpec(), r"2 inputs \(image, mask\)"),
        ({}, OnnxSpec(input="x"), "no input 'x', the model has 'image'"),
        ({}, OnnxSpec(output=1), "no output 1, expected one of map"),
        ({}, OnnxSpec(output="edges"), "no output 'edges'"),
        ({"map_shape": (1, 1, "H", "W")}, OnnxSpec(channel=1), "1 channels, and channel is 1"),
        ({"map_shape": (1, 1, "H", "W")}, OnnxSpec(activation="softmax"), "softmax needs two"),
    ],
)
def test_model_that_contradicts_the_spec_is_refused_when_loaded(tmp_path, build, spec, reason):
    with pytest.raises(InputError, match=reason) as caught:
        OnnxDetector(network(tmp_path, **build), spec)
    assert str(caught.value).startswith(f"{tmp_path / 'net.onnx'}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("shape", "spec", "reason"),
    [
        ([1, 3, 6, 8], OnnxSpec(), r"'map' has shape \[1, 3, .*it has 3 channels"),
        ([1, 3, 6, 8], OnnxSpec(channel=3), "channel is 3"),
        ([1, -1], OnnxSpec(), r"\[1, 144\], which is not a map"),
        ([1, 3, 6, 4, 2], OnnxSpec(), "expected one map"),
        ([3, 1, 6, 8], OnnxSpec(), "expected one map"),
        ([7, -1], OnnxSpec(), "fails on view 'view'"),
    ],
)
def test_output_that_is_not_a_map_is_refused(tmp_path, capfd, shape, spec, reason):
    reshape = helper.make_node("Reshape", ["image", "shape"], ["map"])
    path = network(tmp_path, reshape, constants={"shape": np.array(shape)})
    with pytest.raises(InputError, match=reason) as caught:
        OnnxDetector(path, spec)(IMAGE, VIEW)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", ""), "onnxruntime prints the error as well"


def test_invalid_arguments_are_refused(tmp_path):
    with pytest.raises(InputError, match="no detector preset 'trufoor', expected one of iml-vit"):
        OnnxDetector(network(tmp_path), "trufoor")
    with pytest.raises(InputError, match="no cameras"):
        OnnxDetector(network(tmp_path)).select([])
    with pytest.raises(ValueError, match="needs the rendered image"):
        OnnxDetector(network(tmp_path))(None, VIEW)


@pytest.mark.parametrize("name", ["iml-vit", "pscc-net"])
def test_a_preset_of_a_network_with_another_input_is_questioned(tmp_path, name):
    other = OnnxDetector(network(tmp_path, shape=FREE), dataclasses.replace(PRESETS[name]))
    assert any("right preset" in text for text in other.warnings) == (name == "iml-vit")
    own = OnnxDetector(other.path, dataclasses.replace(PRESETS[name], size=512, fit="resize"))
    assert own.warnings == ()


@pytest.mark.parametrize(
    ("name", "side", "channels"),
    [("iml-vit", 1024, 1), ("trufor", None, 2), ("mvss-net", 512, 1), ("pscc-net", None, 1)],
)
def test_presets_run_on_networks_of_their_shapes(tmp_path, name, side, channels):
    logits = helper.make_node("Gather", ["image", "pick"], ["logits"], axis=1)
    last = "Sigmoid" if PRESETS[name].activation == "none" else "Identity"
    outputs = ("map",) if PRESETS[name].output == 0 else ("edges", "map")
    nodes = [logits, helper.make_node(last, ["logits"], ["map"]), identity("edges")]
    path = network(
        tmp_path,
        *nodes[: 1 + len(outputs)],
        shape=FREE if side is None else (1, 3, side, side),
        constants={"pick": np.arange(channels)},
        outputs=outputs,
    )
    image = np.zeros((6, 8, 3), np.float32)
    image[:, 4:] = 1.0
    found = OnnxDetector(path, name)(image, VIEW)
    assert found.shape == ((512, 512) if name == "mvss-net" else (6, 8))
    if name != "trufor":  # its two channels are equal here
        assert found[0, 0] < found[0, -1]
