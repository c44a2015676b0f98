"""Two opinions as one: each is believed as far as it is sure."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsc_jax.fusion import Prior, both, log_odds_of, pooled

UNIT = st.floats(0, 1, width=32)
OPINIONS = hnp.arrays(np.float32, 5, elements=UNIT)


@given(OPINIONS, OPINIONS, OPINIONS, UNIT)
def test_what_is_pooled_lies_between_both(masks, own, doubt, verdict):
    result = pooled(masks, Prior(probability=own, verdict=verdict), doubt)
    assert result.dtype == np.float32
    assert (result >= np.minimum(masks, own) - 1e-6).all()
    assert (result <= np.maximum(masks, own) + 1e-6).all()


@given(OPINIONS, OPINIONS, UNIT)
def test_who_is_sure_is_believed(masks, own, unsure):
    def prior(verdict: float) -> Prior:
        return Prior(probability=own, verdict=verdict)

    np.testing.assert_array_equal(pooled(masks, prior(unsure), np.zeros(5)), masks)
    np.testing.assert_array_equal(pooled(masks, prior(0.0), np.full(5, unsure)), masks)
    np.testing.assert_array_equal(pooled(masks, prior(1.0), np.ones(5)), own)


@given(OPINIONS, UNIT, UNIT)
def test_more_doubt_in_the_masks_is_more_of_the_prior(own, few, more):
    few, more = sorted((few, more))
    prior = Prior(probability=own, verdict=0.7)
    nothing = np.zeros(5, np.float32)
    assert (
        pooled(nothing, prior, np.full(5, few)) <= pooled(nothing, prior, np.full(5, more))
    ).all()


@given(st.floats(1e-6, 1 - 1e-6), st.floats(-20, 20))
def test_odds_of_independent_evidence_multiply(certain, log_odds):
    added = log_odds_of(both(certain, log_odds))
    assert added == pytest.approx(np.clip(log_odds_of(certain) + log_odds, -20.8, 20.8), abs=1e-3)
