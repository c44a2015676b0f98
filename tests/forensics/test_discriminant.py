"""A discriminant extends a first guess of half of an edit to the whole edit."""

import dataclasses

import numpy as np
import pytest

from gsc_jax.benchmark.metrics import auc
from gsc_jax.benchmark.scenes import make_room
from gsc_jax.forensics.classifier import with_places
from gsc_jax.forensics.discriminant import MAX_DISCRIMINANT, discriminant
from gsc_jax.forensics.features import compute_features
from gsc_jax.forensics.places import Places, find_places
from gsc_jax.scene import Gaussians

ROOM = make_room(count=12_000, seed=5)


def places_of(gaussians: Gaussians) -> Places:
    return find_places(compute_features(gaussians), np.asarray(gaussians.means, np.float32))


@pytest.fixture(scope="module")
def edited() -> tuple[Places, np.ndarray]:
    """A room in which the Gaussians of one region were made smaller, and their mask."""
    means = np.asarray(ROOM.means)
    apart = np.linalg.norm(means - means[0], axis=1)
    part = apart < np.sort(apart)[1_000]
    log_scales = np.asarray(ROOM.log_scales) - part[:, None]
    return places_of(dataclasses.replace(ROOM, log_scales=log_scales.astype(np.float32))), part


def test_guess_of_half_of_a_part_is_extended_to_the_rest(edited):
    places, part = edited
    rows = np.flatnonzero(part)
    guess = np.full(len(part), -4.0, np.float32)
    guess[rows[: len(rows) // 2]] = 2
    rest = np.ones(len(part), bool)
    rest[rows[: len(rows) // 2]] = False
    combined = with_places(guess, places, 0.0)
    assert auc(combined[rest], part[rest]) > 0.9, "0.5 by the guess alone"
    assert np.median(combined[part]) > np.quantile(combined[~part], 0.95)


def test_factor_and_shift_of_a_sharp_guess_hardly_matter(edited):
    places, part = edited
    guess = places.averaged(np.where(part, 3.0, -4.0))
    scores = discriminant(places, guess)
    np.testing.assert_allclose(discriminant(places, guess + 10), scores, atol=1e-6)
    assert np.corrcoef(discriminant(places, 2 * guess), scores)[0, 1] > 0.99


@pytest.mark.parametrize("guess", [np.zeros, np.ones])
def test_equal_guesses_and_equal_places_have_finite_scores(edited, guess):
    places, _ = edited
    same = places_of(
        dataclasses.replace(
            ROOM.take(np.zeros(2_000, int)),
            means=np.random.default_rng(2).normal(size=(2_000, 3)).astype(np.float32),
        )
    )
    for some in (places, same):
        scores = discriminant(some, guess(len(some.starts)))
        assert np.abs(scores).max() <= MAX_DISCRIMINANT
        assert np.isfinite(scores).all()


def test_values_of_places_are_those_of_their_gaussians(edited):
    places, part = edited
    values = np.random.default_rng(0).normal(size=len(places.starts))
    out = places.spread_out(values)
    assert out.shape == part.shape
    np.testing.assert_allclose(places.averaged(out), values, atol=1e-5)
    np.testing.assert_allclose(places.averaged(np.asarray(ROOM.means)), places.centers, atol=1e-5)
