"""Quantisation: values off the levels of a scene, or on levels of their own."""

import dataclasses

import numpy as np
import pytest
from data import load_tampered, needs_data
from forensics_cases import (
    assert_matches,
    central_rows,
    changed,
    detected,
    labels_of,
    quantised_room,
    room,
)

from gsc_jax.forensics.quantisation import off_levels, quantisation
from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import order_of_leaves

BETWEEN = np.float32(0.37 / 16)
"""Offset from the levels of the quantised room to values between them."""


def with_colours_moved(gaussians: Gaussians, rows: np.ndarray) -> Gaussians:
    sh = np.array(gaussians.sh)[rows]
    sh[:, 0] += BETWEEN
    return changed(gaussians, rows, sh=sh)


def test_unquantised_values_in_a_quantised_scene_are_marked():
    host, part = quantised_room(), central_rows(room())
    assert not detected(quantisation, host).found
    edited = changed(host, part, log_scales=room().log_scales[part])
    trace = detected(quantisation, edited)
    assert_matches(trace, labels_of(host, part), precision=0.99)
    assert "scales" in trace.explanation


def test_quantised_values_in_an_unquantised_scene_are_marked():
    part = central_rows(room(), 800)
    edited = changed(room(), part, log_scales=quantised_room().log_scales[part])
    assert_matches(detected(quantisation, edited), labels_of(edited, part), recall=0.8)


@pytest.mark.parametrize(("others", "found"), [(0.0, True), (0.5, False)])
def test_a_part_of_equal_colours_among_others_is_none_with_levels(others, found):
    """A level of detail merges pairs of Gaussians; where both had one colour, it stays exact."""
    part, rng = central_rows(room(), 800), np.random.default_rng(0)
    sh = np.array(room().sh[part])
    equal = rng.random(len(part)) >= others
    sh[equal, 0] = rng.integers(0, 20, (equal.sum(), 1)) / np.float32(20)
    trace = detected(quantisation, changed(room(), part, sh=sh))
    assert trace.found == found


@pytest.mark.parametrize(("size", "found"), [(256, False), (20_000, True)])
def test_levels_of_small_chunks_are_the_format_and_those_of_a_part_are_none(size, found):
    """A compressed.ply has 256 levels between the extremes of each of its chunks."""
    host, rng = room(20_000), np.random.default_rng(0)
    order, part = order_of_leaves(np.asarray(host.means)), central_rows(host, 1500)
    sh = np.array(host.sh)
    sh[:, 0] = rng.normal(size=(len(sh), 3))
    sh[part, 0] = 0.1 * rng.integers(-9, 9, (len(part), 3))
    sh[part[::50], 0] = 1
    for start in range(0, len(order), size):
        rows = order[start : start + size] if size == 256 else part
        low, high = sh[rows, 0].min(axis=0), sh[rows, 0].max(axis=0)
        sh[rows, 0] = low + np.round((sh[rows, 0] - low) / (high - low) * 255) * (high - low) / 255
    assert detected(quantisation, dataclasses.replace(host, sh=sh)).found == found


def test_second_set_of_levels_between_those_of_the_scene_is_marked():
    host = quantised_room(20_000)
    part = central_rows(host, 2000)
    trace = detected(quantisation, with_colours_moved(host, part))
    assert_matches(trace, labels_of(host, part), precision=0.99)


def test_half_of_a_scene_with_its_own_levels_is_a_tile_of_the_export():
    host = quantised_room(20_000)
    half = np.flatnonzero(host.means[:, 0] > np.median(host.means[:, 0]))
    assert not detected(quantisation, with_colours_moved(host, half)).found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_extreme_values_that_neighbour_only_each_other_are_no_second_set(seed):
    """Even values in the scene, odd ones in an edit, and two lamps brighter than all else."""
    rng = np.random.default_rng(seed)
    ranges = {"scene": (6000, 0, 96, 2), "edit": (800, 1, 97, 2)}
    ranges |= {"lamp": (300, 96, 100, 1), "other lamp": (300, 100, 104, 1)}
    values = [rng.choice(np.arange(*span), count) for count, *span in ranges.values()]
    part = np.repeat(np.arange(4), [count for count, *_ in ranges.values()])
    own = [np.flatnonzero(part == k) for k in range(4)]
    neighbours = np.concatenate([rng.choice(rows, (len(rows), 12)) for rows in own])
    _, second = off_levels(np.concatenate(values).astype(np.float32), neighbours)
    assert second[part == 1].mean() > 0.98
    assert not second[part != 1].any()


@needs_data
def test_window_brighter_than_all_else_is_not_taken_for_an_edit():
    scene = load_tampered("kitchen-incorporate")
    trace = detected(quantisation, scene.gaussians)
    assert_matches(trace, scene.labels, precision=0.99, recall=0.15)
