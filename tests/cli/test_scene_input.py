"""Reading scenes and cameras."""

import dataclasses

import numpy as np
import pytest
from cli_case import FIXTURES

from gsc_jax.cli.scene_input import evenly_spaced
from gsc_jax.io.cameras import load_cameras

case, found, own_cache = FIXTURES


@pytest.mark.parametrize(("count", "total"), [(1, 3), (2, 5), (4, 24), (9, 3), (3, 3)])
def test_cameras_are_evenly_spaced(case, count, total):
    cameras = load_cameras(case / "cameras.json")
    many = [dataclasses.replace(cameras[0], name=str(i)) for i in range(total)]
    places = [int(camera.name) for camera in evenly_spaced(many, count)]
    assert len(places) == min(count, total)
    assert places[0] == 0
    gaps = np.diff([*places, total])
    assert gaps.min() >= 1
    assert np.ptp(gaps) <= 1
