"""Mask files: what is written reads back with the same decisions; a layout means one thing."""

from pathlib import Path

import hypothesis.extra.numpy as hnp
import imageio.v3 as iio
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from gsc_jax.io import masks
from gsc_jax.scene import InputError

MASK = np.zeros((6, 9), bool)
MASK[1:4, 5:] = True
LEVELS = np.arange(54, dtype=np.uint8).reshape(6, 9) * 4

same_folder = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@same_folder
@given(hnp.arrays(np.float32, (3, 4), elements=st.floats(0, 1, width=32)))
def test_probabilities_survive_a_file(tmp_path, probability):
    masks.write_probability(tmp_path / "p.png", probability)
    found = masks.read_probability(tmp_path / "p.png")
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, probability, atol=1.5 / 255)
    np.testing.assert_array_equal(found > 0.5, probability > 0.5)


@pytest.mark.parametrize("value", [0.5, np.nextafter(np.float32(0.5), np.float32(1)), 1 / 255])
def test_the_decision_survives_where_rounding_could_turn_it(tmp_path, value):
    masks.write_probability(tmp_path / "p.png", np.full((2, 2), value, np.float32))
    found = masks.read_probability(tmp_path / "p.png")
    np.testing.assert_array_equal(found > 0.5, value > 0.5)


@same_folder
@given(hnp.arrays(bool, (3, 4)))
def test_masks_survive_a_file(tmp_path, mask):
    masks.write_mask(tmp_path / "m.png", mask)
    assert set(np.unique(iio.imread(tmp_path / "m.png"))) <= {0, 255}
    np.testing.assert_array_equal(masks.read_probability(tmp_path / "m.png"), mask)


def test_images_are_clipped_not_wrapped(tmp_path):
    rgb = np.zeros((2, 3, 3), np.float32)
    rgb[0, 0] = (1.7, -0.3, 0.5)
    masks.write_image(tmp_path / "i.png", rgb)
    found = iio.imread(tmp_path / "i.png")
    assert found.shape == (2, 3, 3)
    np.testing.assert_allclose(found[0, 0], (255, 0, 127.5), atol=0.5)


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(TypeError, match="handle"):
        masks.write_image(tmp_path / "i.png", np.zeros((2, 3, 4, 5)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "bad",
    [np.full((2, 2), np.nan), np.full((2, 2), 1.5), np.full((2, 2), -0.1), np.zeros((2, 2, 1))],
)
def test_no_probabilities_are_refused(tmp_path, bad):
    with pytest.raises(InputError, match=r"expected finite values in \[0, 1\]"):
        masks.write_probability(tmp_path / "p.png", bad)


def palette(colours: list[int]) -> Image.Image:
    image = Image.frombytes("P", (9, 6), MASK.astype(np.uint8).tobytes())
    image.putpalette(colours)
    return image


def grey(mode: str) -> Image.Image:
    return Image.fromarray(MASK * np.uint8(255)).convert(mode)


def see_through() -> Image.Image:
    """White wherever, and visible in the mask only."""
    return Image.merge("LA", (Image.new("L", (9, 6), 255), grey("L")))


@pytest.mark.parametrize(
    ("name", "image"),
    [
        ("one-bit.png", grey("1")),
        ("one-bit.tif", grey("1")),
        ("eight-bit.png", grey("L")),
        ("zero-one.png", Image.fromarray(MASK.astype(np.uint8))),
        ("sixteen-bit.png", Image.fromarray(MASK * np.uint16(65535))),
        ("float.tif", Image.fromarray(MASK.astype(np.float32))),
        ("rgb.png", grey("RGB")),
        ("rgba.png", grey("RGBA")),
        ("grey-alpha.png", grey("LA")),
        ("see-through.png", see_through()),
        ("palette-grey.png", palette([0, 0, 0, 255, 255, 255])),
        ("palette-red.png", palette([0, 0, 0, 128, 0, 0])),
        ("palette-zero-one.png", palette([0, 0, 0, 1, 1, 1])),
        (
            "red.png",
            Image.merge("RGB", (grey("L"), Image.new("L", (9, 6)), Image.new("L", (9, 6)))),
        ),
        ("mask.bmp", grey("L")),
        ("MASK.PNG", grey("L")),
    ],
)
def test_every_layout_of_a_mask_reads_the_same(tmp_path, name, image):
    image.save(tmp_path / name)
    found = masks.read_probability(tmp_path / name)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, MASK)


@pytest.mark.parametrize("suffix", ["jpg", "webp"])
def test_lossy_masks_keep_their_decision(tmp_path, suffix):
    mask = np.kron(MASK, np.ones((16, 16), bool))
    Image.fromarray(mask * np.uint8(255)).convert("RGB").save(tmp_path / f"m.{suffix}")
    np.testing.assert_array_equal(masks.read_probability(tmp_path / f"m.{suffix}") > 0.5, mask)


def test_a_trace_of_colour_is_no_colour(tmp_path):
    levels = np.stack([LEVELS, LEVELS + 4, LEVELS + 8], axis=-1)
    iio.imwrite(tmp_path / "p.png", levels)
    found = masks.read_probability(tmp_path / "p.png")
    np.testing.assert_allclose(found, (LEVELS + 4) / 255, rtol=1e-6)


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_levels_are_shares_of_the_largest(tmp_path, mode):
    Image.fromarray(LEVELS).convert(mode).save(tmp_path / "p.png")
    np.testing.assert_allclose(masks.read_probability(tmp_path / "p.png"), LEVELS / 255, rtol=1e-6)


def test_sixteen_bits_are_kept(tmp_path):
    levels = np.array([[0, 1, 32767], [32768, 65534, 65535]], np.uint16)
    iio.imwrite(tmp_path / "p.png", levels)
    found = masks.read_probability(tmp_path / "p.png")
    np.testing.assert_allclose(found, levels / 65535, rtol=1e-6)
    np.testing.assert_array_equal(found > 0.5, levels > 32767)


def test_black_is_zero_and_the_rule_of_zero_one_can_be_overruled(tmp_path):
    iio.imwrite(tmp_path / "black.png", np.zeros((4, 4), np.uint8))
    iio.imwrite(tmp_path / "one.png", MASK.astype(np.uint8))
    for choice in (None, True, False):
        assert not masks.read_probability(tmp_path / "black.png", zero_one=choice).any()
    dark = masks.read_probability(tmp_path / "one.png", zero_one=False)
    np.testing.assert_allclose(dark, MASK / 255, rtol=1e-6)


def test_files_that_are_no_mask_say_so_in_one_line(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    iio.imwrite(tmp_path / "photo.png", noise)
    whole = (tmp_path / "photo.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[:100])
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "folder.png").mkdir()
    black, white = Image.new("L", (9, 6)), Image.new("L", (9, 6), 255)
    for name in ("pages.tif", "frames.png"):
        black.save(tmp_path / name, save_all=True, append_images=[white])
    Image.fromarray(np.full((2, 2), 7.0, np.float32)).save(tmp_path / "seven.tif")
    Image.fromarray(np.full((2, 2), np.nan, np.float32)).save(tmp_path / "nan.tif")
    Image.fromarray(np.full((2, 2), 7, np.int32)).save(tmp_path / "int.tif")
    expected = {
        "photo.png": "colour picture",
        "cut.png": "cannot be read",
        "empty.png": "empty",
        "text.png": "cannot be read",
        "folder.png": "is a folder",
        "missing.png": "does not exist",
        "pages.tif": "2 pages",
        "frames.png": "2 pages",
        "seven.tif": r"in \[0, 1\]",
        "nan.tif": r"in \[0, 1\]",
        "int.tif": "int32",
    }
    for name, reason in expected.items():
        with pytest.raises(InputError, match=reason) as caught:
            masks.read_probability(tmp_path / name)
        message = str(caught.value)
        assert name in message
        assert "\n" not in message


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("a", "a.png"),
        ("img.0001.JPG", "img.0001.JPG.png"),
        ("left/a.b", "left/a.b.png"),
        ("left\\a", "left/a.png"),
        ("a.png", "a.png.png"),
    ],
)
def test_names_keep_their_dots_and_folders(tmp_path, name, file):
    path = masks.image_path(tmp_path, name)
    assert path == tmp_path / file
    masks.write_mask(path, MASK)
    assert [found for found in tmp_path.rglob("*") if found.is_file()] == [tmp_path / file]


@pytest.mark.parametrize("name", ["", ".", "..", "../a", "/etc/a", "a/../../b", "C:\\a", "..\\a"])
def test_names_cannot_leave_the_folder(name):
    with pytest.raises(InputError, match="cannot name a file"):
        masks.image_path(Path("out"), name)
