"""The two configurations of GS-Checker, and its warning about empty groups."""

import dataclasses

import numpy as np
import pytest
from limits import assert_limits
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


def test_a_score_at_the_threshold_is_not_labelled():
    half = dataclasses.replace(PAPER, threshold=0.5)
    attribute, seen = np.array([4.0, 2.0, 2.5, 9.0], np.float32), np.array([1, 1, 1, 0], bool)
    finding = half._decide(attribute, np.ones((4, 3), int), seen)
    assert finding.tamper.tolist() == [1, 0.5, 0.625, 0]
    assert finding.labels.tolist() == [True, False, True, False]


def test_the_3d_loss_joins_after_half_of_all_steps():
    assert PAPER.for_views(7).loop.contrastive_start == 5 * 7 // 2
    assert OFFICIAL.for_views(7).loop.contrastive_start == 7 // 2


LIMITS = {"epochs": (1, 1000), "seed": (0, 2**32 - 1), "threshold": (0.0, 1.0), "near": (1e-9, 1e9)}


@pytest.mark.parametrize("name", LIMITS)
def test_the_ends_of_a_range_are_valid_and_numbers_beyond_them_are_not(name):
    assert_limits(PAPER, name, *LIMITS[name])


def test_that_nothing_is_labelled_is_a_warning():
    seen, sizes = np.ones(3, bool), np.ones((4, 3), int)
    for attribute, warnings in (([-2.0, -1.0, -1.5], [DISAGREEMENT]), ([2.0, -1.0, 0.0], [])):
        finding = PAPER._decide(np.array(attribute, np.float32), sizes, seen)
        assert finding.warnings == warnings
