"""The pieces of the report: small pictures, links, charts and what is said beneath them."""

import base64
import dataclasses
import re
from pathlib import Path
from urllib.parse import unquote

import hypothesis.strategies as st
import imageio.v3 as iio
import numpy as np
import pytest
from hypothesis import given
from reports import COUNT, FOUND, run, write
from scipy.ndimage import gaussian_filter
from skimage.data import astronaut

from gsc_jax.cli.pictures import overlay, write_jpeg
from gsc_jax.cli.report.charts import attribute_chart
from gsc_jax.cli.report.properties import properties
from gsc_jax.cli.report.thumbnails import MANY, SIDE, thumbnail, thumbnail_side, url
from gsc_jax.io.masks import write_mask, write_probability


@given(st.text(min_size=1).filter(lambda name: "\0" not in name and name not in (".", "..")))
def test_a_link_leads_to_its_file_whatever_the_name(name: str):
    try:
        name.encode()
    except UnicodeEncodeError:
        return
    path = Path("folder") / "render" / name.replace("/", "_")
    link = url(path, Path("folder"))
    assert Path("folder") / unquote(link) == path
    assert re.fullmatch(r"[\w./%~-]+", link, flags=re.ASCII)


def test_more_views_have_smaller_pictures():
    assert thumbnail_side(1) == thumbnail_side(MANY) == SIDE
    assert thumbnail_side(4 * MANY) == SIDE // 2
    assert thumbnail_side(10**6) > 60


def test_two_hundred_views_fit_into_an_email(tmp_path: Path):
    picture = astronaut()[:384] / 255  # as detailed as a photograph, and 4:3
    mask = picture[..., 0] > 0.7
    write_jpeg(tmp_path / "render.jpg", picture)
    write_jpeg(tmp_path / "overlay.jpg", overlay(picture, mask))
    write_mask(tmp_path / "masks.png", mask)
    write_probability(tmp_path / "detector.png", gaussian_filter(mask.astype(float), 3))
    side = thumbnail_side(200)
    bytes_of = {path.stem: len(thumbnail(path, side)[0]) for path in tmp_path.iterdir()}
    assert 200 * sum(bytes_of.values()) < 14e6, bytes_of
    assert bytes_of["masks"] < bytes_of["render"] / 2


def test_a_thumbnail_has_the_shape_and_the_colours_of_its_picture(tmp_path: Path):
    write_jpeg(tmp_path / "wide.jpg", np.full((90, 640, 3), (0.8, 0.2, 0.4)))
    write_mask(tmp_path / "high.png", np.arange(700)[:, None] < np.full(40, 350))
    pixels = {}
    for name, size in {"wide.jpg": (320, 45), "high.png": (18, 320)}.items():
        source, *shape = thumbnail(tmp_path / name, 320)
        pixels[name] = iio.imread(base64.b64decode(source.partition(",")[2]))
        assert tuple(shape) == size == pixels[name].shape[1::-1]
    np.testing.assert_allclose(pixels["wide.jpg"], np.full((45, 320, 3), (204, 51, 102)), atol=3)
    assert pixels["high.png"][:150].min() > 250
    assert pixels["high.png"][-150:].max() < 5


def test_properties_tell_groups_apart_and_leave_the_unseen_out(tmp_path: Path):
    located = run(tmp_path, ["a view"])
    told = {one.name: one for one in properties(located.scene.gaussians, *_groups(located))}
    assert len(told) == 7
    for one in told.values():
        assert (len(one.tampered), len(one.authentic)) == (100, 293)
        for density in one.densities(20)[:2]:
            assert density.sum() == pytest.approx(1)
            assert (density >= 0).all()
    size, rotation = told["size"], told["rotation"]
    assert np.median(size.tampered) < np.median(size.authentic) - 0.3
    assert 0 <= rotation.tampered.min() <= rotation.tampered.max() <= 180
    tampered, authentic, _ = told["size"].densities(20)
    assert np.minimum(tampered, authentic).sum() < 0.5, "they overlap little"
    flat = located.scene.gaussians.take(np.arange(400))
    flat = dataclasses.replace(flat, sh=flat.sh[:, :1])
    assert len(properties(flat, *_groups(located))) == 6


def _groups(located) -> tuple[np.ndarray, np.ndarray]:
    return located.result.labels, located.result.seen


def test_what_no_view_shows_is_told_apart_from_what_was_seen(tmp_path: Path):
    seen = np.arange(COUNT) >= 5
    located = run(tmp_path, ["a view"], seen=seen)
    said = attribute_chart(located.result).said
    assert f"Right of the line lie {FOUND - 5} of the {COUNT - 5} Gaussians that were seen" in said
    assert "these are called tampered. Called tampered besides: 5 that no view shows." in said
    told = properties(located.scene.gaussians, *_groups(located))
    assert (len(told[0].tampered), len(told[0].authentic)) == (FOUND - 5, COUNT - FOUND)
    hidden = dataclasses.replace(located.result, seen=np.arange(COUNT) >= FOUND)
    assert properties(located.scene.gaussians, hidden.labels, hidden.seen) == []
    page = write(tmp_path / "out", dataclasses.replace(located, result=hidden))
    assert "so none is called tampered. Called tampered besides: 100 that no" in page.text
