"""Masks that are no evidence: of a nonsense detector, of chance; and masks that are."""

import dataclasses
import functools

import numpy as np
import pytest

from gsc_jax import locate, observe
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.benchmark.simulate import REGIMES, Failures, decoy_labels, simulate
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.mask_checks import agreement, best_property, doubts, separation
from gsc_jax.splat import render

MADE = tampered_room(count=4_000, views=10, heldout=0, width=96, height=72)
ROOM, CAMERAS = MADE.gaussians, MADE.cameras
NONSENSE = {
    "red": lambda image: image[..., 0] > 0.6,
    "brightness": lambda image: image.mean(axis=-1) < 0.4,
}


@functools.cache
def truth() -> dict[str, np.ndarray]:
    return {camera.name: truth_mask(ROOM, camera, MADE.labels) for camera in CAMERAS}


@pytest.mark.parametrize("name", NONSENSE)
def test_a_threshold_on_the_image_is_no_evidence(name):
    result = locate(ROOM, CAMERAS, NONSENSE[name])
    assert f"The masks follow the {name} of the images" in result.warnings[0]
    assert result.prior is not None
    assert result.verdict is not None
    assert result.verdict <= result.prior.verdict
    assert result.outcome != "evidence"


def test_true_masks_are_evidence():
    assert doubts(observe(ROOM, CAMERAS, truth())) == []
    assert locate(ROOM, CAMERAS, truth(), prior=False).outcome == "evidence"


def test_the_same_mask_in_every_view_is_no_evidence():
    mask = np.zeros((CAMERAS[0].height, CAMERAS[0].width), bool)
    mask[10:20, 10:20] = True
    same = {camera.name: mask for camera in CAMERAS}
    assert any("the same pixels" in text for text in doubts(observe(ROOM, CAMERAS, same)))
    for other in (np.zeros_like(mask), ~mask):
        same[CAMERAS[1].name] = other
        assert not any("the same pixels" in text for text in doubts(observe(ROOM, CAMERAS, same)))
    equal = dict.fromkeys(same, mask)
    names = list(same)[:3]
    placed = [dataclasses.replace(CAMERAS[0], name=name) for name in names]
    for cameras in (CAMERAS[:2], placed):  # two views say little, and those of one place are equal
        found = doubts(observe(ROOM, cameras, {c.name: equal[c.name] for c in cameras}))
        assert not any("the same pixels" in text for text in found)
    full = dict.fromkeys(same, np.ones_like(mask))
    assert not any("the same pixels" in text for text in doubts(observe(ROOM, CAMERAS, full)))


def detector_masks(failures: Failures, seed: int) -> dict[str, np.ndarray]:
    """Masks of a simulated detector that may flag a decoy, an authentic region, too."""
    decoy = decoy_labels(ROOM, MADE.labels, seed=0)
    regions = np.stack([*truth().values()]), [truth_mask(ROOM, camera, decoy) for camera in CAMERAS]
    probability = simulate(regions[0], np.stack(regions[1]), seed=seed, failures=failures)
    return dict(zip(truth(), probability > 0.5, strict=True))


def agrees_by_chance(masks: dict[str, np.ndarray]) -> bool:
    return any("hardly more often than chance" in t for t in doubts(observe(ROOM, CAMERAS, masks)))


@pytest.mark.parametrize("seed", range(4))
def test_false_blobs_alone_agree_by_chance_only(seed):
    assert agrees_by_chance(detector_masks(Failures(misses=1.0, blobs=2.0), seed))


@pytest.mark.parametrize("seed", range(4))
def test_masks_with_all_failures_agree_by_more_than_chance(seed):
    assert doubts(observe(ROOM, CAMERAS, detector_masks(REGIMES["mixture"], seed))) == []


def test_masks_at_random_places_agree_by_chance_only():
    rng, masks = np.random.default_rng(0), {}
    for camera in CAMERAS:
        y, x = rng.integers(0, 60), rng.integers(0, 80)
        masks[camera.name] = np.zeros((72, 96), bool)
        masks[camera.name][y : y + 8, x : x + 8] = True
    assert agrees_by_chance(masks)
    agreed = agreement(observe(ROOM, CAMERAS, masks).evidence)
    assert agreed is not None
    assert agreed < 0.1 < 0.9 < (agreement(observe(ROOM, CAMERAS, truth()).evidence) or 0)


def test_masks_are_judged_by_the_views_that_show_what_is_labelled():
    """A third of the views shows the edit, and all have false alarms at random places."""
    rng, here = np.random.default_rng(0), np.arange(400) < 100
    total = np.where(here ^ (np.arange(12)[:, None] >= 4), np.float32(9), np.float32(0))
    flagged = (rng.random(total.shape) < 0.05) | (np.arange(400) < 20)
    masks = Evidence(total=total, tampered=total * flagged)
    observation = dataclasses.replace(observe(ROOM, CAMERAS, truth()), evidence=masks)
    for region, by_chance in ((None, True), (here & False, True), (~here, True), (here, False)):
        assert any("than chance" in text for text in doubts(observation, region)) == by_chance


@pytest.mark.parametrize(("wrong", "followed"), [(0.01, True), (0.03, False)])
def test_masks_follow_a_property_if_a_threshold_explains_98_percent_of_the_pixels(wrong, followed):
    """A share of the pixels, at random places, is on the wrong side of the threshold."""
    rng, masks = np.random.default_rng(0), {}
    for camera in CAMERAS:
        dark = render(ROOM, camera)[0].mean(axis=-1) < 0.5
        masks[camera.name] = np.asarray(dark) ^ (rng.random(dark.shape) < wrong)
    found = doubts(observe(ROOM, CAMERAS, masks))
    assert any("follow the brightness" in text for text in found) == followed


def test_empty_masks_say_nothing_about_themselves():
    empty = {camera.name: np.zeros((72, 96), bool) for camera in CAMERAS}
    assert agreement(observe(ROOM, CAMERAS, empty).evidence) is None
    assert doubts(observe(ROOM, CAMERAS, empty)) == []


@pytest.mark.parametrize("rows", [True, False])
@pytest.mark.parametrize("flag", [True, False])
def test_masks_of_a_single_line_are_judged_like_others(rows, flag):
    line = np.full((72, 96), not flag)
    line[(slice(None), 15) if rows else 15] = flag
    observed = observe(ROOM, CAMERAS, {camera.name: line for camera in CAMERAS})
    assert best_property(observed) == ("", 0.0)


def test_separation_is_the_best_balanced_accuracy_in_either_direction():
    flagged = np.arange(100) < 30
    assert separation(np.arange(100.0), flagged) == pytest.approx(1, abs=0.05)
    assert separation(-np.arange(100.0), flagged) == pytest.approx(1, abs=0.05)
    mixed = np.random.default_rng(0).random(100)
    assert separation(mixed, flagged) < 0.75
