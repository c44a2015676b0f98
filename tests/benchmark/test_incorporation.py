import dataclasses

import numpy as np
import pytest
from edited_room import UP, edited, room, vase
from hypothesis import given, settings
from scipy.spatial.transform import Rotation
from strategies import camera, motions, random_scene

from gsc_jax.benchmark import incorporation
from gsc_jax.benchmark.incorporation import transformed
from gsc_jax.splat import render


def test_a_pasted_object_stands_on_free_ground():
    found = edited("incorporation")
    pasted, rest = (found.gaussians.take(rows) for rows in (found.labels, ~found.labels))
    _, high = incorporation.extent(pasted)
    foot = np.append(np.median(pasted.means[:, [0, 2]], axis=0), high[1])[[0, 2, 1]]
    near = np.linalg.norm(rest.means[:, [0, 2]] - foot[[0, 2]], axis=1) < 0.2
    assert np.min(np.abs(rest.means[near, 1] - foot[1])) < 0.03
    inside = near & (rest.means[:, 1] < foot[1] - 0.1) & (rest.means[:, 1] > foot[1] - 0.4)
    solid = np.asarray(rest.opacities) > 0.5
    assert np.sum(inside & solid) < 0.2 * np.sum(near & solid), "it stands inside an obstacle"


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_a_donor_gets_the_degree_of_the_scene(degree):
    donor = random_scene(20, degree=2)
    fitted = incorporation.with_degree(donor, degree)
    shared = min(9, (degree + 1) ** 2)
    assert fitted.sh_degree == degree
    np.testing.assert_array_equal(fitted.sh[:, :shared], donor.sh[:, :shared])
    assert not fitted.sh[:, shared:].any()


@given(motions())
@settings(max_examples=8)
def test_scene_and_camera_transformed_together_give_the_same_image(motion):
    quat, translation = motion
    R, scale = Rotation.from_quat(quat, scalar_first=True).as_matrix(), 1.7
    scene, view = random_scene(12, seed=3, degree=3), camera()
    moved = transformed(scene, R, scale, translation)
    viewmat = np.eye(4)
    viewmat[:3, :3] = R.T
    viewmat[:3, 3] = -R.T @ translation
    there = dataclasses.replace(view, viewmat=viewmat.astype(np.float32))
    expected, _ = render(scene, view, near=0.2)
    image, _ = render(moved, there, near=0.2 * scale)
    assert np.asarray(expected).mean() > 0.02, "the scene is invisible"
    difference = np.abs(np.asarray(image) - np.asarray(expected))
    assert difference.mean() < 2e-4
    assert difference.max() < 0.02


def test_a_donor_gets_unit_quaternions_if_the_scene_has_them():
    scene = room()[0]
    length = np.linalg.norm(scene.quats, axis=1, keepdims=True)
    for factor in (1, 2):
        host = dataclasses.replace(scene, quats=factor * scene.quats / length)
        pasted = incorporation._with_quaternion_lengths_of(host, vase())
        if factor == 1:
            np.testing.assert_allclose(np.linalg.norm(pasted.quats, axis=1), 1, atol=1e-5)
        else:
            np.testing.assert_array_equal(pasted.quats, vase().quats)


def test_level_ground_costs_nothing_and_a_missing_sector_its_share():
    x, z = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    plane = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1)

    def cost(points):
        return incorporation.placement_cost(points, np.zeros(3), UP, 0.9, 1.0)[0]

    assert cost(plane) == pytest.approx(0, abs=1e-6)
    side = np.linalg.svd(UP[None])[2][1:]
    angles = np.arctan2(*(plane @ side.T).T[::-1])
    sector = np.floor(angles * incorporation.SECTORS / (2 * np.pi))
    inner = np.linalg.norm(plane, axis=1) < 0.4
    costs = [cost(plane[inner | (sector % 8 != k)]) for k in range(incorporation.SECTORS)]
    np.testing.assert_allclose(costs, 1 / incorporation.SECTORS, atol=1e-3)


def test_rotation_between_opposite_directions():
    for end in (UP, -UP, np.array([0.6, 0.8, 0])):
        rotation = incorporation.rotation_between(UP, end)
        np.testing.assert_allclose(rotation @ UP, end, atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1)
