"""Classifier: storage."""

import numpy as np
from forensics_cases import room

from gsc_jax.forensics.classifier import (
    as_arrays,
    default_classifier,
    from_arrays,
    smoothed_log_odds,
)
from gsc_jax.forensics.features import compute_features


def test_stored_classifier_gives_the_same_log_odds():
    features, classifier = compute_features(room()), default_classifier()
    again = from_arrays(as_arrays(classifier))
    assert (again.names, again.calibration) == (classifier.names, classifier.calibration)
    assert (again.base, again.scene) == (classifier.base, classifier.scene)
    before, after = (smoothed_log_odds(features, c) for c in (classifier, again))
    np.testing.assert_array_equal(before, after)
