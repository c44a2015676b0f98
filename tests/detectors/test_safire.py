"""SAFIRE on stand-ins of its two networks, and networks that do not fit."""

import numpy as np
import pytest
from onnx import TensorProto, helper
from onnx_models import FLOAT, save, view
from safire_models import CELLS, IMAGE, ODD, SIDE, decoder, detector, encoder

from gsc_jax.detectors.safire import SafireDetector
from gsc_jax.scene import InputError


def test_odd_square_is_flagged(tmp_path):
    network = detector(tmp_path)
    found = network(IMAGE, view())
    assert (found.shape, found.dtype) == ((SIDE, SIDE), np.float32)
    assert found.min() >= 0
    assert found.max() <= 1
    expected = np.zeros((SIDE, SIDE), bool)
    expected[ODD] = True
    wrong = (found > 0.5) != expected
    assert wrong.sum() <= 12, "more than the corners, which interpolation rounds"
    assert found[12, 24] > 0.95
    assert found[28, 4] < 0.05
    assert network.warnings == ()
    assert network.diagnostics == {"view": {"unusable": 0, "one_source": 0}}
    assert network.needs_image is True
    views = [view("a"), view("b")]
    assert network.select(views) == views


def test_smaller_region_is_flagged_whatever_its_colour(tmp_path):
    network = detector(tmp_path)
    swapped = np.where(IMAGE[0, 0] == IMAGE, IMAGE[12, 24], IMAGE[0, 0])
    np.testing.assert_array_equal(
        network(swapped, view()) > 0.5, network(IMAGE, view("swapped")) > 0.5
    )


def test_image_is_stretched_to_a_square(tmp_path):
    network = detector(tmp_path)
    stretched = np.repeat(IMAGE, 2, axis=1)
    np.testing.assert_allclose(network(stretched, view()), network(IMAGE, view("b")), atol=0.05)


@pytest.mark.parametrize("prompts", [1, 5, 16, 64, 100])
def test_batch_size_does_not_change_the_map(tmp_path, prompts):
    fixed = detector(tmp_path / "fixed", prompts=prompts)
    free = detector(tmp_path / "free")
    np.testing.assert_allclose(fixed(IMAGE, view()), free(IMAGE, view()), atol=1e-6)


@pytest.mark.parametrize("dtype", [TensorProto.INT32, TensorProto.INT64])
def test_label_types(tmp_path, dtype):
    assert detector(tmp_path, label_dtype=dtype)(IMAGE, view())[12, 24] > 0.5


def test_encoder_and_decoder_as_files(tmp_path):
    first, second = encoder(tmp_path), decoder(tmp_path / "b")
    network = SafireDetector(first, second, grid=8, threads=1)
    assert (network.encoder, network.decoder) == (first, second)
    assert network(IMAGE, view())[12, 24] > 0.5


def test_free_size_is_that_of_sam(tmp_path):
    encoder(tmp_path, shape=("N", 3, "H", "W"))
    decoder(tmp_path, mask_shape=(-1, 1, 256, 256), scale=1.0)
    assert SafireDetector(tmp_path, grid=2, threads=1)(IMAGE, view()).shape == (1024, 1024)


@pytest.mark.parametrize(
    ("options", "image", "anomaly", "words"),
    [
        ({}, np.full_like(IMAGE, 0.5), "one_source", "of one source"),
        ({"steepness": 0.0, "shift": -1.0}, IMAGE, "unusable", "64 masks are empty"),
        ({"steepness": np.nan}, IMAGE, "unusable", "64 masks are empty or not finite"),
        ({"confidence": np.nan}, IMAGE, "unusable", "64 masks"),
        ({}, np.full_like(IMAGE, np.nan), "unusable", "64 masks"),
    ],
)
def test_warnings_explain_views_without_two_regions(tmp_path, options, image, anomaly, words):
    network = detector(tmp_path, **options)
    found = network(image, view("bad"))
    assert found.any() == (anomaly == "one_source")
    assert network.diagnostics["bad"][anomaly] > 0
    warnings = " ".join(network.warnings)
    for part in (words, "in 1 of 1 views", "'bad'", str(tmp_path)):
        assert part in warnings


def test_fingerprint_depends_on_both_networks_and_the_options(tmp_path):
    prints = [
        detector(tmp_path / "a").fingerprint,
        detector(tmp_path / "b", seed=1).fingerprint,
        detector(tmp_path / "c", grid=4).fingerprint,
        detector(tmp_path / "d", confidence=0.8).fingerprint,
    ]
    assert len(set(prints)) == len(prints)
    assert detector(tmp_path / "e").fingerprint == prints[0]


# Networks that do not fit

TENSORS = {
    "image": (FLOAT, (1, 3, SIDE, SIDE)),
    "embeddings": (FLOAT, (1, 3, 8, 8)),
    "point_coords": (FLOAT, ("P", 1, 2)),
    "point_labels": (FLOAT, ("P", 1)),
    "masks": (FLOAT, (4, 1, 8, 8)),
    "confidences": (FLOAT, (4, 1)),
}


def constant_networks(folder, tensors: dict) -> SafireDetector:
    """Networks with these tensors and constant outputs; "taken" is the decoder's embeddings."""

    def write(name: str, takes: str, gives: str) -> None:
        inputs = {name: tensors[name] for name in takes.split() if name in tensors}
        outputs = {name: tensors[name] for name in gives.split() if name in tensors}
        if name == "decoder.onnx" and "taken" in tensors:
            inputs["embeddings"] = tensors["taken"]
        constants = {
            f"constant {output}": np.zeros(shape, helper.tensor_dtype_to_np_dtype(dtype))
            for output, (dtype, shape) in outputs.items()
        }
        nodes = [helper.make_node("Identity", [f"constant {name}"], [name]) for name in outputs]
        save(folder / name, nodes, inputs, outputs, constants)

    write("encoder.onnx", "image", "embeddings more")
    write(
        "decoder.onnx", "embeddings point_coords point_labels mask_input", "masks confidences more"
    )
    return SafireDetector(folder, grid=2, threads=1)


def test_further_outputs_are_ignored(tmp_path):
    points = {"point_coords": (FLOAT, (4, 1, 2)), "point_labels": (FLOAT, (4, 1))}
    network = constant_networks(tmp_path, TENSORS | points | {"more": (FLOAT, (1,))})
    assert not network(IMAGE, view()).any()


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"image": (FLOAT, (1, 1, 32, 32))}, r"'image' .*\[1, 1, 32, 32\], expected .*\[1, 3, S"),
        ({"image": (FLOAT, (1, 32, 32, 3))}, r"'image' .*\[1, 32, 32, 3\], expected the image"),
        ({"image": (FLOAT, (1, 3, 32, 40))}, r"\[1, 3, 32, 40\], expected .*\[1, 3, 32, 32\]"),
        ({"image": (TensorProto.UINT8, (1, 3, 32, 32))}, r"'image' is tensor\(uint8\)"),
        ({"embeddings": (FLOAT, (2, 3, 8, 8))}, r"'embeddings' .*\[2, 3, 8, 8\], expected the emb"),
        ({"embeddings": (FLOAT, (1, 3, 8))}, r"'embeddings' .*\[1, 3, 8\], expected the emb"),
        ({"taken": (FLOAT, (1, 256, 8, 8))}, "export both from one network"),
        ({"mask_input": (FLOAT, (1,))}, r"4 inputs \(embeddings, .*, mask_input\), expected 3"),
        ({"point_coords": (FLOAT, (1, "P", 3))}, r"'point_coords' .*\[1, P, 3\], expected"),
        ({"point_coords": (FLOAT, (4, 5, 2))}, r"'point_coords' .*expected .*\[4, 1, 2\]"),
        ({"point_labels": (TensorProto.BOOL, ("P", 1))}, r"'point_labels' is tensor\(bool\)"),
        (
            {"point_coords": (FLOAT, (4, 1, 2)), "point_labels": (FLOAT, (5, 1))},
            r"'point_labels' .*\[5, 1\], expected .*\[4, 1\]",
        ),
        ({"masks": (FLOAT, (4, 3, 8, 8))}, r"'masks' .*\[4, 3, 8, 8\], expected the masks"),
        ({"confidences": (FLOAT, (4,))}, r"'confidences' .*expected .*\[4, 1\]"),
        ({"confidences": (TensorProto.INT64, (4, 1))}, r"'confidences' is tensor\(int64\)"),
    ],
)
def test_unexpected_tensors_are_refused_when_loaded(tmp_path, changed, reason):
    with pytest.raises(InputError, match=reason) as caught:
        constant_networks(tmp_path, TENSORS | changed)
    assert "coder.onnx: " in str(caught.value)
    assert "export" in str(caught.value)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (
            {"mask_shape": (-1, 1, CELLS, 2 * CELLS)},
            r"'masks' .*\[2, 1, 16, 32\], expected the masks",
        ),
        ({"mask_shape": (7, 1, -1, 3)}, "the model fails on view 'view'"),
    ],
)
def test_unexpected_outputs_are_refused(tmp_path, capfd, options, reason):
    network = detector(tmp_path, **options)
    with pytest.raises(InputError, match=reason) as caught:
        network(IMAGE, view())
    assert "decoder.onnx" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", ""), "onnxruntime prints the error as well"


def test_missing_files_are_named(tmp_path):
    with pytest.raises(InputError, match="is not a folder, expected a folder with encoder"):
        SafireDetector(tmp_path / "none")
    path = encoder(tmp_path)
    with pytest.raises(InputError, match=r"holds no decoder\.onnx, expected"):
        SafireDetector(tmp_path)
    with pytest.raises(InputError, match="is not a folder"):
        SafireDetector(path)
    with pytest.raises(InputError, match=r"other\.onnx: no such file"):
        SafireDetector(path, tmp_path / "other.onnx")


def test_invalid_arguments_are_refused(tmp_path):
    for grid in (1, 0, -1, 1.5):
        with pytest.raises(InputError, match="grid is"):
            SafireDetector(tmp_path, grid=grid)  # type: ignore[arg-type]
