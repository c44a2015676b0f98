"""Masks keep their decisions in files, and every layout of a mask file has one meaning."""

import struct
import tracemalloc
from pathlib import Path
from zlib import compress, crc32

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image, TiffImagePlugin

from gsc_jax.io import masks
from gsc_jax.scene import InputError

MASK = np.zeros((6, 9), bool)
MASK[1:4, 5:] = True
LEVELS = np.arange(54, dtype=np.uint8).reshape(6, 9) * 4
HALF = np.full((3, 4), 0.5, np.float32)

same_folder = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@same_folder
@given(hnp.arrays(np.float32, (3, 4), elements=st.floats(0, 1, width=32)))
@example(HALF)
@example(np.nextafter(HALF, np.float32(1)))
@example(HALF / 32767.5)
def test_probabilities_and_decisions_survive_a_file(tmp_path, probability):
    masks.write_probability(tmp_path / "p.png", probability)
    found = masks.read_probability(tmp_path / "p.png")
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, probability, atol=1.5 / 65535)
    np.testing.assert_array_equal(found > 0.5, probability > 0.5)


@same_folder
@given(hnp.arrays(bool, (3, 4)))
def test_masks_survive_a_file(tmp_path, mask):
    masks.write_mask(tmp_path / "m.png", mask)
    assert set(np.unique(np.array(Image.open(tmp_path / "m.png")))) <= {0, 255}
    np.testing.assert_array_equal(masks.read_probability(tmp_path / "m.png"), mask)


@pytest.mark.parametrize(
    "invalid",
    [np.full((2, 2), np.nan), np.full((2, 2), 1.5), np.full((2, 2), -0.1), np.zeros((2, 2, 1))],
)
def test_values_that_are_not_probabilities_are_refused(tmp_path, invalid):
    with pytest.raises(InputError, match=r"expected finite values in \[0, 1\]"):
        masks.write_probability(tmp_path / "p.png", invalid)


def palette(*colours: int, transparency: int | None = None) -> Image.Image:
    image = Image.frombytes("P", (9, 6), MASK.astype(np.uint8).tobytes())
    image.putpalette(colours)
    if transparency is not None:
        image.info["transparency"] = transparency
    return image


def grey(mode: str) -> Image.Image:
    return Image.fromarray(MASK * np.uint8(255)).convert(mode)


BLACK, WHITE = Image.new("L", (9, 6)), Image.new("L", (9, 6), 255)


def with_transparent_colour(depth: int, kind: int, row: bytes, colour: bytes) -> bytes:
    """A .png of four pixels of this row and a transparent colour (chunk tRNS)."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", crc32(name + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 1, depth, kind, 0, 0, 0))
    pixels = chunk(b"IDAT", compress(b"\0" + row))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"tRNS", colour) + pixels + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("depth", "kind", "row", "colour", "expected"),
    [
        (1, 0, b"\x50", b"\0\0", [0, 1, 0, 1]),
        (1, 0, b"\x50", b"\0\1", [0, 0, 0, 0]),
        (2, 0, b"\x1b", b"\0\2", [0, 1 / 3, 0, 1]),
        (4, 0, b"\x0f\xf5", b"\0\x0f", [0, 0, 0, 1 / 3]),
        (8, 0, b"\x00\x33\xff\xcc", b"\0\xff", [0, 0.2, 0, 0.8]),
        (16, 0, b"\0\0\xff\xff\x33\x33\xff\xfe", b"\xff\xff", [0, 0, 0.2, 65534 / 65535]),
        (8, 2, b"\xff" * 6 + b"\0" * 3 + b"\x33" * 3, b"\0\xff" * 3, [0, 0, 0, 0.2]),
        (16, 2, b"\xff" * 12 + b"\0" * 6 + b"\x33" * 6, b"\xff" * 6, [0, 0, 0, 0.2]),
    ],
)
def test_the_transparent_colour_is_authentic(tmp_path, depth, kind, row, colour, expected):
    (tmp_path / "m.png").write_bytes(with_transparent_colour(depth, kind, row, colour))
    found = masks.read_probability(tmp_path / "m.png", zero_one=False)
    np.testing.assert_allclose(found, [expected], atol=1e-6)


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
        ("transparent.png", Image.merge("LA", (WHITE, grey("L")))),
        ("palette-grey.png", palette(0, 0, 0, 255, 255, 255)),
        ("palette-red.png", palette(0, 0, 0, 128, 0, 0)),
        ("palette-zero-one.png", palette(0, 0, 0, 1, 1, 1)),
        ("palette-transparent.png", palette(255, 255, 255, 255, 255, 255, transparency=0)),
        ("red.png", Image.merge("RGB", (grey("L"), BLACK, BLACK))),
        ("inks.tif", grey("RGB").convert("CMYK")),
        ("luminance.tif", grey("RGB").convert("YCbCr")),
        ("unused.tif", grey("RGB").convert("RGBX")),
        ("mask.bmp", grey("L")),
        ("MASK.PNG", grey("L")),
    ],
)
def test_every_layout_of_a_mask_reads_the_same(tmp_path, name, image):
    image.save(tmp_path / name)
    found = masks.read_probability(tmp_path / name)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, MASK)


def test_inverted_levels_of_16_bits_are_decoded(tmp_path):
    levels = Image.fromarray(~MASK * np.uint16(65535))
    levels.save(tmp_path / "m.tif", tiffinfo={TiffImagePlugin.PHOTOMETRIC_INTERPRETATION: 0})
    np.testing.assert_array_equal(masks.read_probability(tmp_path / "m.tif"), MASK)


@pytest.mark.parametrize("mode", ["RGB", "CMYK"])
@pytest.mark.parametrize("suffix", ["jpg", "webp"])
def test_lossy_masks_keep_their_decision(tmp_path, suffix, mode):
    mask = np.kron(MASK, np.ones((16, 16), bool))
    Image.fromarray(mask * np.uint8(255)).convert("RGB").convert(mode).save(
        tmp_path / f"m.{suffix}"
    )
    np.testing.assert_array_equal(masks.read_probability(tmp_path / f"m.{suffix}") > 0.5, mask)


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (LEVELS, LEVELS / 255),
        (np.stack([LEVELS] * 3, axis=-1), LEVELS / 255),
        (np.stack([LEVELS, LEVELS + 4, LEVELS + 8], axis=-1), (LEVELS + 4) / 255),
        (LEVELS * np.uint16(257) + np.uint16(1), (LEVELS * 257.0 + 1) / 65535),
    ],
    ids=["grey", "rgb", "almost-grey", "sixteen-bit"],
)
def test_levels_are_divided_by_the_largest(tmp_path, pixels, expected):
    Image.fromarray(pixels).save(tmp_path / "p.png")
    np.testing.assert_allclose(masks.read_probability(tmp_path / "p.png"), expected, rtol=1e-6)


def test_zero_one_overrides_the_default(tmp_path):
    BLACK.save(tmp_path / "black.png")
    Image.fromarray(MASK.astype(np.uint8)).save(tmp_path / "one.png")
    for choice in (None, True, False):
        assert not masks.read_probability(tmp_path / "black.png", zero_one=choice).any()
    dark = masks.read_probability(tmp_path / "one.png", zero_one=False)
    np.testing.assert_allclose(dark, MASK / 255, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_mask_that_viewers_turn_is_refused(tmp_path, suffix):
    turned = Image.Exif()
    turned[0x0112] = 3
    WHITE.copy().save(tmp_path / f"mask{suffix}", exif=turned)
    with pytest.raises(InputError, match="its EXIF orientation turns it; save it upright"):
        masks.read_probability(tmp_path / f"mask{suffix}")
    turned[0x0112] = 1
    WHITE.copy().save(tmp_path / f"mask{suffix}", exif=turned)
    assert (masks.read_probability(tmp_path / f"mask{suffix}") == 1).all()


def test_files_that_are_not_masks_are_refused_in_one_line(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "photo.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "photo.png").read_bytes()[:100])
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "folder.png").mkdir()
    for name in ("pages.tif", "frames.png"):
        BLACK.save(tmp_path / name, save_all=True, append_images=[WHITE])
    floats = np.full((2, 2), 7, np.float32)
    for name, pixels in {
        "seven": floats,
        "nan": floats * np.float32("nan"),
        "int": floats.astype("i4"),
    }.items():
        Image.fromarray(pixels).save(tmp_path / f"{name}.tif")
    expected = {
        "photo.png": "colour picture",
        "cut.png": "cannot be read",
        "empty.png": "cannot be read",
        "folder.png": "is a folder",
        "missing.png": "no such file",
        "pages.tif": "several pages",
        "frames.png": "several pages",
        "seven.tif": r"in \[0, 1\]",
        "nan.tif": r"in \[0, 1\]",
        "int.tif": "int32",
    }
    for name, problem in expected.items():
        with pytest.raises(InputError, match=problem) as error:
            masks.read_probability(tmp_path / name)
        assert name in str(error.value)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("img.0001.JPG", "img.0001.JPG.png"),
        ("left/a.b", "left/a.b.png"),
        ("left\\a", "left/a.png"),
        ("a.png", "a.png.png"),
    ],
)
def test_image_paths_keep_dots_and_folders_of_names(tmp_path, name, file):
    assert masks.image_path(tmp_path, name) == tmp_path / file


@pytest.mark.parametrize("name", ["", ".", "..", "../a", "/etc/a", "a/../../b", "C:\\a", "..\\a"])
def test_names_that_leave_the_folder_are_refused(name):
    with pytest.raises(InputError, match="cannot name a file"):
        masks.image_path(Path("out"), name)


@pytest.mark.parametrize("name", ["a\0b", "x" * 300, "a/" + "é" * 150, "a/" * 1500 + "b", "\ud800"])
def test_names_that_no_file_can_have_are_refused(name):
    with pytest.raises(InputError, match="cannot name a file") as error:
        masks.image_path(Path("out"), name)
    assert len(str(error.value)) < 400


def test_the_longest_name_can_be_written(tmp_path):
    masks.write_mask(masks.image_path(tmp_path, "x" * masks.MAX_PART_BYTES), MASK)


def test_large_images_are_refused_by_their_header(tmp_path):
    Image.new("1", (9000, 9000)).save(tmp_path / "large.png")
    tracemalloc.start()
    with pytest.raises(InputError, match=r"large\.png: takes 2\.41 GiB of memory"):
        masks.read_probability(tmp_path / "large.png", max_bytes=2**30)
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()


def test_no_other_bound_than_that_of_memory_applies(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    Image.fromarray(MASK).save(tmp_path / "m.png")
    np.testing.assert_array_equal(masks.read_probability(tmp_path / "m.png"), MASK)
    with pytest.raises(InputError, match="of memory to read"):
        masks.read_probability(tmp_path / "m.png", max_bytes=100)
    assert Image.MAX_IMAGE_PIXELS == 10


def test_formats_for_which_other_programs_would_run_are_refused(tmp_path):
    Image.fromarray(LEVELS).save(tmp_path / "page.eps")
    (tmp_path / "page.eps").rename(tmp_path / "page.png")
    with pytest.raises(InputError, match="cannot be read as an image"):
        masks.read_probability(tmp_path / "page.png")
