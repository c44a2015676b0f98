import importance
import numpy as np
import pandas as pd
from cases import QUICK, load_scene

from gsc_jax.forensics.classifier import combined_log_odds, default_classifier
from gsc_jax.forensics.features import compute_features, in_group


def small_scene():
    gaussians = load_scene(QUICK).gaussians.take(np.arange(2_000))
    return compute_features(gaussians), np.asarray(gaussians.means, np.float32)


def test_only_the_columns_of_the_group_are_shuffled():
    features, _ = small_scene()
    shuffled = importance.shuffled(features, "colour", seed=3)
    values, changed = features.rows(), shuffled.rows()
    colour = in_group(features.names, "colour")
    np.testing.assert_array_equal(changed[:, ~colour], values[:, ~colour])
    np.testing.assert_array_equal(changed[:, colour], values[shuffled.order][:, colour])
    assert (np.sort(shuffled.order) == np.arange(len(values))).all()
    assert not np.array_equal(changed, values)
    np.testing.assert_array_equal(shuffled.rows(slice(100, 300)), changed[100:300])


def test_variants_begin_with_the_log_odds_of_the_package_and_end_with_their_parts():
    features, means = small_scene()
    classifier = default_classifier()
    found = dict(importance.variants(features, means, classifier, seed=0))
    whole = combined_log_odds(features, means, classifier)
    np.testing.assert_array_equal(found[importance.NOTHING], whole)
    parts = found[importance.NO_NOVELTY] + found[importance.NO_NETWORKS]
    np.testing.assert_array_equal(parts, whole)
    assert list(found) == [
        importance.NOTHING,
        *importance.groups_of(features),
        *importance.LEFT_OUT,
    ]


def test_a_part_that_is_left_out_is_not_counted_among_the_groups():
    losses = {"nothing": 0.0, "size": 0.1, "opacity": -0.01, importance.NO_NOVELTY: 0.0}
    rows = [
        {"edit": "removal", "seed": 0, "shuffled": name, "auc": 0.9 - loss, "loss": loss}
        for name, loss in losses.items()
    ]
    text = importance.report(pd.DataFrame(rows))
    assert "1 of 2 groups lose nothing (less than 0.0005 in the mean): opacity." in text
    assert "| nothing |" not in text
    assert text.endswith("AUC of the 1 cases with all features: removal 0.900.")
