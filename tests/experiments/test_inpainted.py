"""Inpainted removals take the region away, fill the hole smoothly, and leave the rest alone."""

import numpy as np
import pytest
from inpainted import continued, inpaint_region

from gsc_jax.benchmark.regions import EditRejected, measure_visibility
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.splat import render

MADE = tampered_room(count=3_000, views=8, heldout=1, width=64, height=48)
ROOM, CAMERAS = MADE.gaussians, MADE.cameras


def test_a_ramp_is_continued_across_a_hole():
    ramp = np.add.outer(np.linspace(0, 1, 30), np.linspace(0, 2, 40)) / 3
    hole = np.zeros(ramp.shape, bool)
    hole[10:18, 12:25] = True
    np.testing.assert_allclose(continued(np.where(hole, 0.0, ramp), hole), ramp, atol=0.02)
    np.testing.assert_array_equal(continued(ramp, ~hole | hole), ramp)


def test_the_rest_stays_and_the_hole_is_covered():
    edit = inpaint_region(ROOM, measure_visibility(ROOM, CAMERAS), 0.1, np.random.default_rng(3))
    assert edit.labels.any()
    rest = edit.gaussians.take(np.flatnonzero(~edit.labels))
    kept = {row.tobytes() for row in np.asarray(ROOM.means)}
    assert {row.tobytes() for row in rest.means} <= kept
    assert len(rest) < len(ROOM)
    for camera in CAMERAS[::3]:
        before, after = (np.asarray(render(scene, camera)[1]) for scene in (ROOM, edit.gaussians))
        assert after.mean() > 0.97 * before.mean()
    for leaf in vars(edit.gaussians).values():
        assert np.isfinite(leaf[edit.labels]).all()


def test_a_hole_that_no_view_sees_is_rejected():
    visibility = measure_visibility(ROOM, [camera.scaled(0.1) for camera in CAMERAS])
    with pytest.raises(EditRejected, match="pixels"):
        inpaint_region(ROOM, visibility, 1e-4, np.random.default_rng(0))
