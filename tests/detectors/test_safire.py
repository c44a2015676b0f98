"""SAFIRE: masks of prompted points become one map, and two networks are held to their tensors."""

import dataclasses
import re
import tomllib
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from gsc_jax.detectors import safire, sources
from gsc_jax.detectors.safire import SafireDetector
from gsc_jax.detectors.specs import PRESETS, OnnxSpec
from gsc_jax.evidence.detector import Detector, as_detector, fit_to_view
from gsc_jax.scene import Camera, InputError

FLOAT = TensorProto.FLOAT
SIDE, CELLS = 32, 8
ODD = (slice(8, 16), slice(20, 28))
"""The odd-coloured square of `IMAGE`: a sixteenth of it."""

IMAGE = np.full((SIDE, SIDE, 3), 0.5, np.float32)
IMAGE[ODD] = (0.9, 0.1, 0.1)


def camera(name: str = "view") -> Camera:
    eye = np.eye(4, dtype=np.float32)
    return Camera(viewmat=eye, K=eye[:3, :3], width=SIDE, height=SIDE, name=name)


# Stand-ins: the embedding of a cell is its mean colour; the mask of a point is what looks alike.


def save(path: Path, nodes: list, inputs: dict, outputs: dict, constants: dict) -> Path:
    """An ONNX file; inputs and outputs as (type, shape) by name."""
    graph = helper.make_graph(
        nodes,
        "stand-in",
        [helper.make_tensor_value_info(name, *facts) for name, facts in inputs.items()],
        [helper.make_tensor_value_info(name, *facts) for name, facts in outputs.items()],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    opset = [helper.make_opsetid("", 17)]
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)
    return path


def encoder(path: Path, *, takes: tuple = (1, 3, SIDE, SIDE), kind: int = FLOAT) -> Path:
    pool = helper.make_node(
        "AveragePool", ["pixels"], ["colours"], kernel_shape=[4, 4], strides=[4, 4]
    )
    inputs, outputs = {"pixels": (kind, takes)}, {"colours": (kind, None)}
    return save(path / "encoder.onnx", [pool], inputs, outputs, {})


def decoder(
    path: Path,
    *,
    prompts: int | str = "P",
    label_kind: int = FLOAT,
    confidence: float = 0.9,
    steepness: float = 40.0,
    shift: float = 0.0,
    masks: tuple = (-1, 1, CELLS, CELLS),
    scale: float = 2.0,
) -> Path:
    """A mask where the colours look like those of the prompted point, by their cosine.

    Its logit is `steepness * (cosine - 0.9) + shift`; the confidence is the given one, and a little
    more for larger masks.
    """

    def node(kind, inputs, output, **attributes):
        return helper.make_node(kind, inputs.split(" "), [output], **attributes)

    nodes = [
        node("Cast", "point_labels", "foreground", to=FLOAT),
        node("Mul", "point_coords to_unit", "unit"),
        node("Sub", "unit one", "centred"),
        node("Unsqueeze", "centred first", "places"),
        node("GridSample", "embeddings places", "picked", mode="nearest", align_corners=0),
        node("Reshape", "picked by_point", "columns"),
        node("Transpose", "columns", "asked", perm=[1, 0]),
        node("LpNormalization", "asked", "question", axis=1, p=2),
        node("Reshape", "embeddings by_cell", "cells"),
        node("LpNormalization", "cells", "answers", axis=0, p=2),
        node("MatMul", "question answers", "cosine"),
        node("Sub", "cosine border", "above"),
        node("Mul", "above steepness", "steep"),
        node("Mul", "steep foreground", "shown"),
        node("Add", "shown shift", "logits"),
        node("Reshape", "logits as_masks", "coarse"),
        node("Resize", "coarse  scales", "masks", mode="nearest"),
        node("ReduceMean", "cosine", "likeness", axes=[1], keepdims=1),
        node("Mul", "likeness slight", "more"),
        node("Add", "more confidence", "confidences"),
    ]
    constants = {
        "to_unit": np.float32(2 / SIDE),
        "one": np.float32(1),
        "first": np.array([0]),
        "by_point": np.array([3, -1]),
        "by_cell": np.array([3, -1]),
        "border": np.float32(0.9),
        "steepness": np.float32(steepness),
        "shift": np.float32(shift),
        "as_masks": np.array(masks),
        "scales": np.array([1, 1, scale, scale], np.float32),
        "slight": np.float32(0.01),
        "confidence": np.float32(confidence),
    }
    inputs = {
        "embeddings": (FLOAT, (1, "C", "H", "W")),
        "point_coords": (FLOAT, (prompts, 1, 2)),
        "point_labels": (label_kind, (prompts, 1)),
    }
    outputs = {"masks": (FLOAT, None), "confidences": (FLOAT, None)}
    return save(path / "decoder.onnx", nodes, inputs, outputs, constants)


def detector(path: Path, *, grid: int = 8, seed: int = 0, **options) -> SafireDetector:
    """Of stand-ins in a folder."""
    encoder(path)
    decoder(path, **options)
    return SafireDetector(path, grid=grid, seed=seed, threads=1)


def one_line(caught) -> str:
    message = str(caught.value)
    assert "\n" not in message
    return message


# The detector


def test_it_flags_the_odd_square(tmp_path):
    network = detector(tmp_path)
    found = network(IMAGE, camera())
    assert (found.shape, found.dtype) == ((SIDE, SIDE), np.float32)
    assert found.min() >= 0
    assert found.max() <= 1
    expected = np.zeros((SIDE, SIDE), bool)
    expected[ODD] = True
    wrong = (found > 0.5) != expected
    assert wrong.sum() <= 12, "more than the corners of the square, which interpolation rounds"
    assert found[12, 24] > 0.95
    assert found[28, 4] < 0.05
    assert network.warnings == ()
    assert network.notes == {"view": {"unusable": 0, "one_source": 0, "unsure": 0}}
    assert network.needs_image is True
    views = [camera("a"), camera("b")]
    assert network.select(views) == views


def test_the_smaller_region_is_the_forged_one_whatever_its_colour(tmp_path):
    network = detector(tmp_path)
    swapped = np.where(IMAGE[0, 0] == IMAGE, IMAGE[12, 24], IMAGE[0, 0])
    np.testing.assert_array_equal(
        network(swapped, camera()) > 0.5, network(IMAGE, camera("swapped")) > 0.5
    )


def test_the_image_is_stretched_to_the_square(tmp_path):
    network = detector(tmp_path)
    stretched = np.repeat(IMAGE, 2, axis=1)
    np.testing.assert_allclose(network(stretched, camera()), network(IMAGE, camera("b")), atol=0.05)


@pytest.mark.parametrize("seed", [1, 2, 99])
def test_the_seed_does_not_matter_where_groups_are_clear(tmp_path, seed):
    found = detector(tmp_path / "a", seed=seed)(IMAGE, camera())
    np.testing.assert_array_equal(found, detector(tmp_path / "b")(IMAGE, camera()))


@pytest.mark.parametrize("prompts", [1, 5, 16, 64, 100])
def test_a_fixed_number_of_prompts_changes_nothing(tmp_path, prompts):
    fixed = detector(tmp_path / "fixed", prompts=prompts)
    free = detector(tmp_path / "free")
    np.testing.assert_allclose(fixed(IMAGE, camera()), free(IMAGE, camera()), atol=1e-6)


@pytest.mark.parametrize("kind", [TensorProto.INT32, TensorProto.INT64, TensorProto.FLOAT])
def test_labels_are_of_the_type_that_the_decoder_takes(tmp_path, kind):
    found = detector(tmp_path, label_kind=kind)(IMAGE, camera())
    assert found[12, 24] > 0.5


def test_half_precision_encoders(tmp_path):
    encoder(tmp_path, kind=TensorProto.FLOAT16)
    decoder(tmp_path)
    found = SafireDetector(tmp_path, grid=8, threads=1)(IMAGE, camera())
    assert found[12, 24] > 0.5 > found[28, 4]


def test_two_files_do_as_well_as_a_folder(tmp_path):
    (tmp_path / "b").mkdir()
    first, second = encoder(tmp_path), decoder(tmp_path / "b")
    network = SafireDetector(first, second, grid=8, threads=1)
    assert (network.encoder, network.decoder) == (first, second)
    assert network(IMAGE, camera())[12, 24] > 0.5


def test_an_open_size_is_that_of_sam(tmp_path):
    encoder(tmp_path, takes=("N", 3, "H", "W"))
    decoder(tmp_path, masks=(-1, 1, 256, 256), scale=1.0)
    network = SafireDetector(tmp_path, grid=2, threads=1)
    assert network(IMAGE, camera()).shape == (1024, 1024)


def test_the_network_sees_the_statistics_of_sam(tmp_path):
    """A mean over the image is what the embeddings of one cell say."""
    encoder(tmp_path)
    decoder(tmp_path)
    network = SafireDetector(tmp_path, threads=1)
    seen = network._encoder.run(safire.to_tensor(IMAGE, safire.SAM), view="view")[0]
    expected = (127.5 - np.array([123.675, 116.28, 103.53])) / [58.395, 57.12, 57.375]
    np.testing.assert_allclose(seen[0, :, -1, 0], expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("options", "image", "note", "words"),
    [
        ({}, np.full_like(IMAGE, 0.5), "one_source", "of one source"),
        ({}, np.zeros_like(IMAGE), "one_source", "of one source"),
        ({"steepness": 0.0, "shift": -1.0}, IMAGE, "one_source", "64 of 64 masks are empty"),
        ({"steepness": np.nan}, IMAGE, "one_source", "64 of 64 masks are empty or not finite"),
        ({"confidence": np.nan}, IMAGE, "one_source", "64 of 64 masks"),
        ({}, np.full_like(IMAGE, np.nan), "one_source", "64 of 64 masks"),
        ({"confidence": 0.3}, IMAGE, "unsure", "a confidence is not above 0.5"),
    ],
)
def test_nothing_is_flagged_and_it_is_said_why(tmp_path, options, image, note, words):
    network = detector(tmp_path, **options)
    np.testing.assert_array_equal(network(image, camera("bad")), np.zeros((SIDE, SIDE)))
    assert network.notes["bad"][note] == 1
    warnings = " ".join(network.warnings)
    assert words in warnings
    assert "nothing flagged in 1 of 1 views" in warnings
    assert "'bad'" in warnings
    assert str(tmp_path) in warnings


def test_warnings_count_views(tmp_path):
    network = detector(tmp_path)
    for name, image in (("a", IMAGE), ("b", IMAGE * 0), ("c", IMAGE * 0), ("c", IMAGE * 0)):
        network(image, camera(name))
    (warning,) = network.warnings
    assert "in 2 of 3 views" in warning
    assert "'b'" in warning


def test_the_fingerprint_is_of_both_networks_and_the_options(tmp_path):
    prints = [
        detector(tmp_path / "a").fingerprint,
        detector(tmp_path / "b", seed=1).fingerprint,
        detector(tmp_path / "c", grid=4).fingerprint,
        detector(tmp_path / "d", confidence=0.8).fingerprint,
    ]
    assert len(set(prints)) == len(prints)
    assert detector(tmp_path / "e").fingerprint == prints[0]


def test_it_is_a_detector_whose_map_fits_any_view(tmp_path):
    network: Detector = detector(tmp_path)
    assert as_detector(network) is network
    view = dataclasses.replace(camera(), width=20, height=12)
    found = fit_to_view(network(IMAGE, view), view)
    assert found.shape == (12, 20)
    assert found[4, 15] > 0.5 > found[10, 2]


# What does not fit

FITS = {
    "image": (FLOAT, (1, 3, SIDE, SIDE)),
    "embeddings": (FLOAT, (1, 3, 8, 8)),
    "point_coords": (FLOAT, ("P", 1, 2)),
    "point_labels": (FLOAT, ("P", 1)),
    "masks": (FLOAT, (4, 1, 8, 8)),
    "confidences": (FLOAT, (4, 1)),
}


def shell(path: Path, takes: dict, gives: dict) -> Path:
    """A network that has these inputs and outputs and does nothing."""
    nodes, constants = [], {}
    for name, (kind, shape) in gives.items():
        dtype = helper.tensor_dtype_to_np_dtype(kind)
        constants[f"some {name}"] = np.zeros(shape, dtype)
        nodes.append(helper.make_node("Identity", [f"some {name}"], [name]))
    return save(path, nodes, takes, gives, constants)


def shells(path: Path, facts: dict) -> SafireDetector:
    """Of two shells with these tensors, of which the decoder's may be said apart."""

    def chosen(names: str) -> dict:
        return {name: facts[name] for name in names.split() if name in facts}

    shell(path / "encoder.onnx", chosen("image"), chosen("embeddings more"))
    takes = chosen("embeddings point_coords point_labels mask_input")
    if "taken" in facts:
        takes["embeddings"] = facts["taken"]
    shell(path / "decoder.onnx", takes, chosen("masks confidences more"))
    return SafireDetector(path, grid=2, threads=1)


def test_the_shells_fit_and_more_outputs_are_ignored(tmp_path):
    points = {"point_coords": (FLOAT, (4, 1, 2)), "point_labels": (FLOAT, (4, 1))}
    network = shells(tmp_path, FITS | points | {"more": (FLOAT, (1,))})
    assert not network(IMAGE, camera()).any()


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"image": (FLOAT, (1, 1, 32, 32))}, r"'image' .*\[1, 1, 32, 32\], expected .*\[1, 3, \?"),
        ({"image": (FLOAT, (1, 32, 32, 3))}, r"'image' .*\[1, 32, 32, 3\], expected the image"),
        ({"image": (FLOAT, (1, 3, 32, 40))}, r"\[32, 40\], expected a square"),
        ({"image": (TensorProto.UINT8, (1, 3, 32, 32))}, r"'image' is tensor\(uint8\)"),
        ({"embeddings": (FLOAT, (2, 3, 8, 8))}, r"'embeddings' .*\[2, 3, 8, 8\], expected the emb"),
        (
            {"embeddings": (FLOAT, (1, 3, 8))},
            r"'embeddings' .*\[1, 3, 8\], expected the embeddings",
        ),
        ({"taken": (FLOAT, (1, 256, 8, 8))}, "export both from one network"),
        ({"mask_input": (FLOAT, (1,))}, r"takes \(embeddings, .*, mask_input\) .*expected to take"),
        ({"point_coords": (FLOAT, (1, "P", 3))}, r"'point_coords' .*\[1, P, 3\], expected"),
        ({"point_coords": (FLOAT, (4, 5, 2))}, r"'point_coords' .*expected .*\[\?, 1, 2\]"),
        ({"point_labels": (TensorProto.BOOL, ("P", 1))}, r"'point_labels' is tensor\(bool\)"),
        (
            {"point_coords": (FLOAT, (4, 1, 2)), "point_labels": (FLOAT, (5, 1))},
            "takes 4 points with 5 labels",
        ),
        ({"masks": (FLOAT, (4, 3, 8, 8))}, r"'masks' .*\[4, 3, 8, 8\], expected the masks"),
        ({"confidences": (FLOAT, (4,))}, r"'confidences' .*expected .*\[\?, 1\]"),
        ({"confidences": (TensorProto.INT64, (4, 1))}, r"'confidences' is tensor\(int64\)"),
    ],
)
def test_networks_that_do_not_fit_are_refused_when_loaded(tmp_path, changed, reason):
    with pytest.raises(InputError, match=reason) as caught:
        shells(tmp_path, FITS | changed)
    assert "coder.onnx: " in one_line(caught)
    assert "export" in one_line(caught)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"masks": (1, -1, CELLS, CELLS)}, r"'masks' .*\[1, 4, 16, 16\], expected the masks"),
        ({"masks": (-1, 1, CELLS, 2 * CELLS)}, "expected one of each per point"),
        ({"scale": 1.5}, "expected sides that are multiples"),
        ({"masks": (7, 1, -1, 3)}, "the model fails on view 'view'"),
    ],
)
def test_outputs_that_do_not_fit_are_refused_when_run(tmp_path, capfd, options, reason):
    network = detector(tmp_path, **options)
    with pytest.raises(InputError, match=reason) as caught:
        network(IMAGE, camera())
    assert "decoder.onnx" in one_line(caught)
    assert capfd.readouterr() == ("", ""), "the runtime prints what the error says"


def test_networks_with_their_places_exchanged_are_refused(tmp_path):
    with pytest.raises(InputError, match="expected to take"):
        SafireDetector(decoder(tmp_path), encoder(tmp_path))


def test_files_that_are_missing_are_named(tmp_path):
    with pytest.raises(InputError, match="does not exist, expected a folder with encoder"):
        SafireDetector(tmp_path / "none")
    with pytest.raises(InputError, match=r"holds no encoder\.onnx and no decoder\.onnx"):
        SafireDetector(tmp_path)
    path = encoder(tmp_path)
    with pytest.raises(InputError, match=r"holds no decoder\.onnx, expected"):
        SafireDetector(tmp_path)
    with pytest.raises(InputError, match="is a file, expected a folder"):
        SafireDetector(path)
    with pytest.raises(InputError, match=r"other\.onnx: does not exist"):
        SafireDetector(path, tmp_path / "other.onnx")
    decoder(tmp_path)
    for grid in (1, 0, -1, 1.5):
        with pytest.raises(InputError, match="grid is"):
            SafireDetector(tmp_path, grid=grid)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no cameras"):
        SafireDetector(tmp_path).select([])
    with pytest.raises(ValueError, match="needs the rendered image"):
        SafireDetector(tmp_path)(None, camera())


# The reading of the masks


def test_prompts_are_the_centres_of_the_grid_with_x_first():
    np.testing.assert_array_equal(sources.point_grid(2, side=8), [[2, 2], [6, 2], [2, 6], [6, 6]])
    points = sources.point_grid(16, side=1024)
    assert points.shape == (256, 2)
    assert (points.min(), points.max()) == (32, 992)


def masks_of(*areas: int) -> np.ndarray:
    """Masks that are sure, each of an area, side by side from the left, shape (P, 1, 16)."""
    logits, start = np.full((len(areas), 1, 16), -9.0, np.float32), 0
    for mask, area in zip(logits, areas, strict=True):
        mask[0, start : start + area] = 9.0
        start += area
    return logits


SIXTEEN = np.where(np.arange(16) < 4, 1.0, -1.0).astype(np.float32)[None, None]
"""Embeddings of one channel: the first four cells point the other way."""


def test_the_map_is_the_mean_of_one_and_the_complement_of_the_other():
    logits = masks_of(4, 12)
    logits[1, 0, 15] = -9.0  # the larger mask leaves what the smaller one does not take
    found, note = sources.forged_region(logits, np.array([0.9, 0.9]), SIXTEEN, side=16)
    np.testing.assert_allclose(found[0, :3], 1, atol=1e-3)
    np.testing.assert_allclose(found[0, 6:13], 0, atol=1e-3)
    assert found[0, 15] == pytest.approx(0.5, abs=1e-3)
    assert note == {"unusable": 0, "one_source": 0, "unsure": 0}


def test_the_most_confident_mask_of_a_group_counts():
    logits = np.concatenate([masks_of(4, 12), masks_of(2, 12)[:1]])
    for trust, width in (((0.9, 0.9, 0.8), 4), ((0.8, 0.9, 0.9), 2)):
        found, _ = sources.forged_region(logits, np.array(trust), SIXTEEN, side=16)
        assert found[0, 0] > 0.9
        assert (found[0, 3] > 0.9) == (width == 4)


@pytest.mark.parametrize(
    ("trust", "flagged"),
    [((0.51, 0.51), True), ((0.5, 0.9), False), ((0.9, 0.5), False), ((0.9, np.inf), False)],
)
def test_both_masks_have_to_be_trusted(trust, flagged):
    found, note = sources.forged_region(masks_of(4, 12), np.array(trust), SIXTEEN, side=16)
    assert found.any() == flagged
    assert sum(note.values()) > 0 or flagged


def test_features_are_weighted_by_what_a_mask_covers():
    logits = np.full((1, 2, 4), -1.0)
    logits[0, 0, :3] = 1.0  # half of the first cell, a quarter of the second
    embeddings = np.eye(2)[:, None, :]
    (found,) = sources.mask_directions(logits, embeddings)
    np.testing.assert_allclose(found, np.array([2, 1]) / np.sqrt(5))


def test_masks_smaller_than_a_cell_have_a_feature():
    logits = np.full((1, 8, 8), -1.0)
    logits[0, 3, 3] = 1.0
    assert np.isfinite(sources.mask_directions(logits, np.ones((2, 2, 2)))).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_left_out(bad):
    logits = np.concatenate([masks_of(4, 12), masks_of(9)])
    trust = np.array([0.9, 0.9, bad])
    clean, _ = sources.forged_region(logits[:2], trust[:2], SIXTEEN, side=16)
    found, note = sources.forged_region(logits, trust, SIXTEEN, side=16)
    np.testing.assert_array_equal(found, clean)
    assert note["unusable"] == 1
    infinite = np.where(logits > 0, np.inf, -np.inf)[:2]
    found, _ = sources.forged_region(infinite, trust[:2], SIXTEEN, side=16)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found > 0.5, clean > 0.5)
    broken = np.where(np.arange(16) == 5, bad, SIXTEEN)
    found, note = sources.forged_region(logits[:2], trust[:2], broken, side=16)
    assert note["unusable"] == 2
    assert not found.any()


def spread(seed: int, sizes: tuple[int, int], noise: float) -> np.ndarray:
    """Directions around two axes."""
    rng = np.random.default_rng(seed)
    around = np.repeat(np.eye(2, 5), sizes, axis=0) + noise * rng.normal(size=(sum(sizes), 5))
    return around / np.linalg.norm(around, axis=1, keepdims=True)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(1, 60), (3, 250), (30, 30)]),
    st.floats(0, 0.15),
    st.integers(0, 9),
)
def test_two_groups_are_found_in_any_order_with_any_seed(seed, sizes, noise, other):
    directions = spread(seed, sizes, noise)
    truth = np.repeat([0, 1], sizes)
    order = np.random.default_rng(seed).permutation(len(truth))
    found = sources.two_groups(directions[order], seed=other)
    assert found is not None
    agreement = (found == truth[order]).mean()
    assert agreement in (0, 1)
    np.testing.assert_array_equal(found, sources.two_groups(directions[order], seed=other))


@given(st.integers(0, 99), st.sampled_from([4, 8]))
def test_no_other_pair_of_groups_has_longer_sums(seed, count):
    """The definition, over all the pairs of groups."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def length(groups: np.ndarray) -> float:
        return sum(float(np.linalg.norm(directions[groups == k].sum(axis=0))) for k in (0, 1))

    every = [(np.arange(count) * 0 + code >> np.arange(count)) & 1 for code in range(2**count)]
    found = sources.two_groups(directions, seed=seed)
    assert found is not None
    assert length(found) == pytest.approx(max(map(length, every)), rel=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2, 60])
def test_what_is_all_alike_is_one_group(count):
    alike = np.tile([[0.6, 0.8]], (count, 1))
    assert sources.two_groups(alike) is None
    jitter = 1e-7 * np.random.default_rng(0).normal(size=alike.shape)
    assert sources.two_groups(alike + jitter) is None


# The page on detectors

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "detectors.md").read_text(encoding="utf-8")


def test_the_page_has_every_field_of_a_spec_with_its_default():
    table = dict(re.findall(r"^\| `(\w+)` \| (none|`[^`]*`) \|", PAGE, flags=re.MULTILINE))
    given = {
        name: tomllib.loads(f"it = {default.strip('`')}")["it"]
        for name, default in table.items()
        if default != "none"
    }
    assert list(table) == [field.name for field in dataclasses.fields(OnnxSpec)]
    assert OnnxSpec.from_table(given) == OnnxSpec()


def test_the_specs_and_presets_of_the_page_are_there():
    specs = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    resized = dataclasses.replace(PRESETS["trufor"], fit="resize", size=(480, 640))
    assert resized in [OnnxSpec.from_table(tomllib.loads(spec)) for spec in specs]
    assert set(re.findall(r"--detector \S+ --preset ([\w-]+)", PAGE)) == set(PRESETS)


def test_the_recipes_are_python():
    recipes = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    assert len(recipes) >= 7
    for recipe in recipes:
        compile(recipe, "docs/detectors.md", "exec")
