"""Rotations and usable rows of Gaussians, and robust statistics."""

import dataclasses

import numpy as np
import reference
from strategies import random_scene, with_row

from gsc_jax.scene.gaussians import rotation_matrices, usable_rows
from gsc_jax.scene.statistics import median_and_mad


def test_rotation_matrices_are_those_of_the_quaternions():
    scene = with_row(random_scene(50), "quats", [-2, 0, 0, 0])
    expected = reference.rotations(scene.quats)
    np.testing.assert_allclose(rotation_matrices(scene), expected, atol=1e-6)
    for length in (1e-30, 1e9):  # neither overflows nor underflows
        scaled = dataclasses.replace(scene, quats=np.float32(length) * np.asarray(scene.quats))
        np.testing.assert_allclose(rotation_matrices(scaled), expected, atol=1e-6)


def test_a_damaged_rotation_is_the_identity():
    scene = with_row(with_row(random_scene(3), "quats", 0, row=0), "quats", np.nan, row=1)
    np.testing.assert_array_equal(rotation_matrices(scene)[:2], [np.eye(3)] * 2)


def test_rows_are_usable_unless_a_parameter_is_damaged():
    scene = random_scene(7)
    assert usable_rows(scene).all()
    damage = [("means", 1e30), ("quats", 0), ("log_scales", 50), ("logit_opacities", np.nan)]
    damage.append(("quats", 3e38))
    for row, (field, value) in enumerate(damage):
        scene = with_row(scene, field, value, row=row)
    assert usable_rows(with_row(scene, "logit_opacities", np.inf, row=6)).tolist() == [
        False, False, False, False, False, True, True,
    ]  # fmt: skip


def test_median_and_mad_are_those_of_a_normal_distribution_despite_outliers():
    values = np.random.default_rng(0).normal(3.0, 2.0, (1, 10_001))
    values[0, :500] = 1e9
    center, spread = median_and_mad(values, axis=1)
    assert center.shape == spread.shape == (1, 1)
    np.testing.assert_allclose([center[0, 0], spread[0, 0]], [3.0, 2.0], atol=0.25)
