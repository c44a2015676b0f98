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

COUNT = 4000
PROPERTIES = ("size", "flatness", "opacity", "brightness", "saturation", "view dependence")


def cloud() -> tuple[Gaussians, np.ndarray]:
    """Alike Gaussians in a cube of side 2, and which are in a cube of side 1 in its middle."""
    found = random_scene(COUNT)
    means = np.random.default_rng(1).uniform(-1, 1, (COUNT, 3)).astype(np.float32)
    return dataclasses.replace(found, means=means), np.abs(means).max(axis=1) < 0.5


def changed(gaussians: Gaussians, rows: np.ndarray, name: str) -> Gaussians:
    """Raise one property of some of the Gaussians much, and leave the other properties."""
    log_scales, sh = np.array(gaussians.log_scales), np.array(gaussians.sh)
    opacities = np.array(gaussians.logit_opacities)
    if name == "size":
        log_scales[rows] += 5
    if name == "flatness":
        order = np.argsort(log_scales[rows], axis=1)
        moved = np.take_along_axis(np.array([[-20, 10, 10]] * COUNT)[rows], order.argsort(1), 1)
        log_scales[rows] += moved
    if name == "opacity":
        opacities[rows] += 20
    if name == "brightness":
        sh[rows, 0] += 0.2 - sh[rows, 0].max(axis=1, keepdims=True) + 1.2
    if name == "saturation":
        grey = sh[:, 0].mean(axis=1, keepdims=True)
        sh[:, 0] = grey + 0.1 * (sh[:, 0] - grey)
        sh[rows, 0] += np.array([0.6, -0.3, -0.3])
    if name == "view dependence":
        sh[rows, 1:] *= 100
    leaves = {"log_scales": log_scales, "logit_opacities": opacities, "sh": sh}
    leaves = {key: value.astype(np.float32) for key, value in leaves.items()}
    return dataclasses.replace(gaussians, **leaves)


@pytest.mark.parametrize("name", PROPERTIES)
def test_a_changed_property_is_found(name):
    gaussians, inside = cloud()
    more = contrasts(changed(gaussians, inside, name), inside)
    less = contrasts(changed(gaussians, ~inside, name), inside)
    assert more[name] > 0.97
    assert less[name] < 0.03
    others = {key: value for key, value in more.items() if key != name}
    if name not in ("brightness", "saturation"):  # which depend on each other at black and white
        assert list(others.values()) == pytest.approx([0.5] * 5, abs=0.06)


def test_alike_gaussians_do_not_differ():
    assert list(contrasts(*cloud()).values()) == pytest.approx([0.5] * 6, abs=0.06)


def test_what_is_far_away_does_not_count():
    gaussians, inside = cloud()
    far = dataclasses.replace(gaussians, means=np.asarray(gaussians.means) * 3 + 20)
    far = changed(far, np.ones(COUNT, bool), "size")
    both = jax.tree.map(lambda *leaves: np.concatenate(leaves), gaussians, far)
    labels = np.append(inside, np.zeros(COUNT, bool))
    assert contrasts(both, labels) == contrasts(gaussians, inside)
    stray = labels | (np.random.default_rng(0).random(2 * COUNT) < 0.01)
    assert contrasts(both, stray)["size"] == pytest.approx(0.5, abs=0.12)


@given(seed=st.integers(0, 2**16))
def test_shares_of_labels_and_the_rest_add_up_and_ignore_order_place_and_unit(seed):
    rng = np.random.default_rng(seed)
    gaussians, labels = random_scene(400, seed=seed), rng.random(400) < 0.5
    gaussians = dataclasses.replace(gaussians, means=rng.uniform(0, 1, (400, 3)))
    found, order = contrasts(gaussians, labels), rng.permutation(400)
    assert found.keys() == set(PROPERTIES)
    assert all(0 <= value <= 1 for value in found.values())
    opposite = contrasts(gaussians, ~labels)
    assert opposite == pytest.approx({key: 1 - value for key, value in found.items()}, abs=1e-6)
    larger = np.asarray(gaussians.log_scales) + np.float32(np.log(2))
    moved = dataclasses.replace(gaussians, means=2 * gaussians.means + 3, log_scales=larger)
    shuffled = jax.tree.map(lambda leaf: np.asarray(leaf)[order], moved)
    assert contrasts(shuffled, labels[order]) == pytest.approx(found, abs=2e-3)


def test_with_too_few_gaussians_nothing_is_said():
    gaussians, inside = cloud()
    few = np.zeros(COUNT, bool)
    few[: MIN_COUNT - 1] = True
    for labels in (few, np.zeros_like(few), np.ones_like(few)):
        assert contrasts(gaussians, labels) == {}
    assert contrasts(gaussians, inside)


def test_rows_that_cannot_be_rendered_do_not_count():
    gaussians, inside = cloud()
    opacities, means = np.array(gaussians.logit_opacities), np.array(gaussians.means)
    opacities[::7], means[1::7] = np.nan, np.nan
    broken = dataclasses.replace(gaussians, logit_opacities=opacities, means=means)
    whole = np.isfinite(opacities) & np.isfinite(means).all(axis=1)
    expected = contrasts(gaussians.take(np.flatnonzero(whole)), inside[whole])
    assert contrasts(broken, inside) == expected


def test_a_scale_of_zero_is_smaller_than_all_others():
    gaussians, inside = cloud()
    log_scales = np.where(inside[:, None], -np.inf, gaussians.log_scales).astype(np.float32)
    found = contrasts(dataclasses.replace(gaussians, log_scales=log_scales), inside)
    assert found["size"] == 0


def test_without_harmonics_nothing_is_said_about_the_view():
    gaussians, inside = cloud()
    flat = dataclasses.replace(gaussians, sh=np.asarray(gaussians.sh)[:, :1])
    assert contrasts(flat, inside).keys() == set(PROPERTIES) - {"view dependence"}


@needs_data
def test_a_pasted_object_differs_more_than_parts_of_an_authentic_scene():
    edited = load_tampered("kitchen-incorporate")
    assert contrasts(edited.gaussians, edited.labels)["size"] < 0.05
    authentic, _ = load_scene("kitchen")
    means = np.asarray(authentic.means)
    for center in means[:: len(means) // 5]:
        distances = np.linalg.norm(means - center, axis=1)
        part = contrasts(authentic, distances <= np.sort(distances)[2000])
        assert max(abs(share - 0.5) for share in part.values()) < 0.45
