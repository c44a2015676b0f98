"""Laws of padding and of the threshold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsc_jax.detectors.preprocessing import crop_map, fit_image, remap_threshold

SIZES = st.tuples(st.integers(1, 40), st.integers(1, 40))


@given(SIZES, SIZES)
@settings(max_examples=60, deadline=None)
def test_cropping_inverts_padding(shape, target):
    canvas, (height, width) = fit_image(np.ones((*shape, 3), np.float32), target, fit="pad")
    assert canvas.shape == (*target, 3)
    np.testing.assert_allclose(canvas[:height, :width], 1, rtol=1e-6)
    assert canvas.sum() == pytest.approx(3 * height * width, rel=1e-5)
    assert crop_map(canvas[..., 0], target, (height, width)).shape == (height, width)
    if shape[0] <= target[0] and shape[1] <= target[1]:
        assert (height, width) == shape


@given(st.floats(0.01, 0.99), st.lists(st.floats(0, 1, width=32), min_size=2, max_size=8))
def test_remapping_keeps_order_and_decision(threshold, values):
    values = np.sort(np.array([0, threshold, 1, *values], np.float32))
    found = remap_threshold(values, threshold)
    assert found.dtype == np.float32
    assert (found[0], found[-1]) == (0, 1)
    assert (np.diff(found) >= 0).all()
    np.testing.assert_array_equal(found > 0.5, values > threshold)


@pytest.mark.parametrize("threshold", [0.3, 0.5, 0.9])
def test_remapping_keeps_the_decision_to_the_last_bit(threshold):
    equal = np.float32(threshold)
    values = np.array([np.nextafter(equal, 0), equal, np.nextafter(equal, 1)], np.float32)
    found = remap_threshold(values, threshold)
    np.testing.assert_array_equal(found > 0.5, [False, False, True])
    np.testing.assert_allclose(found, 0.5, atol=1e-6)
