"""Roles of classes, from rates and weights written by hand."""

import numpy as np

from gsc_jax.estimators.robust.class_roles import assign_roles, scene_probability

LOW, HIGH = 0.05, 0.95


def roles(*rates, weights=None, **options):
    rates = np.array(rates)
    weights = np.ones_like(rates) if weights is None else np.array(weights, float)
    weights[0] *= 100
    found = assign_roles(rates, weights, **options)
    assert found is not None
    return found


def test_the_heaviest_class_is_authentic_and_the_most_flagged_tampered():
    found = roles([LOW] * 4, [HIGH, HIGH, HIGH, LOW], [LOW, HIGH, LOW, LOW])
    assert found.patterns[0].tolist() == [False] * 4
    assert found.patterns[1].tolist() == [True, True, True, False]
    assert found.tampered.tolist()[:2] == [False, True]
    assert found.rate == 0.75
    assert found.views == 4


def test_views_that_flag_the_authentic_class_are_inverted():
    found = roles([LOW, HIGH, LOW], [HIGH, LOW, HIGH])
    assert found.inverted.tolist() == [False, True, False]
    assert found.patterns[0].tolist() == [False, False, False]
    assert found.patterns[1].tolist() == [True, True, True]
    kept = roles([LOW, HIGH, LOW], [HIGH, LOW, HIGH], inversion=False)
    assert not kept.inverted.any()


def test_a_view_that_hardly_sees_the_authentic_class_is_not_inverted():
    weights = [[1, 0.001, 1], [1, 9, 1]]
    assert not roles([LOW, HIGH, LOW], [HIGH, HIGH, HIGH], weights=weights).inverted.any()


def test_a_class_flagged_in_fewer_views_is_a_distractor():
    often, seldom = [HIGH] * 6, [HIGH, HIGH, HIGH, LOW, LOW, LOW]
    found = roles([LOW] * 6, often, seldom)
    assert found.tampered.tolist() == [False, True, False]
    assert found.patterns[2].tolist() == [True] * 3 + [False] * 3
    assert len(roles([LOW] * 6, often, seldom, distractors=False).tampered) == 2


def test_a_class_with_rates_near_one_half_is_no_distractor():
    assert len(roles([LOW] * 6, [HIGH] * 6, [0.8, 0.7, 0.6, 0.3, 0.25, 0.3]).tampered) == 2


def test_a_class_flagged_nearly_as_often_is_a_second_edit():
    found = roles([LOW] * 12, [HIGH] * 12, [LOW] * 2 + [HIGH] * 10)
    assert found.tampered.tolist() == [False, True, True]


def test_views_that_do_not_see_a_class_do_not_count():
    weights = [[1.0] * 4, [1, 1, 1, 0.0]]
    found = roles([LOW] * 4, [HIGH, HIGH, HIGH, 0.5], weights=weights)
    assert found.rate == 1
    assert found.views == 3


def test_one_class_has_no_roles():
    assert assign_roles(np.full((1, 3), LOW), np.ones((1, 3))) is None
    assert assign_roles(np.full((2, 3), LOW), np.array([[1.0] * 3, [0.0] * 3])) is None


def test_the_scene_probability_grows_with_the_rate_and_the_number_of_views():
    values = [scene_probability(rate, 20) for rate in np.linspace(0, 1, 11)]
    assert values == sorted(values)
    assert 0 < values[0] < 0.01 < 0.98 < values[-1] < 1
    assert 0.5 < scene_probability(1.0, 1) < scene_probability(1.0, 3) < scene_probability(1.0, 20)
    assert 0.5 > scene_probability(0.0, 1) > scene_probability(0.0, 3) > scene_probability(0.0, 20)


def test_a_view_that_flags_one_of_several_authentic_classes_is_not_inverted():
    rates = np.array([[LOW, HIGH], [LOW, LOW], [LOW, LOW], [HIGH, HIGH]])
    weights = np.array([[30.0, 30], [25, 25], [25, 25], [10, 10]])
    found = assign_roles(rates, weights)
    assert found is not None
    assert not found.inverted.any()
