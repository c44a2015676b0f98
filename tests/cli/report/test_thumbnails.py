"""Thumbnails and links of the report."""

import base64
import re
from pathlib import Path
from urllib.parse import unquote

import hypothesis.strategies as st
import imageio.v3 as iio
import numpy as np
import pytest
from hypothesis import given
from scipy.ndimage import gaussian_filter
from skimage.data import astronaut

from gsc_jax.cli.pictures import overlay
from gsc_jax.cli.report.thumbnails import data_uri, thumbnail_side, url
from gsc_jax.io.masks import write_image, write_mask, write_probability


@given(st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1))
def test_url_leads_to_its_file_for_any_name(name: str):
    path = Path("folder") / "render" / name.replace("/", "_")
    link = url(path, Path("folder"))
    assert Path("folder") / unquote(link) == path
    assert re.fullmatch(r"[\w./%~-]+", link, flags=re.ASCII)


def test_two_hundred_views_fit_into_an_email(tmp_path: Path):
    picture = astronaut()[:384] / 255  # as detailed as a photograph, aspect ratio 4:3
    mask = picture[..., 0] > 0.7
    write_image(tmp_path / "render.jpg", picture)
    write_image(tmp_path / "overlay.jpg", overlay(picture, mask))
    write_mask(tmp_path / "masks.png", mask)
    write_probability(tmp_path / "detector.png", gaussian_filter(mask.astype(float), 3))
    side = thumbnail_side(200)
    size = {path.stem: len(data_uri(path, side)) for path in tmp_path.iterdir()}
    assert 200 * sum(size.values()) < 14e6, size
    assert size["masks"] < size["render"] / 2


@pytest.mark.parametrize("largest", [1, 0.003, 0])
def test_thumbnail_of_16_bits_keeps_the_levels(tmp_path: Path, largest: float):
    levels = np.repeat(np.linspace(0, largest, 8), 40)
    write_probability(tmp_path / "scores.png", np.tile(levels, (90, 1)))
    uri = data_uri(tmp_path / "scores.png", 320)
    found = iio.imread(base64.b64decode(uri.partition(",")[2]))
    np.testing.assert_allclose(found[45, 20::40, 0], 255 * levels[20::40], atol=3)


def test_thumbnail_keeps_shape_and_colours(tmp_path: Path):
    write_image(tmp_path / "wide.jpg", np.full((90, 640, 3), (0.8, 0.2, 0.4)))
    write_mask(tmp_path / "high.png", np.arange(700)[:, None] < np.full(40, 350))
    pixels = [
        iio.imread(base64.b64decode(data_uri(tmp_path / name, 320).partition(",")[2]))
        for name in ("wide.jpg", "high.png")
    ]
    np.testing.assert_allclose(pixels[0], np.full((45, 320, 3), (204, 51, 102)), atol=3)
    assert pixels[1].shape[:2] == (320, 18)
    assert pixels[1][:150].min() > 250
    assert pixels[1][-150:].max() < 5
