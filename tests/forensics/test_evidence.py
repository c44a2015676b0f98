"""Evidence from the Gaussians themselves: what is laid down, and what it finds."""

import dataclasses

import jax
import numpy as np
import pytest
from export import exported
from hypothesis import given, settings
from hypothesis import strategies as st

from gsc_jax import locate
from gsc_jax.benchmark.metrics import auc, truth_mask
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.estimators.gschecker import METHODS
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.forensics.classifier import (
    SURE,
    as_arrays,
    from_arrays,
    judged,
    settled,
    shipped_model,
)
from gsc_jax.forensics.evidence import (
    BESIDE,
    LEVEL,
    SURELY,
    Native,
    find_native,
    gap,
    level_of,
    native_evidence,
    with_traces,
)
from gsc_jax.forensics.features import cues
from gsc_jax.forensics.traces import Trace
from gsc_jax.scene import InputError

MADE = tampered_room(count=6_000, views=2, heldout=1, width=64, height=48, seed=12)
SAVED = exported(MADE.gaussians, seed=12)


def test_a_pasted_object_is_found_in_an_export_that_hides_the_format():
    told = native_evidence(SAVED)
    assert auc(told.log_odds, MADE.labels) > 0.9
    assert told.probability.shape == (6_000,)
    assert 0 <= told.verdict <= 1


def test_the_order_of_the_rows_does_not_matter():
    order = np.random.default_rng(0).permutation(len(SAVED))
    one, other = native_evidence(SAVED), native_evidence(SAVED.take(order))
    np.testing.assert_allclose(other.log_odds, one.log_odds[order], atol=0.05)


def test_rows_without_meaning_say_nothing_and_harm_nobody():
    means = np.array(SAVED.means)
    means[:20] = np.nan
    broken = dataclasses.replace(SAVED, means=means)
    told = native_evidence(broken)
    assert not told.known[:20].any()
    assert (told.log_odds[:20] == np.float32(told.base)).all()
    assert np.isfinite(told.log_odds).all()
    assert auc(told.log_odds[20:], MADE.labels[20:]) > 0.9


@pytest.mark.parametrize("count", [1, 5, 17, 40])
def test_few_gaussians_are_no_trouble(count):
    told = native_evidence(SAVED.take(np.arange(count)))
    assert told.known.all() == (count > 16), "fewer have no surroundings"
    assert np.isfinite(told.log_odds).all()
    assert np.isfinite(told.verdict)


def test_a_model_survives_being_stored():
    model = shipped_model()
    again = from_arrays(as_arrays(model))
    described = cues(SAVED)
    np.testing.assert_array_equal(judged(described, model), judged(described, again))
    assert again.names == model.names
    assert again.scene == model.scene


def test_the_model_in_the_box_is_small():
    size = sum(np.asarray(part).nbytes for part in as_arrays(shipped_model()).values())
    assert size < 1.5e6


def test_settling_keeps_what_all_agree_on():
    described = cues(SAVED)
    np.testing.assert_allclose(settled(np.full(6_000, 2.0, np.float32), described), 2, atol=1e-5)


def test_a_scene_like_none_that_was_trained_on_is_not_all_suspicious():
    rng = np.random.default_rng(0)
    dots = dataclasses.replace(
        SAVED.take(np.arange(300)),
        means=rng.normal(size=(300, 3)).astype(np.float32),
        log_scales=np.full((300, 3), -2.6, np.float32),
    )
    told = native_evidence(dots)
    assert np.median(told.learned) <= told.base + 1e-4


def test_odds_are_bounded():
    loud = dataclasses.replace(shipped_model(), calibration=(40.0, 0.0))
    told = native_evidence(SAVED, model=loud)
    assert np.abs(told.learned).max() == pytest.approx(SURE)
    assert np.abs(told.log_odds).max() <= SURE


def asked(
    learned, *, verdict: float = 0.9, traced: tuple[int, ...] = (), name: str = "copied"
) -> Native:
    """What Gaussians say whose worst part has log odds of 7, if traces name some of them."""
    learned = np.asarray(learned, np.float32)
    score = np.zeros(len(learned), np.float32)
    score[list(traced)] = 0.999
    traces = (Trace(name=name, score=score, explanation="some"),) if traced else ()
    return Native(
        known=np.ones(len(learned), bool),
        learned=learned,
        learned_verdict=verdict,
        log_odds=with_traces(learned, traces),
        base=-3.0,
        worst=7.0,
        verdict=0.999 if traced else verdict,
        traces=traces,
    )


def test_a_trace_alone_is_enough_and_more_than_even_odds_are_asked_of_the_rest():
    native = asked([-3, -3, BESIDE + 0.1, BESIDE - 0.1], verdict=0.3, traced=(0,))
    found = find_native(native)
    assert found.labels.tolist() == [True, False, True, False]
    np.testing.assert_allclose(found.attribute, native.log_odds - BESIDE, atol=1e-5)
    assert native.prior.verdict == pytest.approx(0.999)
    np.testing.assert_array_equal(native.prior.probability, found.tamper)
    assert not native.prior.exact, "either may be the copy"
    assert not native.without_traces.traces


def test_where_an_edit_is_not_sure_only_what_stands_out_is_labelled():
    low, high = (-3 + 10 * (LEVEL + off) for off in (-0.02, 0.02))
    found = find_native(asked([low, high, 7, -3], verdict=SURELY - 0.1))
    assert found.labels.tolist() == [False, True, True, False]


def split(seed: int, edited: int) -> np.ndarray:
    """Log odds of 20,000 Gaussians, the last of which stand apart from the others."""
    rng = np.random.default_rng(seed)
    return np.append(rng.normal(-4, 0.6, 20_000 - edited), rng.normal(1.5, 1, edited))


@pytest.mark.parametrize("edited", [400, 5_000])
def test_where_an_edit_is_sure_what_stands_apart_is_labelled(edited: int):
    labels = find_native(asked(split(0, edited))).labels
    assert labels[-edited:].mean() > 0.97
    assert labels[:-edited].mean() < 0.01
    shy = find_native(asked(split(0, edited), verdict=SURELY - 0.1)).labels
    assert shy[-edited:].mean() < 0.95


def test_traces_that_name_little_of_what_stands_apart_do_not_name_the_edit():
    log_odds = split(1, 2_000)
    few = find_native(asked(log_odds, traced=(0, -1))).labels
    assert few[0]
    assert few[-2_000:].mean() > 0.99
    most = find_native(asked(log_odds, traced=tuple(range(-1_500, 0)))).labels
    assert most[-1_500:].all()
    assert most[-2_000:-1_500].mean() < 0.9


@pytest.mark.parametrize(("named", "exact"), [(1_500, True), (100, False)])
def test_a_trace_that_names_most_of_an_edit_names_it_exactly(named, exact):
    native = asked(split(1, 2_000), traced=tuple(range(-named, 0)), name="lattice")
    assert native.prior.exact == exact


def test_rows_of_which_nothing_is_known_do_not_move_the_level():
    # Nothing lies near the base rate, so that they would.
    native = asked(np.append(np.full(5_000, -6.0), np.linspace(-2, 7, 2_000)))
    padded = {
        name: np.append(getattr(native, name), np.full(5_000, value))
        for name, value in (("known", False), ("learned", -3.0), ("log_odds", -3.0))
    }
    assert level_of(dataclasses.replace(native, **padded)) == level_of(native)


def test_where_nothing_stands_out_there_is_no_gap():
    flat = dataclasses.replace(asked(np.full(50, -3.0)), worst=-3.0)
    assert level_of(flat) == -3.0
    assert not find_native(flat).labels.any()


@given(st.integers(0, 99), st.integers(50, 5_000), st.floats(-5, 5), st.floats(0.2, 5))
@settings(max_examples=20, deadline=None)
def test_the_gap_moves_with_the_log_odds(seed: int, edited: int, shift: float, factor: float):
    log_odds = split(seed, edited)
    level = gap(log_odds, -3, 10)
    moved = gap(factor * log_odds + shift, factor * -3 + shift, factor * 10)
    assert moved == pytest.approx(factor * level + shift, abs=factor * 10 * 0.02)


def test_nothing_is_labelled_where_next_to_nothing_speaks_for_an_edit():
    native = Native(
        known=np.ones(2, bool),
        learned=np.zeros(2, np.float32),
        learned_verdict=0.5,
        log_odds=np.array([3.0, -3.0], np.float32),
        base=-3.0,
        worst=7.0,
        verdict=0.01,
        traces=(),
    )
    assert not find_native(native).labels.any()
    assert not find_native(native).tamper.any()
    assert find_native(native, config=RobustConfig(doubt=0.0)).labels.tolist() == [True, False]


def test_locate_without_a_detector_asks_the_gaussians():
    result = locate(jax.tree.map(np.asarray, SAVED), MADE.cameras, None)
    assert result.native is not None
    assert set(result.masks) == {camera.name for camera in MADE.cameras}
    assert result.verdict == result.native.verdict
    told = native_evidence(SAVED)
    again = locate(SAVED, MADE.cameras, None, native=told)
    np.testing.assert_array_equal(again.labels, result.labels)


def test_locate_with_nothing_to_go_by_says_so():
    with pytest.raises(ValueError, match="nothing to go by"):
        locate(SAVED, MADE.cameras, None, native=False)
    with pytest.raises(ValueError, match="nothing to go by"):
        locate(SAVED, MADE.cameras, None, config=METHODS["paper"])


def said(log_odds: np.ndarray, verdict: float) -> Native:
    """What Gaussians may have said."""
    log_odds = np.asarray(log_odds, np.float32)
    return Native(
        known=np.ones(len(log_odds), bool),
        learned=log_odds,
        learned_verdict=verdict,
        log_odds=log_odds,
        base=-3.0,
        worst=float(log_odds.max()),
        verdict=verdict,
        traces=(),
    )


def test_views_that_flag_nothing_speak_against_an_edit_but_not_against_a_certain_one():
    black = {camera.name: np.zeros((48, 64), np.float32) for camera in MADE.cameras}
    log_odds = np.where(MADE.labels, 9.0, -5.0)
    certain = locate(SAVED, MADE.cameras, black, native=said(log_odds, 1 - 1e-6))
    np.testing.assert_array_equal(certain.labels, MADE.labels)
    assert "the Gaussians themselves" in certain.warnings[-1]
    likely = locate(SAVED, MADE.cameras, black, native=said(log_odds, 0.4))
    assert not likely.labels.any()
    assert likely.verdict is not None
    assert likely.verdict < 0.1


def test_both_kinds_of_evidence_make_the_verdict():
    masks = {c.name: truth_mask(SAVED, c, MADE.labels) for c in MADE.cameras}
    verdicts = [
        locate(SAVED, MADE.cameras, masks, native=said(np.full(6_000, -3.0), p)).verdict or 0.0
        for p in (0.1, 0.5, 0.9)
    ]
    assert verdicts[0] == verdicts[1] < verdicts[2], "what does not show is no evidence"
    plain = locate(SAVED, MADE.cameras, masks, native=False).verdict
    assert verdicts[1] == pytest.approx(plain)


def test_what_is_no_evidence_is_refused():
    prior = said(np.zeros(6_000), 0.5).prior
    with pytest.raises(ValueError, match="got Prior"):
        locate(SAVED, MADE.cameras, None, native=prior)  # pyright: ignore[reportArgumentType]


def test_evidence_of_another_scene_is_refused():
    with pytest.raises(ValueError, match="speaks of 3 Gaussians"):
        locate(SAVED, MADE.cameras, None, native=said(np.zeros(3), 0.5))


@pytest.mark.parametrize("changes", ["flat", "identical"])
def test_degenerate_attributes_are_no_trouble(changes):
    some = SAVED.take(np.arange(3_000))
    scales = np.array(some.log_scales)
    scales[: 5 if changes == "flat" else None] = -np.inf if changes == "flat" else -3.0
    opacities = np.array(some.logit_opacities)
    opacities[:3] = np.inf, -np.inf, 0
    odd = dataclasses.replace(some, log_scales=scales, logit_opacities=opacities)
    if changes == "identical":
        same = np.ones_like(some.quats), np.zeros_like(some.sh), np.zeros(3_000, np.float32)
        odd = dataclasses.replace(odd, quats=same[0], sh=same[1], logit_opacities=same[2])
    told = native_evidence(odd)
    assert np.isfinite(told.log_odds).all()
    assert np.isfinite(told.verdict)


def test_methods_that_have_no_use_for_it_do_not_ask():
    masks = {camera.name: np.zeros((48, 64), np.float32) for camera in MADE.cameras}
    assert locate(SAVED, MADE.cameras, masks, method="official").native is None
    with pytest.raises(InputError, match="No camera has a mask"):
        locate(SAVED, MADE.cameras, {"elsewhere": np.zeros((4, 4))})
