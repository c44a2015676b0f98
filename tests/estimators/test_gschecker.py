"""The two configurations of GS-Checker, and its warning about empty groups."""

import dataclasses

import numpy as np
import pytest
from strategies import blobs, cameras_in_a_row

from gsc_jax import observe
from gsc_jax.estimators import gschecker
from gsc_jax.estimators.gschecker import OFFICIAL, PAPER
from gsc_jax.estimators.protocol import DISAGREEMENT

SCENE = blobs([[x, 0, 3] for x in np.linspace(-1, 1, 9)], opacity=0.95)
CAMERAS = cameras_in_a_row(3, 24, 16, step=0.1)
MASKS = {camera.name: np.tile(np.arange(24) > 15, (16, 1)).astype(float) for camera in CAMERAS}


def test_the_configurations_are_those_of_the_paper_and_of_the_released_code():
    assert (PAPER.epochs, PAPER.loop.per_feature) == (5, False)
    assert (OFFICIAL.epochs, OFFICIAL.shuffle, OFFICIAL.loop.per_feature) == (1, False, True)
    for config in (PAPER, OFFICIAL):
        loop = config.loop
        weights = (loop.lambda1, loop.lambda2, loop.beta, loop.gamma, loop.learning_rate)
        assert weights == (1, 10, 1, 10, 1)


@pytest.mark.parametrize(
    ("sizes", "empty"),
    [
        ([[1, 0, 1], [1, 0, 1], [1, 1, 1]], None),
        ([[1, 1, 1], [1, 0, 1], [0, 0, 1]], "G_m empty"),
        ([[1, 1, 1], [1, 0, 1], [0, 1, 1]], "always one of them empty"),
        ([], None),
    ],
)
def test_groups_that_are_empty_in_every_contrastive_iteration_are_a_warning(sizes, empty):
    found = OFFICIAL._empty_groups(np.array(sizes, int).reshape(-1, 3))
    assert len(found) == (empty is not None)
    assert all(f"({empty})" in warning for warning in found)


@pytest.mark.parametrize(("path", "used"), [("evidence", "fit"), ("rendered", "fit_rendered")])
def test_the_path_selects_how_the_attribute_is_rendered(monkeypatch, path, used):
    called = []
    for name in ("fit", "fit_rendered"):
        original = getattr(gschecker, name)

        def recorded(*args, name=name, original=original, **options):
            called.append(name)
            return original(*args, **options)

        monkeypatch.setattr(gschecker, name, recorded)
    observed = observe(SCENE, CAMERAS, MASKS)
    dataclasses.replace(PAPER.for_views(3), path=path).estimate(observed)
    assert called == [used]


def test_that_nothing_is_labelled_is_a_warning():
    seen, sizes = np.ones(3, bool), np.ones((4, 3), int)
    for attribute, warnings in (([-2.0, -1.0, -1.5], [DISAGREEMENT]), ([2.0, -1.0, 0.0], [])):
        finding = PAPER._decide(np.array(attribute, np.float32), sizes, seen)
        assert finding.warnings == warnings
