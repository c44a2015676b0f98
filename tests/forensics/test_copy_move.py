"""Copy-move: copies are found after a similarity and with noise; coincidences are not."""

import dataclasses

import numpy as np
from forensics_cases import assert_matches, central_rows, detected, room, with_copy
from scipy.spatial import KDTree

from gsc_jax.benchmark.incorporation import transformed
from gsc_jax.benchmark.scenes import concatenate
from gsc_jax.forensics.copy_move import copy_move

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


def test_clones_of_training_stay_where_they_were_made():
    clones, rng = room().take(PART), np.random.default_rng(0)
    means = np.asarray(clones.means)
    reach = KDTree(means).query(means, k=13)[0][:, -1:]
    step = rng.normal(size=means.shape)
    step *= 1.5 * reach / np.linalg.norm(step, axis=1, keepdims=True)
    clones = dataclasses.replace(clones, means=(means + step).astype(np.float32))
    assert not detected(copy_move, concatenate([room(), clones])).found
