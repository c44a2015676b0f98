import numpy as np
import pytest
from edited_room import UP, grown, room, visibility
from strategies import blobs, camera, with_row

from gsc_jax.benchmark import regions


def test_a_region_grows_to_its_size():
    region, seen = grown(), visibility()
    assert set(grown(size=0.02).rows) < set(region.rows)
    assert not set(region.rows) & set(region.ring)
    covers = regions.median_visible_share(seen.pixel_share[:, region.rows].sum(axis=1))
    assert covers == pytest.approx(0.04, rel=0.3)
    assert np.linalg.norm(region.towards) == pytest.approx(1)
    np.testing.assert_allclose(seen.up, UP, atol=0.2)


def test_a_region_does_not_cross_a_gap():
    x = np.linspace(-1, 1, 21)
    sheet = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    front, back = (np.column_stack([sheet, np.full(len(sheet), z)]) for z in (3.0, 4.0))
    two = blobs(np.vstack([front, back]), opacity=0.9, scale=0.05)
    seen = regions.measure_visibility(two, [camera(60, 60, focal=40.0)])
    region = regions.grow_region(two, seen, 220, 0.3)
    assert 0 < len(region.rows) <= 441
    assert region.rows.max() < 441


def test_invalid_rows_are_in_no_region():
    seed, invalid = map(int, grown().rows[:2])
    broken = with_row(room()[0], "means", np.nan, row=invalid)
    region = regions.grow_region(broken, visibility(), seed, 0.04)
    assert np.isfinite(broken.means[region.rows]).all()
    assert invalid not in region.rows
