"""Roles of classes, from rates and weights written by hand."""

import numpy as np
import pytest
from scipy.special import expit

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
    assert found.seen[1] == 4


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
    for rates in ([0.8, 0.7, 0.6, 0.3, 0.25, 0.3], [0.8, 0.8, 0.8, 0.8, 0.3, 0.3]):
        assert len(roles([LOW] * 6, [HIGH] * 6, rates).tampered) == 2
    assert len(roles([LOW] * 6, [HIGH] * 6, [HIGH] * 4 + [LOW] * 2).tampered) == 3


def test_a_class_flagged_nearly_as_often_is_a_second_edit():
    found = roles([LOW] * 12, [HIGH] * 12, [LOW] * 2 + [HIGH] * 10)
    assert found.tampered.tolist() == [False, True, True]


@pytest.mark.parametrize(("views", "edits"), [((10, 9), 1), ((12, 11), 2)])
def test_a_second_edit_is_not_flagged_in_few_views(views, edits):
    """In the shared kitchen, 44 % of the views flag the edit, and 38 % an authentic region."""
    first, second = ([LOW] * (24 - count) + [HIGH] * count for count in views)
    found = roles([LOW] * 24, first, second[::-1])
    assert found.tampered.tolist() == [False, True, edits == 2]


def test_views_that_do_not_see_a_class_do_not_count():
    weights = [[1.0] * 4, [1, 1, 1, 0.0]]
    found = roles([LOW] * 4, [HIGH, HIGH, HIGH, 0.5], weights=weights)
    assert found.rate == 1
    assert found.seen[1] == 3


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


def test_a_rate_of_exactly_one_half_is_not_flagged():
    found = roles([LOW] * 4, [HIGH, HIGH, HIGH, 0.5])
    assert found.rate == 0.75
    assert found.patterns[1].tolist() == [True, True, True, False]
    assert not roles([0.5] * 4, [HIGH] * 4).inverted.any()
    often = roles([LOW] * 4, [HIGH, HIGH, HIGH, LOW], [HIGH, HIGH, 0.5, 0.5])
    assert often.rate == 0.75
    masses = np.array([40, 40, 60.0])[:, None] * np.ones(4)
    halves = assign_roles(np.array([[LOW] * 4, [0.5] * 4, [HIGH] * 4]), masses)
    assert halves is not None
    assert not halves.inverted.any(), "two classes that are not flagged weigh more than one that is"


def test_two_light_classes_of_one_pattern_outweigh_a_heavier_one():
    masses = np.array([30, 25, 40.0])[:, None] * np.ones(3)
    found = assign_roles(np.array([[LOW] * 3, [LOW] * 3, [HIGH] * 3]), masses)
    assert found is not None
    assert found.rate == 1
    assert not found.inverted.any()


def test_the_unit_of_the_weights_does_not_matter():
    rates, weights = (
        np.array([[LOW] * 4, [HIGH] * 3 + [LOW]]),
        np.array([[9.0] * 4, [1, 1, 1, 0.1]]),
    )
    for unit in (1e-12, 1e12):
        found, expected = (assign_roles(rates, w) for w in (unit * weights, weights))
        assert found is not None
        assert expected is not None
        assert found.seen == pytest.approx(expected.seen)
        assert found.rate == pytest.approx(expected.rate)


def test_a_class_that_no_view_sees_has_no_role():
    weights = [[1] * 4, [1] * 4, [0] * 4]
    found = roles([LOW] * 4, [HIGH] * 4, [HIGH, HIGH, LOW, LOW], weights=weights)
    assert found.tampered.tolist() == [False, True]


@pytest.mark.parametrize("rate", [0.1, 0.5])
def test_the_tampered_class_is_another_than_the_authentic_one_even_if_nothing_is_flagged(rate):
    found = roles([LOW] * 3, [rate] * 3, weights=[[1] * 3, [1, 1, 0]])
    assert (found.rate, found.seen[1]) == (0, 2)


def test_classes_that_fewer_than_two_views_separate_are_one_object():
    assert len(roles([LOW] * 6, [HIGH] * 6, [HIGH] * 6).tampered) == 2
    assert len(roles([LOW] * 6, [HIGH] * 6, [HIGH] * 5 + [LOW]).tampered) == 2
    assert len(roles([LOW] * 6, [HIGH] * 6, [LOW] * 6).tampered) == 2
    for weight, count in ((0.05, 2), (0.1, 3)):  # a view that sees a tenth counts one half
        weights = np.ones((3, 6))
        weights[2, 5] = weight
        assert (
            len(roles([LOW] * 6, [HIGH] * 6, [HIGH] * 4 + [LOW] * 2, weights=weights).tampered)
            == count
        )


def test_rates_that_differ_by_six_tenths_do_not_separate_classes():
    for rate, count in ((0.4, 2), (0.35, 3)):
        found = roles([LOW] * 8, [1.0] * 8, [1.0] * 6 + [rate] * 2)
        assert len(found.tampered) == count


def test_a_class_flagged_in_one_view_is_a_distractor_but_not_one_like_the_authentic_class():
    once = [HIGH] + [LOW] * 5
    assert roles([LOW] * 6, [HIGH] * 6, once).patterns[2].tolist() == [True] + [False] * 5


def test_a_view_that_does_not_see_a_distractor_has_the_pattern_of_the_authentic_class():
    weights = np.ones((3, 6))
    weights[2, 0] = 0.01
    found = roles([LOW] * 6, [HIGH] * 6, [HIGH, HIGH] + [LOW] * 4, weights=weights)
    assert found.patterns[2].tolist() == [False, True] + [False] * 4


def test_of_classes_flagged_about_as_often_the_heaviest_is_tampered():
    often, seldom = [HIGH] * 12, [HIGH] * 11 + [LOW]
    weights = np.ones((3, 12)) * [[1], [1], [5]]
    assert roles([LOW] * 12, often, seldom, weights=weights).rate == pytest.approx(11 / 12)
    seldom = [HIGH] * 3 + [LOW] * 9
    assert roles([LOW] * 12, often, seldom, weights=weights).rate == 1


def test_a_view_that_sees_a_fifth_of_the_authentic_class_may_be_inverted():
    for share, inverted in ((0.2, True), (0.19, False)):
        weights = [[1, 1, share], [1, 1, 0]]
        found = roles([LOW, LOW, HIGH], [HIGH, HIGH, LOW], weights=weights)
        assert found.inverted.tolist() == [False, False, inverted]


def test_a_part_of_the_edit_that_is_covered_where_it_is_not_flagged_is_no_other_object():
    for flagged, covered in ((4, 5), (8, 1)):
        rates = [HIGH] * flagged + [LOW] * (12 - flagged)
        weights = [1] * flagged + [0.1] * (12 - flagged - covered) + [0] * covered
        found = roles([LOW] * 12, [HIGH] * 12, rates, weights=[[1] * 12, [1] * 12, weights])
        assert found.tampered.tolist() == [False, True]


def test_views_that_separate_fifteen_percent_of_what_two_classes_show_make_them_two_objects():
    for share, count in ((0.18, 3), (0.17, 2)):
        rates, weights = [HIGH] * 4 + [LOW] * 4, [1] * 4 + [share] * 4
        found = roles([LOW] * 8, [HIGH] * 8, rates, weights=[[1] * 8, [1] * 8, weights])
        assert len(found.tampered) == count


def test_the_scene_probability_is_logistic_with_two_pseudo_views():
    assert scene_probability(1.0, 1e9) == pytest.approx(expit(12 * 0.42))
    assert scene_probability(1.0, 2.0) == pytest.approx(expit(12 * 0.42 / 2))
