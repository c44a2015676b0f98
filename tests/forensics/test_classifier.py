"""Classifier: storage and smoothing."""

import numpy as np
from forensics_cases import room

from gsc_jax.forensics.classifier import (
    as_arrays,
    default_classifier,
    from_arrays,
    smooth,
    smoothed_log_odds,
)
from gsc_jax.forensics.features import compute_features

FEATURES = compute_features(room())


def test_stored_classifier_gives_the_same_log_odds():
    classifier = default_classifier()
    again = from_arrays(as_arrays(classifier))
    assert (again.names, again.calibration) == (classifier.names, classifier.calibration)
    assert (again.base, again.scene) == (classifier.base, classifier.scene)
    np.testing.assert_array_equal(
        smoothed_log_odds(FEATURES, classifier), smoothed_log_odds(FEATURES, again)
    )


def test_smoothing_keeps_constants():
    constant = np.full(len(room()), 2.0, np.float32)
    np.testing.assert_allclose(smooth(constant, FEATURES.neighbourhoods), 2, atol=1e-5)
