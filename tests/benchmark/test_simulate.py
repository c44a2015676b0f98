import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.benchmark.simulate import (
    PROFILES,
    REGIMES,
    STRENGTHS,
    Failures,
    calibrated,
    decoy_labels,
    simulate,
)

VIEWS = 20


def discs(row, column, *, views=VIEWS, height=48, width=64, radius=7):
    y, x = np.indices((height, width))
    return np.repeat([np.hypot(y - row, x - column) < radius], views, axis=0)


TRUTH, DECOY = discs(16, 16), discs(30, 48)


def flagged(failures, *, truth=TRUTH, seed=0):
    return simulate(truth, DECOY, seed=seed, failures=failures) > 0.5


masks = arrays(bool, array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=9))


@given(masks, st.sampled_from([0.0, 1.5, 20.0]))
@settings(max_examples=50, deadline=None)
def test_without_failures_the_detector_says_the_truth(truth, softness):
    said = simulate(truth, seed=0, failures=Failures(softness=softness))
    assert said.shape == truth.shape
    np.testing.assert_array_equal(said > 0.5, truth)


@given(masks, st.sampled_from([*REGIMES.values(), *PROFILES.values()]), st.integers(0, 5))
@settings(max_examples=50, deadline=None)
def test_every_detector_gives_probabilities(truth, failures, seed):
    said = simulate(truth, np.roll(truth, 1, axis=2), seed=seed, failures=failures)
    assert said.dtype == np.float32
    assert np.isfinite(said).all()
    assert said.min() >= 0
    assert said.max() <= 1


def test_regimes_are_the_reported_ones():
    names = ["clean", "boundary", "misses", "blobs", "consistent", "inverted", "mixture"]
    assert list(REGIMES) == names
    assert REGIMES["clean"] == Failures()
    for name in names[1:-1]:
        default = dataclasses.asdict(Failures())
        changed = [k for k, v in dataclasses.asdict(REGIMES[name]).items() if v != default[k]]
        assert len(changed) == 1, f"{name} mixes failures"


def test_misses_are_a_share_of_the_views_that_show_the_object():
    truth = TRUTH.copy()
    truth[::2] = False
    found = np.any(flagged(Failures(misses=0.4), truth=truth), axis=(1, 2))
    assert found.sum() == 6
    assert not found[::2].any()


def test_decoy_is_flagged_in_its_share_of_the_views_and_nothing_else():
    said = flagged(Failures(decoy=0.6))
    whole = (said | ~DECOY).all(axis=(1, 2))
    assert whole.sum() == 12
    np.testing.assert_array_equal(said[whole], (TRUTH | DECOY)[whole])
    np.testing.assert_array_equal(said[~whole], TRUTH[~whole])


def test_inverted_views_are_the_complement():
    said = flagged(Failures(inverted=0.25))
    inverted = (said == ~TRUTH).all(axis=(1, 2))
    assert inverted.sum() == 5
    np.testing.assert_array_equal(said[~inverted], TRUTH[~inverted])


def test_blobs_are_false_positives_that_differ_between_views():
    extra = flagged(Failures(blobs=2.0, blob_size=0.03)) & ~TRUTH
    assert extra.any(axis=(1, 2)).mean() > 0.6
    assert 0.002 < extra.mean() < 0.1
    assert len({view.tobytes() for view in extra}) > 0.6 * VIEWS
    np.testing.assert_array_equal(flagged(Failures(blobs=2.0)) & TRUTH, TRUTH)


def test_larger_blobs_cover_more():
    small, large = (
        (flagged(Failures(blobs=2.0, blob_size=s)) & ~TRUTH).mean() for s in (0.02, 0.08)
    )
    assert large > 3 * small


def test_boundary_moves_edges_by_about_its_pixels():
    y, _ = np.indices((128, 128))
    truth = np.repeat([y < 64], 8, axis=0)
    edges = flagged_rows(truth, boundary=3.0)
    assert edges.std() == pytest.approx(3.0, rel=0.4)
    assert edges.mean() == pytest.approx(64, abs=1.5)
    assert flagged_rows(truth, boundary=0.0).std() == 0


def flagged_rows(truth, *, boundary):
    said = simulate(truth, seed=0, failures=Failures(boundary=boundary)) > 0.5
    return said.sum(axis=1)


def test_softness_widens_the_uncertain_band():
    bands = [
        np.mean(np.abs(simulate(TRUTH, seed=0, failures=Failures(softness=s)) - 0.5) < 0.4)
        for s in (0.0, 1.0, 4.0)
    ]
    assert bands[0] == 0
    assert bands[0] < bands[1] < bands[2]


def test_same_seed_same_masks_other_seed_other_masks():
    one, same, other = (
        simulate(TRUTH, DECOY, seed=s, failures=REGIMES["mixture"]) for s in (0, 0, 1)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def test_no_view_and_no_tampering_are_legal():
    assert simulate(TRUTH[:0], DECOY[:0], seed=0, failures=REGIMES["mixture"]).shape == (0, 48, 64)
    nothing = np.zeros_like(TRUTH)
    assert not flagged(Failures(misses=0.5, boundary=4.0), truth=nothing).any()


def test_inputs_are_not_changed():
    truth, decoy = TRUTH.copy(), DECOY.copy()
    simulate(truth, decoy, seed=0, failures=REGIMES["mixture"])
    np.testing.assert_array_equal(truth, TRUTH)
    np.testing.assert_array_equal(decoy, DECOY)


def test_bad_arguments_say_what_was_expected():
    with pytest.raises(ValueError, match=r"shape \(V, H, W\), got \(48, 64\)"):
        simulate(TRUTH[0], seed=0, failures=Failures())
    with pytest.raises(ValueError, match="needs the masks of a decoy"):
        simulate(TRUTH, seed=0, failures=Failures(decoy=0.5))
    with pytest.raises(ValueError, match="decoy has shape"):
        simulate(TRUTH, DECOY[:3], seed=0, failures=Failures(decoy=0.5))
    with pytest.raises(ValueError, match=r"misses is a share of the views, got 1\.5"):
        Failures(misses=1.5)
    with pytest.raises(ValueError, match="boundary must not be negative"):
        Failures(boundary=-1)


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


shares, amounts = st.floats(0, 1), st.floats(0, 20)
any_failures = st.builds(
    Failures,
    boundary=amounts,
    misses=shares,
    blobs=amounts,
    blob_size=amounts,
    decoy=shares,
    inverted=shares,
    softness=amounts,
)


@given(any_failures)
def test_strength_1_is_the_detector_itself_and_0_a_perfect_one(failures):
    assert failures.scaled(1.0) == failures
    perfect = Failures(softness=failures.softness, blob_size=failures.blob_size)
    assert failures.scaled(0.0) == perfect
    np.testing.assert_array_equal(flagged(failures.scaled(0.0)), TRUTH)


@given(any_failures, st.floats(0, 5), st.floats(0, 5))
def test_a_stronger_detector_fails_no_less_and_shares_stay_shares(failures, one, other):
    weak, strong = (dataclasses.astuple(failures.scaled(s)) for s in sorted([one, other]))
    assert all(a <= b for a, b in zip(weak, strong, strict=True))


@given(any_failures, st.floats(0, 1), st.floats(0, 1))
def test_weakening_twice_is_weakening_by_the_product(failures, one, other):
    twice, once = failures.scaled(one).scaled(other), failures.scaled(one * other)
    assert dataclasses.astuple(twice) == pytest.approx(dataclasses.astuple(once))


def test_scaling_multiplies_and_clips_shares_only():
    failures = Failures(
        boundary=3, misses=0.25, blobs=0.5, blob_size=0.1, decoy=0.5, inverted=0.1, softness=2
    )
    assert failures.scaled(4.0) == Failures(
        boundary=12, misses=1, blobs=2, blob_size=0.1, decoy=1, inverted=0.4, softness=2
    )
    for strength in (-0.1, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="strength must be a number of at least 0"):
            failures.scaled(strength)


def fitted(scores, **options):
    """The strength that `calibrated` settles on, and those it asked for, in order."""
    asked = []

    def score(failures):
        asked.append(failures.boundary)
        return scores[failures.boundary]

    found = calibrated(Failures(boundary=1.0), score, strengths=sorted(scores), **options)
    return found.boundary, asked


def test_calibration_keeps_a_detector_that_fits_already():
    assert fitted({0.5: 0.3, 1.0: 0.4, 2.0: 0.2}) == (1.0, [1.0])
    assert fitted({0.5: 0.3, 1.0: 0.1, 2.0: 0.2}) == (1.0, [1.0])


def test_calibration_takes_the_nearest_strength_that_fits():
    assert fitted({0.25: 0.5, 0.5: 0.45, 1.0: 0.41, 2.0: 0.38, 4.0: 0.2})[0] == 2.0
    assert fitted({0.25: 0.3, 0.5: 0.05, 1.0: 0.04, 2.0: 0.03, 4.0: 0.02})[0] == 0.25
    assert fitted({0.6: 0.9, 1.0: 0.9, 1.5: 0.3, 0.5: 0.3})[0] == 1.5, "nearest as a ratio"


def test_calibration_prefers_the_weaker_of_two_equally_near():
    for strength in (2.0, 4.0, 10.0, 1.4):
        assert fitted({1 / strength: 0.2, 1.0: 0.9, strength: 0.2})[0] == 1 / strength


def test_calibration_comes_as_near_as_it_can_where_nothing_fits():
    assert fitted({0.5: 0.9, 1.0: 0.7, 2.0: 0.55}) == (2.0, [1.0, 0.5, 2.0])
    assert fitted({0.5: 0.09, 1.0: 0.05, 2.0: 0.0})[0] == 0.5
    assert fitted({0.5: 0.08, 1.0: 0.9, 2.0: 0.45})[0] == 0.5
    assert fitted({0.5: 0.7, 1.0: 0.7, 2.0: 0.7})[0] == 1.0


def test_calibration_heeds_its_bounds_and_scales_everything():
    scores = {0.5: 0.3, 1.0: 0.2, 2.0: 0.05}
    assert fitted(scores, low=0.25, high=0.35)[0] == 0.5
    assert fitted(scores, low=0.0, high=0.1)[0] == 2.0
    assert 1.0 in STRENGTHS
    mixture = REGIMES["mixture"]
    found = calibrated(mixture, lambda f: 0.9 if f.misses < 0.4 else 0.2)
    assert found == mixture.scaled(2.0)


def test_calibration_refuses_what_it_cannot_use():
    with pytest.raises(ValueError, match="strengths above 0"):
        calibrated(Failures(), lambda _: 0.2, strengths=(0.0, 1.0))
    with pytest.raises(ValueError, match="strengths above 0"):
        calibrated(Failures(), lambda _: 0.2, strengths=())
    with pytest.raises(ValueError, match="low <= high"):
        calibrated(Failures(), lambda _: 0.2, low=0.5)
    with pytest.raises(ValueError, match=r"strength 1\.0 is NaN"):
        calibrated(Failures(), lambda _: float("nan"))


def test_profiles_behave_as_they_are_called():
    assert len(PROFILES) == 4
    # Larger than the discs above, so that coarse edges do not swallow the object.
    truth, decoy = (
        discs(64, 50, height=128, width=192, radius=24),
        discs(64, 150, height=128, width=192, radius=20),
    )
    said = {name: simulate(truth, decoy, seed=0, failures=f) for name, f in PROFILES.items()}
    flags = {name: views > 0.5 for name, views in said.items()}
    share = {name: views.mean() for name, views in flags.items()}

    assert (flags["picks the wrong side"].mean(axis=(1, 2)) > 0.5).sum() == 8
    assert share["shy"] < 0.6 * truth.mean() < 2 * truth.mean() < share["over-eager"]
    assert (flags["over-eager"] & decoy).any(axis=(1, 2)).sum() >= 16
    assert (~flags["shy"].any(axis=(1, 2))).sum() == 13
    unsure = {name: np.mean(np.abs(views - 0.5) < 0.4) for name, views in said.items()}
    assert max(unsure, key=unsure.__getitem__) == "coarse patches"
    assert min(unsure, key=unsure.__getitem__) == "picks the wrong side"
