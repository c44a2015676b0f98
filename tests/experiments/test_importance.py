import dataclasses

import importance
import numpy as np
import pandas as pd
import pytest
from cases import QUICK, load_scene
from learned_cases import examples

from gsc_jax.forensics.features import compute_features, in_group
from gsc_jax.scene import InputError


def test_columns_of_a_group_are_0_and_all_others_stay():
    features = compute_features(load_scene(QUICK).gaussians.take(np.arange(2_000)))
    own = {field.name: getattr(features, field.name) for field in dataclasses.fields(features)}
    reduced = importance.ReducedFeatures(**own, without=("colour", "copies"))
    before, after = (np.concatenate(list(some.own()), axis=1) for some in (features, reduced))
    names = features.names[: before.shape[1]]
    gone = in_group(names, "colour") | in_group(names, "copies")
    assert (after[:, gone] == 0).all()
    np.testing.assert_array_equal(after[:, ~gone], before[:, ~gone])
    np.testing.assert_array_equal(reduced.rows(), features.rows())


def test_networks_are_trained_without_the_columns_and_the_source(monkeypatch):
    seen = []
    monkeypatch.setattr(importance, "train_network", lambda own, seed: seen.append(own) or (seed,))
    names = ("size.0.own", "colour.0.own", "size.0.mean")
    cases = [dataclasses.replace(examples(host, 0), names=names) for host in ("a", "b", "b-0-mcmc")]
    classifier = importance.trained_without(cases, "a", ("size",))
    assert classifier.names == ("colour.0.own",)
    assert len(classifier.networks) == importance.MEMBERS
    for own in seen:
        assert [one.host for one in own] == ["b", "b-0-mcmc"]
        for one, case in zip(own, cases[1:], strict=True):
            np.testing.assert_array_equal(one.values, case.values[:, 1:2])


def test_groups_are_left_out_alone_and_together():
    names = ("size.0.own", "colour.0.own", "colour.1.own")
    assert importance.choices(names, ("size", "colour")) == {
        importance.NOTHING: (),
        "size": ("size",),
        "colour": ("colour",),
        "size + colour": ("size", "colour"),
    }
    with pytest.raises(InputError, match="'colours': expected some of size, colour"):
        importance.choices(names, ("colours",))


def test_a_part_that_is_left_out_is_not_counted_among_the_groups():
    losses = {"nothing": [0.0, 0.0], importance.NO_NOVELTY: [0.0, 0.0]}
    losses |= {"size": [0.1, 0.12], "opacity": [-0.01, 0.03]}
    rows = [
        {"edit": "removal", "seed": 0, "left_out": name, "auc": 0.9 - loss, "loss": loss}
        for name, pair in losses.items()
        for loss in pair
    ]
    text = importance.report(pd.DataFrame(rows))
    assert "1 of 2 choices lose less than 2 standard errors of the mean" in text
    assert "over all cases: opacity." in text
    assert "| size | 0.110 | 0.110 | 0.010 |" in text
    assert "| nothing |" not in text
    assert text.index("| opacity |") < text.index("| novelty |")
    assert text.endswith("AUC of the 2 cases with all features: removal 0.900.")
