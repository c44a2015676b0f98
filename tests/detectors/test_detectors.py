"""Detectors: masks find their cameras, and a network is fed and read as its spec says."""

import dataclasses
import json
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from gsc_jax.detectors import fitting
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.detectors.onnx import PRESETS, OnnxDetector, OnnxSpec
from gsc_jax.io import masks
from gsc_jax.scene import Camera, InputError

TAMPERED = Path(__file__).parents[3] / "shared" / "data" / "tampered"


def camera(name: str, width: int = 8, height: int = 6) -> Camera:
    return Camera(
        viewmat=np.eye(4, dtype=np.float32),
        K=np.eye(3, dtype=np.float32),
        width=width,
        height=height,
        name=name,
    )


def cameras(*names: str) -> list[Camera]:
    return [camera(name) for name in names]


def folder(path: Path, *files: str) -> FolderDetector:
    """A folder in which the k-th mask is wide k + 1, so that one knows which was read."""
    for k, file in enumerate(files):
        (path / file).parent.mkdir(parents=True, exist_ok=True)
        extension = Path(file).suffix.lower()
        iio.imwrite(path / file, np.full((1, k + 1), 255, np.uint8), extension=extension)
    return FolderDetector(path)


def one_line(caught) -> str:
    message = str(caught.value)
    assert "\n" not in message
    return message


# A folder of masks


@pytest.mark.parametrize(
    ("name", "files", "read"),
    [
        ("a", ["a.png"], "a.png"),
        ("a", ["a.PNG"], "a.PNG"),
        ("a", ["b.png", "a.JPG"], "a.JPG"),
        ("a.jpg", ["a.png"], "a.png"),
        ("a.jpg", ["a.png", "a.jpg.png"], "a.jpg.png"),
        ("a.png", ["a.png"], "a.png"),
        ("a", ["a.jpg.png"], "a.jpg.png"),
        ("a", ["a.jpg.png", "a.png"], "a.png"),
        ("img.0001.JPG", ["img.0001.png", "img.0002.png", "img.png"], "img.0001.png"),
        ("img.0001", ["img.0001.png", "img.0002.png", "img.png"], "img.0001.png"),
        ("left/a.JPG", ["left/a.png", "right/a.png"], "left/a.png"),
        ("left/a.JPG", ["left/a.png", "a.png"], "left/a.png"),
        ("left\\a.JPG", ["left/a.png", "right/a.png"], "left/a.png"),
        ("left/a.JPG", ["a.png"], "a.png"),
        ("left/a.JPG", ["a.JPG.png", "a.png"], "a.JPG.png"),
        ("left/a", ["a.JPG.png"], "a.JPG.png"),
        ("a.JPG", ["masks/a.png"], "masks/a.png"),
    ],
)
def test_a_camera_finds_its_mask(tmp_path, name, files, read):
    detector = folder(tmp_path, *files)
    (chosen,) = detector.select(cameras(name))
    assert detector(None, chosen).shape == (1, files.index(read) + 1)
    assert detector.unmatched(cameras(name)) == []


@pytest.mark.parametrize(
    ("name", "file"),
    [("a", "A.png"), ("a", "aa.png"), ("img.0001", "img.png"), ("left/a", "right/a.png")],
)
def test_a_mask_of_something_else_is_not_taken(tmp_path, name, file):
    detector = folder(tmp_path, file)
    assert detector.unmatched(cameras(name)) == [name]
    with pytest.raises(InputError, match="named after") as caught:
        detector.select(cameras(name))
    message = one_line(caught)
    assert repr(name) in message
    assert repr(file) in message
    assert repr(f"{name}.png") in message
    with pytest.raises(InputError, match="no mask for camera"):
        detector(None, camera(name))


def test_cameras_keep_their_order_and_those_without_a_mask_are_named(tmp_path):
    detector = folder(tmp_path, "a.png", "c.png", "unused.png")
    views = cameras("c", "b", "a", "d")
    assert [view.name for view in detector.select(views)] == ["c", "a"]
    assert detector.unmatched(views) == ["b", "d"]
    assert detector.needs_image is False


@pytest.mark.parametrize(
    ("names", "files"),
    [
        (["a"], ["a.png", "a.jpg"]),
        (["a.jpg"], ["a.png", "a.jpg"]),
        (["a"], ["masks/a.png", "detector/a.png"]),
        (["left/a", "right/a"], ["a.png"]),
        (["a.jpg", "a.png"], ["a.png"]),
        (["a", "a"], ["a.png"]),
    ],
)
def test_ambiguous_claims_are_never_guessed(tmp_path, names, files):
    detector = folder(tmp_path, *files)
    with pytest.raises(InputError, match="equally well") as caught:
        detector.select(cameras(*names))
    assert str(tmp_path) in one_line(caught)


def test_the_more_exact_claim_gets_the_file(tmp_path):
    detector = folder(tmp_path, "a.png")
    views = cameras("left/a", "a")
    assert [view.name for view in detector.select(views)] == ["a"]
    assert detector.unmatched(views) == ["left/a"]


def test_what_is_no_folder_of_masks_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("no mask")
    (tmp_path / "other" / "._a.png").write_bytes(b"finder")
    iio.imwrite(tmp_path / "a.png", np.zeros((2, 2), np.uint8))
    expected = {
        "missing": "does not exist",
        "a.png": "is a file",
        "empty": "no images",
        "other": "no images",
    }
    for name, reason in expected.items():
        with pytest.raises(InputError, match=reason) as caught:
            FolderDetector(tmp_path / name)
        assert str(tmp_path / name) in one_line(caught)
    with pytest.raises(InputError, match="no cameras"):
        folder(tmp_path / "full", "a.png").select([])


def test_zero_one_is_decided_for_the_whole_folder(tmp_path):
    binary, soft = tmp_path / "binary", tmp_path / "soft"
    ones = np.ones((2, 2), np.uint8)
    for path, levels in ((binary, (0, 1)), (soft, (1, 200))):
        path.mkdir()
        for name, level in zip("ab", levels, strict=True):
            iio.imwrite(path / f"{name}.png", level * ones)
    iio.imwrite(binary / "overlay.png", np.eye(3, dtype=np.uint8)[None] * 200)
    np.testing.assert_array_equal(FolderDetector(binary)(None, camera("b")), ones)
    np.testing.assert_allclose(FolderDetector(soft)(None, camera("a")), ones / 255, rtol=1e-6)
    assert "0/1" in FolderDetector(binary).warnings[0]
    assert FolderDetector(soft).warnings == ()


@pytest.mark.parametrize("name", ["a", "a.png", "img.0001.JPG", "left/a.b.JPG", "left\\a"])
def test_what_is_written_for_a_camera_is_found_by_it(tmp_path, name):
    masks.write_mask(masks.image_path(tmp_path, name), np.ones((3, 2), bool))
    masks.write_mask(masks.image_path(tmp_path, "other/" + name), np.zeros((1, 1), bool))
    detector = FolderDetector(tmp_path)
    assert detector(None, camera(name)).shape == (3, 2)


@pytest.mark.skipif(not TAMPERED.is_dir(), reason="the development scenes are not here")
@pytest.mark.parametrize("scene", ["kitchen-incorporate", "playbot-remove"])
def test_the_development_scenes_match_their_detector(scene):
    entries = json.loads((TAMPERED / scene / "cameras.json").read_text())
    views = [camera(entry["img_name"], entry["width"], entry["height"]) for entry in entries]
    detector = FolderDetector(TAMPERED / scene / "detector")
    assert detector.select(views) == views
    assert detector.unmatched(views) == []
    assert detector.warnings == ()
    shares = []
    for view in views[::6]:
        said = detector(None, view)
        assert said.shape == (view.height, view.width)
        assert set(np.unique(said)) <= {0.0, 1.0}
        shares.append(said.mean())
    assert 0 < max(shares) < 1, "the detector says the same everywhere"


# Fitting


@given(
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
)
@settings(max_examples=60, deadline=None)
def test_padding_is_undone(shape, target):
    image = np.ones((*shape, 3), np.float32)
    canvas, (height, width) = fitting.fit_image(image, target, fit="pad")
    assert canvas.shape == (*target, 3)
    np.testing.assert_allclose(canvas[:height, :width], 1, rtol=1e-6)
    assert canvas.sum() == pytest.approx(3 * height * width, rel=1e-5)
    cropped = fitting.crop_map(canvas[..., 0], target, (height, width))
    assert cropped.shape == (height, width)
    if shape[0] <= target[0] and shape[1] <= target[1]:
        assert (height, width) == shape


@given(st.floats(0.01, 0.99), st.lists(st.floats(0, 1, width=32), min_size=2, max_size=8))
def test_remapping_keeps_order_and_decision(threshold, values):
    values = np.sort(np.array([0, threshold, 1, *values], np.float32))
    found = fitting.remap(values, threshold=threshold)
    assert found.dtype == np.float32
    assert (found[0], found[-1]) == (0, 1)
    assert (np.diff(found) >= 0).all()
    np.testing.assert_array_equal(found > 0.5, values > threshold)


@pytest.mark.parametrize("threshold", [0.3, 0.5, 0.9])
def test_remapping_decides_to_the_last_bit(threshold):
    just = np.float32(threshold)
    values = np.array([np.nextafter(just, 0), just, np.nextafter(just, 1)], np.float32)
    found = fitting.remap(values, threshold=threshold)
    np.testing.assert_array_equal(found > 0.5, [False, False, True])
    np.testing.assert_allclose(found, 0.5, atol=1e-6)


# Networks

FREE = (1, 3, "H", "W")


def network(
    path: Path,
    *nodes: onnx.NodeProto,
    takes: tuple = FREE,
    gives: tuple | None = None,
    dtype: int = TensorProto.FLOAT,
    constants: dict | None = None,
    outputs: tuple[str, ...] = ("map",),
    more_inputs: tuple[str, ...] = (),
) -> Path:
    """A little ONNX file; by default its map is the first channel of its input."""
    if not nodes:
        nodes = first_channel()
        constants = {"zero": np.array([0])}
    graph = helper.make_graph(
        list(nodes),
        "network",
        [helper.make_tensor_value_info(name, dtype, takes) for name in ("image", *more_inputs)],
        [helper.make_tensor_value_info(name, dtype, gives) for name in outputs],
        [numpy_helper.from_array(value, name) for name, value in (constants or {}).items()],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path / "net.onnx")
    return path / "net.onnx"


def first_channel(source: str = "image", axis: int = 1, output: str = "map") -> tuple:
    return (helper.make_node("Gather", [source, "zero"], [output], axis=axis),)


def identity(output: str = "map") -> onnx.NodeProto:
    return helper.make_node("Identity", ["image"], [output])


IMAGE = np.random.default_rng(3).uniform(size=(6, 8, 3)).astype(np.float32)
VIEW = camera("view")


def test_a_plain_network_sees_the_image_and_its_map_comes_back(tmp_path):
    detector = OnnxDetector(network(tmp_path), threads=1)
    found = detector(IMAGE, VIEW)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-6)
    assert detector.needs_image is True
    assert detector.select([VIEW]) == [VIEW]
    assert detector.warnings == ()


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("channels", ["rgb", "bgr"])
def test_channels_come_in_the_order_of_the_spec(tmp_path, channels, channel):
    spec = OnnxSpec(channels=channels, channel=channel)
    found = OnnxDetector(network(tmp_path, identity()), spec)(IMAGE, VIEW)
    expected = IMAGE if channels == "rgb" else IMAGE[..., ::-1]
    np.testing.assert_allclose(found, expected[..., channel], atol=1e-6)


def test_the_statistics_are_those_of_the_channel_as_fed(tmp_path):
    mean, std = (0.1, 0.2, 0.3), (2.0, 4.0, 8.0)
    spec = OnnxSpec(channels="bgr", scale=2.0, mean=mean, std=std, channel=2, activation="sigmoid")
    found = OnnxDetector(network(tmp_path, identity()), spec)(IMAGE, VIEW)
    fed = (2 * IMAGE[..., 0] - 0.3) / 8
    np.testing.assert_allclose(found, 1 / (1 + np.exp(-fed)), atol=1e-6)


def test_nhwc_networks(tmp_path):
    path = network(tmp_path, identity(), takes=(1, "H", "W", 3))
    found = OnnxDetector(path, OnnxSpec(layout="NHWC", channel=1))(IMAGE, VIEW)
    np.testing.assert_allclose(found, IMAGE[..., 1], atol=1e-6)


def test_softmax_is_over_channels(tmp_path):
    spec = OnnxSpec(activation="softmax", channel=1)
    found = OnnxDetector(network(tmp_path, identity()), spec)(IMAGE, VIEW)
    weights = np.exp(IMAGE)
    np.testing.assert_allclose(found, weights[..., 1] / weights.sum(-1), atol=1e-6)


def test_half_precision_networks(tmp_path):
    path = network(tmp_path, dtype=TensorProto.FLOAT16)
    found = OnnxDetector(path)(IMAGE, VIEW)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-3)


def test_the_threshold_becomes_one_half(tmp_path):
    image = np.full((6, 8, 3), 0.3, np.float32)
    image[0, 0], image[0, 1], image[0, 2] = 0.0, 1.0, 0.65
    found = OnnxDetector(network(tmp_path), OnnxSpec(threshold=0.3))(image, VIEW)
    np.testing.assert_allclose(found[0, :4], [0, 1, 0.75, 0.5], atol=1e-6)
    assert (found > 0.5).sum() == 2


@pytest.mark.parametrize(
    ("spec", "fed"),
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
def test_images_are_resized_to_what_the_network_takes(tmp_path, spec, fed):
    found = OnnxDetector(network(tmp_path), spec)(IMAGE, VIEW)
    assert found.shape == fed
    if fed == (6, 8):
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
        assert found.min() > 0, "the padding shows"


def test_padding_is_black_before_the_statistics(tmp_path):
    """The mean over the input is what the network sees of the margin."""
    mean = helper.make_node("ReduceMean", ["image"], ["average"], axes=[1, 2, 3])
    spread = helper.make_node("Mul", ["one", "average"], ["map"])
    path = network(tmp_path, mean, spread, constants={"one": np.ones((1, 1, 2, 2), np.float32)})
    spec = OnnxSpec(size=16, fit="pad", mean=(-0.25, -0.25, -0.25))
    found = OnnxDetector(path, spec)(np.ones((8, 16, 3), np.float32), VIEW)
    np.testing.assert_allclose(found, 0.75, atol=1e-6)
    assert found.shape == (1, 2)


@pytest.mark.parametrize(("stride", "shape"), [(2, (4, 8)), (4, (2, 4)), (16, (8, 16))])
def test_coarse_maps_are_cropped_in_proportion(tmp_path, stride, shape):
    """Where the image ends inside a cell the map is upsampled to the input first."""
    sides = [stride, stride]
    pool = helper.make_node("AveragePool", ["one"], ["map"], kernel_shape=sides, strides=sides)
    path = network(tmp_path, *first_channel(output="one"), pool, constants={"zero": np.array([0])})
    image = np.full((8, 16, 3), 0.25, np.float32)
    found = OnnxDetector(path, OnnxSpec(size=16, fit="pad"))(image, VIEW)
    assert found.shape == shape
    np.testing.assert_allclose(found, 0.25 if stride < 16 else 0.125, atol=1e-6)


def test_the_model_decides_the_size_where_the_spec_is_silent(tmp_path):
    path = network(tmp_path, takes=(1, 3, 10, 12))
    assert OnnxDetector(path)(IMAGE, VIEW).shape == (10, 12)
    assert OnnxDetector(path, OnnxSpec(fit="pad"))(IMAGE, VIEW).shape == (6, 8)
    assert OnnxDetector(path, OnnxSpec(size=(10, 12)))(IMAGE, VIEW).shape == (10, 12)
    unfit = OnnxDetector(path, OnnxSpec(fit="none"))
    assert unfit(np.zeros((10, 12, 3), np.float32), VIEW).shape == (10, 12)
    with pytest.raises(InputError, match=r"'image' takes images of \[10, 12\], found \[6, 8\]"):
        unfit(IMAGE, VIEW)


@pytest.mark.parametrize("output", [1, "map"])
def test_the_output_is_chosen_by_position_or_name(tmp_path, output):
    path = network(
        tmp_path,
        identity("edges"),
        *first_channel(),
        constants={"zero": np.array([0])},
        outputs=("edges", "map"),
    )
    found = OnnxDetector(path, OnnxSpec(output=output))(IMAGE, VIEW)
    np.testing.assert_allclose(found, IMAGE[..., 0], atol=1e-6)


@pytest.mark.parametrize("axes", [[0], [0, 1]])
def test_maps_without_batch_or_channel(tmp_path, axes):
    squeeze = helper.make_node("Squeeze", ["one", "axes"], ["map"])
    path = network(
        tmp_path,
        *first_channel(output="one"),
        squeeze,
        constants={"zero": np.array([0]), "axes": np.array(axes)},
    )
    np.testing.assert_allclose(OnnxDetector(path)(IMAGE, VIEW), IMAGE[..., 0], atol=1e-6)


@pytest.mark.parametrize("threshold", [0.5, 0.2, 0.8])
def test_outputs_that_are_not_finite_are_undecided_and_counted(tmp_path, threshold):
    log = helper.make_node("Log", ["one"], ["map"])
    nodes = (*first_channel(output="one"), log)
    path = network(tmp_path, *nodes, constants={"zero": np.array([0])})
    image = np.full((6, 8, 3), np.e, np.float32)
    image[0, :3] = -1.0
    detector = OnnxDetector(path, OnnxSpec(threshold=threshold))
    found = detector(image, VIEW)
    np.testing.assert_allclose(found[0, :3], 0.5, atol=1e-6)
    assert not (found[0, :3] > 0.5).any()
    np.testing.assert_allclose(found[1:], 1, atol=1e-5)
    detector(np.full((6, 8, 3), np.e, np.float32), camera("other"))
    (warning,) = detector.warnings
    assert "3 outputs in 1 of 2 views" in warning
    assert "'view'" in warning


def test_infinite_logits_are_decided(tmp_path):
    detector = OnnxDetector(network(tmp_path), OnnxSpec(activation="sigmoid"))
    image = np.full((2, 2, 3), np.inf, np.float32)
    image[0] = -np.inf
    np.testing.assert_array_equal(detector(image, VIEW), [[0, 0], [1, 1]])
    assert detector.warnings == ()


def test_a_sigmoid_too_many_is_noticed(tmp_path):
    detector = OnnxDetector(network(tmp_path), OnnxSpec(activation="sigmoid"))
    detector(IMAGE, VIEW)
    assert "probabilities already" in detector.warnings[0]
    detector(IMAGE * 8 - 4, camera("other"))
    assert detector.warnings == ()


def test_a_missing_sigmoid_is_refused(tmp_path):
    detector = OnnxDetector(network(tmp_path))
    with pytest.raises(InputError, match="set activation to sigmoid") as caught:
        detector(IMAGE * 8 - 4, VIEW)
    assert "'map'" in one_line(caught)


@pytest.mark.parametrize(
    ("build", "spec", "reason"),
    [
        (
            {"takes": (1, 1, "H", "W")},
            OnnxSpec(),
            r"'image' is tensor\(float\) of shape \[1, 1, H, W\].*\[1, 3, H, W",
        ),
        ({"takes": (4, 3, "H", "W")}, OnnxSpec(), r"\[4, 3, H, W\]"),
        ({"takes": (1, 3, "N")}, OnnxSpec(), r"\[1, 3, N\]"),
        ({"takes": (1, "H", "W", 3)}, OnnxSpec(size=8), r"\[1, H, W, 3\].*\[1, 3, 8, 8\]"),
        ({}, OnnxSpec(layout="NHWC"), r"expects \[1, H, W, 3\]"),
        ({"takes": (1, 3, 10, 12)}, OnnxSpec(size=10), r"\[1, 3, 10, 12\].*\[1, 3, 10, 10\]"),
        (
            {"dtype": TensorProto.INT64},
            OnnxSpec(),
            r"'image' is tensor\(int64\) of shape \[1, 3, H, W\], expected tensor\(float\)",
        ),
        ({"more_inputs": ("mask",)}, OnnxSpec(), r"2 inputs \(image, mask\)"),
        ({}, OnnxSpec(input="x"), "no input 'x', the model has 'image'"),
        ({}, OnnxSpec(output=1), "no output 1, the model has map"),
        ({}, OnnxSpec(output="edges"), "no output 'edges'"),
        ({"gives": (1, 1, "H", "W")}, OnnxSpec(channel=1), r"'map'.*none of position 1"),
        ({"gives": (1, 1, "H", "W")}, OnnxSpec(activation="softmax"), "softmax needs two"),
    ],
)
def test_a_model_that_does_not_fit_is_refused_when_loaded(tmp_path, build, spec, reason):
    with pytest.raises(InputError, match=reason) as caught:
        OnnxDetector(network(tmp_path, **build), spec)
    assert "net.onnx" in one_line(caught)


@pytest.mark.parametrize(
    ("node", "spec", "reason"),
    [
        (identity(), OnnxSpec(), r"'map' has shape \[1, 3, .*it has 3 channels"),
        (identity(), OnnxSpec(channel=3), "none of position 3"),
        (helper.make_node("Reshape", ["image", "row"], ["map"]), OnnxSpec(), r"\[1, 144\], no map"),
        (helper.make_node("Reshape", ["image", "five"], ["map"]), OnnxSpec(), "expected one map"),
        (helper.make_node("Reshape", ["image", "batch"], ["map"]), OnnxSpec(), "expected one map"),
        (
            helper.make_node("Reshape", ["image", "bad"], ["map"]),
            OnnxSpec(),
            "fails on view 'view'",
        ),
    ],
)
def test_an_output_that_is_no_map_is_refused_when_run(tmp_path, capfd, node, spec, reason):
    shapes = {"row": [1, -1], "five": [1, 3, 6, 4, 2], "batch": [3, 1, 6, 8], "bad": [7, -1]}
    path = network(
        tmp_path, node, constants={name: np.array(shape) for name, shape in shapes.items()}
    )
    with pytest.raises(InputError, match=reason) as caught:
        OnnxDetector(path, spec)(IMAGE, VIEW)
    assert "net.onnx" in one_line(caught)
    assert capfd.readouterr() == ("", ""), "the runtime prints what the error says"


def test_files_that_are_no_model_are_refused(tmp_path):
    (tmp_path / "empty.onnx").write_bytes(b"")
    (tmp_path / "text.onnx").write_text("no network")
    for name, reason in {
        "missing.onnx": "does not exist",
        ".": "is a folder",
        "empty.onnx": "cannot load",
        "text.onnx": "cannot load",
    }.items():
        with pytest.raises(InputError, match=reason) as caught:
            OnnxDetector(tmp_path / name)
        assert str(tmp_path / name) in one_line(caught)
    with pytest.raises(InputError, match="no provider 'Abacus'"):
        OnnxDetector(network(tmp_path), providers=("Abacus",))
    with pytest.raises(InputError, match="no detector preset 'trufoor', expected one of iml-vit"):
        OnnxDetector(network(tmp_path), "trufoor")
    with pytest.raises(InputError, match="no cameras"):
        OnnxDetector(network(tmp_path)).select([])
    with pytest.raises(ValueError, match="needs the rendered image"):
        OnnxDetector(network(tmp_path))(None, VIEW)


# Presets


@pytest.mark.parametrize(
    ("name", "fed", "channels"),
    [("iml-vit", 1024, 1), ("trufor", None, 2), ("mvss-net", 512, 1), ("pscc-net", None, 1)],
)
def test_presets_run(tmp_path, name, fed, channels):
    """Each on a stand-in of the network's shapes that says its first channel's sign."""
    constants = {"pick": np.arange(channels), "flat": np.zeros((1, channels, 1, 1), np.float32)}
    logits = helper.make_node("Gather", ["image", "pick"], ["logits"], axis=1)
    said = "Sigmoid" if PRESETS[name].activation == "none" else "Identity"
    last = helper.make_node(said, ["logits"], ["map"])
    takes = FREE if fed is None else (1, 3, fed, fed)
    outputs = ("map",) if PRESETS[name].output == 0 else ("edges", "map")
    nodes = (logits, last, identity("edges")) if len(outputs) > 1 else (logits, last)
    path = network(tmp_path, *nodes, takes=takes, constants=constants, outputs=outputs)
    image = np.zeros((6, 8, 3), np.float32)
    image[:, 4:] = 1.0
    found = OnnxDetector(path, name)(image, VIEW)
    assert found.shape == ((512, 512) if name == "mvss-net" else (6, 8))
    if name != "trufor":  # whose two channels are alike here
        assert found[0, 0] < found[0, -1]


def test_presets_can_be_adjusted():
    spec = dataclasses.replace(PRESETS["mvss-net"], output=0)
    assert (spec.size, spec.output, spec.channels) == ((512, 512), 0, "bgr")
