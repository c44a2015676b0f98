import functools

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.benchmark.simulate import REGIMES, Failures, decoy_labels, simulate

VIEWS = 20
WITHIN_A_VIEW = np.zeros((3, 3, 3), int)
"""Pixels that `scipy.ndimage.label` joins: the eight around one, of the same view."""
WITHIN_A_VIEW[1] = 1


def discs(row, column, *, views=VIEWS, height=48, width=64, radius=7):
    y, x = np.indices((height, width))
    return np.repeat([np.hypot(y - row, x - column) < radius], views, axis=0)


TRUTH, DECOY = discs(16, 16), discs(30, 48)


def flagged(failures, *, truth=TRUTH, seed=0):
    return simulate(truth, DECOY, seed=seed, failures=failures) > 0.5


masks = arrays(bool, array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=9))


@given(masks, st.sampled_from([0.0, 1.5, 20.0]))
@settings(max_examples=50, deadline=None)
def test_without_failures_masks_are_the_truth(truth, softness):
    probability = simulate(truth, seed=0, failures=Failures(softness=softness))
    np.testing.assert_array_equal(probability > 0.5, truth)


@given(masks, st.sampled_from([*REGIMES.values()]), st.integers(0, 5))
@settings(max_examples=50, deadline=None)
def test_outputs_are_probabilities(truth, failures, seed):
    probability = simulate(truth, np.roll(truth, 1, axis=2), seed=seed, failures=failures)
    assert probability.dtype == np.float32
    assert np.all((probability >= 0) & (probability <= 1))


def test_misses_are_a_share_of_the_views_that_show_the_object():
    truth = TRUTH.copy()
    truth[::2] = False
    found = np.any(flagged(Failures(misses=0.4), truth=truth), axis=(1, 2))
    assert found.sum() == 6
    assert not found[::2].any()


def test_decoy_is_flagged_in_its_share_of_the_views_and_nothing_else():
    masks = flagged(Failures(decoy=0.6))
    whole = (masks | ~DECOY).all(axis=(1, 2))
    assert whole.sum() == 12
    np.testing.assert_array_equal(masks[whole], (TRUTH | DECOY)[whole])
    np.testing.assert_array_equal(masks[~whole], TRUTH[~whole])


def test_inverted_views_are_the_complement():
    masks = flagged(Failures(inverted=0.25))
    inverted = (masks == ~TRUTH).all(axis=(1, 2))
    assert inverted.sum() == 5
    np.testing.assert_array_equal(masks[~inverted], TRUTH[~inverted])


def test_blobs_are_false_positives_that_differ_between_views():
    extra = flagged(Failures(blobs=2.0, blob_size=0.03)) & ~TRUTH
    assert extra.any(axis=(1, 2)).mean() > 0.6
    assert 0.002 < extra.mean() < 0.1
    assert len({view.tobytes() for view in extra}) > 0.6 * VIEWS
    np.testing.assert_array_equal(flagged(Failures(blobs=2.0)) & TRUTH, TRUTH)


@functools.cache
def blobs_alone() -> tuple[np.ndarray, np.ndarray]:
    """Number of blobs in each of 300 views, and radii in pixels of those inside of the image.

    On average two blobs per view, so small that two hardly ever touch.
    """
    views, height, width = 300, 96, 128
    nothing = np.zeros((views, height, width), bool)
    masks = simulate(nothing, seed=0, failures=Failures(blobs=2.0, blob_size=0.025)) > 0.5
    labels, count = scipy.ndimage.label(masks, structure=WITHIN_A_VIEW)
    view = np.zeros(count + 1, int)
    view[labels] = np.arange(views)[:, None, None]
    border = np.ones((height, width), bool)
    border[1:-1, 1:-1] = False
    inside = np.setdiff1d(np.arange(1, count + 1), labels[:, border])
    radii = np.sqrt(np.bincount(labels.ravel())[inside] / np.pi)
    return np.bincount(view[1:], minlength=views), radii


def test_the_number_of_blobs_is_that_of_the_settings_on_average():
    assert blobs_alone()[0].mean() == pytest.approx(2.0, rel=0.1)


def test_the_number_of_blobs_varies_between_views_as_a_poisson_variable():
    counts, _ = blobs_alone()
    assert 0.7 < counts.var() / counts.mean() < 1.4
    assert (counts == 0).mean() == pytest.approx(np.exp(-2), abs=0.05)


def test_the_median_radius_of_blobs_is_their_size_times_the_diagonal():
    radii = blobs_alone()[1] / np.hypot(96, 128)
    assert np.median(radii) == pytest.approx(0.025, rel=0.1)
    assert np.log(radii).std() > 0.2, "all blobs have the same size"


@pytest.mark.parametrize("boundary", [2.0, 3.0])
def test_boundary_is_the_standard_deviation_of_the_position_of_edges(boundary):
    """Over 64 edges of 256 pixels, since neighbouring pixels of an edge are displaced together."""
    y, _ = np.indices((64, 256))
    truth = np.repeat([y < 32], 64, axis=0)
    edges = flagged_rows(truth, boundary=boundary)
    assert edges.std() == pytest.approx(boundary, rel=0.06)
    assert edges.mean() == pytest.approx(32, abs=0.2)


def test_without_boundary_edges_stay_where_they_are():
    y, _ = np.indices((64, 256))
    assert np.all(flagged_rows(np.array([y < 32]), boundary=0.0) == 32)


def flagged_rows(truth, *, boundary):
    return (simulate(truth, seed=0, failures=Failures(boundary=boundary)) > 0.5).sum(axis=1)


def test_the_seed_determines_the_masks():
    one, same, other = (
        simulate(TRUTH, DECOY, seed=s, failures=REGIMES["mixture"]) for s in (0, 0, 1)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def test_invalid_arguments_are_refused():
    with pytest.raises(ValueError, match=r"shape \(V, H, W\), got \(48, 64\)"):
        simulate(TRUTH[0], seed=0, failures=Failures())
    with pytest.raises(ValueError, match="needs the masks of a decoy"):
        simulate(TRUTH, seed=0, failures=Failures(decoy=0.5))
    with pytest.raises(ValueError, match=r"misses must be in \[0, 1\], got 1\.5"):
        Failures(misses=1.5)


@pytest.mark.parametrize("seed", range(4))
def test_decoy_is_a_compact_authentic_region_apart_from_the_object(seed):
    scene = tampered_room(count=4000, views=1, heldout=0)
    means, labels = scene.gaussians.means, scene.labels
    region = decoy_labels(scene.gaussians, labels, seed=seed)
    assert region.dtype == bool
    assert 10 <= region.sum() <= labels.sum()
    assert not (region & labels).any()

    def extent(rows):
        return np.linalg.norm(means[rows] - np.median(means[rows], axis=0), axis=1).max()

    assert extent(region) < 2 * extent(labels)
    middle = np.median(means[labels], axis=0)
    assert np.linalg.norm(means[region] - middle, axis=1).min() > 0.1
    np.testing.assert_array_equal(region, decoy_labels(scene.gaussians, labels, seed=seed))


def test_decoy_needs_an_object_and_room_beside_it():
    scene = tampered_room(count=500, views=1, heldout=0)
    with pytest.raises(ValueError, match="labels mark no Gaussian"):
        decoy_labels(scene.gaussians, np.zeros(500, bool), seed=0)
    with pytest.raises(ValueError, match="no opaque authentic Gaussian"):
        decoy_labels(scene.gaussians, np.ones(500, bool), seed=0)
