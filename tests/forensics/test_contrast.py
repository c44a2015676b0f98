"""How labelled Gaussians differ from those around them."""

import dataclasses

import hypothesis.strategies as st
import jax
import numpy as np
import pytest
from data import load_scene, load_tampered, needs_data
from hypothesis import given
from strategies import random_scene

from gsc_jax.forensics.contrast import MIN_COUNT, contrasts
from gsc_jax.scene import Gaussians


def with_patch(change: float) -> tuple[Gaussians, np.ndarray]:
    """A cloud whose middle is larger by `change` in log scale, and which Gaussians these are."""
    cloud = random_scene(2000)
    means = np.random.default_rng(1).uniform(-1, 1, (2000, 3)).astype(np.float32)
    inside = np.abs(means).max(axis=1) < 0.5
    log_scales = np.asarray(cloud.log_scales) + np.float32(change) * inside[:, None]
    return dataclasses.replace(cloud, means=means, log_scales=log_scales), inside


@pytest.mark.parametrize(("change", "expected"), [(5.0, 1.0), (-5.0, 0.0), (0.0, 0.5)])
def test_a_changed_property_is_found_and_no_other(change, expected):
    found = contrasts(*with_patch(change))
    assert found.pop("size") == pytest.approx(expected, abs=0.07)
    assert list(found.values()) == pytest.approx([0.5] * len(found), abs=0.07)


@given(seed=st.integers(0, 2**16), share=st.floats(0.1, 0.9))
def test_shares_turn_around_with_the_sign_and_ignore_order_place_and_unit(seed, share):
    rng = np.random.default_rng(seed)
    cloud, labels = random_scene(200, seed=seed), rng.random(200) < share
    found, order = contrasts(cloud, labels), rng.permutation(200)
    assert all(0 <= value <= 1 for value in found.values())
    moved = dataclasses.replace(
        cloud,
        means=2 * np.asarray(cloud.means),
        log_scales=np.asarray(cloud.log_scales) + np.log(2),
    )
    shuffled = jax.tree.map(lambda leaf: np.asarray(leaf)[order], moved)
    assert contrasts(shuffled, labels[order]) == pytest.approx(found, abs=2e-3)


def test_with_too_few_gaussians_nothing_is_said():
    cloud, inside = with_patch(1.0)
    few = np.zeros(2000, bool)
    few[: MIN_COUNT - 1] = True
    assert contrasts(cloud, few) == contrasts(cloud, np.ones_like(inside)) == {}


def test_a_scale_of_zero_is_smaller_than_all_others():
    cloud, inside = with_patch(0.0)
    log_scales = np.where(inside[:, None], -np.inf, cloud.log_scales).astype(np.float32)
    assert contrasts(dataclasses.replace(cloud, log_scales=log_scales), inside)["size"] == 0


@needs_data
def test_a_pasted_object_differs_more_than_a_part_of_an_authentic_scene():
    edited = load_tampered("kitchen-incorporate")
    assert contrasts(edited.gaussians, edited.labels)["size"] < 0.05
    authentic, _ = load_scene("kitchen")
    means = np.asarray(authentic.means)
    for center in means[:: len(means) // 5]:
        distances = np.linalg.norm(means - center, axis=1)
        part = contrasts(authentic, distances <= np.sort(distances)[2000])
        assert max(abs(share - 0.5) for share in part.values()) < 0.45
