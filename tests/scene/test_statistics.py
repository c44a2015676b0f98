"""Statistics that several packages share, against SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.stats import mannwhitneyu

from gsc_jax.scene.statistics import superiority

FEW_VALUES = st.sampled_from([-np.inf, -1.5, 0.0, 1e-30, 2.0, np.inf])


@given(hnp.arrays(np.float32, 12, elements=FEW_VALUES), st.integers(1, 11))
def test_superiority_is_the_u_of_mann_and_whitney_by_pair(values, count):
    chosen = np.arange(12) < count
    u = mannwhitneyu(values[chosen], values[~chosen]).statistic
    assert superiority(values, chosen) == pytest.approx(u / (count * (12 - count)))


@pytest.mark.parametrize("chosen", [np.zeros(3, bool), np.ones(3, bool), np.zeros(0, bool)])
def test_without_a_pair_there_is_no_superiority(chosen):
    assert np.isnan(superiority(np.zeros(len(chosen)), chosen))
