from pathlib import Path

import numpy as np
import pytest
from detector_strengths import PROFILES, PUBLISHED, calibrated, scaled
from hypothesis import given
from hypothesis import strategies as st
from published_fit import RANGES, distances
from tables import read_csv, where

from gsc_jax.benchmark.simulate import Failures, simulate

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


def test_the_published_failures_are_the_best_draws_of_the_search():
    rows = read_csv(Path(__file__).parents[2] / "docs" / "published_fit.csv")
    for edit, failures in PUBLISHED.items():
        best = distances(where(rows, edit=edit)).iloc[0]
        assert {name: getattr(failures, name) for name in RANGES} == dict(best[list(RANGES)])


@given(any_failures)
def test_strength_1_changes_nothing_and_strength_0_removes_all_failures(failures):
    assert scaled(failures, 1.0) == failures
    perfect = Failures(softness=failures.softness, blob_size=failures.blob_size)
    assert scaled(failures, 0.0) == perfect


def test_scaling_multiplies_and_clips_shares_only():
    failures = Failures(
        boundary=3, misses=0.25, blobs=0.5, blob_size=0.1, decoy=0.5, inverted=0.1, softness=2
    )
    assert scaled(failures, 4.0) == Failures(
        boundary=12, misses=1, blobs=2, blob_size=0.1, decoy=1, inverted=0.4, softness=2
    )
    for strength in (-0.1, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="strength must be a number of at least 0"):
            scaled(failures, strength)


def fitted(scores, **options):
    """The strength that `calibrated` returns, and those that it tried, in order."""
    tried = []

    def score(failures):
        tried.append(failures.boundary)
        return scores[failures.boundary]

    found = calibrated(Failures(boundary=1.0), score, strengths=sorted(scores), **options)
    return found.boundary, tried


def test_strength_1_is_kept_if_its_score_is_in_the_range():
    assert fitted({0.5: 0.3, 1.0: 0.4, 2.0: 0.2}) == (1.0, [1.0])
    assert fitted({0.5: 0.3, 1.0: 0.1, 2.0: 0.2}) == (1.0, [1.0])


def test_the_nearest_strength_in_the_range_is_taken():
    assert fitted({0.25: 0.5, 0.5: 0.45, 1.0: 0.41, 2.0: 0.38, 4.0: 0.2})[0] == 2.0
    assert fitted({0.25: 0.3, 0.5: 0.05, 1.0: 0.04, 2.0: 0.03, 4.0: 0.02})[0] == 0.25
    assert fitted({0.6: 0.9, 1.0: 0.9, 1.5: 0.3, 0.5: 0.3})[0] == 1.5, "nearest as a ratio"


def test_the_nearest_score_is_taken_if_none_is_in_the_range():
    assert fitted({0.5: 0.9, 1.0: 0.7, 2.0: 0.55}) == (2.0, [1.0, 0.5, 2.0])
    assert fitted({0.5: 0.09, 1.0: 0.05, 2.0: 0.0})[0] == 0.5
    assert fitted({0.5: 0.08, 1.0: 0.9, 2.0: 0.45})[0] == 0.5
    assert fitted({0.5: 0.7, 1.0: 0.7, 2.0: 0.7})[0] == 1.0


def test_profiles_fail_as_their_names_say():
    # Large discs, so that coarse edges do not remove the object.
    y, x = np.indices((128, 192))
    truth = np.repeat([np.hypot(y - 64, x - 50) < 24], 20, axis=0)
    decoy = np.repeat([np.hypot(y - 64, x - 150) < 20], 20, axis=0)
    maps = {name: simulate(truth, decoy, seed=0, failures=f) for name, f in PROFILES.items()}
    masks = {name: views > 0.5 for name, views in maps.items()}
    share = {name: views.mean() for name, views in masks.items()}
    assert (masks["picks the wrong side"].mean(axis=(1, 2)) > 0.5).sum() == 8
    assert share["shy"] < 0.6 * truth.mean() < 2 * truth.mean() < share["over-eager"]
    assert (masks["over-eager"] & decoy).any(axis=(1, 2)).sum() >= 16
    assert (~masks["shy"].any(axis=(1, 2))).sum() == 13
    unsure = {name: np.mean(np.abs(views - 0.5) < 0.4) for name, views in maps.items()}
    assert max(unsure, key=unsure.__getitem__) == "coarse patches"
    assert min(unsure, key=unsure.__getitem__) == "picks the wrong side"
