"""Exporters keep what a scene shows, and say which row each Gaussian stems from."""

import dataclasses

import numpy as np
import pytest
from export import CODEBOOK, COLOUR_STEP, EXPORTERS, SCALE_STEP, export
from histories import MIN_OPACITY, level_of_detail, morton_order
from similarity import psnr
from strategies import random_scene, with_row

from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.scene import invalid_rows
from gsc_jax.splat import render

ROOM = make_room(count=3_000, seed=1)
CAMERA = room_cameras(3, width=96, height=72)[0]
LOSSY = {"spz": 24, "splat": 21, "no harmonics": 21, "level of detail": 22, "pruned": 24}
"""Least PSNR in dB of the exporters that drop something; 30 for the others."""


def requantised(gaussians, exporter="8 bits", seed=0):
    return export(gaussians, exporter, seed=seed).gaussians


@pytest.mark.parametrize("exporter", EXPORTERS)
def test_an_export_is_a_scene_that_looks_the_same(exporter):
    if exporter in ("spz", "compressed.ply"):
        pytest.importorskip("gsply", reason="gsply is not installed (extra formats)")
    saved, rows = export(ROOM, exporter, seed=3)
    assert len(saved) == len(rows) > len(ROOM) // 3
    assert not any(bad.any() for bad in invalid_rows(saved).values())
    assert {leaf.dtype for leaf in vars(saved).values()} == {np.dtype(np.float32)}
    again = export(ROOM, exporter, seed=3).gaussians
    np.testing.assert_array_equal(saved.sh, again.sh)
    if exporter not in ("moved", "cropped"):
        shift = np.linalg.norm(saved.means - np.asarray(ROOM.means)[rows], axis=1)
        assert np.median(shift) < 0.1
        images = [render(scene, CAMERA)[0] for scene in (ROOM, saved)]
        assert psnr(*images) > LOSSY.get(exporter, 30)


def test_a_moved_scene_has_the_same_shape():
    saved, rows = export(ROOM, "moved", seed=2)
    pairs = np.random.default_rng(0).integers(len(ROOM), size=(2, 200))
    before, after = (
        np.linalg.norm(np.subtract(*np.asarray(scene.means)[pairs]), axis=1)
        for scene in (ROOM, saved)
    )
    scale = np.median(after / before)
    np.testing.assert_allclose(after, scale * before, rtol=1e-3)
    np.testing.assert_allclose(saved.log_scales - ROOM.log_scales, np.log(scale), atol=1e-4)
    assert 0.3 < scale < 3
    assert rows.tolist() == list(range(len(ROOM)))


@pytest.mark.parametrize("exporter", ["spz", "compressed.ply", "palettes", "splat"])
def test_formats_keep_rotations_and_opacities(exporter):
    if exporter in ("spz", "compressed.ply"):
        pytest.importorskip("gsply", reason="gsply is not installed (extra formats)")
    saved, rows = export(ROOM, exporter)
    turned = np.abs(np.sum(np.asarray(saved.rotations) * np.asarray(ROOM.rotations)[rows], axis=1))
    assert turned.min() > 0.999
    error = np.abs(np.asarray(saved.opacities) - np.asarray(ROOM.opacities)[rows])
    assert error.max() < 1.01 / 255


def test_rows_that_are_selected_stay_as_they_are():
    for exporter in ("cropped", "pruned", "Morton order", "random order"):
        saved, rows = export(ROOM, exporter)
        np.testing.assert_array_equal(saved.sh, np.asarray(ROOM.sh)[rows])
        assert len(np.unique(rows)) == len(rows)
    assert (np.asarray(export(ROOM, "pruned").gaussians.opacities) >= MIN_OPACITY - 1e-6).all()
    assert len(export(ROOM, "cropped").rows) < len(ROOM)


def test_a_palette_has_few_entries_and_chunks_have_their_own():
    one, chunked = (requantised(ROOM, name) for name in ("palettes", "streamed"))
    assert len(np.unique(one.log_scales)) <= CODEBOOK < len(np.unique(chunked.log_scales))


def test_morton_order_keeps_neighbours_together():
    shuffled = export(ROOM, "random order").gaussians.means
    sorted_ = np.asarray(ROOM.means)[morton_order(np.asarray(ROOM.means))]
    steps = [np.median(np.linalg.norm(np.diff(m, axis=0), axis=1)) for m in (sorted_, shuffled)]
    assert steps[0] < 0.1 * steps[1]


def test_merged_gaussians_have_the_moments_of_the_pair():
    pair = dataclasses.replace(random_scene(2), logit_opacities=np.zeros(2, np.float32))
    pair.log_scales[:] = np.log(0.1)
    pair.means[:] = [[0, 0, 3], [0.4, 0, 3]]
    merged, rows = level_of_detail(pair)
    assert len(merged) == len(rows) == 1
    np.testing.assert_allclose(merged.means, [[0.2, 0, 3]], atol=1e-6)
    scales = np.sort(np.exp(merged.log_scales[0]))
    np.testing.assert_allclose(scales**2, [0.01, 0.01, 0.05], rtol=1e-4)
    area = np.mean([scales[0] * scales[1], scales[0] * scales[2], scales[1] * scales[2]])
    np.testing.assert_allclose(merged.opacities[0] * area, 2 * 0.5 * 0.01, rtol=1e-4)


def test_an_unknown_exporter_and_unusable_scenes_are_errors():
    with pytest.raises(ValueError, match="exporter must be one of"):
        export(ROOM, "zip")
    with pytest.raises(ValueError, match="at least 8 Gaussians"):
        export(ROOM.take(np.arange(7)), "float")
    with pytest.raises(ValueError, match="of which 2999 can"):
        export(with_row(ROOM, "means", np.nan), "palettes")


def test_8_bits_leave_few_values_and_float_many():
    coarse, fine = requantised(ROOM), requantised(ROOM, "float")
    assert len(np.unique(coarse.log_scales)) < 200 < 2_000 < len(np.unique(fine.log_scales))
    assert len(np.unique(coarse.opacities)) <= 256


@pytest.mark.parametrize("exporter", ["8 bits", "float"])
def test_values_change_by_a_step_at_most(exporter):
    saved = requantised(ROOM, exporter)
    assert np.abs(saved.log_scales - ROOM.log_scales).max() <= 1.5 * SCALE_STEP + 1e-5
    assert np.abs(saved.sh - ROOM.sh).max() <= 1.5 * COLOUR_STEP + 1e-5
    assert np.abs(np.asarray(saved.opacities) - np.asarray(ROOM.opacities)).max() <= 1.501 / 255
    turned = np.abs(np.sum(np.asarray(saved.rotations) * np.asarray(ROOM.rotations), axis=1))
    assert turned.min() > 0.998


def test_an_earlier_quantisation_of_some_rows_is_hidden():
    scales = np.array(ROOM.log_scales)
    scales[::2] = np.round(scales[::2] / SCALE_STEP) * SCALE_STEP
    saved = np.asarray(requantised(dataclasses.replace(ROOM, log_scales=scales)).log_scales)
    moved = np.abs(saved - scales) > 1e-4
    assert 0.15 < moved[::2].mean() < 0.35, "a quarter of triangular noise exceeds half a step"
    assert np.abs(saved / SCALE_STEP - np.round(saved / SCALE_STEP)).max() < 1e-3


def test_the_seed_determines_the_noise():
    np.testing.assert_array_equal(requantised(ROOM, seed=4).sh, requantised(ROOM, seed=4).sh)
    assert (requantised(ROOM, seed=4).sh != requantised(ROOM, seed=5).sh).any()
