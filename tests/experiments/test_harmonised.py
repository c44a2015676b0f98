"""A pasted object takes the light of its place, and nothing sticks through at the contact."""

import numpy as np
import pytest
from harmonised import contact, incorporate, lit_like, place_of

from gsc_jax.benchmark.regions import measure_visibility
from gsc_jax.benchmark.scenes import make_object, make_room, room_cameras
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians

UP = np.array([0, -1.0, 0])


def scene_of(points: np.ndarray, colors: np.ndarray) -> Gaussians:
    count = len(points)
    sh = np.zeros((count, 4, 3), np.float32)
    sh[:, 0], sh[:, 1:] = (colors - 0.5) / Y0, 0.1
    return Gaussians(
        means=points.astype(np.float32),
        log_scales=np.full((count, 3), -3, np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        logit_opacities=np.full(count, 3, np.float32),
        sh=sh,
    )


def ball_on_ground() -> tuple[Gaussians, np.ndarray]:
    """A ball of radius 1 that stands 0.2 deep in the ground y = 0, with y down; it is last."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-4, 4, 2000), np.zeros(2000), rng.uniform(-4, 4, 2000)])
    inside = rng.normal(size=(50, 3)) * 0.1 - [0, 0.8, 0]
    ball = rng.normal(size=(1000, 3))
    ball = ball / np.linalg.norm(ball, axis=1, keepdims=True) - [0, 0.8, 0]
    colors = np.concatenate(
        [rng.uniform(0.2, 0.4, (2050, 3)), rng.uniform(0.4, 0.9, (1000, 3)) * [1, 0.8, 0.6]]
    )
    return scene_of(np.concatenate([ground, inside, ball]), colors), np.arange(3050) >= 2050


def colors_of(scene: Gaussians) -> np.ndarray:
    return 0.5 + Y0 * np.asarray(scene.sh)[:, 0]


def test_full_strength_gives_an_object_the_colours_of_its_place():
    scene, labels = ball_on_ground()
    place = place_of(scene, labels)
    assert not place[labels].any()
    lit = lit_like(scene, labels, place, 1.0)
    own, other = colors_of(lit)[labels], colors_of(lit)[place]
    np.testing.assert_allclose(own.mean(axis=0), other.mean(axis=0), atol=0.02)
    before = colors_of(scene)[labels]
    gain = own.std(axis=0) / before.std(axis=0)
    assert (gain < 1).all()
    bands = np.asarray(lit.sh)[labels, 1]
    np.testing.assert_allclose(bands, 0.1 * gain[None].repeat(1000, 0), rtol=1e-5)
    np.testing.assert_array_equal(np.asarray(lit.sh)[~labels], np.asarray(scene.sh)[~labels])


def test_no_strength_changes_no_colour():
    scene, labels = ball_on_ground()
    lit = lit_like(scene, labels, place_of(scene, labels), 0.0)
    np.testing.assert_allclose(lit.sh, scene.sh, atol=1e-6)


def test_half_the_strength_goes_half_of_the_way():
    scene, labels = ball_on_ground()
    place = place_of(scene, labels)
    means = [colors_of(lit_like(scene, labels, place, s))[labels].mean(axis=0) for s in (0, 0.5, 1)]
    np.testing.assert_allclose(means[1], (means[0] + means[2]) / 2, atol=1e-5)


def test_what_lies_below_the_ground_and_what_is_inside_of_the_object_is_deleted():
    scene, labels = ball_on_ground()
    deleted = contact(scene, labels, UP)
    heights = -np.asarray(scene.means)[:, 1]
    assert deleted[labels & (heights < -0.1)].all()
    assert not deleted[labels & (heights > 0)].any()
    assert deleted[2000:2050].all()  # the cloud inside of the ball
    assert not deleted[:2000].any()  # the ground itself


def test_a_flat_object_has_no_core():
    scene, labels = ball_on_ground()
    flat = np.array(scene.means)
    flat[labels, 2] = 0
    scene = scene_of(flat, colors_of(scene))
    assert not contact(scene, labels, UP)[~labels].any()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_harmonised_object_is_nearer_in_colour_than_a_pasted_one(seed):
    room = make_room(count=4_000)
    visibility = measure_visibility(room, room_cameras(8, width=96, height=72))
    donor, rng = make_object(seed=seed), np.random.default_rng(seed)
    edit = incorporate(room, visibility, 0.05, rng, donor)
    labels = edit.labels
    assert 0.5 * len(donor) < labels.sum() <= len(donor)
    assert "lit like its place" in edit.description
    assert edit.original is None
    place = place_of(edit.gaussians, labels)
    target = colors_of(edit.gaussians)[place].mean(axis=0)
    own = colors_of(edit.gaussians)[labels].mean(axis=0)
    assert np.abs(own - target).sum() < np.abs(colors_of(donor).mean(axis=0) - target).sum()
