import dataclasses

import numpy as np
from edited_room import edited, room
from strategies import blobs

from gsc_jax.benchmark import regions, removal
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.splat import render


def test_a_removal_leaves_no_hole():
    found, (_, cameras) = edited("removal"), room()
    for view in (cameras[i] for i in np.argsort(-found.visible)[:3]):
        inside = truth_mask(found.gaussians, view, found.labels)
        assert np.asarray(render(found.gaussians, view)[1])[inside].mean() > 0.9


def test_a_hole_in_a_sheet_is_filled_in_its_plane_with_its_colours():
    rng = np.random.default_rng(0)
    flat = rng.uniform(-2, 2, (6000, 2))
    sheet = blobs(np.column_stack([flat, rng.normal(0, 0.01, 6000)]), opacity=0.9, scale=0.05)
    sheet = dataclasses.replace(sheet, sh=(sheet.sh + np.sign(flat[:, :1, None])).astype("f4"))
    radius = np.linalg.norm(flat, axis=1)
    region = regions.Region(
        rows=np.flatnonzero(radius < 0.5),
        ring=np.flatnonzero((radius >= 0.5) & (radius < 1)),
        center=np.zeros(3),
        radius=0.5,
        towards=np.array([0, 0, 1.0]),
    )
    fill = removal.fill_hole(sheet, removal.fit_hole(sheet, region), rng)
    assert np.linalg.norm(fill.means[:, :2], axis=1).max() < 0.55
    assert np.abs(fill.means[:, 2]).max() < 0.06
    assert 0.7 < len(fill) / len(region.rows) < 1.4, "its density differs from its surroundings"
    agree = np.sign(fill.sh[:, 0, 0]) == np.sign(fill.means[:, 0])
    assert agree.mean() > 0.9, "the border between the colours is not continued"
