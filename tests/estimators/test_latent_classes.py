"""Latent classes: rates, shares and their number are recovered from samples."""

import numpy as np
import pytest

from gsc_jax.estimators.robust.latent_classes import RATE_FLOOR, fit_classes

RATES = np.array(
    [[0.1, 0.1, 0.1, 0.1, 0.1, 0.1], [0.9, 0.9, 0.1, 0.9, 0.9, 0.9], [0.1, 0.9, 0.9, 0.1, 0.9, 0.1]]
)
SHARES = np.array([0.6, 0.25, 0.15])


def drawn(count: int = 1500, pixels: int = 8, seed: int = 0):
    rng = np.random.default_rng(seed)
    kinds = rng.choice(3, count, p=SHARES)
    seen = rng.random((6, count)) < 0.8
    flagged = rng.binomial(pixels, RATES[kinds].T) * seen
    return kinds, flagged.astype(np.float32), (pixels * seen - flagged).astype(np.float32)


def test_rates_and_shares_are_recovered_and_responsibilities_separate_the_classes():
    kinds, flagged, clear = drawn()
    fit = fit_classes(flagged, clear, counts=(3,), restarts=4)
    order = np.argsort(-np.asarray(fit.classes.shares[0]))
    np.testing.assert_allclose(np.asarray(fit.classes.rates[0])[order], RATES, atol=0.03)
    np.testing.assert_allclose(np.asarray(fit.classes.shares[0])[order], SHARES, atol=0.03)
    responsibilities = np.asarray(fit.responsibilities[0])
    np.testing.assert_allclose(responsibilities.sum(axis=0), 1, atol=1e-5)
    assert np.mean(np.argmax(responsibilities[order], axis=0) == kinds) > 0.98


def test_the_criterion_chooses_the_number_of_classes():
    _, flagged, clear = drawn()
    fit = fit_classes(flagged, clear, counts=(2, 3, 6), restarts=3)
    assert np.sum(np.asarray(fit.classes.shares[0]) > 0) == 3
    assert np.asarray(fit.criterion).shape == np.asarray(fit.iterations).shape == (9,)


def test_all_starts_are_returned_the_best_first():
    _, flagged, clear = drawn()
    fit = fit_classes(flagged, clear, counts=(2, 6), restarts=3)
    assert fit.classes.rates.shape == (6, 6, 6)
    assert fit.responsibilities.shape == (6, 6, 1500)
    assert (np.diff(fit.criterion) <= 0).all()
    used = np.sum(np.asarray(fit.classes.shares) > 0, axis=1)
    assert sorted(used.tolist()) == [2, 2, 2, 6, 6, 6]
    assert used[-1] == 2  # two classes cannot fit three as well as six do
    for shares, responsibilities in zip(fit.classes.shares, fit.responsibilities, strict=True):
        np.testing.assert_allclose(np.mean(responsibilities, axis=1), shares, atol=0.01)


def test_the_criterion_of_one_class_is_that_of_schwarz():
    _, flagged, clear = drawn()
    flagged[2] = clear[2] = 0  # a view that shows nothing has no parameter
    pixels = (flagged + clear).sum(axis=1)
    rates = (flagged.sum(axis=1) + 0.5) / (pixels + 1)
    likelihood = flagged.sum(axis=1) @ np.log(rates) + clear.sum(axis=1) @ np.log1p(-rates)
    expected = likelihood - 0.5 * (5 + 1) * np.log(1500)
    criterion = fit_classes(flagged, clear, counts=(1,), restarts=1).criterion
    np.testing.assert_allclose(criterion, [expected], rtol=0, atol=1.0)


def test_the_criterion_of_overlapping_classes_is_that_of_schwarz():
    _, flagged, clear = drawn(pixels=1)  # so that no Gaussian belongs to one class for sure
    fit = fit_classes(flagged, clear, counts=(2,), restarts=1)
    rates = np.asarray(fit.classes.rates[0], np.float64)
    joint = np.log(np.asarray(fit.classes.shares[0], np.float64))[:, None]
    joint = joint + np.log(rates) @ flagged + np.log1p(-rates) @ clear
    likelihood = np.logaddexp(*joint).sum()
    assert likelihood > joint.max(axis=0).sum() + 50
    # The likelihood is that of the last step but one, below by less than 1e-4 per Gaussian.
    expected = likelihood - 0.5 * 2 * (6 + 1) * np.log(1500)
    np.testing.assert_allclose(fit.criterion, [expected], rtol=0, atol=1.0)


def test_rates_are_bounded_and_unseen_gaussians_follow_the_shares():
    flagged, clear = np.zeros((6, 1500), np.float32), np.zeros((6, 1500), np.float32)
    flagged[:, :10] = 1e6
    fit = fit_classes(flagged, clear, counts=(2,))
    rates = np.asarray(fit.classes.rates)
    assert RATE_FLOOR <= rates.min() <= rates.max() <= 1 - RATE_FLOOR
    responsibilities = np.asarray(fit.responsibilities)
    np.testing.assert_allclose(responsibilities[..., -1], fit.classes.shares, atol=1e-6)


def test_the_fit_is_deterministic_for_a_seed():
    _, flagged, clear = drawn()
    one, again, other = (fit_classes(flagged, clear, counts=(3,), seed=s) for s in (0, 0, 1))
    assert np.array_equal(one.classes.rates, again.classes.rates)
    assert not np.array_equal(one.criterion, other.criterion)


@pytest.mark.parametrize(
    "wrong", [{"counts": ()}, {"counts": (0,)}, {"counts": (2,), "restarts": 0}]
)
def test_no_candidates_and_no_gaussians_are_errors(wrong):
    _, flagged, clear = drawn()
    with pytest.raises(ValueError, match="numbers of classes"):
        fit_classes(flagged, clear, **wrong)
    with pytest.raises(ValueError, match="at least one Gaussian"):
        fit_classes(flagged[:, :0], clear[:, :0], counts=(2,))


def test_four_starts_with_the_seed_0_are_the_default():
    _, flagged, clear = drawn()
    default = fit_classes(flagged, clear, counts=(3,))
    explicit = fit_classes(flagged, clear, counts=(3,), restarts=8, seed=0)
    assert np.array_equal(default.criterion, explicit.criterion)


def test_em_stops_when_it_no_longer_improves_and_after_100_iterations():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 9, (6, 300)).astype(np.float32)
    slow = fit_classes(noise, 8 - noise, counts=(8,), restarts=4)
    _, flagged, clear = drawn()
    fast = fit_classes(flagged, clear, counts=(3,), restarts=4)
    assert np.max(slow.iterations) <= 100
    assert np.max(fast.iterations) < 50
    assert np.min(fast.iterations) > 2
