"""Observation of all views: its input is checked before anything is rendered."""

import dataclasses

import numpy as np
import pytest
from strategies import blobs, camera

from gsc_jax import InputError, observe

SCENE = blobs([[0, 0, 2]])
CAMERA = dataclasses.replace(camera(16, 12), name="one")
MASK = np.zeros((12, 16))


@pytest.mark.parametrize(
    ("cameras", "detector", "message"),
    [
        ([], {"one": MASK}, "no cameras"),
        ([CAMERA, CAMERA], {"one": MASK}, "Two cameras have the name 'one'"),
        ([CAMERA], {"other": MASK}, "'one' has no mask"),
    ],
)
def test_unusable_input_is_one_clear_error(cameras, detector, message):
    with pytest.raises(InputError, match=message):
        observe(SCENE, cameras, detector)


def test_a_detector_that_cannot_be_called_is_an_error():
    with pytest.raises(ValueError, match="got int"):
        observe(SCENE, [CAMERA], 3)  # type: ignore[arg-type]
