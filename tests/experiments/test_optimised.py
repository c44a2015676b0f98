"""Optimised edits change what they should and nothing else; laundering changes little of much."""

import dataclasses

import numpy as np
import optimised
import pytest
from optimised import IMAGE_EDITS, Refinement, laundered, optimise_region, refine
from similarity import psnr

from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.regions import measure_visibility
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.scene import Gaussians
from gsc_jax.splat import render

MADE = tampered_room(count=3_000, views=8, heldout=1, width=64, height=48)
ROOM, CAMERAS = MADE.gaussians, MADE.cameras
IMAGES = np.stack([np.asarray(render(ROOM, camera)[0]) for camera in CAMERAS])


def leaves(scene: Gaussians) -> list[np.ndarray]:
    return [np.asarray(leaf).reshape(len(scene), -1) for leaf in vars(scene).values()]


def test_only_the_given_rows_change_and_the_images_come_closer():
    rows = np.arange(len(ROOM)) % 3 == 0
    target = np.clip(0.7 * IMAGES + 0.1, 0, 1)
    after = refine(ROOM, CAMERAS, target, rows=rows, options=Refinement(steps=40, anchor=0.0))
    for old, new in zip(leaves(ROOM), leaves(after), strict=True):
        np.testing.assert_array_equal(old[~rows], new[~rows])
        assert new.dtype == np.float32
    assert (after.sh != np.asarray(ROOM.sh))[rows].mean() > 0.3
    before, now = (
        psnr(np.stack([render(scene, camera)[0] for camera in CAMERAS]), target)
        for scene in (ROOM, after)
    )
    assert now > before + 1


def test_infinite_opacities_stay_and_images_that_do_not_fit_are_errors():
    logits = np.array(ROOM.logit_opacities)
    logits[:2] = np.inf, -np.inf
    scene = dataclasses.replace(ROOM, logit_opacities=logits)
    after = refine(
        scene, CAMERAS, IMAGES, rows=np.arange(len(ROOM)) > 1, options=Refinement(steps=2)
    )
    np.testing.assert_array_equal(after.logit_opacities[:2], logits[:2])
    assert not np.isnan(after.logit_opacities).any()
    with pytest.raises(ValueError, match="7 images"):
        refine(scene, CAMERAS, IMAGES[1:])


def test_the_anchor_holds_parameters_near_to_what_they_were():
    free, held = (
        refine(ROOM, CAMERAS, 1 - IMAGES, options=Refinement(steps=10, anchor=anchor))
        for anchor in (0.0, 0.3)
    )
    moves = [np.abs(scene.sh - np.asarray(ROOM.sh)).mean() for scene in (free, held)]
    assert 0 < moves[1] < 0.6 * moves[0]


def test_laundering_changes_much_by_little():
    after = laundered(ROOM, CAMERAS, options=Refinement(steps=20, anchor=0.0))
    for old, new in zip(leaves(ROOM), leaves(after), strict=True):
        assert (old != new).any(axis=1).mean() > 0.5
    camera = MADE.heldout_cameras[0]
    assert psnr(render(after, camera)[0], render(ROOM, camera)[0]) > 30
    again = laundered(ROOM, CAMERAS, options=Refinement(steps=20, anchor=0.0))
    np.testing.assert_array_equal(after.means, again.means)


@pytest.mark.parametrize("name", IMAGE_EDITS)
def test_image_edits_give_other_images(name):
    change = IMAGE_EDITS[name](np.random.default_rng(0))
    edited = change(IMAGES[0])
    assert edited.shape == IMAGES[0].shape
    assert edited.min() >= 0
    assert edited.max() <= 1
    assert np.abs(edited - IMAGES[0]).mean() > 0.005


def test_a_region_is_optimised_for_edited_views(monkeypatch):
    monkeypatch.setattr(optimised, "IMAGE_EDITS", {"recoloured": IMAGE_EDITS["recoloured"]})
    visibility = measure_visibility(ROOM, CAMERAS)
    edit = optimise_region(ROOM, visibility, 0.1, np.random.default_rng(1))
    assert 8 <= edit.labels.sum() < len(ROOM) // 2
    for old, new in zip(leaves(ROOM), leaves(edit.gaussians), strict=True):
        np.testing.assert_array_equal(old[~edit.labels], new[~edit.labels])
    inside = np.stack([truth_mask(ROOM, camera, edit.labels) for camera in CAMERAS])
    images = np.stack([render(edit.gaussians, camera)[0] for camera in CAMERAS])
    change = np.abs(images - IMAGES).mean(axis=-1)
    assert change[inside].mean() > 0.05
    assert change[inside].mean() > 5 * change[~inside].mean()


def test_densification_adds_gaussians_to_the_region_only(monkeypatch):
    monkeypatch.setattr(optimised, "IMAGE_EDITS", {"textured": IMAGE_EDITS["textured"]})
    visibility = measure_visibility(ROOM, CAMERAS)
    quick, edit = (
        optimise_region(ROOM, visibility, 0.1, np.random.default_rng(1), densify=densify)
        for densify in (False, True)
    )
    assert len(quick.gaussians) == len(ROOM) < len(edit.gaussians)
    assert np.isfinite(edit.gaussians.logit_opacities).all()
    added = len(edit.gaussians) - len(ROOM)
    assert 0 < added < len(ROOM) // 2
    # Authentic Gaussians are those of the room, to the bit and in their order.
    rest = edit.gaussians.take(np.flatnonzero(~edit.labels))
    whole = {row.tobytes() for row in np.concatenate(leaves(ROOM), axis=1)}
    assert all(row.tobytes() in whole for row in np.concatenate(leaves(rest), axis=1))


def test_densification_leaves_other_rows_alone():
    rows = np.arange(len(ROOM)) % 2 == 0
    logits = np.array(ROOM.logit_opacities)
    logits[:40], logits[40:42] = -np.inf, -9.0  # 40 free rows, of which half may be used
    scene = dataclasses.replace(ROOM, logit_opacities=logits)
    options = Refinement(steps=100, densify=True)
    after = refine(scene, CAMERAS, 1 - IMAGES, rows=rows, options=options)
    for old, new in zip(leaves(scene), leaves(after), strict=True):
        np.testing.assert_array_equal(old[~rows], new[~rows])
        assert not np.isnan(new).any()
    assert np.isneginf(after.logit_opacities[1:40:2]).all()
    assert np.isfinite(after.logit_opacities[:40:2]).any()
    # Row 40 was pruned, and may have been used again for a new Gaussian.
    assert np.isneginf(after.logit_opacities[40]) or after.logit_opacities[40] > -5
