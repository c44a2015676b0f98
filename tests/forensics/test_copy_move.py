"""Copy-move: copies are found after a similarity and with noise; coincidences are not."""

import dataclasses
import sys

import numpy as np
import pytest
from forensics_cases import assert_matches, central_rows, detected, room, with_copy
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gsc_jax.benchmark.incorporation import transformed
from gsc_jax.forensics.copy_move import copy_move
from gsc_jax.forensics.traces import MIN_REGION, NEIGHBOURS
from gsc_jax.scene import Gaussians
from gsc_jax.scene.gaussians import concatenate
from gsc_jax.scene.neighbours import nearest_neighbours

PART = central_rows(room())


def both_copies(count: int) -> np.ndarray:
    labels = np.arange(count) >= len(room())
    labels[PART] = True
    return labels


def test_both_copies_are_marked_also_after_a_similarity():
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    copy = transformed(room().take(PART), quarter, 1.7, np.array([0, -9.0, 0]))
    for edited in (with_copy(room(), PART), concatenate([room(), copy])):
        assert_matches(detected(copy_move, edited), both_copies(len(edited)))


def test_copy_with_noise_is_found():
    edited = with_copy(room(), PART)
    noise = 0.03 * np.random.default_rng(0).normal(size=(len(edited), 3))
    log_scales = (np.asarray(edited.log_scales) + noise).astype(np.float32)
    edited = dataclasses.replace(edited, log_scales=log_scales)
    assert_matches(detected(copy_move, edited), both_copies(len(edited)), recall=0.8)


def test_scattered_duplicates_are_a_coincidence():
    chosen = np.random.default_rng(0).choice(len(room()), 400, replace=False)
    copies = room().take(chosen)
    places = np.random.default_rng(1).permutation(np.asarray(copies.means)) + np.float32(0.01)
    edited = concatenate([room(), dataclasses.replace(copies, means=places)])
    assert not detected(copy_move, edited).found


def clones_of(part: Gaussians) -> Gaussians:
    """Clones beside their originals, as training leaves them."""
    means = np.asarray(part.means)
    reach = KDTree(means).query(means, k=13)[0][:, -1:]
    step = np.random.default_rng(0).normal(size=means.shape)
    step *= 1.5 * reach / np.linalg.norm(step, axis=1, keepdims=True)
    return dataclasses.replace(part, means=(means + step).astype(np.float32))


def test_clones_of_training_stay_where_they_were_made():
    clones = clones_of(room().take(PART))
    assert not detected(copy_move, concatenate([room(), clones])).found


def test_clones_beside_a_copied_region_are_not_marked():
    with_both = concatenate([with_copy(room(), PART), clones_of(far_part())])
    score = detected(copy_move, with_both).score
    assert (score[len(room()) : len(room()) + len(PART)] > 0.5).mean() > 0.8
    assert not score[len(room()) + len(PART) :].any()


def test_small_parts_are_coincidences():
    """Even if all small copies together have as many Gaussians as the smallest region."""
    means = np.asarray(room().means)
    seeds = np.random.default_rng(3).choice(len(means), 8, replace=False)
    parts = [np.argsort(np.linalg.norm(means - means[seed], axis=1))[:16] for seed in seeds]
    edited = room()
    for part in parts:
        edited = with_copy(edited, part)
    assert not detected(copy_move, edited).found


@pytest.mark.parametrize(("share", "density"), [(0.1, 0.6), (0.1, 0.65), (0.2, 0.65)])
def test_no_fragments_are_left_of_parts_that_are_coincidences(monkeypatch, share, density):
    scene, rng = room(), np.random.default_rng(0)
    means = np.asarray(scene.means)
    far = np.linalg.norm(means - means[np.random.default_rng(9).integers(len(means))], axis=1)
    moved = (rng.random(len(scene)) < density) & (far <= np.quantile(far, share))
    moves = np.where(moved, rng.uniform(0.6, 3.7, len(scene)), 0)
    monkeypatch.setattr(sys.modules[copy_move.__module__], "moved_together", lambda *_: moves)
    near = nearest_neighbours(means, np.arange(len(means)), NEIGHBOURS)
    marked = copy_move(scene, near).score > 0.5
    ends = np.arange(len(near) + 1) * NEIGHBOURS
    graph = csr_array((np.ones(near.size), near.ravel(), ends), shape=(len(near), len(near)))
    parts = connected_components(graph[marked][:, marked], directed=False)[1]
    assert np.bincount(parts).min() >= MIN_REGION


def far_part() -> Gaussians:
    """A compact part of the room that is not the copied one."""
    means = np.asarray(room().means)
    far = means[np.argmax(np.linalg.norm(means - means[PART].mean(axis=0), axis=1))]
    return room().take(np.argsort(np.linalg.norm(means - far, axis=1))[: len(PART)])
