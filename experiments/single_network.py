"""AUC of a case by one network instead of the ensemble, with novelty and discriminant."""

import dataclasses
from collections.abc import Callable

import numpy as np
from bank import BankCase

from gsc_jax.benchmark.metrics import auc
from gsc_jax.forensics.classifier import (
    Layers,
    default_classifier,
    smoothed_log_odds,
    with_places,
)
from gsc_jax.forensics.features import compute_features, with_finite_scales
from gsc_jax.forensics.novelty import novelty
from gsc_jax.forensics.places import find_places


def scorer(case: BankCase) -> Callable[[Layers | None], float]:
    """Function from a network, or None for none at all, to the AUC per Gaussian of a case.

    The weight of novelty is that of the package.
    """
    features = compute_features(with_finite_scales(case.gaussians))
    classifier = default_classifier()
    places = find_places(features, np.asarray(case.gaussians.means, np.float32))
    novel = classifier.novelty * novelty(places)

    def score(layers: Layers | None) -> float:
        networks = np.zeros(len(case.labels))
        if layers is not None:
            one = dataclasses.replace(classifier, networks=(layers,))
            networks = smoothed_log_odds(features, one)
        return auc(with_places(networks, places, novel), case.labels)

    return score
